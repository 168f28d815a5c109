//! The loss of one frame and its gradient with respect to the rendered planes (method §5).
//!
//! L = L_C + λ_D L_D + λ_TV (TV_C + TV_D) + λ_F (L_F + λ_TV TV_F + λ_RS RS), all terms inside the supervision mask.

use crate::{
    prepare::NO_REGION,
    raster::{ALPHA_PLANE, DEPTH_PLANE, FEATURE_PLANE},
    real::Real,
};
use fearless_simd::{Simd, dispatch};
use fearless_simd_macros::simd;
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
    /// r, g, b, plane after plane, 0–255.
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
        let at = channel * n..(channel + 1) * n;
        let (plane, g, colour) = (&planes[at.clone()], &mut g[at.clone()], &truth.colour[at]);
        let (third, byte) = (T::of(1.0 / 3.0), T::of(1.0 / 255.0));
        let target = |start: usize, row: &mut [T]| {
            row.iter_mut().zip(&colour[start..]).for_each(|(to, c)| *to = T::from_f32(f32::from(*c)) * byte);
        };
        terms.colour += l1(plane, g, truth.width, truth.mask, per_pixel * third, target);
        terms.total_variation += total_variation(plane, g, truth.width, truth.mask, variation * third);
    }
    depth_terms(planes, &mut g, truth, weights, per_pixel, &mut terms);
    let latent_dim = (planes.len() / n).saturating_sub(FEATURE_PLANE);
    if latent_dim > 0 && !truth.regions.is_empty() {
        feature_terms(planes, &mut g, truth, weights, latent_dim, &mut terms);
    }
    (terms, g)
}

/// Rows per parallel piece; partial sums are added piece by piece, so that the thread count does not matter.
const STRIP_ROWS: usize = 16;

/// Runs `f(first row, its rows of g)` over strips of a plane and adds what it returns, in order.
fn sum_over_strips<T: Real>(g: &mut [T], width: usize, f: impl Fn(usize, &mut [T]) -> T + Sync) -> T {
    let strips = g.par_chunks_mut(width * STRIP_ROWS).enumerate();
    let sums: Vec<T> = strips.map(|(k, g)| f(k * STRIP_ROWS, g)).collect();
    sums.into_iter().sum()
}

/// 0 at 0, unlike `signum`; written so that it vectorises.
fn sign<T: Real>(v: T) -> T {
    let one = |yes: bool| if yes { T::one() } else { T::zero() };
    one(v > T::zero()) - one(v < T::zero())
}

/// Σ |v|, in 16 lanes so that it vectorises.
#[simd]
fn abs_sum<S: Simd, T: Real>(_: S, values: &[T]) -> T {
    let (chunks, rest) = values.as_chunks::<16>();
    let mut lanes = [T::zero(); 16];
    for chunk in chunks {
        for (lane, v) in lanes.iter_mut().zip(chunk) {
            *lane += v.abs();
        }
    }
    lanes.into_iter().chain(rest.iter().map(|v| v.abs())).sum()
}

/// Values and mask of a row.
type Row<'a, T> = (&'a [T], &'a [bool]);

/// `difference` becomes a − b where both masks are true, else 0.
#[simd]
fn masked_difference<S: Simd, T: Real>(_: S, a: Row<'_, T>, b: Row<'_, T>, difference: &mut [T]) {
    for ((d, (a, ma)), (b, mb)) in difference.iter_mut().zip(a.0.iter().zip(a.1)).zip(b.0.iter().zip(b.1)) {
        *d = if *ma & *mb { *a - *b } else { T::zero() };
    }
}

/// to += sign(difference) · factor.
#[simd]
fn add_signs<S: Simd, T: Real>(_: S, to: &mut [T], difference: &[T], factor: T) {
    for (to, d) in to.iter_mut().zip(difference) {
        *to += sign(*d) * factor;
    }
}

/// Σ scale·|plane − target| where `mask`; adds the gradient. `target(start, row)` fills in a row of targets.
fn l1<T: Real>(
    plane: &[T],
    g: &mut [T],
    width: usize,
    mask: &[bool],
    scale: T,
    target: impl Fn(usize, &mut [T]) + Sync,
) -> T {
    let level = fearless_simd::Level::new();
    sum_over_strips(g, width, |row, g| {
        let (mut wanted, mut difference) = (vec![T::zero(); width], vec![T::zero(); width]);
        let mut sum = T::zero();
        for (k, g) in g.chunks_exact_mut(width).enumerate() {
            let at = (row + k) * width..(row + k + 1) * width;
            target(at.start, &mut wanted);
            let (plane, mask) = (&plane[at.clone()], &mask[at]);
            sum += dispatch!(level, simd => {
                masked_difference(simd, (plane, mask), (&wanted, mask), &mut difference);
                add_signs(simd, g, &difference, scale);
                abs_sum(simd, &difference)
            });
        }
        sum * scale
    })
}

/// Σ scale·|x_i − x_j| over horizontal and vertical neighbours, both in `mask`; adds the gradient.
fn total_variation<T: Real>(plane: &[T], g: &mut [T], width: usize, mask: &[bool], scale: T) -> T {
    if scale == T::zero() || width < 2 {
        return T::zero();
    }
    let level = fearless_simd::Level::new();
    let height = plane.len() / width;
    let row_of = |y: usize| (&plane[y * width..(y + 1) * width], &mask[y * width..(y + 1) * width]);
    sum_over_strips(g, width, |first, g| {
        let (mut across, mut above, mut below) =
            (vec![T::zero(); width - 1], vec![T::zero(); width], vec![T::zero(); width]);
        if first > 0 {
            dispatch!(level, simd => masked_difference(simd, row_of(first - 1), row_of(first), &mut above));
        }
        let mut sum = T::zero();
        for (k, g) in g.chunks_exact_mut(width).enumerate() {
            let here = row_of(first + k);
            let next = (first + k + 1 < height).then(|| row_of(first + k + 1));
            // A pair is counted by its left or upper pixel; its gradient goes to both.
            sum += dispatch!(level, simd => {
                masked_difference(simd, (&here.0[..width - 1], &here.1[..width - 1]), (&here.0[1..], &here.1[1..]), &mut across);
                add_signs(simd, &mut g[..width - 1], &across, scale);
                add_signs(simd, &mut g[1..], &across, -scale);
                add_signs(simd, g, &above, -scale);
                match next {
                    Some(next) => masked_difference(simd, here, next, &mut below),
                    None => below.fill(T::zero()),
                }
                add_signs(simd, g, &below, scale);
                abs_sum(simd, &across) + abs_sum(simd, &below)
            });
            std::mem::swap(&mut above, &mut below);
        }
        sum * scale
    })
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
    if truth.depth.is_empty() || weights.depth == 0.0 {
        return;
    }
    let n = truth.width * truth.height;
    let typical = T::from_f32(truth.typical_depth);
    let (depth, alpha) = (&planes[DEPTH_PLANE * n..][..n], &planes[ALPHA_PLANE * n..][..n]);
    let rendered: Vec<bool> = (0..n)
        .into_par_iter()
        .with_min_len(1 << 14)
        .map(|i| truth.mask[i] && alpha[i] > T::of(MIN_DEPTH_ALPHA) && depth[i] > T::zero())
        .collect();
    let compared: Vec<bool> = rendered.iter().zip(truth.depth).map(|(r, d)| *r && *d > 0.0).collect();
    let safe = |i: usize| if rendered[i] { typical * alpha[i] / depth[i] } else { T::zero() };
    let inverse: Vec<T> = (0..n).into_par_iter().with_min_len(1 << 14).map(safe).collect();
    let mut g_inverse = vec![T::zero(); n];
    let target = |start: usize, row: &mut [T]| {
        let inverse = |d: f32| if d > 0.0 { typical / T::from_f32(d) } else { T::zero() };
        row.iter_mut().zip(&truth.depth[start..]).for_each(|(to, d)| *to = inverse(*d));
    };
    let scale = T::from_f32(weights.depth) * per_pixel;
    terms.depth += l1(&inverse, &mut g_inverse, truth.width, &compared, scale, target);
    let variation = T::from_f32(weights.total_variation) * per_pixel;
    terms.total_variation += total_variation(&inverse, &mut g_inverse, truth.width, &rendered, variation);
    let (g_depth, g_alpha) = g[DEPTH_PLANE * n..].split_at_mut(n);
    for i in (0..n).filter(|&i| rendered[i]) {
        g_depth[i] -= g_inverse[i] * inverse[i] / depth[i];
        g_alpha[i] += g_inverse[i] * typical / depth[i];
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
    let mask: Vec<bool> = truth.mask.iter().zip(truth.regions).map(|(m, r)| *m && *r != NO_REGION).collect();
    let rows = truth.latents.len() / latent_dim;
    let regions = Regions::new(truth, &mask, rows, weights.min_region_px);
    for d in 0..latent_dim {
        let at = (FEATURE_PLANE + d) * n;
        let (plane, g) = (&planes[at..at + n], &mut g[at..at + n]);
        // One more row, so that NO_REGION (masked anyway) reads something.
        let table: Vec<T> =
            (0..rows).map(|r| T::from_f32(truth.latents[r * latent_dim + d])).chain([T::zero()]).collect();
        let target = |start: usize, row: &mut [T]| {
            row.iter_mut()
                .zip(&truth.regions[start..])
                .for_each(|(to, r)| *to = table[usize::from(*r).min(rows)]);
        };
        terms.features += l1(plane, g, truth.width, &mask, weight / all, target);
        let variation = weight * T::from_f32(weights.total_variation) / all;
        terms.total_variation += total_variation(plane, g, truth.width, truth.mask, variation);
        let smoothness = weight * T::from_f32(weights.region_smoothness) / T::of(latent_dim as f64);
        terms.region += regions.smoothness(plane, g, smoothness);
    }
}

/// The pixels of the regions that are large enough to be smoothed.
struct Regions<'a, T> {
    width: usize,
    ids: &'a [u16],
    /// 1 / pixels of each region; 0 for regions that are left alone, and for [`NO_REGION`] at the end.
    share: Vec<T>,
    mask: &'a [bool],
}

impl<'a, T: Real> Regions<'a, T> {
    fn new(truth: &Truth<'a>, mask: &'a [bool], rows: usize, min_px: usize) -> Self {
        let mut counts = vec![0usize; rows + 1];
        for (&r, _) in truth.regions.iter().zip(mask).filter(|(_, m)| **m) {
            counts[usize::from(r).min(rows)] += 1;
        }
        let share = counts.iter().enumerate().map(|(r, &count)| {
            if r < rows && count >= min_px.max(1) { T::of(1.0 / count as f64) } else { T::zero() }
        });
        Self { width: truth.width, ids: truth.regions, share: share.collect(), mask }
    }

    /// Σ over regions of the mean of `value(pixel, region)`, summed strip by strip.
    fn means(&self, value: impl Fn(usize, usize) -> T + Sync) -> Vec<T> {
        let last = self.share.len() - 1;
        let strips = self.ids.par_chunks(self.width * STRIP_ROWS).enumerate();
        let partial: Vec<Vec<T>> = strips
            .map(|(k, ids)| {
                let mut sums = vec![T::zero(); last + 1];
                for (j, id) in ids.iter().enumerate() {
                    let i = k * self.width * STRIP_ROWS + j;
                    if self.mask[i] {
                        let r = usize::from(*id).min(last);
                        sums[r] += value(i, r);
                    }
                }
                sums
            })
            .collect();
        let sum = |r: usize| partial.iter().map(|p| p[r]).sum::<T>() * self.share[r];
        (0..=last).map(sum).collect()
    }

    /// RS of one feature plane: Σ over large regions of the mean |F − region mean|, the gradient also through the mean.
    fn smoothness(&self, plane: &[T], g: &mut [T], scale: T) -> T {
        let last = self.share.len() - 1;
        let means = self.means(|i, _| plane[i]);
        let deviations = self.means(|i, r| (plane[i] - means[r]).abs());
        let mean_signs = self.means(|i, r| sign(plane[i] - means[r]));
        sum_over_strips(g, self.width, |row, g| {
            for (k, g) in g.iter_mut().enumerate() {
                let i = row * self.width + k;
                if self.mask[i] {
                    let r = usize::from(self.ids[i]).min(last);
                    *g += (sign(plane[i] - means[r]) - mean_signs[r]) * scale * self.share[r];
                }
            }
            T::zero()
        });
        deviations.into_iter().sum::<T>() * scale
    }
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
