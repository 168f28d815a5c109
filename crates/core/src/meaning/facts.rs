//! Facts about the words of a scene that are known from its preparation.

use super::Calibration;
use half::f16;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// Facts about words, found when a recording was prepared and kept in the scene file.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct WordFacts {
    /// Names of listed classes that no training frame shows.
    pub unseen: Vec<String>,
    /// `true` if the classes are the names of marks by hand: there may be more that nobody marked.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub from_marks: bool,
    /// Measure of how far the text encoder tells words apart; `None` if that was not measured.
    pub calibration: Option<Calibration>,
    /// Vectors of the vocabulary's texts ([`super::Space::texts`]), one after the other, so that no other
    /// computer has to encode them; empty if they are not known. Files keep them beside the other facts.
    #[serde(skip)]
    pub vectors: Arc<Vec<f16>>,
}

impl WordFacts {
    /// Returns `true` if nothing is known.
    pub fn is_empty(&self) -> bool {
        *self == Self::default()
    }

    /// Returns the facts for records that people read: without the vector of the encoder's space.
    pub fn summary(&self) -> serde_json::Value {
        let Some(calibration) = &self.calibration else {
            return serde_json::json!({ "unseen_classes": self.unseen });
        };
        serde_json::json!({
            "unseen_classes": self.unseen,
            "vocabulary_sha256": calibration.vocabulary,
            "fit": calibration.fit,
            "floors": calibration.floors,
        })
    }
}
