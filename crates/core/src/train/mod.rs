//! From a recording to a scene: initial Gaussians, losses, gradients, Adam, densify and prune.

use crate::{Result, prepare::Prepared, scene::Scene, sequence::Sequence};

/// Which set of choices: the paper's released behaviour, or the formulas done right.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Profile {
    /// What the released code does, quirks included.
    Paper,
    /// The paper's formulas done right, and better where measured.
    #[default]
    Default,
}

/// Training settings.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct TrainSettings {
    /// Optimiser steps.
    pub iterations: usize,
    /// Seed of everything random.
    pub seed: u64,
    /// Hold test frames out.
    pub eval: bool,
}

impl TrainSettings {
    /// The settings of a profile.
    pub fn of(profile: Profile) -> Self {
        let _ = profile;
        Self { iterations: 3000, seed: 0, eval: false }
    }
}

/// What one step did.
#[derive(Clone, Debug, serde::Serialize)]
pub struct StepReport {
    /// Steps done, this one included.
    pub step: usize,
    /// Total loss of the frame of this step.
    pub loss: f32,
    /// Gaussians now.
    pub gaussians: usize,
    /// Steps dropped so far because their loss or gradient was not finite.
    pub dropped: usize,
}

/// Training in progress; holds parameters, moments and the decoded frames.
pub struct Trainer {}

impl Trainer {
    /// Reads the recording and places the initial Gaussians. Features are trained if `prepared` is given
    /// (then `sequence` is `prepared.sequence`).
    pub fn new(sequence: &Sequence, prepared: Option<&Prepared>, settings: TrainSettings) -> Result<Self> {
        let _ = (sequence, prepared, settings);
        todo!()
    }
    /// One optimiser step.
    pub fn step(&mut self) -> Result<StepReport> {
        todo!()
    }
    /// Steps done.
    pub fn steps_done(&self) -> usize {
        todo!()
    }
    /// The scene as it stands, ready to be saved or shown.
    pub fn scene(&self) -> Scene {
        todo!()
    }
    /// Mean PSNR in dB inside the supervision mask over the held-out frames (all frames if none is held out).
    pub fn psnr_db(&mut self) -> Result<f64> {
        todo!()
    }
}
