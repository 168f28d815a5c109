//! Files about all frames of an export. Each is fed frame by frame and streamed to disk, so that memory does not grow
//! with the number of frames, and appears whole at the end; an export that stops before leaves none of them.

mod coco;
mod gif;
mod list;
mod nrrd;
mod sheet;
mod table;
mod video;

use super::{Format, Provenance, frame::FrameContent};
use crate::files::WholeFile;
use std::io;

/// A file in the making.
pub(super) trait Series {
    /// Adds the next frame.
    fn add(&mut self, frame: &FrameContent<'_>) -> io::Result<()>;
    /// Writes what is left; the file is complete then, but not in its place.
    fn finish(self: Box<Self>) -> io::Result<WholeFile>;
}

/// What is known before the first frame.
#[derive(Clone, Copy)]
pub(super) struct Plan<'a> {
    pub(super) provenance: &'a Provenance,
    /// All frames that will be added, in order; at least one.
    pub(super) frames: &'a [usize],
    /// Columns and rows of every frame; none is 0.
    pub(super) size: (usize, usize),
}

/// The file's path inside the export.
pub(super) fn name(format: Format, frames: &[usize]) -> String {
    let (first, last) = (frames.first().unwrap_or(&0), frames.last().unwrap_or(&0));
    format!("{}/frames_{first:06}-{last:06}.{}", format.name(), format.extension())
}

/// Begins a file of a format that [`Format::is_series`].
pub(super) fn begin(format: Format, file: WholeFile, plan: Plan<'_>) -> io::Result<Box<dyn Series>> {
    Ok(match format {
        Format::Video => Box::new(video::Video::begin(file, plan)?),
        Format::Gif => Box::new(gif::Gif::begin(file, plan)?),
        Format::Sheet => Box::new(sheet::Sheet::begin(file, plan)),
        Format::Csv => Box::new(table::Table::begin(table::Csv::begin(file))),
        Format::Json => Box::new(table::Table::begin(table::Json::begin(file, plan)?)),
        Format::Coco => Box::new(coco::Coco::begin(file, plan)?),
        Format::Nrrd => Box::new(nrrd::Nrrd::begin(file, plan)?),
        Format::Cutout
        | Format::Overlay
        | Format::Binary
        | Format::Index
        | Format::Outline
        | Format::Score
        | Format::Npy => return Err(io::Error::other("this format has a file per frame")),
    })
}

#[cfg(test)]
mod tests;
