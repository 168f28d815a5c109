//! Guided filter (He, Sun and Tang 2013, "Guided image filtering"; fast form of He and Sun 2015): borders of
//! shares move to borders of the picture.
//!
//! In each window q = a · I + b is fitted to the shares by least squares, with I the colours. The fit is made
//! on a picture of a quarter of the size, to shares of half the size; its coefficients are applied to the
//! whole picture.

use super::means::window_means;
use crate::grid::Grid;
use fearless_simd::{Level, Simd, dispatch};
use fearless_simd_macros::simd;
use image::RgbImage;
use rayon::prelude::*;

/// Side of the cells whose means the fit uses, px; and of those at half size.
const CELL: usize = 4;
const HALF_CELL: usize = CELL / 2;
/// Half the window, in widths of the picture; at least one cell.
const REACH: f32 = 0.024;
/// Addend to the variances of colours, of 0 to 1: slopes of less contrast are not followed.
const SMOOTHING: f32 = 3e-4;

/// Returns half the window in cells.
fn reach(columns: usize) -> usize {
    (REACH * columns as f32).round().max(1.0) as usize
}

/// The filter of one picture, with everything that does not depend on the shares.
pub(super) struct GuidedFilter {
    picture: RgbImage,
    /// Mean colours of the cells.
    small: Grid<[f32; 3]>,
    /// Mean colour of each window, and the inverse covariance: xx, xy, xz, yy, yz, zz.
    means: Vec<[f32; 3]>,
    inverses: Vec<[f32; 6]>,
}

impl GuidedFilter {
    /// Prepares the filter of a picture.
    pub(super) fn new(picture: RgbImage) -> Self {
        let (width, height) = (picture.width() as usize, picture.height() as usize);
        let raw = picture.as_raw();
        // What is left over at the right and at the bottom belongs to the last cells.
        let columns = (width / 2).div_ceil(HALF_CELL);
        let rows = (height / 2).div_ceil(HALF_CELL);
        let colour = |i: usize| std::array::from_fn(|c| f32::from(raw[3 * i + c]) / 255.0);
        let small = shrunk([width, height], CELL, [columns, rows], colour);
        let size = [small.width, small.height];
        let reach = reach(small.width);
        let products = |a: usize, b: usize| small.data.iter().map(|v| v[a] * v[b]).collect::<Vec<f32>>();
        let first: Vec<Vec<f32>> = (0..3)
            .map(|c| window_means(&small.data.iter().map(|v| v[c]).collect::<Vec<_>>(), size, reach))
            .collect();
        let pairs = [(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)];
        let second: Vec<Vec<f32>> =
            pairs.par_iter().map(|(a, b)| window_means(&products(*a, *b), size, reach)).collect();
        let means: Vec<[f32; 3]> =
            (0..small.data.len()).map(|i| std::array::from_fn(|c| first[c][i])).collect();
        let inverse = |i: usize| {
            let m = means[i];
            let covariance: [f32; 6] = std::array::from_fn(|p| {
                let (a, b) = pairs[p];
                second[p][i] - m[a] * m[b] + if a == b { SMOOTHING } else { 0.0 }
            });
            inverse_of(covariance)
        };
        let inverses = (0..small.data.len()).map(inverse).collect();
        Self { picture, small, means, inverses }
    }

    /// Filters the shares of every pixel at half size, rounded down; returns them at full size.
    pub(super) fn filter(&self, shares: &[f32]) -> Vec<f32> {
        let half = [self.picture.width(), self.picture.height()].map(|side| side as usize / 2);
        let size = [self.small.width, self.small.height];
        let reach = reach(size[0]);
        let small = shrunk(half, HALF_CELL, size, |i| [shares[i]]);
        let values: Vec<f32> = small.data.iter().map(|[v]| *v).collect();
        let mean = window_means(&values, size, reach);
        let with = |c: usize| {
            let products: Vec<f32> = self.small.data.iter().zip(&values).map(|(i, v)| i[c] * v).collect();
            window_means(&products, size, reach)
        };
        let products = [with(0), with(1), with(2)];
        let fit = |i: usize| -> [f32; 4] {
            let (m, s) = (self.means[i], self.inverses[i]);
            let v: [f32; 3] = std::array::from_fn(|c| products[c][i] - m[c] * mean[i]);
            let a = [
                s[0] * v[0] + s[1] * v[1] + s[2] * v[2],
                s[1] * v[0] + s[3] * v[1] + s[4] * v[2],
                s[2] * v[0] + s[4] * v[1] + s[5] * v[2],
            ];
            [a[0], a[1], a[2], mean[i] - a[0] * m[0] - a[1] * m[1] - a[2] * m[2]]
        };
        let fits: Vec<[f32; 4]> = (0..values.len()).map(fit).collect();
        let smooth: Vec<Vec<f32>> = (0..4)
            .map(|c| window_means(&fits.iter().map(|f| f[c]).collect::<Vec<_>>(), size, reach))
            .collect();
        let fits = Grid::from_vec(
            size[0],
            size[1],
            (0..fits.len()).map(|i| std::array::from_fn(|c| smooth[c][i])).collect(),
        );
        self.apply(&fits)
    }

    /// Applies interpolated coefficients to the whole picture.
    fn apply(&self, fits: &Grid<[f32; 4]>) -> Vec<f32> {
        let (width, height) = (self.picture.width() as usize, self.picture.height() as usize);
        let raw = self.picture.as_raw();
        let mut out = vec![0.0; width * height];
        let level = Level::new();
        out.par_chunks_mut(width.max(1)).enumerate().for_each(|(y, row)| {
            let at = ((y as f32 + 0.5) / CELL as f32 - 0.5).clamp(0.0, (fits.height - 1) as f32);
            let (top, down) = (at as usize, at.fract());
            let bottom = (top + 1).min(fits.height - 1);
            let pairs = fits.row(top).iter().zip(fits.row(bottom));
            let line: Vec<[f32; 4]> =
                pairs.map(|(a, b)| std::array::from_fn(|c| a[c] + down * (b[c] - a[c]))).collect();
            let pixels = raw[3 * y * width..3 * (y + 1) * width].as_chunks().0;
            dispatch!(level, simd => apply_row(simd, &line, pixels, row));
        });
        out
    }
}

/// Applies coefficients at the middles of cells to a row of pixels.
#[simd]
fn apply_row<S: Simd>(_: S, fits: &[[f32; 4]], pixels: &[[u8; 3]], out: &mut [f32]) {
    // Left of the first middle, between each two, and what is left over.
    let first = (CELL / 2).min(out.len());
    let (head, tail) = out.split_at_mut(first);
    let (head_pixels, tail_pixels) = pixels.split_at(first);
    let (blocks, rest) = tail.as_chunks_mut::<CELL>();
    let (pixel_blocks, rest_pixels) = tail_pixels.as_chunks::<CELL>();
    let num_blocks = blocks.len();
    let between = |k: usize| [fits[k.min(fits.len() - 1)], fits[(k + 1).min(fits.len() - 1)]];
    let some = |fits: [[f32; 4]; 2], pixels: &[[u8; 3]], out: &mut [f32]| {
        let mut block = [[0; 3]; CELL];
        block[..pixels.len()].copy_from_slice(pixels);
        out.copy_from_slice(&applied(fits, &block)[..out.len()]);
    };
    some([fits[0]; 2], head_pixels, head);
    for (k, (out, pixels)) in blocks.iter_mut().zip(pixel_blocks).enumerate() {
        *out = applied(between(k), pixels);
    }
    some(between(num_blocks), rest_pixels, rest);
}

/// Applies coefficients to the pixels between two middles.
#[inline(always)]
fn applied([left, right]: [[f32; 4]; 2], pixels: &[[u8; 3]; CELL]) -> [f32; CELL] {
    let fit = |c: usize, j: usize| left[c] + (j as f32 + 0.5) / CELL as f32 * (right[c] - left[c]);
    let value = |j: usize| {
        let colour = pixels[j].map(|level| f32::from(level) / 255.0);
        fit(3, j) + fit(0, j) * colour[0] + fit(1, j) * colour[1] + fit(2, j) * colour[2]
    };
    std::array::from_fn(|j| value(j).clamp(0.0, 1.0))
}

/// Returns the means of cells of `cell`² pixels; the last ones of a row or column may be larger or smaller.
fn shrunk<const N: usize>(
    [width, height]: [usize; 2],
    cell: usize,
    [columns, rows]: [usize; 2],
    at: impl Fn(usize) -> [f32; N] + Sync,
) -> Grid<[f32; N]> {
    let pixels =
        |k: usize, count: usize, size: usize| k * cell..if k + 1 == count { size } else { (k + 1) * cell };
    let mut means = Grid::filled(columns, rows, [0.0; N]);
    means.data.par_chunks_mut(columns.max(1)).with_min_len(16).enumerate().for_each(|(row, means)| {
        let ys = pixels(row, rows, height);
        for (column, mean) in means.iter_mut().enumerate() {
            let xs = pixels(column, columns, width);
            for y in ys.clone() {
                for x in xs.clone() {
                    let value = at(y * width + x);
                    (0..N).for_each(|c| mean[c] += value[c]);
                }
            }
            let count = (xs.len() * ys.len()) as f32;
            mean.iter_mut().for_each(|v| *v /= count);
        }
    });
    means
}

/// Inverse of a symmetric matrix: xx, xy, xz, yy, yz, zz.
fn inverse_of([a, b, c, d, e, f]: [f32; 6]) -> [f32; 6] {
    let cofactors =
        [d * f - e * e, c * e - b * f, b * e - c * d, a * f - c * c, b * c - a * e, a * d - b * b];
    let determinant = a * cofactors[0] + b * cofactors[1] + c * cofactors[2];
    cofactors.map(|v| v / determinant.max(f32::MIN_POSITIVE))
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::Rgb;

    #[test]
    fn borders_move_to_those_of_the_picture() {
        let colour = |x: u32| if x < 240 { [200, 60, 50] } else { [60, 90, 70] };
        let filter = GuidedFilter::new(RgbImage::from_fn(480, 32, |x, _| Rgb(colour(x))));
        // Six pixels too far to the right.
        let shares: Vec<f32> = (0..240 * 16).map(|i| if i % 240 < 123 { 1.0 } else { 0.0 }).collect();
        let filtered = filter.filter(&shares);
        let row = &filtered[16 * 480..17 * 480];
        assert!(row[238] > 0.5 && row[241] < 0.5, "{:?}", &row[230..250]);
        assert!(row[20] > 0.95 && row[460] < 0.05);
    }

    #[test]
    fn a_flat_picture_keeps_constant_shares() {
        let filter = GuidedFilter::new(RgbImage::from_pixel(10, 7, Rgb([9, 9, 9])));
        assert!(filter.filter(&[0.25; 15]).iter().all(|v| (v - 0.25).abs() < 1e-4));
        let inverse = inverse_of([2.0, 0.0, 0.0, 4.0, 0.0, 5.0]);
        assert_eq!(inverse, [0.5, 0.0, 0.0, 0.25, 0.0, 0.2]);
    }
}
