//! Depth between points of known depth.

use super::NEAREST_POINTS;
use crate::grid::Grid;
use kiddo::{ImmutableKdTree, SquaredEuclidean};
use rayon::prelude::*;
use std::num::NonZeroUsize;

/// Distance, px, up to which points count alike.
const SOFT_PX: f32 = 8.0;
/// Distance of the pixels at which depth is computed, px; between them it is interpolated by the nearest.
const EVERY_PX: usize = 4;

/// Returns the depth of every pixel: a mean of its nearest points (u, v, z), weighted by the inverse square
/// of their distance.
pub(super) fn through(points: &[[f32; 3]], width: usize, height: usize) -> Grid<f32> {
    let positions: Vec<[f32; 2]> = points.iter().map(|p| [p[0], p[1]]).collect();
    let Ok(tree) = ImmutableKdTree::<f32, 2>::new_from_slice(&positions) else {
        return Grid::filled(width, height, 0.0);
    };
    let count = NonZeroUsize::new(NEAREST_POINTS).unwrap_or(NonZeroUsize::MIN);
    let (columns, rows) = (width.div_ceil(EVERY_PX), height.div_ceil(EVERY_PX));
    let depth = |k: usize| {
        let at = [k % columns, k / columns].map(|v| (v * EVERY_PX) as f32 + 0.5 * EVERY_PX as f32);
        let near = tree.query(&at).nearest_n::<SquaredEuclidean<f32>>(count).execute();
        let (sum, weights) = near.iter().fold((0.0, 0.0), |(sum, weights), n| {
            let weight = 1.0 / (n.distance + SOFT_PX * SOFT_PX);
            (sum + weight * points[n.item as usize][2], weights + weight)
        });
        sum / weights
    };
    let coarse: Vec<f32> = (0..columns * rows).into_par_iter().map(depth).collect();
    let at = |k: usize| coarse[(k / width / EVERY_PX) * columns + k % width / EVERY_PX];
    Grid::from_vec(width, height, (0..width * height).map(at).collect())
}
