//! Options of an export.

use super::format::Format;
use crate::{mask::CleanUp, overlay::OverlayLook};

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
    /// Style of the overlays.
    #[serde(flatten)]
    pub look: OverlayLook,
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
            look: OverlayLook::default(),
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
}
