//! Files about all frames of an export. Each file gets the frames one by one and is streamed to disk, so
//! that memory does not grow with the number of frames. It appears in its place, complete, at the end. An
//! export that stops before leaves none of them.

mod coco;
mod cvat;
mod dicom_seg;
mod gif;
mod label_studio;
mod list;
mod nrrd;
mod sheet;
mod stream;
mod table;
mod video;

pub(super) use stream::{Series, SeriesPlan};
pub use video::VideoFault;

use super::Format;
use crate::files::WholeFile;
use std::io;

/// Returns the file's path inside the export.
pub(super) fn name(format: Format, frames: &[usize]) -> String {
    let (first, last) = (frames.first().unwrap_or(&0), frames.last().unwrap_or(&0));
    format!("{}/frames_{first:06}-{last:06}.{}", format.name(), format.extension())
}

/// Begins a file of a format that [`Format::is_series`].
pub(super) fn begin(format: Format, file: WholeFile, plan: SeriesPlan<'_>) -> io::Result<Box<dyn Series>> {
    Ok(match format {
        Format::Video => Box::new(video::Video::begin(file, plan)?),
        Format::Gif => Box::new(gif::Gif::begin(file, plan)?),
        Format::Sheet => Box::new(sheet::Sheet::begin(file, plan)),
        Format::Csv => Box::new(table::FrameTable::begin(table::Csv::begin(file, plan)?)),
        Format::Json => Box::new(table::FrameTable::begin(table::Json::begin(file, plan)?)),
        Format::Coco => Box::new(coco::Coco::begin(file, plan)?),
        Format::DicomSeg => Box::new(dicom_seg::DicomSeg::begin(file, plan)?),
        Format::Cvat => Box::new(cvat::Cvat::begin(file, plan)?),
        Format::LabelStudio => Box::new(label_studio::LabelStudio::begin(file, plan)?),
        Format::Nrrd => Box::new(nrrd::Nrrd::begin(file, plan)?),
        _ => return Err(io::Error::other("this format has a file per frame")),
    })
}

#[cfg(test)]
mod tests;
