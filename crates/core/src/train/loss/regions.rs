//! Region smoothness (method §5.4): segmented means over runs of pixels.

use super::{
    sums::{STRIP_ROWS, lane_sum, sign},
    truth::Truth,
};
use crate::real::Real;
use fearless_simd::{Simd, dispatch};
use fearless_simd_macros::simd;
use rayon::prelude::*;

/// A run of neighbouring pixels of a row that belong to the same region.
struct Run {
    start: usize,
    len: usize,
    region: usize,
}

/// Pixels of the regions that are large enough to be smoothed.
pub(super) struct Regions<T> {
    /// Number of pixels per strip.
    strip: usize,
    /// 1 / pixels of each region; 0 for regions that are not smoothed.
    share: Vec<T>,
    /// Supervised runs, strip by strip; their starts count from the strip's first pixel.
    runs: Vec<Vec<Run>>,
}

impl<T: Real> Regions<T> {
    pub(super) fn new(truth: &Truth<'_>, rows: usize, min_px: usize) -> Self {
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

    /// Means over each region of the sums that `sum` computes for a run; added strip by strip.
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

    /// RS of the feature planes: Σ over large regions of the mean |F − region mean|. The gradient also
    /// goes through the mean.
    pub(super) fn smoothness(&self, planes: &[T], g: &mut [T], n: usize, scale: T, pooled: bool) -> T {
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
        // Means of |F − mean| and of its sign. The mean sign is the gradient with respect to the region's
        // mean.
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

/// Supervised runs of regions with an index below `rows`.
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

/// Adds (sign(v − mean) − mean_sign) · factor to g.
#[simd]
fn add_deviation_signs<S: Simd, T: Real>(_: S, values: &[T], mean: T, mean_sign: T, factor: T, g: &mut [T]) {
    for (g, v) in g.iter_mut().zip(values) {
        *g += (sign(*v - mean) - mean_sign) * factor;
    }
}
