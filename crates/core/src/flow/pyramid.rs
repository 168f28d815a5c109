//! Images at several sizes, and their values between pixels.

use super::Vector;
use crate::grid::Grid;
use rayon::prelude::*;

/// Width and height of a patch, px.
pub(super) const PATCH: usize = 8;
/// Pixels at least that one thread takes at once.
const PIXELS_AT_ONCE: usize = 4096;

/// Returns the number of rows that one thread takes at once.
pub(super) fn rows_at_once(width: usize) -> usize {
    PIXELS_AT_ONCE.div_ceil(width.max(1))
}

/// Computes every pixel by itself, rows in parallel.
pub(super) fn each_pixel<T: Copy + Default + Send>(
    width: usize,
    height: usize,
    at: impl Fn(usize, usize) -> T + Sync,
) -> Grid<T> {
    let mut grid = Grid::filled(width, height, T::default());
    let rows = grid.data.par_chunks_mut(width.max(1)).with_min_len(rows_at_once(width));
    rows.enumerate().for_each(|(y, row)| {
        row.iter_mut().enumerate().for_each(|(x, value)| *value = at(x, y));
    });
    grid
}

/// Returns the half of the image, the half of that, and so on, while a patch fits.
pub(super) fn halvings(image: &Grid<f32>) -> Vec<Grid<f32>> {
    // `clamp` keeps NaN, `max` returns the number.
    let levels = each_pixel(image.width, image.height, |x, y| image.at(x, y).clamp(0.0, 255.0).max(0.0));
    let half = |whole: &Grid<f32>| (whole.width.min(whole.height) >= 2 * PATCH).then(|| halved(whole));
    std::iter::successors(half(&levels), half).collect()
}

/// Means of 2×2 pixels; an odd last column or row is left out.
pub(crate) fn halved(image: &Grid<f32>) -> Grid<f32> {
    each_pixel(image.width / 2, image.height / 2, |x, y| {
        let pair = |y: usize| image.at(2 * x, y) + image.at(2 * x + 1, y);
        (pair(2 * y) + pair(2 * y + 1)) / 4.0
    })
}

/// Flow of an image of twice the size: vectors are interpolated and twice as long.
pub(super) fn doubled(flow: &Grid<Vector>, width: usize, height: usize) -> Grid<Vector> {
    each_pixel(width, height, |x, y| {
        value_at(flow, [x, y].map(|v| v as f32 / 2.0 - 0.25)).map(|value| 2.0 * value)
    })
}

/// Interpolates a level linearly at a position in px; the border is repeated outside.
pub(super) fn level_at(image: &Grid<f32>, position: [f32; 2]) -> f32 {
    let (offsets, shares) = around(image.width, image.height, position);
    (0..4).map(|k| shares[k] * image.data[offsets[k]]).sum()
}

/// Interpolates several values linearly at a position in px; the border is repeated outside.
pub(super) fn value_at<const N: usize>(image: &Grid<[f32; N]>, position: [f32; 2]) -> [f32; N] {
    let (offsets, shares) = around(image.width, image.height, position);
    let pixels = offsets.map(|offset| image.data[offset]);
    std::array::from_fn(|n| (0..4).map(|k| shares[k] * pixels[k][n]).sum())
}

/// Offsets of the four pixels around a position in px, and their shares.
pub(crate) fn around(width: usize, height: usize, position: [f32; 2]) -> ([usize; 4], [f32; 4]) {
    let ends = [width - 1, height - 1];
    // `max` returns the number if the other is NaN.
    let [x, y] = std::array::from_fn(|k| position[k].max(0.0).min(ends[k] as f32));
    let (left, top) = (x as usize, y as usize);
    let (right, bottom) = ((left + 1).min(ends[0]), (top + 1).min(ends[1]));
    let (across, down) = (x - left as f32, y - top as f32);
    let offsets = [top * width + left, top * width + right, bottom * width + left, bottom * width + right];
    let (keep, stay) = (1.0 - across, 1.0 - down);
    (offsets, [keep * stay, across * stay, keep * down, across * down])
}

/// Slopes along x and y, levels per px: central differences, with the border repeated.
pub(super) fn slopes(image: &Grid<f32>) -> [Grid<f32>; 2] {
    let (right, bottom) = (image.width - 1, image.height - 1);
    let across = each_pixel(image.width, image.height, |x, y| {
        (image.at((x + 1).min(right), y) - image.at(x.saturating_sub(1), y)) / 2.0
    });
    let down = each_pixel(image.width, image.height, |x, y| {
        (image.at(x, (y + 1).min(bottom)) - image.at(x, y.saturating_sub(1))) / 2.0
    });
    [across, down]
}
