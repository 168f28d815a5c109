//! Phrases: which words of a prompt carry its meaning, and what it is about.

use super::{text, word_files::GrammarLists};
use std::collections::HashSet;

/// Words that do not name a thing, by what they do in a phrase. All in the compared form of [`text`].
#[derive(Debug, Default)]
pub(super) struct Grammar {
    articles: HashSet<String>,
    /// Words that leave the meaning as it is: "left", "visible".
    neutral: HashSet<String>,
    joining: HashSet<String>,
    prepositions: HashSet<String>,
    sides: HashSet<String>,
    negations: HashSet<String>,
    parts: HashSet<String>,
    places: HashSet<String>,
}

/// A prompt or a listed word, taken apart.
#[derive(Debug)]
pub(super) struct Phrase {
    pub tokens: Vec<String>,
    /// Keys to look the phrase up by, from strict to loose.
    pub keys: Vec<Key>,
    /// Its words without neutral and joining ones, as a key.
    pub bare: String,
    /// The words that carry its meaning: neither neutral nor joining, nor for a part or a place.
    pub content: Vec<String>,
    /// The words of what it is about, up to a preposition; the last one is its head noun.
    pub subject: Vec<String>,
    /// `true` if a preposition ended the subject.
    pub has_more: bool,
}

/// Words joined without spaces, so that "gall bladder" is "gallbladder".
#[derive(Debug)]
pub(super) struct Key {
    pub text: String,
    pub fit: KeyFit,
}

/// Amount that was left out for a key.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum KeyFit {
    /// Nothing but articles.
    Exact,
    /// Joining and neutral words.
    Loose,
    /// Words for a part or a place, too.
    Part,
}

impl Phrase {
    /// Returns `true` if each word has a letter or digit that listed words have. Encoders are measured with
    /// these words alone.
    pub fn is_latin(&self) -> bool {
        self.tokens.iter().all(|token| token.bytes().any(|b| b.is_ascii_alphanumeric()))
    }
}

impl Grammar {
    pub fn new(lists: &GrammarLists, neutral: &[String]) -> Self {
        // Neutral phrases of several words ("part of the") need no entry: the rules for parts cover them.
        let single = neutral.iter().map(|words| text::tokens(words)).filter(|tokens| tokens.len() == 1);
        Self {
            articles: token_set(&lists.articles),
            neutral: single.flatten().collect(),
            joining: token_set(&lists.joining),
            prepositions: token_set(&lists.prepositions),
            sides: token_set(&lists.sides),
            negations: token_set(&lists.negations),
            parts: token_set(&lists.parts),
            places: token_set(&lists.places),
        }
    }

    /// All words of the lists.
    pub fn words(&self) -> impl Iterator<Item = &String> {
        let lists = [&self.articles, &self.neutral, &self.joining, &self.prepositions, &self.negations];
        lists.into_iter().flatten().chain(&self.parts).chain(&self.places)
    }

    pub fn is_part(&self, token: &str) -> bool {
        self.parts.contains(token)
    }

    /// Returns `true` if a word ties others together.
    pub fn is_tie(&self, token: &str) -> bool {
        self.joining.contains(token) || self.prepositions.contains(token)
    }

    pub fn is_neutral(&self, token: &str) -> bool {
        self.neutral.contains(token)
    }

    /// Returns `true` if words say what is not meant: "gallbladder without stones" means the gallbladder,
    /// "without gallbladder" does not.
    pub fn says_not(&self, tokens: &[String]) -> bool {
        tokens.first().is_some_and(|first| first == "without")
            || tokens.iter().any(|token| self.negations.contains(token))
    }

    /// Returns the words of the thing beside which a phrase names a place: "under the liver", "left of the
    /// liver".
    pub fn beside<'a>(&self, tokens: &'a [String]) -> Option<&'a [String]> {
        let thing = match tokens {
            [first, thing @ ..] if self.prepositions.contains(first) => thing,
            [side, of, thing @ ..] if self.sides.contains(side) && of == "of" => thing,
            _ => return None,
        };
        (!thing.is_empty()).then_some(thing)
    }

    /// Takes words apart.
    pub fn phrase(&self, words: &str) -> Phrase {
        self.phrase_of(text::tokens(words))
    }

    /// Takes a phrase apart that is split already.
    pub fn phrase_of(&self, tokens: Vec<String>) -> Phrase {
        let end = (1..tokens.len()).find(|&i| self.prepositions.contains(&tokens[i]));
        let subject = self.bare(&turned(&tokens[..end.unwrap_or(tokens.len())]));
        let bare = self.bare(&turned(&tokens));
        Phrase {
            keys: self.keys(&tokens, &bare, end.is_none()),
            content: self.whole_thing(&bare).to_vec(),
            bare: bare.concat(),
            subject,
            has_more: end.is_some(),
            tokens,
        }
    }

    /// The keys of a phrase; those for the whole of a part only if `may_be_part`.
    fn keys(&self, tokens: &[String], bare: &[String], may_be_part: bool) -> Vec<Key> {
        let without_articles: Vec<_> = without(tokens, &[&self.articles]);
        let joined = without(&turned(tokens), &[&self.joining]);
        let whole = |words: &[String]| {
            let part_alone = words.len() == 1 && self.is_part(&words[0]);
            if may_be_part && !part_alone { self.whole_thing(words).concat() } else { String::new() }
        };
        let all = [
            (tokens.concat(), KeyFit::Exact),
            (without_articles.concat(), KeyFit::Exact),
            (joined.concat(), KeyFit::Loose),
            (whole(&joined), KeyFit::Part),
            (bare.concat(), KeyFit::Loose),
            (whole(bare), KeyFit::Part),
        ];
        let mut keys: Vec<Key> = Vec::new();
        for (text, fit) in all {
            if !text.is_empty() && keys.iter().all(|key| key.text != text) {
                keys.push(Key { text, fit });
            }
        }
        keys
    }

    /// Leaves out neutral and joining words, as long as something remains.
    fn bare(&self, tokens: &[String]) -> Vec<String> {
        let candidates =
            [without(tokens, &[&self.neutral, &self.joining]), without(tokens, &[&self.joining])];
        candidates.into_iter().find(|words| !words.is_empty()).unwrap_or_else(|| tokens.to_vec())
    }

    /// Leaves out words for a place, and words for a part at the end: "inner liver edge" is of the liver.
    fn whole_thing(&self, tokens: &[String]) -> Vec<String> {
        let mut words = without(tokens, &[&self.places]);
        if words.is_empty() {
            words = tokens.to_vec();
        }
        while words.len() > 1 && self.is_part(&words[words.len() - 1]) {
            words.pop();
        }
        words
    }
}

/// The words of a list in their compared form.
pub(super) fn token_set(words: &str) -> HashSet<String> {
    text::tokens(words).into_iter().collect()
}

fn without(tokens: &[String], left_out: &[&HashSet<String>]) -> Vec<String> {
    let kept = tokens.iter().filter(|token| left_out.iter().all(|set| !set.contains(*token)));
    kept.cloned().collect()
}

/// Turns "A of B" into "B A".
fn turned(tokens: &[String]) -> Vec<String> {
    match tokens.iter().position(|token| token == "of") {
        Some(of) => [&tokens[of + 1..], &tokens[..of]].concat(),
        None => tokens.to_vec(),
    }
}
