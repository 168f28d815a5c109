//! The lexicon file, and the endless stream of examples drawn from it.

use crate::text;
use rand::{Rng, seq::IndexedRandom};
use rand_chacha::ChaCha8Rng;
use std::collections::{BTreeMap, BTreeSet};

/// Contents of `lexicon.toml`; the file explains its parts.
#[derive(serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Lexicon {
    /// Words by concept by group.
    pub concepts: BTreeMap<String, BTreeMap<String, Vec<String>>>,
    /// Concepts that are kinds or parts of another.
    pub near: BTreeMap<String, String>,
    /// Words that only tests see, by concept.
    pub held_out: BTreeMap<String, Vec<String>>,
    /// Words without meaning for a prompt.
    pub neutral: Neutral,
    /// Words that belong to no concept.
    pub other: Other,
}

/// Words and templates that do not change a prompt's meaning.
#[derive(serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Neutral {
    /// Words before a prompt.
    pub words: Vec<String>,
    /// Sentences with `{}`.
    pub templates: Vec<String>,
}

/// Words that belong to no concept, separated by white space.
#[derive(serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Other {
    /// Words for the training.
    pub words: String,
    /// Words for the tests.
    pub held_out: String,
}

impl Lexicon {
    /// Reads the file's text and refuses contradictions.
    pub fn parse(text: &str) -> Result<Self, String> {
        let lexicon: Self = toml::from_str(text).map_err(|e| e.to_string())?;
        let mut owner = BTreeMap::new();
        for (concept, phrase) in lexicon.phrases() {
            if let Some(other) = owner.insert(phrase, concept).filter(|other| *other != concept) {
                return Err(format!("\"{phrase}\" stands for \"{concept}\" and for \"{other}\""));
            }
        }
        for word in lexicon.other.words.split_whitespace().chain(lexicon.other.held_out.split_whitespace()) {
            if let Some(concept) = owner.get(word) {
                return Err(format!("\"{word}\" stands for \"{concept}\" and is listed as other English"));
            }
        }
        let named = lexicon.near.iter().flat_map(|(a, b)| [a, b]).chain(lexicon.held_out.keys());
        for name in named {
            if !lexicon.concepts.values().any(|group| group.contains_key(name)) {
                return Err(format!("\"{name}\" is not a concept"));
            }
        }
        Ok(lexicon)
    }

    /// Every phrase with its concept, the concept's own name first.
    pub fn phrases(&self) -> impl Iterator<Item = (&str, &str)> {
        let concepts = self.concepts.values().flatten().filter(|(name, _)| *name != "canonical");
        concepts.flat_map(|(name, words)| {
            std::iter::once(name).chain(words).map(move |phrase| (name.as_str(), phrase.as_str()))
        })
    }
}

/// Meaning of an example.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Meaning {
    /// Index into [`Examples::concepts`].
    Concept(usize),
    /// A word outside of the lexicon, with the text that tells it from other unknown ones.
    Unknown(String),
}

/// Draws texts and their meanings.
pub struct Examples {
    /// Names of the concepts, sorted.
    pub concepts: Vec<String>,
    phrases: Vec<Vec<String>>,
    other: Vec<String>,
    known_words: BTreeSet<String>,
    /// Trigrams of each phrase and of each word of a phrase.
    known_trigrams: Vec<Vec<usize>>,
    neutral: Vec<String>,
    templates: Vec<String>,
}

impl Examples {
    /// Prepares the lists.
    pub fn new(lexicon: &Lexicon) -> Self {
        let mut by_concept: BTreeMap<&str, BTreeSet<String>> = BTreeMap::new();
        for (concept, phrase) in lexicon.phrases() {
            by_concept.entry(concept).or_default().extend(spellings(phrase));
        }
        let other: Vec<String> = lexicon.other.words.split_whitespace().map(String::from).collect();
        let of_phrases =
            |phrase: &String| phrase.split(' ').chain([phrase.as_str()]).map(String::from).collect();
        let phrase_words: BTreeSet<String> =
            by_concept.values().flatten().flat_map::<Vec<_>, _>(of_phrases).collect();
        Self {
            known_trigrams: phrase_words.iter().map(|word| text::trigrams(word).collect()).collect(),
            known_words: phrase_words.into_iter().chain(other.iter().cloned()).collect(),
            concepts: by_concept.keys().map(|name| (*name).to_owned()).collect(),
            phrases: by_concept.into_values().map(|set| set.into_iter().collect()).collect(),
            other,
            neutral: lexicon.neutral.words.clone(),
            templates: lexicon.neutral.templates.clone(),
        }
    }

    /// All texts whose trigrams get table rows of their own.
    pub fn texts(&self) -> impl Iterator<Item = &str> {
        let lists = self.phrases.iter().chain([&self.neutral, &self.templates]);
        lists.flatten().map(String::as_str)
    }

    /// Draws one text and its meaning.
    pub fn draw(&self, rng: &mut ChaCha8Rng) -> (String, Meaning) {
        if rng.random_bool(0.6) {
            let concept = rng.random_range(0..self.concepts.len());
            // Class names come more often than their synonyms, because the features of pixels are made
            // from them.
            let is_name = rng.random_bool(0.2);
            let phrase = if is_name { &self.concepts[concept] } else { pick(&self.phrases[concept], rng) };
            let text = if rng.random_bool(0.3) { self.mistype(phrase, rng) } else { phrase.to_owned() };
            (self.decorate(&text, rng), Meaning::Concept(concept))
        } else {
            let text = self.draw_unknown(rng);
            (self.decorate(&text, rng), Meaning::Unknown(text))
        }
    }

    /// Draws a text outside of the lexicon: other English, random letters, or a word that only resembles
    /// a known one.
    fn draw_unknown(&self, rng: &mut ChaCha8Rng) -> String {
        loop {
            let other = pick(&self.other, rng);
            let concept = self.phrases.choose(rng).map_or("", |phrases| pick(phrases, rng)).replace(' ', "");
            let (text, is_made_up) = match rng.random_range(0..20) {
                0..9 => (other.to_owned(), false),
                9..11 => (format!("{other} {}", pick(&self.other, rng)), false),
                11..13 => (splice(other, pick(&self.other, rng), rng), true),
                13..15 => (splice(other, &concept, rng), true),
                15..17 => (splice(&concept, other, rng), true),
                // Typing mistakes seldom hit the first letter. Another first letter makes another word
                // (suction, auction).
                17 => (
                    format!(
                        "{}{}",
                        char::from(rng.random_range(b'a'..=b'z')),
                        &concept[1.min(concept.len())..]
                    ),
                    false,
                ),
                18 => (pick(&self.neutral, rng).to_owned(), false),
                _ => (
                    (0..rng.random_range(2..12)).map(|_| char::from(rng.random_range(b'a'..=b'z'))).collect(),
                    true,
                ),
            };
            let is_taken = self.is_known(&text) || is_made_up && self.is_like_known(&text);
            if !is_taken {
                return text;
            }
        }
    }

    fn is_known(&self, text: &str) -> bool {
        self.phrases.iter().any(|phrases| phrases.iter().any(|phrase| phrase == text))
    }

    /// Returns `true` if a text shares most of its trigrams with a known word, as a mistyped word does.
    fn is_like_known(&self, text: &str) -> bool {
        let own: Vec<usize> = text::trigrams(text).collect();
        self.known_trigrams.iter().any(|known| {
            let shared = own.iter().filter(|code| known.contains(code)).count();
            shared * 5 >= own.len().max(known.len()) * 3
        })
    }

    /// Puts a text into a template, often with neutral words before it.
    fn decorate(&self, text: &str, rng: &mut ChaCha8Rng) -> String {
        let mut text = text.to_owned();
        while rng.random_bool(0.2) {
            text = format!("{} {text}", pick(&self.neutral, rng));
        }
        match rng.random_range(0..10) {
            0..4 => text,
            4..7 => self.templates[0].replace("{}", &text),
            _ => pick(&self.templates, rng).replace("{}", &text),
        }
    }

    /// Makes one typing mistake in one longer word, unless the result is another known word.
    fn mistype(&self, phrase: &str, rng: &mut ChaCha8Rng) -> String {
        let mut words: Vec<String> = phrase.split(' ').map(String::from).collect();
        let long: Vec<usize> = (0..words.len()).filter(|i| words[*i].len() >= 5).collect();
        let Some(&chosen) = long.choose(rng) else { return phrase.to_owned() };
        let mut letters = words[chosen].clone().into_bytes();
        // The first letter stays. In short words only a letter is doubled: any other mistake may make
        // another word.
        let at = rng.random_range(2..letters.len());
        match rng.random_range(0..4) {
            _ if letters.len() < 6 => letters.insert(at, letters[at - 1]),
            0 => drop(letters.remove(at - 1)),
            1 => letters.insert(at, letters[at - 1]),
            2 => letters.swap(at - 1, at),
            _ => letters[at] = rng.random_range(b'a'..=b'z'),
        }
        let mistyped = String::from_utf8_lossy(&letters).into_owned();
        if self.known_words.contains(&mistyped) {
            return phrase.to_owned();
        }
        words[chosen] = mistyped;
        words.join(" ")
    }
}

fn pick<'a>(list: &'a [String], rng: &mut ChaCha8Rng) -> &'a str {
    list.choose(rng).map_or("", String::as_str)
}

/// Joins the beginning of one word and the end of another: pronounceable, but without meaning.
fn splice(first: &str, second: &str, rng: &mut ChaCha8Rng) -> String {
    let head = rng.random_range(2..=first.len().max(2)).min(first.len());
    let tail = rng.random_range(1..=5.min(second.len()).max(1)).min(second.len());
    format!("{}{}", &first[..head], &second[second.len() - tail..])
}

/// A phrase and its plural, and both of them written as one word.
fn spellings(phrase: &str) -> Vec<String> {
    let plural = match phrase {
        p if p.ends_with('s') || p.len() < 4 => p.to_owned(),
        p if p.ends_with('y') && !p.ends_with("ey") => format!("{}ies", &p[..p.len() - 1]),
        p => format!("{p}s"),
    };
    let mut all = vec![phrase.to_owned(), plural];
    if phrase.matches(' ').count() == 1 {
        all.extend([all[0].replace(' ', ""), all[1].replace(' ', "")]);
    }
    all
}
