//! The colours that luma and chroma of an H.264 video stand for (ITU-T H.273, 8.3).

use super::nal::sequence_parameters;
use h264_reader::nal::sps::VideoSignalType;
use openh264::{decoder::DecodedYUV, formats::YUVSource};
use shiguredo_mp4::{BoxType, boxes::UnknownBox};

/// Facts that a file gives about its colours; `None` where it says nothing.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Colours {
    /// The code of the matrix (ITU-T H.273, table 4).
    matrix: Option<u8>,
    /// `true` if luma and chroma take all 8-bit levels.
    is_full_range: Option<bool>,
}

/// The code of an unspecified matrix.
const UNSPECIFIED: u8 = 2;
/// Weights of red and blue in the luma of ITU-R BT.601, which unspecified colours follow.
const BT601: [f32; 2] = [0.299, 0.114];

impl Colours {
    /// Reads the facts in a sequence parameter set.
    pub(super) fn of_parameters(unit: &[u8]) -> Self {
        let vui = sequence_parameters(unit).and_then(|parameters| parameters.vui_parameters);
        let Some(VideoSignalType { video_full_range_flag, colour_description, .. }) =
            vui.and_then(|vui| vui.video_signal_type)
        else {
            return Self::default();
        };
        let matrix = colour_description.map(|description| description.matrix_coefficients);
        Self { matrix: matrix.filter(|m| *m != UNSPECIFIED), is_full_range: Some(video_full_range_flag) }
    }

    /// Reads the facts in a box of a container (ISO/IEC 14496-12, 12.1.5).
    pub(super) fn of_box(inner: &UnknownBox) -> Option<Self> {
        let [b'n', b'c', b'l', b'x', .., matrix, range] = *inner.payload.first_chunk::<11>()? else {
            return None;
        };
        let is_colour = inner.box_type == BoxType::Normal(*b"colr");
        let matrix = Some(matrix).filter(|m| *m != UNSPECIFIED);
        is_colour.then_some(Self { matrix, is_full_range: Some(range & 0x80 != 0) })
    }

    /// Takes from `other` what is not known.
    pub(super) fn or(self, other: Self) -> Self {
        Self {
            matrix: self.matrix.or(other.matrix),
            is_full_range: self.is_full_range.or(other.is_full_range),
        }
    }

    /// Writes the picture's colours row by row, three bytes per pixel.
    pub(super) fn write_rgb8(self, picture: &DecodedYUV<'_>, target: &mut [u8]) {
        let is_full_range = self.is_full_range.unwrap_or(false);
        if self.weights() == BT601 && !is_full_range {
            return picture.write_rgb8(target);
        }
        let ((width, _), (y, u, v)) = (picture.dimensions(), picture.strides());
        let conversion = Conversion::new(self.weights(), is_full_range);
        for (row, target) in target.chunks_exact_mut(3 * width).enumerate() {
            let chroma = [&picture.u()[row / 2 * u..], &picture.v()[row / 2 * v..]];
            conversion.row(&picture.y()[row * y..], chroma, target);
        }
    }

    /// Returns the weights of red and blue in luma.
    fn weights(self) -> [f32; 2] {
        match self.matrix {
            Some(1) => [0.2126, 0.0722],
            Some(4) => [0.30, 0.11],
            Some(7) => [0.212, 0.087],
            Some(9 | 10) => [0.2627, 0.0593],
            _ => BT601,
        }
    }
}

/// Factors from levels of luma and chroma to levels of colours.
struct Conversion {
    /// Level of black, and levels of brightness per level above it.
    luma: [f32; 2],
    red_by_v: f32,
    green_by_u: f32,
    green_by_v: f32,
    blue_by_u: f32,
}

impl Conversion {
    fn new([red, blue]: [f32; 2], is_full_range: bool) -> Self {
        let (luma, chroma) =
            if is_full_range { ([0.0, 1.0], 1.0) } else { ([16.0, 255.0 / 219.0], 255.0 / 224.0) };
        let green = 1.0 - red - blue;
        let (red_by_v, blue_by_u) = (2.0 * (1.0 - red) * chroma, 2.0 * (1.0 - blue) * chroma);
        Self {
            luma,
            red_by_v,
            green_by_u: -blue_by_u * blue / green,
            green_by_v: -red_by_v * red / green,
            blue_by_u,
        }
    }

    /// Converts a row; each two pixels share one level of chroma.
    fn row(&self, y: &[u8], [u, v]: [&[u8]; 2], target: &mut [u8]) {
        let [black, gain] = self.luma;
        for ((pair, y), (u, v)) in target.chunks_mut(6).zip(y.chunks(2)).zip(u.iter().zip(v)) {
            let (u, v) = (f32::from(*u) - 128.0, f32::from(*v) - 128.0);
            let chroma = [self.red_by_v * v, self.green_by_u * u + self.green_by_v * v, self.blue_by_u * u];
            for (pixel, y) in pair.chunks_exact_mut(3).zip(y) {
                let brightness = (f32::from(*y) - black) * gain + 0.5;
                pixel.iter_mut().zip(chroma).for_each(|(level, chroma)| *level = (brightness + chroma) as u8);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use shiguredo_mp4::BoxSize;

    #[test]
    fn grey_stays_grey_and_primaries_come_back() {
        for (matrix, is_full) in [(1, false), (1, true), (5, true), (6, false), (7, false), (9, true)] {
            let [red, blue] = Colours { matrix: Some(matrix), is_full_range: None }.weights();
            let conversion = Conversion::new([red, blue], is_full);
            let (black, luma, chroma) = if is_full { (0.0, 255.0, 255.0) } else { (16.0, 219.0, 224.0) };
            for rgb in [[0.0; 3], [0.5; 3], [1.0; 3], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.7, 0.2, 0.1]] {
                let y = red * rgb[0] + (1.0 - red - blue) * rgb[1] + blue * rgb[2];
                let difference = |part: f32, weight: f32| {
                    (128.0 + chroma * 0.5 * (part - y) / (1.0 - weight)).round() as u8
                };
                let (u, v) = (difference(rgb[2], blue), difference(rgb[0], red));
                let mut pixels = [0; 9];
                conversion.row(&[(black + luma * y).round() as u8; 3], [&[u; 2], &[v; 2]], &mut pixels);
                let wanted = rgb.map(|part| (255.0 * part).round() as u8);
                let is_near = |pixel: &[u8]| pixel.iter().zip(wanted).all(|(a, b)| a.abs_diff(b) <= 3);
                assert!(pixels.chunks(3).all(is_near), "{matrix} {is_full}: {pixels:?}, not {wanted:?}");
            }
        }
    }

    #[test]
    fn the_container_tells_what_the_stream_leaves_open() {
        let colours = |kind: &[u8; 4], payload: &[u8]| {
            let (box_type, payload) = (BoxType::Normal(*kind), payload.to_vec());
            let size = BoxSize::with_payload_size(box_type, payload.len() as u64);
            Colours::of_box(&UnknownBox { box_type, box_size: size, payload })
        };
        let told = colours(b"colr", b"nclx\0\x01\0\x01\0\x01\x80").unwrap();
        assert_eq!(told, Colours { matrix: Some(1), is_full_range: Some(true) });
        assert_eq!(colours(b"pasp", b"nclx\0\x01\0\x01\0\x01\x80"), None);
        assert_eq!(colours(b"colr", b"prof\0\x01\0\x01\0\x01\x80"), None);
        assert_eq!(colours(b"colr", b"nclx\0\x01\0\x01\0\x01"), None);
        let stream = Colours { matrix: None, is_full_range: Some(false) };
        assert_eq!(stream.or(told), Colours { matrix: Some(1), is_full_range: Some(false) });
        assert_eq!(Colours::of_parameters(&[0x67, 66]), Colours::default());
    }
}
