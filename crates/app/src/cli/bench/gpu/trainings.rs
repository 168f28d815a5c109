//! Whole trainings on both backends: quality beside time.

use super::scale::Scale;
use crate::{
    cli::console::interrupted,
    engine::{BackendChoice, Engine, EngineOptions},
    evaluation::{Extras, evaluate},
    jobs::{self, Material, PrepareOptions},
};
use std::{
    ops::ControlFlow,
    path::{Path, PathBuf},
    sync::Arc,
    time::{Duration, Instant},
};
use surgtpgs_core::{
    Error, Result, demo, progress::unobserved, scene::Scene, sequence::Sequence, train::TrainSettings,
};
use tempfile::TempDir;

/// Backends that train, in their order.
pub(super) const BACKENDS: [BackendChoice; 2] = [BackendChoice::Gpu, BackendChoice::Cpu];

/// One training. Quality is that of held-out frames.
#[derive(serde::Serialize)]
pub(super) struct TrainingRow {
    pub(super) recording: String,
    pub(super) backend: &'static str,
    pub(super) width: usize,
    pub(super) height: usize,
    pub(super) steps: usize,
    /// Number of steps that there would have been time for on a faster machine.
    pub(super) planned_steps: usize,
    pub(super) seconds: f64,
    pub(super) gaussians: usize,
    pub(super) dropped_steps: usize,
    pub(super) psnr_masked_db: Option<f64>,
    pub(super) ssim: Option<f64>,
    pub(super) miou_paper: Option<f64>,
    pub(super) miou_strict: Option<f64>,
}

/// Recording to train on.
#[derive(Clone, Copy)]
pub(super) enum Place<'a> {
    Demo,
    Recording(&'a Path),
}

/// A recording that is ready to be trained on.
pub(super) struct Studio {
    name: String,
    path: PathBuf,
    material: Material,
    steps: usize,
    /// Holds files that were made for the trainings.
    _folder: TempDir,
}

pub(super) fn backend_name(backend: BackendChoice) -> &'static str {
    if backend == BackendChoice::Gpu { "GPU" } else { "CPU" }
}

impl Studio {
    /// Opens a recording, or records the demo. Features are made where there are labels.
    pub(super) fn new(name: &str, place: Place<'_>, scale: &Scale) -> Result<Self> {
        let folder = tempfile::tempdir().map_err(|e| Error::io("make a folder", std::env::temp_dir(), e))?;
        let (path, steps) = match place {
            Place::Recording(path) => (path.to_owned(), scale.recording_steps),
            Place::Demo => (folder.path().join("recording"), scale.demo_steps),
        };
        if matches!(place, Place::Demo) {
            demo::write(&scale.demo, &path, &mut unobserved)?;
        }
        let sequence = Sequence::open(&path)?;
        let material = if sequence.classes().is_empty() {
            Material::Bare(sequence)
        } else {
            let how = PrepareOptions { eval: true, ..Default::default() };
            let prepared = jobs::prepare(sequence, &folder.path().join("prepared"), &how, &mut unobserved)?;
            Material::Prepared(Box::new(prepared))
        };
        Ok(Self { name: name.to_owned(), path, material, steps, _folder: folder })
    }

    /// Trains for at most this time, and evaluates what was learned on the CPU.
    pub(super) fn train(
        &self,
        backend: BackendChoice,
        at_most: Duration,
    ) -> Result<(TrainingRow, Arc<Scene>)> {
        let settings = TrainSettings { iterations: self.steps, eval: true, ..Default::default() };
        let end = Instant::now() + at_most;
        let trained = jobs::train(&self.material, settings, backend, &mut |_| {
            if interrupted() || Instant::now() > end {
                ControlFlow::Break(())
            } else {
                ControlFlow::Continue(())
            }
        })?;
        if interrupted() {
            return Err(Error::Cancelled);
        }
        let scene = Arc::new(trained.scene);
        let options = EngineOptions {
            backend: BackendChoice::Cpu,
            sequence: Some(self.path.clone()),
            ..Default::default()
        };
        let mut engine = Engine::new(scene.clone(), None, options)?;
        let report = evaluate(&mut engine, Extras::default(), &mut unobserved)?.report;
        let iou = report.iou.as_ref();
        let sequence = self.material.sequence();
        let row = TrainingRow {
            recording: self.name.clone(),
            backend: backend_name(backend),
            width: sequence.width(),
            height: sequence.height(),
            steps: trained.steps,
            planned_steps: self.steps,
            seconds: trained.seconds,
            gaussians: scene.gaussians.len(),
            dropped_steps: trained.dropped,
            psnr_masked_db: report.psnr_masked_db,
            ssim: report.ssim,
            miou_paper: iou.and_then(|iou| iou.paper.mean),
            miou_strict: iou.and_then(|iou| iou.strict.mean),
        };
        Ok((row, scene))
    }
}
