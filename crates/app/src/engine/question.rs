//! What is looked for, and what it is compared with.

use std::hash::{Hash, Hasher};
use surgtpgs_core::relevancy::RelevancySettings;

/// What to look for, and what it is compared with: together they decide the scores.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Question {
    /// The words; spaces around them do not count.
    pub text: String,
    /// What a pixel shows, to look for instead of the words, which are its name then.
    pub like: Option<Sample>,
    /// What a pixel is compared with besides.
    pub negatives: Negatives,
}

/// What a prompt is compared with.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Negatives {
    /// Generic phrases and whatever else the prompt is not, encoded without the template.
    pub phrases: Vec<String>,
    /// What pixels show that the prompt is not, with their names.
    pub samples: Vec<(String, Sample)>,
    /// Also the scene's other classes.
    pub uses_classes: bool,
}

/// What a pixel shows: its feature, decoded.
#[derive(Clone, Debug, serde::Serialize, serde::Deserialize)]
pub struct Sample {
    /// Unit vector; finite.
    pub(super) embedding: Vec<f32>,
    /// SHA-256 of the text encoder whose space it is in, hexadecimal; empty where that is not known.
    pub(super) encoder_sha256: String,
}

impl Sample {
    fn bits(&self) -> impl Iterator<Item = u32> {
        self.embedding.iter().map(|v| v.to_bits())
    }
}

impl PartialEq for Sample {
    fn eq(&self, other: &Self) -> bool {
        self.encoder_sha256 == other.encoder_sha256 && self.bits().eq(other.bits())
    }
}

impl Eq for Sample {}

impl Hash for Sample {
    fn hash<H: Hasher>(&self, state: &mut H) {
        self.bits().for_each(|bits| bits.hash(state));
    }
}

impl Question {
    /// Looks for words.
    pub fn words(text: impl Into<String>, negatives: Negatives) -> Self {
        Self { text: text.into(), like: None, negatives }
    }
}

impl Negatives {
    /// Those that settings give to every prompt.
    pub fn of(settings: &RelevancySettings) -> Self {
        let (phrases, uses_classes) = (settings.phrases.clone(), settings.class_negatives);
        Self { phrases, samples: Vec::new(), uses_classes }
    }

    /// With `more`, each of which is there once, however it is written.
    pub fn with<'a>(mut self, more: impl IntoIterator<Item = &'a String>) -> Self {
        for text in more {
            if !self.phrases.iter().any(|p| p.eq_ignore_ascii_case(text)) {
                self.phrases.push(text.clone());
            }
        }
        self
    }
}
