//! A recorded operation on disk: frames, cameras, depth, masks, labels. Decoded lazily, never modified.

use crate::{
    Result,
    camera::Camera,
    grid::{Grid, Mask},
};
use image::RgbImage;
use std::path::Path;

/// The folder layouts that are recognised, by content and never by name.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Layout {
    /// `images/ masks/ [depth/] poses_bounds.npy`.
    EndoNerf,
    /// The reference's CholecSeg8K / EndoVis18 layout: `images/ masks/ disps|depth_mu/ test_seg/`.
    Reference,
    /// Raw CholecSeg8K: `frame_*_endo.png` with `_watershed_mask`.
    CholecSeg8k,
    /// Raw EndoVis18: `left_frames/ labels/ labels.json`.
    EndoVis18,
    /// nerfstudio's `transforms.json`.
    Transforms,
    /// A folder of images.
    Images,
    /// A video file.
    Video,
}

/// Where the cameras come from.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum CameraSource {
    /// Read from the recording or its `sequence.toml`.
    Given,
    /// Assumed: a still pinhole with this horizontal field of view, in degrees.
    Assumed(f32),
}

/// A kind of tissue or instrument.
#[derive(Clone, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub struct Class {
    /// Value in a [`LabelMap`].
    pub id: u8,
    /// Name in plain lower-case words, e.g. "abdominal wall"; also the prompt that finds it.
    pub name: String,
    /// Display colour (sRGB).
    pub colour: [u8; 3],
}

/// Class ids per pixel; [`NO_LABEL`] where unknown.
pub type LabelMap = Grid<u8>;

/// The id of a pixel whose class is unknown.
pub const NO_LABEL: u8 = 255;

/// A recording; see the accessors.
#[derive(Clone, Debug)]
pub struct Sequence {}

impl Sequence {
    /// Opens a folder or a video file; the layout is recognised by content.
    pub fn open(path: &Path) -> Result<Self> {
        let _ = path;
        todo!()
    }
    /// The folder or file that was opened.
    pub fn path(&self) -> &Path {
        todo!()
    }
    /// Folder or file name, for titles.
    pub fn name(&self) -> String {
        todo!()
    }
    /// The recognised layout.
    pub fn layout(&self) -> Layout {
        todo!()
    }
    /// Number of frames, at least 1.
    pub fn num_frames(&self) -> usize {
        todo!()
    }
    /// Image columns.
    pub fn width(&self) -> usize {
        todo!()
    }
    /// Image rows.
    pub fn height(&self) -> usize {
        todo!()
    }
    /// File stem of frame `i` (or its number, for a video).
    pub fn frame_name(&self, i: usize) -> String {
        let _ = i;
        todo!()
    }
    /// Time of frame `i`: i / N.
    pub fn time(&self, i: usize) -> f32 {
        i as f32 / self.num_frames() as f32
    }
    /// Whether frame `i` is held out under `--eval`: (i − 1) mod 8 = 0.
    pub fn is_test_frame(i: usize) -> bool {
        i % 8 == 1
    }
    /// Recording speed, where known.
    pub fn frames_per_second(&self) -> Option<f32> {
        todo!()
    }
    /// The camera of frame `i`.
    pub fn camera(&self, i: usize) -> Camera {
        let _ = i;
        todo!()
    }
    /// Where the cameras come from.
    pub fn camera_source(&self) -> CameraSource {
        todo!()
    }
    /// Whether the camera's pose changes during the recording.
    pub fn camera_moves(&self) -> bool {
        todo!()
    }
    /// Decodes frame `i`.
    pub fn frame(&self, i: usize) -> Result<RgbImage> {
        let _ = i;
        todo!()
    }
    /// Depth (z) of frame `i` in scene units, 0 where unknown; `None` if the recording has no depth.
    pub fn depth(&self, i: usize) -> Result<Option<Grid<f32>>> {
        let _ = i;
        todo!()
    }
    /// Supervision mask of frame `i`: `true` = keep; the recording's masks (polarity resolved)
    /// and the field of view together.
    pub fn mask(&self, i: usize) -> Result<Mask> {
        let _ = i;
        todo!()
    }
    /// The round endoscopic picture or the area inside a black border; `true` = inside.
    pub fn field_of_view(&self) -> &Mask {
        todo!()
    }
    /// Class labels of frame `i`; `None` if the recording has none for it.
    pub fn labels(&self, i: usize) -> Result<Option<LabelMap>> {
        let _ = i;
        todo!()
    }
    /// The classes that labels refer to; empty without labels.
    pub fn classes(&self) -> &[Class] {
        todo!()
    }
}

/// What `check` reports (design §9); the JSON keys are a contract.
#[derive(Debug, serde::Serialize)]
pub struct Report {
    /// No errors.
    pub ok: bool,
    /// Number of frames.
    pub frames: usize,
    /// Image columns.
    pub width: usize,
    /// Image rows.
    pub height: usize,
    /// Camera source, field of view, still or moving, in words.
    pub camera: String,
    /// Depth kind, range and share of valid pixels, in words.
    pub depth: String,
    /// Mask polarity, share kept, field of view, in words.
    pub masks: String,
    /// Classes and in how many frames they occur, in words.
    pub labels: String,
    /// What the user should know.
    pub warnings: Vec<String>,
    /// What would make training wrong.
    pub errors: Vec<String>,
}

/// Reads every frame once and reports; wrong files become entries of `errors`, not an `Err`.
pub fn check(sequence: &Sequence, progress: &mut dyn FnMut(usize, usize)) -> Report {
    let _ = (sequence, progress);
    todo!()
}
