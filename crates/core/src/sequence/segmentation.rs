//! DICOM segmentations as the labels of a recording.

use super::{
    classes::{self, ClassEntry},
    labels::LabelFiles,
    recording::Recording,
};
use crate::{
    Error, Result,
    dicom::{Segmentation, SegmentationFrame, colour},
};
use std::{collections::BTreeMap, path::Path, sync::Arc};

/// Gives frames the labels of a DICOM segmentation. Frames are found by the reference to their file, by the
/// number in it, or by the position in time. Segments become classes.
pub(super) fn add_labels(recording: &mut Recording, path: &Path) -> Result<()> {
    let file = Arc::new(Segmentation::open(path)?);
    let (found, expected) = (file.size(), (recording.width, recording.height));
    if found != expected {
        let what = format!(
            "the segmentation is {}×{}, the frames are {}×{}",
            found.0, found.1, expected.0, expected.1
        );
        return Err(Error::input_at(path, what, ""));
    }
    let places = Places::of(recording)?;
    let mut by_frame: BTreeMap<usize, Vec<usize>> = BTreeMap::new();
    for (i, frame) in file.frames.iter().enumerate() {
        if let Some(place) = places.frame_of(frame) {
            by_frame.entry(place).or_default().push(i);
        }
    }
    if by_frame.is_empty() {
        let what = "no frame of this segmentation is about a frame of the recording";
        return Err(Error::input_at(path, what, "Make sure that it was made from this recording."));
    }
    recording.classes = class_list(&file, path)?;
    for (place, frames) in by_frame {
        recording.frames[place].labels = Some(LabelFiles::Segmentation(file.clone(), frames));
    }
    Ok(())
}

fn class_list(file: &Segmentation, path: &Path) -> Result<Vec<classes::Class>> {
    let segments = file.segments.iter().filter(|segment| segment.number > 0);
    let entry = |segment: &crate::dicom::Segment| {
        let id = u8::try_from(segment.number).map_err(|_| {
            Error::input_at(
                path,
                "this segmentation has more than 254 segments",
                "Classes have ids up to 254.",
            )
        })?;
        Ok(ClassEntry { id, name: segment.label.clone(), colour: segment.lab.map(colour::rgb) })
    };
    classes::from_entries(&segments.map(entry).collect::<Result<Vec<_>>>()?, path)
}

/// Ways to find the frames of a recording.
struct Places {
    by_reference: BTreeMap<(String, Option<u32>), usize>,
    by_name: BTreeMap<String, usize>,
    num_frames: usize,
}

impl Places {
    fn of(recording: &Recording) -> Result<Self> {
        let references = recording.dicom.as_ref().map(|origin| origin.references()).transpose()?.flatten();
        let of_frame = |(sources, i): (&super::SourceReferences, usize)| {
            let source = sources.frames[i];
            ((sources.instances[source.instance].instance_uid.clone(), source.number), i)
        };
        let by_reference = references.iter().flat_map(|r| (0..r.frames.len()).map(move |i| of_frame((r, i))));
        let names = recording.frames.iter().enumerate().map(|(i, frame)| (frame.name.clone(), i));
        Ok(Self {
            by_reference: by_reference.collect(),
            by_name: names.collect(),
            num_frames: recording.frames.len(),
        })
    }

    fn frame_of(&self, frame: &SegmentationFrame) -> Option<usize> {
        if let Some(instance) = frame.instance.as_ref().filter(|_| !self.by_reference.is_empty()) {
            return self.by_reference.get(&(instance.clone(), frame.number)).copied();
        }
        let named = |number: u32| self.by_name.get(&format!("{:06}", number.checked_sub(1)?)).copied();
        let placed = |position: u32| Some(position.checked_sub(1)? as usize).filter(|i| *i < self.num_frames);
        frame.number.and_then(named).or_else(|| frame.position.and_then(placed))
    }
}
