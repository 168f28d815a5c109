//! DICOM segmentations as the labels of a recording.

use super::{
    classes::{self, Class, ClassEntry},
    labels::LabelFiles,
    recording::Recording,
};
use crate::{
    Error, Result,
    annotations::{self, References, placed},
    dicom::{Segment, Segmentation, colour},
};
use std::{collections::BTreeMap, path::Path, sync::Arc};

/// Gives frames the labels of a DICOM segmentation, whose segments become the classes.
pub(super) fn add_labels(recording: &mut Recording, path: &Path) -> Result<()> {
    let file = Arc::new(Segmentation::open(path)?);
    let pairs = placed(&file, &recording.canvas(), &references(recording)?);
    let mut by_frame: BTreeMap<usize, Vec<usize>> = BTreeMap::new();
    for (i, frame) in pairs.map_err(|e| annotations::in_file(e, path))? {
        by_frame.entry(frame).or_default().push(i);
    }
    recording.classes = class_list(&file, path)?;
    if file.has_unread_labels {
        let note = "Names of segments are in a character set that is not read: convert the segmentation to \
                    UTF-8, for instance by dcmconv +U8";
        recording.notes.push(note.to_owned());
    }
    for (frame, shown) in by_frame {
        recording.frames[frame].labels = Some(LabelFiles::Segmentation(file.clone(), shown));
    }
    Ok(())
}

fn class_list(file: &Segmentation, path: &Path) -> Result<Vec<Class>> {
    let segments = file.segments.iter().filter(|segment| segment.number > 0);
    let entry = |segment: &Segment| {
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

/// Returns the DICOM files that the frames come from; empty for other recordings.
fn references(recording: &Recording) -> Result<References> {
    let sources = recording.dicom.as_ref().map(|origin| origin.references()).transpose()?.flatten();
    Ok(sources.map(|sources| sources.by_file()).unwrap_or_default())
}
