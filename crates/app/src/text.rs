//! Text of any origin, made fit to be shown: names of files may hold characters that turn lines
//! round or cannot be seen.

use std::{borrow::Cow, io::Write as _};

/// Turns characters that cannot be seen into escapes such as `\u{202e}`; ends of lines and tabs stay.
pub(crate) fn visible(text: &str) -> Cow<'_, str> {
    replaced(text, |c, out| out.extend(c.escape_unicode()))
}

/// Turns characters that cannot be seen into escapes; the JSON says the same.
pub(crate) fn in_json(json: &str) -> Cow<'_, str> {
    replaced(json, |c, out| {
        c.encode_utf16(&mut [0; 2]).iter().for_each(|unit| out.push_str(&format!("\\u{unit:04x}")));
    })
}

/// Writes a line to standard error.
pub fn say(line: &str) {
    // Names of files may hold ends of lines.
    let line = visible(line).replace('\n', "\\n");
    let _ = writeln!(std::io::stderr().lock(), "{line}");
}

/// Makes a message one line, without anything that a terminal would obey. Messages from libraries may have
/// several lines, and names of files and the text in them may hold escape sequences.
pub(crate) fn one_line(text: &str) -> String {
    let shown: String = text.chars().map(|c| if c.is_control() { ' ' } else { c }).collect();
    visible(&shown.split_whitespace().collect::<Vec<_>>().join(" ")).into_owned()
}

/// Splits a text at commas, without words that are empty.
pub(crate) fn split_words(text: &str) -> Vec<String> {
    text.split(',').map(str::trim).filter(|w| !w.is_empty()).map(str::to_owned).collect()
}

fn replaced(text: &str, escape: impl Fn(char, &mut String)) -> Cow<'_, str> {
    if !text.chars().any(is_hidden) {
        return Cow::Borrowed(text);
    }
    let mut out = String::with_capacity(text.len() + 8);
    text.chars().for_each(|c| if is_hidden(c) { escape(c, &mut out) } else { out.push(c) });
    Cow::Owned(out)
}

/// Returns `true` for controls, marks of direction, separators of lines, and formatting without a picture.
/// The joiners U+200C and U+200D are letters of several scripts, and are not hidden.
fn is_hidden(c: char) -> bool {
    let is_format = matches!(
        c,
        '\u{ad}' | '\u{61c}' | '\u{180e}' | '\u{200b}' | '\u{200e}' | '\u{200f}' | '\u{2028}'..='\u{202e}'
            | '\u{2060}'..='\u{206f}' | '\u{feff}' | '\u{fff9}'..='\u{fffb}' | '\u{e0000}'..='\u{e007f}'
    );
    is_format || (c.is_control() && !matches!(c, '\n' | '\t' | '\r'))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_cannot_be_seen_is_shown_as_its_number() {
        let text = "a\u{202e}b\u{2066}c\u{200f}d\u{61c}e\u{2028}f\u{feff}g\u{1b}[0m";
        assert_eq!(visible(text), r"a\u{202e}b\u{2066}c\u{200f}d\u{61c}e\u{2028}f\u{feff}g\u{1b}[0m");
        for seen in ["患者七 é\n\tü", "می\u{200c}خواهم", "👩\u{200d}⚕️"] {
            assert_eq!(visible(seen), seen);
        }
    }

    #[test]
    fn a_message_is_one_line_that_no_terminal_obeys() {
        assert_eq!(one_line("a\n  b\u{1b}[31mred\u{7} \u{9b}2J é"), "a b [31mred 2J é");
        assert_eq!(one_line("clip\u{202e}gpj.exe"), r"clip\u{202e}gpj.exe");
    }

    #[test]
    fn json_means_what_it_meant() {
        let name = "a\u{202e}b\u{e0041}\u{2029}";
        let json = in_json(&serde_json::to_string(name).unwrap()).into_owned();
        assert_eq!(json, r#""a\u202eb\udb40\udc41\u2029""#);
        assert_eq!(serde_json::from_str::<String>(&json).unwrap(), name);
    }
}
