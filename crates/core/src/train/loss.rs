//! The loss of one frame and its gradient with respect to the rendered planes (method §5).
//!
//! L = L_C + λ_D L_D + λ_TV (TV_C + TV_D) + λ_F (L_F + λ_TV TV_F + λ_RS RS), all terms inside the supervision mask.

use crate::{
    raster::{ALPHA_PLANE, DEPTH_PLANE, FEATURE_PLANE},
    real::Real,
};
use fearless_simd::{Simd, dispatch};
use fearless_simd_macros::simd;
use rayon::prelude::*;
use std::ops::Range;

/// Weights of the loss terms.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct LossWeights {
    /// λ_D of the inverse-depth term.
    pub depth: f32,
    /// λ_TV of total variation of colour, depth and features.
    pub total_variation: f32,
    /// λ_F of everything about features.
    pub features: f32,
    /// λ_RS of region smoothness.
    pub region_smoothness: f32,
    /// Regions with fewer pixels are not smoothed.
    pub min_region_px: usize,
    /// Depth as the released code has it: not divided by the accumulated opacity, inverted in scene units.
    pub raw_depth: bool,
    /// One mean over all channels of a region, as in the released code, instead of one for each.
    pub pooled_regions: bool,
    /// Total variation outside the mask too, as in the released code.
    pub unmasked_variation: bool,
}

impl Default for LossWeights {
    fn default() -> Self {
        Self {
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
    /// For an image of which every `step`-th pixel is there: neighbours differ the more, regions have fewer pixels.
    pub fn sampled(&self, step: usize) -> Self {
        Self {
            total_variation: self.total_variation / step as f32,
            min_region_px: self.min_region_px.div_ceil(step * step),
            ..self.clone()
        }
    }
}

/// What a frame is compared to.
#[derive(Clone, Copy, Debug)]
pub struct Truth<'a> {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// r, g, b, plane after plane, 0–255.
    pub colour: &'a [u8],
    /// `true` = supervise.
    pub mask: &'a [bool],
    /// z in scene units, 0 where unknown; empty if there is no depth.
    pub depth: &'a [f32],
    /// Latent table row per pixel, [`crate::prepare::NO_REGION`] where none; empty if there are no features.
    pub regions: &'a [u16],
    /// [rows][D].
    pub latents: &'a [f32],
    /// Typical depth (scene units): makes the inverse-depth term free of units.
    pub typical_depth: f32,
}

/// Value of each term, weighted, and their sum.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize)]
pub struct LossTerms<T> {
    /// L_C.
    pub colour: T,
    /// λ_D L_D.
    pub depth: T,
    /// All total variation.
    pub total_variation: T,
    /// λ_F L_F.
    pub features: T,
    /// λ_F λ_RS RS.
    pub region: T,
}

impl<T: Real> LossTerms<T> {
    /// The loss.
    pub fn total(&self) -> T {
        self.colour + self.depth + self.total_variation + self.features + self.region
    }
}

/// Accumulated opacity below which a pixel has no depth worth comparing.
const MIN_DEPTH_ALPHA: f64 = 0.5;
/// Rendered depth (scene units) below which there is none: its inverse squared must stay in f32.
const MIN_DEPTH: f64 = 1e-6;

/// The loss of `planes` (as [`crate::raster::Images`]) and ∂L/∂planes. A frame without supervised pixels has loss 0.
pub fn loss<T: Real>(planes: &[T], truth: &Truth<'_>, weights: &LossWeights) -> (LossTerms<T>, Vec<T>) {
    let mut g = Vec::new();
    (loss_into(planes, truth, weights, &mut g), g)
}

/// As [`loss`], with the memory for the gradient from outside.
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
    let per_pixel = T::one() / T::of(supervised as f64);
    let (g_colour, g_rest) = g.split_at_mut(DEPTH_PLANE * n);
    let (g_depth, g_features) = g_rest.split_at_mut((FEATURE_PLANE - DEPTH_PLANE) * n);
    let everywhere = if weights.unmasked_variation { vec![true; n] } else { Vec::new() };
    let variation_mask = if weights.unmasked_variation { &everywhere } else { truth.mask };
    let per_neighbour = if weights.unmasked_variation { T::one() / T::of(n as f64) } else { per_pixel };
    let scales = Scales {
        difference: per_pixel * T::of(1.0 / 3.0),
        variation: T::from_f32(weights.total_variation) * per_neighbour * T::of(1.0 / 3.0),
    };
    for (channel, g) in g_colour.chunks_exact_mut(n).enumerate() {
        let plane = Plane::new(&planes[channel * n..(channel + 1) * n], variation_mask, truth.width);
        let bytes = &truth.colour[channel * n..(channel + 1) * n];
        let (difference, variation) = plane_terms(&plane, scales, g, |y, out| {
            let (level, span) = (fearless_simd::Level::new(), plane.span(y));
            let row = (&plane.values[span.clone()], &truth.mask[span.clone()]);
            dispatch!(level, simd => byte_difference(simd, row, &bytes[span], out));
        });
        terms.colour += difference;
        terms.total_variation += variation;
    }
    depth_terms(planes, g_depth, truth, weights, per_pixel, &mut terms);
    if !truth.regions.is_empty() && !g_features.is_empty() {
        feature_terms(planes, g_features, truth, variation_mask, weights, &mut terms);
    } else {
        g_features.fill(T::zero());
    }
    terms
}

/// Weights per pixel of the two terms that every plane has.
#[derive(Clone, Copy)]
struct Scales<T> {
    difference: T,
    variation: T,
}

/// A plane and where it counts.
#[derive(Clone, Copy)]
struct Plane<'a, T> {
    values: &'a [T],
    mask: &'a [bool],
    width: usize,
}

/// Values and mask of a row.
type Row<'a, T> = (&'a [T], &'a [bool]);

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

    fn row(&self, y: usize) -> Row<'a, T> {
        (&self.values[self.span(y)], &self.mask[self.span(y)])
    }
}

/// Rows per parallel piece; partial sums are added piece by piece, so that the thread count does not matter.
const STRIP_ROWS: usize = 16;

/// Σ scale·|plane − target| and Σ scale·|x_i − x_j| over horizontal and vertical neighbours that both count; `g` becomes
/// the gradient. `difference(y, out)` writes plane − target of row y, 0 where that is not compared.
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
    let total = sums.into_iter().fold((T::zero(), T::zero()), |a, b| (a.0 + b.0, a.1 + b.1));
    (total.0 * scales.difference, total.1 * scales.variation)
}

/// Differences of one row: to the target, to the right neighbour (with a leading 0), to the rows above and below.
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

/// Sums of one row, and its gradient; a pair of neighbours is counted by its left or upper pixel.
#[simd]
fn row_terms<S: Simd, T: Real>(
    simd: S,
    here: Row<'_, T>,
    next: Option<Row<'_, T>>,
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
    let neighbours = across[..width].iter().zip(&across[1..]).zip(above.iter().zip(below.iter()));
    for ((g, d), ((left, right), (above, below))) in g.iter_mut().zip(difference.iter()).zip(neighbours) {
        let pull = sign(*right) - sign(*left) + (sign(*below) - sign(*above));
        *g = sign(*d) * scales.difference + pull * scales.variation;
    }
    let sums = (abs_sum(simd, difference), abs_sum(simd, &across[1..]) + abs_sum(simd, below));
    std::mem::swap(above, below);
    sums
}

/// 0 at 0, unlike `signum`; written so that it vectorises.
fn sign<T: Real>(v: T) -> T {
    let one = |yes: bool| if yes { T::one() } else { T::zero() };
    one(v > T::zero()) - one(v < T::zero())
}

/// Σ f(v), in 16 lanes so that it vectorises.
#[simd]
fn lane_sum<S: Simd, T: Real, F: Fn(T) -> T>(_: S, values: &[T], f: F) -> T {
    let (chunks, rest) = values.as_chunks::<16>();
    let mut lanes = [T::zero(); 16];
    for chunk in chunks {
        for (lane, v) in lanes.iter_mut().zip(chunk) {
            *lane += f(*v);
        }
    }
    lanes.into_iter().chain(rest.iter().map(|v| f(*v))).sum()
}

#[simd]
fn abs_sum<S: Simd, T: Real>(simd: S, values: &[T]) -> T {
    lane_sum(simd, values, |v| v.abs())
}

/// `difference` becomes a − b where both masks are true, else 0.
#[simd]
fn masked_difference<S: Simd, T: Real>(_: S, a: Row<'_, T>, b: Row<'_, T>, difference: &mut [T]) {
    for ((d, (a, ma)), (b, mb)) in difference.iter_mut().zip(a.0.iter().zip(a.1)).zip(b.0.iter().zip(b.1)) {
        *d = if *ma & *mb { *a - *b } else { T::zero() };
    }
}

/// `difference` becomes a − b / 255 where the mask is true, else 0.
#[simd]
fn byte_difference<S: Simd, T: Real>(_: S, a: Row<'_, T>, bytes: &[u8], difference: &mut [T]) {
    let byte = T::of(1.0 / 255.0);
    for ((d, (a, mask)), b) in difference.iter_mut().zip(a.0.iter().zip(a.1)).zip(bytes) {
        *d = if *mask { *a - T::from_f32(f32::from(*b)) * byte } else { T::zero() };
    }
}

/// Inverse depth r = z̃ A / D (alpha-normalised, in units of the typical depth; or 1 / D): |r − r̂| and its variation.
/// `g` holds the planes of depth and alpha.
fn depth_terms<T: Real>(
    planes: &[T],
    g: &mut [T],
    truth: &Truth<'_>,
    weights: &LossWeights,
    per_pixel: T,
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
                let opaque = weights.raw_depth || alpha[i] > T::of(MIN_DEPTH_ALPHA);
                *rendered = truth.mask[i] && opaque && depth[i] > T::of(MIN_DEPTH);
                let alpha = if weights.raw_depth { T::one() } else { alpha[i] };
                *inverse = if *rendered { typical * alpha / depth[i] } else { T::zero() };
            }
        },
    );
    let scales = Scales {
        difference: T::from_f32(weights.depth) * per_pixel,
        variation: T::from_f32(weights.total_variation) * per_pixel,
    };
    let plane = Plane::new(&inverse, &rendered, truth.width);
    let (g_depth, g_alpha) = g.split_at_mut(n);
    // The gradient of the inverse, until it is taken apart.
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
    terms: &mut LossTerms<T>,
) {
    let n = truth.width * truth.height;
    let latent_dim = g.len() / n;
    let all = T::of((n * latent_dim) as f64);
    let weight = T::from_f32(weights.features);
    let rows = truth.latents.len() / latent_dim.max(1);
    let regions = Regions::new(truth, rows, weights.min_region_px);
    let scales =
        Scales { difference: weight / all, variation: weight * T::from_f32(weights.total_variation) / all };
    let smoothness = weight * T::from_f32(weights.region_smoothness) / T::of(latent_dim as f64);
    for (d, g) in g.chunks_exact_mut(n).enumerate() {
        let plane = Plane::new(&planes[(FEATURE_PLANE + d) * n..][..n], variation_mask, truth.width);
        let wanted: Vec<T> = (0..rows).map(|r| T::from_f32(truth.latents[r * latent_dim + d])).collect();
        let (difference, variation) = plane_terms(&plane, scales, g, |y, out| {
            let (values, mask) = (plane.row(y).0, &truth.mask[plane.span(y)]);
            for (((out, value), mask), id) in
                out.iter_mut().zip(values).zip(mask).zip(&truth.regions[plane.span(y)])
            {
                // `NO_REGION` is beyond the table.
                let wanted = wanted.get(usize::from(*id)).filter(|_| *mask);
                *out = wanted.map_or(T::zero(), |wanted| *value - *wanted);
            }
        });
        terms.features += difference;
        terms.total_variation += variation;
    }
    let values = &planes[FEATURE_PLANE * n..];
    terms.region += regions.smoothness(values, g, n, smoothness, weights.pooled_regions);
}

/// Neighbouring pixels of a row that belong to the same region.
struct Run {
    start: usize,
    len: usize,
    region: usize,
}

/// The pixels of the regions that are large enough to be smoothed.
struct Regions<T> {
    /// Pixels per strip.
    strip: usize,
    /// 1 / pixels of each region; 0 for regions that are left alone.
    share: Vec<T>,
    /// Supervised runs, strip by strip; starts count from the strip's first pixel.
    runs: Vec<Vec<Run>>,
}

impl<T: Real> Regions<T> {
    fn new(truth: &Truth<'_>, rows: usize, min_px: usize) -> Self {
        let strip = truth.width * STRIP_ROWS;
        let strips = truth.regions.par_chunks(strip).zip(truth.mask.par_chunks(strip));
        let mut runs: Vec<Vec<Run>> = strips.map(|(ids, mask)| runs_of(ids, mask, rows)).collect();
        let mut counts = vec![0; rows];
        runs.iter().flatten().for_each(|run| counts[run.region] += run.len);
        let is_large = |region: usize| counts[region] >= min_px.max(1);
        runs.iter_mut().for_each(|strip| strip.retain(|run| is_large(run.region)));
        let share = (0..rows).map(|r| if is_large(r) { T::of(1.0 / counts[r] as f64) } else { T::zero() });
        Self { strip, share: share.collect(), runs }
    }

    /// Means over each region of what `sum` adds up over a run, summed strip by strip.
    fn means<const K: usize>(&self, values: &[T], sum: impl Fn(&[T], usize) -> [T; K] + Sync) -> Vec<[T; K]> {
        let strips = values.par_chunks(self.strip).zip(&self.runs);
        let partial: Vec<Vec<[T; K]>> = strips
            .map(|(values, runs)| {
                let mut sums = vec![[T::zero(); K]; self.share.len()];
                for run in runs {
                    let added = sum(&values[run.start..run.start + run.len], run.region);
                    sums[run.region].iter_mut().zip(added).for_each(|(total, v)| *total += v);
                }
                sums
            })
            .collect();
        let mean = |r: usize, k: usize| partial.iter().map(|p| p[r][k]).sum::<T>() * self.share[r];
        (0..self.share.len()).map(|r| std::array::from_fn(|k| mean(r, k))).collect()
    }

    /// RS of the feature planes: Σ over large regions of the mean |F − region mean|, the gradient also through the mean.
    fn smoothness(&self, planes: &[T], g: &mut [T], n: usize, scale: T, pooled: bool) -> T {
        let level = fearless_simd::Level::new();
        let of_plane = |plane: &[T]| {
            let means = self.means(plane, |run, _| [dispatch!(level, simd => lane_sum(simd, run, |v| v))]);
            means.into_iter().map(|[mean]| mean).collect::<Vec<T>>()
        };
        let mut means: Vec<Vec<T>> = planes.chunks_exact(n).map(of_plane).collect();
        if pooled {
            pool(&mut means);
        }
        let of_plane = |(plane, means): (&[T], &Vec<T>)| {
            self.means(plane, |run, r| dispatch!(level, simd => deviation_sums(simd, run, means[r])))
        };
        // Means of |F − mean| and of its sign, which is how the loss pulls at the mean.
        let spreads: Vec<Vec<[T; 2]>> = planes.chunks_exact(n).zip(&means).map(of_plane).collect();
        let mut pulls: Vec<Vec<T>> =
            spreads.iter().map(|s| s.iter().map(|[_, sign]| *sign).collect()).collect();
        if pooled {
            pool(&mut pulls);
        }
        for (((plane, g), means), pulls) in
            planes.chunks_exact(n).zip(g.chunks_exact_mut(n)).zip(&means).zip(&pulls)
        {
            let strips = g.par_chunks_mut(self.strip).zip(plane.par_chunks(self.strip)).zip(&self.runs);
            strips.for_each(|((g, values), runs)| {
                for run in runs {
                    let (at, r) = (run.start..run.start + run.len, run.region);
                    let (values, g) = (&values[at.clone()], &mut g[at]);
                    let factor = scale * self.share[r];
                    dispatch!(level, simd => add_deviation_signs(simd, values, means[r], pulls[r], factor, g));
                }
            });
        }
        spreads.into_iter().flatten().map(|[spread, _]| spread).sum::<T>() * scale
    }
}

/// Replaces each region's value by its mean over the planes.
fn pool<T: Real>(planes: &mut [Vec<T>]) {
    let count = T::of(planes.len() as f64);
    for region in 0..planes.first().map_or(0, Vec::len) {
        let mean = planes.iter().map(|p| p[region]).sum::<T>() / count;
        planes.iter_mut().for_each(|p| p[region] = mean);
    }
}

/// Supervised runs of regions below `rows`.
fn runs_of(ids: &[u16], mask: &[bool], rows: usize) -> Vec<Run> {
    let mut runs = Vec::new();
    let mut start = 0;
    while start < ids.len() {
        let (id, supervised) = (ids[start], mask[start]);
        let same = |i: &usize| ids[*i] == id && mask[*i] == supervised;
        let end = (start + 1..ids.len()).find(|i| !same(i)).unwrap_or(ids.len());
        if supervised && usize::from(id) < rows {
            runs.push(Run { start, len: end - start, region: usize::from(id) });
        }
        start = end;
    }
    runs
}

/// Σ |v − mean| and Σ sign(v − mean).
#[simd]
fn deviation_sums<S: Simd, T: Real>(simd: S, values: &[T], mean: T) -> [T; 2] {
    [lane_sum(simd, values, |v| (v - mean).abs()), lane_sum(simd, values, |v| sign(v - mean))]
}

/// g += (sign(v − mean) − mean_sign) · factor.
#[simd]
fn add_deviation_signs<S: Simd, T: Real>(_: S, values: &[T], mean: T, mean_sign: T, factor: T, g: &mut [T]) {
    for (g, v) in g.iter_mut().zip(values) {
        *g += (sign(*v - mean) - mean_sign) * factor;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::prepare::NO_REGION;
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    const WIDTH: usize = 7;
    const HEIGHT: usize = 6;
    const N: usize = WIDTH * HEIGHT;

    struct Fixture {
        colour: Vec<u8>,
        mask: Vec<bool>,
        depth: Vec<f32>,
        regions: Vec<u16>,
        latents: Vec<f32>,
        planes: Vec<f64>,
    }

    fn fixture() -> Fixture {
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let mut planes: Vec<f64> = (0..8 * N).map(|_| rng.random_range(0.1..0.9)).collect();
        for i in 0..N {
            planes[ALPHA_PLANE * N + i] = rng.random_range(0.6..1.0);
            planes[DEPTH_PLANE * N + i] = rng.random_range(20.0..60.0);
        }
        Fixture {
            colour: (0..3 * N).map(|_| rng.random_range(0..255)).collect(),
            mask: (0..N).map(|i| i % 5 != 2).collect(),
            depth: (0..N).map(|i| if i % 4 == 0 { 0.0 } else { rng.random_range(20.0..60.0) }).collect(),
            regions: (0..N).map(|i| if i % 9 == 0 { NO_REGION } else { (i % 3) as u16 }).collect(),
            latents: (0..9).map(|_| rng.random_range(-1.0..1.0)).collect(),
            planes,
        }
    }

    impl Fixture {
        fn truth(&self) -> Truth<'_> {
            Truth {
                width: WIDTH,
                height: HEIGHT,
                colour: &self.colour,
                mask: &self.mask,
                depth: &self.depth,
                regions: &self.regions,
                latents: &self.latents,
                typical_depth: 40.0,
            }
        }
    }

    #[test]
    fn every_term_matches_finite_differences() {
        let f = fixture();
        let none = LossWeights {
            depth: 0.0,
            total_variation: 0.0,
            features: 0.0,
            region_smoothness: 0.0,
            min_region_px: 5,
            ..LossWeights::default()
        };
        let all = LossWeights {
            depth: 1.0,
            total_variation: 0.3,
            features: 1.0,
            region_smoothness: 0.5,
            min_region_px: 5,
            ..LossWeights::default()
        };
        for weights in [
            none.clone(),
            LossWeights { depth: 1.0, ..none.clone() },
            LossWeights { total_variation: 0.3, ..none.clone() },
            LossWeights { features: 1.0, ..none.clone() },
            LossWeights { features: 1.0, region_smoothness: 1.0, ..none.clone() },
            LossWeights { depth: 1.0, total_variation: 0.3, raw_depth: true, ..none.clone() },
            LossWeights { features: 1.0, region_smoothness: 1.0, pooled_regions: true, ..none.clone() },
            LossWeights { features: 1.0, total_variation: 0.3, unmasked_variation: true, ..none },
            all,
        ] {
            let (_, g) = loss(&f.planes, &f.truth(), &weights);
            for i in 0..f.planes.len() {
                let at = |h: f64| {
                    let mut planes = f.planes.clone();
                    planes[i] += h;
                    loss(&planes, &f.truth(), &weights).0.total()
                };
                let h = 1e-7;
                let numeric = (at(h) - at(-h)) / (2.0 * h);
                assert!((g[i] - numeric).abs() < 1e-6, "value {i}: {} against {numeric}, {weights:?}", g[i]);
            }
        }
    }

    #[test]
    fn a_perfect_picture_of_flat_regions_costs_nothing() {
        let mut f = fixture();
        f.colour = vec![51; 3 * N];
        for c in 0..3 {
            f.planes[c * N..(c + 1) * N].fill(0.2);
        }
        f.depth = vec![40.0; N];
        f.planes[DEPTH_PLANE * N..(DEPTH_PLANE + 1) * N].fill(40.0);
        f.planes[ALPHA_PLANE * N..(ALPHA_PLANE + 1) * N].fill(1.0);
        f.regions = vec![1; N];
        for d in 0..3 {
            f.planes[(FEATURE_PLANE + d) * N..][..N].fill(f64::from(f.latents[3 + d]));
        }
        let (terms, g) =
            loss(&f.planes, &f.truth(), &LossWeights { min_region_px: 5, ..LossWeights::default() });
        assert!(terms.total().abs() < 1e-9, "{terms:?}");
        assert!(g.iter().all(|v| v.abs() < 1e-9 || v.is_finite()));
    }

    #[test]
    fn what_is_masked_out_has_no_gradient() {
        let f = fixture();
        let (_, g) = loss(&f.planes, &f.truth(), &LossWeights::default());
        for (k, v) in g.iter().enumerate() {
            assert!(f.mask[k % N] || *v == 0.0, "plane {} pixel {}", k / N, k % N);
        }
        let empty = vec![false; N];
        let (terms, g) = loss(&f.planes, &Truth { mask: &empty, ..f.truth() }, &LossWeights::default());
        assert!(terms.total() == 0.0 && g.iter().all(|v| *v == 0.0));
    }

    #[test]
    fn small_regions_are_left_alone() {
        let f = fixture();
        let at = |min_region_px| {
            loss(&f.planes, &f.truth(), &LossWeights { min_region_px, ..LossWeights::default() }).0.region
        };
        assert!(at(2) > 0.0);
        assert_eq!(at(1000), 0.0);
    }

    /// 4×4 pixels, one region: the first feature alternates between 0 and 2, the second is 3 everywhere.
    #[test]
    fn variation_and_smoothness_as_computed_by_hand() {
        const PIXELS: usize = 16;
        let mut planes = vec![0.0f64; (FEATURE_PLANE + 2) * PIXELS];
        for i in 0..PIXELS {
            // Red: a step between the second and the third column.
            planes[i] = f64::from(u8::from(i % 4 >= 2));
            planes[FEATURE_PLANE * PIXELS + i] = 2.0 * (i % 2) as f64;
            planes[(FEATURE_PLANE + 1) * PIXELS + i] = 3.0;
        }
        let (colour, mask, regions) = (vec![0; 3 * PIXELS], vec![true; PIXELS], vec![0; PIXELS]);
        let truth = Truth {
            width: 4,
            height: 4,
            colour: &colour,
            mask: &mask,
            depth: &[],
            regions: &regions,
            latents: &[0.0, 3.0],
            typical_depth: 1.0,
        };
        let weights = LossWeights { min_region_px: 16, ..LossWeights::default() };
        let (terms, _) = loss(&planes, &truth, &weights);
        assert!((terms.colour - 0.5 / 3.0).abs() < 1e-8);
        assert!((terms.features - 8.0 * 2.0 / 32.0).abs() < 1e-8);
        // Four steps of 1 in red; three steps of 2 in each row of the first feature.
        let variation = 0.01 * (4.0 / 48.0 + 24.0 / 32.0);
        assert!((terms.total_variation - variation).abs() < 1e-8);
        // Each channel's own mean: deviations 1 and 0, averaged over two channels.
        assert!((terms.region - 0.01 * 0.5).abs() < 1e-8);
        // Their common mean 2: deviations 2 or 0, and 1.
        let (pooled, _) = loss(&planes, &truth, &LossWeights { pooled_regions: true, ..weights.clone() });
        assert!((pooled.region - 0.01).abs() < 1e-8);
        let (small, _) = loss(&planes, &truth, &LossWeights { min_region_px: 17, ..weights });
        assert_eq!(small.region, 0.0);
    }
}
