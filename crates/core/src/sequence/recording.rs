//! The contents of a recording, as its layout describes them.

use super::{
    classes::{self, Class, NO_LABEL},
    depth::DepthRule,
    dicom::{DicomPictures, Origin},
    ffmpeg::Stream,
    h264::H264,
    hidden::{self, HiddenRectangle},
    labels::{LabelCoding, LabelFiles, NumbersAre, ReadLabels, numbers_of},
    read, segmentation,
    settings_file::settings_name,
    times::Gaps,
};
use crate::{
    Error, Result,
    annotations::{self, Canvas},
    camera::Camera,
    dicom::is_dicom,
    grid::{Grid, Mask},
    reading::is_present,
};
use image::RgbImage;
use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
    sync::Arc,
};
use tempfile::TempDir;

/// Number of label pictures that are read to find out the meaning of their numbers.
pub(super) const LABEL_PICTURES: usize = 8;
/// Difference of frame rates, as a share of them, that is none.
const SAME_SPEED: f32 = 0.01;
/// Horizontal field of view that is assumed if none is known, in degrees.
pub(super) const ASSUMED_FOV_DEGREES: f32 = 60.0;

/// Source of the cameras.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum CameraSource {
    /// Lens and poses were read from the recording.
    Given,
    /// The lens was read from the recording or its `sequence.toml`; the camera is assumed to stand still.
    Lens,
    /// Assumed: a still pinhole with this horizontal field of view, in degrees.
    Assumed(f32),
}

/// Tells if frame `i` is one of those that an evaluation holds out.
pub(super) fn is_test_frame(i: usize) -> bool {
    i % 8 == 1
}

/// The recorded frames that are used.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Selection {
    pub first: usize,
    pub last: Option<usize>,
    pub every: usize,
}

impl Selection {
    /// Everything.
    #[cfg(test)]
    pub(super) const ALL: Self = Self { first: 0, last: None, every: 1 };

    /// Returns the numbers of the used frames among `n`. The error says what is wrong if there are none.
    pub(super) fn indices(&self, n: usize) -> Result<Vec<usize>, String> {
        let last = self.last.unwrap_or(n.saturating_sub(1));
        if self.first > last || last >= n {
            return Err(format!(
                "frames {} to {last} are asked for, the recording has frames 0 to {}",
                self.first,
                n.saturating_sub(1)
            ));
        }
        Ok((self.first..=last).step_by(self.every.max(1)).collect())
    }
}

/// Everything that `open` finds out; pictures are decoded on request.
#[derive(Debug)]
pub(super) struct Recording {
    pub path: PathBuf,
    pub width: usize,
    pub height: usize,
    pub frames: Vec<FrameFiles>,
    /// Cameras, one per frame.
    pub cameras: Vec<Camera>,
    pub camera_source: CameraSource,
    /// Width of a pixel by its height.
    pub pixel_aspect: f32,
    pub depth_rule: DepthRule,
    pub mask_rule: MaskRule,
    pub detect_field_of_view: bool,
    pub coding: LabelCoding,
    pub classes: Vec<Class>,
    pub frames_per_second: Option<f32>,
    /// Times of all frames, seconds on the clock of the files; empty if they are not known.
    pub seconds: Vec<f64>,
    /// Notes for the user about how the files were understood.
    pub notes: Vec<String>,
    /// Notes that nobody should miss who works with the recording: other programs show other frames.
    pub cautions: Vec<String>,
    /// Folders of what was unpacked of videos; removed with the recording.
    pub scratch: Vec<TempDir>,
    /// The videos that ffmpeg reads: their frames have no bytes of their own.
    pub read_by_ffmpeg: Vec<PathBuf>,
    /// The DICOM files that the frames come from.
    pub dicom: Option<Origin>,
    /// Parts of every frame that are black, whatever the files show there.
    pub hidden: Vec<HiddenRectangle>,
}

/// The files of one frame.
#[derive(Debug)]
pub(super) struct FrameFiles {
    pub name: String,
    pub picture: Picture,
    pub mask: Option<PathBuf>,
    pub depth: Option<PathBuf>,
    pub labels: Option<LabelFiles>,
}

/// Source of the pixels of one frame.
#[derive(Debug)]
pub(super) enum Picture {
    File(PathBuf),
    Video { video: Arc<H264>, index: usize },
    Stream { stream: Arc<Stream>, index: usize },
    Dicom { frames: Arc<DicomPictures>, index: usize },
}

/// The pixels that a mask file keeps; [`read::least_white`] says what is white.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum MaskRule {
    /// White is kept.
    KeepWhite,
    /// Black is kept: white hides.
    KeepBlack,
    /// The mask is a label picture; only this code is hidden.
    DropCode(u8),
}

/// A side of a mask file.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Keep {
    /// White pixels: all that are not black.
    White,
    /// Black pixels.
    Black,
}

impl Keep {
    pub(super) fn rule(self) -> MaskRule {
        match self {
            Self::White => MaskRule::KeepWhite,
            Self::Black => MaskRule::KeepBlack,
        }
    }
}

impl Recording {
    /// Creates a recording of `pictures` with an assumed still camera and nothing else.
    pub(super) fn of_pictures(path: &Path, pictures: &[PathBuf]) -> Result<Self> {
        let size = read::common_size(pictures)?;
        let frames = pictures.iter().map(|p| FrameFiles::new(read::stem(p), Picture::File(p.clone())));
        Ok(Self::new(path, size, frames.collect()))
    }

    pub(super) fn new(path: &Path, (width, height): (usize, usize), frames: Vec<FrameFiles>) -> Self {
        let camera = Camera::with_field_of_view(width as u32, height as u32, ASSUMED_FOV_DEGREES);
        Self {
            path: path.to_owned(),
            width,
            height,
            cameras: vec![camera; frames.len()],
            frames,
            camera_source: CameraSource::Assumed(ASSUMED_FOV_DEGREES),
            pixel_aspect: 1.0,
            depth_rule: DepthRule::default(),
            mask_rule: MaskRule::KeepWhite,
            detect_field_of_view: true,
            coding: LabelCoding::IdsOrColours,
            classes: Vec::new(),
            frames_per_second: None,
            seconds: Vec::new(),
            notes: Vec::new(),
            cautions: Vec::new(),
            scratch: Vec::new(),
            read_by_ffmpeg: Vec::new(),
            dicom: None,
            hidden: Vec::new(),
        }
    }

    /// Gives its assumed cameras pixels that are not square, if the file tells of such.
    pub(super) fn shape_pixels(&mut self, aspect: Option<f32>) {
        /// Difference from square pixels that is none, as a share.
        const SQUARE: f32 = 0.01;
        let Some(aspect) = aspect.filter(|aspect| (aspect - 1.0).abs() > SQUARE) else { return };
        self.pixel_aspect = aspect;
        self.cameras.iter_mut().for_each(|camera| camera.fy = camera.fx * aspect);
        self.notes.push(format!(
            "Pixels are {aspect:.3} times as wide as high: fy = {aspect:.3} fx is assumed. A round border is not \
             found in them: if there is one, make them square by ffmpeg -vf scale=iw*sar:ih,setsar=1"
        ));
    }

    /// Appends the frames of a video file; the recording is empty, or made of such files.
    pub(super) fn append(&mut self, file: &Path, part: Self) -> Result<()> {
        let size = (part.width, part.height);
        self.append_times(&part);
        if self.frames.is_empty() {
            (self.width, self.height) = size;
            self.pixel_aspect = part.pixel_aspect;
            self.frames_per_second = part.frames_per_second;
        } else if (self.width, self.height) != size {
            let what = format!(
                "the pictures of this video are {}×{}, those of the first are {}×{}",
                size.0, size.1, self.width, self.height
            );
            return Err(Error::input_at(file, what, "Open it by itself, or move it elsewhere."));
        }
        let (name, first) = (read::stem(file), self.frames.len());
        if let (Some(speed), Some(other)) = (self.frames_per_second, part.frames_per_second)
            && (speed - other).abs() > SAME_SPEED * speed
        {
            self.notes.push(format!(
                "{name} has {other:.2} frames per second, the first video {speed:.2}, which counts for all"
            ));
        }
        let last = first + part.frames.len().saturating_sub(1);
        self.notes.push(format!("Frames {first} to {last} are those of {name}"));
        let of_part = |note: String| format!("{name}: {note}");
        self.notes.extend(part.notes.into_iter().map(of_part));
        self.cautions.extend(part.cautions.into_iter().map(of_part));
        self.frames.extend(
            part.frames
                .into_iter()
                .map(|frame| FrameFiles { name: format!("{name}_{}", frame.name), ..frame }),
        );
        self.cameras.extend(part.cameras);
        self.scratch.extend(part.scratch);
        self.read_by_ffmpeg.extend(part.read_by_ffmpeg);
        self.hidden.extend(part.hidden);
        Ok(())
    }

    /// Appends the times of the frames of `part`, which begins when the last frame has been shown.
    fn append_times(&mut self, part: &Self) {
        let is_known = part.seconds.len() == part.frames.len() && self.seconds.len() == self.frames.len();
        let offset = match (self.seconds.last(), part.seconds.first(), self.frames_per_second) {
            (None, _, _) => Some(0.0),
            (Some(end), Some(begin), Some(speed)) => Some(end + 1.0 / f64::from(speed) - begin),
            _ => None,
        };
        match offset.filter(|_| is_known) {
            Some(offset) => self.seconds.extend(part.seconds.iter().map(|t| t + offset)),
            None => self.seconds.clear(),
        }
    }

    /// Tells of gaps in the numbers of pictures, and gives frames the times that follow from these at a known
    /// speed.
    pub(super) fn time_gaps(&mut self) {
        let is_file = |frame: &FrameFiles| matches!(frame.picture, Picture::File(_));
        if !self.read_by_ffmpeg.is_empty() || !self.frames.iter().all(is_file) {
            return;
        }
        let names: Vec<&str> = self.frames.iter().map(|frame| frame.name.as_str()).collect();
        if let Some(gaps) = Gaps::of(&names) {
            self.notes.push(gaps.describe(&names, self.frames_per_second));
            self.seconds = self.frames_per_second.map_or_else(Vec::new, |speed| gaps.seconds(speed));
        }
    }

    /// Gives every frame its mask from `folder`, if that exists.
    pub(super) fn add_masks(&mut self, folder: &Path) -> Result<()> {
        for (frame, file) in self.companions(folder, read::PICTURES, "masks", false)? {
            frame.mask = Some(file);
        }
        Ok(())
    }

    /// Gives frames their depth map (PNG or npy) from `folder`, if that exists; not every frame needs one.
    pub(super) fn add_depth(&mut self, folder: &Path) -> Result<()> {
        for (frame, file) in self.companions(folder, &["png", "npy"], "depth maps", true)? {
            frame.depth = Some(file);
        }
        Ok(())
    }

    /// Gives frames their label picture from `folder` (not every frame needs one) and reads `list`.
    pub(super) fn add_labels(&mut self, folder: &Path, list: &Path) -> Result<()> {
        for (frame, file) in self.companions(folder, &["png"], "label pictures", true)? {
            frame.labels = Some(LabelFiles::Picture(file));
        }
        if is_present(list) {
            self.classes = classes::read_json(list)?;
        }
        Ok(())
    }

    /// Returns what annotations of the recording are made on.
    pub(super) fn canvas(&self) -> Canvas {
        let frame_names = self.frames.iter().map(|frame| frame.name.clone()).collect();
        Canvas { width: self.width, height: self.height, frame_names, num_frames: self.frames.len() }
    }

    /// Takes the labels of all frames from a file of annotations, or from a DICOM segmentation, instead of the
    /// recording's own. A class of annotations keeps its id and colour if the recording has one of the same name.
    pub(super) fn take_labels(&mut self, file: &Path) -> Result<()> {
        if is_dicom(file) {
            self.frames.iter_mut().for_each(|frame| frame.labels = None);
            return segmentation::add_labels(self, file);
        }
        let annotations = annotations::read(file, &self.canvas())?;
        self.classes = classes::named(&annotations, &self.classes, file)?;
        self.frames.iter_mut().for_each(|frame| frame.labels = None);
        for annotation in annotations {
            let name = classes::plain_words(&annotation.name);
            let Some(class) = self.classes.iter().find(|class| class.name == name) else { continue };
            let labels = &mut self.frames[annotation.frame].labels;
            if let LabelFiles::Shapes(shapes) = labels.get_or_insert(LabelFiles::Shapes(Vec::new())) {
                shapes.push((class.id, annotation.shape));
            }
        }
        Ok(())
    }

    /// Pairs the files of `folder` with frames. Equal names match; if no name is shared and the numbers
    /// agree, files match by order. `partial` allows frames without a file.
    fn companions(
        &mut self,
        folder: &Path,
        endings: &[&str],
        what: &str,
        partial: bool,
    ) -> Result<Vec<(&mut FrameFiles, PathBuf)>> {
        let files = if folder.is_dir() { read::list(folder, endings)? } else { Vec::new() };
        if files.is_empty() {
            return Ok(Vec::new());
        }
        let mut by_name: BTreeMap<String, PathBuf> =
            files.iter().map(|f| (read::stem(f), f.clone())).collect();
        let shared = self.frames.iter().filter(|f| by_name.contains_key(&f.name)).count();
        if shared == files.len() && (partial || shared == self.frames.len()) {
            return Ok(self
                .frames
                .iter_mut()
                .filter_map(|f| by_name.remove(&f.name).map(|p| (f, p)))
                .collect());
        }
        if files.len() != self.frames.len() {
            return Err(Error::input_at(
                folder,
                format!("{} images but {} {what}", self.frames.len(), files.len()),
                "There must be one per image, with the same file name or in the same order.",
            ));
        }
        if shared > 0 {
            let stray = files.iter().find(|f| !self.frames.iter().any(|frame| frame.name == read::stem(f)));
            return Err(Error::input_at(
                stray.unwrap_or(&files[0]),
                format!("only {shared} of {} {what} are named like an image", files.len()),
                "Give every file the name of its image, or number both from the same start.",
            ));
        }
        Ok(self.frames.iter_mut().zip(files).collect())
    }

    /// Keeps only the frames that `selection` names.
    pub(super) fn select(mut self, selection: &Selection) -> Result<Self> {
        let keep = selection.indices(self.frames.len()).map_err(|what| {
            let hint = format!("Look at [frames] and [time] in {}.", settings_name(&self.path));
            Error::input_at(&self.path, what, hint)
        })?;
        let mut frames: Vec<_> = self.frames.into_iter().map(Some).collect();
        self.frames = keep.iter().filter_map(|&i| frames[i].take()).collect();
        self.cameras = keep.iter().map(|&i| self.cameras[i]).collect();
        if !self.seconds.is_empty() {
            self.seconds = keep.iter().map(|&i| self.seconds[i]).collect();
        }
        if let Some(origin) = &mut self.dicom {
            origin.select(&keep);
        }
        Ok(self)
    }

    /// Returns an error if a recording cannot be used at all, whatever its pixels hold.
    pub(super) fn validate(self) -> Result<Self> {
        let labelled = self.frames.iter().find_map(|f| f.labels.as_ref());
        if let (Some(labels), true) = (labelled, self.classes.is_empty()) {
            return Err(Error::input_at(
                labels.paths().first().unwrap_or(&self.path.as_path()),
                "there are label pictures but no class list says what they mean",
                format!(
                    "Add labels.json beside the folder, or [[classes]] to {}.",
                    settings_name(&self.path)
                ),
            ));
        }
        hidden::require_inside(&self.hidden, (self.width, self.height))
            .map_err(|what| Error::input_at(&self.path, what, "Look at what is to be hidden."))?;
        for (i, camera) in self.cameras.iter().enumerate() {
            let intrinsics = [camera.fx, camera.fy, camera.cx, camera.cy];
            if !intrinsics.iter().all(|v| v.is_finite()) || camera.fx <= 0.0 || camera.fy <= 0.0 {
                return Err(Error::input_at(
                    &self.path,
                    format!("the camera of frame {i} has fx, fy, cx, cy = {intrinsics:?}"),
                    "Focal lengths must be positive numbers.",
                ));
            }
            if !camera.camera_from_world.is_finite() {
                let what = format!("the pose of frame {i} has a number that is too large or none");
                return Err(Error::input_at(&self.path, what, "Correct the poses."));
            }
        }
        Ok(self)
    }

    /// Returns the files of all frames, but for videos.
    pub(super) fn files(&self) -> impl Iterator<Item = &Path> {
        let dicom = self.dicom.iter().flat_map(Origin::files).map(PathBuf::as_path);
        dicom.chain(self.frames.iter().flat_map(|frame| {
            let picture = match &frame.picture {
                Picture::File(path) => Some(path.as_path()),
                Picture::Video { .. } | Picture::Stream { .. } | Picture::Dicom { .. } => None,
            };
            let maps = [frame.mask.as_deref(), frame.depth.as_deref(), picture];
            let labels = frame.labels.iter().flat_map(LabelFiles::paths);
            maps.into_iter().flatten().chain(labels)
        }))
    }

    /// Returns `true` if a frame is decoded from the one before it.
    pub(super) fn is_decoded_in_order(&self) -> bool {
        self.frames
            .iter()
            .any(|frame| matches!(frame.picture, Picture::Video { .. } | Picture::Stream { .. }))
    }

    /// Returns a frame at or before frame `i` that is decoded quickly, if one is not farther than `most` frames
    /// away; else `i`.
    pub(super) fn entry_near(&self, i: usize, most: usize) -> usize {
        let (index, entry) = match &self.frames[i].picture {
            Picture::Video { video, index } => (*index, video.entry_before(*index)),
            Picture::Stream { stream, index } => (*index, stream.entry_before(*index)),
            Picture::File(_) | Picture::Dicom { .. } => return i,
        };
        let Some(near) = i.checked_sub(index - entry).filter(|near| i - near <= most) else { return i };
        let is_it = match &self.frames[near].picture {
            Picture::Video { index, .. } | Picture::Stream { index, .. } => *index == entry,
            Picture::File(_) | Picture::Dicom { .. } => false,
        };
        if is_it { near } else { i }
    }

    /// Returns the complaints of ffmpeg about the contents of frames that were decoded, once for each video.
    pub(super) fn complaints(&self) -> Vec<String> {
        let streams = self.frames.iter().filter_map(|frame| match &frame.picture {
            Picture::Stream { stream, .. } => Some(stream),
            _ => None,
        });
        let mut streams: Vec<_> = streams.collect();
        streams.dedup_by(|a, b| Arc::ptr_eq(a, b));
        streams.into_iter().filter_map(|stream| stream.complaint()).collect()
    }

    /// Decodes frame `i`; hidden parts are black.
    pub(super) fn frame(&self, i: usize) -> Result<RgbImage> {
        let mut frame = self.frame_in_full(i)?;
        hidden::blacken(&mut frame, &self.hidden);
        Ok(frame)
    }

    /// Decodes frame `i` with its hidden parts, which nobody may see.
    pub(super) fn frame_in_full(&self, i: usize) -> Result<RgbImage> {
        match &self.frames[i].picture {
            Picture::File(path) => read::frame(path, self.width, self.height),
            Picture::Video { video, index } => video.frame(*index),
            Picture::Stream { stream, index } => stream.frame(*index),
            Picture::Dicom { frames, index } => frames.frame(*index),
        }
    }

    /// Returns the pixels that the mask file of frame `i` keeps; `None` if it has no mask file.
    pub(super) fn file_mask(&self, i: usize) -> Result<Option<Mask>> {
        let Some(path) = &self.frames[i].mask else { return Ok(None) };
        let values = read::lightness(path)?;
        read::expect_size(path, (values.width, values.height), (self.width, self.height))?;
        let white = read::least_white(path);
        Ok(Some(match self.mask_rule {
            MaskRule::KeepWhite => values.map(|&v| v >= white),
            MaskRule::KeepBlack => values.map(|&v| v < white),
            MaskRule::DropCode(code) => values.map(|&v| v != u16::from(code)),
        }))
    }

    /// Reads the labels of frame `i`; `None` if it has none.
    pub(super) fn labels(&self, i: usize, numbers: NumbersAre) -> Result<Option<ReadLabels>> {
        let Some(files) = &self.frames[i].labels else { return Ok(None) };
        let mut labels = files.read(&self.coding, numbers, &self.classes, (self.width, self.height))?;
        hidden::fill(&mut labels.ids, &self.hidden, NO_LABEL);
        Ok(Some(labels))
    }

    /// Decides the meaning of the numbers of its label pictures, from some of them, evenly spread.
    pub(super) fn label_numbers(&self) -> NumbersAre {
        if !matches!(self.coding, LabelCoding::IdsOrColours) {
            return NumbersAre::Coded;
        }
        let pictures = self.frames.iter().filter_map(|frame| match &frame.labels {
            Some(LabelFiles::Picture(path)) => Some(path.as_path()),
            _ => None,
        });
        let pictures: Vec<&Path> = pictures.collect();
        let spread = pictures
            .iter()
            .step_by(pictures.len().div_ceil(LABEL_PICTURES).max(1))
            .copied()
            .collect::<Vec<_>>();
        numbers_of(&spread, &self.coding, &self.classes, NumbersAre::Coded)
    }

    /// Reads the depth of frame `i` at the frames' size, 0 where unknown.
    pub(super) fn depth(&self, i: usize) -> Result<Option<Grid<f32>>> {
        let Some(path) = &self.frames[i].depth else { return Ok(None) };
        let mut depth = self.depth_rule.read(path)?.resized(self.width, self.height);
        hidden::fill(&mut depth, &self.hidden, 0.0);
        Ok(Some(depth))
    }
}

impl FrameFiles {
    pub(super) fn new(name: String, picture: Picture) -> Self {
        Self { name, picture, mask: None, depth: None, labels: None }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn selection_counts_from_the_first_frame_that_is_used() {
        let selection = Selection { first: 1, last: Some(8), every: 3 };
        assert_eq!(selection.indices(10).unwrap(), [1, 4, 7]);
        assert!(selection.indices(8).is_err());
        assert!(Selection { first: 5, last: Some(4), every: 1 }.indices(10).is_err());
        assert_eq!(Selection { first: 0, last: None, every: 1 }.indices(2).unwrap(), [0, 1]);
    }
}
