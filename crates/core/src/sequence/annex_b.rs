//! Bare streams of H.264 (H.264, annex B): finds the coded pictures, without times. Frames are numbered in
//! the order in which a decoder shows them.

use super::{
    colours::Colours,
    edit_list::Cut,
    mp4::{CodedPicture, Description, Framing, MAX_PICTURES, Mp4},
    nal::{self, IDR_SLICE, SEQUENCE_PARAMETERS, START_CODE, is_slice, start_code},
};
use crate::reading::Pieces;
use std::io::Read;

/// NAL unit types that begin a new picture if they follow a slice (H.264, 7.4.1.2.3), besides slices.
const BEGINNINGS: [u8; 9] = [6, 7, 8, 9, 14, 15, 16, 17, 18];
const PICTURE_PARAMETERS: u8 = 8;
/// Number of bytes read at once.
const CHUNK: usize = 1 << 20;
/// Number of bytes of a unit that tell its kind and its place: the head, and the number of the first
/// macroblock.
const HEAD: usize = 2;
/// Largest parameter set, bytes.
const MOST_PARAMETERS: usize = 1 << 12;

/// Returns `true` if a stream begins with a start code of H.264 or H.265.
pub(super) fn is_bare(head: &[u8]) -> bool {
    head.starts_with(&START_CODE) || head.starts_with(&[0, 0, 0, 1])
}

/// Finds the pictures of a stream whose frames have a size. The error says why that is not possible.
pub(super) fn index(file: &Pieces, (width, height): (usize, usize)) -> Result<Mp4, String> {
    let mut pictures = Pictures::default();
    scan(file, |at, unit| pictures.take(at, unit)).map_err(|e| e.to_string())?;
    pictures.close(file.len());
    let Pictures { found, parameter_sets, .. } = pictures;
    if found.first().is_none_or(|first| !first.is_sync) || parameter_sets.is_empty() {
        return Err("there is no H.264 video in it that can be entered at its beginning".to_owned());
    }
    if found.len() > MAX_PICTURES {
        return Err("it has too many pictures".to_owned());
    }
    let sequence = parameter_sets.iter().find(|unit| unit[0] & 31 == SEQUENCE_PARAMETERS);
    let sequence = sequence.map_or(&[][..], Vec::as_slice);
    let (pixel_aspect, colours) = (nal::pixel_aspect(sequence), Colours::of_parameters(sequence));
    let framing = Framing::StartCodes;
    let description = Description { from: 0, width, height, pixel_aspect, colours, framing, parameter_sets };
    Ok(Mp4 {
        descriptions: vec![description],
        timescale: 0,
        is_turned: false,
        present: found.len(),
        bytes: file.len(),
        cut: Cut::nothing(found.len()),
        lasts: 0,
        pictures: found,
        is_open_ended: false,
        num_tracks: 1,
    })
}

/// The pictures found so far.
#[derive(Default)]
struct Pictures {
    found: Vec<CodedPicture>,
    /// The first of each kind.
    parameter_sets: Vec<Vec<u8>>,
    has_slice: bool,
}

impl Pictures {
    /// Takes a unit that begins at `at`, its start code included; `unit` are its first bytes.
    fn take(&mut self, at: u64, unit: &[u8]) {
        let Some(&head) = unit.first() else { return };
        let kind = head & 31;
        let is_slice = is_slice(unit);
        // The number of the first macroblock is 0 if the next bit is set (H.264, 7.3.3 and 9.1).
        let is_first_slice = is_slice && unit.get(1).is_some_and(|byte| byte & 0x80 != 0);
        let begins =
            self.found.is_empty() || (self.has_slice && (is_first_slice || BEGINNINGS.contains(&kind)));
        if begins {
            self.close(at);
            self.has_slice = false;
            self.found.push(CodedPicture {
                offset: at,
                size: 0,
                shown_at: self.found.len() as i64,
                is_sync: false,
            });
        }
        if is_slice && !self.has_slice {
            self.has_slice = true;
            if let Some(last) = self.found.last_mut() {
                last.is_sync = kind == IDR_SLICE;
            }
        }
        let is_known = |kind: u8| self.parameter_sets.iter().any(|set| set[0] & 31 == kind);
        if [SEQUENCE_PARAMETERS, PICTURE_PARAMETERS].contains(&kind) && !is_known(kind) {
            self.parameter_sets.push(unit.to_vec());
        }
    }

    /// Ends the last picture; one without a slice is none.
    fn close(&mut self, at: u64) {
        if let Some(last) = self.found.last_mut() {
            last.size = usize::try_from(at - last.offset).unwrap_or(usize::MAX);
        }
        if !self.has_slice {
            self.found.pop();
        }
    }
}

/// Goes through the units of a stream: `take` is told where each begins, and its first bytes; of parameter
/// sets, all of them.
fn scan(file: &Pieces, mut take: impl FnMut(u64, &[u8])) -> std::io::Result<()> {
    let mut source = file.open()?;
    // Bytes from `at` on that are not gone through yet.
    let (mut window, mut at) = (Vec::new(), 0_u64);
    loop {
        let before = window.len();
        source.by_ref().take(CHUNK as u64).read_to_end(&mut window)?;
        let is_last = window.len() == before;
        let mut done = 0;
        let rest = loop {
            // A start code may lie across the border.
            let Some(place) = start_code(&window[done..]) else {
                break window.len().saturating_sub(2).max(done);
            };
            let begin = done + place;
            let body = &window[begin + START_CODE.len()..];
            if body.len() < MOST_PARAMETERS && !is_last {
                break begin;
            }
            take(at + begin as u64, head_of(body));
            done = begin + START_CODE.len();
        };
        if is_last {
            return Ok(());
        }
        at += rest as u64;
        window.drain(..rest);
    }
}

/// Returns the bytes of a unit that matter.
fn head_of(body: &[u8]) -> &[u8] {
    let is_parameters =
        body.first().is_some_and(|b| [SEQUENCE_PARAMETERS, PICTURE_PARAMETERS].contains(&(b & 31)));
    if !is_parameters {
        return &body[..body.len().min(HEAD)];
    }
    let body = &body[..body.len().min(MOST_PARAMETERS)];
    let unit = &body[..start_code(body).unwrap_or(body.len())];
    &unit[..unit.iter().rposition(|byte| *byte != 0).map_or(0, |last| last + 1)]
}
