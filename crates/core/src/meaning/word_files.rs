//! The two files that the vocabulary is made of.

use crate::{Error, Result};
use serde::{Deserialize, de::DeserializeOwned};
use std::collections::BTreeMap;

/// Words that the built-in text encoder knows, and English that it keeps away from them.
pub(super) const LEXICON: &str = include_str!("../../../../assets/text_encoder/lexicon.toml");
/// Further concepts, and the words that do not name a thing.
pub(super) const BANK: &str = include_str!("../../../../assets/words/bank.toml");

/// Group, name, other words for the same.
pub(super) type Groups = BTreeMap<String, BTreeMap<String, Vec<String>>>;

/// The sections of the lexicon that are used here.
#[derive(Default, Deserialize)]
#[serde(default)]
pub(super) struct Lexicon {
    pub concepts: Groups,
    /// The left one is a kind or part of the right one.
    pub near: BTreeMap<String, String>,
    pub neutral: Neutral,
    pub other: Other,
}

#[derive(Default, Deserialize)]
#[serde(default)]
pub(super) struct Neutral {
    pub words: Vec<String>,
}

/// Words that have nothing to do with surgery.
#[derive(Default, Deserialize)]
#[serde(default)]
pub(super) struct Other {
    pub words: String,
    pub held_out: String,
}

/// The bank of words; the file explains its sections.
#[derive(Default, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(super) struct Bank {
    pub concepts: Groups,
    pub grammar: GrammarLists,
    pub everyday: Everyday,
    pub real_words: RealWords,
}

#[derive(Default, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(super) struct GrammarLists {
    pub articles: String,
    pub joining: String,
    pub prepositions: String,
    pub sides: String,
    pub negations: String,
    pub parts: String,
    pub places: String,
    pub generic: Vec<String>,
}

#[derive(Default, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(super) struct Everyday {
    pub groups: Vec<String>,
    pub words: String,
}

#[derive(Default, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(super) struct RealWords {
    pub words: String,
}

/// Reads one of the files.
pub(super) fn parse<T: DeserializeOwned>(text: &str) -> Result<T> {
    let wrong = |e: toml::de::Error| Error::input(format!("a list of words is malformed: {e}"), "");
    toml::from_str(text).map_err(wrong)
}
