//! The picture between two frames, as both tell it.

use super::{Vector, optical_flow, pyramid};
use crate::grid::{Grid, Mask};
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

/// A frame and its time.
pub type Timed<'a> = (&'a RgbImage, f32);

/// Displacements, px, from the picture at `time` to the frame before and to the one after. Each point
/// follows the polynomial through its places in the frames, so that it may speed up and slow down; the
/// frames before the one before and after the one after are used if they are given. All frames have one
/// size, and their times rise.
pub fn ways_around(
    [before, after]: [Timed<'_>; 2],
    [earlier, later]: [Option<Timed<'_>>; 2],
    time: f32,
) -> [Grid<Vector>; 2] {
    let gray = |frame: Timed<'_>| colours(frame.0).map(luminance);
    let [near, far] = [gray(before), gray(after)];
    let size = (near.width, near.height);
    let to = |from: &Grid<f32>, to: Option<Timed<'_>>| match to {
        Some(frame) => even_flow(from, &gray(frame)),
        None => Grid::filled(size.0, size.1, [0.0; 2]),
    };
    let ((forth, back), (first, last)) = rayon::join(
        || rayon::join(|| even_flow(&near, &far), || even_flow(&far, &near)),
        || rayon::join(|| to(&near, earlier), || to(&far, later)),
    );
    let times = [earlier, Some(before), Some(after), later].map(|frame| frame.map(|f| f.1));
    let [first_weight, before_weight, after_weight, last_weight] = weights(times, time);
    [
        way((&forth, after_weight), (&first, first_weight), (&last, last_weight)),
        way((&back, before_weight), (&last, last_weight), (&first, first_weight)),
    ]
}

/// Optical flow that leans to no side. Patches and pixels are visited in order, from the upper left or the
/// lower right: the flow of the images turned by half a turn leans the other way, and this is the mean.
fn even_flow(from: &Grid<f32>, to: &Grid<f32>) -> Grid<Vector> {
    let turned = |image: &Grid<f32>| {
        Grid::from_vec(image.width, image.height, image.data.iter().rev().copied().collect())
    };
    let (upright, turned) =
        rayon::join(|| optical_flow(from, to), || optical_flow(&turned(from), &turned(to)));
    let mean = |(a, b): (&Vector, &Vector)| [0, 1].map(|k| (a[k] - b[k]) / 2.0);
    let data = upright.data.iter().zip(turned.data.iter().rev()).map(mean).collect();
    Grid::from_vec(upright.width, upright.height, data)
}

/// Weights of places at `times` in the place at `time` on the polynomial through them (Lagrange); 0 where
/// there is no time.
fn weights(times: [Option<f32>; 4], time: f32) -> [f32; 4] {
    let weight = |k: usize| {
        let others = (0..4).filter(|j| *j != k).filter_map(|j| times[j]);
        times[k].map_or(0.0, |own| others.map(|other| (time - other) / (own - other)).product())
    };
    [0, 1, 2, 3].map(weight)
}

/// Displacement from a time between two frames to one of them: minus the weighted sum of those from it to the
/// other one, to the frame behind itself, and to the frame beyond the other one, which is a flow from there.
/// The sum is known where points are in the frame, and is looked up there for points between.
fn way(
    (across, across_weight): (&Grid<Vector>, f32),
    (behind, behind_weight): (&Grid<Vector>, f32),
    (beyond, beyond_weight): (&Grid<Vector>, f32),
) -> Grid<Vector> {
    let from_frame = pyramid::each_pixel(across.width, across.height, |x, y| {
        let (here, behind) = (across.at(x, y), behind.at(x, y));
        let there = pyramid::value_at(beyond, [x as f32 + here[0], y as f32 + here[1]]);
        std::array::from_fn(|k| {
            -across_weight * here[k] - behind_weight * behind[k] - beyond_weight * (here[k] + there[k])
        })
    });
    pyramid::each_pixel(across.width, across.height, |x, y| {
        let [u, v] = from_frame.at(x, y);
        pyramid::value_at(&from_frame, [x as f32 + u, y as f32 + v])
    })
}

/// Returns the frame as it is seen where `way` leads from: at x its colour at x + way(x), in 8-bit levels.
pub fn arriving(frame: &RgbImage, way: &Grid<Vector>) -> Grid<Colour> {
    warp(&colours(frame), way, 1.0)
}

/// Returns the mask as it is seen where `way` leads from: `true` if it is at all pixels that the value at
/// x + way(x) is interpolated from.
pub fn arriving_mask(mask: &Mask, way: &Grid<Vector>) -> Mask {
    pyramid::each_pixel(way.width, way.height, |x, y| {
        let [u, v] = way.at(x, y);
        let (offsets, shares) = pyramid::around(mask.width, mask.height, [x as f32 + u, y as f32 + v]);
        offsets.iter().zip(shares).all(|(offset, share)| share == 0.0 || mask.data[*offset])
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
pub(super) fn luminance([r, g, b]: &Colour) -> f32 {
    0.299 * r + 0.587 * g + 0.114 * b
}
