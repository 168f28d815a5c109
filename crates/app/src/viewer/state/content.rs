//! The user's decisions about a recording, as a session saves them.

use crate::engine::{Negatives, Sample};
use crate::viewer::{
    backend::{orbit::Orbit, ranges},
    state::{
        clean_up,
        marks::MarkList,
        measure::Scale,
        phases::{self, Phase},
        zoom::Zoom,
    },
};
use serde_json::{Map, Value};
use surgtpgs_core::{mask::CleanUp, relevancy::RelevancySettings};

/// Identifier of a prompt, valid for its lifetime.
pub(crate) type PromptId = u64;

/// Identifier of the prompt that is being typed and not yet added.
pub(crate) const PREVIEW: PromptId = 0;

/// Something to look for.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub(crate) struct Prompt {
    #[serde(skip)]
    pub(crate) id: PromptId,
    pub(crate) text: String,
    /// Colour that stays the same when other prompts are deleted.
    pub(crate) colour: [u8; 3],
    pub(crate) is_visible: bool,
    /// `true` if the prompt's masks lie over those of other prompts.
    #[serde(default)]
    pub(crate) is_instrument: bool,
    /// Score above which a pixel is found; a whole number of hundredths.
    pub(crate) threshold: f32,
    /// Phrases that the prompt is compared with, besides those for all prompts.
    #[serde(default)]
    pub(crate) but_not: Vec<String>,
    /// Sample of a picture to look for, instead of the words.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) like: Option<Sample>,
    /// `true` to draw the class that is most like the words, if they mean none.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub(crate) shows_nearest: bool,
    /// Samples of pictures that are not meant.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub(crate) not_like: Vec<NamedSample>,
    /// Fields that a newer program wrote.
    #[serde(flatten)]
    pub(crate) unknown: Map<String, Value>,
}

/// Sample of a picture, with a name that tells its point.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub(crate) struct NamedSample {
    pub(crate) name: String,
    pub(crate) sample: Sample,
}

/// Everything that can be undone.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(default)]
pub(crate) struct Content {
    pub(crate) prompts: Vec<Prompt>,
    /// Bookmarks in the order of their frames, at most one per frame.
    pub(crate) bookmarks: Vec<Bookmark>,
    /// Phases of the operation, in order; none overlap.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub(crate) phases: Vec<Phase>,
    /// First and last frame of the part that plays.
    pub(crate) range: Option<(usize, usize)>,
    /// Phrases and classes that all prompts are compared with.
    pub(crate) comparison: Comparison,
    /// Scale that converts scene units to millimetres.
    pub(crate) scale: Option<Scale>,
    /// Clean-up of masks.
    pub(crate) clean_up: CleanUp,
    /// First and last frame of each range that is left out of everything, in order.
    pub(crate) excluded: Vec<(usize, usize)>,
    /// Marks by hand.
    #[serde(skip_serializing_if = "MarkList::holds_nothing")]
    pub(crate) marks: MarkList,
    /// Fields that a newer program wrote.
    #[serde(flatten)]
    pub(crate) unknown: Map<String, Value>,
}

/// Viewpoint and magnification of the picture.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(default)]
pub(crate) struct Look {
    pub(crate) orbit: Orbit,
    pub(crate) zoom: Zoom,
}

/// A frame to come back to.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
pub(crate) struct Bookmark {
    /// Index of the frame, from 0.
    pub(crate) frame: usize,
    #[serde(default)]
    pub(crate) note: String,
    /// `true` if the frame needs another look.
    #[serde(default)]
    pub(crate) is_flagged: bool,
    /// Colour of its own.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) colour: Option<[u8; 3]>,
    /// Fields that a newer program wrote.
    #[serde(flatten)]
    pub(crate) unknown: Map<String, Value>,
}

/// A generic phrase, which can be switched off for a while to see its effect.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub(crate) struct Phrase {
    pub(crate) text: String,
    pub(crate) is_on: bool,
}

/// Phrases and classes that all prompts are compared with.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(default)]
pub(crate) struct Comparison {
    pub(crate) phrases: Vec<Phrase>,
    pub(crate) uses_classes: bool,
}

impl Default for Comparison {
    fn default() -> Self {
        Self::of(&RelevancySettings::default())
    }
}

impl Comparison {
    /// The comparison that settings ask for.
    pub(crate) fn of(settings: &RelevancySettings) -> Self {
        let phrase = |text: &String| Phrase { text: text.clone(), is_on: true };
        Self {
            phrases: settings.phrases.iter().map(phrase).collect(),
            uses_classes: settings.class_negatives,
        }
    }

    /// Returns the negatives of a prompt without exceptions of its own.
    pub(crate) fn common(&self) -> Negatives {
        let on = self.phrases.iter().filter(|p| p.is_on).map(|p| &p.text);
        let none = Negatives { phrases: Vec::new(), samples: Vec::new(), uses_classes: self.uses_classes };
        none.with(on)
    }
}

impl Look {
    /// Limits the look to what is possible, because files may hold any values.
    pub(crate) fn mended(self, max_degrees: f32) -> Self {
        Self { orbit: self.orbit.mended(max_degrees), zoom: self.zoom.mended() }
    }
}

impl Content {
    /// Returns `true` if both hold the same decisions. Ids of prompts do not count, because they differ
    /// between windows.
    pub(crate) fn is_alike(&self, other: &Self) -> bool {
        let anonymous = |content: &Self| {
            let mut content = content.clone();
            content.prompts.iter_mut().for_each(|p| p.id = PREVIEW);
            content
        };
        anonymous(self) == anonymous(other)
    }

    /// Drops a scale of the space, which means nothing where the shape is guessed.
    pub(crate) fn without_scale_in_space(self) -> Self {
        let scale = self.scale.filter(|scale| scale.px_per_mm.is_some());
        Self { scale, ..self }
    }

    /// Limits the content to what is possible for `num_frames` frames, because files may hold any values.
    pub(crate) fn mended(mut self, num_frames: usize) -> Self {
        self.prompts.retain(|p| !p.text.trim().is_empty());
        self.prompts.iter_mut().for_each(|p| p.threshold = hundredths(p.threshold));
        self.bookmarks.retain(|b| b.frame < num_frames);
        self.bookmarks.sort_by_key(|b| b.frame);
        self.bookmarks.dedup_by_key(|b| b.frame);
        self.scale = self.scale.filter(Scale::is_possible);
        self.clean_up = clean_up::mended(self.clean_up);
        self.excluded = ranges::mended(self.excluded, num_frames);
        self.phases = phases::mended(self.phases, num_frames);
        self.range = self.range.filter(|(from, to)| from <= to && *to < num_frames);
        self
    }
}

/// Rounds to the nearest whole hundredth of 0–1. Not a number becomes 1: nothing is found rather than
/// everything.
pub(crate) fn hundredths(threshold: f32) -> f32 {
    if threshold.is_nan() { 1.0 } else { (threshold.clamp(0.0, 1.0) * 100.0).round() / 100.0 }
}
