//! Text in XML files.

use quick_xml::escape::escape;

/// Returns text as XML can hold it. Characters that it cannot hold become spaces, and so do ends of lines,
/// which readers of attributes would change.
pub(super) fn xml(text: &str) -> String {
    let is_held = |c: char| !c.is_control() && !matches!(c, '\u{fffe}' | '\u{ffff}');
    let text: String = text.chars().map(|c| if is_held(c) { c } else { ' ' }).collect();
    escape(&text).into_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_xml_cannot_hold_becomes_a_space() {
        assert_eq!(
            xml("bile & <sac>\u{1}\u{85}\n\u{fffe}\u{ffff}\u{fffd}é"),
            "bile &amp; &lt;sac&gt;     \u{fffd}é"
        );
    }
}
