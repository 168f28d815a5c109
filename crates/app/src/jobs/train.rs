//! Training, from a recording to a scene.

use super::{backend, material::Material};
use crate::{
    engine::BackendChoice,
    memory::{Work, require_for},
};
use std::path::{Path, PathBuf};
use surgtpgs_core::{
    Error, Result,
    progress::{Observer, Progress},
    scene::Scene,
    train::{StepReport, TrainSettings, Trainer},
};

/// Result of a training.
pub struct Trained {
    /// The scene.
    pub scene: Scene,
    /// Number of Gaussians, of all chapters.
    pub gaussians: usize,
    /// Number of steps done, of all chapters.
    pub steps: usize,
    /// Number of them that chapters took which lay there already. Their time is not known.
    pub steps_kept: usize,
    /// Wall time of the other steps, seconds, reading the recording included.
    pub seconds: f64,
    /// PSNR in dB over the held-out frames, inside the supervision mask.
    pub psnr_db: Option<f64>,
    /// Number of steps dropped because their loss or gradient was not finite.
    pub dropped: usize,
    /// Notes on the scope of each chapter, and on work that could not be kept.
    pub notes: Vec<String>,
}

/// Training as it is watched.
pub struct Watched<'a> {
    /// The trainer at work.
    pub trainer: &'a mut Trainer,
    /// The chapters that are done.
    pub done: Option<&'a Scene>,
}

impl Watched<'_> {
    /// Returns the scene as far as it is learned.
    pub fn scene(&mut self) -> Result<Scene> {
        let scene = self.trainer.scene()?.as_chapter();
        if scene.chapters.is_empty() { Ok(scene) } else { Ok(Scene::joined(self.done.cloned(), scene)) }
    }
}

/// Trains until all steps are done or the observer asks to stop.
pub fn train(
    material: &Material,
    settings: TrainSettings,
    backend: BackendChoice,
    observer: &mut Observer<'_>,
) -> Result<Trained> {
    train_watched(material, settings, backend, observer, &mut |_, _| {})
}

/// Trains on the recording as a whole until all steps are done or the observer asks to stop. `watch` sees the
/// trainer and the report of each step after it, to show how far the training is.
pub fn train_watched(
    material: &Material,
    settings: TrainSettings,
    backend: BackendChoice,
    observer: &mut Observer<'_>,
    watch: &mut dyn FnMut(&mut Watched<'_>, &StepReport),
) -> Result<Trained> {
    require_for(&Work::Training(material.sequence(), &settings))?;
    let mut trainer = Trainer::new(material.sequence(), material.prepared(), settings)?;
    backend::choose(&mut trainer, backend)?;
    go_on(&mut trainer, None, observer, watch)
}

/// Returns the path of the file that keeps the unfinished training of a scene file.
pub fn checkpoint_path(scene: &Path) -> PathBuf {
    scene.with_extension("unfinished")
}

/// Stage of the training itself.
pub const TRAINING: &str = "training";

/// Seconds between two checkpoints.
const CHECKPOINT_SECONDS: f64 = 120.0;

/// Goes on with a training until all steps are done or the observer asks to stop. With a
/// `checkpoint`, the work done is written there now and then, when stopped, and when something
/// fails. If the last attempt could not be written, [`Trained::notes`] say so.
pub fn go_on(
    trainer: &mut Trainer,
    checkpoint: Option<&Path>,
    observer: &mut Observer<'_>,
    watch: &mut dyn FnMut(&mut Watched<'_>, &StepReport),
) -> Result<Trained> {
    let first_step = trainer.steps_done();
    let trained = steps(trainer, checkpoint, observer, watch);
    if let (Err(_), Some(path)) = (&trained, checkpoint)
        && trainer.steps_done() > first_step
    {
        // If this fails, too, the older checkpoint stays, and the first error is the one that is returned.
        let _ = trainer.save_checkpoint(path);
    }
    trained
}

fn steps(
    trainer: &mut Trainer,
    checkpoint: Option<&Path>,
    observer: &mut Observer<'_>,
    watch: &mut dyn FnMut(&mut Watched<'_>, &StepReport),
) -> Result<Trained> {
    let total = trainer.settings().iterations;
    let psnr_every = (total / 6).max(250);
    let (first_step, training_started) = (trainer.steps_done(), std::time::Instant::now());
    let mut psnr = String::new();
    let mut kept_at = trainer.seconds();
    let mut not_kept = None;
    if first_step == total {
        // An earlier run did the last step and failed after it.
        trainer.complete_features()?;
    }
    while trainer.steps_done() < total {
        let report = trainer.step()?;
        if report.step.is_multiple_of(psnr_every) && report.step < total {
            psnr = trainer.psnr_db()?.map_or(String::new(), |db| format!(", {db:.2} dB"));
        }
        watch(&mut Watched { trainer, done: None }, &report);
        let done_here = (report.step - first_step) as f64;
        let per_second = done_here / training_started.elapsed().as_secs_f64().max(1e-9);
        let detail =
            format!("loss {:.4}, {} Gaussians, {per_second:.0} steps/s{psnr}", report.loss, report.gaussians);
        let progress = Progress { stage: TRAINING, done: report.step, total, detail: &detail };
        let stop = observer(&progress).is_break() && report.step < total;
        if let Some(path) = checkpoint
            && (stop || trainer.seconds() > kept_at + CHECKPOINT_SECONDS)
        {
            // A checkpoint that fails is no reason to end a training: its scene is smaller, and
            // there may be room the next time.
            let kept = trainer.save_checkpoint(path);
            not_kept =
                kept.err().map(|e| format!("step {} could not be kept to go on from: {e}", report.step));
            kept_at = trainer.seconds();
        }
        if stop {
            trainer.complete_features()?;
            break;
        }
    }
    trainer.finish()?;
    let (seconds, dropped) = (trainer.seconds(), trainer.dropped());
    let psnr_db = trainer.psnr_db()?;
    let scene = trainer.scene()?;
    let (steps, gaussians) = (trainer.steps_done(), scene.gaussians.len());
    let (steps_kept, notes) = (0, not_kept.into_iter().collect());
    Ok(Trained { scene, gaussians, steps, steps_kept, seconds, psnr_db, dropped, notes })
}

/// Removes a file that this program made; a missing one is fine.
pub fn remove_file(path: &Path) -> Result<()> {
    match std::fs::remove_file(path) {
        Err(e) if e.kind() != std::io::ErrorKind::NotFound => Err(Error::io("remove the old file", path, e)),
        _ => Ok(()),
    }
}
