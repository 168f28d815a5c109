//! A scene as the window's source of pictures.

use super::info::{examples, output_folder};
use crate::engine::{self, Answer, Ask, Engine, Motion, Pending, Question, Sample, Tools};
use crate::viewer::{
    backend::{FrameSource, FrameView, Info, Lens, Parts, Rendering, orbit::Orbit, task::lock},
    text::thousands,
};
use image::RgbImage;
use std::{
    ops::Range,
    path::PathBuf,
    sync::{Arc, Mutex},
};
use surgtpgs_core::{
    Error, Result,
    files::full_path,
    grid::{Grid, Mask},
    marks::{LookHere, Mark, Marks},
    raster::FrameClock,
    scene::Scene,
    sequence::Sequence,
};
use surgtpgs_render::{Shown, Wanted};

/// A scene, with its recording if that is still there.
pub(super) struct SceneSource {
    engine: Engine,
    info: Info,
    /// Turn of the view that was turned last, and distance to the point that the endoscope looks at, scene
    /// units, on the frame where it was turned so. Views turn around this point.
    pivot: Option<(Orbit, f32)>,
    /// Depth of the endoscope's own view, for the view that was turned last.
    home_depth: Option<(FrameView, Arc<Grid<f32>>)>,
    /// Place for the engine's tools at its end.
    spare: Option<SpareTools>,
}

/// Tools of a source that is no longer shown, for a later one.
pub(super) type SpareTools = Arc<Mutex<Option<Tools>>>;

impl Drop for SceneSource {
    fn drop(&mut self) {
        if let Some(spare) = &self.spare {
            *lock(spare) = Some(self.engine.give_tools());
        }
    }
}

impl SceneSource {
    /// Leaves the engine's tools in a place at its end.
    pub(super) fn leaving_tools(mut self, spare: &SpareTools) -> Self {
        self.spare = Some(Arc::clone(spare));
        self
    }

    pub(super) fn new(engine: Engine, path: PathBuf, recording: Option<PathBuf>) -> Self {
        let scene = engine.scene();
        let size = scene.cameras.first().map_or((0, 0), |c| (c.width as usize, c.height as usize));
        let moves =
            |c: &surgtpgs_core::camera::Camera| c.camera_from_world != scene.cameras[0].camera_from_world;
        let count = format!("{} Gaussians", thousands(scene.gaussians.len()));
        let mut notes = vec![(count, "What the reconstruction is made of.".to_owned())];
        let chapters = scene.chapters.iter().len();
        let missing = scene.chapters.num_missing(scene.num_frames());
        if chapters > 1 {
            let why = "A long recording is reconstructed in parts, each with Gaussians of its own.";
            notes.push((format!("{chapters} parts"), why.to_owned()));
        }
        if chapters > 0 && missing > 0 {
            let why = "These frames are in none of the parts that are done.";
            notes.push((format!("{} frames are not reconstructed", thousands(missing)), why.to_owned()));
        }
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
            made_before: None,
            path,
            recording,
            sequence: Some(sequence).filter(|p| !p.as_os_str().is_empty()),
            frames_sha256: identity.map(|identity| identity.outline_digest()),
            spots_sha256: identity.and_then(|identity| identity.spots_digest()),
            num_frames: scene.num_frames(),
            frame_names: engine.frame_sources().into(),
            width: size.0,
            height: size.1,
            frames_per_second: scene.provenance.frames_per_second,
            frame_seconds: scene.provenance.frame_seconds.as_slice().into(),
            camera_moves: scene.cameras.iter().any(moves),
            lens: scene.cameras.first().map(|c| Lens { fx: c.fx, fy: c.fy, cx: c.cx, cy: c.cy }),
            has_original: engine.sequence().is_some(),
            original_missing: engine.recording_missing().map(str::to_owned),
            has_reconstruction: true,
            learned: learned(scene),
            unlearned: scene.chapters.gaps(scene.num_frames()),
            has_measured_depth: engine.depth_origin().is_measured(),
            has_features: scene.codec.is_some(),
            has_labels: engine.sequence().is_some_and(|s| !s.classes().is_empty()),
            example_prompts: examples(scene.classes.iter().map(|(class, _)| class.name.as_str())),
            notes,
        };
        Self { engine, info, pivot: None, home_depth: None, spare: None }
    }

    fn engine_view(&mut self, view: &FrameView) -> Result<engine::SceneView> {
        let recorded = self.engine.view(view.frame)?;
        let full = if view.orbit.is_home() {
            recorded
        } else {
            let pivot_depth = self.pivot_depth(view)?;
            engine::SceneView::free(recorded.time, view.orbit.apply(&recorded.camera, pivot_depth))
        };
        let half = |n: u32| (n / 2).max(1);
        Ok(if view.is_preview {
            full.resized(half(full.camera.width), half(full.camera.height))
        } else {
            full
        })
    }

    /// Returns the distance to the point that a turned view turns around. It stays while other frames are shown
    /// from the same side.
    fn pivot_depth(&mut self, view: &FrameView) -> Result<f32> {
        if let Some((_, depth)) = self.pivot.filter(|(orbit, _)| *orbit == view.orbit) {
            return Ok(depth);
        }
        let depth = middle_depth(&*self.recorded_depth(view)?).unwrap_or(1.0);
        self.pivot = Some((view.orbit, depth));
        Ok(depth)
    }

    /// Returns the depth of the endoscope's own view on the frame of a view, at the view's size.
    fn recorded_depth(&mut self, view: &FrameView) -> Result<Arc<Grid<f32>>> {
        let home = FrameView { orbit: Orbit::default(), ..*view };
        if let Some((_, depth)) = self.home_depth.as_ref().filter(|(of, _)| *of == home) {
            return Ok(depth.clone());
        }
        let engine_view = self.engine_view(&home)?;
        let wanted = Wanted { depth: true, ..Wanted::default() };
        let shown = self.engine.show(&engine_view, Ask::Nothing, wanted)?;
        let depth = Arc::new(shown.depth.unwrap_or_default());
        self.home_depth = Some((home, depth.clone()));
        Ok(depth)
    }

    /// Returns the scores of several questions; fails if one of them cannot be asked.
    fn ask(&mut self, view: &engine::SceneView, questions: &[Question]) -> Result<Vec<Grid<f32>>> {
        self.engine.set_questions(questions)?;
        let wanted = Wanted { scores: true, ..Wanted::default() };
        Ok(self.engine.show(view, Ask::Now, wanted)?.scores)
    }
}

impl FrameSource for SceneSource {
    fn info(&self) -> &Info {
        &self.info
    }

    fn shot_of(&self, frame: usize) -> Range<usize> {
        self.engine.scene().shot_of(frame)
    }

    fn original(&mut self, frame: usize) -> Result<RgbImage> {
        let missing =
            || Error::input("the recorded frames are not at hand", "Put the recording where it was.");
        self.engine.original(frame)?.ok_or_else(missing)
    }

    fn instruments(&mut self, frame: usize) -> Result<Option<Mask>> {
        self.engine.instruments(frame)
    }

    fn render(&mut self, view: &FrameView, parts: Parts) -> Result<Rendering> {
        let engine_view = self.engine_view(view)?;
        // A picture is told which of its pixels the endoscope did not see.
        let is_turned = parts.colour && !view.orbit.is_home();
        let recorded_depth = if is_turned { self.recorded_depth(view)? } else { Arc::default() };
        let ask = if parts.features { Ask::Later } else { Ask::Nothing };
        let wanted = Wanted { picture: parts.colour, depth: parts.depth || is_turned, scores: false };
        let Shown { picture, depth, .. } = self.engine.show(&engine_view, ask, wanted)?;
        let unseen = |depth| self.engine.unseen(&engine_view, depth, view.frame, &recorded_depth);
        let unseen = depth.as_ref().filter(|_| is_turned).map(unseen).transpose()?;
        Ok(Rendering { colour: picture, depth, unseen })
    }

    fn motion(&mut self, view: &FrameView) -> Result<(Grid<f32>, String)> {
        let view = self.engine_view(view)?;
        let Motion { travel_px, num_moving, num_gaussians } = self.engine.motion(&view)?;
        let [moving, all] = [num_moving, num_gaussians].map(thousands);
        Ok((travel_px, format!("{moving} of {all} Gaussians move by a pixel or more")))
    }

    fn opacity(&mut self, view: &FrameView) -> Result<Grid<f32>> {
        let view = self.engine_view(view)?;
        self.engine.opacity(&view)
    }

    fn scores(&mut self, view: &FrameView, questions: &[Question]) -> Vec<Result<Grid<f32>>> {
        let view = match self.engine_view(view) {
            Ok(view) => view,
            Err(e) => return questions.iter().map(|_| Err(Error::input(e.to_string(), ""))).collect(),
        };
        match self.ask(&view, questions) {
            Ok(scores) => return scores.into_iter().map(Ok).collect(),
            Err(Error::Cancelled) => return questions.iter().map(|_| Err(Error::Cancelled)).collect(),
            // One by one, so that words that cannot be read fail alone.
            Err(_) => {}
        }
        let one = |question: &Question| {
            let missing = || Error::input("there is no score for these words", "");
            self.ask(&view, std::slice::from_ref(question)).and_then(|mut s| s.pop().ok_or_else(missing))
        };
        questions.iter().map(one).collect()
    }

    fn answers(&mut self, questions: &[Question]) -> Vec<Option<Answer>> {
        let one = |question: &Question| {
            self.engine.set_questions(std::slice::from_ref(question)).ok()?;
            self.engine.answers().first().cloned()
        };
        questions.iter().map(one).collect()
    }

    fn sample(&mut self, view: &FrameView, point: [f32; 2]) -> Result<Option<Sample>> {
        let view = self.engine_view(view)?;
        let [x, y] = [(point[0], view.camera.width), (point[1], view.camera.height)]
            .map(|(share, n)| ((share * n as f32) as usize).min(n.saturating_sub(1) as usize));
        self.engine.sample(&view, [x, y])
    }

    fn set_marks(&mut self, marks: &[Mark]) -> Result<()> {
        let marks = Marks::new(marks.to_vec(), &self.engine.canvas())?;
        self.engine.set_marks(marks)
    }

    fn carry_marks(&mut self, view: &FrameView) -> Result<()> {
        let time = self.engine.view(view.frame)?.time;
        self.engine.carry_marks(time)
    }

    fn look_here(&mut self, frame: usize) -> Result<Option<LookHere>> {
        self.engine.look_here_on(frame)
    }

    fn leave_off_for(&mut self, pending: &Arc<Pending>) {
        self.engine.leave_off_for(pending.clone());
    }

    fn answers_at_once(&self, view: &FrameView) -> bool {
        self.engine.answers_at_once(view.frame)
    }

    fn renderer(&self) -> String {
        self.engine.renderer_name()
    }

    fn clock(&self) -> FrameClock {
        self.engine.clock().clone()
    }
}

/// Returns the share of its training that a scene has had, 0–1; 1 where nothing is known.
fn learned(scene: &Scene) -> f32 {
    let planned = scene.provenance.planned_steps();
    planned.map_or(1.0, |planned| (scene.provenance.steps as f32 / planned as f32).min(1.0))
}

/// Returns the median depth in the middle of the picture; `None` where nothing is there.
fn middle_depth(depth: &Grid<f32>) -> Option<f32> {
    let rows = depth.height / 3..(2 * depth.height).div_ceil(3);
    let columns = depth.width / 3..(2 * depth.width).div_ceil(3);
    let mut depths: Vec<f32> =
        rows.flat_map(|y| depth.row(y)[columns.clone()].iter().copied()).filter(|d| *d > 0.0).collect();
    let middle = depths.len() / 2;
    (!depths.is_empty()).then(|| *depths.select_nth_unstable_by(middle, f32::total_cmp).1)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::engine::{
        BackendChoice, Negatives,
        asking_tests::{adapter, engine_on},
    };
    use surgtpgs_core::{marks::Shape, relevancy::RelevancySettings};
    use surgtpgs_render::Traffic;

    #[test]
    fn only_what_is_shown_is_read_back_from_a_gpu() {
        if adapter().is_none() {
            return;
        }
        let engine = engine_on(BackendChoice::Gpu, &["liver", "fat", "grasper"], &[]);
        let camera = engine.scene().cameras[0];
        let pixels = u64::from(camera.width * camera.height);
        let mut source = SceneSource::new(engine, PathBuf::new(), None);
        let traffic = |source: &mut SceneSource| source.engine.gpu().unwrap().gpu().traffic();
        let read_back = |source: &mut SceneSource, before: Traffic| traffic(source).since(&before).read_back;
        let negatives = Negatives::of(&RelevancySettings::default());
        let questions = ["liver", "fat"].map(|words| Question::words(words, negatives.clone()));
        let (view, none) = (FrameView::default(), Parts::default());
        // Counts of pairs and of open pixels.
        const COUNTS: u64 = 64;
        for (parts, values) in [
            (Parts { features: true, ..none }, 0),
            (Parts { features: true, colour: true, depth: false }, 1),
            (Parts { features: true, colour: true, depth: true }, 2),
        ] {
            let before = traffic(&mut source);
            let rendering = source.render(&view, parts).unwrap();
            assert_eq!((rendering.colour.is_some(), rendering.depth.is_some()), (parts.colour, parts.depth));
            let bytes = read_back(&mut source, before);
            assert!(
                (4 * values * pixels..4 * values * pixels + COUNTS).contains(&bytes),
                "{parts:?}: {bytes}"
            );
        }
        let before = traffic(&mut source);
        assert!(source.scores(&view, &questions).iter().all(Result::is_ok));
        let bytes = read_back(&mut source, before);
        // Both scores, and once more where pixels were left open, which come back as well: less than with depth.
        assert!(bytes < 2 * 3 * 4 * pixels, "{bytes}");
    }

    #[test]
    fn marks_correct_scores_that_a_gpu_computes() {
        if adapter().is_none() {
            return;
        }
        let engine = engine_on(BackendChoice::Gpu, &["liver", "fat", "grasper"], &[]);
        let camera = engine.scene().cameras[0];
        let pixels = u64::from(camera.width * camera.height);
        let mut source = SceneSource::new(engine, PathBuf::new(), None);
        let corners_px = [[0.0; 2], [camera.width as f32, camera.height as f32]];
        source.set_marks(&[Mark::new(0, "liver", false, Shape::Box { corners_px })]).unwrap();
        let negatives = Negatives::of(&RelevancySettings::default());
        let questions = ["liver", "fat"].map(|words| Question::words(words, negatives.clone()));
        let view = FrameView::default();
        // The first answer renders the marked frame, too.
        assert!(source.scores(&view, &questions).iter().all(Result::is_ok));
        source.engine.forget_last();
        let before = source.engine.gpu().unwrap().gpu().traffic();
        let scores = source.scores(&view, &questions);
        let bytes = source.engine.gpu().unwrap().gpu().traffic().since(&before).read_back;
        assert!(bytes < 2 * 3 * 4 * pixels, "{bytes}: as without marks");
        let area = |scores: &Result<Grid<f32>>| {
            scores.as_ref().unwrap().data.iter().filter(|score| **score > 0.5).count()
        };
        let [liver, fat] = [0, 1].map(|k| area(&scores[k]));
        assert!(liver == 0 && fat > 20, "{liver} {fat}");
    }

    #[test]
    fn a_scene_that_was_stopped_early_knows_it() {
        let mut scene = surgtpgs_core::stress::ordinary(4);
        assert_eq!(learned(&scene), 1.0, "nothing is known");
        scene.provenance.settings = serde_json::json!({ "iterations": 4000 });
        for (steps, share) in [(1000, 0.25), (4000, 1.0), (5000, 1.0)] {
            scene.provenance.steps = steps;
            assert_eq!(learned(&scene), share);
        }
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
