//! Conversion of a network's coarse logits to a mask of the image, with its stability.

use super::bit_mask::BitMask;
use crate::mask::{PixelRect, WORD};

/// Pixels of the image along one axis, each between two values of the coarse map.
struct Axis {
    /// Index of the value before.
    low: Vec<usize>,
    /// Weight of the value after.
    weight: Vec<f32>,
}

impl Axis {
    /// Lays `pixels` over the first `extent` (a share, 0–1) of `values`; bilinear between pixel
    /// centres, clamped.
    fn new(pixels: usize, values: usize, extent: f32) -> Self {
        let step = extent * values as f32 / pixels as f32;
        let position = |i: usize| ((i as f32 + 0.5) * step - 0.5).clamp(0.0, (values - 1) as f32);
        let low = (0..pixels).map(|i| position(i) as usize).collect();
        let weight = (0..pixels).map(|i| position(i).fract()).collect();
        Self { low, weight }
    }
}

/// Scales coarse maps to the size of the image, or of a window of it.
pub(super) struct Upsampler {
    image_width: usize,
    image_height: usize,
    window: PixelRect,
    map: [usize; 2],
    columns: Axis,
    rows: Axis,
}

/// A mask as the network returned it.
pub(super) struct Measured {
    pub mask: BitMask,
    /// Share of the pixels above -offset that are above +offset too.
    pub stability: f32,
}

impl Upsampler {
    /// Creates an upsampler of maps of `map` (columns, rows) values; the `window` of the image covers the
    /// shares `extent` of them.
    pub(super) fn new(image: [usize; 2], window: PixelRect, map: [usize; 2], extent: [f32; 2]) -> Self {
        Self {
            image_width: image[0],
            image_height: image[1],
            window,
            map,
            columns: Axis::new(window.width, map[0], extent[0]),
            rows: Axis::new(window.height, map[1], extent[1]),
        }
    }

    /// Returns the pixels with a logit above 0; `None` if there are none. A logit that is not a
    /// number is not above 0.
    pub(super) fn measure(&self, logits: &[f32], offset: f32) -> Option<Measured> {
        let [map_width, map_height] = self.map;
        let words = self.image_width.div_ceil(WORD);
        let mut bits = vec![0_u64; words * self.image_height];
        let row_of = |y: usize| &logits[y * map_width..][..map_width];
        let reaches: Vec<bool> = (0..map_height).map(|y| row_of(y).iter().any(|&v| v > -offset)).collect();
        // The last value is repeated, so that there is always one after.
        let mut blended = vec![0.0_f32; map_width + 1];
        let (mut inner, mut outer) = (0_u32, 0_u32);
        for y in 0..self.window.height {
            let (low, weight) = (self.rows.low[y], self.rows.weight[y]);
            let high = (low + 1).min(map_height - 1);
            if !reaches[low] && !reaches[high] {
                continue;
            }
            for ((out, a), b) in blended.iter_mut().zip(row_of(low)).zip(row_of(high)) {
                *out = a + weight * (b - a);
            }
            blended[map_width] = blended[map_width - 1];
            let row = &mut bits[(self.window.y + y) * words..][..words];
            let (above, below) = self.row_bits(&blended, offset, row);
            (inner, outer) = (inner + above, outer + below);
        }
        let mask = BitMask::from_rows(self.image_width, &bits)?;
        Some(Measured { mask, stability: inner as f32 / outer.max(1) as f32 })
    }

    /// Sets the bits of one row; returns the numbers of pixels above `offset` and above `-offset`.
    fn row_bits(&self, values: &[f32], offset: f32, row: &mut [u64]) -> (u32, u32) {
        let (from, to) = (self.window.x, self.window.x + self.window.width);
        let (mut inner, mut outer) = (0, 0);
        for (k, word) in row.iter_mut().enumerate().take(to.div_ceil(WORD)).skip(from / WORD) {
            let pixels = from.max(k * WORD)..to.min((k + 1) * WORD);
            let mut logits = [f32::NEG_INFINITY; WORD];
            let inside = pixels.start - from..pixels.end - from;
            let places = self.columns.low[inside.clone()].iter().zip(&self.columns.weight[inside]);
            for (logit, (&low, &weight)) in logits[pixels.start % WORD..].iter_mut().zip(places) {
                *logit = values[low] + weight * (values[low + 1] - values[low]);
            }
            let above = |limit: f32| {
                logits.iter().rev().fold(0_u64, |word, &logit| word << 1 | u64::from(logit > limit))
            };
            *word = above(0.0);
            inner += above(offset).count_ones();
            outer += above(-offset).count_ones();
        }
        (inner, outer)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn whole(width: usize, height: usize) -> PixelRect {
        PixelRect { x: 0, y: 0, width, height }
    }

    #[test]
    fn a_ramp_is_cut_where_it_crosses_zero() {
        // Values -3, -1, 1, 3 at the columns 0.5, 1.5, 2.5, 3.5: zero at column 2 of 4, at 100 of 200.
        let map: Vec<f32> = (0..8).map(|i| -3.0 + 2.0 * (i % 4) as f32).collect();
        let upsampler = Upsampler::new([200, 6], whole(200, 6), [4, 2], [1.0, 1.0]);
        let found = upsampler.measure(&map, 1.0).unwrap();
        assert_eq!(found.mask.bounds(), PixelRect { x: 100, y: 0, width: 100, height: 6 });
        assert_eq!(found.mask.area_px(), 600);
        // Above 1 from column 125 on, above -1 from 75 on.
        assert!((found.stability - 75.0 / 125.0).abs() < 1e-6, "{}", found.stability);
    }

    #[test]
    fn a_padded_map_is_used_as_far_as_the_image_reaches() {
        // The image covers the upper half; the positive lower half is padding.
        let map: Vec<f32> = (0..16)
            .map(|i| {
                if i >= 8 {
                    5.0
                } else if i < 4 {
                    -5.0
                } else {
                    2.0
                }
            })
            .collect();
        let upsampler = Upsampler::new([4, 2], whole(4, 2), [4, 4], [1.0, 0.5]);
        let found = upsampler.measure(&map, 1.0).unwrap();
        assert_eq!(found.mask.bounds(), PixelRect { x: 0, y: 1, width: 4, height: 1 });
    }

    #[test]
    fn a_window_lies_where_it_lies() {
        let upsampler =
            Upsampler::new([150, 9], PixelRect { x: 60, y: 2, width: 70, height: 4 }, [2, 2], [1.0, 1.0]);
        let found = upsampler.measure(&[1.0; 4], 1.0).unwrap();
        assert_eq!(found.mask.bounds(), PixelRect { x: 60, y: 2, width: 70, height: 4 });
        assert_eq!(found.stability, 0.0, "1 is not above the offset");
        assert!(upsampler.measure(&[-1.0, f32::NAN, -2.0, 0.0], 1.0).is_none());
    }
}
