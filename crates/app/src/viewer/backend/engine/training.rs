//! Training for the window: with previews, and saved with patience.

use super::scene::SceneSource;
use crate::viewer::backend::{
    TrainNews, TrainRequest,
    task::{NOT_SAVED, TaskContext},
};
use crate::{
    engine::{self, Engine, EngineOptions},
    jobs::{self, Material, PrepareOptions},
    outputs,
};
use std::{
    path::{Path, PathBuf},
    sync::Arc,
    time::{Duration, Instant},
};
use surgtpgs_core::{
    Error, Result,
    scene::Scene,
    train::{StepReport, TrainSettings, Trainer},
};

/// Number of steps before the first state that is worth showing.
const FIRST_PREVIEW: usize = 60;

/// Trains on a recording and saves the scene. After a cancellation, the scene learned so far is still saved.
pub(super) fn reconstruct(request: &TrainRequest, task: &TaskContext<TrainNews>) -> Result<PathBuf> {
    let material = Material::open(&request.recording)?;
    let inputs = material.inputs(&request.recording);
    // The offered name is free, and the file dialog asks before it replaces a file.
    let output = outputs::scene_file(&request.scene, &inputs, true)?;
    // Temporary folder of the features. It must outlive the training, which reads from it.
    let mut features = None;
    let material = match material {
        Material::Bare(sequence) if !sequence.classes().is_empty() => {
            let folder = features.insert(folder_beside(&request.scene)?);
            let options = PrepareOptions::default();
            Material::Prepared(Box::new(jobs::prepare(sequence, folder.path(), &options, &mut |p| {
                task.follow(p)
            })?))
        }
        other => other,
    };
    task.check()?;
    let settings = TrainSettings { excluded: request.excluded.clone(), ..Default::default() };
    let settings = settings.with_quality(request.quality);
    let mut last_shown = Instant::now();
    let mut show = |trainer: &mut Trainer, report: &StepReport| {
        task.update(TrainNews::Step(report.step, report.terms));
        let is_due = |every| report.step > FIRST_PREVIEW && last_shown.elapsed() >= every;
        if report.step == FIRST_PREVIEW || task.preview_every().is_some_and(is_due) {
            last_shown = Instant::now();
            if let Ok(source) = trainer.scene().and_then(|scene| preview(scene, &request.recording)) {
                task.update(TrainNews::Preview(Box::new(source)));
            }
        }
    };
    let trained = jobs::train_watched(
        &material,
        settings,
        engine::BackendChoice::Auto,
        &mut |p| task.follow(p),
        &mut show,
    )?;
    if trained.steps == 0 {
        return Err(Error::Cancelled);
    }
    save_with_patience(trained.steps, &|| output.write(&trained.scene.to_bytes()?), task)?;
    Ok(request.scene.clone())
}

/// Makes a source that shows a scene during its training.
fn preview(scene: Scene, recording: &Path) -> Result<SceneSource> {
    let engine = Engine::new(Arc::new(scene), None, EngineOptions::default())?;
    Ok(SceneSource::new(engine, recording.to_owned(), Some(recording.to_owned())))
}

/// Time between two attempts to save the trained scene.
const SAVE_EVERY: Duration = Duration::from_secs(1);

/// Saves the trained scene. If that fails, reports the reason and tries again, until it works or the user
/// gives the scene up. Minutes of work must not be lost to a full disk, both after the last step and after
/// the user stopped early to keep the scene so far.
fn save_with_patience(
    steps: usize,
    save: &dyn Fn() -> Result<()>,
    task: &TaskContext<TrainNews>,
) -> Result<()> {
    let stops = task.num_stops();
    loop {
        match save() {
            Err(e) if task.num_stops() == stops => {
                let detail = format!("{e} Free some space: it is tried again every second.");
                task.progress(NOT_SAVED, steps, steps, detail);
                std::thread::sleep(SAVE_EVERY);
            }
            saved => return saved,
        }
    }
}

/// Makes a folder for temporary files beside `file`, removed when it is dropped.
fn folder_beside(file: &Path) -> Result<tempfile::TempDir> {
    let parent = file.parent().unwrap_or(Path::new("."));
    let folder = tempfile::Builder::new().prefix(".surgtpgs-").tempdir_in(parent);
    folder.map_err(|e| Error::io("make a folder", parent, e))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::viewer::backend::task::{Task, TaskEvent};
    use surgtpgs_core::train::Quality;

    /// Waits for the result of a task. With `until_told`, returns `None` once the task reports that something
    /// is not saved yet.
    fn wait(task: &mut Task<(), TrainNews>, until_told: bool) -> Option<Result<()>> {
        loop {
            match task.poll() {
                Some(TaskEvent::Done(result)) => return Some(result),
                _ if until_told && task.progress.stage == NOT_SAVED => return None,
                _ => std::thread::yield_now(),
            }
        }
    }

    #[test]
    fn what_was_learned_is_saved_as_soon_as_there_is_room_or_given_up() {
        let folder = tempfile::tempdir().unwrap();
        let blocked = folder.path().join("results");
        let file = blocked.join("clip.safetensors");
        let scene = surgtpgs_core::stress::ordinary(5);
        let start = || {
            std::fs::write(&blocked, "no folder").unwrap();
            let (to, scene) = (file.clone(), scene.clone());
            Task::start("saving", &egui::Context::default(), move |task| {
                save_with_patience(7, &|| scene.save(&to), task)
            })
        };
        let mut waiting = start();
        assert!(wait(&mut waiting, true).is_none());
        assert!(waiting.progress.detail.contains("results"), "{}", waiting.progress.detail);
        std::fs::remove_file(&blocked).unwrap();
        assert!(wait(&mut waiting, false).unwrap().is_ok());
        assert_eq!(Scene::load(&file).unwrap().gaussians, scene.gaussians);

        std::fs::remove_dir_all(&blocked).unwrap();
        let mut given_up = start();
        assert!(wait(&mut given_up, true).is_none());
        given_up.cancel();
        let error = wait(&mut given_up, false).unwrap().unwrap_err();
        assert!(error.to_string().contains("results"), "{error}");
    }

    #[test]
    fn a_reconstruction_leaves_its_scene_and_nothing_else() {
        let folder = tempfile::tempdir().unwrap();
        let [recording, scene, prepared] =
            ["clip", "clip.safetensors", "clip.prepared"].map(|name| folder.path().join(name));
        let tiny = surgtpgs_core::demo::DemoSettings {
            width: 32,
            height: 24,
            frames: 4,
            ..surgtpgs_core::demo::DemoSettings::default()
        };
        surgtpgs_core::demo::write(&tiny, &recording, &mut surgtpgs_core::progress::unobserved).unwrap();
        std::fs::create_dir(&prepared).unwrap();
        std::fs::write(prepared.join("mine"), "hours of work").unwrap();
        let request =
            TrainRequest { recording, scene: scene.clone(), quality: Quality::Quick, excluded: Vec::new() };
        let train = move |task: &TaskContext<TrainNews>| reconstruct(&request, task).map(drop);
        let mut task = Task::start("training", &egui::Context::default(), train);
        wait(&mut task, false).unwrap().unwrap();
        assert!(Scene::load(&scene).unwrap().codec.is_some());
        assert_eq!(std::fs::read_to_string(prepared.join("mine")).unwrap(), "hours of work");
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 3, "and no other");
    }
}
