//! DICOM segmentations: each of their frames shows segments on one frame of the recording.

use super::{Annotation, Canvas, Shape};
use crate::{Error, Result, dicom::Segmentation};
use std::{collections::BTreeMap, path::Path};

/// Frames of a recording by the DICOM files that they come from: the identifier of the file, and the number
/// of the frame in it, from 1.
pub(crate) type References = BTreeMap<(String, Option<u32>), usize>;

/// Returns the annotations of a segmentation: each frame adds its pixels to the name of its segment.
pub(super) fn read(path: &Path, canvas: &Canvas) -> Result<Vec<Annotation>> {
    let file = Segmentation::open(path)?;
    let mut found = Vec::new();
    for (i, frame) in placed(&file, canvas, &References::new())? {
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

/// Pairs frames of a segmentation with those of the recording that they are about: by the reference to their
/// file, by the number in it, or by the position in time. Those about other frames are left out.
///
/// # Errors
/// A segmentation of pictures of another size, and one that is about no frame at all.
pub(crate) fn placed(
    file: &Segmentation,
    canvas: &Canvas,
    references: &References,
) -> Result<Vec<(usize, usize)>> {
    let (width, height) = file.size();
    canvas.expect_size(width, height)?;
    let names: BTreeMap<&str, usize> =
        canvas.frame_names.iter().enumerate().map(|(i, name)| (name.as_str(), i)).collect();
    let named = |number: u32| names.get(format!("{:06}", number.checked_sub(1)?).as_str()).copied();
    let frame_of = |i: usize| {
        let about = &file.frames[i];
        if let Some(instance) = about.instance.as_ref().filter(|_| !references.is_empty()) {
            return references.get(&(instance.clone(), about.number)).copied();
        }
        let at_position = || canvas.frame(about.position?.checked_sub(1)? as usize);
        about.number.and_then(named).or_else(at_position)
    };
    let pairs: Vec<_> = (0..file.frames.len()).filter_map(|i| Some((i, frame_of(i)?))).collect();
    if pairs.is_empty() {
        let what = "no frame of this segmentation is about a frame of the recording";
        return Err(Error::input(what, "Make sure that it was made from this recording."));
    }
    Ok(pairs)
}
