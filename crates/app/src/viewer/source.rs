//! The seam between the window and everything that computes: what the window asks for, as traits.
//!
//! [`super::engine_source`] answers with the real engine; tests answer with a small fake.

use super::{excluded::included, jobs::JobContext, measure::Lens, orbit::Orbit};
use crate::{
    engine::{Negatives, Question, Sample},
    evaluation::Evaluation,
};
use image::RgbImage;
use std::path::{Path, PathBuf};
use surgtpgs_core::{
    Result,
    export::{Format, num_files},
    grid::{Grid, Mask},
    mask::CleanUp,
    overlay::OverlayLook,
    raster::FrameClock,
    sequence::Report,
};

/// What is known about a scene or a recording as soon as it is open.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Info {
    /// For titles.
    pub(crate) name: String,
    /// What was opened.
    pub(crate) path: PathBuf,
    /// What a reconstruction of it is made from: a recording or a prepared folder; `None` where it is not at hand.
    pub(crate) recording: Option<PathBuf>,
    /// Where the recorded frames are or were, without links: the same for everything made of one recording.
    pub(crate) sequence: Option<PathBuf>,
    /// Names and sizes of the recording's frames, hashed; `None` where they are not known.
    pub(crate) frames_sha256: Option<String>,
    pub(crate) num_frames: usize,
    pub(crate) width: usize,
    pub(crate) height: usize,
    pub(crate) frames_per_second: Option<f32>,
    pub(crate) camera_moves: bool,
    /// The camera's optics, for lengths in space.
    pub(crate) lens: Option<Lens>,
    /// Recorded frames can be shown.
    pub(crate) has_original: bool,
    /// Why not, in a sentence.
    pub(crate) original_missing: Option<String>,
    /// There is a reconstruction to render.
    pub(crate) has_reconstruction: bool,
    /// Prompts can be asked.
    pub(crate) has_features: bool,
    /// The recording has class labels, from which features can be made.
    pub(crate) has_labels: bool,
    /// What could be asked, e.g. the class names.
    pub(crate) example_prompts: Vec<String>,
    /// What renders, e.g. "CPU, 2 threads".
    pub(crate) renderer: String,
    /// Things about this scene that the user should know, a few words and a sentence each.
    pub(crate) notes: Vec<(String, String)>,
    /// A folder that can be written to, for what is made of it.
    pub(crate) output_folder: PathBuf,
}

impl Info {
    /// Whether both are of one recording; where it is not known, by name and length.
    pub(crate) fn is_same_recording(&self, other: &Self) -> bool {
        match (&self.sequence, &other.sequence) {
            (Some(mine), Some(theirs)) => mine == theirs,
            _ => (&self.name, self.num_frames) == (&other.name, other.num_frames),
        }
    }
}

/// What to render.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct View {
    pub(crate) frame: usize,
    pub(crate) orbit: Orbit,
    /// Half the width and height, while something moves.
    pub(crate) is_preview: bool,
}

/// A rendered view.
#[derive(Clone, Debug)]
pub(crate) struct Rendering {
    pub(crate) colour: RgbImage,
    /// Scene units; 0 where there is nothing.
    pub(crate) depth: Grid<f32>,
    /// What the endoscope did not see, where the view is not its own.
    pub(crate) unseen: Option<Mask>,
}

/// An open scene or recording. A worker thread owns it.
pub(crate) trait FrameSource: Send {
    fn info(&self) -> &Info;
    /// The frame as it was recorded.
    fn original(&mut self, frame: usize) -> Result<RgbImage>;
    /// Where instruments are on the frame as it was recorded; `None` where that is not known.
    fn instruments(&mut self, _: usize) -> Result<Option<Mask>> {
        Ok(None)
    }
    /// Renders; `with_features` promises that [`FrameSource::scores`] of the same view will be asked for.
    fn render(&mut self, view: &View, with_features: bool) -> Result<Rendering>;
    /// One score image per question in the view that was rendered last, of its size; an error concerns its question alone.
    fn scores(&mut self, view: &View, questions: &[Question]) -> Vec<Result<Grid<f32>>>;
    /// How far what a view shows moves over the recording, px, not a number where nothing is; and in words what moves.
    fn motion(&mut self, view: &View) -> Result<(Grid<f32>, String)>;
    /// How opaque a view is, 0–1.
    fn opacity(&mut self, view: &View) -> Result<Grid<f32>>;
    /// What a point of a view shows, the point as share of width and height; `None` where nothing was reconstructed.
    fn sample(&mut self, _: &View, _: [f32; 2]) -> Result<Option<Sample>> {
        Ok(None)
    }
    /// Whether views may be asked for before anybody wants to see them.
    fn prepares_ahead(&self) -> bool {
        true
    }
    /// How often each pass of a frame ran so far.
    fn clock(&self) -> FrameClock {
        FrameClock::default()
    }
}

/// Opens, exports and trains. All methods run on worker threads and take as long as they need.
pub(crate) trait Backend: Send + Sync {
    fn open(&self, path: &Path) -> Result<Box<dyn FrameSource>>;
    /// Reads a whole recording and says what is in it.
    fn check(&self, path: &Path, job: &JobContext) -> Result<Checked>;
    /// Turns round which side of a recording's masks is kept.
    fn flip_masks(&self, path: &Path) -> Result<PathBuf>;
    /// Makes sure that the built-in demo is under `folder`: its scene, or at least its recording.
    fn demo(&self, folder: &Path, job: &JobContext) -> Result<Demo>;
    /// Writes files. When cancelled, finished files stay and the same request goes on from there.
    fn export(&self, request: &ExportRequest, job: &JobContext) -> Result<ExportSummary>;
    /// Compares a scene with its recording: pictures, depth and the masks of its classes.
    fn evaluate(&self, scene: &Path, job: &JobContext) -> Result<Evaluation>;
    /// Memory that is left, bytes; `None` where the system does not tell.
    fn available_bytes(&self) -> Option<u64> {
        None
    }
    /// Trains and saves a scene. When cancelled, what was learned so far is saved and returned all the same.
    fn reconstruct(&self, request: &TrainRequest, job: &JobContext) -> Result<PathBuf>;
}

/// What a recording holds.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Checked {
    pub(crate) report: Report,
    /// Its masks can be turned round.
    pub(crate) can_flip: bool,
}

/// One prompt of an export.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct ExportPrompt {
    pub(crate) question: Question,
    pub(crate) threshold: f32,
    pub(crate) colour: [u8; 3],
    pub(crate) is_instrument: bool,
}

/// Everything that an export depends on.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct ExportRequest {
    pub(crate) scene: PathBuf,
    pub(crate) folder: PathBuf,
    pub(crate) formats: Vec<Format>,
    /// First and last frame.
    pub(crate) frames: (usize, usize),
    /// Ranges of frames that are left out.
    pub(crate) excluded: Vec<(usize, usize)>,
    /// Draw on recorded frames, not on rendered ones.
    pub(crate) from_original: bool,
    pub(crate) prompts: Vec<ExportPrompt>,
    /// What prompts without exceptions of their own are compared with.
    pub(crate) negatives: Negatives,
    /// Every pixel belongs to at most one prompt.
    pub(crate) is_exclusive: bool,
    /// How overlays are drawn.
    pub(crate) look: OverlayLook,
    /// What is done to masks.
    pub(crate) clean_up: CleanUp,
}

impl ExportRequest {
    /// How many files it will write; a record and the names of labels come on top.
    pub(crate) fn num_files(&self) -> usize {
        num_files(&self.formats, self.frames().len(), self.prompts.len())
    }

    /// The frames that are exported.
    pub(crate) fn frames(&self) -> Vec<usize> {
        included(self.frames, &self.excluded)
    }

    /// Whether a file about all frames is wanted of frames that are not in one piece.
    pub(crate) fn has_gaps(&self) -> bool {
        let frames = self.frames();
        self.formats.iter().any(|f| f.is_series()) && frames.windows(2).any(|pair| pair[0] + 1 != pair[1])
    }
}

/// Where the demo is.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Demo {
    /// What to open.
    pub(crate) path: PathBuf,
    /// The scene to make of it, if there is none yet.
    pub(crate) train: Option<TrainRequest>,
}

/// What an export did.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct ExportSummary {
    /// All frames that were asked for are there.
    pub(crate) is_complete: bool,
    pub(crate) num_files: usize,
    pub(crate) folder: PathBuf,
}

/// Everything that training depends on.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct TrainRequest {
    pub(crate) recording: PathBuf,
    /// The scene file to write.
    pub(crate) scene: PathBuf,
    pub(crate) iterations: usize,
    /// Ranges of frames that nothing is learned from.
    pub(crate) excluded: Vec<(usize, usize)>,
}
