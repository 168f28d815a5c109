//! Implementation of the window's interface ([`super::source`]) by the real engine.

use super::{
    jobs::{JobContext, NOT_SAVED},
    measure::Lens,
    orbit::Orbit,
    source::{
        Backend, Checked, Demo, ExportRequest, ExportSummary, FrameSource, Info, Rendering, TrainRequest,
        View,
    },
    training::DEFAULT_STEPS,
    widgets::thousands,
};
use crate::{
    engine::{self, Ask, Engine, EngineOptions, Motion, Question, Sample},
    evaluation::{self, Evaluation},
    jobs::{self, DemoPaths, ExportQuestion, Material, PrepareOptions, Progress},
    memory::{Work, require_for},
    outputs,
};
use image::RgbImage;
use std::{
    ops::ControlFlow,
    path::{Path, PathBuf},
    sync::Arc,
    time::{Duration, Instant},
};
use surgtpgs_core::{
    Error, Result,
    demo::{self, DemoSettings},
    export::{ExportOptions, Source},
    files::{Inputs, claim_collection, full_path},
    grid::{Grid, Mask},
    raster::FrameClock,
    relevancy::RelevancySettings,
    scene::Scene,
    sequence::{self, Sequence},
    train::{StepReport, TrainSettings, Trainer},
};
use surgtpgs_render::Wanted;

/// Request for depth and scores without pictures.
const VALUES: Wanted = Wanted { pictures: false, values: true };
/// Number of steps before the first state that is worth showing.
const FIRST_PREVIEW: usize = 60;

/// Opens, exports and trains with the program's own engine.
pub(crate) struct EngineBackend;

impl Backend for EngineBackend {
    fn open(&self, path: &Path) -> Result<Box<dyn FrameSource>> {
        if Scene::is_named_like_one(path) {
            let engine = Engine::open(path, EngineOptions::default())?;
            let recording = engine.sequence().map(|s| s.path().to_owned());
            Ok(Box::new(SceneSource::new(engine, path.to_owned(), recording)))
        } else {
            let material = Material::open(path)?;
            require_for(&Work::Reading(material.sequence()))?;
            Ok(Box::new(RecordingSource::new(&material, path.to_owned())))
        }
    }

    fn check(&self, path: &Path, job: &JobContext) -> Result<Checked> {
        let material = Material::open(path)?;
        let sequence = material.sequence();
        let report = sequence::check(sequence, &mut |done, total| {
            job.progress("checking", done, total, String::new())
        });
        Ok(Checked { report, can_flip: sequence.has_mask_files() })
    }

    fn flip_masks(&self, path: &Path) -> Result<PathBuf> {
        Material::open(path)?.sequence().flip_masks()
    }

    fn demo(&self, folder: &Path, job: &JobContext) -> Result<Demo> {
        let paths = DemoPaths::under(folder);
        if paths.scene.is_file() {
            return Ok(Demo { path: paths.scene, train: None });
        }
        if Sequence::open(&paths.recording).is_err() {
            claim_collection(folder, outputs::DEMO, &Inputs::none())?;
            let settings = DemoSettings::default();
            job.preview(Box::new(RecordingSource::of_demo(demo::Demo::new(&settings)?, &paths.recording)));
            jobs::record_demo(&settings, &paths.recording, true, &mut |done, total| {
                job.progress("recording the demo", done, total, String::new());
            })?;
        }
        let train = TrainRequest {
            recording: paths.recording.clone(),
            scene: paths.scene,
            iterations: DEFAULT_STEPS,
            excluded: Vec::new(),
        };
        Ok(Demo { path: paths.recording, train: Some(train) })
    }

    fn export(&self, request: &ExportRequest, job: &JobContext) -> Result<ExportSummary> {
        let relevancy = RelevancySettings {
            phrases: request.negatives.phrases.clone(),
            class_negatives: request.negatives.uses_classes,
            ..Default::default()
        };
        let options = EngineOptions { relevancy, ..Default::default() };
        let mut engine = Engine::open(&request.scene, options)?;
        let question = |prompt: &super::source::ExportPrompt| ExportQuestion {
            question: prompt.question.clone(),
            threshold: prompt.threshold,
            colour: prompt.colour,
            is_instrument: prompt.is_instrument,
        };
        let options = ExportOptions {
            formats: request.formats.clone(),
            source: if request.from_original { Source::Original } else { Source::Reconstruction },
            exclusive: request.is_exclusive,
            look: request.look,
            clean_up: request.clean_up,
            ..Default::default()
        };
        let asked = jobs::ExportRequest {
            scene: request.scene.clone(),
            folder: request.folder.clone(),
            frames: request.frames(),
            questions: request.prompts.iter().map(question).collect(),
            options,
            replace: false,
            completes_same: true,
        };
        let done = jobs::export(&mut engine, &asked, &mut |p| watch(job, p))?;
        Ok(ExportSummary {
            is_complete: done.complete,
            num_files: done.files,
            folder: request.folder.clone(),
        })
    }

    fn evaluate(&self, scene: &Path, job: &JobContext) -> Result<Evaluation> {
        let mut engine = Engine::open(scene, EngineOptions::default())?;
        evaluation::evaluate(&mut engine, None, &mut |p| watch(job, p))
    }

    fn available_bytes(&self) -> Option<u64> {
        crate::memory::available_bytes()
    }

    fn reconstruct(&self, request: &TrainRequest, job: &JobContext) -> Result<PathBuf> {
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
                    watch(job, p)
                })?))
            }
            other => other,
        };
        job.check()?;
        let (iterations, excluded) = (request.iterations, request.excluded.clone());
        let settings = TrainSettings { iterations, excluded, ..Default::default() };
        let mut last_shown = Instant::now();
        let mut show = |trainer: &mut Trainer, report: &StepReport| {
            job.step(report.step, report.terms);
            let is_due = |every| report.step > FIRST_PREVIEW && last_shown.elapsed() >= every;
            if report.step == FIRST_PREVIEW || job.preview_every().is_some_and(is_due) {
                last_shown = Instant::now();
                if let Ok(source) = trainer.scene().and_then(|scene| preview(scene, &request.recording)) {
                    job.preview(Box::new(source));
                }
            }
        };
        let trained = jobs::train_watched(
            &material,
            settings,
            engine::BackendChoice::Auto,
            &mut |p| watch(job, p),
            &mut show,
        )?;
        if trained.steps == 0 {
            return Err(Error::Cancelled);
        }
        save_with_patience(trained.steps, &|| output.write(&trained.scene.to_bytes()?), job)?;
        Ok(request.scene.clone())
    }
}

/// Time between two attempts to save the trained scene.
const SAVE_EVERY: Duration = Duration::from_secs(1);

/// Saves the trained scene. If that fails, reports the reason and tries again, until it works or the user
/// gives the scene up. Minutes of work must not be lost to a full disk, both after the last step and after
/// the user stopped early to keep the scene so far.
fn save_with_patience(steps: usize, save: &dyn Fn() -> Result<()>, job: &JobContext) -> Result<()> {
    let stops = job.num_stops();
    loop {
        match save() {
            Err(e) if job.num_stops() == stops => {
                let detail = format!("{e} Free some space: it is tried again every second.");
                job.progress(NOT_SAVED, steps, steps, detail);
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

/// Reports the progress of a job, and breaks if the job is to stop.
fn watch(job: &JobContext, progress: &Progress<'_>) -> ControlFlow<()> {
    job.progress(progress.stage, progress.done, progress.total, progress.detail.to_owned());
    job.rest_while_paused();
    if job.is_cancelled() { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
}

/// Makes a source that shows a scene during its training.
fn preview(scene: Scene, recording: &Path) -> Result<SceneSource> {
    let engine = Engine::new(Arc::new(scene), None, EngineOptions::default())?;
    Ok(SceneSource::new(engine, recording.to_owned(), Some(recording.to_owned())))
}

/// A scene, with its recording if that is still there.
struct SceneSource {
    engine: Engine,
    info: Info,
    /// Distance to the point that the endoscope looks at, scene units. Views turn around this point.
    pivot_depth: f32,
    /// Depth of the endoscope's own view, for the view that was turned last.
    home_depth: Option<(View, Arc<Grid<f32>>)>,
}

impl SceneSource {
    fn new(engine: Engine, path: PathBuf, recording: Option<PathBuf>) -> Self {
        let scene = engine.scene();
        let size = scene.cameras.first().map_or((0, 0), |c| (c.width as usize, c.height as usize));
        let moves =
            |c: &surgtpgs_core::camera::Camera| c.camera_from_world != scene.cameras[0].camera_from_world;
        let count = format!("{} Gaussians", thousands(scene.gaussians.len()));
        let mut notes = vec![(count, "What the reconstruction is made of.".to_owned())];
        if !scene.provenance.held_out {
            let why = "No frame was held out, so none is left to test the reconstruction on.";
            notes.push(("trained on all frames".to_owned(), why.to_owned()));
        }
        let identity = engine.sequence().map(Sequence::outline).or(scene.provenance.identity.as_ref());
        let sequence = engine.sequence().map_or(&*scene.provenance.sequence_path, Sequence::path);
        let sequence = full_path(sequence);
        let info = Info {
            name: scene.provenance.sequence_name.clone(),
            output_folder: output_folder(&path),
            path,
            recording,
            sequence: Some(sequence).filter(|p| !p.as_os_str().is_empty()),
            frames_sha256: identity.map(|identity| identity.outline_digest()),
            num_frames: scene.num_frames(),
            width: size.0,
            height: size.1,
            frames_per_second: scene.provenance.frames_per_second,
            camera_moves: scene.cameras.iter().any(moves),
            lens: scene.cameras.first().map(|c| Lens { fx: c.fx, fy: c.fy, cx: c.cx, cy: c.cy }),
            has_original: engine.sequence().is_some(),
            original_missing: engine.recording_missing().map(str::to_owned),
            has_reconstruction: true,
            has_features: scene.codec.is_some(),
            has_labels: engine.sequence().is_some_and(|s| !s.classes().is_empty()),
            example_prompts: examples(scene.classes.iter().map(|(class, _)| class.name.as_str())),
            renderer: engine.renderer_name(),
            notes,
        };
        Self { engine, info, pivot_depth: 1.0, home_depth: None }
    }

    fn engine_view(&mut self, view: &View) -> Result<engine::SceneView> {
        let recorded = self.engine.view(view.frame)?;
        let full = if view.orbit.is_home() {
            recorded
        } else {
            engine::SceneView::free(recorded.time, view.orbit.apply(&recorded.camera, self.pivot_depth))
        };
        let half = |n: u32| (n / 2).max(1);
        Ok(if view.is_preview {
            full.resized(half(full.camera.width), half(full.camera.height))
        } else {
            full
        })
    }

    /// Returns the depth of the endoscope's own view on the frame of a turned view, at the size of the turned
    /// view. Empty if `view` is the endoscope's own.
    fn recorded_depth(&mut self, view: &View) -> Result<Arc<Grid<f32>>> {
        if view.orbit.is_home() {
            return Ok(Arc::default());
        }
        let home = View { orbit: Orbit::default(), ..*view };
        if let Some((_, depth)) = self.home_depth.as_ref().filter(|(of, _)| *of == home) {
            return Ok(depth.clone());
        }
        let engine_view = self.engine_view(&home)?;
        let shown = self.engine.show(&engine_view, Ask::Nothing, VALUES)?;
        let depth = Arc::new(shown.depth.unwrap_or_default());
        self.home_depth = Some((home, depth.clone()));
        Ok(depth)
    }

    /// Returns the scores of several questions; fails if one of them cannot be asked.
    fn ask(&mut self, view: &engine::SceneView, questions: &[Question]) -> Result<Vec<Grid<f32>>> {
        self.engine.set_questions(questions)?;
        Ok(self.engine.show(view, Ask::Now(None), VALUES)?.scores)
    }
}

impl FrameSource for SceneSource {
    fn info(&self) -> &Info {
        &self.info
    }

    fn original(&mut self, frame: usize) -> Result<RgbImage> {
        let missing =
            || Error::input("the recorded frames are not at hand", "Put the recording where it was.");
        self.engine.original(frame)?.ok_or_else(missing)
    }

    fn instruments(&mut self, frame: usize) -> Result<Option<Mask>> {
        self.engine.instruments(frame)
    }

    fn render(&mut self, view: &View, with_features: bool) -> Result<Rendering> {
        let engine_view = self.engine_view(view)?;
        let recorded_depth = self.recorded_depth(view)?;
        let ask = if with_features { Ask::Later } else { Ask::Nothing };
        let shown = self.engine.show(&engine_view, ask, Wanted { pictures: true, values: true })?;
        let missing = || Error::input("the picture did not come back", "");
        let colour = shown.picture.ok_or_else(missing)?;
        let depth = shown.depth.ok_or_else(missing)?;
        let unseen = if view.orbit.is_home() {
            self.pivot_depth = middle_depth(&depth).unwrap_or(self.pivot_depth);
            None
        } else {
            Some(self.engine.unseen(&engine_view, &depth, view.frame, &recorded_depth)?)
        };
        Ok(Rendering { colour, depth, unseen })
    }

    fn motion(&mut self, view: &View) -> Result<(Grid<f32>, String)> {
        let view = self.engine_view(view)?;
        let Motion { travel_px, num_moving, num_gaussians } = self.engine.motion(&view);
        let [moving, all] = [num_moving, num_gaussians].map(thousands);
        Ok((travel_px, format!("{moving} of {all} Gaussians move by a pixel or more")))
    }

    fn opacity(&mut self, view: &View) -> Result<Grid<f32>> {
        let view = self.engine_view(view)?;
        self.engine.opacity(&view)
    }

    fn scores(&mut self, view: &View, questions: &[Question]) -> Vec<Result<Grid<f32>>> {
        let view = match self.engine_view(view) {
            Ok(view) => view,
            Err(e) => return questions.iter().map(|_| Err(Error::input(e.to_string(), ""))).collect(),
        };
        if let Ok(scores) = self.ask(&view, questions) {
            return scores.into_iter().map(Ok).collect();
        }
        // One by one, so that words that cannot be read fail alone.
        let one = |question: &Question| {
            let missing = || Error::input("there is no score for these words", "");
            self.ask(&view, std::slice::from_ref(question)).and_then(|mut s| s.pop().ok_or_else(missing))
        };
        questions.iter().map(one).collect()
    }

    fn sample(&mut self, view: &View, point: [f32; 2]) -> Result<Option<Sample>> {
        let view = self.engine_view(view)?;
        let [x, y] = [(point[0], view.camera.width), (point[1], view.camera.height)]
            .map(|(share, n)| ((share * n as f32) as usize).min(n.saturating_sub(1) as usize));
        self.engine.sample(&view, [x, y])
    }

    fn clock(&self) -> FrameClock {
        self.engine.clock().clone()
    }
}

/// Returns the folder that holds `path`, or the user's own folder if that cannot be written to.
fn output_folder(path: &Path) -> PathBuf {
    let beside = path.parent().filter(|p| tempfile::tempfile_in(p).is_ok());
    let own = || dirs::document_dir().or_else(dirs::home_dir).unwrap_or_else(std::env::temp_dir);
    beside.map_or_else(own, Path::to_owned)
}

/// Returns the median depth in the middle of the picture.
fn middle_depth(depth: &Grid<f32>) -> Option<f32> {
    let rows = depth.height / 3..(2 * depth.height).div_ceil(3);
    let columns = depth.width / 3..(2 * depth.width).div_ceil(3);
    let mut depths: Vec<f32> =
        rows.flat_map(|y| depth.row(y)[columns.clone()].iter().copied()).filter(|d| *d > 0.0).collect();
    let middle = depths.len() / 2;
    (!depths.is_empty()).then(|| *depths.select_nth_unstable_by(middle, f32::total_cmp).1)
}

/// Returns class names as example prompts, without those of the background.
fn examples<'a>(names: impl Iterator<Item = &'a str>) -> Vec<String> {
    names.filter(|n| !n.contains("background")).map(str::to_owned).collect()
}

/// A recording that is not reconstructed yet.
struct RecordingSource {
    frame: Box<dyn Fn(usize) -> Result<RgbImage> + Send>,
    info: Info,
}

impl RecordingSource {
    fn new(material: &Material, path: PathBuf) -> Self {
        let sequence = material.sequence().clone();
        let info = Info {
            name: sequence.name(),
            output_folder: output_folder(&path),
            recording: Some(path.clone()),
            path,
            sequence: Some(full_path(sequence.path())),
            frames_sha256: Some(sequence.outline().outline_digest()),
            num_frames: sequence.num_frames(),
            width: sequence.width(),
            height: sequence.height(),
            frames_per_second: sequence.frames_per_second(),
            camera_moves: sequence.camera_moves(),
            has_original: true,
            has_labels: material.prepared().is_some() || !sequence.classes().is_empty(),
            example_prompts: examples(sequence.classes().iter().map(|c| c.name.as_str())),
            ..Info::default()
        };
        Self { frame: Box::new(move |i| sequence.frame(i)), info }
    }

    /// Makes a source of the demo that is being written to `path`.
    fn of_demo(demo: demo::Demo, path: &Path) -> Self {
        let DemoSettings { width, height, frames, moving_camera, .. } = *demo.settings();
        let info = Info {
            name: path.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default(),
            output_folder: output_folder(path),
            path: path.to_owned(),
            recording: Some(path.to_owned()),
            sequence: Some(full_path(path)),
            num_frames: frames,
            width,
            height,
            frames_per_second: Some(demo::FRAMES_PER_SECOND),
            camera_moves: moving_camera,
            has_original: true,
            has_labels: true,
            ..Info::default()
        };
        Self { frame: Box::new(move |i| Ok(demo.frame(i).colour)), info }
    }
}

impl FrameSource for RecordingSource {
    fn info(&self) -> &Info {
        &self.info
    }
    fn original(&mut self, frame: usize) -> Result<RgbImage> {
        (self.frame)(frame)
    }
    fn render(&mut self, _: &View, _: bool) -> Result<Rendering> {
        Err(not_reconstructed())
    }
    fn motion(&mut self, _: &View) -> Result<(Grid<f32>, String)> {
        Err(not_reconstructed())
    }
    fn opacity(&mut self, _: &View) -> Result<Grid<f32>> {
        Err(not_reconstructed())
    }
    fn scores(&mut self, _: &View, questions: &[Question]) -> Vec<Result<Grid<f32>>> {
        questions.iter().map(|_| Err(not_reconstructed())).collect()
    }
}

fn not_reconstructed() -> Error {
    Error::input("this recording has not been reconstructed yet", "Press Reconstruct.")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::viewer::jobs::{Job, JobEvent};

    /// Waits for the result of a job. With `until_told`, returns `None` once the job reports that something
    /// is not saved yet.
    fn wait(job: &mut Job<()>, until_told: bool) -> Option<Result<()>> {
        loop {
            match job.poll() {
                Some(JobEvent::Done(result)) => return Some(result),
                _ if until_told && job.progress.stage == NOT_SAVED => return None,
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
            Job::start("saving", &egui::Context::default(), move |job| {
                save_with_patience(7, &|| scene.save(&to), job)
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
        let tiny = DemoSettings { width: 32, height: 24, frames: 4, ..DemoSettings::default() };
        demo::write(&tiny, &recording, &mut |_, _| {}).unwrap();
        std::fs::create_dir(&prepared).unwrap();
        std::fs::write(prepared.join("mine"), "hours of work").unwrap();
        let request = TrainRequest { recording, scene: scene.clone(), iterations: 3, excluded: Vec::new() };
        let train = move |job: &JobContext| EngineBackend.reconstruct(&request, job).map(drop);
        let mut job = Job::start("training", &egui::Context::default(), train);
        wait(&mut job, false).unwrap().unwrap();
        assert!(Scene::load(&scene).unwrap().codec.is_some());
        assert_eq!(std::fs::read_to_string(prepared.join("mine")).unwrap(), "hours of work");
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 3, "and no other");
    }

    #[test]
    fn the_pivot_is_what_the_middle_of_the_picture_shows() {
        let mut depth = Grid::filled(9, 9, 10.0);
        (0..9).for_each(|x| depth.set(x, 4, 50.0));
        assert_eq!(middle_depth(&depth), Some(10.0));
        assert_eq!(middle_depth(&Grid::filled(9, 9, 0.0)), None);
        assert_eq!(middle_depth(&Grid::filled(0, 0, 0.0)), None);
        assert_eq!(middle_depth(&Grid::filled(1, 1, 3.0)), Some(3.0));
    }
}
