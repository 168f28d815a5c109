//! The technical attributes of a file.

use crate::{
    Error, Result,
    camera::check_image_size,
    dicom::{
        DicomFile, LeftUnread, Set, Value, read,
        tag::{self, Tag},
        uid,
    },
    reading::Piece,
    sequence::times,
};
use sha2::{Digest, Sha256};
use std::path::{Path, PathBuf};

/// Everything that is read of a file. The identifier of the series is hashed at once, to tell series apart.
const WANTED: [Tag; 32] = [
    tag::DIRECTORY_RECORDS,
    tag::SOP_CLASS,
    tag::SERIES_INSTANCE,
    tag::INSTANCE_NUMBER,
    tag::DISPLAY_FRAME_RATE,
    tag::CINE_RATE,
    tag::FRAME_TIME,
    tag::FRAME_TIME_VECTOR,
    tag::IMAGER_PIXEL_SPACING,
    tag::SHARED_GROUPS,
    tag::PIXEL_MEASURES,
    tag::PIXEL_SPACING,
    tag::SAMPLES_PER_PIXEL,
    tag::PHOTOMETRIC,
    tag::PLANAR,
    tag::NUMBER_OF_FRAMES,
    tag::ROWS,
    tag::COLUMNS,
    tag::BITS_ALLOCATED,
    tag::BITS_STORED,
    tag::HIGH_BIT,
    tag::PIXEL_REPRESENTATION,
    tag::RED_DESCRIPTOR,
    tag::GREEN_DESCRIPTOR,
    tag::BLUE_DESCRIPTOR,
    tag::RED_TABLE,
    tag::GREEN_TABLE,
    tag::BLUE_TABLE,
    tag::LOSSY,
    tag::CHARACTER_SET,
    tag::EXTENDED_OFFSETS,
    tag::PIXEL_DATA,
];

/// Most frames of a file: ten hours of video.
const MOST_FRAMES: f64 = 1_048_576.0;

/// Kind of a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    Pictures,
    Segmentation,
    Directory,
    /// A report, a waveform and the like.
    Other,
}

/// A file.
pub(super) struct Object {
    pub path: PathBuf,
    pub kind: Kind,
    /// Hash of the identifier of its series.
    pub series: [u8; 32],
    /// Number in the series.
    pub number: i64,
    pub syntax: String,
    /// Columns and rows.
    pub size: (usize, usize),
    pub num_frames: usize,
    pub set: Set,
    pub left_unread: LeftUnread,
}

impl Object {
    pub(super) fn read(path: &Path) -> Result<Self> {
        let DicomFile { syntax, mut set, left_unread } = read(path, &WANTED)?;
        let kind = kind(&set);
        let (mut size, mut num_frames) = ((0, 0), 0);
        if kind == Kind::Pictures {
            let side = |tag| set.short(tag).map_or(0, usize::from);
            size = (side(tag::COLUMNS), side(tag::ROWS));
            check_image_size(size.0, size.1).map_err(|what| Error::input_at(path, what, ""))?;
            num_frames = number_of_frames(&set).map_err(|what| Error::input_at(path, what, ""))?;
        }
        let series = Sha256::digest(set.bytes(tag::SERIES_INSTANCE).unwrap_or_default()).into();
        set.elements.retain(|(tag, _)| *tag != tag::SERIES_INSTANCE);
        let number = set.numbers(tag::INSTANCE_NUMBER).first().map_or(0, |number| *number as i64);
        Ok(Self { path: path.to_owned(), kind, series, number, syntax, size, num_frames, set, left_unread })
    }

    /// Returns the places of its pixels: one piece if they are stored as they are, else the fragments, of which
    /// the first is the table of offsets.
    pub(super) fn pixels(&self) -> Result<Pixels<'_>> {
        match self.set.value(tag::PIXEL_DATA) {
            Some(Value::Stored(piece)) => Ok(Pixels::Stored(*piece)),
            Some(Value::Fragments(all)) => match all.split_first() {
                Some((offsets, fragments)) if !fragments.is_empty() => {
                    Ok(Pixels::Fragments { offsets: *offsets, fragments })
                }
                _ => Err(Error::input_at(&self.path, "this DICOM file holds no pictures", "")),
            },
            _ => Err(Error::input_at(&self.path, "this DICOM file holds no pictures", "")),
        }
    }

    /// Returns the distance of pixel centres in millimetres: of rows, and of columns.
    pub(super) fn spacing_mm(&self) -> Option<[f64; 2]> {
        let shared = self.set.item(tag::SHARED_GROUPS).and_then(|set| set.item(tag::PIXEL_MEASURES));
        let places = [
            shared.map(|set| (set, tag::PIXEL_SPACING)),
            Some((&self.set, tag::PIXEL_SPACING)),
            Some((&self.set, tag::IMAGER_PIXEL_SPACING)),
        ];
        let given = places.into_iter().flatten().map(|(set, tag)| set.numbers(tag));
        let valid = |numbers: Vec<f64>| <[f64; 2]>::try_from(numbers).ok();
        given.filter_map(valid).find(|pair| pair.iter().all(|v| v.is_finite() && *v > 0.0))
    }

    /// Returns frames per second.
    pub(super) fn speed(&self) -> Option<f64> {
        let listed = times::mean_speed(&self.seconds()).map(f64::from);
        let time = || self.set.positive(tag::FRAME_TIME).map(|time| 1e3 / time);
        let rate =
            || [tag::CINE_RATE, tag::DISPLAY_FRAME_RATE].into_iter().find_map(|t| self.set.positive(t));
        listed.or_else(time).or_else(rate)
    }

    /// Returns the time of every frame, seconds from the first one; empty if it is not listed.
    pub(super) fn seconds(&self) -> Vec<f64> {
        // The first time is none: it is that since the frame before the first.
        let steps: Vec<f64> = self.set.numbers(tag::FRAME_TIME_VECTOR).into_iter().skip(1).collect();
        if steps.is_empty() || !steps.iter().all(|t| *t >= 0.0 && t.is_finite()) {
            return Vec::new();
        }
        let after = |seconds: &mut f64, step: f64| {
            *seconds += 1e-3 * step;
            Some(*seconds)
        };
        std::iter::once(0.0).chain(steps.into_iter().scan(0.0, after)).collect()
    }

    /// Returns the photometric interpretation.
    pub(super) fn photometric(&self) -> String {
        self.set.text(tag::PHOTOMETRIC).unwrap_or_default()
    }

    /// Returns the error that its pictures cannot be read.
    pub(super) fn unreadable(&self, why: &str) -> Error {
        let hint = "Convert it to MPEG-4 H.264, JPEG or Explicit VR Little Endian.";
        Error::input_at(&self.path, format!("the pictures of this DICOM file cannot be read: {why}"), hint)
    }
}

/// Places of pixels.
pub(super) enum Pixels<'a> {
    Stored(Piece),
    Fragments { offsets: Piece, fragments: &'a [Piece] },
}

fn kind(set: &Set) -> Kind {
    let class = set.text(tag::SOP_CLASS).unwrap_or_default();
    if [uid::SEGMENTATION, uid::LABEL_MAP].contains(&class.as_str()) {
        Kind::Segmentation
    } else if set.value(tag::DIRECTORY_RECORDS).is_some() {
        Kind::Directory
    } else if set.value(tag::PIXEL_DATA).is_some() {
        Kind::Pictures
    } else {
        Kind::Other
    }
}

fn number_of_frames(set: &Set) -> Result<usize, String> {
    match set.numbers(tag::NUMBER_OF_FRAMES).first() {
        None => Ok(1),
        Some(n) if *n >= 1.0 && *n <= MOST_FRAMES && n.fract() == 0.0 => Ok(*n as usize),
        Some(n) => Err(format!("this DICOM file says that it has {n} frames")),
    }
}
