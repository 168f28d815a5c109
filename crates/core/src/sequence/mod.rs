//! A recorded operation on disk: frames, cameras, depth, masks, labels. Decoded lazily, never modified.

use crate::{
    Error, Result,
    annotations::Canvas,
    camera::Camera,
    files::{Inputs, full_path, unfinished_kind},
    grid::{Grid, Mask},
    num::spread,
    reading::{is_present, open_regular},
};
use estimated::Estimated;
use field_of_view::FieldOfView;
use glam::Affine3A;
use image::RgbImage;
use labels::{LabelCoding, ReadLabels};
use rayon::prelude::*;
use recording::{LABEL_PICTURES, MaskRule, Recording};
use std::{
    collections::{BTreeMap, BTreeSet},
    path::{Path, PathBuf},
    sync::{Arc, OnceLock},
};

mod annex_b;
mod check;
mod classes;
mod colours;
mod decided;
mod decoding;
mod depth;
mod dicom;
mod edit_list;
mod estimated;
mod ffmpeg;
mod field_of_view;
mod h264;
mod hidden;
mod identity;
mod labels;
mod layouts;
mod lens;
mod mp4;
mod nal;
pub(crate) mod pace;
mod read;
mod recording;
mod segmentation;
mod settings;
mod settings_file;
pub(crate) mod shots;
mod supervision;
#[cfg(test)]
mod tests;
mod times;
mod video;

pub use check::{CheckReport, check, name_frames};
pub(crate) use classes::letters;
pub use classes::{Class, ClassEntry, NO_LABEL, class_colour, is_same_name, names_instrument, plain_words};
pub use depth::{DepthKind, DepthOrigin};
pub use dicom::{SourceFrame, SourceInstance, SourceReferences};
pub use estimated::EstimatedDepth;
pub(crate) use estimated::{DEPTH, depth_file, depth_name};
pub use ffmpeg::remove_unpacked_videos;
pub use hidden::{HiddenRectangle, blacken};
pub(crate) use identity::shared as shared_identity;
pub use identity::{Difference, Identity};
pub use labels::LabelMap;
pub(crate) use labels::{NumbersAre, PictureOfIds};
pub use layouts::Layout;
pub(crate) use layouts::MONOCULAR_BASELINE;
pub(crate) use read::{lightness, npy_map};
pub use recording::{CameraSource, Keep};
pub use settings::{
    CameraSettings, DepthSettings, FieldOfViewSetting, FrameSettings, LabelSettings, MAX_FRAMES_PER_SECOND,
    MaskSettings, Settings, TimeSettings,
};
pub(crate) use settings_file::settings_name;
pub use settings_file::{SETTINGS_FILE, settings_files};
pub(crate) use times::USUAL_SPEED;
pub use times::{seconds_of, shown_for};

/// A recording; see the accessors. Cheap to clone: clones share everything.
#[derive(Clone, Debug)]
pub struct Sequence {
    inner: Arc<Inner>,
    /// Depth from another source than the recording.
    estimated: Option<Arc<Estimated>>,
    /// `camera_from_world` of every frame, where they were estimated.
    poses: Option<Arc<[Affine3A]>>,
    /// Factor from the recording's focal length to the estimated one, if that was estimated.
    zoom: Option<f32>,
}

#[derive(Debug)]
struct Inner {
    layout: Layout,
    recording: Recording,
    camera_moves: bool,
    /// Places of the frames in the recording, 0 to 1, if they are not evenly spaced.
    places: Vec<f32>,
    field_of_view: OnceLock<FieldOfView>,
    label_numbers: OnceLock<NumbersAre>,
    /// The identity as far as it is known when the recording is opened.
    outline: Arc<Identity>,
    identity: OnceLock<Arc<Identity>>,
}

/// Number of frames, evenly spread, in which the field of view is looked for.
const FIELD_OF_VIEW_FRAMES: usize = 8;

impl Sequence {
    /// Opens a folder or a video file; the layout is recognised by content. Only file names, picture
    /// headers and small tables are read here.
    pub fn open(path: &Path) -> Result<Self> {
        Self::open_with(path, None, &[])
    }

    /// Opens a recording as [`Sequence::open`] does. The labels are those of a file of annotations
    /// ([`crate::annotations`]) or of a DICOM segmentation instead of its own, if one is given. Besides the
    /// rectangles that its settings hide, `hidden` are black in every frame.
    pub fn open_with(path: &Path, labels: Option<&Path>, hidden: &[HiddenRectangle]) -> Result<Self> {
        if let Some(kind) = unfinished_kind(path) {
            let what = format!("this folder holds an unfinished {kind}");
            return Err(Error::input_at(path, what, "Run the command again that makes it."));
        }
        if !is_present(path) {
            return Err(Error::input_at(path, "there is no such file or folder", "Check the path."));
        }
        if !path.is_dir() {
            open_regular(path).map_err(|e| Error::io("open the recording", path, e))?;
        }
        let file = settings_file::own_file(path);
        let settings = Settings::read(&file)?;
        let (layout, mut recording) = layouts::open(path, &settings.selection())?;
        settings.apply(&mut recording, &file)?;
        recording.hidden.extend(hidden);
        recording.hidden.sort_unstable();
        recording.hidden.dedup();
        let named = settings.labels.file.as_ref().map(|name| file.with_file_name(name));
        labels.or(named.as_deref()).map_or(Ok(()), |file| recording.take_labels(file))?;
        Self::from_recording(layout, recording.validate()?)
    }

    fn from_recording(layout: Layout, mut recording: Recording) -> Result<Self> {
        let first = recording.cameras[0].camera_from_world;
        let camera_moves = recording.cameras.iter().any(|c| !c.camera_from_world.abs_diff_eq(first, 1e-6));
        let outline = Arc::new(Identity::opened(&recording)?);
        decided::apply(&mut recording, &outline)?;
        recording.time_gaps();
        recording.seconds = times::uneven(&recording.seconds, recording.frames_per_second);
        recording.notes.extend(times::describe(&recording.seconds));
        let places = pace::places(&recording.seconds);
        let (field_of_view, label_numbers, identity) = (OnceLock::new(), OnceLock::new(), OnceLock::new());
        let inner = Inner {
            layout,
            recording,
            camera_moves,
            places,
            field_of_view,
            label_numbers,
            outline,
            identity,
        };
        Ok(Self { inner: Arc::new(inner), estimated: None, poses: None, zoom: None })
    }

    fn recording(&self) -> &Recording {
        &self.inner.recording
    }

    /// Returns what marks and annotations are made on.
    pub fn canvas(&self) -> Canvas {
        self.recording().canvas()
    }

    /// Returns the folder or file that was opened.
    pub fn path(&self) -> &Path {
        &self.recording().path
    }

    /// Returns the folder or file name, for titles and results. DICOM files are often called by the name of a
    /// patient: what comes from them is called by a hash of its content.
    pub fn name(&self) -> String {
        if self.inner.layout == Layout::Dicom {
            return format!("dicom-{}", &self.outline().content_digest()[..8]);
        }
        let path = self.path();
        let whole = path.canonicalize().unwrap_or_else(|_| path.to_owned());
        read::file_name(&whole)
    }

    /// Returns the recognised layout.
    pub fn layout(&self) -> Layout {
        self.inner.layout
    }

    /// Returns the number of frames, at least 1.
    pub fn num_frames(&self) -> usize {
        self.recording().frames.len()
    }

    /// Returns the number of image columns.
    pub fn width(&self) -> usize {
        self.recording().width
    }

    /// Returns the number of image rows.
    pub fn height(&self) -> usize {
        self.recording().height
    }

    /// Returns the file stem of frame `i` (or its number, for a video).
    pub fn frame_name(&self, i: usize) -> String {
        self.recording().frames[i].name.clone()
    }

    /// Returns the identity as far as opening the recording tells it: names and sizes of the frames.
    pub fn outline(&self) -> &Arc<Identity> {
        &self.inner.outline
    }

    /// Returns the identity, including the content of every frame. All frames are read on the first call.
    pub fn identity(&self) -> Result<Arc<Identity>> {
        if let Some(known) = self.inner.identity.get() {
            return Ok(known.clone());
        }
        let found = Arc::new(Identity::complete(self.recording())?);
        Ok(self.inner.identity.get_or_init(|| found).clone())
    }

    /// Returns the place of frame `i` in the recording, 0 to 1: i / N, unless frames are unevenly spaced. A scene
    /// may give it another time, see [`crate::scene::Scene::times`].
    pub fn time(&self, i: usize) -> f32 {
        self.inner.places.get(i).copied().unwrap_or(i as f32 / self.num_frames() as f32)
    }

    /// Returns the places of all frames, see [`Sequence::time`].
    pub fn times(&self) -> Vec<f32> {
        (0..self.num_frames()).map(|i| self.time(i)).collect()
    }

    /// Returns the time of every frame after the first, seconds; empty if [`Self::frames_per_second`] tells it,
    /// or nothing does.
    pub fn frame_seconds(&self) -> &[f64] {
        &self.recording().seconds
    }

    /// Returns `true` if frame `i` is one of those that an evaluation holds out: (i − 1) mod 8 = 0.
    pub fn is_test_frame(i: usize) -> bool {
        recording::is_test_frame(i)
    }

    /// Returns the frames that training may see: all, or with `eval` those that are not held out.
    pub(crate) fn used_frames(&self, eval: bool) -> Vec<usize> {
        (0..self.num_frames()).filter(|&i| !(eval && Self::is_test_frame(i))).collect()
    }

    /// Returns the rate of the used frames, if known.
    pub fn frames_per_second(&self) -> Option<f32> {
        self.recording().frames_per_second
    }

    /// Returns the camera of frame `i`.
    pub fn camera(&self, i: usize) -> Camera {
        let camera = self.recording().cameras[i];
        let camera_from_world = self.poses.as_ref().map_or(camera.camera_from_world, |poses| poses[i]);
        Camera { camera_from_world, ..camera.zoomed(self.zoom.unwrap_or(1.0)) }
    }

    /// Returns the source of the cameras.
    pub fn camera_source(&self) -> CameraSource {
        self.recording().camera_source
    }

    /// Returns `true` if the camera's pose changes during the recording.
    pub fn camera_moves(&self) -> bool {
        self.inner.camera_moves || self.poses.is_some()
    }

    /// Returns the same recording with estimated poses, `camera_from_world` of every frame. Their number is
    /// that of the frames.
    pub(crate) fn with_poses(self, poses: &[Affine3A]) -> Self {
        Self { poses: Some(poses.into()), ..self }
    }

    /// Returns the same recording with focal lengths that are `zoom` times those it came with.
    pub(crate) fn with_zoom(self, zoom: f32) -> Self {
        Self { zoom: Some(zoom), ..self }
    }

    /// Returns the factor of [`Sequence::with_zoom`], 1 if nothing told the lens; `None` if that was not looked
    /// for.
    pub(crate) fn estimated_zoom(&self) -> Option<f32> {
        self.zoom
    }

    /// Returns notes that nobody should miss who works with the recording: other programs show other frames of
    /// it.
    pub fn cautions(&self) -> &[String] {
        &self.recording().cautions
    }

    /// Returns the rectangles that are black in every frame.
    pub fn hidden(&self) -> &[HiddenRectangle] {
        &self.recording().hidden
    }

    /// Reads the identifiers of the DICOM files that the recording comes from; `None` if it comes from no such
    /// files. They are for references from a segmentation alone.
    pub fn source_references(&self) -> Result<Option<SourceReferences>> {
        self.recording().dicom.as_ref().map_or(Ok(None), |origin| origin.references())
    }

    /// Decodes frame `i`.
    pub fn frame(&self, i: usize) -> Result<RgbImage> {
        self.recording().frame(i)
    }

    /// Decodes frames and hands each to `f`, on all cores. Returns the results in the order of `frames`. Those of
    /// a video are decoded one after the other: nothing is decoded twice if they are in order.
    pub(crate) fn map_frames<T: Send>(
        &self,
        frames: &[usize],
        f: impl Fn(usize, Result<RgbImage>) -> T + Sync,
    ) -> Vec<T> {
        if self.recording().is_decoded_in_order() {
            let decoded = frames.iter().enumerate().map(|(k, &i)| (k, i, self.frame(i)));
            let mut results: Vec<(usize, T)> =
                decoded.par_bridge().map(|(k, i, frame)| (k, f(i, frame))).collect();
            results.sort_unstable_by_key(|(k, _)| *k);
            return results.into_iter().map(|(_, result)| result).collect();
        }
        frames.par_iter().map(|&i| f(i, self.frame(i))).collect()
    }

    /// Takes depth from the prepared folder `folder` instead of the recording.
    pub(crate) fn with_estimated_depth(
        self,
        folder: &Path,
        about: EstimatedDepth,
        sha256: Arc<BTreeMap<String, String>>,
    ) -> Self {
        let estimated = Estimated { folder: folder.to_owned(), about, sha256 };
        Self { estimated: Some(Arc::new(estimated)), ..self }
    }

    /// Returns the same recording after the folder with its estimated depth, if any, was moved to `folder`.
    pub(crate) fn with_depth_at(self, folder: &Path) -> Self {
        let moved = |e: &Arc<Estimated>| Arc::new(Estimated { folder: folder.to_owned(), ..(**e).clone() });
        Self { estimated: self.estimated.as_ref().map(moved), ..self }
    }

    /// Returns the source of depth if it is not the recording itself.
    pub fn estimated_depth(&self) -> Option<&EstimatedDepth> {
        self.estimated.as_ref().map(|e| &e.about)
    }

    /// Returns `true` if any frame has depth.
    pub fn has_depth(&self) -> bool {
        self.estimated.is_some() || self.recording().frames.iter().any(|f| f.depth.is_some())
    }

    /// Returns the origin of the depth.
    pub fn depth_origin(&self) -> DepthOrigin {
        match (self.estimated.is_some(), self.has_depth()) {
            (true, _) => DepthOrigin::Estimated,
            (false, true) => DepthOrigin::Recorded,
            (false, false) => DepthOrigin::Absent,
        }
    }

    /// Returns the depth (z) of frame `i` in scene units at the frames' size, 0 where unknown (bilinear
    /// if the file has another size); `None` if the frame has no depth.
    pub fn depth(&self, i: usize) -> Result<Option<Grid<f32>>> {
        match &self.estimated {
            Some(estimated) => estimated.depth(i, self.width(), self.height()),
            None => self.recording().depth(i),
        }
    }

    /// Returns the supervision mask of frame `i`: `true` = keep. It combines the recording's masks
    /// (polarity resolved) and the field of view.
    pub fn mask(&self, i: usize) -> Result<Mask> {
        let Some(mut mask) = self.recording().file_mask(i)? else { return Ok(self.field_of_view().clone()) };
        for (keep, inside) in mask.data.iter_mut().zip(&self.field_of_view().data) {
            *keep &= inside;
        }
        Ok(mask)
    }

    /// Returns the round endoscopic picture or the area inside a black border; `true` = inside. It is
    /// found from a few frames on the first call; frames that cannot be read are skipped.
    pub fn field_of_view(&self) -> &Mask {
        &self.found_field_of_view().mask
    }

    /// Radius of the disc that the endoscope shows, px; `None` if no round border was found.
    pub fn disc_radius_px(&self) -> Option<f64> {
        self.found_field_of_view().disc_radius_px()
    }

    /// Returns the class labels of frame `i`; `None` if the recording has none for it.
    pub fn labels(&self, i: usize) -> Result<Option<LabelMap>> {
        Ok(self.read_labels(i)?.map(|labels| labels.ids))
    }

    fn read_labels(&self, i: usize) -> Result<Option<ReadLabels>> {
        let numbers = self.inner.label_numbers.get_or_init(|| self.recording().label_numbers());
        self.recording().labels(i, *numbers)
    }

    /// Decides the meaning of the numbers of label pictures that are not the recording's own. They may be
    /// ids, or values of the kind that the recording's pictures hold. The choice is the one by which more
    /// pixels of some of these pictures name a class.
    pub(crate) fn numbers_of(&self, pictures: &[&Path]) -> NumbersAre {
        let pictures: Vec<&Path> =
            pictures.iter().step_by(pictures.len().div_ceil(LABEL_PICTURES).max(1)).copied().collect();
        let first = match self.recording().coding {
            LabelCoding::Codes(_) => NumbersAre::Ids,
            LabelCoding::Ids | LabelCoding::IdsOrColours => NumbersAre::Coded,
        };
        labels::numbers_of(&pictures, &self.recording().coding, self.classes(), first)
    }

    /// Reads the class ids of a label picture that is not the recording's own. Its numbers mean
    /// what [`Self::numbers_of`] found. With `names`, (value, class or none), it holds these values
    /// and 0 for nothing.
    pub(crate) fn picture_of_ids(
        &self,
        path: &Path,
        numbers: NumbersAre,
        names: Option<&[(u8, Option<u8>)]>,
    ) -> Result<PictureOfIds> {
        labels::picture_of_ids(path, &self.recording().coding, numbers, self.classes(), names)
    }

    /// Returns the pixels of instruments on frame `i`. They come from its labels if a class names an
    /// instrument, else from what its mask file hides inside the field of view. `None` if the
    /// recording has neither.
    pub fn instruments(&self, i: usize) -> Result<Option<Mask>> {
        let ids: Vec<u8> =
            self.classes().iter().filter(|c| names_instrument(&c.name)).map(|c| c.id).collect();
        if let Some(labels) = self.labels(i)?.filter(|_| !ids.is_empty()) {
            return Ok(Some(labels.map(|id| ids.contains(id))));
        }
        if matches!(self.recording().mask_rule, MaskRule::DropCode(_)) {
            return Ok(None);
        }
        let Some(mut kept) = self.recording().file_mask(i)? else { return Ok(None) };
        for (kept, inside) in kept.data.iter_mut().zip(&self.field_of_view().data) {
            *kept = !*kept && *inside;
        }
        Ok(Some(kept))
    }

    /// Returns `true` if there are mask files whose meaning can be inverted; see [`Self::flip_masks`].
    pub fn has_mask_files(&self) -> bool {
        let recording = self.recording();
        let can_flip = !matches!(recording.mask_rule, MaskRule::DropCode(_));
        can_flip && recording.frames.iter().any(|f| f.mask.is_some())
    }

    /// Inverts which side of the mask files is kept, for everyone who opens the recording later. The decision
    /// is written into a file beside the recording, which stays as it is. Returns the path of that file.
    pub fn flip_masks(&self) -> Result<PathBuf> {
        let keep = match self.recording().mask_rule {
            MaskRule::KeepWhite if self.has_mask_files() => Keep::Black,
            MaskRule::KeepBlack if self.has_mask_files() => Keep::White,
            _ => {
                return Err(Error::input_at(
                    self.path(),
                    "this recording has no mask files to turn round",
                    "",
                ));
            }
        };
        decided::keep_masks(self.path(), self.outline(), keep)
    }

    /// Returns `true` if any frame has labels.
    pub fn has_labels(&self) -> bool {
        self.recording().frames.iter().any(|f| f.labels.is_some())
    }

    /// Returns the classes that labels refer to; empty without labels.
    pub fn classes(&self) -> &[Class] {
        &self.recording().classes
    }

    /// Returns the folders that hold files of the recording, links followed, but for those that the whole
    /// recording lies in.
    pub fn folders(&self) -> BTreeSet<PathBuf> {
        let whole = full_path(self.path());
        let parents: BTreeSet<&Path> = self.recording().files().filter_map(Path::parent).collect();
        parents.into_iter().map(full_path).filter(|folder| !whole.starts_with(folder)).collect()
    }

    fn detect_field_of_view(&self) -> FieldOfView {
        let (width, height) = (self.width(), self.height());
        if !self.recording().detect_field_of_view {
            return FieldOfView::whole(width, height);
        }
        // An evaluation may hold the others out.
        let all = self.used_frames(true);
        let some = all.len().min(FIELD_OF_VIEW_FRAMES);
        // Of long videos, those frames near to them that are decoded quickly.
        let near = |i: usize| self.recording().entry_near(i, self.num_frames() / (8 * some));
        let looked_at = spread(all.len(), some).map(|k| near(all[k]));
        let looked_at = looked_at.map(|i| if Self::is_test_frame(i) { i + 1 } else { i });
        // A black rectangle could be taken for a border.
        FieldOfView::detect(width, height, looked_at.filter_map(|i| self.recording().frame_in_full(i).ok()))
    }

    fn found_field_of_view(&self) -> &FieldOfView {
        self.inner.field_of_view.get_or_init(|| {
            let mut found = self.detect_field_of_view();
            hidden::leave_out(&mut found.mask, self.hidden());
            found
        })
    }
}

impl Inputs {
    /// Adds a recording and its settings.
    pub fn with_recording(self, sequence: &Sequence) -> Self {
        let settings = settings_files(sequence.path());
        let inputs = self.with("the recording", sequence.path());
        let folders = sequence.folders();
        let inputs =
            folders.iter().fold(inputs, |inputs, folder| inputs.with("a folder of the recording", folder));
        settings.iter().fold(inputs, |inputs, file| inputs.with("a settings file of the recording", file))
    }
}
