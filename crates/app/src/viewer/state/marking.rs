//! The tool that marks are made with.

use crate::viewer::state::content::PromptId;
use surgtpgs_core::{
    marks::{Mark, is_name},
    sequence::plain_words,
};

/// Least and largest radius of clicks and strokes, px of the recording.
pub(crate) const RADII_PX: [f32; 2] = [1.0, 60.0];

/// Way of marking.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) enum Tool {
    #[default]
    Brush,
    Click,
    Outline,
    Box,
}

impl Tool {
    pub(crate) const ALL: [Self; 4] = [Self::Brush, Self::Click, Self::Outline, Self::Box];

    /// Returns its name, and how it is used.
    pub(crate) fn label(self) -> (&'static str, &'static str) {
        match self {
            Self::Brush => ("Brush", "Draw along the structure"),
            Self::Click => ("Click", "Click on points of the structure"),
            Self::Outline => {
                ("Outline", "Draw around the structure, or click on its corners; a double click closes")
            }
            Self::Box => ("Box", "Drag from corner to corner"),
        }
    }

    /// Returns `true` if it points at an object, whose mask a network can find.
    pub(crate) fn points(self) -> bool {
        matches!(self, Self::Click | Self::Box)
    }

    pub(crate) fn has_radius(self) -> bool {
        matches!(self, Self::Brush | Self::Click)
    }
}

/// State of the tool.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Marking {
    /// `true` while the tool has the mouse.
    pub(crate) is_on: bool,
    pub(crate) tool: Tool,
    /// `true` to mark what is the structure, `false` for what is not.
    pub(crate) adds: bool,
    /// Name of the structure, as it is typed.
    pub(crate) name: String,
    /// `true` if the field of the name is to be seen and to have the focus, with its text selected.
    pub(crate) wants_name: bool,
    /// `true` if the tool was just taken in hand, and its controls are to be seen.
    pub(crate) is_just_taken: bool,
    pub(crate) radius_px: f32,
    /// Prompt that was selected when the tool was put away.
    pub(crate) put_away_at: Option<PromptId>,
    /// Mark that is being drawn.
    pub(crate) draft: Option<Draft>,
}

/// A mark that is being drawn.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Draft {
    pub(crate) mark: Mark,
    /// `true` if it marks something already.
    pub(crate) fits: bool,
}

impl Default for Marking {
    fn default() -> Self {
        Self {
            is_on: false,
            tool: Tool::default(),
            adds: true,
            name: String::new(),
            wants_name: false,
            is_just_taken: false,
            radius_px: 8.0,
            put_away_at: None,
            draft: None,
        }
    }
}

impl Marking {
    /// Returns the mark that is being drawn on a frame.
    pub(crate) fn draft_on(&self, frame: usize) -> Option<&Draft> {
        self.draft.as_ref().filter(|draft| draft.mark.frame == frame)
    }

    /// Returns the name of the structure in plain words; empty before there is one.
    pub(crate) fn plain_name(&self) -> String {
        let words = plain_words(self.name.trim());
        if is_name(&words) { words } else { String::new() }
    }
}
