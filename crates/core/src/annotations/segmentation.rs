//! DICOM segmentations: each of their frames shows segments on one frame of the recording.

use super::{Annotation, Canvas, Shape};
use crate::{Error, Result, dicom::Segmentation};
use std::{collections::BTreeMap, path::Path};

/// Frames of a recording by the DICOM files that they come from: the identifier of the file, and the number
/// of the frame in it, from 1.
pub(crate) type References = BTreeMap<(String, Option<u32>), usize>;

/// Returns the annotations of a segmentation: each frame adds its pixels to the name of its segment.
pub(super) fn read(path: &Path, canvas: &Canvas, references: &References) -> Result<Vec<Annotation>> {
    let file = Segmentation::open(path)?;
    if file.has_unread_labels {
        let what = "names of its segments are in a character set that is not read";
        return Err(Error::input(what, "Convert it to UTF-8, for instance by dcmconv +U8."));
    }
    let mut found = Vec::new();
    for (i, frame) in placed(&file, canvas, references)? {
        let only = file.frames[i].segment;
        let is_shown = |number: u16| number > 0 && only.is_none_or(|only| only == number);
        for segment in file.segments.iter().filter(|segment| is_shown(segment.number)) {
            let mask = file.mask(i, segment.number)?;
            if mask.data.contains(&true) {
                found.push(Annotation { frame, name: segment.label.clone(), shape: Shape::from(&mask) });
            }
        }
    }
    Ok(found)
}

/// Pairs frames of a segmentation with those of the recording that they are about. Those that refer to a file
/// are found by `references`, or, where these are not known and it is one file alone, by the number in it.
/// Others are found by the position in time. What is about no frame of the recording is left out.
///
/// # Errors
/// A segmentation of pictures of another size, one that refers to several files that are not known, and one
/// that is about no frame at all.
pub(crate) fn placed(
    file: &Segmentation,
    canvas: &Canvas,
    references: &References,
) -> Result<Vec<(usize, usize)>> {
    let (width, height) = file.size();
    canvas.expect_size(width, height)?;
    if references.is_empty() && !file.is_about_one_file() {
        let what = "the segmentation refers to several DICOM files that are not at hand";
        return Err(Error::input(what, "Open the recording from these files."));
    }
    let names: BTreeMap<&str, usize> =
        canvas.frame_names.iter().enumerate().map(|(i, name)| (name.as_str(), i)).collect();
    let named = |number: u32| names.get(format!("{:06}", number.checked_sub(1)?).as_str()).copied();
    let frame_of = |i: usize| {
        let about = &file.frames[i];
        match &about.instance {
            // The only frame of a file has no number.
            Some(_) if references.is_empty() => named(about.number.unwrap_or(1)),
            Some(instance) => references.get(&(instance.clone(), about.number)).copied(),
            None => canvas.frame(about.position?.checked_sub(1)? as usize),
        }
    };
    let pairs: Vec<_> = (0..file.frames.len()).filter_map(|i| Some((i, frame_of(i)?))).collect();
    if pairs.is_empty() {
        let what = "no frame of this segmentation is about a frame of the recording";
        return Err(Error::input(what, "Make sure that it was made from this recording."));
    }
    Ok(pairs)
}
