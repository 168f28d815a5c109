//! DICOM segmentations as the labels of a recording.

use super::{
    SourceReferences,
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
    let references = recording.dicom.as_ref().map(|origin| origin.references()).transpose()?.flatten();
    let of_frame = |(sources, i): (&SourceReferences, usize)| {
        let source = sources.frames[i];
        ((sources.instances[source.instance].instance_uid.clone(), source.number), i)
    };
    Ok(references.iter().flat_map(|r| (0..r.frames.len()).map(move |i| of_frame((r, i)))).collect())
}
