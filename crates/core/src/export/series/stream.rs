//! A file about all frames while it is written.

use crate::{
    export::{
        Provenance,
        frame::{FrameContent, drawn_size},
    },
    files::WholeFile,
    sequence::SourceReferences,
};
use std::io;

/// A file that is being written.
pub(in crate::export) trait Series {
    /// Adds the next frame.
    fn add(&mut self, frame: &FrameContent<'_>) -> io::Result<()>;
    /// Writes the rest; the file is complete then, but not in its place.
    fn finish(self: Box<Self>) -> io::Result<WholeFile>;
}

/// Facts that are known before the first frame.
#[derive(Clone, Copy)]
pub(in crate::export) struct SeriesPlan<'a> {
    pub(in crate::export) provenance: &'a Provenance,
    /// All frames that will be added, in order; at least one.
    pub(in crate::export) frames: &'a [usize],
    /// Columns and rows of every frame; none is 0.
    pub(in crate::export) size: (usize, usize),
    /// The DICOM files that the frames come from.
    pub(in crate::export) sources: Option<&'a SourceReferences>,
}

impl SeriesPlan<'_> {
    /// Returns columns and rows of pictures with prompts drawn over them.
    pub(in crate::export) fn drawn_size(&self) -> (u32, u32) {
        drawn_size(&self.provenance.options, (self.size.0 as u32, self.size.1 as u32))
    }
}
