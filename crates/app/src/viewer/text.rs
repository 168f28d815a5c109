//! Numbers as people read them.

pub(crate) use surgtpgs_core::export::timecode;

/// Begins a text with a capital letter.
pub(crate) fn sentence(text: &str) -> String {
    let mut letters = text.chars();
    letters.next().map_or_else(String::new, |first| first.to_uppercase().chain(letters).collect())
}

/// Formats a duration in words, rounded as people say it.
pub(crate) fn duration(seconds: f64) -> String {
    let whole = seconds.max(0.0).round() as u64;
    match whole {
        0..=9 => "a few seconds".into(),
        10..=89 => format!("{} seconds", whole / 5 * 5),
        90..=5399 => format!("{} minutes", (whole + 30) / 60),
        _ => format!("{:.1} hours", seconds / 3600.0),
    }
}

/// Formats a whole number with thin gaps between thousands.
pub(crate) fn thousands(n: usize) -> String {
    let digits = n.to_string();
    let mut text = String::new();
    for (i, digit) in digits.chars().enumerate() {
        if i > 0 && (digits.len() - i).is_multiple_of(3) {
            text.push('\u{a0}');
        }
        text.push(digit);
    }
    text
}

/// Formats a number of things that are called `one`, or `many` if there is another number of them.
pub(crate) fn counted(n: usize, one: &str, many: &str) -> String {
    format!("{} {}", thousands(n), if n == 1 { one } else { many })
}

/// Formats a share of the frame in percent; small shares keep their digits.
pub(crate) fn percent(share: f32) -> String {
    match share * 100.0 {
        p if p <= 0.0 => "0 %".into(),
        p if p < 0.1 => "< 0.1 %".into(),
        p if p < 10.0 => format!("{p:.1} %"),
        p => format!("{p:.0} %"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_and_numbers_in_words() {
        assert_eq!(duration(3.0), "a few seconds");
        assert_eq!(duration(44.0), "40 seconds");
        assert_eq!(duration(100.0), "2 minutes");
        assert_eq!(duration(5400.0), "1.5 hours");
        assert_eq!(thousands(1_234_567), "1\u{a0}234\u{a0}567");
        assert_eq!(thousands(12), "12");
        let files = [0, 1, 1200].map(|n| counted(n, "file", "files"));
        assert_eq!(files, ["0 files", "1 file", "1\u{a0}200 files"]);
    }

    #[test]
    fn small_shares_are_not_shown_as_nothing() {
        assert_eq!(percent(0.0), "0 %");
        assert_eq!(percent(0.0002), "< 0.1 %");
        assert_eq!(percent(0.034), "3.4 %");
        assert_eq!(percent(0.456), "46 %");
    }
}
