//! Frames that are decoded here one by one: plain numbers, run lengths, JPEG.

use super::{
    object::{Object, Pixels},
    rle,
    stored::Form,
};
use crate::{
    Error, Result,
    dicom::tag,
    reading::{Piece, Pieces, jpeg},
};
use image::RgbImage;
use std::path::Path;

/// The frames of a file.
#[derive(Debug)]
pub(in crate::sequence) struct DicomPictures {
    frames: Vec<Pieces>,
    size: (usize, usize),
    coding: Coding,
}

/// Coding of a frame.
#[derive(Debug)]
pub(super) enum Coding {
    Plain(Form),
    RunLengths(Form),
    /// JPEG; `true` if its three channels are red, green and blue as they are.
    Jpeg {
        is_rgb: bool,
    },
}

impl DicomPictures {
    pub(super) fn open(object: &Object, coding: Coding) -> Result<Self> {
        let pieces = match (object.pixels()?, &coding) {
            (Pixels::Stored(all), Coding::Plain(form)) => plain_frames(object, all, form)?,
            (Pixels::Fragments { offsets, fragments }, Coding::RunLengths(_) | Coding::Jpeg { .. }) => {
                coded_frames(object, offsets, fragments)?
            }
            _ => return Err(object.unreadable("they are not stored as the file says")),
        };
        let frames = pieces.iter().map(|pieces| Pieces::of(&object.path, pieces)).collect();
        Ok(Self { frames, size: object.size, coding })
    }

    pub(super) fn num_frames(&self) -> usize {
        self.frames.len()
    }

    /// Returns the number of bytes that a frame takes in the file.
    pub(in crate::sequence) fn coded_bytes(&self, index: usize) -> u64 {
        self.frames[index].len()
    }

    /// Returns the bytes of a frame in the file.
    pub(in crate::sequence) fn read_coded(&self, index: usize) -> Result<Vec<u8>> {
        let frame = &self.frames[index];
        frame.read().map_err(|e| Error::io("read the frame", frame.path(), e))
    }

    /// Decodes a frame.
    pub(in crate::sequence) fn frame(&self, index: usize) -> Result<RgbImage> {
        let bytes = self.read_coded(index)?;
        let found = self.decoded(&bytes).map_err(|why| self.damaged(index, &why))?;
        let size = (found.width() as usize, found.height() as usize);
        if size == self.size {
            return Ok(found);
        }
        Err(self.damaged(
            index,
            &format!("it is {}×{} instead of {}×{}", size.0, size.1, self.size.0, self.size.1),
        ))
    }

    fn decoded(&self, bytes: &[u8]) -> Result<RgbImage, String> {
        let too_few = || "it is cut off".to_owned();
        match &self.coding {
            Coding::Plain(form) => form.picture(bytes).ok_or_else(too_few),
            Coding::RunLengths(form) => form.picture(&unpacked(bytes, form)?).ok_or_else(too_few),
            Coding::Jpeg { is_rgb } => Ok(match is_rgb {
                true => jpeg(&with_plain_colours(bytes))?,
                false => jpeg(bytes)?,
            }
            .into_rgb8()),
        }
    }

    fn damaged(&self, index: usize, why: &str) -> Error {
        let path = self.frames.first().map_or(Path::new(""), |frame| frame.path());
        Error::input_at(path, format!("frame {index} cannot be decoded: {why}"), "")
    }
}

/// Returns the places of frames that are stored one after the other.
fn plain_frames(object: &Object, all: Piece, form: &Form) -> Result<Vec<Vec<Piece>>> {
    let (n, len) = (object.num_frames, form.frame_bytes() as u64);
    if n as u64 * len > all.len {
        let there = all.len.checked_div(len).unwrap_or(0);
        return Err(object.unreadable(&format!("it lists {n} frames and holds {there} of them")));
    }
    Ok((0..n as u64).map(|i| vec![Piece { offset: all.offset + i * len, len }]).collect())
}

/// Returns the fragments of each frame. Where a frame begins is told by the extended table of offsets or by
/// the basic one (PS3.5, A.4); without either, each fragment is a frame, or all are one.
fn coded_frames(object: &Object, offsets: Piece, fragments: &[Piece]) -> Result<Vec<Vec<Piece>>> {
    let n = object.num_frames;
    if n == 1 {
        return Ok(vec![fragments.to_vec()]);
    }
    if fragments.len() == n {
        return Ok(fragments.iter().map(|fragment| vec![*fragment]).collect());
    }
    let starts = match object.set.bytes(tag::EXTENDED_OFFSETS) {
        Some(bytes) => bytes.as_chunks::<8>().0.iter().map(|eight| u64::from_le_bytes(*eight)).collect(),
        None => basic_offsets(object, offsets)?,
    };
    if starts.len() != n {
        let there = fragments.len();
        return Err(object.unreadable(&format!("it lists {n} frames and holds {there} parts of frames")));
    }
    // Offsets count from the head of the first fragment.
    let head = 8;
    let zero = fragments[0].offset - head;
    let mut frames: Vec<Vec<Piece>> = Vec::with_capacity(n);
    for fragment in fragments {
        let at = fragment.offset - head - zero;
        if starts.get(frames.len()) == Some(&at) {
            frames.push(Vec::new());
        }
        match frames.last_mut() {
            Some(frame) => frame.push(*fragment),
            None => return Err(object.unreadable("its table of offsets is wrong")),
        }
    }
    if frames.len() == n { Ok(frames) } else { Err(object.unreadable("its table of offsets is wrong")) }
}

fn basic_offsets(object: &Object, table: Piece) -> Result<Vec<u64>> {
    let fail = |e| Error::io("read the DICOM file", &object.path, e);
    let bytes = Pieces::of(&object.path, &[table]).read().map_err(fail)?;
    Ok(bytes.as_chunks::<4>().0.iter().map(|four| u64::from(u32::from_le_bytes(*four))).collect())
}

/// Unpacks run lengths into the bytes of a frame as it would be stored plainly, pixel by pixel.
fn unpacked(bytes: &[u8], form: &Form) -> Result<Vec<u8>, String> {
    let (width, samples) = form.segments();
    let n = form.num_pixels();
    let segments = rle::unpack(bytes, width * samples, n)?;
    let mut plain = vec![0; n * width * samples];
    for (place, segment) in segments.iter().enumerate() {
        // The segment of the high bytes comes first.
        let offset = place / width * width + width - 1 - place % width;
        plain
            .iter_mut()
            .skip(offset)
            .step_by(width * samples)
            .zip(segment)
            .for_each(|(to, byte)| *to = *byte);
    }
    Ok(plain)
}

/// Adds the mark to a JPEG stream which says that its channels are red, green and blue (ITU-T T.872, 6.5.3),
/// unless it says itself what they are.
fn with_plain_colours(bytes: &[u8]) -> Vec<u8> {
    const MARK: &[u8] = b"\xff\xee\x00\x0eAdobe\x00\x64\x00\x00\x00\x00\x00";
    let has_mark = bytes.windows(5).take(1 << 12).any(|window| window == b"Adobe");
    match bytes.split_at_checked(2) {
        Some((begin, rest)) if !has_mark => [begin, MARK, rest].concat(),
        _ => bytes.to_vec(),
    }
}
