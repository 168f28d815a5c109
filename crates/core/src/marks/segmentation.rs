//! DICOM segmentations as marks: each frame adds its pixels to the name of its segment.

use super::{Canvas, Mark, Shape};
use crate::{
    Error, Result,
    dicom::{Segmentation, SegmentationFrame},
};
use std::path::Path;

/// Returns the marks of a DICOM segmentation.
pub(super) fn marks(path: &Path, canvas: &Canvas) -> Result<Vec<Mark>> {
    let file = Segmentation::open(path)?;
    let (found, expected) = (file.size(), (canvas.width, canvas.height));
    if found != expected {
        let what = format!(
            "this segmentation has {}×{} pixels, the frames have {}×{}",
            found.0, found.1, expected.0, expected.1
        );
        return Err(Error::input_at(path, what, ""));
    }
    let mut marks = Vec::new();
    for (i, frame) in file.frames.iter().enumerate() {
        let place = frame_of(frame, canvas).ok_or_else(|| {
            let hint = "Frames are found by their numbers in a reference, or by their positions in time.";
            Error::input_at(
                path,
                format!("frame {i} of this segmentation is about no frame of the recording"),
                hint,
            )
        })?;
        for segment in &file.segments {
            let is_shown = segment.number > 0 && frame.segment.is_none_or(|number| number == segment.number);
            if !is_shown {
                continue;
            }
            let mask = file.mask(i, segment.number)?;
            if mask.data.contains(&true) {
                marks.push(Mark::new(place, &segment.label, true, Shape::from(&mask)));
            }
        }
    }
    Ok(marks)
}

/// Returns the frame of the recording that a frame of a segmentation is about.
fn frame_of(frame: &SegmentationFrame, canvas: &Canvas) -> Option<usize> {
    let named = |number: u32| {
        let name = format!("{:06}", number.checked_sub(1)?);
        canvas.frame_names.iter().position(|known| *known == name)
    };
    let placed = |position: u32| Some(position.checked_sub(1)? as usize).filter(|i| *i < canvas.num_frames);
    frame.number.and_then(named).or_else(|| frame.position.and_then(placed))
}
