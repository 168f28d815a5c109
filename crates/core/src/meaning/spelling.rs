//! Words that are one typing mistake away.

use std::collections::BTreeSet;

/// A list of words to search for near ones.
#[derive(Debug, Default)]
pub(super) struct Spelling {
    /// Words by their length in bytes, sorted.
    by_length: Vec<Vec<String>>,
}

impl Spelling {
    pub fn new<'a>(words: impl IntoIterator<Item = &'a String>) -> Self {
        let mut by_length: Vec<Vec<String>> = Vec::new();
        for word in words.into_iter().collect::<BTreeSet<_>>() {
            if by_length.len() <= word.len() {
                by_length.resize_with(word.len() + 1, Vec::new);
            }
            by_length[word.len()].push(word.clone());
        }
        Self { by_length }
    }

    /// The words one mistake away from `word`: those of its length, then longer ones (a letter was left
    /// out), then shorter ones, each in alphabetical order.
    pub fn near<'a>(&'a self, word: &'a str) -> impl Iterator<Item = &'a str> {
        let lengths = [Some(word.len()), Some(word.len() + 1), word.len().checked_sub(1)];
        let lists = lengths.into_iter().filter_map(|length| self.by_length.get(length?));
        lists.flatten().map(String::as_str).filter(move |listed| one_mistake(word, listed))
    }

    /// The word that `word` becomes if one of two equal neighbouring letters is left out.
    pub fn undoubled(&self, word: &str) -> Option<&str> {
        let shorter = self.by_length.get(word.len().checked_sub(1)?)?;
        let is_doubled = |listed: &&String| {
            let at = first_difference(word, listed);
            let (word, listed) = (word.as_bytes(), listed.as_bytes());
            at > 0 && word[at] == word[at - 1] && word[at + 1..] == listed[at..]
        };
        shorter.iter().find(is_doubled).map(String::as_str)
    }
}

/// Tests whether a letter was left out, added or replaced, or two neighbours swapped. Equal words count.
pub(super) fn one_mistake(a: &str, b: &str) -> bool {
    let (short, long) = if a.len() < b.len() { (a, b) } else { (b, a) };
    if long.len() - short.len() > 1 {
        return false;
    }
    let at = first_difference(short, long);
    let (short, long) = (&short.as_bytes()[at..], &long.as_bytes()[at..]);
    let [first, rest @ ..] = long else { return true };
    if short.len() < long.len() {
        return short == rest;
    }
    let is_swapped =
        || long.len() >= 2 && short[0] == long[1] && short[1] == *first && short[2..] == long[2..];
    short[1..] == *rest || is_swapped()
}

/// Number of equal bytes at the start.
fn first_difference(a: &str, b: &str) -> usize {
    a.bytes().zip(b.bytes()).take_while(|(x, y)| x == y).count()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_mistake_is_one_letter_or_a_swap() {
        for near in ["liver", "livr", "livver", "lover", "lvier", "livre", "iver", "livera"] {
            assert!(one_mistake("liver", near) && one_mistake(near, "liver"), "{near}");
        }
        for far in ["lve", "revil", "livingg", "lvire", "", "l"] {
            assert!(!one_mistake("liver", far) && !one_mistake(far, "liver"), "{far}");
        }
        assert!(one_mistake("", "") && one_mistake("", "a"));
    }

    #[test]
    fn near_words_are_found_at_every_length() {
        let words = ["liver", "lever", "livers", "fat", ""].map(String::from);
        let spelling = Spelling::new(&words);
        assert_eq!(spelling.near("liver").collect::<Vec<_>>(), ["lever", "liver", "livers"]);
        assert_eq!(spelling.near("banana").count(), 0);
        assert_eq!(spelling.undoubled("fatt"), Some("fat"));
        assert_eq!(spelling.undoubled("livver"), Some("liver"));
        assert_eq!(spelling.undoubled("lifver"), None);
        assert_eq!(spelling.undoubled(""), None);
    }
}
