//! A segmentation as a DICOM object (PS3.3, C.8.20): one segment per prompt, and references to the recorded
//! frames where these are DICOM.
//!
//! The pixels come last in the file, but a number for each of their frames comes before. They are therefore
//! collected in a temporary file. Memory holds a few bytes per frame. Identifiers follow from hashes and
//! dates are constant, so that equal inputs give equal bytes.

mod bits;
mod codes;
mod header;

use super::{Series, SeriesPlan};
use crate::{
    dicom::{Writer, uid},
    export::{Provenance, SegType, frame::FrameContent},
    files::WholeFile,
    sequence::SourceReferences,
};
use bits::Bits;
use sha2::{Digest, Sha256};
use std::{
    fs::File,
    io::{self, BufWriter, Seek, Write},
    path::Path,
};

/// Largest value of fractional segments, which stands for a score of 1.
const MOST_FRACTION: u16 = 255;

/// A frame of the file: a frame of the recording, and the segment that it shows; 0 for all of them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct SegFrame {
    frame: usize,
    segment: u16,
}

/// Facts that the header is made of.
struct Content<'a> {
    provenance: &'a Provenance,
    sources: Option<&'a SourceReferences>,
    size: (usize, usize),
    frames: &'a [SegFrame],
    /// `true` if some pixel is in two segments.
    has_overlap: bool,
    /// Hash of the pixels, for identifiers.
    pixels: &'a [u8],
}

pub(super) struct DicomSeg {
    file: WholeFile,
    provenance: Provenance,
    sources: Option<SourceReferences>,
    size: (usize, usize),
    /// First frame that the scene shows; a file without any finding refers to it.
    first: usize,
    frames: Vec<SegFrame>,
    has_overlap: bool,
    pixels: BufWriter<File>,
    /// Number of bytes in `pixels`.
    len: u64,
    hash: Sha256,
    bits: Bits,
    row: Vec<u8>,
}

impl DicomSeg {
    pub(super) fn begin(file: WholeFile, plan: SeriesPlan<'_>) -> io::Result<Self> {
        let folder = file.path().parent().unwrap_or(Path::new("."));
        let pixels = BufWriter::new(tempfile::tempfile_in(folder)?);
        let (provenance, sources) = (plan.provenance.clone(), plan.sources.cloned());
        let first = plan.frames.iter().find(|&&frame| provenance.shows(frame)).or(plan.frames.first());
        let first = first.copied().unwrap_or(0);
        let most = usize::from(u16::MAX);
        if plan.size.0 > most || plan.size.1 > most || provenance.prompts.len() > most {
            return Err(io::Error::other("DICOM has no numbers for so many columns, rows or segments"));
        }
        Ok(Self {
            file,
            provenance,
            sources,
            size: plan.size,
            first,
            frames: Vec::new(),
            has_overlap: false,
            pixels,
            len: 0,
            hash: Sha256::new(),
            bits: Bits::default(),
            row: Vec::new(),
        })
    }

    /// Adds a frame of the file, whose pixels are in `row`.
    fn push(&mut self, frame: usize, segment: usize) -> io::Result<()> {
        self.frames.push(SegFrame { frame, segment: segment as u16 });
        self.len += self.row.len() as u64;
        // The length of pixel data has 32 bits, and must be even.
        if self.len >= u64::from(u32::MAX) - 1 {
            return Err(io::Error::other(
                "a DICOM file holds at most 4 GB of pixels: export fewer frames at a time",
            ));
        }
        self.hash.update(&self.row);
        self.pixels.write_all(&self.row)
    }

    fn push_mask(&mut self, frame: usize, segment: usize, mask: &[bool]) -> io::Result<()> {
        self.row.clear();
        self.bits.push(mask, &mut self.row);
        self.push(frame, segment)
    }
}

impl Series for DicomSeg {
    /// Adds what was found. A frame that the scene does not show has no labels.
    fn add(&mut self, frame: &FrameContent<'_>) -> io::Result<()> {
        if !frame.is_shown() {
            return Ok(());
        }
        let num_pixels = self.size.0 * self.size.1;
        match self.provenance.options.seg_type {
            SegType::Binary => {
                for (i, mask) in frame.masks.iter().enumerate().filter(|(_, mask)| mask.data.contains(&true))
                {
                    self.push_mask(frame.frame, i + 1, &mask.data)?;
                }
            }
            SegType::Fractional => {
                for (i, scores) in frame.scores.iter().enumerate() {
                    self.row.clear();
                    self.row.extend(scores.data.iter().map(|score| fraction(*score)));
                    if self.row.iter().any(|value| *value > 0) {
                        self.push(frame.frame, i + 1)?;
                    }
                }
            }
            SegType::Labelmap => {
                self.row.clear();
                self.row.extend((0..num_pixels).map(|pixel| frame.label(pixel)));
                self.push(frame.frame, 0)?;
            }
        }
        let shares = |pixel: usize| frame.masks.iter().filter(|mask| mask.data[pixel]).count() > 1;
        self.has_overlap = self.has_overlap || (0..num_pixels).any(shares);
        Ok(())
    }

    fn finish(mut self: Box<Self>) -> io::Result<WholeFile> {
        if self.frames.is_empty() {
            // A file needs a frame.
            let (first, num_pixels) = (self.first, self.size.0 * self.size.1);
            match self.provenance.options.seg_type {
                SegType::Binary => self.push_mask(first, 1, &vec![false; num_pixels])?,
                SegType::Fractional | SegType::Labelmap => {
                    self.row = vec![0; num_pixels];
                    self.push(first, 1)?;
                }
            }
        }
        let Self {
            file,
            provenance,
            sources,
            size,
            frames,
            has_overlap,
            mut pixels,
            mut len,
            hash,
            bits,
            ..
        } = *self;
        if let Some(byte) = bits.rest() {
            pixels.write_all(&[byte])?;
            len += 1;
        }
        let digest = hash.finalize();
        let content = Content {
            provenance: &provenance,
            sources: sources.as_ref(),
            size,
            frames: &frames,
            has_overlap,
            pixels: &digest,
        };
        let mut writer = Writer::new(BufWriter::new(file));
        header::write(&mut writer, &content)?;
        let even = len.next_multiple_of(2);
        writer.begin_pixels(even as u32)?;
        let mut out = writer.into_inner();
        let mut pixels = pixels.into_inner()?;
        pixels.rewind()?;
        io::copy(&mut pixels, &mut out)?;
        out.write_all(&[0][..(even - len) as usize])?;
        Ok(out.into_inner()?)
    }
}

/// Returns the value of a score; NaN is 0.
fn fraction(score: f32) -> u8 {
    (score * f32::from(MOST_FRACTION)).round().clamp(0.0, f32::from(MOST_FRACTION)) as u8
}

impl Content<'_> {
    fn seg_type(&self) -> SegType {
        self.provenance.options.seg_type
    }

    fn class_uid(&self) -> &'static str {
        if self.seg_type() == SegType::Labelmap { uid::LABEL_MAP } else { uid::SEGMENTATION }
    }

    /// Returns the identifier of a thing that belongs to this very content.
    fn own_uid(&self, what: &str) -> String {
        // What can be serialized once can be again.
        let provenance = serde_json::to_vec(self.provenance).unwrap_or_default();
        let frames = self.frames.iter().flat_map(|f| [f.frame as u64, u64::from(f.segment)]);
        let frames: Vec<u8> = frames.flat_map(u64::to_le_bytes).collect();
        uid::of_hash(&[what.as_bytes(), &provenance, &frames, self.pixels])
    }
}
