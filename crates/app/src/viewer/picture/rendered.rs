//! Rendered views that are kept.

use crate::engine::Question;
use crate::viewer::{
    backend::{FrameView, Parts, Rendering},
    picture::{
        findings::{PromptScores, Scores},
        marks::{color_image, fade},
    },
};
use egui::ColorImage;
use image::RgbImage;
use std::sync::Arc;
use surgtpgs_core::grid::Grid;

/// A view as it was rendered, with the scores that were asked for in it.
pub(super) struct Rendered {
    pub(super) view: FrameView,
    has_features: bool,
    pub(super) colour: Option<Colour>,
    pub(super) depth: Option<Arc<Grid<f32>>>,
    pub(super) unseen_share: f32,
    pub(super) scores: Vec<PromptScores>,
}

/// A picture, also as it is shown.
pub(super) struct Colour {
    pub(super) image: RgbImage,
    pub(super) bare: Arc<ColorImage>,
}

impl Rendered {
    /// Makes a view of which nothing is rendered yet.
    pub(super) fn of(view: &FrameView) -> Self {
        let (colour, depth, scores) = (None, None, Vec::new());
        Self { view: *view, has_features: false, colour, depth, unseen_share: 0.0, scores }
    }

    /// Returns the parts that were rendered.
    pub(super) fn parts(&self) -> Parts {
        let (colour, depth) = (self.colour.is_some(), self.depth.is_some());
        Parts { features: self.has_features, colour, depth }
    }

    /// Returns `true` if these parts were rendered.
    pub(super) fn has(&self, parts: Parts) -> bool {
        parts.without(self.parts()) == Parts::default()
    }

    /// Adds the parts that were rendered.
    pub(super) fn add(&mut self, Rendering { colour, depth, unseen }: Rendering, parts: Parts) {
        self.has_features |= parts.features;
        self.depth = depth.map(Arc::new).or(self.depth.take());
        if let Some(mut image) = colour {
            if let (Some(depth), Some(unseen)) = (&self.depth, unseen) {
                self.unseen_share = fade(&mut image, depth, &unseen);
            }
            self.colour = Some(Colour { bare: Arc::new(color_image(&image)), image });
        }
    }

    /// Returns those questions that have not been asked for this view yet.
    pub(super) fn new_questions(&self, questions: &[Question]) -> Vec<Question> {
        let mut new: Vec<Question> = Vec::new();
        for question in questions {
            if !new.contains(question) && !self.scores.iter().any(|(q, _)| q == question) {
                new.push(question.clone());
            }
        }
        new
    }

    /// Returns the scores of all `questions`, if all of them have been asked.
    pub(super) fn known(&self, questions: &[Question]) -> Option<Vec<Scores>> {
        let of = |question: &Question| {
            let known = self.scores.iter().find(|(q, _)| q == question);
            known.map(|(_, scores)| scores.clone())
        };
        questions.iter().map(of).collect()
    }

    /// Returns the memory that the view takes, bytes.
    pub(super) fn bytes(&self) -> usize {
        // A picture is kept as RGB and RGBA.
        let colour = self.colour.as_ref().map_or(0, |colour| 7 * colour.image.as_raw().len() / 3);
        let scores = self.scores.iter().filter_map(|(_, scores)| scores.as_ref().ok());
        let values: usize = scores.chain(&self.depth).map(|grid| grid.data.len()).sum();
        colour + size_of::<f32>() * values
    }
}
