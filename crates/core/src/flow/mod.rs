//! Dense optical flow by dense inverse search (Kroeger et al. 2016, "Fast optical flow using dense inverse
//! search"), and the picture half way between two frames that it tells.
//!
//! Both images are halved again and again. From the coarsest size to the half, patches are searched
//! ([`search`]) and the flow that they agree on is refined ([`refine`]). The full size is left out, as in the
//! preset "medium" of OpenCV, whose settings these mostly are: patches that small follow the noise. Luminance
//! is in 8-bit levels, 0 to 255; the constants are in these units. Work is cut into rows or strips of fixed
//! size, so the same bytes come out for any number of threads.

mod between;
mod pyramid;
mod refine;
mod relax;
mod search;
#[cfg(test)]
mod tests;
mod ways;

pub use between::{Between, Colour, Timed, arriving, arriving_mask, between, ways_around};
pub(crate) use pyramid::{around, halved};
pub use ways::{joined, luma, mended};

use crate::grid::Grid;
use pyramid::PATCH;

/// Displacement in px, to the right and down.
pub type Vector = [f32; 2];

/// Shortest side of an image that is halved at least once, px.
const SHORTEST: usize = 2 * PATCH;

/// Computes the displacement of every pixel: `to` at x + flow(x) looks like `from` at x. Luminance is
/// 0 to 255; other values are clamped, NaN is 0. Images of two sizes, or with a side below 16 px, give zeros.
pub fn optical_flow(from: &Grid<f32>, to: &Grid<f32>) -> Grid<Vector> {
    coarse_to_fine(from, to, |from, to, start| refine::refined(from, to, search::searched(from, to, start)))
}

/// Computes [`optical_flow`] without its refinement, in 0.4 of the time. Things that part keep sharper
/// borders, so that what is carried along the flow over many frames stays where it belongs.
pub fn patch_flow(from: &Grid<f32>, to: &Grid<f32>) -> Grid<Vector> {
    coarse_to_fine(from, to, search::searched)
}

/// Computes a flow of a few px, at full size alone.
fn small_flow(from: &Grid<f32>, to: &Grid<f32>) -> Grid<Vector> {
    let still = Grid::filled(from.width, from.height, [0.0; 2]);
    if from.width.min(from.height) < SHORTEST { still } else { search::searched(from, to, &still) }
}

/// Computes a flow from the coarsest size to the half; `at` computes it at one size, near a given one.
fn coarse_to_fine(
    from: &Grid<f32>,
    to: &Grid<f32>,
    at: impl Fn(&Grid<f32>, &Grid<f32>, &Grid<Vector>) -> Grid<Vector> + Sync,
) -> Grid<Vector> {
    let (width, height) = (from.width, from.height);
    if (width, height) != (to.width, to.height) || width.min(height) < SHORTEST {
        return Grid::filled(width, height, [0.0; 2]);
    }
    // Its many short passes begin at once inside the pool.
    rayon::scope(|_| {
        let [from, to] = [from, to].map(pyramid::halvings);
        let still = Grid::filled(1, 1, [0.0; 2]);
        let half = from.iter().zip(&to).rev().fold(still, |coarse, (from, to)| {
            at(from, to, &pyramid::doubled(&coarse, from.width, from.height))
        });
        pyramid::doubled(&half, width, height)
    })
}
