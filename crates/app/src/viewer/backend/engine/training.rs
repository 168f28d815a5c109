//! Training for the window: with previews, and saved with patience.

use super::{
    features,
    scene::{SceneSource, SpareTools},
};
use crate::viewer::backend::{
    Models, PREPARING, SCENE, TrainNews, TrainRequest, Words,
    earlier::STOPPED,
    paths::free_path,
    task::{NOT_SAVED, TaskContext, lock},
};
use crate::{
    engine::{self, EncoderChoice, Engine, EngineOptions},
    jobs::{self, Course, FeatureSource, Material, PrepareOptions, Watched},
    outputs,
};
use std::{
    ops::ControlFlow,
    path::{Path, PathBuf},
    sync::Arc,
    time::{Duration, Instant},
};
use surgtpgs_core::{
    Error, Result,
    files::OutputFile,
    prepare::Prepared,
    scene::Scene,
    segment::MaskSettings,
    sequence::Sequence,
    train::{Plan, StepReport, TrainSettings},
};

/// Number of steps before the first state that is worth showing.
const FIRST_PREVIEW: usize = 60;

/// Trains on a recording and saves the scene. After a cancellation, the scene learned so far is still saved.
pub(super) fn reconstruct(request: &TrainRequest, task: &TaskContext<TrainNews>) -> Result<PathBuf> {
    let material = Material::open(&request.recording)?;
    let inputs = material.inputs(&request.recording);
    let output = outputs::scene_file(&request.scene, &inputs, request.replaces)?;
    // Temporary folder of the features. It must outlive the training, which reads from it.
    let mut features = None;
    let material = match (material, &request.words) {
        (Material::Bare(sequence), Words::Models(models)) => {
            Material::Prepared(Box::new(prepared_by_models(sequence, request, models, task)?))
        }
        (Material::Bare(sequence), Words::Labels) if !sequence.classes().is_empty() => {
            let folder = features.insert(folder_beside(&request.scene)?);
            let options = PrepareOptions::default();
            let observer = &mut |p: &jobs::Progress<'_>| follow_preparing(task, p);
            Material::Prepared(Box::new(jobs::prepare(sequence, folder.path(), &options, observer)?))
        }
        (other, _) => other,
    };
    task.check()?;
    let settings = TrainSettings { excluded: request.excluded.clone(), ..Default::default() };
    let settings = settings.with_quality(request.quality);
    let mut last_shown = Instant::now();
    let spare = SpareTools::default();
    let mut show = |watched: &mut Watched<'_>, report: &StepReport| {
        task.note(TrainNews::Step(report.step, report.terms));
        let is_due = |every| report.step > FIRST_PREVIEW && last_shown.elapsed() >= every;
        if report.step == FIRST_PREVIEW || task.preview_every().is_some_and(is_due) {
            last_shown = Instant::now();
            let made = watched
                .scene()
                .and_then(|scene| preview(scene, material.sequence(), &request.recording, &spare));
            if let Ok(source) = made {
                task.update(TrainNews::Preview(Box::new(source)));
            }
        }
    };
    let course = Course {
        material: &material,
        settings,
        backend: engine::BackendChoice::Auto,
        scene: output.path(),
        keeps_unfinished: false,
        // Chapters that an interrupted training of other settings left do not stand in the way.
        replaces: true,
        look_at: Some(&|| task.play_head()),
    };
    let (sequence, prepared) = (material.sequence(), material.prepared());
    let plan = Plan::of(sequence, prepared, &course.settings, &mut |p| follow_preparing(task, p))?;
    let trained = course.train_planned(plan, &mut |p| task.follow(p), &mut show)?;
    if trained.steps == 0 {
        return Err(Error::Cancelled);
    }
    let write = |output: &OutputFile| output.write_with(|file| trained.scene.write(file, false));
    if !course.is_whole(&trained) && is_better(output.path(), trained.scene.provenance.steps) {
        let beside = stopped_beside(&request.scene);
        let save = || write(&outputs::scene_file(&beside, &inputs, false)?);
        save_with_patience(trained.steps, &save, task)?;
        move_parts(output.path(), &beside);
        return Ok(beside);
    }
    save_with_patience(trained.steps, &|| write(&output), task)?;
    course.clear(&trained)?;
    Ok(request.scene.clone())
}

/// Returns `true` if a training that was stopped after some steps must not replace the scene in a file, which
/// is whole or had learned more.
fn is_better(scene: &Path, steps: usize) -> bool {
    match jobs::stopped_at(scene) {
        Some(stopped) => stopped.steps > steps,
        None => scene.exists(),
    }
}

/// Moves the parts of a long recording that lie beside a scene to another one, which goes on with them.
fn move_parts(from: &Path, to: &Path) {
    for part in jobs::begun_chapters(from) {
        let chapter = part.file_stem().and_then(|stem| Path::new(stem).extension());
        if let (Some(chapter), Some(kind)) = (chapter, part.extension()) {
            // A part that cannot be moved is made anew.
            let _ = std::fs::rename(&part, to.with_extension(chapter).with_added_extension(kind));
        }
    }
}

/// Returns a free path beside a scene, for one whose training was stopped.
fn stopped_beside(scene: &Path) -> PathBuf {
    let (folder, name) = (scene.parent().unwrap_or(Path::new(".")), scene.file_stem().unwrap_or_default());
    free_path(folder, &format!("{}-{STOPPED}", name.to_string_lossy()), SCENE, &[])
}

/// Prepares a recording with networks, in a folder beside the scene that stays: after a stop, or with other
/// settings, masks and embeddings that are there are used again.
fn prepared_by_models(
    sequence: Sequence,
    request: &TrainRequest,
    models: &Models,
    task: &TaskContext<TrainNews>,
) -> Result<Prepared> {
    let options = PrepareOptions {
        source: FeatureSource::Masks {
            model: models.masks.clone(),
            image_encoder: models.images.clone(),
            settings: MaskSettings::of_grid(models.points_per_side),
            level: features::LEVEL,
        },
        encoder: text_encoder(models),
        ..PrepareOptions::default()
    };
    jobs::prepare_folder(sequence, &request.features_folder(), &options, true, &mut |p| {
        follow_preparing(task, p)
    })
}

/// Reports the progress of work before the training, under a name that says so.
fn follow_preparing(task: &TaskContext<TrainNews>, p: &jobs::Progress<'_>) -> ControlFlow<()> {
    task.follow(&jobs::Progress { stage: &format!("{PREPARING}, {}", p.stage), ..*p })
}

/// Returns the text encoder of models.
pub(super) fn text_encoder(models: &Models) -> EncoderChoice {
    let is_chosen = !models.texts.as_os_str().is_empty();
    if is_chosen { EncoderChoice::Folder(models.texts.clone()) } else { EncoderChoice::Builtin }
}

/// Makes a source that shows a scene during its training on the sequence of the recording at `path`, with the
/// tools of the source before the last one: that one is still shown.
fn preview(scene: Scene, sequence: &Sequence, path: &Path, spare: &SpareTools) -> Result<SceneSource> {
    let (options, tools) = (EngineOptions::default(), lock(spare).take());
    let engine = Engine::of_recording(Arc::new(scene), sequence.clone(), options, tools)?;
    Ok(SceneSource::new(engine, path.to_owned(), Some(path.to_owned())).leaving_tools(spare))
}

/// Time between two attempts to save the trained scene.
const SAVE_EVERY: Duration = Duration::from_secs(1);

/// Saves the trained scene. If that fails, reports the reason and tries again, until it works or the user
/// gives the scene up. Minutes of work must not be lost to a full disk, both after the last step and after
/// the user stopped early to keep the scene so far. Asking to stop, as a window that is closed does, gives up
/// nothing.
fn save_with_patience(
    steps: usize,
    save: &dyn Fn() -> Result<()>,
    task: &TaskContext<TrainNews>,
) -> Result<()> {
    loop {
        match save() {
            Err(e) if !task.is_given_up() => {
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

/// Small networks of every contract.
#[cfg(test)]
#[path = "../../../../../clip/tests/models/mod.rs"]
mod models;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::viewer::backend::task::{Task, TaskEvent, TaskProgress};
    use crate::viewer::backend::{
        Backend, FrameSource,
        earlier::{Earlier, features_beside},
        engine::{EngineBackend, recording::RecordingSource},
    };
    use image::{Rgb, RgbImage};
    use surgtpgs_core::{
        demo::DemoSettings,
        marks::{Mark, Shape},
        train::Quality,
    };

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
        waiting.cancel();
        let told = waiting.progress.clone();
        while waiting.progress == told {
            assert!(waiting.poll().is_none(), "whoever stops keeps what was learned");
            std::thread::yield_now();
        }
        std::fs::remove_file(&blocked).unwrap();
        assert!(wait(&mut waiting, false).unwrap().is_ok());
        assert_eq!(Scene::load(&file).unwrap().gaussians, scene.gaussians);

        std::fs::remove_dir_all(&blocked).unwrap();
        let mut given_up = start();
        assert!(wait(&mut given_up, true).is_none());
        given_up.give_up();
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
        let made_before = |path: &Path| {
            let source = RecordingSource::new(&Material::open(path).unwrap(), path.to_owned());
            source.info().made_before.clone()
        };
        assert_eq!(made_before(&recording), None);
        let request = TrainRequest {
            recording: recording.clone(),
            scene: scene.clone(),
            replaces: false,
            quality: Quality::Quick,
            excluded: Vec::new(),
            words: Words::Labels,
            features: None,
        };
        let again = TrainRequest { replaces: true, ..request.clone() };
        let train = move |task: &TaskContext<TrainNews>| reconstruct(&request, task).map(drop);
        let mut task = Task::start("training", &egui::Context::default(), train);
        wait(&mut task, false).unwrap().unwrap();
        assert!(Scene::load(&scene).unwrap().codec.is_some());
        assert_eq!(std::fs::read_to_string(prepared.join("mine")).unwrap(), "hours of work");
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 3, "and no other");
        assert_eq!(made_before(&recording), Some(scene.clone()));
        let other = folder.path().join("other");
        let fewer = surgtpgs_core::demo::DemoSettings { frames: 3, ..tiny };
        surgtpgs_core::demo::write(&fewer, &other, &mut surgtpgs_core::progress::unobserved).unwrap();
        std::fs::copy(&scene, folder.path().join("other.safetensors")).unwrap();
        assert_eq!(made_before(&other), None, "another recording's");

        let whole = std::fs::read(&scene).unwrap();
        let unasked = TrainRequest { replaces: false, ..again.clone() };
        let refused = reconstruct(&unasked, &TaskContext::stopping_at(|_| true)).unwrap_err();
        assert!(refused.to_string().contains("there is an earlier result here"), "{refused}");
        for name in ["clip-stopped.safetensors", "clip-stopped-2.safetensors"] {
            let stopping = TaskContext::stopping_at(|p| p.stage == jobs::TRAINING);
            assert_eq!(reconstruct(&again, &stopping).unwrap(), folder.path().join(name));
        }
        assert!(std::fs::read(&scene).unwrap() == whole, "a stopped training does not replace a whole scene");
    }

    fn earlier_on(recording: &Path) -> Earlier {
        let source = RecordingSource::new(&Material::open(recording).unwrap(), recording.to_owned());
        Earlier::on(source.info())
    }

    #[test]
    fn what_was_stopped_is_found_again_and_not_replaced_by_less() {
        let folder = tempfile::tempdir().unwrap();
        let [recording, scene] = ["clip", "clip.safetensors"].map(|name| folder.path().join(name));
        let tiny = DemoSettings { width: 32, height: 24, frames: 4, ..DemoSettings::default() };
        surgtpgs_core::demo::write(&tiny, &recording, &mut surgtpgs_core::progress::unobserved).unwrap();
        assert_eq!(earlier_on(&recording), Earlier::default());
        let request = TrainRequest {
            recording: recording.clone(),
            scene: scene.clone(),
            replaces: true,
            quality: Quality::Best,
            excluded: Vec::new(),
            words: Words::Nothing,
            features: None,
        };
        let stopped_after = |steps: usize| {
            let task = TaskContext::stopping_at(move |p| p.stage == jobs::TRAINING && p.done >= steps);
            reconstruct(&request, &task).unwrap()
        };
        assert_eq!(stopped_after(4), scene);
        assert_eq!(earlier_on(&recording), Earlier::default(), "there is nothing to go on with");
        let steps = || jobs::stopped_at(&scene).unwrap().steps;
        let [beside, second] =
            ["clip-stopped", "clip-stopped-2"].map(|name| folder.path().join(name).with_extension(SCENE));
        assert_eq!((stopped_after(2), steps()), (beside.clone(), 4));

        let part = surgtpgs_core::stress::ordinary(4);
        part.save(&jobs::chapter_path(&beside, 3)).unwrap();
        let stopped = earlier_on(&recording).stopped.unwrap();
        assert_eq!((&stopped.path, stopped.quality(&[])), (&beside, Some(Quality::Best)));
        assert_eq!(stopped.quality(&[(0, 0)]), None, "frames are left out since");
        assert!(stopped.finds(&Words::Nothing) && !stopped.finds(&Words::Labels));

        assert_eq!((stopped_after(6), steps()), (scene.clone(), 6));
        part.save(&jobs::chapter_path(&scene, 3)).unwrap();
        assert_eq!((stopped_after(2), steps()), (second.clone(), 6), "with parts, too");
        assert_eq!(earlier_on(&recording).stopped.unwrap().path, second, "the newest");
    }

    #[test]
    fn parts_of_a_long_recording_go_with_the_scene_that_was_stopped() {
        let folder = tempfile::tempdir().unwrap();
        let [whole, stopped] =
            ["op.1.safetensors", "op.1-stopped.safetensors"].map(|name| folder.path().join(name));
        surgtpgs_core::stress::ordinary(4).save(&jobs::chapter_path(&whole, 3)).unwrap();
        move_parts(&whole, &stopped);
        assert_eq!(jobs::begun_chapters(&stopped), [jobs::chapter_path(&stopped, 3)]);
        assert!(jobs::begun_chapters(&whole).is_empty());
    }

    /// Writes a recording of two colours, and networks that tell colours apart.
    fn recording_and_models(folder: &Path) -> (PathBuf, Models) {
        let write = |name: &str, bytes: Vec<u8>| {
            let path = folder.join(name);
            std::fs::create_dir_all(path.parent().unwrap()).unwrap();
            std::fs::write(path, bytes).unwrap();
        };
        let dim = surgtpgs_clip::TextEncoder::builtin().unwrap().identity().dim;
        let colours: Vec<f32> = (0..3 * dim).map(|i| (i as f32 * 1.7).sin()).collect();
        write("sam/encoder.onnx", models::encoder(&["image_embed", "high_res_feats_0"]).into_bytes());
        write("sam/decoder.onnx", models::sam2_decoder().into_bytes());
        write("clip/model.onnx", models::image_encoder(&colours, None, &["image_embeds"]).into_bytes());
        write("clip/encoder.toml", b"mean = [0.0, 0.0, 0.0]\nstd = [1.0, 1.0, 1.0]\n".to_vec());
        write("other/model.onnx", models::image_encoder(&[0.5; 15], None, &["image_embeds"]).into_bytes());
        let recording = folder.join("recording");
        std::fs::create_dir_all(&recording).unwrap();
        for frame in 0..4 {
            let colour = |x: u32| if x < 20 + frame { Rgb([150, 30, 30]) } else { Rgb([230, 210, 60]) };
            let picture = RgbImage::from_fn(48, 32, |x, _| colour(x));
            picture.save(recording.join(format!("frame_{frame}.png"))).unwrap();
        }
        let (masks, images) = (folder.join("sam"), folder.join("clip"));
        (recording, Models { masks, images, points_per_side: 8, ..Models::default() })
    }

    #[test]
    fn faults_of_models_are_told_each_in_words() {
        let folder = tempfile::tempdir().unwrap();
        let (_, models) = recording_and_models(folder.path());
        let faults = |models: Models| {
            let check = move |task: &TaskContext| EngineBackend::default().check_models(&models, task);
            let mut task = Task::start("models", &egui::Context::default(), check);
            loop {
                match task.poll() {
                    Some(TaskEvent::Done(result)) => return result.unwrap(),
                    _ => std::thread::yield_now(),
                }
            }
        };
        assert!(faults(models.clone()).is_none());
        let swapped = faults(Models { masks: models.images.clone(), ..models.clone() });
        assert!(swapped.masks.is_some() && swapped.images.is_none() && swapped.texts.is_none());
        let unlike = faults(Models { images: folder.path().join("other"), ..models.clone() });
        assert!(unlike.texts.unwrap().contains("Image embeddings have 5 values"));
        let gone = faults(Models { images: folder.path().join("gone"), ..models });
        assert!(gone.images.is_some() && gone.texts.is_none());
    }

    #[test]
    fn a_click_becomes_the_mask_of_what_the_network_finds() {
        let folder = tempfile::tempdir().unwrap();
        let (recording, models) = recording_and_models(folder.path());
        let backend = EngineBackend::default();
        let click =
            |frame, x| Mark::new(frame, "liver", true, Shape::Click { point_px: [x, 16.0], radius_px: 2.0 });
        for (frame, x, covered) in [(0, 5.0, 0..20), (3, 40.0, 23..48), (3, 5.0, 0..23)] {
            let made = backend.with_mask(&models.masks, &recording, &click(frame, x)).unwrap();
            let pixels = made.shape.pixels(48, 32);
            let wrong = (0..48).filter(|x| pixels.at(*x, 16) != covered.contains(x)).count();
            assert!(wrong <= 2, "frame {frame}: {wrong} pixels of the row");
        }
        let gone = folder.path().join("gone");
        assert!(backend.with_mask(&gone, &recording, &click(0, 5.0)).is_err());
    }

    #[test]
    fn a_recording_without_labels_is_prepared_and_learned_and_goes_on_after_a_stop() {
        let folder = tempfile::tempdir().unwrap();
        let (recording, models) = recording_and_models(folder.path());
        let request = TrainRequest {
            recording,
            scene: folder.path().join("recording.safetensors"),
            replaces: false,
            quality: Quality::Quick,
            excluded: Vec::new(),
            words: Words::Models(models.clone()),
            features: None,
        };
        let found = |models: &Models| {
            let folders = earlier_on(&request.recording).features;
            let task = TaskContext::stopping_at(|_| false);
            EngineBackend::default().found_before(models, &request.recording, &folders, &task).unwrap()
        };
        assert_eq!(found(&models), None);
        let until = |stage: &'static str| {
            let task = TaskContext::stopping_at(move |p| p.stage.starts_with(stage) && p.done > 0);
            reconstruct(&request, &task)
        };
        let stopped = until(PREPARING);
        assert!(matches!(stopped, Err(Error::Cancelled)), "{stopped:?}");
        assert!(request.features_folder().join("masks").is_dir(), "what was found is kept");
        assert_eq!(found(&models), Some(request.features_folder()));
        let scene = until("training").unwrap();
        let scene = Scene::load(&scene).unwrap();
        assert!(scene.codec.is_some(), "words can be asked");

        let finer = Models { points_per_side: 16, ..models.clone() };
        let other = Models { images: folder.path().join("other"), ..models.clone() };
        assert_eq!([&finer, &other].map(found), [None, None], "they would replace it");
        let features = found(&models);
        assert_eq!(features, Some(request.features_folder()));
        let scene = folder.path().join("recording-2.safetensors");
        let again = TrainRequest { scene, features, ..request.clone() };
        let is_found_anew = |p: &TaskProgress| p.detail.starts_with("point ");
        let task = TaskContext::stopping_at(move |p| p.stage == jobs::TRAINING || is_found_anew(p));
        assert_eq!(reconstruct(&again, &task).unwrap(), again.scene, "what was found is used again");
        assert!(!features_beside(&again.scene).exists());
    }
}
