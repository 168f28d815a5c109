//! The reconstruction of a recording: its check before, its training, and what was finished meanwhile.

use crate::viewer::{
    backend::{
        Backend, Checked, Info, TrainNews, TrainRequest, Words,
        task::{Task, TaskEvent},
    },
    remedy::message,
    state::loss_curve::LossCurve,
};
use egui::Context;
use std::{
    collections::VecDeque,
    path::{Path, PathBuf},
    sync::Arc,
};

/// Check, training and result of reconstructions.
#[derive(Default)]
pub(crate) struct Reconstruction {
    pub(crate) check: Option<ImportCheck>,
    pub(crate) training: Option<Training>,
    /// Trainings that begin when the present one has ended, the next one first.
    pub(crate) queue: VecDeque<TrainRequest>,
    /// Finished reconstruction that was not opened, because something else was shown or the window was busy.
    pub(crate) finished: Option<PathBuf>,
}

impl Reconstruction {
    /// Returns `true` if a recording is being reconstructed or waits for it.
    pub(crate) fn is_planned(&self, recording: &Path) -> bool {
        let is_running = self.training.as_ref().is_some_and(|t| t.recording == recording);
        is_running || self.queue.iter().any(|request| request.recording == recording)
    }

    /// Returns the scene files that are being made or will be.
    pub(crate) fn planned_scenes(&self) -> Vec<PathBuf> {
        let running = self.training.iter().map(|t| t.scene.clone());
        running.chain(self.queue.iter().map(|request| request.scene.clone())).collect()
    }

    /// Returns `true` if the check of the open recording found that a reconstruction would be wrong.
    pub(crate) fn would_be_wrong(&self) -> bool {
        let outcome = self.check.as_ref().and_then(|check| check.outcome.as_ref());
        matches!(outcome, Some(Ok(checked)) if !checked.report.ok)
    }
}

/// Check of the open recording: its content, and faults that would make a reconstruction of it wrong.
pub(crate) struct ImportCheck {
    pub(crate) path: PathBuf,
    pub(crate) task: Task<Checked>,
    /// Result of the check, or the reason for its failure.
    pub(crate) outcome: Option<Result<Checked, String>>,
}

impl ImportCheck {
    /// Starts to read the whole recording in the background.
    pub(crate) fn start(backend: Arc<dyn Backend>, path: PathBuf, ctx: &Context) -> Self {
        let at = path.clone();
        let task = Task::start("check", ctx, move |task| backend.check(&at, task));
        Self { path, task, outcome: None }
    }

    pub(crate) fn poll(&mut self) {
        if let Some(TaskEvent::Done(result)) = self.task.poll() {
            self.outcome = Some(result.map_err(|e| message(&e)));
        }
    }
}

/// Training in the background.
pub(crate) struct Training {
    pub(crate) task: Task<PathBuf, TrainNews>,
    pub(crate) recording: PathBuf,
    /// The scene file that is being made.
    pub(crate) scene: PathBuf,
    /// Folder of what networks found so far, which stays; `None` without networks.
    pub(crate) features: Option<PathBuf>,
    pub(crate) curve: LossCurve,
    backend: Arc<dyn Backend>,
    /// Available memory, bytes, and the time of that reading, seconds.
    pub(crate) memory: Option<(u64, f64)>,
    /// Number of steps that are planned.
    steps: usize,
    /// Duration of a step, seconds, once there is a pace.
    pub(crate) seconds_per_step: Option<f64>,
    /// Time at which the window was asked to close, seconds. Closing waits until the scene is saved.
    pub(crate) closing_since: Option<f64>,
}

impl Training {
    pub(crate) fn start(backend: Arc<dyn Backend>, request: TrainRequest, ctx: &Context) -> Self {
        let (theirs, recording, scene) = (backend.clone(), request.recording.clone(), request.scene.clone());
        let features = matches!(request.words, Words::Models(_)).then(|| request.features_folder());
        let steps = request.quality.steps();
        let task = Task::start("training", ctx, move |task| theirs.reconstruct(&request, task));
        let curve = LossCurve::default();
        let (memory, seconds_per_step, closing_since) = (None, None, None);
        Self {
            task,
            recording,
            scene,
            features,
            curve,
            backend,
            memory,
            steps,
            seconds_per_step,
            closing_since,
        }
    }

    /// Returns `true` if this is the training on the recording of `info`.
    pub(crate) fn is_about(&self, info: &Info) -> bool {
        info.recording.as_ref() == Some(&self.recording)
    }

    /// Notes the pace of the training, which later ones are estimated from.
    pub(crate) fn note_pace(&mut self) {
        let progress = &self.task.progress;
        if progress.total == self.steps && progress.done * 10 > self.steps {
            self.seconds_per_step = Some(progress.seconds / progress.done as f64);
        }
    }

    /// Reads the available memory, at most once a second.
    pub(crate) fn watch_memory(&mut self, now: f64) {
        if self.memory.is_none_or(|(_, at)| now >= at + 1.0) {
            self.memory = self.backend.available_bytes().map(|bytes| (bytes, now));
        }
    }
}
