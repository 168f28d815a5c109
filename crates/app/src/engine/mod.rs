//! The engine that the viewer and every verb work with: a scene, its recording, a renderer, a text
//! encoder and the prompts.
//!
//! ```text
//! set_prompts ─▶ text encoder ─▶ queries ─────────────────────┐
//! view(i) or SceneView::free ─┬▶ render ─▶ planes ─▶ scores ◀─┤ ─▶ masks
//!                             └▶ show ◀───────────────────────┘ ─▶ picture, depth, scores
//! ```
//!
//! There are two ways to a rendered view, for two uses:
//!
//! - [`Engine::render`] returns all image planes as numbers in memory, and [`Engine::scores`] answers the
//!   prompts on them. Verbs that measure and write files take this way.
//! - [`Engine::show`] returns finished results, and only those that are wanted. On a GPU everything between
//!   stays on the device, and scores are computed there. The window takes this way.
//!
//! An engine is `Send`: a worker thread can own it. The result of `scores` belongs to the planes it was
//! given. A view that was just rendered is not rendered again.

mod answer;
mod asking;
mod chapters;
mod layers;
mod machine;
mod marked;
mod opening;
mod outside;
mod pending;
mod question;
mod recorded;
mod tools;

pub use answer::{Absence, Answer, Verdict};
pub(crate) use chapters::frames_around;
pub use layers::Motion;
pub use machine::BackendChoice;
pub(crate) use machine::Machine;
pub(crate) use machine::may_have_gpu;
pub(crate) use pending::{Next, Pending};
pub use question::{Negatives, Question, Sample};
pub(crate) use tools::Tools;

use crate::memory::{Work, require_for};
use asking::Asking;
use chapters::TurnedFrom;
pub use opening::open_text_encoder;
use opening::{find_recording, open_recording, open_relevancy};
use outside::{Outside, blank};
use recorded::Recorded;
use serde::Deserialize;
use std::{
    path::{Path, PathBuf},
    sync::Arc,
};
use surgtpgs_core::{
    Error, Remedy, Result,
    camera::Camera,
    codec::AUTOENCODER_FILE,
    deform::deform,
    files::Inputs,
    grid::{Grid, Mask},
    marks::{ChapterMarks, Graph},
    mask::threshold,
    meaning::EncoderIdentity,
    num::sigmoid,
    raster::{FrameClock, FramePass, Images, Renderer},
    relevancy::{Fastest, Points, Query, Relevancy, RelevancySettings},
    scene::Scene,
    sequence::Sequence,
    train::Profile,
};
use surgtpgs_render::{Asked, GpuRenderer, RenderInput, Shown, Wanted};

/// Choice of the text encoder.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub enum EncoderChoice {
    /// The one the scene was prepared with.
    #[default]
    OfScene,
    /// The one inside the program.
    Builtin,
    /// A folder with `model.onnx` and `tokenizer.json`.
    Folder(PathBuf),
}

impl EncoderChoice {
    /// Returns the folder that was chosen, if any was.
    pub(crate) fn folder(&self) -> Option<&Path> {
        match self {
            Self::Folder(folder) => Some(folder),
            Self::OfScene | Self::Builtin => None,
        }
    }
}

/// Options to open an [`Engine`] with.
#[derive(Clone, Debug, Default)]
pub struct EngineOptions {
    /// Device that renders.
    pub backend: BackendChoice,
    /// Text encoder that answers prompts.
    pub encoder: EncoderChoice,
    /// Path of the recording; `None`: the place where it was when the scene was trained.
    pub sequence: Option<PathBuf>,
}

/// A time and a camera to render.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SceneView {
    /// Time, 0 to 1; frame i of N is at i / N.
    pub time: f32,
    /// The camera; its size is the size of the images.
    pub camera: Camera,
    /// Recorded frame that is shown as it was recorded, at any size: the field of view limits what is found.
    pub recorded: Option<usize>,
}

impl SceneView {
    /// Creates a view that the recording never had.
    pub fn free(time: f32, camera: Camera) -> Self {
        Self { time, camera, recorded: None }
    }

    /// Returns the same view at another size in pixels.
    pub fn resized(&self, width: u32, height: u32) -> Self {
        Self { camera: self.camera.resized(width, height), ..*self }
    }
}

/// Request to score the prompts on a view.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ask {
    /// No scores, and none later: no features are rendered.
    Nothing,
    /// No scores yet: the features are rendered, so that asking later costs no rendering.
    Later,
    /// The scores of the prompts.
    Now,
}

/// A scene that can be rendered and asked.
pub struct Engine {
    scene: Arc<Scene>,
    recording: Recorded,
    machine: Machine,
    /// `true` if the CPU stands in for a GPU that could not do this scene. Another scene may fit.
    stands_in: bool,
    backend: BackendChoice,
    clock: FrameClock,
    last: Option<Rendered>,
    outside: Outside,
    travelling: Option<layers::Travelling>,
    relevancy: Option<Fastest>,
    /// Scores that are corrected, apart from those of prompts: tables adapt to all that is looked up in them,
    /// and no other prompt may change. Made for the first correction.
    uncorrected: Option<Fastest>,
    settings: RelevancySettings,
    asking: Asking,
    /// Marks by hand, and those that count in each chapter of a long scene, as far as they were needed.
    chapter_marks: Option<ChapterMarks>,
    /// Marks that were carried to the Gaussians; those of before if the marks by hand are others now.
    carried_marks: Option<marked::MarksInScene>,
    /// The request that waits: carrying marks to another chapter leaves off for it.
    pending: Arc<Pending>,
    /// Graph of the scene's Gaussians, which marks spread over; made for the first marks.
    graph: Option<Arc<Graph>>,
    /// Chapter of a long scene that was turned from last, with its marks.
    turned_from: Option<TurnedFrom>,
    /// File that the marks were read from.
    marks_file: Option<PathBuf>,
    /// Folder of the network that made masks of them, and the SHA-256 over it.
    marks_model: Option<PathBuf>,
    marks_model_sha256: Option<String>,
    /// Folder of the text encoder that was chosen in place of the scene's.
    chosen_encoder: Option<PathBuf>,
}

/// The images of a view, with or without features.
struct Rendered {
    view: SceneView,
    has_features: bool,
    images: Arc<Images>,
}

impl Engine {
    /// Opens a scene file. The recording is looked for where it was when the scene was trained, then
    /// beside the scene file; without it everything but [`Engine::original`] works. A recording that
    /// `options` names must be there and fit.
    pub fn open(path: &Path, options: EngineOptions) -> Result<Self> {
        require_for(&Work::Scene(path))?;
        let scene = Arc::new(Scene::load(path)?);
        let beside = path.parent().map(|p| p.join(&scene.provenance.sequence_name));
        Self::new(scene, beside.as_deref(), options)
    }

    /// Wraps a scene in memory; `beside` is a second place to look for its recording.
    pub fn new(scene: Arc<Scene>, beside: Option<&Path>, options: EngineOptions) -> Result<Self> {
        let recording = match &options.sequence {
            Some(path) => Recorded::Found(open_recording(&scene, path)?),
            None => find_recording(&scene, beside),
        };
        Self::with(scene, recording, options, None)
    }

    /// Wraps a scene whose recording is open already. `tools` are those of an earlier engine.
    pub(crate) fn of_recording(
        scene: Arc<Scene>,
        sequence: Sequence,
        options: EngineOptions,
        tools: Option<Tools>,
    ) -> Result<Self> {
        Self::with(scene, Recorded::Found(sequence), options, tools)
    }

    fn with(
        scene: Arc<Scene>,
        recording: Recorded,
        options: EngineOptions,
        tools: Option<Tools>,
    ) -> Result<Self> {
        if let Some(camera) = scene.cameras.first() {
            require_for(&Work::Pictures(camera.width, camera.height))?;
        }
        let working = tools.filter(Tools::work).map_or_else(|| Tools::open(options.backend), Ok);
        let Tools { machine, encoder, .. } = working?;
        let settings = settings_of(&scene);
        let chosen_encoder = options.encoder.folder().map(Path::to_owned);
        Ok(Self {
            relevancy: open_relevancy(&scene),
            uncorrected: None,
            asking: Asking::new(&scene, options.encoder, &settings).with_encoder(&scene, encoder),
            scene,
            recording,
            machine,
            stands_in: false,
            backend: options.backend,
            clock: FrameClock::default(),
            last: None,
            outside: Outside::default(),
            travelling: None,
            settings,
            carried_marks: None,
            chapter_marks: None,
            pending: Arc::default(),
            graph: None,
            turned_from: None,
            marks_file: None,
            marks_model: None,
            marks_model_sha256: None,
            chosen_encoder,
        })
    }

    /// Returns the scene.
    pub fn scene(&self) -> &Arc<Scene> {
        &self.scene
    }

    /// Returns the inputs of a run on the scene, which was opened at `path`.
    pub(crate) fn inputs(&self, path: &Path) -> Inputs {
        let encoder = self.scene.encoder.as_ref().and_then(|encoder| encoder.folder.as_deref());
        let inputs = Inputs::none()
            .with("the scene", path)
            .with("the scene's recording", &self.scene.provenance.sequence_path)
            .with_some("the text encoder", encoder)
            .with_some("the text encoder", self.chosen_encoder.as_deref())
            .with_some("the marks", self.marks_file.as_deref())
            .with_some("the network for marks", self.marks_model.as_deref());
        self.sequence().into_iter().fold(inputs, Inputs::with_recording)
    }

    /// Returns the name of the machine that renders, e.g. "CPU, 2 threads, Avx512".
    pub fn renderer_name(&self) -> String {
        self.machine.name()
    }

    /// Returns the name of the way scores are computed, e.g. "lattice"; "none" for a scene without features.
    pub fn relevancy_name(&self) -> &'static str {
        self.relevancy.as_ref().map_or("none", |r| r.name())
    }

    /// Returns the text encoder that the scene is asked with. It is opened only if the scene does not name it.
    pub fn encoder_identity(&mut self) -> Result<EncoderIdentity> {
        self.asking.encoder(&self.scene)
    }

    /// Returns the view of frame `i` as it was recorded; frames past the end give the last one.
    pub fn view(&self, i: usize) -> Result<SceneView> {
        let last =
            self.scene.num_frames().checked_sub(1).ok_or_else(|| {
                Error::input("the scene has no frames", "Train it again from its recording.")
            })?;
        let i = i.min(last);
        Ok(SceneView { time: self.scene.time(i), camera: self.scene.cameras[i], recorded: Some(i) })
    }

    /// Renders all planes of a view into memory; the features are needed for [`Engine::scores`] only. A
    /// recorded view is empty outside the field of view, where nothing was ever seen.
    pub fn render(&mut self, view: &SceneView, features: bool) -> Result<Arc<Images>> {
        self.turn_to(view.time)?;
        let features = features && self.scene.gaussians.latent_dim > 0;
        if let Some(last) = &self.last
            && last.view == *view
            && (last.has_features || !features)
        {
            return Ok(last.images.clone());
        }
        let used = self.last.take().and_then(|last| Arc::try_unwrap(last.images).ok());
        let mut images = used.unwrap_or_default();
        self.on_a_working_machine(|Self { scene, machine, clock, .. }| {
            machine.render_into(scene, &view.camera, view.time, features, &mut images, clock)
        })?;
        if view.recorded.is_some() {
            let size = (images.width, images.height);
            let outside = self.outside.ranges(size, &self.scene.field_of_view);
            for plane in images.planes.chunks_exact_mut((images.width * images.height).max(1)) {
                blank(plane, outside);
            }
        }
        let images = Arc::new(images);
        self.last = Some(Rendered { view: *view, has_features: features, images: images.clone() });
        Ok(images)
    }

    /// Shows a view: the picture, the depth and, as `ask` says, the scores of the prompts. On a GPU only what
    /// is `wanted` leaves the device.
    pub fn show(&mut self, view: &SceneView, ask: Ask, wanted: Wanted) -> Result<Shown> {
        self.turn_to(view.time)?;
        let is_asked = ask == Ask::Now && wanted.scores && !self.asking.queries.is_empty();
        let are_marked = is_asked && self.chapter_marks.is_some();
        if are_marked {
            // This leaves off for a request elsewhere, before anything is rendered in vain.
            self.carry_marks(view.time)?;
        }
        let mut shown = self.show_without_marks(view, ask, wanted)?;
        if are_marked {
            self.score_marked(view, &mut shown.scores)?;
        }
        Ok(shown)
    }

    /// Shows a view with the scores that prompts have without marks. Where marks are all that can be found,
    /// scores need no picture.
    fn show_without_marks(&mut self, view: &SceneView, ask: Ask, wanted: Wanted) -> Result<Shown> {
        if ask == Ask::Now && self.relevancy.is_none() && self.chapter_marks.is_some() {
            let is_seen = wanted.picture || wanted.depth;
            let shown = is_seen.then(|| self.show_without_marks(view, Ask::Nothing, wanted)).transpose()?;
            let [width, height] = [view.camera.width, view.camera.height].map(|side| side as usize);
            let num_scores = if wanted.scores { self.asking.queries.len() } else { 0 };
            let scores = vec![Grid::filled(width, height, 0.0); num_scores];
            return Ok(Shown { scores, ..shown.unwrap_or_default() });
        }
        let has_lattice = matches!(self.relevancy, Some(Fastest::Lattice(_)));
        if !self.machine.is_gpu() || (ask == Ask::Now && !has_lattice) {
            return self.show_by_cpu(view, ask, wanted);
        }
        let features = has_lattice && ask != Ask::Nothing;
        self.on_a_working_machine(|engine| {
            let Self { scene, machine: Machine::Gpu(gpu), relevancy, asking, settings, clock, .. } = engine
            else {
                return engine.show_by_cpu(view, ask, wanted);
            };
            let input = RenderInput { scene, camera: &view.camera, time: view.time, features };
            let field_of_view = view.recorded.map(|_| &scene.field_of_view);
            let asked = match (ask, relevancy) {
                (Ask::Now, Some(Fastest::Lattice(lattice))) => {
                    Some(Asked { lattice, queries: &asking.queries, settings })
                }
                _ => None,
            };
            gpu.show(&input, field_of_view, asked, wanted, clock)
        })
    }

    /// Does the same as [`Engine::show_without_marks`] pass by pass, with the images in memory.
    fn show_by_cpu(&mut self, view: &SceneView, ask: Ask, wanted: Wanted) -> Result<Shown> {
        let images = self.render(view, ask != Ask::Nothing)?;
        let is_scored = ask == Ask::Now && wanted.scores;
        Ok(Shown {
            picture: wanted.picture.then(|| images.to_rgb()),
            depth: wanted.depth.then(|| images.normalised_depth()),
            scores: if is_scored { self.scores_without_marks(&images, view)? } else { Vec::new() },
        })
    }

    /// Does `work`. If the graphics device is lost meanwhile, opens a machine anew and does `work` once more.
    /// What the GPU cannot do, because it hangs, has no room or its driver fails, the CPU does, from then on
    /// with everything else; if a GPU was asked for, the error is returned instead.
    fn on_a_working_machine<T>(&mut self, mut work: impl FnMut(&mut Self) -> Result<T>) -> Result<T> {
        let mut result = work(self);
        if result.is_err() && self.machine.loss().is_some_and(|loss| !loss.hangs) {
            self.machine = Machine::open(self.backend)?;
            self.last = None;
            result = work(self);
        }
        let is_of_gpu = result.as_ref().is_err_and(|error| error.remedy() == Some(Remedy::UseCpu));
        if is_of_gpu && self.machine.is_gpu() && self.backend != BackendChoice::Gpu {
            self.stands_in = self.machine.loss().is_none();
            self.machine = Machine::open(BackendChoice::Cpu)?;
            self.last = None;
            result = work(self);
        }
        result
    }

    /// Returns the GPU, if it is the machine that renders.
    pub(crate) fn gpu(&mut self) -> Option<&mut GpuRenderer> {
        match &mut self.machine {
            Machine::Cpu(_) => None,
            Machine::Gpu(gpu) => Some(gpu),
        }
    }

    /// Returns the number of runs and the time of each pass of a frame.
    pub fn clock(&self) -> &FrameClock {
        &self.clock
    }

    /// Forgets the last view, so that the next one is rendered whatever it is.
    pub fn forget_last(&mut self) {
        self.last = None;
    }

    /// Returns the prompts being asked, in order, with what each is compared to.
    pub fn queries(&self) -> &[Query] {
        &self.asking.queries
    }

    /// Returns what the scene says to each prompt, whatever the frame.
    pub fn answers(&self) -> &[Answer] {
        &self.asking.answers
    }

    /// Returns the settings of queries.
    pub fn settings(&self) -> &RelevancySettings {
        &self.settings
    }

    /// Changes the settings of queries, which at first are those of the profile that the scene was trained
    /// with. The prompts are forgotten.
    pub fn change_settings(&mut self, change: impl FnOnce(RelevancySettings) -> RelevancySettings) {
        self.settings = change(self.settings.clone());
        self.asking.forget(&self.scene, &self.settings);
    }

    /// Sets the prompts to look for, with the negatives of the settings; see [`Engine::set_questions`].
    pub fn set_prompts(&mut self, prompts: &[String]) -> Result<()> {
        let negatives = Negatives::of(&self.settings);
        let question = |text: &String| Question::words(text, negatives.clone());
        self.set_questions(&prompts.iter().map(question).collect::<Vec<_>>())
    }

    /// Sets the questions to look for: asks what their words mean in the scene, and lets each compete with
    /// its own negatives. Words that were encoded before are not encoded again.
    ///
    /// Refuses empty words, a scene without features and marks, and a text encoder other than the one the
    /// scene was prepared with.
    pub fn set_questions(&mut self, questions: &[Question]) -> Result<()> {
        self.asking.set(&self.scene, &self.settings, self.chapter_marks.is_some(), questions)
    }

    /// Takes a sample at a pixel of a view; `None` where nothing was reconstructed.
    pub fn sample(&mut self, view: &SceneView, [x, y]: [usize; 2]) -> Result<Option<Sample>> {
        let images = self.render(view, true)?;
        let Some(codec) = &self.scene.codec else { return Err(no_features(&self.scene)) };
        let dim = images.latent_dim();
        if x >= images.width || y >= images.height || dim != codec.latent_dim() {
            return Ok(None);
        }
        let mut latent = Vec::with_capacity(dim);
        let is_seen = Points::of_images(&images, self.settings.min_alpha)
            .push_latent(y * images.width + x, &mut latent);
        let row = ndarray::Array2::from_shape_vec((1, dim), latent).ok().filter(|_| is_seen);
        Ok(row.map(|row| Sample {
            embedding: codec.decode(row.view()).into_raw_vec_and_offset().0,
            encoder_sha256: asking::encoder_sha256(&self.scene).to_owned(),
        }))
    }

    /// Returns one score image per prompt, from images of `view` with features: 0–1, and 0 in holes and
    /// outside the field of view.
    pub fn scores(&mut self, images: &Images, view: &SceneView) -> Result<Vec<Grid<f32>>> {
        self.turn_to(view.time)?;
        let mut scores = self.scores_without_marks(images, view)?;
        self.score_marked(view, &mut scores)?;
        Ok(scores)
    }

    /// Does the same as [`Engine::scores`] without marks. Where these are all that can be found, nothing is.
    fn scores_without_marks(&mut self, images: &Images, view: &SceneView) -> Result<Vec<Grid<f32>>> {
        if self.asking.queries.is_empty() {
            return Ok(Vec::new());
        }
        self.clock.start();
        let mut scores = match &mut self.relevancy {
            Some(relevancy) => relevancy.score(images, &self.asking.queries, &self.settings),
            None if self.chapter_marks.is_some() => {
                vec![Grid::filled(images.width, images.height, 0.0); self.asking.queries.len()]
            }
            None => return Err(no_features(&self.scene)),
        };
        self.blank_outside(view, &mut scores);
        self.clock.lap(FramePass::Relevancy);
        Ok(scores)
    }

    /// Makes sure that nothing is found outside the field of view, if the view was recorded.
    fn blank_outside(&mut self, view: &SceneView, scores: &mut [Grid<f32>]) {
        let Some(size) = scores.first().map(|s| (s.width, s.height)).filter(|_| view.recorded.is_some())
        else {
            return;
        };
        let outside = self.outside.ranges(size, &self.scene.field_of_view);
        scores.iter_mut().for_each(|s| blank(&mut s.data, outside));
    }

    /// Returns for each prompt the Gaussians that it finds at `time`: their score is above the threshold, and
    /// they are at least as opaque as a pixel has to be. Marks count as they do for pixels.
    pub fn gaussians_found(&mut self, time: f32) -> Result<Vec<Vec<usize>>> {
        let marked = self.gaussians_marked(time)?;
        if self.relevancy.is_none() && self.chapter_marks.is_some() {
            return Ok(marked);
        }
        let mut scores = self.gaussian_scores(time)?;
        self.correct_gaussians(&mut scores);
        let RelevancySettings { threshold, min_alpha, .. } = self.settings;
        let opacities = self.scene.gaussians.opacity_logits.iter().map(|o| sigmoid(*o));
        let opacities: Vec<f32> = opacities.collect();
        let is_found = |scores: &[f32], i: usize| scores[i] > threshold && opacities[i] >= min_alpha;
        let found = |scores: &Vec<f32>| (0..scores.len()).filter(|&i| is_found(scores, i)).collect();
        let mut found: Vec<Vec<usize>> = scores.iter().map(found).collect();
        for (found, marked) in found.iter_mut().zip(marked) {
            found.extend(marked);
            found.sort_unstable();
            found.dedup();
        }
        Ok(found)
    }

    /// Returns for each prompt the score of each Gaussian at `time`, whatever its opacity. Marks do not count.
    pub fn gaussian_scores(&mut self, time: f32) -> Result<Vec<Vec<f32>>> {
        self.turn_to(time)?;
        let Some(relevancy) = &mut self.relevancy else { return Err(no_features(&self.scene)) };
        let deformed = deform(&self.scene.gaussians, &self.scene.deformation, time, true);
        let points = Points::of_latents(&deformed.features, self.scene.gaussians.latent_dim);
        Ok(relevancy.score_points(&points, &self.asking.queries, &self.settings))
    }

    /// Returns for each prompt the mask of pixels whose score is above the threshold of the settings.
    pub fn masks(&self, scores: &[Grid<f32>]) -> Vec<Mask> {
        scores.iter().map(|s| threshold(s, self.settings.threshold)).collect()
    }
}

/// Settings of queries that fit the profile which a scene was trained with.
fn settings_of(scene: &Scene) -> RelevancySettings {
    let profile = scene.provenance.settings.get("profile");
    match profile.and_then(|profile| Profile::deserialize(profile).ok()) {
        Some(Profile::Paper) => RelevancySettings::paper(),
        _ => RelevancySettings::default(),
    }
}

fn no_features(scene: &Scene) -> Error {
    if scene.gaussians.latent_dim > 0 {
        return Error::input(
            "the network that this scene's features were compressed with is not known",
            format!("Put it beside the .ply, as {AUTOENCODER_FILE}."),
        );
    }
    Error::input("this scene was trained without features, so it cannot be asked for words", Remedy::Prepare)
}

#[cfg(test)]
pub(crate) mod asking_tests;
#[cfg(test)]
mod marked_tests;
#[cfg(test)]
mod tests;
