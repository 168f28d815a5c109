//! The loss of one frame and its gradient with respect to the rendered planes (method §5).
//!
//! L = L_C + λ_D L_D + λ_TV (TV_C + TV_D) + λ_F (L_F + λ_TV TV_F + λ_RS RS), all terms inside the supervision mask.

use crate::{
    prepare::NO_REGION,
    raster::{ALPHA_PLANE, DEPTH_PLANE, FEATURE_PLANE},
    real::Real,
};
use rayon::prelude::*;

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
}

impl Default for LossWeights {
    fn default() -> Self {
        Self {
            depth: 1.0,
            total_variation: 0.01,
            features: 1.0,
            region_smoothness: 0.01,
            min_region_px: 1000,
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
    /// r, g, b interleaved, 0–255.
    pub colour: &'a [u8],
    /// `true` = supervise.
    pub mask: &'a [bool],
    /// z in scene units, 0 where unknown; empty if there is no depth.
    pub depth: &'a [f32],
    /// Latent table row per pixel, [`NO_REGION`] where none; empty if there are no features.
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

/// The loss of `planes` (as [`crate::raster::Images`]) and ∂L/∂planes. A frame without supervised pixels has loss 0.
pub fn loss<T: Real>(planes: &[T], truth: &Truth<'_>, weights: &LossWeights) -> (LossTerms<T>, Vec<T>) {
    let n = truth.width * truth.height;
    let mut g = vec![T::zero(); planes.len()];
    let mut terms = LossTerms::default();
    let supervised = truth.mask.iter().filter(|m| **m).count();
    if n == 0 || supervised == 0 {
        return (terms, g);
    }
    let per_pixel = T::one() / T::of(supervised as f64);
    let variation = T::from_f32(weights.total_variation) * per_pixel;
    for channel in 0..3 {
        let (plane, g) = (&planes[channel * n..(channel + 1) * n], &mut g[channel * n..(channel + 1) * n]);
        let scale = per_pixel / T::of(3.0);
        terms.colour += l1_rows(plane, g, truth, scale, |i| {
            Some(T::of(f64::from(truth.colour[3 * i + channel]) / 255.0))
        });
        terms.total_variation += total_variation(plane, g, truth, variation / T::of(3.0), |_| true);
    }
    depth_terms(planes, &mut g, truth, weights, per_pixel, &mut terms);
    let latent_dim = (planes.len() / n).saturating_sub(FEATURE_PLANE);
    if latent_dim > 0 && !truth.regions.is_empty() {
        feature_terms(planes, &mut g, truth, weights, latent_dim, &mut terms);
    }
    (terms, g)
}

/// Σ scale·|plane − target| over supervised pixels that have a target; adds the gradient.
fn l1_rows<T: Real>(
    plane: &[T],
    g: &mut [T],
    truth: &Truth<'_>,
    scale: T,
    target: impl Fn(usize) -> Option<T> + Sync,
) -> T {
    let sums: Vec<T> = g
        .par_chunks_mut(truth.width)
        .enumerate()
        .map(|(y, g)| {
            let mut sum = T::zero();
            for (x, g) in g.iter_mut().enumerate() {
                let i = y * truth.width + x;
                if let Some(target) = truth.mask[i].then(|| target(i)).flatten() {
                    let difference = plane[i] - target;
                    sum += difference.abs() * scale;
                    *g += sign(difference) * scale;
                }
            }
            sum
        })
        .collect();
    sums.into_iter().sum()
}

/// 0 at 0, unlike `signum`.
fn sign<T: Real>(v: T) -> T {
    if v > T::zero() {
        T::one()
    } else if v < T::zero() {
        -T::one()
    } else {
        T::zero()
    }
}

/// Σ scale·|x_i − x_j| over horizontal and vertical neighbours, both supervised and both `valid`; adds the gradient.
fn total_variation<T: Real>(
    plane: &[T],
    g: &mut [T],
    truth: &Truth<'_>,
    scale: T,
    valid: impl Fn(usize) -> bool + Sync,
) -> T {
    let (width, height) = (truth.width, truth.height);
    if scale == T::zero() {
        return T::zero();
    }
    let counts = |i: usize| truth.mask[i] && valid(i);
    let sums: Vec<T> = g
        .par_chunks_mut(width)
        .enumerate()
        .map(|(y, g)| {
            let mut sum = T::zero();
            for (x, g) in g.iter_mut().enumerate() {
                let i = y * width + x;
                if !counts(i) {
                    continue;
                }
                // Each pair is counted by its left or upper pixel; its gradient by both.
                let right = (x + 1 < width).then_some(i + 1);
                let below = (y + 1 < height).then_some(i + width);
                let left = (x > 0).then(|| i - 1);
                let above = (y > 0).then(|| i - width);
                for j in [right, below].into_iter().flatten().filter(|j| counts(*j)) {
                    sum += (plane[i] - plane[j]).abs() * scale;
                    *g += sign(plane[i] - plane[j]) * scale;
                }
                for j in [left, above].into_iter().flatten().filter(|j| counts(*j)) {
                    *g += sign(plane[i] - plane[j]) * scale;
                }
            }
            sum
        })
        .collect();
    sums.into_iter().sum()
}

/// Inverse depth r = z̃ A / D (alpha-normalised, in units of the typical depth): |r − r̂| and its variation.
fn depth_terms<T: Real>(
    planes: &[T],
    g: &mut [T],
    truth: &Truth<'_>,
    weights: &LossWeights,
    per_pixel: T,
    terms: &mut LossTerms<T>,
) {
    let n = truth.width * truth.height;
    let typical = T::from_f32(truth.typical_depth);
    let (depth, alpha) = (&planes[DEPTH_PLANE * n..][..n], &planes[ALPHA_PLANE * n..][..n]);
    let valid = |i: usize| alpha[i] > T::of(MIN_DEPTH_ALPHA) && depth[i] > T::zero();
    if truth.depth.is_empty() || weights.depth == 0.0 {
        return;
    }
    let inverse: Vec<T> =
        (0..n).map(|i| if valid(i) { typical * alpha[i] / depth[i] } else { T::zero() }).collect();
    let mut g_inverse = vec![T::zero(); n];
    let target = |i: usize| (valid(i) && truth.depth[i] > 0.0).then(|| typical / T::from_f32(truth.depth[i]));
    terms.depth += l1_rows(&inverse, &mut g_inverse, truth, T::from_f32(weights.depth) * per_pixel, target);
    let variation = T::from_f32(weights.total_variation) * per_pixel;
    terms.total_variation += total_variation(&inverse, &mut g_inverse, truth, variation, valid);
    for i in (0..n).filter(|&i| valid(i)) {
        g[DEPTH_PLANE * n + i] -= g_inverse[i] * inverse[i] / depth[i];
        g[ALPHA_PLANE * n + i] += g_inverse[i] * typical / depth[i];
    }
}

fn feature_terms<T: Real>(
    planes: &[T],
    g: &mut [T],
    truth: &Truth<'_>,
    weights: &LossWeights,
    latent_dim: usize,
    terms: &mut LossTerms<T>,
) {
    let n = truth.width * truth.height;
    let all = T::of((n * latent_dim) as f64);
    let weight = T::from_f32(weights.features);
    let has_region = |i: usize| truth.regions[i] != NO_REGION;
    let counts = region_counts(truth);
    for d in 0..latent_dim {
        let at = (FEATURE_PLANE + d) * n;
        let (plane, g) = (&planes[at..at + n], &mut g[at..at + n]);
        let target = |i: usize| {
            has_region(i).then(|| T::from_f32(truth.latents[truth.regions[i] as usize * latent_dim + d]))
        };
        terms.features += l1_rows(plane, g, truth, weight / all, target);
        let variation = weight * T::from_f32(weights.total_variation) / all;
        terms.total_variation += total_variation(plane, g, truth, variation, |_| true);
        let smoothness = weight * T::from_f32(weights.region_smoothness) / T::of(latent_dim as f64);
        terms.region += region_smoothness(plane, g, truth, &counts, weights.min_region_px, smoothness);
    }
}

/// Supervised pixels of each latent-table row.
fn region_counts(truth: &Truth<'_>) -> Vec<usize> {
    let mut counts = Vec::new();
    for (&r, _) in truth.regions.iter().zip(truth.mask).filter(|(r, m)| **m && **r != NO_REGION) {
        let r = usize::from(r);
        if r >= counts.len() {
            counts.resize(r + 1, 0);
        }
        counts[r] += 1;
    }
    counts
}

/// RS of one feature plane: Σ over large regions of the mean |F − region mean|, the gradient also through the mean.
fn region_smoothness<T: Real>(
    plane: &[T],
    g: &mut [T],
    truth: &Truth<'_>,
    counts: &[usize],
    min_px: usize,
    scale: T,
) -> T {
    let is_large = |i: usize| {
        let r = usize::from(truth.regions[i]);
        (truth.mask[i] && truth.regions[i] != NO_REGION && counts[r] >= min_px).then_some(r)
    };
    let mut means = vec![T::zero(); counts.len()];
    let large: Vec<(usize, usize)> = (0..plane.len()).filter_map(|i| is_large(i).map(|r| (i, r))).collect();
    for &(i, r) in &large {
        means[r] += plane[i] / T::of(counts[r] as f64);
    }
    let (mut sum, mut sign_sums) = (T::zero(), vec![T::zero(); counts.len()]);
    for &(i, r) in &large {
        let difference = plane[i] - means[r];
        sum += difference.abs() * scale / T::of(counts[r] as f64);
        sign_sums[r] += sign(difference);
    }
    for &(i, r) in &large {
        let n = T::of(counts[r] as f64);
        g[i] += (sign(plane[i] - means[r]) - sign_sums[r] / n) * scale / n;
    }
    sum
}

#[cfg(test)]
mod tests {
    use super::*;
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
        };
        let all = LossWeights {
            depth: 1.0,
            total_variation: 0.3,
            features: 1.0,
            region_smoothness: 0.5,
            min_region_px: 5,
        };
        for weights in [
            none.clone(),
            LossWeights { depth: 1.0, ..none.clone() },
            LossWeights { total_variation: 0.3, ..none.clone() },
            LossWeights { features: 1.0, ..none.clone() },
            LossWeights { features: 1.0, region_smoothness: 1.0, ..none },
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
}
