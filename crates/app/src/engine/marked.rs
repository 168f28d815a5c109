//! Marks by hand in an engine: scores of the names that they give, and corrections of what features find.

use super::{Engine, Recorded, SceneView, asking::Asking, blank, open_relevancy};
use crate::memory::{Work, require_for};
use std::{collections::BTreeMap, path::Path, sync::Arc};
use surgtpgs_clip::SegmentAnything;
use surgtpgs_core::{
    Error, Result,
    grid::Grid,
    marks::{Canvas, Carried, CarrySettings, ChapterMarks, Correction, FrameScores, Graph, LookHere, Marks},
    raster::{FramePass, Images, Renderer, render_frame},
    relevancy::Relevancy,
    scene::Scene,
};

/// Number of pictures that are read for a frame before a request for another one is answered first: what is
/// shown while the time bar is dragged reads fewer.
const MOST_READ: usize = 8;

/// Largest number of score images without corrections that are kept for the next mark.
const MOST_BEFORE: usize = 32;

/// Scores of names on frames without corrections, by name and frame.
type ScoresBefore = BTreeMap<(String, usize), Arc<Grid<f32>>>;

/// Marks, carried to the scene or to the chapter of it that is at hand.
pub(super) struct MarksInScene {
    /// Marks by hand that were carried.
    by_hand: Arc<Marks>,
    /// Names that are none of the scene's classes.
    carried: Carried,
    /// Corrections of what features find, by name.
    corrections: BTreeMap<String, Correction>,
    /// Scores of these names on marked frames.
    before: ScoresBefore,
    /// Scores of the last frame, in the order of the carried names.
    last: Option<(usize, FrameScores)>,
}

impl Engine {
    /// Returns the recording that marks are made on.
    pub fn canvas(&self) -> Canvas {
        let size = self.scene.cameras.first().map_or([0; 2], |c| [c.width, c.height]);
        let [width, height] = size.map(|side| side as usize);
        let frame_names = self.frame_sources();
        Canvas { width, height, frame_names, num_frames: self.scene.num_frames() }
    }

    /// Reads a file of marks, see [`Engine::set_marks`]. With a folder of a Segment Anything, clicks and boxes
    /// become the masks that it finds there first. Both are inputs from now on.
    pub fn read_marks(&mut self, path: &Path, model: Option<&Path>) -> Result<()> {
        let mut marks = Marks::read_for(path, &self.canvas(), || self.sequence().cloned())?;
        let mut network_sha256 = None;
        if let Some(folder) = model {
            let Some(sequence) = self.sequence() else {
                let what = "the recording is not at hand, in which masks of clicks and boxes are looked for";
                return Err(Error::input(what, "Name it with --sequence."));
            };
            let mut network = SegmentAnything::open(folder)?;
            marks = marks.with_masks(&mut network, &self.scene.field_of_view, |i| sequence.frame(i))?;
            network_sha256 = Some(network.sha256().to_owned());
        }
        self.set_marks(marks)?;
        self.marks_model_sha256 = network_sha256;
        (self.marks_file, self.marks_model) = (Some(path.to_owned()), model.map(Path::to_owned));
        Ok(())
    }

    /// Takes marks in place of earlier ones. From now on prompts find what was marked, and marks of the scene's
    /// own classes, by whatever name, correct them. Where features have no classes, marks correct the prompts
    /// that have their name. Any other name has to be shown by some mark: where marks only say what it is not,
    /// it cannot be looked for. If there are other names than before, the prompts are forgotten.
    ///
    /// Marks are carried to the Gaussians when the first prompt is asked, in each chapter of a long scene anew.
    pub fn set_marks(&mut self, marks: Marks) -> Result<()> {
        let marks = marks.joined(Asking::class_names(&self.scene, &self.settings));
        let num_carried = marks.shown_names().iter().filter(|name| !self.scene.finds(name)).count();
        if let Some(camera) = self.scene.cameras.first().filter(|_| num_carried > 0) {
            require_for(&Work::Marks(camera.width, camera.height, num_carried))?;
        }
        let names = names_to_know(&self.scene, &marks);
        if names != self.marks().map(|marks| names_to_know(&self.scene, marks)).unwrap_or_default() {
            self.asking.know(&self.scene, &self.settings, &names)?;
        }
        if marks.is_empty() {
            (self.chapter_marks, self.carried_marks, self.turned_from) = (None, None, None);
            self.uncorrected = None;
            return Ok(());
        }
        self.chapter_marks = Some(match self.chapter_marks.take() {
            Some(chapter_marks) => chapter_marks.for_marks(&self.scene, &marks),
            None => ChapterMarks::new(&marks),
        });
        Ok(())
    }

    /// Returns the SHA-256 over the network that made masks of the marks that were read, hexadecimal.
    pub(crate) fn marks_model_sha256(&self) -> Option<&str> {
        self.marks_model_sha256.as_deref()
    }

    /// Returns the marks by hand.
    pub fn marks(&self) -> Option<&Marks> {
        self.chapter_marks.as_ref().map(|chapter_marks| &**chapter_marks.by_hand())
    }

    /// Names those of the marks that show nothing, see [`Marks::notes`], and the names that marks only deny
    /// although nothing finds them.
    pub fn mark_notes(&self) -> Vec<String> {
        let Some(marks) = self.marks() else { return Vec::new() };
        let mut notes = marks.notes(&self.canvas(), &self.scene.field_of_view, |_| true);
        let is_shown = |name: &String| marks.all().iter().any(|mark| mark.add && mark.name == *name);
        let names = marks.names().into_iter();
        let only_denied = names.filter(|name| !self.scene.corrects(name) && !is_shown(name));
        notes.extend(only_denied.map(|name| {
            format!(
                "\"{name}\" is marked only as what it is not, which changes nothing: mark what it is, too"
            )
        }));
        notes
    }

    /// Carries the marks to the chapter that is shown at `time`, unless that is done. It can take seconds, and
    /// leaves off with [`surgtpgs_core::Error::Cancelled`] for a request elsewhere.
    pub(crate) fn carry_marks(&mut self, time: f32) -> Result<()> {
        self.turn_to(time)?;
        let Some(by_hand) = self.chapter_marks.as_ref().map(|chapter_marks| chapter_marks.by_hand().clone())
        else {
            return Ok(());
        };
        if self.carried_marks.as_ref().is_some_and(|marked| Arc::ptr_eq(&marked.by_hand, &by_hand)) {
            return Ok(());
        }
        let here = self.marks_here()?;
        self.carry(by_hand, &here)
    }

    /// Returns the marks that count in the chapter at hand.
    fn marks_here(&mut self) -> Result<Marks> {
        let Self { chapter_marks: Some(chapter_marks), scene, recording, pending, .. } = self else {
            return Ok(Marks::default());
        };
        chapter_marks.marks(scene, &mut |i| {
            if pending.is_elsewhere(|frame| scene.is_at(scene.time(frame))) {
                return Err(Error::Cancelled);
            }
            picture(recording, scene, i)
        })
    }

    /// Carries the marks that count `here` to the Gaussians.
    fn carry(&mut self, by_hand: Arc<Marks>, here: &Marks) -> Result<()> {
        let scene = Arc::clone(&self.scene);
        let names = here.names();
        let earlier_graph = self.graph.take().filter(|g| g.is_of(&self.scene));
        let graph = earlier_graph.unwrap_or_else(|| Arc::new(Graph::of(&self.scene)));
        self.graph = Some(Arc::clone(&graph));
        let new: Vec<&String> = names.iter().filter(|name| !scene.finds(name)).collect();
        let carried = Carried::new(&scene, Arc::clone(&graph), &here.named(&new), CarrySettings::default());
        let earlier = self.carried_marks.take();
        let is_first = earlier.is_none();
        let (carried, mut before) = match earlier {
            Some(earlier) => (carried.after(earlier.carried), earlier.before),
            None => (carried, BTreeMap::new()),
        };
        let correcting = self.chapter_marks.as_ref().map(|marks| marks.correcting(&scene));
        let correcting = correcting.unwrap_or_default();
        before.retain(|(_, frame), _| correcting.on(*frame).next().is_some());
        let (by_hand, corrections, done) = match self.corrections(&graph, &correcting, &mut before) {
            Ok(corrections) => (by_hand, corrections, Ok(())),
            // What is known so far serves the next attempt.
            Err(e) => (Arc::default(), BTreeMap::new(), Err(e)),
        };
        if done.is_ok() || !is_first {
            self.carried_marks = Some(MarksInScene { by_hand, carried, corrections, before, last: None });
        }
        done
    }

    /// Returns the corrections of what features find by `marks`. `before` are the scores that are known
    /// already. Leaves off for a request elsewhere.
    fn corrections(
        &mut self,
        graph: &Graph,
        marks: &Marks,
        before: &mut ScoresBefore,
    ) -> Result<BTreeMap<String, Correction>> {
        let (scene, threshold) = (Arc::clone(&self.scene), self.settings.threshold);
        let mut rendered = None;
        Correction::of_names(&scene, graph, marks, threshold, &mut |name, frame| {
            let key = (name.to_owned(), frame);
            if let Some(scores) = before.get(&key) {
                return Ok(Arc::clone(scores));
            }
            if self.pending.is_elsewhere(|other| scene.is_at(scene.time(other))) {
                return Err(Error::Cancelled);
            }
            let images = match rendered.take().filter(|(of, _)| *of == frame) {
                Some((_, images)) => images,
                None => self.features_on(frame)?,
            };
            let scores = Arc::new(self.scores_before(name, &images)?);
            rendered = Some((frame, images));
            if before.len() < MOST_BEFORE {
                before.insert(key, Arc::clone(&scores));
            }
            Ok(scores)
        })
    }

    /// Renders a frame with features, by the Gaussians of the chapter at hand.
    fn features_on(&mut self, frame: usize) -> Result<Images> {
        let (camera, time) = (self.scene.cameras[frame], self.scene.time(frame));
        self.on_a_working_machine(|Self { scene, machine, .. }| machine.render(scene, &camera, time, true))
    }

    /// Returns the scores of a name on a rendered frame, without marks.
    fn scores_before(&mut self, name: &str, images: &Images) -> Result<Grid<f32>> {
        let nothing = || Grid::filled(images.width, images.height, 0.0);
        if self.uncorrected.is_none() {
            self.uncorrected = open_relevancy(&self.scene);
        }
        let Some(relevancy) = &mut self.uncorrected else { return Ok(nothing()) };
        let query = self.asking.query_of(&self.scene, &self.settings, name)?;
        let mut scores = relevancy.score(images, &[query], &self.settings).pop().unwrap_or_else(nothing);
        let size = (images.width, images.height);
        blank(&mut scores.data, self.outside.ranges(size, &self.scene.field_of_view));
        Ok(scores)
    }

    /// Changes the scores of the prompts on a view by what was marked, if anything was.
    pub(super) fn score_marked(&mut self, view: &SceneView, scores: &mut [Grid<f32>]) -> Result<()> {
        if self.chapter_marks.is_none() || scores.is_empty() {
            return Ok(());
        }
        self.clock.start();
        self.carry_marks(view.time)?;
        let Some(mut marked) = self.carried_marks.take() else { return Ok(()) };
        let result = self.add_marked(&mut marked, view, scores);
        self.carried_marks = Some(marked);
        self.blank_outside(view, scores);
        self.clock.waited(FramePass::Relevancy);
        result
    }

    fn add_marked(
        &mut self,
        marked: &mut MarksInScene,
        view: &SceneView,
        scores: &mut [Grid<f32>],
    ) -> Result<()> {
        let frame = self.frame_of(view);
        // Marked pixels are known at the size of the recording.
        let at_full_size = frame.filter(|i| self.scene.cameras[*i] == view.camera);
        let is_asked = |name: &String| self.asking.meant.iter().flatten().any(|meant| meant == name);
        let new = if marked.carried.names().iter().any(is_asked) {
            self.carried_scores(marked, view, frame)?
        } else {
            Vec::new()
        };
        let Asking { meant, corrected, queries, .. } = &self.asking;
        for (((score, meant), corrected), query) in scores.iter_mut().zip(meant).zip(corrected).zip(queries) {
            let corrections: Vec<&Correction> =
                corrected.iter().filter_map(|name| marked.corrections.get(name)).collect();
            for correction in &corrections {
                correction.apply(&self.scene, (view.camera, view.time), at_full_size, score);
            }
            let place = |name: &String| marked.carried.names().iter().position(|known| known == name);
            let own: Vec<&Grid<f32>> = meant.iter().filter_map(|name| new.get(place(name)?)).collect();
            for own in &own {
                score.data.iter_mut().zip(&own.data).for_each(|(s, own)| *s = s.max(*own));
            }
            // Other prompts stay as they are, to the last bit.
            if !corrections.is_empty() || !own.is_empty() {
                score.data.iter_mut().for_each(|s| *s = s.min(query.certainty));
            }
        }
        Ok(())
    }

    /// Returns the scores of the carried names on a view. Frames that were recorded are refined by their
    /// picture, or by the reconstruction of it where the recording is not at hand.
    fn carried_scores(
        &mut self,
        marked: &mut MarksInScene,
        view: &SceneView,
        frame: Option<usize>,
    ) -> Result<Vec<Grid<f32>>> {
        let Some(frame) = frame else {
            let Self { scene, recording, .. } = self;
            let pictures = &mut |i| picture(recording, scene, i);
            return marked.carried.on_view(scene, view.camera, view.time, pictures);
        };
        let [width, height] = [view.camera.width, view.camera.height].map(|side| side as usize);
        let scores = &self.carried_on(marked, frame)?.scores;
        Ok(scores.iter().map(|scores| scores.sampled(width, height)).collect())
    }

    /// Returns the scores of the carried names on a frame.
    fn carried_on<'a>(&mut self, marked: &'a mut MarksInScene, frame: usize) -> Result<&'a FrameScores> {
        let known = marked.last.take().filter(|(last, _)| *last == frame);
        let Self { scene, recording, pending, .. } = self;
        let mut num_read = 0;
        let mut pictures = |i: usize| {
            num_read += 1;
            if num_read > MOST_READ && pending.is_elsewhere(|other| other == frame) {
                return Err(Error::Cancelled);
            }
            picture(recording, scene, i)
        };
        let found = match known {
            Some((_, found)) => found,
            None => marked.carried.on_frame(scene, frame, &mut pictures)?,
        };
        Ok(&marked.last.insert((frame, found)).1)
    }

    /// Returns the frame that a view shows as it was recorded, at any size.
    fn frame_of(&self, view: &SceneView) -> Option<usize> {
        let size = view.camera;
        let shows = |i: &usize| {
            let camera = self.scene.cameras.get(*i).map(|camera| camera.resized(size.width, size.height));
            camera == Some(view.camera) && self.scene.time(*i) == view.time
        };
        view.recorded.filter(shows)
    }

    /// Returns for each prompt the Gaussians that marks give it at `time`: those whose share is above one half.
    pub(super) fn gaussians_marked(&mut self, time: f32) -> Result<Vec<Vec<usize>>> {
        self.carry_marks(time)?;
        let Some(mut marked) = self.carried_marks.take() else { return Ok(Vec::new()) };
        let Self { scene, recording, .. } = self;
        let shares = marked.carried.shares(scene, &mut |i| picture(recording, scene, i)).map(<[_]>::to_vec);
        let names = marked.carried.names().to_vec();
        self.carried_marks = Some(marked);
        let shares = shares?;
        let of = |meant: &Vec<String>| {
            let places: Vec<usize> = (0..shares.len()).filter(|k| meant.contains(&names[*k])).collect();
            let is_found = |i: &usize| places.iter().any(|k| shares[*k][*i] > 0.5);
            (0..self.scene.gaussians.len()).filter(is_found).collect()
        };
        Ok(self.asking.meant.iter().map(of).collect())
    }

    /// Changes the scores of the Gaussians for each prompt by the corrections, once marks are carried to them.
    pub(super) fn correct_gaussians(&self, scores: &mut [Vec<f32>]) {
        let (Some(marked), Asking { corrected, queries, .. }) = (&self.carried_marks, &self.asking) else {
            return;
        };
        for ((scores, corrected), query) in scores.iter_mut().zip(corrected).zip(queries) {
            for correction in corrected.iter().filter_map(|name| marked.corrections.get(name)) {
                correction.apply_to_gaussians(scores);
                scores.iter_mut().for_each(|s| *s = s.min(query.certainty));
            }
        }
    }

    /// Returns the place on a frame where one more mark of a new name would help most; `None` if there is no
    /// such name, or if the frame is marked.
    pub fn look_here_on(&mut self, frame: usize) -> Result<Option<LookHere>> {
        self.carry_marks(self.scene.time(frame))?;
        let Some(mut marked) = self.carried_marks.take() else { return Ok(None) };
        let is_marked = marked.carried.frames().any(|other| other == frame);
        let found = if marked.carried.names().is_empty() || is_marked {
            Ok(None)
        } else {
            let scene = self.scene.clone();
            let found = self.carried_on(&mut marked, frame);
            found.map(|found| Some(found.look_here(frame, &scene.field_of_view)))
        };
        self.carried_marks = Some(marked);
        found
    }
}

/// Returns the names that prompts may mean: those that some mark shows and, where features find any words,
/// those that marks only correct.
fn names_to_know(scene: &Scene, marks: &Marks) -> Vec<String> {
    if scene.finds_any_words() { marks.names() } else { marks.shown_names() }
}

/// Returns the recorded picture of a frame, or the reconstruction of it where the recording is not at hand.
fn picture(recording: &Recorded, scene: &Scene, frame: usize) -> Result<image::RgbImage> {
    let time = scene.time(frame);
    match recording.frame(frame)? {
        Some(picture) => Ok(picture),
        None if scene.is_at(time) => Ok(render_frame(scene, frame).to_rgb()),
        None => Ok(render_frame(&scene.at(time)?, frame).to_rgb()),
    }
}
