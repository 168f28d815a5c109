//! Numbers, sentences and names of edits as people read them.

pub(crate) use surgtpgs_core::export::timecode;

/// Begins a text with a capital letter.
pub(crate) fn sentence(text: &str) -> String {
    let mut letters = text.chars();
    letters.next().map_or_else(String::new, |first| first.to_uppercase().chain(letters).collect())
}

/// Beginnings of names of edits, and what they are called once the edit is made. What lasts, such as hiding,
/// is called the same.
const DONE: [(&str, &str); 12] = [
    ("adding ", "added "),
    ("changing ", "changed "),
    ("deleting ", "deleted "),
    ("keeping ", "kept "),
    ("leaving out ", "left out "),
    ("marking ", "marked "),
    ("moving ", "moved "),
    ("reading ", "read "),
    ("removing ", "removed "),
    ("returning ", "returned "),
    ("setting ", "set "),
    ("taking ", "took "),
];

/// Turns the name of an edit into words for what was done: "deleting liver" becomes "deleted liver".
pub(crate) fn done(edit: &str) -> String {
    let past = DONE.iter().find_map(|(name, past)| Some(format!("{past}{}", edit.strip_prefix(*name)?)));
    past.unwrap_or_else(|| edit.to_owned())
}

/// Formats a duration as an estimate.
pub(crate) fn about(seconds: f64) -> String {
    let duration = duration(seconds);
    if duration.starts_with("a ") { duration } else { format!("about {duration}") }
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
        assert_eq!([about(3.0), about(44.0)], ["a few seconds", "about 40 seconds"]);
        assert_eq!(thousands(1_234_567), "1\u{a0}234\u{a0}567");
        assert_eq!(thousands(12), "12");
        let files = [0, 1, 1200].map(|n| counted(n, "file", "files"));
        assert_eq!(files, ["0 files", "1 file", "1\u{a0}200 files"]);
    }

    #[test]
    fn what_was_done_is_told_as_done_and_what_lasts_as_lasting() {
        let told =
            ["deleting \"fat\"", "leaving out frame 1", "hiding \"fat\"", "masks as they are"].map(done);
        assert_eq!(told, ["deleted \"fat\"", "left out frame 1", "hiding \"fat\"", "masks as they are"]);
    }

    #[test]
    fn small_shares_are_not_shown_as_nothing() {
        assert_eq!(percent(0.0), "0 %");
        assert_eq!(percent(0.0002), "< 0.1 %");
        assert_eq!(percent(0.034), "3.4 %");
        assert_eq!(percent(0.456), "46 %");
    }
}
