//! A scene's classes, prepared for being compared with prompts.

use super::{
    grammar::{KeyFit, Phrase},
    spelling::one_mistake,
    vocabulary::{Path, Vocabulary},
};
use std::collections::HashSet;

/// Shortest name that is found in spite of a typing mistake.
const MIN_NAME: usize = 5;

/// A class of a scene.
#[derive(Clone, Debug, PartialEq)]
pub struct ClassWords {
    /// Its name.
    pub name: String,
    /// The unit embedding of its name in the scene's template; empty if it is not known.
    pub embedding: Vec<f32>,
    /// `false` if the class is listed but no training frame has a pixel of it.
    pub is_seen: bool,
}

impl ClassWords {
    /// A class that training frames show.
    pub fn seen(name: &str, embedding: &[f32]) -> Self {
        Self { name: name.to_owned(), embedding: embedding.to_vec(), is_seen: true }
    }

    /// A listed class that no training frame shows.
    pub fn unseen(name: &str) -> Self {
        Self { name: name.to_owned(), embedding: Vec::new(), is_seen: false }
    }
}

/// A class and what its name means.
#[derive(Clone, Debug)]
pub(super) struct Class {
    pub name: String,
    pub key: String,
    pub embedding: Vec<f32>,
    pub is_seen: bool,
    /// The concept of its name, or else of the head noun of its name.
    pub concept: Option<usize>,
    /// The words of content of its name and of its concept's words.
    pub content: HashSet<String>,
}

impl Class {
    /// Prepares a scene's classes.
    pub fn all(vocabulary: &Vocabulary, classes: &[ClassWords]) -> Vec<Self> {
        classes.iter().map(|class| Self::new(vocabulary, class)).collect()
    }

    fn new(vocabulary: &Vocabulary, class: &ClassWords) -> Self {
        let phrase = vocabulary.phrase(&class.name);
        let concept = match vocabulary.look_up(&phrase) {
            Some((concept, Path::Key(KeyFit::Exact | KeyFit::Loose))) => Some(concept),
            _ => vocabulary.head_concept(&phrase, None),
        };
        let listed = concept.map(|concept| &vocabulary.concepts()[concept].contents);
        let content = listed.into_iter().flatten().chain([&phrase.content]).flatten().cloned().collect();
        Self {
            name: class.name.clone(),
            key: phrase.keys.first().map_or_else(String::new, |key| key.text.clone()),
            embedding: class.embedding.clone(),
            is_seen: class.is_seen,
            concept,
            content,
        }
    }

    /// Tests whether two classes are one under two entries.
    pub fn is_same(&self, other: &Self) -> bool {
        self.key == other.key || (self.concept.is_some() && self.concept == other.concept)
    }

    /// Tests whether a phrase is this class's name with a typing mistake after its first letter.
    pub fn is_misspelt_as(&self, phrase: &Phrase) -> bool {
        let (name, typed) = (&self.key, &phrase.bare);
        name.len().min(typed.len()) >= MIN_NAME
            && name.chars().next() == typed.chars().next()
            && one_mistake(name, typed)
    }
}
