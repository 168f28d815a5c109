//! The contents of a recording as its layout describes them, and the recognition of layouts.

use super::{
    CameraSource, Class, Layout, cholecseg8k, classes,
    depth::DepthRule,
    endonerf, endovis18, images,
    labels::{LabelCoding, LabelFiles, NumbersAre, ReadLabels, numbers_of},
    read, reference,
    settings::Selection,
    transforms, video,
};
use crate::{
    Error, Result,
    camera::Camera,
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

/// Horizontal field of view that is assumed if none is known, in degrees.
pub(super) const ASSUMED_FOV_DEGREES: f32 = 60.0;

/// Everything that `open` finds out; pictures are decoded on request.
#[derive(Debug)]
pub(super) struct Recording {
    pub path: PathBuf,
    pub layout: Layout,
    pub width: usize,
    pub height: usize,
    pub frames: Vec<FrameFiles>,
    /// Cameras, one per frame.
    pub cameras: Vec<Camera>,
    pub camera_source: CameraSource,
    pub depth_rule: DepthRule,
    pub mask_rule: MaskRule,
    pub detect_field_of_view: bool,
    pub coding: LabelCoding,
    pub classes: Vec<Class>,
    pub frames_per_second: Option<f32>,
    /// Notes for the user about how the files were understood.
    pub notes: Vec<String>,
    /// Folder of the unpacked frames of a video; removed with the recording.
    pub scratch: Option<TempDir>,
    /// The video that the frames were unpacked from.
    pub unpacked_from: Option<PathBuf>,
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
    Video { video: Arc<video::H264>, index: usize },
}

/// The pixels that a mask file keeps.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum MaskRule {
    /// Non-zero is kept.
    KeepWhite,
    /// Zero is kept: white hides.
    KeepBlack,
    /// The mask is a label picture; only this code is hidden.
    DropCode(u8),
}

impl Recording {
    /// Creates a recording of `pictures` with an assumed still camera and nothing else.
    pub(super) fn of_pictures(path: &Path, layout: Layout, pictures: &[PathBuf]) -> Result<Self> {
        let size = read::common_size(pictures)?;
        let frames = pictures.iter().map(|p| FrameFiles::new(read::stem(p), Picture::File(p.clone())));
        Ok(Self::new(path, layout, size, frames.collect()))
    }

    pub(super) fn new(
        path: &Path,
        layout: Layout,
        (width, height): (usize, usize),
        frames: Vec<FrameFiles>,
    ) -> Self {
        let camera = Camera::with_field_of_view(width as u32, height as u32, ASSUMED_FOV_DEGREES);
        Self {
            path: path.to_owned(),
            layout,
            width,
            height,
            cameras: vec![camera; frames.len()],
            frames,
            camera_source: CameraSource::Assumed(ASSUMED_FOV_DEGREES),
            depth_rule: DepthRule::default(),
            mask_rule: MaskRule::KeepWhite,
            detect_field_of_view: true,
            coding: LabelCoding::IdsOrColours,
            classes: Vec::new(),
            frames_per_second: None,
            notes: Vec::new(),
            scratch: None,
            unpacked_from: None,
        }
    }

    /// Gives every frame its mask from `folder`, if that exists.
    pub(super) fn add_masks(&mut self, folder: &Path) -> Result<()> {
        for (frame, file) in self.companions(folder, read::PICTURES, "masks", false)? {
            frame.mask = Some(file);
        }
        Ok(())
    }

    /// Gives every frame its depth map (PNG or npy) from `folder`, if that exists.
    pub(super) fn add_depth(&mut self, folder: &Path) -> Result<()> {
        for (frame, file) in self.companions(folder, &["png", "npy"], "depth maps", false)? {
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
    fn select(mut self, selection: &Selection) -> Result<Self> {
        let keep = selection.indices(self.frames.len()).map_err(|what| {
            Error::input_at(&self.path, what, "Look at [frames] and [time] in sequence.toml.")
        })?;
        let mut frames: Vec<_> = self.frames.into_iter().map(Some).collect();
        self.frames = keep.iter().filter_map(|&i| frames[i].take()).collect();
        self.cameras = keep.iter().map(|&i| self.cameras[i]).collect();
        Ok(self)
    }

    /// Returns an error if a recording cannot be used at all, whatever its pixels hold.
    pub(super) fn validate(self) -> Result<Self> {
        let labelled = self.frames.iter().find_map(|f| f.labels.as_ref());
        if let (Some(labels), true) = (labelled, self.classes.is_empty()) {
            return Err(Error::input_at(
                labels.paths().first().unwrap_or(&self.path.as_path()),
                "there are label pictures but no class list says what they mean",
                "Add labels.json beside the folder, or [[classes]] to sequence.toml.",
            ));
        }
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
        self.frames.iter().flat_map(|frame| {
            let picture = match &frame.picture {
                Picture::File(path) => Some(path.as_path()),
                Picture::Video { .. } => None,
            };
            let maps = [frame.mask.as_deref(), frame.depth.as_deref(), picture];
            let labels = frame.labels.iter().flat_map(LabelFiles::paths);
            maps.into_iter().flatten().chain(labels)
        })
    }

    /// Decodes frame `i`.
    pub(super) fn frame(&self, i: usize) -> Result<RgbImage> {
        match &self.frames[i].picture {
            Picture::File(path) => read::frame(path, self.width, self.height),
            Picture::Video { video, index } => video.frame(*index),
        }
    }

    /// Returns the pixels that the mask file of frame `i` keeps; `None` if it has no mask file.
    pub(super) fn file_mask(&self, i: usize) -> Result<Option<Mask>> {
        let Some(path) = &self.frames[i].mask else { return Ok(None) };
        let values = read::lightness(path)?;
        read::expect_size(path, (values.width, values.height), (self.width, self.height))?;
        Ok(Some(match self.mask_rule {
            MaskRule::KeepWhite => values.map(|&v| v != 0),
            MaskRule::KeepBlack => values.map(|&v| v == 0),
            MaskRule::DropCode(code) => values.map(|&v| v != u16::from(code)),
        }))
    }

    /// Reads the labels of frame `i`; `None` if it has none.
    pub(super) fn labels(&self, i: usize, numbers: NumbersAre) -> Result<Option<ReadLabels>> {
        let labels = self.frames[i].labels.as_ref();
        labels.map(|l| l.read(&self.coding, numbers, &self.classes, (self.width, self.height))).transpose()
    }

    /// Decides the meaning of the numbers of its label pictures, from `some` of them, evenly spread.
    pub(super) fn label_numbers(&self, some: usize) -> NumbersAre {
        if !matches!(self.coding, LabelCoding::IdsOrColours) {
            return NumbersAre::Coded;
        }
        let pictures = self.frames.iter().filter_map(|frame| match &frame.labels {
            Some(LabelFiles::Picture(path)) => Some(path.as_path()),
            _ => None,
        });
        let pictures: Vec<&Path> = pictures.collect();
        let spread =
            pictures.iter().step_by(pictures.len().div_ceil(some).max(1)).copied().collect::<Vec<_>>();
        numbers_of(&spread, &self.coding, &self.classes, NumbersAre::Coded)
    }

    /// Reads the depth of frame `i` at the frames' size, 0 where unknown.
    pub(super) fn depth(&self, i: usize) -> Result<Option<Grid<f32>>> {
        let Some(path) = &self.frames[i].depth else { return Ok(None) };
        Ok(Some(self.depth_rule.read(path)?.resized(self.width, self.height)))
    }
}

impl FrameFiles {
    pub(super) fn new(name: String, picture: Picture) -> Self {
        Self { name, picture, mask: None, depth: None, labels: None }
    }
}

/// Recognises the layout of `path` by its contents and opens the selected frames.
pub(super) fn open(path: &Path, selection: &Selection) -> Result<Recording> {
    if path.is_file() {
        return video::open(path, selection);
    }
    let images = read::holds(&path.join("images"), read::PICTURES);
    let recording = if is_present(&path.join(transforms::TRANSFORMS_FILE)) {
        transforms::open(path)
    } else if images && is_present(&path.join("poses_bounds.npy")) {
        endonerf::open(path)
    } else if images && reference::matches(path) {
        reference::open(path)
    } else if endovis18::matches(path) {
        endovis18::open(path)
    } else if !cholecseg8k::frames(path)?.is_empty() {
        cholecseg8k::open(path)
    } else if images || read::holds(path, read::PICTURES) {
        images::open(path)
    } else if let [only] = read::list(path, video::VIDEOS)?.as_slice() {
        return Ok(Recording { path: path.to_owned(), ..video::open(only, selection)? });
    } else {
        Err(not_a_recording(path))
    }?;
    recording.select(selection)
}

fn not_a_recording(folder: &Path) -> Error {
    let inner = std::fs::read_dir(folder).into_iter().flatten().flatten().map(|entry| entry.path());
    let mut inner: Vec<_> = inner.filter(|p| read::holds(p, read::PICTURES)).collect();
    inner.sort_by(|a, b| read::natural_order(&read::file_name(a), &read::file_name(b)));
    let hint = match inner.first() {
        Some(first) => format!("The folder \"{}\" inside it does: open that one.", read::file_name(first)),
        None => "Open a folder of PNG or JPEG frames, one of the known data set layouts, or a video file."
            .to_owned(),
    };
    Error::input_at(folder, "this folder holds no frames", hint)
}
