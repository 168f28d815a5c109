//! Options of an export.

use super::format::Format;
use crate::{
    grid::Grid,
    mask::CleanUp,
    overlay::{OverlayLook, OverlayPrompt},
};
use std::fmt;

/// Pictures that the masks are applied to.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum PictureSource {
    /// The recorded frames.
    #[default]
    Original,
    /// The frames as the scene renders them.
    Reconstruction,
}

/// Kind of a DICOM segmentation.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SegType {
    /// A mask per prompt and frame.
    #[default]
    Binary,
    /// Scores per prompt and frame, in 255 steps.
    Fractional,
    /// A label picture per frame; a pixel has the best prompt.
    Labelmap,
}

impl SegType {
    /// All kinds.
    pub const ALL: [Self; 3] = [Self::Binary, Self::Fractional, Self::Labelmap];

    /// Returns its name on the command line and in the window.
    pub fn name(self) -> &'static str {
        match self {
            Self::Binary => "binary",
            Self::Fractional => "fractional",
            Self::Labelmap => "labelmap",
        }
    }

    /// Returns an explanation.
    pub fn about(self) -> &'static str {
        match self {
            Self::Binary => "Masks, one per prompt; every viewer of segmentations reads them",
            Self::Fractional => "Scores, as probabilities",
            Self::Labelmap => "One number per pixel; small, but only new viewers read it",
        }
    }
}

/// Options of an export.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(default)]
pub struct ExportOptions {
    /// Formats to write.
    pub formats: Vec<Format>,
    /// Pictures that the masks are applied to. This is only recorded: the caller supplies the pictures.
    pub source: PictureSource,
    /// `true` if a pixel belongs to at most one prompt (the one with the best score).
    pub exclusive: bool,
    /// `true` if pictures with prompts drawn over them say "research use only".
    pub stamp: bool,
    /// `true` if they say which frame they show, at what time, and which prompts were found on it.
    pub captions: bool,
    /// Number of columns of overlays and videos, px; `None` for the size of the recording.
    pub width_px: Option<u32>,
    /// Style of the overlays.
    #[serde(flatten)]
    pub look: OverlayLook,
    /// `true` to write, for words that mean nothing in the recording, the class that is most like them.
    pub nearest: bool,
    /// Kind of DICOM segmentations.
    pub seg_type: SegType,
    /// Clean-up of masks before anything is written. Scores are written without it, apart from
    /// smoothing over time.
    pub clean_up: CleanUp,
}

impl Default for ExportOptions {
    fn default() -> Self {
        Self {
            formats: vec![Format::Cutout, Format::Overlay],
            source: PictureSource::Original,
            exclusive: false,
            stamp: true,
            captions: false,
            width_px: None,
            look: OverlayLook::default(),
            nearest: false,
            seg_type: SegType::default(),
            clean_up: CleanUp::default(),
        }
    }
}

/// One prompt of an export.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct ExportPrompt {
    /// The words as typed.
    pub text: String,
    /// Score above which a pixel is found.
    pub threshold: f32,
    /// Colour in overlays and `labels.json` (sRGB).
    pub colour: [u8; 3],
    /// Phrases that the prompt was compared with.
    pub negatives: Vec<String>,
    /// `true` if its regions lie over those of the other prompts.
    #[serde(default)]
    pub is_instrument: bool,
    /// Probability that the words mean something that the scene knows, 0–1; absent in older records.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub certainty: Option<f32>,
    /// The words that were asked for, if they mean nothing in the recording and this is only the class that is
    /// most like them.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub stands_for: Option<String>,
}

impl ExportPrompt {
    /// The prompt's scores on a frame as they are drawn: dashed if it only stands for other words.
    pub(super) fn drawn<'a>(&self, scores: &'a Grid<f32>) -> OverlayPrompt<'a> {
        let is_dashed = self.stands_for.is_some();
        OverlayPrompt { scores, threshold: self.threshold, colour: self.colour, is_dashed }
    }

    /// The answer on a frame, in the words of tables: `found`, `nearest` or `absent`.
    pub(super) fn answer(&self, is_found: bool) -> &'static str {
        match (is_found, &self.stands_for) {
            (true, None) => "found",
            (true, Some(_)) => "nearest",
            (false, _) => "absent",
        }
    }
}

/// Words that were asked for and of which nothing was written.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct LeftOut {
    /// The words as typed.
    pub text: String,
    /// Class that is most like them, if any is.
    pub nearest: Option<String>,
    /// Reason, in a few words.
    pub why: String,
}

impl fmt::Display for LeftOut {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "nothing was written for \"{}\": {}", self.text, self.why)?;
        match &self.nearest {
            Some(class) => write!(f, "; it looks like {class}"),
            None => Ok(()),
        }
    }
}
