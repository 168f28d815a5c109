//! Files in which other programs keep what was marked on the frames of a recording.
//!
//! | File | Frames are found by | Shapes |
//! |---|---|---|
//! | COCO annotations (JSON) | `source`, `frame` or `file_name` of the image | run lengths, polygons |
//! | CVAT for video, or for images (XML) | number of the frame; name of the image | masks, polygons, boxes |
//! | Label Studio tasks (JSON) | name of the task's image, or `frame` of its data | brush masks, polygons, boxes |
//! | DICOM segmentation | reference to a frame of a recorded file, or position in time | masks |
//! | 3D Slicer segmentation (`.seg.nrrd`) | place along the third axis, after `first_frame` | masks |
//!
//! Names come before numbers, but for those that count exported frames, or the pictures of a video. In COCO
//! and Label Studio, images that are named like no frame are left out; a file of such images alone is
//! refused.
//!
//! Formats are recognised by content. Masks are kept as run lengths, so that memory follows the size of the
//! file.

mod coco;
mod cvat;
mod images;
mod label_studio;
mod names;
mod nrrd;
mod runs;
mod segmentation;
mod shape;
#[cfg(test)]
mod tests;

pub(crate) use label_studio::packed;
pub(crate) use runs::RunsEntry;
pub(crate) use segmentation::{References, placed};
pub use shape::Shape;

use crate::{Error, Result, dicom::is_dicom, reading::read_regular};
use serde::de::IgnoredAny;
use std::path::Path;

/// Largest size in bytes of a file of annotations.
const MOST_BYTES: u64 = 1 << 30;

/// The recording that annotations are made on.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Canvas {
    /// Number of columns.
    pub width: usize,
    /// Number of rows.
    pub height: usize,
    /// Name of each frame, to find frames that a file names; empty if they are not known.
    pub frame_names: Vec<String>,
    /// Number of frames.
    pub num_frames: usize,
}

/// One shape that is named on a frame.
#[derive(Clone, Debug, PartialEq)]
pub struct Annotation {
    /// The frame, counted from 0.
    pub frame: usize,
    /// Name as it is written in the file.
    pub name: String,
    /// The pixels.
    pub shape: Shape,
}

/// Reads a file of annotations.
///
/// # Errors
/// A file that cannot be read or is none, and the first annotation that does not fit the recording; the
/// message names it.
pub fn read(path: &Path, canvas: &Canvas) -> Result<Vec<Annotation>> {
    read_with(path, canvas, &References::new())
}

/// Reads a file of annotations as [`read`] does. `references` are the DICOM files of the recording; empty if
/// they are not known.
pub(crate) fn read_with(path: &Path, canvas: &Canvas, references: &References) -> Result<Vec<Annotation>> {
    let at = |e| in_file(e, path);
    // Only the frames that are about the recording are read.
    let found = match is_dicom(path) {
        true => segmentation::read(path, canvas, references).map(Some),
        false => parse(&bytes_of(path, "read the annotations")?, canvas),
    };
    match found.map_err(at)? {
        Some(annotations) => checked(annotations, canvas).map_err(at),
        None => {
            let hint = "COCO, CVAT for video or for images, Label Studio, .seg.nrrd and DICOM segmentations can be read.";
            Err(Error::input_at(path, "this is no file of annotations that can be read", hint))
        }
    }
}

/// Returns the bytes of a file of annotations or marks. `doing` says what is done, as in [`Error::io`].
pub(crate) fn bytes_of(path: &Path, doing: &str) -> Result<Vec<u8>> {
    read_regular(path, MOST_BYTES).map_err(|e| Error::io(doing, path, e))
}

/// Reads annotations of any form; `None` if they are in none.
pub(crate) fn parse(bytes: &[u8], canvas: &Canvas) -> Result<Option<Vec<Annotation>>> {
    let text = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes).trim_ascii_start();
    let annotations = match text.first() {
        Some(b'<') => cvat::read(text, canvas)?,
        Some(b'[') => label_studio::read(text, canvas)?,
        Some(b'{') if is_coco(text) => coco::read(text, canvas)?,
        Some(_) if text.starts_with(b"NRRD") => nrrd::read(text, canvas)?,
        _ => return Ok(None),
    };
    Ok(Some(annotations))
}

/// Returns `true` for an object with a list of annotations and none of marks.
fn is_coco(text: &[u8]) -> bool {
    #[derive(serde::Deserialize)]
    struct Keys {
        marks: Option<IgnoredAny>,
        annotations: Option<IgnoredAny>,
    }
    serde_json::from_slice::<Keys>(text).is_ok_and(|keys| keys.marks.is_none() && keys.annotations.is_some())
}

/// Returns the annotations if all of them fit the recording.
fn checked(annotations: Vec<Annotation>, canvas: &Canvas) -> Result<Vec<Annotation>> {
    for Annotation { frame, name, shape } in &annotations {
        let beyond = || format!("the recording has frames 0 to {}", canvas.num_frames.saturating_sub(1));
        let problem = match canvas.frame(*frame) {
            Some(_) => shape.problem(canvas.width, canvas.height),
            None => Some(beyond()),
        };
        if let Some(problem) = problem {
            let what = format!("\"{name}\" on frame {frame} cannot be used: {problem}");
            return Err(Error::input(what, "The annotations must be those of this recording."));
        }
    }
    Ok(annotations)
}

/// Adds the path to an error about what a file holds.
pub(crate) fn in_file(error: Error, path: &Path) -> Error {
    match error {
        Error::Input { what, hint, path: None } => Error::Input { what, hint, path: Some(path.to_owned()) },
        other => other,
    }
}

impl Canvas {
    /// Returns the frame of this number, if there is one.
    fn frame(&self, number: usize) -> Option<usize> {
        (number < self.num_frames).then_some(number)
    }

    /// Returns an error if a file says that its pictures have another size.
    fn expect_size(&self, width: usize, height: usize) -> Result<()> {
        if (width, height) == (self.width, self.height) {
            return Ok(());
        }
        let what = format!(
            "the annotations are of pictures of {width}×{height} pixels, the frames have {}×{}",
            self.width, self.height
        );
        Err(Error::input(what, "The annotations must be those of this recording."))
    }
}
