//! Colours of pictures that are stored as plain numbers (PS3.3, C.7.6.3).

use super::{object::Object, palette::Palette};
use crate::dicom::tag;
use image::RgbImage;

/// Form of the numbers of a frame.
#[derive(Debug)]
pub(super) struct Form {
    size: (usize, usize),
    samples: usize,
    /// 8 or 16.
    bits: usize,
    /// Number of bits of a 16-bit number that count, and the place of the highest.
    stored: u16,
    high: u16,
    is_signed: bool,
    /// `true` if each channel is stored by itself.
    is_planar: bool,
    colours: Colours,
}

/// Meaning of the numbers.
#[derive(Debug)]
enum Colours {
    Grey {
        is_inverted: bool,
    },
    Rgb,
    /// ITU-R BT.601 with full range.
    Ybr,
    /// The same, with one colour for two pixels of a row.
    Ybr422,
    Palette(Palette),
}

impl Form {
    /// Reads the form of a file's numbers. The error says why they cannot be shown.
    pub(super) fn of(object: &Object) -> Result<Self, String> {
        let short = |tag, usual| object.set.short(tag).unwrap_or(usual);
        let (bits, samples) = (short(tag::BITS_ALLOCATED, 8), short(tag::SAMPLES_PER_PIXEL, 1));
        let stored = short(tag::BITS_STORED, bits);
        let high = short(tag::HIGH_BIT, stored.wrapping_sub(1));
        let photometric = object.photometric();
        let (colours, expected) = match photometric.as_str() {
            "MONOCHROME1" => (Colours::Grey { is_inverted: true }, 1),
            "MONOCHROME2" => (Colours::Grey { is_inverted: false }, 1),
            "RGB" => (Colours::Rgb, 3),
            "YBR_FULL" => (Colours::Ybr, 3),
            "YBR_FULL_422" => (Colours::Ybr422, 3),
            "PALETTE COLOR" => (Colours::Palette(Palette::of(&object.set)?), 1),
            _ => return Err("their colours are of an unknown kind".to_owned()),
        };
        if ![8, 16].contains(&bits) || samples != expected || !(1..=bits).contains(&stored) || high >= bits {
            return Err(format!("they have {samples} numbers of {bits} bits per pixel"));
        }
        if matches!(colours, Colours::Ybr422) && (bits != 8 || object.size.0 % 2 == 1) {
            return Err("their colours are stored for half pixels".to_owned());
        }
        Ok(Self {
            size: object.size,
            samples: usize::from(samples),
            bits: usize::from(bits),
            stored,
            high,
            is_signed: short(tag::PIXEL_REPRESENTATION, 0) == 1,
            is_planar: short(tag::PLANAR, 0) == 1 && samples > 1,
            colours,
        })
    }

    /// Returns the form of numbers that are stored pixel by pixel.
    pub(super) fn by_pixels(self) -> Self {
        Self { is_planar: false, ..self }
    }

    /// Returns the number of bytes of a frame.
    pub(super) fn frame_bytes(&self) -> usize {
        let numbers = if matches!(self.colours, Colours::Ybr422) { 2 } else { self.samples };
        self.size.0 * self.size.1 * numbers * self.bits / 8
    }

    /// Returns the number of bytes of a number, and of numbers per pixel; for run lengths.
    pub(super) fn segments(&self) -> (usize, usize) {
        (self.bits / 8, self.samples)
    }

    /// Returns the number of pixels of a frame.
    pub(super) fn num_pixels(&self) -> usize {
        self.size.0 * self.size.1
    }

    /// Converts the bytes of a frame; `None` if there are too few.
    pub(super) fn picture(&self, bytes: &[u8]) -> Option<RgbImage> {
        let bytes = bytes.get(..self.frame_bytes())?;
        let (n, half) = (self.num_pixels(), matches!(self.colours, Colours::Ybr422));
        let mut rgb = Vec::with_capacity(3 * n);
        for pixel in 0..n {
            let number = |channel: usize| {
                let place = match (half, self.is_planar, channel) {
                    (true, _, 0) => pixel / 2 * 4 + pixel % 2,
                    (true, ..) => pixel / 2 * 4 + 1 + channel,
                    (_, true, _) => channel * n + pixel,
                    _ => pixel * self.samples + channel,
                };
                self.number(bytes, place)
            };
            rgb.extend(self.colour(number));
        }
        RgbImage::from_raw(self.size.0 as u32, self.size.1 as u32, rgb)
    }

    /// Returns a stored number without the bits that do not count.
    fn number(&self, bytes: &[u8], place: usize) -> u16 {
        let raw = match self.bits {
            8 => u16::from(bytes[place]),
            _ => u16::from_le_bytes([bytes[2 * place], bytes[2 * place + 1]]),
        };
        let lowest = (self.high + 1).saturating_sub(self.stored);
        raw >> lowest & (u32::from(u16::MAX) >> (16 - self.stored.min(16))) as u16
    }

    /// Brings a number to 8 bits.
    fn level(&self, number: u16) -> u8 {
        let number = if self.is_signed { number ^ 1 << (self.stored - 1) } else { number };
        match self.stored {
            0..8 => (u32::from(number) * 255 / ((1 << self.stored) - 1)) as u8,
            _ => (number >> (self.stored - 8)) as u8,
        }
    }

    fn colour(&self, number: impl Fn(usize) -> u16) -> [u8; 3] {
        match &self.colours {
            Colours::Grey { is_inverted } => {
                let level = self.level(number(0));
                [if *is_inverted { 255 - level } else { level }; 3]
            }
            Colours::Rgb => [0, 1, 2].map(|channel| self.level(number(channel))),
            Colours::Ybr | Colours::Ybr422 => of_ybr([0, 1, 2].map(|channel| self.level(number(channel)))),
            Colours::Palette(palette) => palette.colour(number(0)),
        }
    }
}

/// Converts full-range BT.601 (PS3.3, C.7.6.3.1.2).
fn of_ybr([y, b, r]: [u8; 3]) -> [u8; 3] {
    let (y, b, r) = (f32::from(y), f32::from(b) - 128.0, f32::from(r) - 128.0);
    [y + 1.402 * r, y - 0.344_136 * b - 0.714_136 * r, y + 1.772 * b]
        .map(|v| v.round().clamp(0.0, 255.0) as u8)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn colours_are_those_of_the_standard() {
        assert_eq!(of_ybr([128, 128, 128]), [128; 3]);
        assert_eq!(of_ybr([76, 85, 255]), [254, 0, 0]);
    }
}
