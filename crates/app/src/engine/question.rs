//! Questions: words or samples to look for, and everything that they are compared with.

use std::hash::{Hash, Hasher};
use surgtpgs_core::relevancy::RelevancySettings;

/// Words or a sample to look for, with everything they are compared with. Together they decide the scores.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Question {
    /// The words; spaces around them do not count.
    pub text: String,
    /// Sample of a pixel to look for instead of the words, which are then its name.
    pub like: Option<Sample>,
    /// Everything else that a pixel is compared with.
    pub negatives: Negatives,
    /// `true` to look for the class that is most like the words, if they mean none.
    pub shows_nearest: bool,
}

/// Everything that a prompt is compared with.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Negatives {
    /// Generic phrases, and other words that the prompt is not, encoded without the template.
    pub phrases: Vec<String>,
    /// Samples of pixels that the prompt is not, with their names.
    pub samples: Vec<(String, Sample)>,
    /// `true` to ask what the words mean, and to compare with everything that means something else.
    pub uses_classes: bool,
}

/// Sample of a pixel: its feature, decoded.
#[derive(Clone, Debug, serde::Serialize, serde::Deserialize)]
pub struct Sample {
    /// Unit vector of finite values.
    pub(super) embedding: Vec<f32>,
    /// SHA-256 of the text encoder whose space the embedding is in, hexadecimal; empty if that is not known.
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
    /// Creates a question that looks for words.
    pub fn words(text: impl Into<String>, negatives: Negatives) -> Self {
        Self { text: text.into(), like: None, negatives, shows_nearest: false }
    }
}

impl Negatives {
    /// Returns the negatives that settings give to every prompt.
    pub fn of(settings: &RelevancySettings) -> Self {
        let (phrases, uses_classes) = (settings.phrases.clone(), settings.class_negatives);
        Self { phrases, samples: Vec::new(), uses_classes }
    }

    /// Adds the phrases of `more` that are not there yet; upper and lower case are the same.
    pub fn with<'a>(mut self, more: impl IntoIterator<Item = &'a String>) -> Self {
        for text in more {
            if !self.phrases.iter().any(|p| p.eq_ignore_ascii_case(text)) {
                self.phrases.push(text.clone());
            }
        }
        self
    }
}
