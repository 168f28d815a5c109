//! Files of DICOM, as far as recordings and segmentations need them: reading and writing of data elements,
//! and identifiers. The numbers of sections are those of the standard's parts PS3.3, PS3.5 and PS3.10.
//!
//! A file can hold anything about a patient. The reader therefore keeps only the attributes that it is asked
//! for. It counts the others by their kind and never keeps their values.

pub(crate) mod colour;
#[cfg(test)]
pub(crate) mod elements;
mod left_unread;
mod reader;
mod segmentation;
mod set;
pub(crate) mod tag;
pub(crate) mod uid;
mod writer;

pub(crate) use left_unread::LeftUnread;
pub(crate) use reader::{DicomFile, is_dicom, read};
pub(crate) use segmentation::{Segment, Segmentation};
pub(crate) use set::{Set, Value};
pub(crate) use writer::{Vr, Writer};

/// Length of a value, a sequence or an item whose end is marked instead.
const UNDEFINED: u32 = u32::MAX;
