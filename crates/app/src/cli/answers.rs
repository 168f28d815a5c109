//! Answers to prompts, frame by frame.

use super::console::ProgressView;
use crate::engine::Engine;
use std::path::PathBuf;
use surgtpgs_core::{Result, mask::Region, object::seen_area, raster::MIN_DEPTH_ALPHA};

/// Answers to all prompts, as they are reported in JSON; the keys are a contract.
#[derive(serde::Serialize, serde::Deserialize)]
pub(super) struct Answers {
    pub(super) prompts: Vec<PromptAnswers>,
    pub(super) threshold: f32,
    pub(super) relevancy: String,
    pub(super) renderer: String,
}

/// Answers to one prompt.
#[derive(serde::Serialize, serde::Deserialize)]
pub(super) struct PromptAnswers {
    pub(super) text: String,
    pub(super) frames: Vec<FrameAnswer>,
    /// Gaussians that the prompt found, if asked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) gaussians: Option<FoundGaussians>,
}

/// Object that a prompt found, in three dimensions.
#[derive(serde::Serialize, serde::Deserialize)]
pub(super) struct FoundGaussians {
    /// Frame at whose time the Gaussians were found and written.
    pub(super) frame: usize,
    pub(super) count: usize,
    pub(super) file: PathBuf,
}

/// Answer to one prompt on one frame: if it was found, and how much of it.
#[derive(serde::Serialize, serde::Deserialize)]
pub(super) struct FrameAnswer {
    pub(super) frame: usize,
    pub(super) found: bool,
    pub(super) area_px: usize,
    pub(super) area_fraction: f64,
    pub(super) max_score: f32,
    /// Area of the found pixels at their depth, facing the camera, in scene units².
    pub(super) seen_area: f64,
    /// File name of the recorded frame, where known.
    #[serde(default)]
    pub(super) source: Option<String>,
}

impl PromptAnswers {
    pub(super) fn frames_found(&self) -> usize {
        self.frames.iter().filter(|f| f.found).count()
    }

    pub(super) fn max_score(&self) -> f32 {
        self.frames.iter().map(|f| f.max_score).fold(0.0, f32::max)
    }

    /// Returns the frame where the prompt covers most; `None` if it is never found.
    pub(super) fn largest(&self) -> Option<&FrameAnswer> {
        self.frames.iter().filter(|f| f.found).max_by_key(|f| f.area_px)
    }
}

/// Asks the engine's prompts on `frames`.
pub(super) fn ask(engine: &mut Engine, frames: &[usize]) -> Result<Answers> {
    let mut prompts: Vec<PromptAnswers> = engine
        .queries()
        .iter()
        .map(|q| PromptAnswers {
            text: q.prompt.clone(),
            frames: Vec::with_capacity(frames.len()),
            gaussians: None,
        })
        .collect();
    let sources = engine.frame_sources();
    let mut view = ProgressView::default();
    for (done, &frame) in frames.iter().enumerate() {
        let at = engine.view(frame)?;
        let images = engine.render(&at, true)?;
        let scores = engine.scores(&images, &at)?;
        let masks = engine.masks(&scores);
        let depth = images.normalised_depth(MIN_DEPTH_ALPHA);
        for ((prompt, scores), mask) in prompts.iter_mut().zip(&scores).zip(&masks) {
            let region = Region::of(scores, mask);
            prompt.frames.push(FrameAnswer {
                frame,
                found: region.area_px > 0,
                area_px: region.area_px,
                area_fraction: region.area_fraction,
                max_score: region.max_score,
                seen_area: seen_area(mask, &depth, &at.camera),
                source: sources.get(frame).cloned(),
            });
        }
        view.count("asking", done + 1, frames.len());
    }
    Ok(Answers {
        prompts,
        threshold: engine.settings().threshold,
        relevancy: engine.relevancy_name().into(),
        renderer: engine.renderer_name(),
    })
}
