//! The picture between two frames, as both tell it.

use super::{Vector, optical_flow, pyramid};
use crate::grid::Grid;
use image::{Rgb, RgbImage};

/// Colour in 8-bit levels, 0 to 255, with fractions.
pub type Colour = [f32; 3];

/// Two guesses at the picture between two frames, which do not see it.
#[derive(Clone, Debug, PartialEq)]
pub struct Between {
    /// Weighted mean of both frames; the nearer one weighs more.
    pub blend: RgbImage,
    /// The same of both frames, each moved by its share of the flow.
    pub moved: RgbImage,
}

/// Guesses at the picture that lies at `share` of the way from one frame to the next, 0 to 1. With a side
/// below 16 px nothing is moved. `None` if the sizes of the frames differ.
pub fn between(before: &RgbImage, after: &RgbImage, share: f32) -> Option<Between> {
    if before.dimensions() != after.dimensions() {
        return None;
    }
    let share = share.clamp(0.0, 1.0);
    let (before, after) = (colours(before), colours(after));
    let [from, to] = [&before, &after].map(|image| image.map(luminance));
    let (forth, back) = (optical_flow(&from, &to), optical_flow(&to, &from));
    Some(Between {
        blend: mean(&before, &after, share),
        moved: mean(&warp(&before, &forth, -share), &warp(&after, &back, share - 1.0), share),
    })
}

/// Moves an image against the flow: the result at x is the image at x + share · flow(x), interpolated
/// linearly, with the border repeated.
fn warp(image: &Grid<Colour>, flow: &Grid<Vector>, share: f32) -> Grid<Colour> {
    pyramid::each_pixel(flow.width, flow.height, |x, y| {
        let [u, v] = flow.at(x, y);
        pyramid::value_at(image, [x as f32 + share * u, y as f32 + share * v])
    })
}

/// Mean of two images in 8-bit levels; the second one weighs `share`.
fn mean(a: &Grid<Colour>, b: &Grid<Colour>, share: f32) -> RgbImage {
    RgbImage::from_fn(a.width as u32, a.height as u32, |x, y| {
        let (a, b) = (a.at(x as usize, y as usize), b.at(x as usize, y as usize));
        Rgb(std::array::from_fn(|k| (a[k] + share * (b[k] - a[k])).round() as u8))
    })
}

fn colours(image: &RgbImage) -> Grid<Colour> {
    let data = image.pixels().map(|pixel| pixel.0.map(f32::from)).collect();
    Grid::from_vec(image.width() as usize, image.height() as usize, data)
}

/// Luma of ITU-R BT.601, in 8-bit levels.
fn luminance([r, g, b]: &Colour) -> f32 {
    0.299 * r + 0.587 * g + 0.114 * b
}
