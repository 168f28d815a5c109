//! The loss of one frame and its gradient with respect to the rendered planes (method §5).
//!
//! L = L_C + λ_D L_D + λ_TV (TV_C + TV_D) + λ_F (L_F + λ_TV TV_F + λ_RS RS), all terms inside the
//! supervision mask.

mod regions;
mod sums;
mod truth;

pub use truth::Truth;

use crate::{
    raster::{ALPHA_PLANE, DEPTH_PLANE, FEATURE_PLANE},
    real::Real,
};
use fearless_simd::{Simd, dispatch};
use fearless_simd_macros::simd;
use rayon::prelude::*;
use regions::Regions;
use std::ops::Range;
use sums::{STRIP_ROWS, lane_sum, sign};

/// Weights of the loss terms.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct LossWeights {
    /// Weight of |C − Ĉ| of colour.
    pub absolute: f32,
    /// Weight of (C − Ĉ)² of colour; colours are 0 to 1.
    pub square: f32,
    /// λ_D of the inverse-depth term.
    pub depth: f32,
    /// λ_TV of total variation of colour, depth and features.
    pub total_variation: f32,
    /// λ_F of all terms of the features.
    pub features: f32,
    /// λ_RS of region smoothness.
    pub region_smoothness: f32,
    /// Smallest region that is smoothed, px.
    pub min_region_px: usize,
    /// `true` for depth as in the released code: not divided by the accumulated opacity, inverted in
    /// scene units.
    pub raw_depth: bool,
    /// `true` for one mean over all channels of a region, as in the released code, instead of one for each.
    pub pooled_regions: bool,
    /// `true` for total variation of colour and features outside the mask too, as in the released code. That of
    /// depth stays inside.
    pub unmasked_variation: bool,
}

impl Default for LossWeights {
    fn default() -> Self {
        Self {
            absolute: 0.3,
            square: 10.0,
            depth: 1.0,
            total_variation: 0.01,
            features: 1.0,
            region_smoothness: 0.01,
            min_region_px: 1000,
            raw_depth: false,
            pooled_regions: false,
            unmasked_variation: false,
        }
    }
}

impl LossWeights {
    /// Adapts the weights to an image whose pixels are `spacing_px` pixels of the full-size image apart: its
    /// neighbours differ more, its regions have fewer pixels.
    pub fn sampled(&self, spacing_px: usize) -> Self {
        Self {
            total_variation: self.total_variation / spacing_px as f32,
            min_region_px: self.min_region_px.div_ceil(spacing_px * spacing_px),
            ..self.clone()
        }
    }
}

/// Number of terms of the loss.
pub const NUM_TERMS: usize = 5;

/// Value of each term, weighted, and their sum. The term of regions is the last; all others are sums over
/// pixels.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize)]
pub struct LossTerms<T> {
    /// L_C: absolute and squared differences of colour.
    pub colour: T,
    /// λ_D L_D.
    pub depth: T,
    /// Total variation of all planes.
    pub total_variation: T,
    /// λ_F L_F.
    pub features: T,
    /// λ_F λ_RS RS.
    pub region: T,
}

impl<T: Real> LossTerms<T> {
    /// Sum of all terms.
    pub fn total(&self) -> T {
        self.values().into_iter().sum()
    }

    /// Values of all terms, in their order.
    pub fn values(&self) -> [T; NUM_TERMS] {
        [self.colour, self.depth, self.total_variation, self.features, self.region]
    }

    /// Terms of these values, in their order.
    pub fn of([colour, depth, total_variation, features, region]: [T; NUM_TERMS]) -> Self {
        Self { colour, depth, total_variation, features, region }
    }

    /// Terms as people tell them apart: names and values.
    pub fn named(&self) -> [(&'static str, T); 4] {
        [
            ("colour", self.colour),
            ("depth", self.depth),
            ("words", self.features + self.region),
            ("smoothness", self.total_variation),
        ]
    }
}

/// Smallest accumulated opacity of a pixel whose depth is compared.
pub const MIN_LOSS_ALPHA: f64 = 0.5;
/// Smallest rendered depth (scene units) that counts: its inverse squared must fit into f32.
pub const MIN_LOSS_DEPTH: f64 = 1e-6;

/// Loss of `planes` (as [`crate::raster::Images`]) and ∂L/∂planes. A frame without supervised pixels has
/// loss 0.
pub fn loss<T: Real>(planes: &[T], truth: &Truth<'_>, weights: &LossWeights) -> (LossTerms<T>, Vec<T>) {
    let mut g = Vec::new();
    (loss_into(planes, truth, weights, &mut g), g)
}

/// Computes [`loss`] with the caller's memory for the gradient.
pub fn loss_into<T: Real>(
    planes: &[T],
    truth: &Truth<'_>,
    weights: &LossWeights,
    g: &mut Vec<T>,
) -> LossTerms<T> {
    let n = truth.width * truth.height;
    g.resize(planes.len(), T::zero());
    let mut terms = LossTerms::default();
    let supervised = truth.mask.iter().filter(|m| **m).count();
    if n == 0 || supervised == 0 {
        g.fill(T::zero());
        return terms;
    }
    let latent_dim = (planes.len() / n).saturating_sub(FEATURE_PLANE);
    let scales = TermScales::new(weights, supervised, n, latent_dim);
    let (g_colour, g_rest) = g.split_at_mut(DEPTH_PLANE * n);
    let (g_depth, g_features) = g_rest.split_at_mut((FEATURE_PLANE - DEPTH_PLANE) * n);
    let everywhere = if weights.unmasked_variation { vec![true; n] } else { Vec::new() };
    let variation_mask = if weights.unmasked_variation { &everywhere } else { truth.mask };
    for (channel, g) in g_colour.chunks_exact_mut(n).enumerate() {
        let plane = Plane::new(&planes[channel * n..(channel + 1) * n], variation_mask, truth.width);
        let bytes = &truth.colour[channel * n..(channel + 1) * n];
        let (difference, variation) = plane_terms(&plane, scales.colour, g, |y, out| {
            let (level, span) = (fearless_simd::Level::new(), plane.span(y));
            let row = (&plane.values[span.clone()], &truth.mask[span.clone()]);
            dispatch!(level, simd => byte_difference(simd, row, &bytes[span], out));
        });
        terms.colour += difference;
        terms.total_variation += variation;
    }
    depth_terms(planes, g_depth, truth, weights, scales.depth, &mut terms);
    if !truth.regions.is_empty() && !g_features.is_empty() {
        feature_terms(planes, g_features, truth, variation_mask, weights, &scales, &mut terms);
    } else {
        g_features.fill(T::zero());
    }
    terms
}

/// Weights per pixel of the two terms that every plane has.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Scales<T> {
    /// Weight of |here − wanted|.
    pub difference: T,
    /// Weight of (here − wanted)².
    pub square: T,
    /// Weight of |here − neighbour|.
    pub variation: T,
}

/// Factors of all sums over a frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TermScales<T> {
    /// Factors of each plane of colour.
    pub colour: Scales<T>,
    /// Factors of inverse depth.
    pub depth: Scales<T>,
    /// Factors of each plane of features.
    pub features: Scales<T>,
    /// Factor of a region's mean deviation in one plane.
    pub smoothness: T,
}

impl<T: Real> TermScales<T> {
    /// Factors for a frame of `pixels` pixels, of which `supervised` (> 0) are supervised.
    pub fn new(weights: &LossWeights, supervised: usize, pixels: usize, latent_dim: usize) -> Self {
        let over = |count: usize| T::one() / T::of(count.max(1) as f64);
        let per_neighbour = over(if weights.unmasked_variation { pixels } else { supervised });
        let (variation, third) = (T::from_f32(weights.total_variation), T::of(1.0 / 3.0));
        let features = T::from_f32(weights.features);
        let per_number = features * over(pixels * latent_dim);
        Self {
            colour: Scales {
                difference: T::from_f32(weights.absolute) * over(supervised) * third,
                square: T::from_f32(weights.square) * over(supervised) * third,
                variation: variation * per_neighbour * third,
            },
            depth: Scales {
                difference: T::from_f32(weights.depth) * over(supervised),
                square: T::zero(),
                variation: variation * over(supervised),
            },
            features: Scales { difference: per_number, square: T::zero(), variation: variation * per_number },
            smoothness: features * T::from_f32(weights.region_smoothness) * over(latent_dim),
        }
    }
}

/// A plane and the mask of the pixels that count.
#[derive(Clone, Copy)]
struct Plane<'a, T> {
    values: &'a [T],
    mask: &'a [bool],
    width: usize,
}

/// Values and mask of a row.
type MaskedRow<'a, T> = (&'a [T], &'a [bool]);

impl<'a, T: Real> Plane<'a, T> {
    fn new(values: &'a [T], mask: &'a [bool], width: usize) -> Self {
        Self { values, mask, width }
    }

    fn height(&self) -> usize {
        self.values.len() / self.width
    }

    fn span(&self, y: usize) -> Range<usize> {
        y * self.width..(y + 1) * self.width
    }

    fn row(&self, y: usize) -> MaskedRow<'a, T> {
        (&self.values[self.span(y)], &self.mask[self.span(y)])
    }
}

/// Σ scale·|plane − target| + scale·(plane − target)² and Σ scale·|x_i − x_j| over horizontal and vertical neighbours that both
/// count. Writes the gradient to `g`. `difference(y, out)` writes plane − target of row y, and 0 at
/// pixels that are not compared.
fn plane_terms<T: Real>(
    plane: &Plane<'_, T>,
    scales: Scales<T>,
    g: &mut [T],
    difference: impl Fn(usize, &mut [T]) + Sync,
) -> (T, T) {
    let level = fearless_simd::Level::new();
    let width = plane.width;
    let strips = g.par_chunks_mut(width * STRIP_ROWS).enumerate();
    let sums = strips.map(|(strip, g)| {
        let first = strip * STRIP_ROWS;
        let mut buffers = RowBuffers::new(width);
        if first > 0 {
            let above = &mut buffers.above;
            dispatch!(level, simd => masked_difference(simd, plane.row(first - 1), plane.row(first), above));
        }
        let mut sums = (T::zero(), T::zero());
        for (k, g) in g.chunks_exact_mut(width).enumerate() {
            difference(first + k, &mut buffers.difference);
            let next = (first + k + 1 < plane.height()).then(|| plane.row(first + k + 1));
            let (d, v) =
                dispatch!(level, simd => row_terms(simd, plane.row(first + k), next, &mut buffers, scales, g));
            sums = (sums.0 + d, sums.1 + v);
        }
        sums
    });
    let sums: Vec<(T, T)> = sums.collect();
    sums.into_iter().fold((T::zero(), T::zero()), |a, b| (a.0 + b.0, a.1 + b.1))
}

/// Differences of one row: to the target, to the right neighbour (with a leading 0), to the rows above
/// and below.
struct RowBuffers<T> {
    difference: Vec<T>,
    across: Vec<T>,
    above: Vec<T>,
    below: Vec<T>,
}

impl<T: Real> RowBuffers<T> {
    fn new(width: usize) -> Self {
        let zeros = || vec![T::zero(); width];
        Self { difference: zeros(), across: vec![T::zero(); width + 1], above: zeros(), below: zeros() }
    }
}

/// Weighted sums of one row, and its gradient. A pair of neighbours is counted by its left or upper pixel.
#[simd]
fn row_terms<S: Simd, T: Real>(
    simd: S,
    here: MaskedRow<'_, T>,
    next: Option<MaskedRow<'_, T>>,
    buffers: &mut RowBuffers<T>,
    scales: Scales<T>,
    g: &mut [T],
) -> (T, T) {
    let width = g.len();
    let RowBuffers { difference, across, above, below } = buffers;
    let left = (&here.0[..width - 1], &here.1[..width - 1]);
    masked_difference(simd, left, (&here.0[1..], &here.1[1..]), &mut across[1..width]);
    match next {
        Some(next) => masked_difference(simd, here, next, below),
        None => below.fill(T::zero()),
    }
    let twice_square = scales.square + scales.square;
    let neighbours = across[..width].iter().zip(&across[1..]).zip(above.iter().zip(below.iter()));
    for ((g, d), ((left, right), (above, below))) in g.iter_mut().zip(difference.iter()).zip(neighbours) {
        let pull = sign(*right) - sign(*left) + (sign(*below) - sign(*above));
        *g = sign(*d) * scales.difference + *d * twice_square + pull * scales.variation;
    }
    let of_difference = abs_sum(simd, difference) * scales.difference;
    let squares = lane_sum(simd, difference, |v| v * v) * scales.square;
    let of_variation = (abs_sum(simd, &across[1..]) + abs_sum(simd, below)) * scales.variation;
    std::mem::swap(above, below);
    (of_difference + squares, of_variation)
}

#[simd]
fn abs_sum<S: Simd, T: Real>(simd: S, values: &[T]) -> T {
    lane_sum(simd, values, |v| v.abs())
}

/// Writes a − b to `difference` where both masks are true, else 0.
#[simd]
fn masked_difference<S: Simd, T: Real>(_: S, a: MaskedRow<'_, T>, b: MaskedRow<'_, T>, difference: &mut [T]) {
    for ((d, (a, ma)), (b, mb)) in difference.iter_mut().zip(a.0.iter().zip(a.1)).zip(b.0.iter().zip(b.1)) {
        *d = if *ma & *mb { *a - *b } else { T::zero() };
    }
}

/// Writes a − b / 255 to `difference` where the mask is true, else 0.
#[simd]
fn byte_difference<S: Simd, T: Real>(_: S, a: MaskedRow<'_, T>, bytes: &[u8], difference: &mut [T]) {
    let byte = T::of(1.0 / 255.0);
    for ((d, (a, mask)), b) in difference.iter_mut().zip(a.0.iter().zip(a.1)).zip(bytes) {
        *d = if *mask { *a - T::from_f32(f32::from(*b)) * byte } else { T::zero() };
    }
}

/// Terms of inverse depth r = z̃ A / D (alpha-normalised, in units of the typical depth; or 1 / D): |r −
/// r̂| and its variation. `g` holds the planes of depth and alpha.
fn depth_terms<T: Real>(
    planes: &[T],
    g: &mut [T],
    truth: &Truth<'_>,
    weights: &LossWeights,
    scales: Scales<T>,
    terms: &mut LossTerms<T>,
) {
    if truth.depth.is_empty() || weights.depth == 0.0 {
        g.fill(T::zero());
        return;
    }
    let n = truth.width * truth.height;
    let typical = if weights.raw_depth { T::one() } else { T::from_f32(truth.typical_depth) };
    let (depth, alpha) = (&planes[DEPTH_PLANE * n..][..n], &planes[ALPHA_PLANE * n..][..n]);
    let (mut rendered, mut inverse) = (vec![false; n], vec![T::zero(); n]);
    let piece = truth.width * STRIP_ROWS;
    rendered.par_chunks_mut(piece).zip(inverse.par_chunks_mut(piece)).enumerate().for_each(
        |(k, (rendered, inverse))| {
            for (j, (rendered, inverse)) in rendered.iter_mut().zip(inverse).enumerate() {
                let i = k * piece + j;
                let opaque = weights.raw_depth || alpha[i] > T::of(MIN_LOSS_ALPHA);
                *rendered = truth.mask[i] && opaque && depth[i] > T::of(MIN_LOSS_DEPTH);
                let alpha = if weights.raw_depth { T::one() } else { alpha[i] };
                *inverse = if *rendered { typical * alpha / depth[i] } else { T::zero() };
            }
        },
    );
    let plane = Plane::new(&inverse, &rendered, truth.width);
    let (g_depth, g_alpha) = g.split_at_mut(n);
    // `g_alpha` holds the gradient of the inverse until it is split into those of depth and alpha.
    let (difference, variation) = plane_terms(&plane, scales, g_alpha, |y, out| {
        let (values, mask) = plane.row(y);
        let wanted = &truth.depth[plane.span(y)];
        for (((out, value), mask), z) in out.iter_mut().zip(values).zip(mask).zip(wanted) {
            *out = if *mask && *z > 0.0 { *value - typical / T::from_f32(*z) } else { T::zero() };
        }
    });
    terms.depth += difference;
    terms.total_variation += variation;
    g_depth.par_chunks_mut(piece).zip(g_alpha.par_chunks_mut(piece)).enumerate().for_each(
        |(k, (g_depth, g_alpha))| {
            for (j, (g_depth, g_alpha)) in g_depth.iter_mut().zip(g_alpha).enumerate() {
                let i = k * piece + j;
                let g_inverse = if rendered[i] { *g_alpha } else { T::zero() };
                let depth = if rendered[i] { depth[i] } else { T::one() };
                *g_depth = -g_inverse * inverse[i] / depth;
                *g_alpha = if weights.raw_depth { T::zero() } else { g_inverse * typical / depth };
            }
        },
    );
}

fn feature_terms<T: Real>(
    planes: &[T],
    g: &mut [T],
    truth: &Truth<'_>,
    variation_mask: &[bool],
    weights: &LossWeights,
    scales: &TermScales<T>,
    terms: &mut LossTerms<T>,
) {
    let n = truth.width * truth.height;
    let latent_dim = g.len() / n;
    let rows = truth.latents.len() / latent_dim.max(1);
    let regions = Regions::new(truth, rows, weights.min_region_px);
    for (d, g) in g.chunks_exact_mut(n).enumerate() {
        let plane = Plane::new(&planes[(FEATURE_PLANE + d) * n..][..n], variation_mask, truth.width);
        let wanted: Vec<T> = (0..rows).map(|r| T::from_f32(truth.latents[r * latent_dim + d])).collect();
        let (difference, variation) = plane_terms(&plane, scales.features, g, |y, out| {
            let (values, mask) = (plane.row(y).0, &truth.mask[plane.span(y)]);
            for (((out, value), mask), id) in
                out.iter_mut().zip(values).zip(mask).zip(&truth.regions[plane.span(y)])
            {
                // `NO_REGION` is beyond the end of the table.
                let wanted = wanted.get(usize::from(*id)).filter(|_| *mask);
                *out = wanted.map_or(T::zero(), |wanted| *value - *wanted);
            }
        });
        terms.features += difference;
        terms.total_variation += variation;
    }
    let values = &planes[FEATURE_PLANE * n..];
    terms.region += regions.smoothness(values, g, n, scales.smoothness, weights.pooled_regions);
}

#[cfg(test)]
mod tests;
