//! Reading of segmentations (PS3.3, A.51), frame by frame.

use super::{
    read,
    set::{Set, Value},
    tag::{self, Tag},
    uid,
};
use crate::{
    Error, Result,
    camera::check_image_size,
    grid::{Grid, Mask},
    reading::{Piece, Pieces},
};
use std::{
    collections::BTreeSet,
    io::{Read, Seek, SeekFrom},
    path::{Path, PathBuf},
};

const WANTED: [Tag; 24] = [
    tag::SOP_CLASS,
    tag::ROWS,
    tag::COLUMNS,
    tag::NUMBER_OF_FRAMES,
    tag::BITS_ALLOCATED,
    tag::SEGMENTATION_TYPE,
    tag::SEGMENTS,
    tag::SEGMENT_NUMBER,
    tag::SEGMENT_LABEL,
    tag::DISPLAY_COLOUR,
    tag::MAXIMUM_FRACTION,
    tag::SHARED_GROUPS,
    tag::PER_FRAME_GROUPS,
    tag::DERIVATION_IMAGES,
    tag::SOURCE_IMAGES,
    tag::REFERENCED_SOP_INSTANCE,
    tag::REFERENCED_FRAME,
    tag::FRAME_CONTENT,
    tag::TEMPORAL_POSITION,
    tag::SEGMENT_IDENTIFICATION,
    tag::REFERENCED_SEGMENT,
    tag::CHARACTER_SET,
    tag::PHOTOMETRIC,
    tag::PIXEL_DATA,
];

/// A segmentation, of which the pixels are read on request.
#[derive(Clone, Debug)]
pub(crate) struct Segmentation {
    path: PathBuf,
    width: usize,
    height: usize,
    bits: u64,
    /// Value from which a pixel of a fractional segment counts.
    least: u16,
    pub(crate) segments: Vec<Segment>,
    /// `true` if labels are in another character set than UTF-8 and Latin-1, and were read as far as possible.
    pub(crate) has_unread_labels: bool,
    pub(crate) frames: Vec<SegmentationFrame>,
    pixels: Piece,
}

/// A structure that a segmentation shows.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Segment {
    pub(crate) number: u16,
    pub(crate) label: String,
    /// Display colour, scaled CIELab.
    pub(crate) lab: Option<[u16; 3]>,
}

/// The meaning of a frame.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct SegmentationFrame {
    /// The segment that it shows; `None` if its values are numbers of segments.
    pub(crate) segment: Option<u16>,
    /// Identifier of the file that it is about, and number of the frame in it, from 1.
    pub(crate) instance: Option<String>,
    pub(crate) number: Option<u32>,
    /// Place of the frame that it is about in time, from 1.
    pub(crate) position: Option<u32>,
}

impl Segmentation {
    /// Reads everything but the pixels.
    pub(crate) fn open(path: &Path) -> Result<Self> {
        let file = read(path, &WANTED)?;
        let wrong = |what: &str| {
            let hint = "It must be a segmentation without compression.";
            Error::input_at(path, format!("this segmentation cannot be used: {what}"), hint)
        };
        if file.set.items(tag::SEGMENTS).is_empty() {
            return Err(wrong("it has no segments"));
        }
        if ![uid::IMPLICIT, uid::EXPLICIT].contains(&file.syntax.as_str()) {
            return Err(wrong("its pixels are compressed"));
        }
        Self::of(path, &file.set).map_err(wrong)
    }

    fn of(path: &Path, set: &Set) -> Result<Self, &'static str> {
        let side = |tag| set.short(tag).map_or(0, usize::from);
        let (width, height) = (side(tag::COLUMNS), side(tag::ROWS));
        check_image_size(width, height).map_err(|_| "its size is none that is possible")?;
        let kind = set.text(tag::SEGMENTATION_TYPE).unwrap_or_default();
        let bits = set.short(tag::BITS_ALLOCATED).unwrap_or(0);
        let (is_labels, least) = match (kind.as_str(), bits) {
            ("BINARY", 1) => (false, 1),
            ("FRACTIONAL", 8) => (false, set.short(tag::MAXIMUM_FRACTION).unwrap_or(255).div_ceil(2).max(1)),
            ("LABELMAP", 8 | 16) => (true, 0),
            _ => return Err("it is of an unknown kind"),
        };
        let (items, is_latin) = (set.items(tag::SEGMENTS), is_latin(set));
        let segments = items.iter().map(|item| segment(item, is_latin)).collect::<Option<Vec<_>>>();
        let has_unread_labels = !is_latin && items.iter().any(|item| !item.is_utf8(tag::SEGMENT_LABEL));
        let groups = set.items(tag::PER_FRAME_GROUPS);
        let shared = set.item(tag::SHARED_GROUPS);
        let frames: Vec<_> = groups.iter().map(|group| frame(group, shared, is_labels)).collect();
        let Some(&Value::Stored(pixels)) = set.value(tag::PIXEL_DATA) else { return Err("it has no pixels") };
        let number = set.numbers(tag::NUMBER_OF_FRAMES).first().copied().unwrap_or(0.0);
        if frames.is_empty() || number != frames.len() as f64 {
            return Err("it does not describe each of its frames");
        }
        if !is_labels && frames.iter().any(|frame| frame.segment.is_none()) {
            return Err("a frame belongs to no segment");
        }
        let num_bits = (width * height) as u64 * u64::from(bits);
        if (num_bits * frames.len() as u64).div_ceil(8) > pixels.len {
            return Err("it is cut off");
        }
        Ok(Self {
            path: path.to_owned(),
            width,
            height,
            bits: u64::from(bits),
            least,
            segments: segments.ok_or("a segment has no number")?,
            has_unread_labels,
            frames,
            pixels,
        })
    }

    pub(crate) fn path(&self) -> &Path {
        &self.path
    }

    /// Returns columns and rows.
    pub(crate) fn size(&self) -> (usize, usize) {
        (self.width, self.height)
    }

    /// Returns `true` if all frames that refer to a file refer to the same one.
    pub(crate) fn is_about_one_file(&self) -> bool {
        let instances: BTreeSet<&str> =
            self.frames.iter().filter_map(|frame| frame.instance.as_deref()).collect();
        instances.len() < 2
    }

    /// Returns the segment that a pixel of a frame shows, 0 for none.
    pub(crate) fn shown(&self, i: usize) -> Result<Grid<u16>> {
        let values = self.values(i).map_err(|e| Error::io("read the segmentation", &self.path, e))?;
        let shown = match self.frames[i].segment {
            None => values,
            Some(segment) => values.into_iter().map(|v| if v >= self.least { segment } else { 0 }).collect(),
        };
        Ok(Grid::from_vec(self.width, self.height, shown))
    }

    /// Returns the mask of a segment on a frame.
    pub(crate) fn mask(&self, i: usize, segment: u16) -> Result<Mask> {
        Ok(self.shown(i)?.map(|shown| *shown == segment))
    }

    fn values(&self, i: usize) -> std::io::Result<Vec<u16>> {
        let num_pixels = self.width * self.height;
        let first_bit = i as u64 * num_pixels as u64 * self.bits;
        let last_bit = first_bit + num_pixels as u64 * self.bits;
        let mut file = Pieces::of(&self.path, &[self.pixels]).open()?;
        file.seek(SeekFrom::Start(first_bit / 8))?;
        let len = last_bit.div_ceil(8) - first_bit / 8;
        let mut bytes = vec![0; len as usize];
        file.read_exact(&mut bytes)?;
        let offset = (first_bit % 8) as usize;
        Ok(match self.bits {
            1 => {
                (offset..offset + num_pixels).map(|bit| u16::from(bytes[bit / 8] >> (bit % 8) & 1)).collect()
            }
            8 => bytes.into_iter().map(u16::from).collect(),
            _ => bytes.as_chunks::<2>().0.iter().map(|pair| u16::from_le_bytes(*pair)).collect(),
        })
    }
}

/// Returns `true` if texts are in Latin-1 (PS3.3, C.12.1.1.2).
fn is_latin(set: &Set) -> bool {
    let character_set = set.text(tag::CHARACTER_SET);
    matches!(character_set.as_deref(), Some("ISO_IR 100" | "ISO 2022 IR 100"))
}

fn segment(item: &Set, is_latin: bool) -> Option<Segment> {
    let label = if is_latin { item.latin_text(tag::SEGMENT_LABEL) } else { item.text(tag::SEGMENT_LABEL) };
    Some(Segment {
        number: item.short(tag::SEGMENT_NUMBER)?,
        label: label.unwrap_or_default(),
        lab: item.shorts(tag::DISPLAY_COLOUR).try_into().ok(),
    })
}

fn frame(group: &Set, shared: Option<&Set>, is_labels: bool) -> SegmentationFrame {
    let of = |tag| group.item(tag).or_else(|| shared?.item(tag));
    let source = of(tag::DERIVATION_IMAGES).and_then(|derivation| derivation.item(tag::SOURCE_IMAGES));
    let segment = of(tag::SEGMENT_IDENTIFICATION).and_then(|item| item.short(tag::REFERENCED_SEGMENT));
    let number = source.and_then(|source| source.positive(tag::REFERENCED_FRAME));
    SegmentationFrame {
        segment: segment.filter(|_| !is_labels),
        instance: source.and_then(|source| source.text(tag::REFERENCED_SOP_INSTANCE)),
        number: number.map(|number| number as u32),
        position: of(tag::FRAME_CONTENT).and_then(|item| item.longs(tag::TEMPORAL_POSITION).first().copied()),
    }
}
