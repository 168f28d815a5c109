//! The layouts of recordings. A new one is a file here that recognises and reads it, and a row of `READERS`.

mod cholecseg8k;
mod endonerf;
mod endovis18;
mod images;
mod reference;
mod transforms;

pub(crate) use reference::BASELINE as MONOCULAR_BASELINE;

use super::{
    dicom, read,
    recording::{Recording, Selection},
    video,
};
use crate::{
    Error, Result,
    files::{is_prepared, kind_of_result},
};
use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
};

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
    /// A video file, or several that follow each other.
    Video,
    /// DICOM files.
    Dicom,
}

/// A layout of folders: tells if a folder has its marks, and reads it.
type Reader = (Layout, fn(&Path) -> Result<bool>, fn(&Path) -> Result<Recording>);

/// The layouts of folders. A folder is of the first whose marks it has.
const READERS: [Reader; 6] = [
    (Layout::Transforms, transforms::matches, transforms::open),
    (Layout::EndoNerf, endonerf::matches, endonerf::open),
    (Layout::Reference, reference::matches, reference::open),
    (Layout::EndoVis18, endovis18::matches, endovis18::open),
    (Layout::CholecSeg8k, cholecseg8k::matches, cholecseg8k::open),
    (Layout::Images, images::matches, images::open),
];

/// Recognises the layout of `path` by its contents and opens the selected frames.
pub(super) fn open(path: &Path, selection: &Selection) -> Result<(Layout, Recording)> {
    if path.is_file() && dicom::is_file(path) {
        return Ok((Layout::Dicom, dicom::open(path, selection)?));
    }
    if path.is_file() {
        return Ok((Layout::Video, video::open(path, selection)?));
    }
    for (layout, matches, open) in READERS {
        if matches(path)? {
            return Ok((layout, open(path)?.select(selection)?));
        }
    }
    match read::list(path, video::VIDEOS)?.as_slice() {
        _ if dicom::matches(path) => Ok((Layout::Dicom, dicom::open(path, selection)?)),
        [] => Err(not_a_recording(path)),
        files => Ok((Layout::Video, video::open_folder(path, files, selection)?)),
    }
}

/// Returns the video of a folder that is a recording of nothing but this one.
pub(super) fn only_video(folder: &Path) -> Option<PathBuf> {
    let mut videos = read::list(folder, video::VIDEOS).ok()?;
    let is_other = || READERS.iter().any(|(_, matches, _)| matches(folder).unwrap_or(true));
    if videos.len() != 1 || is_other() || dicom::matches(folder) {
        return None;
    }
    videos.pop()
}

/// Lists the frames of a folder of pictures.
///
/// # Errors
/// Two pictures whose names differ in their endings alone: each frame would count twice, and a copy of a
/// held-out one would be trained on.
fn frames_in(folder: &Path) -> Result<Vec<PathBuf>> {
    let pictures = read::list(folder, read::PICTURES)?;
    let mut known = BTreeMap::new();
    for (i, picture) in pictures.iter().enumerate() {
        if let Some(first) = known.insert(picture.with_extension(""), i) {
            let [first, second] = [&pictures[first], picture].map(|path| read::file_name(path));
            let what = format!("\"{first}\" and \"{second}\" would be two frames of one name");
            let hint = "Leave out one kind of pictures: move it to another folder.";
            return Err(Error::input_at(folder, what, hint));
        }
    }
    Ok(pictures)
}

fn not_a_recording(folder: &Path) -> Error {
    let preparation = || is_prepared(folder).then(|| "preparation".to_owned());
    if let Some(kind) = kind_of_result(folder).or_else(preparation) {
        let what = format!("this folder holds no frames: it is a {kind} that this program made");
        return Error::input_at(folder, what, "Give the recording itself.");
    }
    let inner = std::fs::read_dir(folder).into_iter().flatten().flatten().map(|entry| entry.path());
    let mut inner: Vec<_> = inner.filter(|p| read::holds(p, read::PICTURES)).collect();
    inner.sort_by(|a, b| read::natural_order(&read::file_name(a), &read::file_name(b)));
    let hint = match inner.first() {
        Some(first) => format!("The folder \"{}\" inside it does: open that one.", read::file_name(first)),
        None => {
            "Open a folder of PNG or JPEG frames, one of the known data set layouts, a video file, or DICOM."
                .to_owned()
        }
    };
    Error::input_at(folder, "this folder holds no frames", hint)
}
