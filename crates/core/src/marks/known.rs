//! Marked frames, and how other frames look them up.

use super::{Evidence, means::window_means, seeds::Seeds, trail::Trail};
use crate::{
    flow::{Vector, around},
    grid::{Grid, Mask},
    scene::Scene,
};
use rayon::prelude::*;
use std::{collections::BTreeSet, ops::Range};

/// Difference between a pixel and the marked one at which it weighs half, 8-bit levels.
const DIFFERENCE: f32 = 8.0;
/// Half the side of the squares in which pictures are compared, px of half size.
const COMPARED_PX: usize = 2;
/// Weight of pixels of a marked frame that are not marked themselves.
const UNMARKED: f32 = 0.3;

/// A marked frame at half size, with a share for every pixel.
pub(super) struct MarkedFrame {
    pub(super) luma: Grid<f32>,
    pub(super) trail: Trail,
    /// Shares as its own marks tell, [names][pixels].
    pub(super) own: Vec<Vec<f32>>,
    /// The same at full size, on the frame that became known last.
    pub(super) whole: Option<Vec<Vec<f32>>>,
    /// `own` with what the marks of the frames beside it tell, once that was asked; `None` if there are none.
    pub(super) told: Option<Vec<Vec<f32>>>,
    /// Weight of each pixel: 1 if it is marked.
    pub(super) weights: Vec<f32>,
    /// Names whose marks were carried here from other frames.
    pub(super) lent: BTreeSet<usize>,
    /// `true` if the frame knows of all names, by its own marks or by what was told or lent; else it does not
    /// know what is left.
    pub(super) is_whole: bool,
}

impl MarkedFrame {
    /// Shares with what the frames beside it tell, if that was asked.
    pub(super) fn told(&self) -> &[Vec<f32>] {
        self.told.as_ref().unwrap_or(&self.own)
    }

    /// Weight of this frame at each pixel of another one, from where `way` leads here; `of` is that of a pixel
    /// here if both look the same.
    pub(super) fn weights_along(
        &self,
        way: &Grid<Vector>,
        luma: &Grid<f32>,
        field_of_view: &Mask,
        of: impl Fn(f32) -> f32 + Sync,
    ) -> Grid<f32> {
        let mut weights = likeness(luma, &self.luma, way, field_of_view);
        weights.data.par_iter_mut().with_min_len(4096).enumerate().for_each(|(i, weight)| {
            *weight *= place(way, i).map_or(0.0, |at| of(self.weights[at]));
        });
        weights
    }

    /// Returns the part of each pixel that is known: what is left may show names that the frame does not know.
    pub(super) fn sure(&self) -> Vec<f32> {
        let known = |(i, weight): (usize, &f32)| {
            let is_known = self.is_whole || *weight > UNMARKED;
            if is_known { 1.0 } else { self.own.iter().map(|plane| plane[i]).sum::<f32>().min(1.0) }
        };
        self.weights.iter().enumerate().map(known).collect()
    }

    /// Adds what this frame tells of the Gaussians. Pixels outside the field of view tell nothing.
    pub(super) fn seed(&self, seeds: &mut Seeds, scene: &Scene, frame: usize) {
        let (width, height) = (self.luma.width, self.luma.height);
        let field_of_view = scene.field_of_view.sampled(width, height);
        let weight = |(w, inside): (&f32, &bool)| if *inside { *w } else { 0.0 };
        let weights: Vec<f32> = self.weights.iter().zip(&field_of_view.data).map(weight).collect();
        let sure: Vec<f32> = weights.iter().zip(self.sure()).map(|(weight, sure)| weight * sure).collect();
        let planes = |names: Range<usize>| {
            let shares = self.own[names.clone()].iter().flat_map(|plane| plane.iter().zip(&weights));
            (sure.repeat(names.len()), shares.map(|(share, weight)| share * weight).collect())
        };
        let camera = scene.cameras[frame].resized(width as u32, height as u32);
        seeds.add_pixels(scene, camera, scene.time(frame), planes);
    }

    /// Mixes the shares of unmarked pixels with those of marked pixels of another frame, looked up along
    /// `way`.
    pub(super) fn hear(
        &self,
        shares: &mut [Vec<f32>],
        other: &Self,
        way: &Grid<Vector>,
        field_of_view: &Mask,
    ) {
        let marked = |weight: f32| if weight > UNMARKED { weight } else { 0.0 };
        let mut weights = other.weights_along(way, &self.luma, field_of_view, marked);
        weights.data.iter_mut().zip(&self.weights).for_each(|(w, own)| {
            *w = if *own > UNMARKED { 0.0 } else { *w / (UNMARKED + *w) };
        });
        shares.par_iter_mut().zip(&other.own).for_each(|(plane, other)| {
            plane.iter_mut().zip(&weights.data).for_each(|(v, w)| *v *= 1.0 - w);
            add_seen(plane, other, way, &weights);
        });
    }
}

/// Returns the weights of the pixels of a marked frame at half size; `luma` is its luminance there.
pub(super) fn weights(evidence: &Evidence, luma: &Grid<f32>, whole_width: usize) -> Vec<f32> {
    let mut weights = vec![UNMARKED; luma.data.len()];
    for i in evidence.settled() {
        weights[at_half(i, whole_width, luma)] = 1.0;
    }
    weights
}

/// Returns the pixel of half size that holds pixel `i` of a picture that is `whole_width` wide.
pub(super) fn at_half(i: usize, whole_width: usize, half: &Grid<f32>) -> usize {
    let (x, y) = (i % whole_width / 2, i / whole_width / 2);
    y.min(half.height - 1) * half.width + x.min(half.width - 1)
}

/// Returns the first of the pixels, of a picture that is `whole_width` wide, in pixel `i` of half size.
pub(super) fn at_whole(i: usize, whole_width: usize, half: &Grid<f32>) -> usize {
    2 * (i / half.width) * whole_width + 2 * (i % half.width)
}

/// Returns the pixel that the way of pixel `i` leads to, if that is in the picture.
pub(super) fn place(way: &Grid<Vector>, i: usize) -> Option<usize> {
    let (width, height) = (way.width, way.height);
    let [x, y] = [(i % width) as f32 + way.data[i][0], (i / width) as f32 + way.data[i][1]];
    let is_inside = x >= -0.5 && y >= -0.5 && x < width as f32 - 0.5 && y < height as f32 - 0.5;
    is_inside.then(|| (y + 0.5) as usize * width + (x + 0.5) as usize)
}

/// Likeness of a frame and another one, seen along `way`, around each pixel, 0–1; 0 where the way leads out
/// of the field of view.
pub(super) fn likeness(
    luma: &Grid<f32>,
    other: &Grid<f32>,
    way: &Grid<Vector>,
    field_of_view: &Mask,
) -> Grid<f32> {
    let (width, height) = (way.width, way.height);
    let field_of_view = field_of_view.sampled(width, height);
    let seen = |i: usize| place(way, i).filter(|at| field_of_view.data.get(*at).is_none_or(|v| *v));
    let mut differences = vec![0.0; width * height];
    differences.par_iter_mut().with_min_len(4096).enumerate().for_each(|(i, d)| {
        *d = seen(i).map_or(255.0, |at| (luma.data[i] - other.data[at]).abs());
    });
    let mut likeness = window_means(&differences, [width, height], COMPARED_PX);
    likeness.par_iter_mut().with_min_len(4096).enumerate().for_each(|(i, v)| {
        *v = if seen(i).is_some() { 1.0 / (1.0 + (*v / DIFFERENCE).powi(2)) } else { 0.0 };
    });
    Grid::from_vec(width, height, likeness)
}

/// Adds weight · marked(x + way) to every pixel x.
pub(super) fn add_seen(plane: &mut [f32], marked: &[f32], way: &Grid<Vector>, weights: &Grid<f32>) {
    let width = way.width;
    for (i, value) in plane.iter_mut().enumerate() {
        let [u, v] = way.data[i];
        let place = [(i % width) as f32 + u, (i / width) as f32 + v];
        let (offsets, parts) = around(width, way.height, place);
        let seen: f32 = offsets.iter().zip(parts).map(|(offset, part)| part * marked[*offset]).sum();
        *value += weights.data[i] * seen;
    }
}
