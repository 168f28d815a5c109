//! The interface between the window and everything that computes: traits for everything the window asks for.
//!
//! [`engine`] implements them with the real engine; tests implement them with a small fake.

pub(crate) mod earlier;
pub(crate) mod engine;
pub(crate) mod frames;
pub(crate) mod orbit;
pub(crate) mod paths;
pub(crate) mod ranges;
pub(crate) mod task;

use crate::{
    engine::{Answer, Negatives, Pending, Question, Sample},
    evaluation::Evaluation,
    jobs::ExportRequest,
};
use frames::Frames;
use image::RgbImage;
use orbit::Orbit;
use paths::{PathAsk, Picked};
use std::{
    ops::Range,
    path::{Path, PathBuf},
    sync::Arc,
};
use surgtpgs_core::{
    Result,
    camera::{MAX_MOVING_DEGREES, MAX_STILL_DEGREES},
    export::ExportSummary,
    grid::{Grid, Mask},
    marks::{LookHere, Mark},
    raster::FrameClock,
    sequence::CheckReport,
    train::{LossTerms, Quality},
};
use task::TaskContext;

/// A pinhole camera, in pixels of the full picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Lens {
    pub(crate) fx: f32,
    pub(crate) fy: f32,
    pub(crate) cx: f32,
    pub(crate) cy: f32,
}

/// Facts about a scene or a recording that are known as soon as it is open.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Info {
    /// Name for titles.
    pub(crate) name: String,
    /// Path that was opened.
    pub(crate) path: PathBuf,
    /// Recording or prepared folder from which a reconstruction is made; `None` where it is not at hand.
    pub(crate) recording: Option<PathBuf>,
    /// Path of the recorded frames, with links resolved; they may be gone. It is the same for everything made
    /// of one recording.
    pub(crate) sequence: Option<PathBuf>,
    /// Hash of the names and sizes of the recording's frames; `None` where they are not known.
    pub(crate) frames_sha256: Option<String>,
    /// Hash of the content of a few frames; `None` where it is not known.
    pub(crate) spots_sha256: Option<String>,
    pub(crate) num_frames: usize,
    /// File names of the frames, by which files of annotations name them; empty where they are not known.
    pub(crate) frame_names: Arc<[String]>,
    pub(crate) width: usize,
    pub(crate) height: usize,
    pub(crate) frames_per_second: Option<f32>,
    /// Time of every frame after the first, seconds; empty if the frame rate tells it, or nothing does.
    pub(crate) frame_seconds: Arc<[f64]>,
    pub(crate) camera_moves: bool,
    /// Optics of the camera, for lengths in space.
    pub(crate) lens: Option<Lens>,
    /// `true` if recorded frames can be shown.
    pub(crate) has_original: bool,
    /// Reason why recorded frames cannot be shown, in a sentence.
    pub(crate) original_missing: Option<String>,
    /// `true` if there is a reconstruction to render.
    pub(crate) has_reconstruction: bool,
    /// Share of its training that a reconstruction has had, 0–1; 1 where nothing is known.
    pub(crate) learned: f32,
    /// Frames of a long recording that no part reconstructs.
    pub(crate) unlearned: Vec<Range<usize>>,
    /// `true` if the depth of the reconstruction was measured, so that lengths in space mean something.
    pub(crate) has_measured_depth: bool,
    /// `true` if prompts can be asked.
    pub(crate) has_features: bool,
    /// `true` if the recording has class labels, from which features can be made.
    pub(crate) has_labels: bool,
    /// Examples of prompts, e.g. the class names.
    pub(crate) example_prompts: Vec<String>,
    /// Notes about this scene that the user should know, a few words and a sentence each.
    pub(crate) notes: Vec<(String, String)>,
    /// Folder that can be written to, for files made of the scene or recording.
    pub(crate) output_folder: PathBuf,
    /// Newest reconstruction of a recording under a name that is offered for it.
    pub(crate) made_before: Option<PathBuf>,
}

impl Info {
    /// Returns `true` if no part of a long recording reconstructs a frame.
    pub(crate) fn is_unlearned(&self, frame: usize) -> bool {
        self.unlearned.iter().any(|frames| frames.contains(&frame))
    }

    /// Returns the frames of the recording; `None` where they are not known.
    pub(crate) fn frames(&self) -> Option<Frames<'_>> {
        let (spots, place) = (self.spots_sha256.as_deref(), self.sequence.as_deref());
        self.frames_sha256.as_deref().map(|outline| Frames { outline, spots, place })
    }

    /// Returns `true` if both are of the same frames of one recording. Where frames are not known, paths are
    /// compared; where those are not known either, names.
    pub(crate) fn is_same_recording(&self, other: &Self) -> bool {
        let frames = self.frames().zip(other.frames());
        let paths = self.sequence.as_ref().zip(other.sequence.as_ref());
        let is_same = match (frames, paths) {
            (Some((mine, theirs)), _) => mine.are_of_one(theirs),
            (None, Some((mine, theirs))) => mine == theirs,
            (None, None) => self.name == other.name,
        };
        is_same && self.num_frames == other.num_frames
    }

    /// Returns `true` if both are of recordings at one path, but of other frames.
    pub(crate) fn has_other_frames(&self, other: &Self) -> bool {
        self.sequence.is_some() && self.sequence == other.sequence && !self.is_same_recording(other)
    }

    /// Returns `true` if there is a reconstruction whose depth nobody measured. It has no numbers then.
    pub(crate) fn shape_is_guessed(&self) -> bool {
        self.has_reconstruction && !self.has_measured_depth
    }

    /// Returns `true` if there is a reconstruction whose training was stopped before its end.
    pub(crate) fn is_unfinished(&self) -> bool {
        self.has_reconstruction && self.learned < 1.0
    }

    /// Returns the largest rotation of the view away from the endoscope's, degrees.
    pub(crate) fn orbit_limit(&self) -> f32 {
        if self.camera_moves { MAX_MOVING_DEGREES } else { MAX_STILL_DEGREES }
    }
}

/// A view to render.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct FrameView {
    pub(crate) frame: usize,
    pub(crate) orbit: Orbit,
    /// `true` for half the width and height, while something moves.
    pub(crate) is_preview: bool,
}

/// Parts of a rendered view that are wanted. What is not wanted is not made, and not read back from a GPU.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Parts {
    /// `true` if [`FrameSource::scores`] of the view will follow.
    pub(crate) features: bool,
    pub(crate) colour: bool,
    pub(crate) depth: bool,
}

impl Parts {
    /// Returns those of these parts that are not `there`.
    pub(crate) fn without(self, there: Self) -> Self {
        Self {
            features: self.features && !there.features,
            colour: self.colour && !there.colour,
            depth: self.depth && !there.depth,
        }
    }
}

/// A rendered view.
#[derive(Clone, Debug, Default)]
pub(crate) struct Rendering {
    /// The picture, if it was wanted.
    pub(crate) colour: Option<RgbImage>,
    /// Depth in scene units, if it was wanted; 0 where there is nothing.
    pub(crate) depth: Option<Grid<f32>>,
    /// Mask of the pixels of the picture that the endoscope did not see; `None` for the endoscope's own view.
    pub(crate) unseen: Option<Mask>,
}

/// An open scene or recording. A worker thread owns it.
pub(crate) trait FrameSource: Send {
    fn info(&self) -> &Info;
    /// Returns the frames of the shot of a frame, over which its scores may be smoothed.
    fn shot_of(&self, _: usize) -> Range<usize> {
        0..self.info().num_frames
    }
    /// Returns the frame as it was recorded.
    fn original(&mut self, frame: usize) -> Result<RgbImage>;
    /// Returns the mask of instruments on the recorded frame; `None` where it is not known.
    fn instruments(&mut self, _: usize) -> Result<Option<Mask>> {
        Ok(None)
    }
    /// Renders the wanted parts of a view.
    fn render(&mut self, view: &FrameView, parts: Parts) -> Result<Rendering>;
    /// Returns one score image per question, in the view that was rendered last and of its size. An error
    /// concerns its question alone.
    fn scores(&mut self, view: &FrameView, questions: &[Question]) -> Vec<Result<Grid<f32>>>;
    /// Returns what is said to each question, whatever the view; `None` where that is not known.
    fn answers(&mut self, questions: &[Question]) -> Vec<Option<Answer>> {
        questions.iter().map(|_| None).collect()
    }
    /// Returns the distances that the contents of a view move over the recording, px, not a number where
    /// nothing is, and a description in words of what moves.
    fn motion(&mut self, view: &FrameView) -> Result<(Grid<f32>, String)>;
    /// Returns the opacity of a view, 0–1.
    fn opacity(&mut self, view: &FrameView) -> Result<Grid<f32>>;
    /// Returns the sample at a point of a view, the point as share of width and height; `None` where nothing
    /// was reconstructed.
    fn sample(&mut self, _: &FrameView, _: [f32; 2]) -> Result<Option<Sample>> {
        Ok(None)
    }
    /// Takes marks by hand in place of earlier ones: questions then find what they name. A recording without a
    /// reconstruction has nothing to carry them to.
    fn set_marks(&mut self, _: &[Mark]) -> Result<()> {
        Ok(())
    }
    /// Carries the marks to a view, so that questions on it can be answered. It can take seconds.
    fn carry_marks(&mut self, _: &FrameView) -> Result<()> {
        Ok(())
    }
    /// Returns the place on a frame where one more mark would help most; `None` where that is not known.
    fn look_here(&mut self, _: usize) -> Result<Option<LookHere>> {
        Ok(None)
    }
    /// Takes the place where requests that wait are told: long work for other frames leaves off for them, with
    /// [`surgtpgs_core::Error::Cancelled`].
    fn leave_off_for(&mut self, _: &Arc<Pending>) {}
    /// Returns `false` if questions on a view have to wait for seconds, until marks are carried to it.
    fn answers_at_once(&self, _: &FrameView) -> bool {
        true
    }
    /// Returns `true` if views may be requested before anybody wants to see them.
    fn prepares_ahead(&self) -> bool {
        true
    }
    /// Returns the name of the machine that renders now, e.g. "CPU, 2 threads"; empty if nothing is rendered.
    fn renderer(&self) -> String {
        String::new()
    }
    /// Returns the number of times that each pass of a frame has run so far.
    fn clock(&self) -> FrameClock {
        FrameClock::default()
    }
}

/// Opens, exports and trains. All methods run on worker threads and take as long as they need.
pub(crate) trait Backend: Send + Sync {
    fn open(&self, path: &Path) -> Result<Box<dyn FrameSource>>;
    /// Asks the user for a path by a dialog of the system, and returns once it is closed.
    fn pick(&self, ask: &PathAsk) -> Picked;
    /// Reads a whole recording and reports its contents.
    fn check(&self, path: &Path, task: &TaskContext) -> Result<Checked>;
    /// Inverts which side of a recording's masks is kept.
    fn flip_masks(&self, path: &Path) -> Result<PathBuf>;
    /// Makes sure that the built-in demo is under `folder`: its scene, or at least its recording.
    fn demo(&self, folder: &Path, task: &TaskContext<Box<dyn FrameSource>>) -> Result<Demo>;
    /// Exports files; `negatives` are those of prompts without exceptions of their own. After a cancellation,
    /// finished files stay and the same request continues from there.
    fn export(
        &self,
        request: &ExportRequest,
        negatives: &Negatives,
        task: &TaskContext,
    ) -> Result<ExportSummary>;
    /// Shows a folder with the system's file manager.
    fn show_folder(&self, folder: &Path) -> Result<()>;
    /// Compares a scene with its recording: pictures, depth and the masks of its classes. Ranges of frames that
    /// are left out are not measured.
    fn evaluate(&self, scene: &Path, left_out: &[(usize, usize)], task: &TaskContext) -> Result<Evaluation>;
    /// Returns the available memory, bytes; `None` where the system does not tell.
    fn available_bytes(&self) -> Option<u64> {
        None
    }
    /// Opens the networks that make a recording searchable, and reports what is wrong with each.
    fn check_models(&self, models: &Models, task: &TaskContext) -> Result<ModelFaults>;
    /// Returns the first of these folders that holds what these very networks found in a recording.
    fn found_before(
        &self,
        models: &Models,
        recording: &Path,
        folders: &[PathBuf],
        task: &TaskContext,
    ) -> Result<Option<PathBuf>>;
    /// Returns a mark on a recording with the mask of the object that it points at, if the Segment Anything in
    /// the folder `model` finds one.
    fn with_mask(&self, model: &Path, recording: &Path, mark: &Mark) -> Result<Mark>;
    /// Trains and saves a scene. After a cancellation, the scene learned so far is still saved and returned.
    fn reconstruct(&self, request: &TrainRequest, task: &TaskContext<TrainNews>) -> Result<PathBuf>;
}

/// News from a running training.
pub(crate) enum TrainNews {
    /// An intermediate state that can be looked at.
    Preview(Box<dyn FrameSource>),
    /// A step and its loss.
    Step(usize, LossTerms<f32>),
}

/// Result of the check of a recording.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Checked {
    pub(crate) report: CheckReport,
    /// `true` if the masks can be inverted.
    pub(crate) can_flip: bool,
}

/// The built-in demo.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Demo {
    /// Path to open.
    pub(crate) path: PathBuf,
    /// Training that makes the scene, if there is none yet.
    pub(crate) train: Option<TrainRequest>,
}

/// Everything that training depends on.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct TrainRequest {
    pub(crate) recording: PathBuf,
    /// The scene file to write.
    pub(crate) scene: PathBuf,
    /// `true` if the user agreed to replace an earlier scene of this name.
    pub(crate) replaces: bool,
    pub(crate) quality: Quality,
    /// Ranges of frames that are not trained on.
    pub(crate) excluded: Vec<(usize, usize)>,
    /// Source of what words are found by.
    pub(crate) words: Words,
    /// Folder of what networks find, and may have found before; `None` for the one beside the scene.
    pub(crate) features: Option<PathBuf>,
}

/// Source of what words are found by in a reconstruction. A prepared folder has its own.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) enum Words {
    /// The recording's class labels, if it has some.
    #[default]
    Labels,
    /// Networks that find regions and tell what they show.
    Models(Models),
    /// Nothing: pictures alone.
    Nothing,
}

/// Networks that make a recording without labels searchable.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(default)]
pub(crate) struct Models {
    /// Folder with a Segment Anything, which finds regions.
    pub(crate) masks: PathBuf,
    /// Folder with an image encoder, which tells what regions show.
    pub(crate) images: PathBuf,
    /// Folder with the text encoder that belongs to it; empty for the built-in one.
    pub(crate) texts: PathBuf,
    /// Number of points along each side of a picture at which regions are looked for.
    pub(crate) points_per_side: usize,
}

impl Default for Models {
    fn default() -> Self {
        let none = PathBuf::new;
        Self { masks: none(), images: none(), texts: none(), points_per_side: 16 }
    }
}

/// Faults of models, each in words; `None` where one can be used.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct ModelFaults {
    pub(crate) masks: Option<String>,
    pub(crate) images: Option<String>,
    pub(crate) texts: Option<String>,
}

impl ModelFaults {
    /// Returns `true` if all models can be used together.
    pub(crate) fn is_none(&self) -> bool {
        self.masks.is_none() && self.images.is_none() && self.texts.is_none()
    }
}

/// Extension of scene files.
pub(crate) const SCENE: &str = "safetensors";

/// Beginning of the names of stages before the training itself.
pub(crate) const PREPARING: &str = "preparing";

impl TrainRequest {
    /// Returns the folder of what networks find, which stays, so that the work goes on there after a stop.
    pub(crate) fn features_folder(&self) -> PathBuf {
        self.features.clone().unwrap_or_else(|| earlier::features_beside(&self.scene))
    }
}
