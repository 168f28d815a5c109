//! Masks of the objects that clicks and boxes point at.

use crate::viewer::backend::task::lock;
use std::{
    path::{Path, PathBuf},
    sync::Mutex,
};
use surgtpgs_clip::SegmentAnything;
use surgtpgs_core::{Result, marks::Mark, segment::PointSegmenter, sequence::Sequence};

/// A Segment Anything that stays open for the next mark, with the frame that it read last.
pub(super) struct Segmenter {
    folder: PathBuf,
    model: SegmentAnything,
    sequence: Sequence,
    recording: PathBuf,
    frame: Option<usize>,
}

impl Segmenter {
    fn open(folder: &Path, recording: &Path) -> Result<Self> {
        Ok(Self {
            folder: folder.to_owned(),
            model: SegmentAnything::open(folder)?,
            sequence: Sequence::open(recording)?,
            recording: recording.to_owned(),
            frame: None,
        })
    }

    fn with_mask(&mut self, mark: &Mark) -> Result<Mark> {
        if self.frame != Some(mark.frame) {
            self.frame = None;
            self.model.set_image(&self.sequence.frame(mark.frame)?)?;
            self.frame = Some(mark.frame);
        }
        let size = [self.sequence.width(), self.sequence.height()];
        mark.with_mask(&mut self.model, size, self.sequence.field_of_view())
    }
}

/// Returns a mark with the mask of the object that it points at in a recording, by the network in `folder`.
pub(super) fn with_mask(
    kept: &Mutex<Option<Segmenter>>,
    folder: &Path,
    recording: &Path,
    mark: &Mark,
) -> Result<Mark> {
    let mut kept = lock(kept);
    if !kept.as_ref().is_some_and(|kept| kept.folder == folder && kept.recording == recording) {
        *kept = None;
        *kept = Some(Segmenter::open(folder, recording)?);
    }
    kept.as_mut().map_or_else(|| Ok(mark.clone()), |segmenter| segmenter.with_mask(mark))
}
