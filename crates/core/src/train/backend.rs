//! Backends that carry out training steps: the passes of this crate, or their twins on a GPU. Schedule,
//! policy and random numbers belong to the trainer, so that all backends follow the same decisions.

use super::{
    LossTerms, LossWeights, TrainSettings, densify::Densify, frames::TrainFrame, model::Model, pass::Pass,
};
use crate::{
    Result,
    camera::{Camera, Twist},
    clock::PassClock,
    deform::Deformation,
    gaussian::Gaussians,
    raster::project::Sampling,
};
use std::sync::Arc;

/// View of the scene in one step.
#[derive(Clone, Debug)]
pub struct StepView {
    /// Camera of the frame, or of half its size.
    pub camera: Camera,
    /// Time, 0–1.
    pub time: f32,
    /// `true` if the camera has half the size.
    pub half: bool,
    /// Choice of the pixels that are rendered.
    pub sampling: Sampling,
    /// Share of all steps done so far.
    pub progress: f32,
}

impl StepView {
    /// Distance of neighbouring pixels, px of the full-size image.
    pub fn spacing_px(&self) -> usize {
        self.sampling.step * if self.half { 2 } else { 1 }
    }
}

/// One step to be done.
#[derive(Clone, Debug)]
pub struct StepPlan {
    /// Number of the frame in the recording.
    pub index: usize,
    /// Frame at the size of the camera, with all its pixels.
    pub frame: Arc<TrainFrame>,
    /// Camera, time and pixels.
    pub view: StepView,
    /// Number of steps done before.
    pub step: usize,
    /// `true` if parameters are updated; statistics are updated in any case.
    pub updates: bool,
}

/// Values that are the same for all steps.
#[derive(Clone, Copy, Debug)]
pub struct Context<'a> {
    /// Settings of the training.
    pub settings: &'a TrainSettings,
    /// Table of latent features, [rows][D].
    pub latents: &'a [f32],
    /// Typical depth, scene units.
    pub typical_depth: f32,
    /// Length of a full-size pixel at the typical depth, scene units.
    pub world_per_px: f32,
}

impl Context<'_> {
    /// Weights of the loss for the pixels of `view`.
    pub fn loss_weights(&self, view: &StepView) -> LossWeights {
        self.settings.loss.sampled(view.spacing_px())
    }

    /// Factors of the pull at a splat's centre before it is added to the statistics.
    pub fn pull_scale(&self, view: &StepView) -> [f32; 2] {
        if self.settings.densify.threshold > 0.0 {
            [0.5 * view.camera.width as f32, 0.5 * view.camera.height as f32]
        } else if view.half {
            [0.5; 2]
        } else {
            [1.0; 2]
        }
    }

    /// Number of values per Gaussian that are rendered and learned beside the colour.
    pub fn learned_latents(&self, gaussians: &Gaussians) -> usize {
        if self.settings.feature_mode == super::FeatureMode::Lifted { 0 } else { gaussians.latent_dim }
    }
}

/// Result of a step.
#[derive(Clone, Debug, Default)]
pub struct StepOutcome {
    /// Loss of the last step, if it is known already.
    pub terms: Option<LossTerms<f32>>,
    /// Number of steps found dropped since the last outcome, because something was not finite.
    pub dropped: usize,
    /// Frames visited since the last outcome, each with the loss's gradient to a motion of its camera.
    pub cameras: Vec<(usize, Twist<f32>)>,
}

/// Carries out training steps. A backend that updates the model in each step needs only `step` and `densify`.
pub trait TrainBackend: Send {
    /// Name of the device it runs on.
    fn name(&self) -> String;

    /// Takes one optimiser step. The model may stay out of date until [`TrainBackend::finish`].
    fn step(
        &mut self,
        model: &mut Model,
        plan: StepPlan,
        context: &Context<'_>,
        clock: &mut PassClock<Pass>,
    ) -> Result<StepOutcome>;

    /// Adds and removes Gaussians, as [`super::densify`] does.
    fn densify(&mut self, model: &mut Model, how: &Densify, context: &Context<'_>) -> Result<StepOutcome>;

    /// Returns the current number of Gaussians.
    fn num_gaussians(&self, model: &Model) -> usize {
        model.gaussians.len()
    }

    /// Waits for all submitted steps and returns their outcome. The model may stay out of date.
    fn synchronise(&mut self, _model: &mut Model, _context: &Context<'_>) -> Result<StepOutcome> {
        Ok(StepOutcome::default())
    }

    /// Brings the model up to date.
    fn finish(&mut self, _model: &mut Model, _context: &Context<'_>) -> Result<StepOutcome> {
        Ok(StepOutcome::default())
    }

    /// Waits for all submitted steps. Returns their outcome, and the Gaussians with their motion as they are now;
    /// the model may stay out of date.
    fn shown(
        &mut self,
        model: &mut Model,
        context: &Context<'_>,
    ) -> Result<(StepOutcome, Gaussians, Deformation)> {
        let outcome = self.finish(model, context)?;
        Ok((outcome, model.gaussians.clone(), model.deformation.clone()))
    }

    /// Drops the device's copy of the model, which was changed outside.
    fn invalidate(&mut self) {}
}
