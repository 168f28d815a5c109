//! NAL units of H.264: how they are told apart, and the start codes before them (annex B).

use h264_reader::{
    nal::sps::SeqParameterSet,
    rbsp::{BitReader, decode_nal},
};

/// The bytes before each NAL unit.
pub(super) const START_CODE: [u8; 3] = [0, 0, 1];
/// NAL unit type of a slice of an IDR picture (H.264, table 7-1).
pub(super) const IDR_SLICE: u8 = 5;
/// NAL unit type of a sequence parameter set (H.264, table 7-1).
pub(super) const SEQUENCE_PARAMETERS: u8 = 7;

/// Reads a sequence parameter set; `None` if it is damaged, or the unit is another one.
pub(super) fn sequence_parameters(unit: &[u8]) -> Option<SeqParameterSet> {
    unit.first().filter(|head| *head & 31 == SEQUENCE_PARAMETERS)?;
    let bytes = decode_nal(unit).ok()?;
    SeqParameterSet::from_bits(BitReader::new(&*bytes)).ok()
}

/// Returns the width of a pixel by its height that a sequence parameter set tells (H.264, E.2.1).
pub(super) fn pixel_aspect(unit: &[u8]) -> Option<f32> {
    let (width, height) = sequence_parameters(unit)?.vui_parameters?.aspect_ratio_info?.get()?;
    Some(f32::from(width) / f32::from(height))
}

/// Returns `true` if a NAL unit holds a part of a picture.
pub(super) fn is_slice(unit: &[u8]) -> bool {
    unit.first().is_some_and(|head| (1..=IDR_SLICE).contains(&(head & 31)))
}

/// Returns the place of the first start code.
pub(super) fn start_code(bytes: &[u8]) -> Option<usize> {
    bytes.windows(START_CODE.len()).position(|window| window == START_CODE)
}
