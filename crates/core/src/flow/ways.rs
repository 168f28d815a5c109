//! Displacements one after the other, and what is left of them.

use super::{Vector, pyramid, small_flow};
use crate::grid::Grid;
use image::RgbImage;

/// Luma of ITU-R BT.601 of every pixel, in 8-bit levels.
pub fn luma(picture: &RgbImage) -> Grid<f32> {
    let data = picture.pixels().map(|pixel| super::between::luminance(&pixel.0.map(f32::from))).collect();
    Grid::from_vec(picture.width() as usize, picture.height() as usize, data)
}

/// Displacements that lead `first` and then `then`: at x they are first(x) + then(x + first(x)).
pub fn joined(first: &Grid<Vector>, then: &Grid<Vector>) -> Grid<Vector> {
    pyramid::each_pixel(first.width, first.height, |x, y| {
        let [u, v] = first.at(x, y);
        let [s, t] = pyramid::value_at(then, [x as f32 + u, y as f32 + v]);
        [u + s, v + t]
    })
}

/// Mends displacements: `to`, as it is seen along `way`, is compared with `from`, and the few px between both
/// are put before `way`. Luminance is in 8-bit levels.
pub fn mended(from: &Grid<f32>, to: &Grid<f32>, way: &Grid<Vector>) -> Grid<Vector> {
    let seen = pyramid::each_pixel(way.width, way.height, |x, y| {
        let [u, v] = way.at(x, y);
        pyramid::level_at(to, [x as f32 + u, y as f32 + v])
    });
    joined(&small_flow(from, &seen), way)
}
