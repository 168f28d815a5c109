//! Requests for pictures, and the pictures that answer them.

use crate::engine::{Answer, Question, Sample};
use crate::viewer::{
    backend::FrameView,
    picture::{difference::Difference, found::Found},
    state::{content::PromptId, marks::MarkList, view_mode::Layer},
};
use egui::ColorImage;
use std::sync::Arc;
use surgtpgs_core::{grid::Grid, mask::CleanUp, overlay::OverlayLook, strokes::Outline};

/// A prompt that is to be looked for.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct AskedPrompt {
    pub(crate) id: PromptId,
    pub(crate) question: Question,
    pub(crate) threshold: f32,
    pub(crate) colour: [u8; 3],
    /// `true` if the prompt's masks lie over those of other prompts.
    pub(crate) is_instrument: bool,
}

/// A picture that the window wants to show.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Request {
    pub(crate) view: FrameView,
    /// Number of the last jump before it, which tells pictures from before a jump from those behind it.
    pub(crate) jump: u64,
    pub(crate) needs_original: bool,
    pub(crate) needs_reconstruction: bool,
    /// Layer of values to show as colours.
    pub(crate) layer: Option<Layer>,
    pub(crate) needs_difference: bool,
    /// `true` if depth is wanted though it is not drawn, to measure with and to turn the view around a point.
    /// It is made where it was measured.
    pub(crate) needs_depth: bool,
    pub(crate) prompts: Vec<AskedPrompt>,
    /// Questions whose scores are wanted without being drawn.
    pub(crate) candidates: Vec<Question>,
    /// Style of the overlay.
    pub(crate) look: OverlayLook,
    /// Clean-up of masks.
    pub(crate) clean_up: CleanUp,
    /// Point that is probed, as share of width and height.
    pub(crate) point: Option<[f32; 2]>,
    /// Marks by hand that prompts can find.
    pub(crate) marks: MarkList,
    /// `true` if a word is being typed: its next letter is likely to come before another frame.
    pub(crate) is_typing: bool,
}

impl Request {
    /// Returns the clean-up for masks of this view's size.
    pub(crate) fn clean_up(&self) -> CleanUp {
        if self.view.is_preview { self.clean_up.at_size(0.5) } else { self.clean_up }
    }

    /// Returns `true` if nothing is to be rendered but depth that is not drawn.
    pub(crate) fn wants_depth_alone(&self) -> bool {
        let is_drawn = self.needs_reconstruction || self.layer.is_some();
        self.needs_depth && !is_drawn && self.prompts.is_empty() && self.candidates.is_empty()
    }

    /// Returns all questions of the request, prompts first.
    pub(crate) fn questions(&self) -> Vec<Question> {
        self.prompts.iter().map(|p| &p.question).chain(&self.candidates).cloned().collect()
    }
}

/// A picture without and with what was found drawn over it. All of it is of one frame.
#[derive(Clone, Debug)]
pub(crate) struct Pane {
    pub(crate) bare: Arc<ColorImage>,
    /// The picture with fills or a heatmap, if there are any. Lines are [`Outlines`].
    pub(crate) marked: Option<Arc<ColorImage>>,
}

/// Lines around everything found. They have no width yet, which does not depend on the zoom.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Outlines {
    pub(crate) lines: Vec<Outline>,
    /// Columns and rows of the scores, in whose pixels the lines are given.
    pub(crate) size: (usize, usize),
    pub(crate) opacity: f32,
}

/// A layer of values as colours, with their meaning.
#[derive(Clone, Debug)]
pub(crate) struct LayerPane {
    pub(crate) layer: Layer,
    pub(crate) image: Arc<ColorImage>,
    /// Values at both ends of the colour scale, in the layer's unit.
    pub(crate) range: (f32, f32),
    /// Summary of the whole layer in words; may be empty.
    pub(crate) note: String,
}

/// The answer to a [`Request`].
#[derive(Clone, Debug)]
pub(crate) struct Picture {
    pub(crate) request: Request,
    pub(crate) original: Option<Pane>,
    pub(crate) reconstruction: Option<Pane>,
    pub(crate) layer: Option<LayerPane>,
    pub(crate) difference: Option<Difference>,
    pub(crate) outlines: Arc<Outlines>,
    /// Depth of every pixel, scene units; 0 where unknown.
    pub(crate) depth_values: Option<Arc<Grid<f32>>>,
    pub(crate) findings: Vec<Finding>,
    /// Scores of those [`Request::candidates`] that have any.
    pub(crate) candidates: Vec<(String, Arc<Grid<f32>>)>,
    /// Sample of [`Request::point`]; `None` where nothing was reconstructed.
    pub(crate) sample: Option<Sample>,
    /// Share of the picture that is faded because the endoscope did not see it, 0–1.
    pub(crate) unseen_share: f32,
    /// Description of a failure, for the user.
    pub(crate) problem: Option<String>,
    /// `true` if a request for something else came before it was made.
    pub(crate) is_left_off: bool,
    /// Duration of making the picture, milliseconds.
    pub(crate) took_ms: f64,
    /// Number of passes of a frame that had to run for the picture.
    pub(crate) passes_run: usize,
    /// Name of the machine that made it, e.g. "CPU, 2 threads"; empty if nothing is rendered.
    pub(crate) renderer: String,
}

/// Result of a prompt in this view.
#[derive(Clone, Debug)]
pub(crate) struct Finding {
    pub(crate) id: PromptId,
    pub(crate) text: String,
    /// Answer to the prompt, whatever the view; `None` where that is not known.
    pub(crate) answer: Option<Answer>,
    /// Everything found, or the reason why the question could not be asked.
    pub(crate) outcome: Result<Found, String>,
}

impl Finding {
    /// Returns the class that is drawn in the prompt's stead, because it is most like its words.
    pub(crate) fn stand_in(&self, prompt: &AskedPrompt) -> Option<&str> {
        let nearest = self.answer.as_ref()?.nearest.as_deref();
        nearest.filter(|_| prompt.question.shows_nearest)
    }
}
