//! The real engine behind the window's seam.

use super::{
    jobs::JobContext,
    measure::Lens,
    negatives::Negatives,
    source::{Backend, Demo, ExportRequest, ExportSummary, FrameSource, Info, Rendering, TrainRequest, View},
    training::DEFAULT_STEPS,
    widgets::thousands,
};
use crate::{
    engine::{self, Ask, Engine, EngineOptions},
    jobs::{self, DemoPaths, Material, PrepareOptions, Progress},
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
    export::{ExportOptions, ExportPrompt, Source},
    grid::Grid,
    raster::FrameClock,
    relevancy::RelevancySettings,
    scene::Scene,
    sequence::Sequence,
    train::{TrainSettings, Trainer},
};
use surgtpgs_render::Wanted;

/// Time between two states of a training that are shown.
const PREVIEW_EVERY: Duration = Duration::from_secs(4);
/// Steps before the first state is worth showing.
const FIRST_PREVIEW: usize = 60;

/// Opens, exports and trains with the program's own engine.
pub(crate) struct EngineBackend;

impl Backend for EngineBackend {
    fn open(&self, path: &Path) -> Result<Box<dyn FrameSource>> {
        if path.extension().is_some_and(|e| e.eq_ignore_ascii_case("safetensors")) {
            let engine = Engine::open(path, EngineOptions::default())?;
            Ok(Box::new(SceneSource::new(engine, path.to_owned())))
        } else {
            Ok(Box::new(RecordingSource::new(&Material::open(path)?, path.to_owned())))
        }
    }

    fn demo(&self, folder: &Path, job: &JobContext) -> Result<Demo> {
        let paths = DemoPaths::under(folder);
        if paths.scene.is_file() {
            return Ok(Demo { path: paths.scene, train: None });
        }
        if Sequence::open(&paths.recording).is_err() {
            jobs::remove_folder(&paths.recording)?;
            demo::write(&DemoSettings::default(), &paths.recording, &mut |done, total| {
                job.progress("recording the demo", done, total, String::new());
            })?;
        }
        let train = TrainRequest {
            recording: paths.recording.clone(),
            scene: paths.scene,
            iterations: DEFAULT_STEPS,
        };
        Ok(Demo { path: paths.recording, train: Some(train) })
    }

    fn export(&self, request: &ExportRequest, job: &JobContext) -> Result<ExportSummary> {
        let mut engine = Engine::open(&request.scene, EngineOptions::default())?;
        let words: Vec<String> = request.prompts.iter().map(|p| p.text.clone()).collect();
        engine.set_prompts(&words)?;
        let chosen = |(mut prompt, wanted): (ExportPrompt, &super::source::ExportPrompt)| {
            (prompt.threshold, prompt.colour) = (wanted.threshold, wanted.colour);
            prompt
        };
        let prompts = jobs::export_prompts(&engine).into_iter().zip(&request.prompts).map(chosen).collect();
        let options = ExportOptions {
            formats: request.formats.clone(),
            source: if request.from_original { Source::Original } else { Source::Reconstruction },
            exclusive: request.is_exclusive,
            style: request.style,
            opacity: request.opacity,
            ..Default::default()
        };
        let asked = jobs::ExportRequest {
            scene: &request.scene,
            folder: &request.folder,
            frames: (request.frames.0..=request.frames.1).collect(),
            prompts,
            options,
            overwrite: false,
        };
        let done = jobs::export(&mut engine, asked, &mut |p| watch(job, p))?;
        Ok(ExportSummary {
            is_complete: done.complete,
            num_files: done.files,
            folder: request.folder.clone(),
        })
    }

    fn reconstruct(&self, request: &TrainRequest, job: &JobContext) -> Result<PathBuf> {
        require_writable(&request.scene)?;
        let material = match Material::open(&request.recording)? {
            Material::Bare(sequence) if !sequence.classes().is_empty() => {
                let folder = request.scene.with_extension("prepared");
                jobs::remove_folder(&folder)?;
                let options = PrepareOptions::default();
                Material::Prepared(Box::new(jobs::prepare(sequence, &folder, &options, &mut |p| {
                    watch(job, p)
                })?))
            }
            other => other,
        };
        job.check()?;
        let settings = TrainSettings { iterations: request.iterations, ..Default::default() };
        let mut last_shown = Instant::now();
        let mut show = |trainer: &mut Trainer| {
            let is_first = trainer.steps_done() == FIRST_PREVIEW;
            if is_first || (trainer.steps_done() > FIRST_PREVIEW && last_shown.elapsed() >= PREVIEW_EVERY) {
                last_shown = Instant::now();
                if let Ok(source) = trainer.scene().and_then(|scene| preview(scene, &request.recording)) {
                    job.preview(Box::new(source));
                }
            }
        };
        let trained = jobs::train_watched(
            &material,
            settings,
            engine::Backend::Auto,
            &mut |p| watch(job, p),
            &mut show,
        )?;
        if trained.steps == 0 {
            return Err(Error::Cancelled);
        }
        trained.scene.save(&request.scene)?;
        Ok(request.scene.clone())
    }
}

/// Nobody shall wait for a training whose result cannot be saved.
fn require_writable(file: &Path) -> Result<()> {
    let folder = file.parent().unwrap_or(Path::new("."));
    match tempfile::tempfile_in(folder) {
        Ok(_) => Ok(()),
        Err(_) => Err(Error::input_at(folder, "this folder cannot be written to", "Save it in another one.")),
    }
}

/// Passes on how far a job is, and whether it is to stop.
fn watch(job: &JobContext, progress: &Progress<'_>) -> ControlFlow<()> {
    job.progress(progress.stage, progress.done, progress.total, progress.detail.to_owned());
    job.rest_while_paused();
    if job.is_cancelled() { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
}

/// A scene in the making.
fn preview(scene: Scene, recording: &Path) -> Result<SceneSource> {
    let engine = Engine::new(Arc::new(scene), None, EngineOptions::default())?;
    Ok(SceneSource::new(engine, recording.to_owned()))
}

/// A scene, with its recording if that is still there.
struct SceneSource {
    engine: Engine,
    info: Info,
    /// Distance to what the endoscope looks at, scene units; the point to turn around.
    pivot_depth: f32,
}

impl SceneSource {
    fn new(engine: Engine, path: PathBuf) -> Self {
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
        let info = Info {
            name: scene.provenance.sequence_name.clone(),
            output_folder: output_folder(&path),
            path,
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
        Self { engine, info, pivot_depth: 1.0 }
    }

    fn engine_view(&mut self, view: &View) -> Result<engine::View> {
        let recorded = self.engine.view(view.frame)?;
        let full = if view.orbit.is_home() {
            recorded
        } else {
            engine::View::free(recorded.time, view.orbit.apply(&recorded.camera, self.pivot_depth))
        };
        let half = |n: u32| (n / 2).max(1);
        Ok(if view.is_preview {
            full.resized(half(full.camera.width), half(full.camera.height))
        } else {
            full
        })
    }

    /// Scores of prompts that can all be asked together.
    fn ask(&mut self, view: &engine::View, prompts: &[&str]) -> Result<Vec<Grid<f32>>> {
        let words: Vec<String> = prompts.iter().map(|p| (*p).to_owned()).collect();
        self.engine.set_prompts(&words)?;
        let wanted = Wanted { pictures: false, values: true };
        Ok(self.engine.show(view, Ask::Now(None), wanted)?.scores)
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

    fn render(&mut self, view: &View, with_features: bool) -> Result<Rendering> {
        let engine_view = self.engine_view(view)?;
        let ask = if with_features { Ask::Later } else { Ask::Nothing };
        let shown = self.engine.show(&engine_view, ask, Wanted { pictures: true, values: true })?;
        let missing = || Error::input("the picture did not come back", "");
        let colour = shown.picture.ok_or_else(missing)?;
        let depth = shown.depth.ok_or_else(missing)?;
        if view.orbit.is_home() {
            self.pivot_depth = middle_depth(&depth).unwrap_or(self.pivot_depth);
        }
        Ok(Rendering { colour, depth })
    }

    fn set_negatives(&mut self, negatives: &Negatives) -> Result<()> {
        let present = self.engine.settings();
        if (&present.phrases, present.class_negatives) == (&negatives.phrases, negatives.uses_classes) {
            return Ok(());
        }
        let settings = RelevancySettings {
            phrases: negatives.phrases.clone(),
            class_negatives: negatives.uses_classes,
            ..present.clone()
        };
        self.engine.set_settings(settings)
    }

    fn scores(&mut self, view: &View, prompts: &[&str]) -> Vec<Result<Grid<f32>>> {
        let view = match self.engine_view(view) {
            Ok(view) => view,
            Err(e) => return prompts.iter().map(|_| Err(Error::input(e.to_string(), ""))).collect(),
        };
        if let Ok(scores) = self.ask(&view, prompts) {
            return scores.into_iter().map(Ok).collect();
        }
        // One by one, so that the words that cannot be read do not silence the others.
        let one = |prompt: &&str| {
            let missing = || Error::input("there is no score for these words", "");
            self.ask(&view, &[prompt]).and_then(|mut s| s.pop().ok_or_else(missing))
        };
        prompts.iter().map(one).collect()
    }

    fn clock(&self) -> FrameClock {
        self.engine.clock().clone()
    }
}

/// The folder that holds `path`, or the user's own one where that cannot be written to.
fn output_folder(path: &Path) -> PathBuf {
    let beside = path.parent().filter(|p| tempfile::tempfile_in(p).is_ok());
    let own = || dirs::document_dir().or_else(dirs::home_dir).unwrap_or_else(std::env::temp_dir);
    beside.map_or_else(own, Path::to_owned)
}

/// The median depth of the middle of the picture.
fn middle_depth(depth: &Grid<f32>) -> Option<f32> {
    let rows = depth.height / 3..(2 * depth.height).div_ceil(3);
    let columns = depth.width / 3..(2 * depth.width).div_ceil(3);
    let mut depths: Vec<f32> =
        rows.flat_map(|y| depth.row(y)[columns.clone()].iter().copied()).filter(|d| *d > 0.0).collect();
    let middle = depths.len() / 2;
    (!depths.is_empty()).then(|| *depths.select_nth_unstable_by(middle, f32::total_cmp).1)
}

/// Class names to begin with: not what surrounds the picture.
fn examples<'a>(names: impl Iterator<Item = &'a str>) -> Vec<String> {
    names.filter(|n| !n.contains("background")).map(str::to_owned).collect()
}

/// A recording that is not reconstructed yet.
struct RecordingSource {
    sequence: Sequence,
    info: Info,
}

impl RecordingSource {
    fn new(material: &Material, path: PathBuf) -> Self {
        let sequence = material.sequence().clone();
        let info = Info {
            name: sequence.name(),
            output_folder: output_folder(&path),
            path,
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
        Self { sequence, info }
    }
}

impl FrameSource for RecordingSource {
    fn info(&self) -> &Info {
        &self.info
    }
    fn original(&mut self, frame: usize) -> Result<RgbImage> {
        self.sequence.frame(frame)
    }
    fn render(&mut self, _: &View, _: bool) -> Result<Rendering> {
        Err(not_reconstructed())
    }
    fn scores(&mut self, _: &View, prompts: &[&str]) -> Vec<Result<Grid<f32>>> {
        prompts.iter().map(|_| Err(not_reconstructed())).collect()
    }
}

fn not_reconstructed() -> Error {
    Error::input("this recording has not been reconstructed yet", "Press Reconstruct.")
}

#[cfg(test)]
mod tests {
    use super::*;

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
