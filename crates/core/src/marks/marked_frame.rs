//! Marked frames with a share for every pixel, and lookup of these shares from other frames.

use super::{
    Evidence, flow_to_marked::FlowToMarked, frame_splats::FrameSplats, looks::Looks, means::window_means,
    mix::Known, seeds::Seeds,
};
use crate::{
    flow::{Vector, around, halved, luma},
    grid::{Grid, Mask},
    num::finite_percentile,
    scene::Scene,
    sequence::DepthOrigin,
};
use image::RgbImage;
use rayon::prelude::*;
use std::{collections::BTreeSet, ops::Range};

/// Difference of luminance between a pixel and the one it is looked up from at which the likeness is one
/// half, 8-bit levels.
const HALF_LIKENESS: f32 = 8.0;
/// Difference of the logarithm of depth from that of the pixel it is looked up from, beyond the usual one of
/// the picture, at which the likeness is one half.
const HALF_DEPTH_LIKENESS: f32 = 0.05;
/// Every how many pixels the usual difference of depth is taken from.
const DEPTH_STEP: usize = 7;
/// Half the side of the windows in which pictures are compared, px of half size.
const COMPARED_PX: usize = 2;
/// Weight of pixels of a marked frame without a mark.
const UNMARKED_WEIGHT: f32 = 0.3;

/// A frame at half size, as it is compared with others.
#[derive(Clone)]
pub(super) struct HalfFrame {
    pub(super) luma: Grid<f32>,
    /// Logarithm of depth, NaN where there is none; `None` if none was measured.
    pub(super) log_depths: Option<Vec<f32>>,
}

impl HalfFrame {
    /// Takes a frame of a scene, with its picture.
    pub(super) fn of(scene: &Scene, frame: usize, picture: &RgbImage) -> Self {
        let is_measured = scene.provenance.depth.is_some_and(DepthOrigin::is_measured);
        let depth = is_measured.then(|| FrameSplats::at_half(scene, frame).depth());
        let logarithms = |depth: Vec<f32>| depth.into_iter().map(f32::ln).collect();
        Self { luma: luma_of(picture), log_depths: depth.map(logarithms) }
    }

    /// Returns the likeness of the depth of each pixel and of the one in `other` that its flow leads to, 0–1; 1
    /// where it is not known. What lies farther all over the picture is as deep: the scope has moved.
    fn depth_likeness(&self, other: &Self, flow: &Grid<Vector>) -> Option<Vec<f32>> {
        let (here, there) = (self.log_depths.as_ref()?, other.log_depths.as_ref()?);
        let farther = |i: usize| flow_target(flow, i).map_or(f32::NAN, |at| here[i] - there[at]);
        let farther: Vec<f32> = (0..here.len()).into_par_iter().with_min_len(4096).map(farther).collect();
        let usual = finite_percentile(farther.iter().copied().step_by(DEPTH_STEP), 50.0)?;
        let likeness = |farther: f32| match (farther - usual) / HALF_DEPTH_LIKENESS {
            apart if apart.is_nan() => 1.0,
            apart => 1.0 / (1.0 + apart * apart),
        };
        Some(farther.into_iter().map(likeness).collect())
    }
}

/// A marked frame, with a share for every pixel at half size.
pub(super) struct MarkedFrame {
    pub(super) half: HalfFrame,
    /// Flow from the frames around to this one.
    pub(super) flows: FlowToMarked,
    /// Shares segmented from its own marks and its guides, [names][pixels].
    pub(super) own_shares: Vec<Vec<f32>>,
    /// The same at full size, on the frame that was segmented last.
    pub(super) full_size_shares: Option<Vec<Vec<f32>>>,
    /// Own shares mixed with those of the nearest marked frames, once that was needed; `None` if there are
    /// none.
    pub(super) shares_with_neighbours: Option<Vec<Vec<f32>>>,
    /// Weight of each pixel: 1 if its label is decided by a mark.
    pub(super) weights: Vec<f32>,
    /// Names whose marks were propagated from other frames to this one, to its guides, to their guides and so on.
    pub(super) propagated_names: BTreeSet<usize>,
    /// For each name whether the frame knows it, by its own marks, by its guides or by propagation.
    pub(super) known_names: Vec<bool>,
    /// Looks of the names, once that was needed.
    pub(super) looks: Option<Looks>,
}

impl MarkedFrame {
    /// Returns the shares with those of the nearest marked frames, if these were needed; else its own.
    pub(super) fn shares(&self) -> &[Vec<f32>] {
        self.shares_with_neighbours.as_ref().unwrap_or(&self.own_shares)
    }

    /// Returns the weight of this frame at each pixel of another one, which `flow` leads from. `of` returns
    /// the weight where both look the same, from the weight of the pixel here.
    pub(super) fn lookup_weights(
        &self,
        flow: &Grid<Vector>,
        other: &HalfFrame,
        field_of_view: &Mask,
        of: impl Fn(f32) -> f32 + Sync,
    ) -> Grid<f32> {
        let mut weights = likeness(&other.luma, &self.half.luma, flow, field_of_view);
        if let Some(depth) = other.depth_likeness(&self.half, flow) {
            weights.data.iter_mut().zip(depth).for_each(|(weight, depth)| *weight *= depth);
        }
        weights.data.par_iter_mut().with_min_len(4096).enumerate().for_each(|(i, weight)| {
            *weight *= flow_target(flow, i).map_or(0.0, |at| of(self.weights[at]));
        });
        weights
    }

    /// Returns `true` if the frame knows all names.
    pub(super) fn knows_all_names(&self) -> bool {
        self.known_names.iter().all(|is_known| *is_known)
    }

    /// Returns how far the names are known. A marked pixel shows no name but those that marks say.
    pub(super) fn known(&self) -> Known {
        let names = self.known_names.clone();
        let share = |(i, weight): (usize, &f32)| {
            let is_marked = *weight > UNMARKED_WEIGHT;
            if is_marked { 1.0 } else { self.own_shares.iter().map(|plane| plane[i]).sum::<f32>().min(1.0) }
        };
        let has_others = !self.knows_all_names();
        let others = self.weights.iter().enumerate().filter(|_| has_others).map(share).collect();
        Known { names, others }
    }

    /// Adds the shares of this frame to the seeds of the Gaussians. Pixels outside the field of view do not
    /// count.
    pub(super) fn seed(&self, seeds: &mut Seeds, scene: &Scene, frame: usize) {
        let (width, height) = (self.half.luma.width, self.half.luma.height);
        let field_of_view = scene.field_of_view.sampled(width, height);
        let weight = |(w, inside): (&f32, &bool)| if *inside { *w } else { 0.0 };
        let weights: Vec<f32> = self.weights.iter().zip(&field_of_view.data).map(weight).collect();
        let known = self.known();
        let planes = |names: Range<usize>| {
            let plane = |name: usize| weights.iter().enumerate().map(move |(i, weight)| (name, i, weight));
            let each = || names.clone().flat_map(plane);
            let own = each().map(|(name, i, weight)| weight * known.of(name, i));
            (own.collect(), each().map(|(name, i, weight)| weight * self.own_shares[name][i]).collect())
        };
        seeds.add_pixels(scene, scene.cameras[frame].halved(), scene.time(frame), planes);
    }

    /// Mixes the shares of unmarked pixels with those of marked pixels of another frame, looked up along
    /// `flow`.
    pub(super) fn blend_neighbour(
        &self,
        shares: &mut [Vec<f32>],
        other: &Self,
        flow: &Grid<Vector>,
        field_of_view: &Mask,
    ) {
        let marked = |weight: f32| if weight > UNMARKED_WEIGHT { weight } else { 0.0 };
        let mut weights = other.lookup_weights(flow, &self.half, field_of_view, marked);
        weights.data.iter_mut().zip(&self.weights).for_each(|(w, own)| {
            *w = if *own > UNMARKED_WEIGHT { 0.0 } else { *w / (UNMARKED_WEIGHT + *w) };
        });
        shares.par_iter_mut().zip(&other.own_shares).for_each(|(plane, other)| {
            plane.iter_mut().zip(&weights.data).for_each(|(v, w)| *v *= 1.0 - w);
            add_looked_up(plane, other, flow, &weights);
        });
    }
}

/// Returns the luminance of a picture at half size, 0–255.
pub(super) fn luma_of(picture: &RgbImage) -> Grid<f32> {
    halved(&luma(picture))
}

/// Returns the weights of the pixels of a marked frame at half size, which is the size of `luma`.
pub(super) fn weights(evidence: &Evidence, luma: &Grid<f32>, full_width: usize) -> Vec<f32> {
    let mut weights = vec![UNMARKED_WEIGHT; luma.data.len()];
    for i in evidence.decided() {
        weights[at_half(i, full_width, [luma.width, luma.height])] = 1.0;
    }
    weights
}

/// Returns the pixel at half size that holds pixel `i` of a picture that is `full_width` wide.
pub(super) fn at_half(i: usize, full_width: usize, [width, height]: [usize; 2]) -> usize {
    let (x, y) = (i % full_width / 2, i / full_width / 2);
    y.min(height - 1) * width + x.min(width - 1)
}

/// Returns the first pixel, of a picture that is `full_width` wide, in pixel `i` of a picture at half size.
pub(super) fn at_full_size(i: usize, full_width: usize, half_width: usize) -> usize {
    2 * (i / half_width) * full_width + 2 * (i % half_width)
}

/// Returns the pixel that the flow of pixel `i` leads to, if it lies in the picture.
pub(super) fn flow_target(flow: &Grid<Vector>, i: usize) -> Option<usize> {
    let (width, height) = (flow.width, flow.height);
    let [x, y] = [(i % width) as f32 + flow.data[i][0], (i / width) as f32 + flow.data[i][1]];
    let is_inside = x >= -0.5 && y >= -0.5 && x < width as f32 - 0.5 && y < height as f32 - 0.5;
    is_inside.then(|| (y + 0.5) as usize * width + (x + 0.5) as usize)
}

/// Returns the likeness of a frame and another one, looked up along `flow`, around each pixel, 0–1; 0 where
/// the flow leads out of the field of view.
pub(super) fn likeness(
    luma: &Grid<f32>,
    other: &Grid<f32>,
    flow: &Grid<Vector>,
    field_of_view: &Mask,
) -> Grid<f32> {
    let (width, height) = (flow.width, flow.height);
    let field_of_view = field_of_view.sampled(width, height);
    let target = |i: usize| flow_target(flow, i).filter(|at| field_of_view.data.get(*at).is_none_or(|v| *v));
    let mut differences = vec![0.0; width * height];
    differences.par_iter_mut().with_min_len(4096).enumerate().for_each(|(i, d)| {
        *d = target(i).map_or(255.0, |at| (luma.data[i] - other.data[at]).abs());
    });
    let mut likeness = window_means(&differences, [width, height], COMPARED_PX);
    likeness.par_iter_mut().with_min_len(4096).enumerate().for_each(|(i, v)| {
        *v = if target(i).is_some() { 1.0 / (1.0 + (*v / HALF_LIKENESS).powi(2)) } else { 0.0 };
    });
    Grid::from_vec(width, height, likeness)
}

/// Adds weight · marked(x + flow) to every pixel x.
pub(super) fn add_looked_up(plane: &mut [f32], marked: &[f32], flow: &Grid<Vector>, weights: &Grid<f32>) {
    let width = flow.width;
    for (i, value) in plane.iter_mut().enumerate() {
        let [u, v] = flow.data[i];
        let target = [(i % width) as f32 + u, (i / width) as f32 + v];
        let (offsets, parts) = around(width, flow.height, target);
        let looked_up: f32 = offsets.iter().zip(parts).map(|(offset, part)| part * marked[*offset]).sum();
        *value += weights.data[i] * looked_up;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_lies_at_another_depth_is_looked_up_less() {
        let half = |log_depths: Option<Vec<f32>>| HalfFrame { luma: Grid::filled(20, 10, 90.0), log_depths };
        let still = Grid::filled(20, 10, [0.0; 2]);
        let there = half(Some(vec![2.0; 200]));
        // The scope came nearer. A tool lies before the first columns, and of the last one nothing is known.
        let depth = |i: usize| [1.2, 1.7, f32::NAN][usize::from(i % 20 > 3) + usize::from(i % 20 == 19)];
        let here = half(Some((0..200).map(depth).collect()));
        let likeness = here.depth_likeness(&there, &still).unwrap();
        assert!(likeness[2] < 0.02 && likeness[10] > 0.99 && likeness[19] == 1.0, "{:?}", &likeness[..20]);
        assert!(half(None).depth_likeness(&there, &still).is_none(), "nothing was measured");
    }
}
