//! What carries out a step: the passes of this crate, or their twins on a GPU. Schedule, policy and random numbers are
//! the trainer's, so that both walk through the same decisions.

use super::{
    LossTerms, TrainSettings,
    densify::{Densify, Statistics},
    frames::Frame,
    optimiser::Optimiser,
    pass::Pass,
};
use crate::{
    Result, camera::Camera, clock::PassClock, deform::Deformation, gaussian::Gaussians,
    raster::project::Sampling,
};
use std::sync::Arc;

/// Everything that a step changes.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Model {
    /// At rest.
    pub gaussians: Gaussians,
    /// How they move.
    pub deformation: Deformation,
    /// Moments of all parameters.
    pub optimiser: Optimiser,
    /// Since the last densification.
    pub statistics: Statistics,
}

impl Model {
    /// Zero moments, nothing seen yet.
    pub fn new(gaussians: Gaussians, deformation: Deformation) -> Self {
        Self {
            optimiser: Optimiser::new(&gaussians, &deformation),
            statistics: Statistics::new(gaussians.len()),
            gaussians,
            deformation,
        }
    }
}

/// How a step looks at the scene.
#[derive(Clone, Debug)]
pub struct Look {
    /// Of the frame, or of half its size.
    pub camera: Camera,
    /// 0–1.
    pub time: f32,
    /// Whether the camera is one of half the size.
    pub half: bool,
    /// Which of its pixels are rendered.
    pub sampling: Sampling,
    /// Share of all steps done.
    pub progress: f32,
}

/// One step to be done.
#[derive(Clone, Debug)]
pub struct Plan {
    /// Number of the frame in the recording.
    pub index: usize,
    /// The frame at the size of the camera, all its pixels.
    pub frame: Arc<Frame>,
    /// From where, when, which pixels.
    pub look: Look,
    /// Steps done before.
    pub step: usize,
    /// Whether parameters are updated; statistics are in any case.
    pub updates: bool,
}

/// What is the same for all steps.
#[derive(Clone, Copy, Debug)]
pub struct Context<'a> {
    /// The choices.
    pub settings: &'a TrainSettings,
    /// Table of latent features, [rows][D].
    pub latents: &'a [f32],
    /// Scene units.
    pub typical_depth: f32,
    /// Length of a full-size pixel at the typical depth, scene units.
    pub world_per_px: f32,
}

impl Context<'_> {
    /// What the pull at a splat's centre is multiplied by before it is added to the statistics.
    pub fn pull_scale(&self, look: &Look) -> [f32; 2] {
        if self.settings.densify.threshold > 0.0 {
            [0.5 * look.camera.width as f32, 0.5 * look.camera.height as f32]
        } else if look.half {
            [0.5; 2]
        } else {
            [1.0; 2]
        }
    }

    /// Numbers per Gaussian that are rendered and learned beside the colour.
    pub fn learned_latents(&self, gaussians: &Gaussians) -> usize {
        if self.settings.feature_mode == super::FeatureMode::Lifted { 0 } else { gaussians.latent_dim }
    }
}

/// What is known after a step.
#[derive(Clone, Copy, Debug, Default)]
pub struct Outcome {
    /// Loss of the last step, where it is known by now.
    pub terms: Option<LossTerms<f32>>,
    /// Steps that turned out to be dropped since the last outcome, because something was not finite.
    pub dropped: usize,
}

/// Carries out steps.
pub trait Backend: Send {
    /// What it runs on.
    fn name(&self) -> String;

    /// One optimiser step. The model may be brought up to date as late as in [`Backend::finish`].
    fn step(
        &mut self,
        model: &mut Model,
        plan: Plan,
        context: &Context<'_>,
        clock: &mut PassClock<Pass>,
    ) -> Result<Outcome>;

    /// Adds and removes Gaussians, as [`super::densify`] does.
    fn densify(&mut self, model: &mut Model, how: &Densify, context: &Context<'_>) -> Result<Outcome>;

    /// Gaussians that there are now.
    fn num_gaussians(&self, model: &Model) -> usize;

    /// Brings the model up to date.
    fn finish(&mut self, model: &mut Model, context: &Context<'_>) -> Result<Outcome>;

    /// The model was changed by somebody else after [`Backend::finish`].
    fn forget(&mut self);
}
