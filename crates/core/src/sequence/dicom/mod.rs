//! Recordings in DICOM: videos, pictures of several frames, and series of single pictures; files, folders,
//! and what a DICOMDIR lists.
//!
//! Only the technical attributes of [`object`] are read. Names, dates, identifiers, and names of files, which
//! often say more than they should, go no further than this folder.

mod object;
mod palette;
mod pictures;
mod references;
mod rle;
mod source;
mod stored;

pub(super) use pictures::DicomPictures;
pub(super) use references::Origin;
pub use references::{SourceFrame, SourceInstance, SourceReferences};

use super::{
    read,
    recording::{FrameFiles, Recording, Selection},
    segmentation,
    settings_file::settings_name,
};
use crate::{
    Error, Result,
    dicom::{LeftUnread, is_dicom, tag},
    reading::is_present,
};
use object::{Kind, Object};
use std::path::{Path, PathBuf};

/// Name of the file that lists the others of a medium (PS3.10, 8.6).
const DIRECTORY: &str = "DICOMDIR";

/// Returns `true` if `path` is a file of DICOM.
pub(super) fn is_file(path: &Path) -> bool {
    is_dicom(path)
}

/// Returns `true` if `folder` has a DICOMDIR or holds files of DICOM.
pub(super) fn matches(folder: &Path) -> bool {
    folder.join(DIRECTORY).is_file() || files(folder).is_ok_and(|files| !files.is_empty())
}

/// Opens a file, or a folder with the files of one series.
pub(super) fn open(path: &Path, selection: &Selection) -> Result<Recording> {
    let listed = match path.is_dir() {
        true if path.join(DIRECTORY).is_file() => listed(&path.join(DIRECTORY))?,
        true => files(path)?,
        false => vec![path.to_owned()],
    };
    let mut objects = Vec::with_capacity(listed.len());
    for file in &listed {
        let object = Object::read(file)?;
        if matches!(object.kind, Kind::Directory) && listed.len() == 1 {
            return open_listed(path, file, selection);
        }
        objects.push(object);
    }
    open_objects(path, objects, selection)
}

/// Opens the files that a DICOMDIR lists which was named itself.
fn open_listed(path: &Path, directory: &Path, selection: &Selection) -> Result<Recording> {
    let objects = listed(directory)?.iter().map(|file| Object::read(file)).collect::<Result<_>>()?;
    open_objects(path, objects, selection)
}

fn open_objects(path: &Path, objects: Vec<Object>, selection: &Selection) -> Result<Recording> {
    let mut left_unread = LeftUnread::default();
    objects.iter().for_each(|object| left_unread.add(&object.left_unread));
    let (mut pictures, mut segmentations) = (Vec::new(), Vec::new());
    for object in objects {
        match object.kind {
            Kind::Pictures => pictures.push(object),
            Kind::Segmentation => segmentations.push(object.path),
            Kind::Directory | Kind::Other => {}
        }
    }
    let series = one_series(path, pictures)?;
    let facts = source::Facts::of(&series);
    let mut recording = source::open(path, &series, selection)?;
    facts.add_to(&mut recording, left_unread);
    match segmentations.as_slice() {
        [] => {}
        [only] => segmentation::add_labels(&mut recording, only)?,
        all => recording.notes.push(format!(
            "There are {} segmentations here, and none is taken as labels. Name one under [labels] in {}.",
            all.len(),
            settings_name(path)
        )),
    }
    Ok(recording)
}

/// Returns the objects in the order of their numbers, if all are of one series and of one size.
fn one_series(path: &Path, mut objects: Vec<Object>) -> Result<Vec<Object>> {
    let Some(first) = objects.first() else {
        let hint = "Open a file or a series of endoscopic pictures or video.";
        return Err(Error::input_at(path, "there are no pictures in these DICOM files", hint));
    };
    let (series, size) = (first.series, first.size);
    if objects.iter().any(|object| object.series != series) {
        let mut all: Vec<_> = objects.iter().map(|object| object.series).collect();
        all.sort_unstable();
        all.dedup();
        let what = format!("there are {} series of pictures here", all.len());
        let hint = "Put the files of one series into a folder of its own, or open a single file.";
        return Err(Error::input_at(path, what, hint));
    }
    if let Some(other) = objects.iter().find(|object| object.size != size) {
        let what = format!(
            "a picture of the series is {}×{}, the first is {}×{}",
            other.size.0, other.size.1, size.0, size.1
        );
        return Err(Error::input_at(&other.path, what, "All frames of a recording must have the same size."));
    }
    objects.sort_by_key(|object| object.number);
    Ok(objects)
}

/// Returns the files of DICOM in a folder, in natural order of their names.
fn files(folder: &Path) -> Result<Vec<PathBuf>> {
    read::list_where(folder, is_dicom)
}

/// Returns the files of pictures and segmentations that a DICOMDIR lists.
fn listed(directory: &Path) -> Result<Vec<PathBuf>> {
    let wanted = [tag::DIRECTORY_RECORDS, tag::RECORD_TYPE, tag::REFERENCED_FILE];
    let file = crate::dicom::read(directory, &wanted)?;
    let folder = directory.parent().unwrap_or(Path::new("."));
    let mut files = Vec::new();
    for record in file.set.items(tag::DIRECTORY_RECORDS) {
        let is_image = record.text(tag::RECORD_TYPE).is_some_and(|kind| kind == "IMAGE");
        let Some(id) = record.text(tag::REFERENCED_FILE).filter(|_| is_image) else { continue };
        let parts: Vec<&str> = id.split('\\').map(str::trim).collect();
        // A component is at most 8 letters, digits and underscores (PS3.10, 8.2): nothing leads out of the folder.
        let is_plain = |part: &&str| {
            !part.is_empty()
                && part.bytes().all(|b| b.is_ascii_alphanumeric() || b"_-.".contains(&b))
                && *part != ".."
        };
        if !parts.iter().all(is_plain) {
            return Err(Error::input_at(
                directory,
                "this DICOMDIR names a file in a way that is not allowed",
                "",
            ));
        }
        let path = parts.iter().fold(folder.to_owned(), |path, part| path.join(part));
        if !is_present(&path) {
            let what = "this DICOMDIR lists a file that is not there";
            return Err(Error::input_at(directory, what, "Copy the medium once more."));
        }
        files.push(path);
    }
    Ok(files)
}

/// Returns frames that are called by their numbers: names of files may be names of patients.
fn numbered(pictures: Vec<super::recording::Picture>) -> Vec<FrameFiles> {
    let frame = |(i, picture)| FrameFiles::new(format!("{i:06}"), picture);
    pictures.into_iter().enumerate().map(frame).collect()
}
