//! Label Studio's brush masks: run lengths of RGBA pixels, packed bit by bit (the `rle-pack` of thi.ng).
//!
//! ```text
//! number of values (32 bits) · bits per value − 1 (5) · bits − 1 of the four kinds of lengths (4 × 4)
//! then per run:  1 · kind of length (2) · length − 1 · value      the value repeated
//!                0 · kind of length (2) · length − 1 · values     each value by itself
//! ```
//!
//! A pixel is four values; the last one, its opacity, says whether it belongs to the mask.

use crate::grid::Mask;

/// Number of values per pixel.
const CHANNELS: usize = 4;
/// Bits of the four kinds of lengths that we write.
const LENGTH_BITS: [u32; 4] = [3, 4, 8, 16];
/// Bits per value.
const VALUE_BITS: u32 = 8;

/// Packs a mask.
pub(crate) fn pack(mask: &Mask) -> Vec<u8> {
    let mut bits = BitWriter::default();
    bits.push((mask.data.len() * CHANNELS) as u32, 32);
    bits.push(VALUE_BITS - 1, 5);
    LENGTH_BITS.iter().for_each(|length| bits.push(length - 1, 4));
    for run in mask.data.chunk_by(|a, b| a == b) {
        let value = if run[0] { 255 } else { 0 };
        let mut left = run.len() * CHANNELS;
        while left > 0 {
            let kind = LENGTH_BITS.iter().position(|bits| left <= 1 << bits).unwrap_or(LENGTH_BITS.len() - 1);
            let length = left.min(1 << LENGTH_BITS[kind]);
            bits.push(1, 1);
            bits.push(kind as u32, 2);
            bits.push(length as u32 - 1, LENGTH_BITS[kind]);
            bits.push(value, VALUE_BITS);
            left -= length;
        }
    }
    bits.bytes
}

/// Unpacks a mask of a known size; `None` if the bytes are of none.
pub(crate) fn mask(bytes: &[u8], width: usize, height: usize) -> Option<Mask> {
    let mut bits = BitReader { bytes, at: 0 };
    let values = width.checked_mul(height)?.checked_mul(CHANNELS)?;
    if bits.take(32)? as usize != values {
        return None;
    }
    let value_bits = bits.take(5)? + 1;
    let mut length_bits = [0; 4];
    for length in &mut length_bits {
        *length = bits.take(4)? + 1;
    }
    let mut mask = Mask::filled(width, height, false);
    let mut at = 0;
    while at < values {
        let is_repeated = bits.take(1)? == 1;
        let kind = bits.take(2)? as usize;
        let end = (at + bits.take(length_bits[kind])? as usize + 1).min(values);
        let mut value = if is_repeated { bits.take(value_bits)? } else { 0 };
        for i in at..end {
            if !is_repeated {
                value = bits.take(value_bits)?;
            }
            if i % CHANNELS == CHANNELS - 1 {
                mask.data[i / CHANNELS] = value > 0;
            }
        }
        at = end;
    }
    Some(mask)
}

#[derive(Default)]
struct BitWriter {
    bytes: Vec<u8>,
    len: usize,
}

impl BitWriter {
    /// Adds the lowest `count` bits of a value, the highest first.
    fn push(&mut self, value: u32, count: u32) {
        for k in (0..count).rev() {
            if self.len.is_multiple_of(8) {
                self.bytes.push(0);
            }
            if let Some(last) = self.bytes.last_mut() {
                *last |= ((value >> k & 1) as u8) << (7 - self.len % 8);
            }
            self.len += 1;
        }
    }
}

struct BitReader<'a> {
    bytes: &'a [u8],
    at: usize,
}

impl BitReader<'_> {
    /// Takes up to 32 bits, the highest first; `None` at the end.
    fn take(&mut self, count: u32) -> Option<u32> {
        let mut value = 0;
        for _ in 0..count {
            let byte = *self.bytes.get(self.at / 8)?;
            value = value << 1 | u32::from(byte >> (7 - self.at % 8) & 1);
            self.at += 1;
        }
        Some(value)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn packed_bytes_begin_with_their_number_and_read_back() {
        let mut mask = Mask::filled(4, 3, false);
        [1, 2, 5, 11].into_iter().for_each(|i| mask.data[i] = true);
        let packed = pack(&mask);
        // 12 pixels of four channels.
        assert_eq!(packed[..4], [0, 0, 0, 48]);
        assert_eq!(super::mask(&packed, 4, 3), Some(mask));
    }

    #[test]
    fn single_values_are_read() {
        // 4 values of 8 bits: one run of 4 values, each by itself.
        let mut bits = BitWriter::default();
        for (value, count) in [(4, 32), (7, 5), (2, 4), (3, 4), (7, 4), (15, 4), (0, 1), (0, 2), (3, 3)] {
            bits.push(value, count);
        }
        [9, 0, 0, 200].into_iter().for_each(|value| bits.push(value, 8));
        assert_eq!(mask(&bits.bytes, 1, 1), Some(Mask::filled(1, 1, true)));
        assert_eq!(mask(&bits.bytes[..9], 1, 1), None, "cut off");
        assert_eq!(mask(&bits.bytes, 2, 1), None, "another size");
        assert_eq!(mask(&[], 1, 1), None);
    }

    proptest! {
        #[test]
        fn masks_read_back(width in 0_usize..300, height in 0_usize..90, seed in any::<u64>(), every in 1_u32..64) {
            let is_set = |i: usize| (seed.rotate_left(i as u32 / every) & 3) == 1;
            let mask = Mask::from_vec(width, height, (0..width * height).map(is_set).collect());
            prop_assert_eq!(super::mask(&pack(&mask), width, height), Some(mask));
        }

        #[test]
        fn arbitrary_bytes_are_a_mask_or_none(bytes in prop::collection::vec(any::<u8>(), 0..60)) {
            let _ = mask(&[&[0, 0, 0, 96][..], &bytes].concat(), 6, 4);
        }
    }
}
