//! Adding Gaussians where the picture pulls at them, removing those that have faded (method §6.3–6.4).
//!
//! Unlike the released code, whose scene extent of 0 makes every densification a split, size is judged in pixels,
//! so it works with a still camera.

use super::settings::DensifySettings;
use crate::{
    deform::Deformation,
    gaussian::Gaussians,
    num::{logit, sigmoid},
    raster::project::{Splat, SplatGradient},
    real::{rotation_matrix, transform, unit_quaternion},
};
use rand::Rng;
use rand_chacha::ChaCha8Rng;

/// Per Gaussian, since the last densification.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Statistics {
    /// Σ ‖∂L/∂centre‖, per px of the full-size image.
    pub pull: Vec<f32>,
    /// Frames in which it was visible.
    pub seen: Vec<u32>,
}

impl Statistics {
    /// For `n` Gaussians, nothing seen yet.
    pub fn new(n: usize) -> Self {
        Self { pull: vec![0.0; n], seen: vec![0; n] }
    }

    /// Adds one frame; `scale` makes its pixels the unit wanted.
    pub fn add(&mut self, splats: &[Splat<f32>], g: &[SplatGradient<f32>], scale: [f32; 2]) {
        for (i, (splat, g)) in splats.iter().zip(g).enumerate() {
            if splat.is_visible() {
                self.pull[i] += (g.centre[0] * scale[0]).hypot(g.centre[1] * scale[1]);
                self.seen[i] += 1;
            }
        }
    }

    fn mean_pull(&self, i: usize) -> f32 {
        if self.seen[i] == 0 { 0.0 } else { self.pull[i] / self.seen[i] as f32 }
    }
}

/// What becomes of the set of Gaussians.
#[derive(Clone, Debug, Default)]
pub struct Change {
    /// Row of the old set that each row of the new set copies.
    pub parents: Vec<u32>,
    /// Whether the row's moments start afresh.
    pub fresh: Vec<bool>,
}

impl Change {
    /// The moments' rows, for [`super::optimiser::Optimiser::rearrange`].
    pub fn moment_rows(&self) -> Vec<Option<u32>> {
        self.parents.iter().zip(&self.fresh).map(|(p, fresh)| (!fresh).then_some(*p)).collect()
    }
}

/// Decides and carries out one densify-and-prune, to at most `budget` Gaussians; `world_per_px` is the length of a pixel at the typical depth.
pub fn densify(
    gaussians: &mut Gaussians,
    deformation: &mut Deformation,
    statistics: &Statistics,
    settings: &DensifySettings,
    budget: usize,
    world_per_px: f32,
    rng: &mut ChaCha8Rng,
) -> Change {
    let n = gaussians.len();
    let keep: Vec<u32> =
        (0..n as u32).filter(|&i| is_worth_keeping(gaussians, i as usize, settings)).collect();
    let room = budget.saturating_sub(keep.len());
    let by_threshold = settings.threshold > 0.0;
    let wanted = if by_threshold { room } else { room.min((settings.growth * keep.len() as f32) as usize) };
    let is_pulled = |i: &u32| {
        let pull = statistics.mean_pull(*i as usize);
        if by_threshold { pull >= settings.threshold } else { pull > 0.0 }
    };
    let mut pulled: Vec<u32> = keep.iter().copied().filter(is_pulled).collect();
    pulled.sort_by(|&a, &b| {
        statistics.mean_pull(b as usize).total_cmp(&statistics.mean_pull(a as usize)).then(a.cmp(&b))
    });
    pulled.truncate(wanted);
    pulled.sort_unstable();
    let mut change = Change { parents: keep.clone(), fresh: vec![false; keep.len()] };
    change.parents.extend(&pulled);
    change.fresh.resize(change.parents.len(), true);
    rearrange(gaussians, deformation, &change.parents, n);
    for (k, parent) in pulled.iter().enumerate() {
        let child = keep.len() + k;
        let Ok(parent) = keep.binary_search(parent) else { continue };
        if settings.split_only {
            change.fresh[parent] = true;
            scatter(gaussians, [parent, child], rng);
        } else {
            part(gaussians, parent, child, settings.split_px * world_per_px, rng);
        }
    }
    change
}

fn is_worth_keeping(gaussians: &Gaussians, i: usize, settings: &DensifySettings) -> bool {
    let finite = gaussians.means[i].iter().chain(&gaussians.log_scales[i]).all(|v| v.is_finite());
    finite && sigmoid(gaussians.opacity_logits[i]) >= settings.min_opacity
}

/// Makes two of one: a large Gaussian is split along its longest axis into two smaller ones, a small one is cloned
/// side by side; opacities are chosen so that both together cover what the one did.
fn part(gaussians: &mut Gaussians, parent: usize, child: usize, split_size: f32, rng: &mut ChaCha8Rng) {
    let scale = gaussians.log_scales[parent].map(f32::exp);
    let longest = (0..3).max_by(|&a, &b| scale[a].total_cmp(&scale[b])).unwrap_or(0);
    let (unit, _) = unit_quaternion(gaussians.rotations[parent]);
    let is_large = scale[longest] > split_size;
    let distance = if is_large { 0.8 } else { 0.4 } * scale[longest] * rng.random_range(0.8..1.2);
    let mut local = [0.0; 3];
    local[longest] = distance;
    let offset = transform(&rotation_matrix(unit), local);
    for (axis, offset) in offset.into_iter().enumerate() {
        gaussians.means[child][axis] += offset;
        gaussians.means[parent][axis] -= offset;
    }
    if is_large {
        for i in [parent, child] {
            gaussians.log_scales[i][longest] -= 1.6f32.ln();
        }
    }
    let shared = 1.0 - (1.0 - sigmoid(gaussians.opacity_logits[parent])).sqrt();
    let opacity = if is_large { sigmoid(gaussians.opacity_logits[parent]) } else { shared };
    gaussians.opacity_logits[parent] = logit(opacity);
    gaussians.opacity_logits[child] = logit(opacity);
}

/// Puts two smaller Gaussians at random where one was, as the released code does (method §6.4).
fn scatter(gaussians: &mut Gaussians, pair: [usize; 2], rng: &mut ChaCha8Rng) {
    let (mean, scale) = (gaussians.means[pair[0]], gaussians.log_scales[pair[0]].map(f32::exp));
    let turn = rotation_matrix(unit_quaternion(gaussians.rotations[pair[0]]).0);
    for i in pair {
        let offset = transform(&turn, scale.map(|s| s * standard_normal(rng)));
        gaussians.means[i] = std::array::from_fn(|axis| mean[axis] + offset[axis]);
        gaussians.log_scales[i] = scale.map(|s| s.ln() - 1.6f32.ln());
    }
}

/// Box and Muller.
fn standard_normal(rng: &mut ChaCha8Rng) -> f32 {
    let (u, angle): (f32, f32) = (rng.random_range(f32::MIN_POSITIVE..1.0), rng.random_range(0.0..1.0));
    (-2.0 * u.ln()).sqrt() * (std::f32::consts::TAU * angle).cos()
}

/// Rows of every array become copies of the rows listed in `parents`.
fn rearrange(gaussians: &mut Gaussians, deformation: &mut Deformation, parents: &[u32], old_len: usize) {
    fn rows<T: Copy>(values: &[T], parents: &[u32], width: usize) -> Vec<T> {
        parents.iter().flat_map(|&p| &values[p as usize * width..(p as usize + 1) * width]).copied().collect()
    }
    let (bands, dim, stride) = (gaussians.sh_bands() * 3, gaussians.latent_dim, deformation.stride);
    gaussians.means = rows(&gaussians.means, parents, 1);
    gaussians.rotations = rows(&gaussians.rotations, parents, 1);
    gaussians.log_scales = rows(&gaussians.log_scales, parents, 1);
    gaussians.opacity_logits = rows(&gaussians.opacity_logits, parents, 1);
    gaussians.colours = rows(&gaussians.colours, parents, 1);
    gaussians.sh_rest = rows(&gaussians.sh_rest, parents, bands);
    gaussians.features = rows(&gaussians.features, parents, dim);
    let by_plane = |values: &[f32]| -> Vec<f32> {
        values.chunks(old_len * stride).flat_map(|plane| rows(plane, parents, stride)).collect()
    };
    deformation.weights = by_plane(&deformation.weights);
    if !deformation.is_shared() {
        (deformation.centres, deformation.widths) =
            (by_plane(&deformation.centres), by_plane(&deformation.widths));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;

    fn scene(n: usize) -> (Gaussians, Deformation) {
        let gaussians = Gaussians {
            means: (0..n).map(|i| [i as f32, 0.0, 10.0]).collect(),
            rotations: vec![[1.0, 0.0, 0.0, 0.0]; n],
            log_scales: (0..n).map(|i| [if i % 2 == 0 { 0.0 } else { -3.0 }; 3]).collect(),
            opacity_logits: (0..n).map(|i| if i == 0 { -9.0 } else { 0.0 }).collect(),
            colours: vec![[0.0; 3]; n],
            features: (0..3 * n).map(|i| i as f32).collect(),
            latent_dim: 3,
            ..Gaussians::default()
        };
        let mut deformation = Deformation::at_rest(n, 3, 2, 0.1, 2.5);
        for (i, w) in deformation.weights.iter_mut().enumerate() {
            *w = i as f32;
        }
        (gaussians, deformation)
    }

    #[test]
    fn the_most_pulled_are_parted_and_the_faded_removed() {
        let (mut g, mut d) = scene(6);
        let before = d.clone();
        let statistics = Statistics { pull: vec![9.0, 0.1, 5.0, 8.0, 0.0, 0.2], seen: vec![1; 6] };
        let settings = DensifySettings { growth: 0.4, ..crate::train::TrainSettings::default().densify };
        let change =
            densify(&mut g, &mut d, &statistics, &settings, 100, 0.1, &mut ChaCha8Rng::seed_from_u64(1));
        assert_eq!(change.parents, vec![1, 2, 3, 4, 5, 2, 3]);
        assert_eq!(change.fresh, vec![false, false, false, false, false, true, true]);
        assert_eq!(g.len(), 7);
        assert_eq!(g.features[15..18], [6.0, 7.0, 8.0]);
        let stride = d.stride;
        for b in 0..2 {
            assert_eq!(d.weights[(b * 7 + 6) * stride], before.weights[(b * 6 + 3) * stride]);
        }
        // Gaussian 2 is large and split; Gaussian 3 is small and cloned with shared opacity.
        assert!(g.log_scales[1].iter().any(|s| *s < 0.0) && (g.log_scales[2][0] + 3.0).abs() < 1e-6);
        assert!((sigmoid(g.opacity_logits[2]) - (1.0 - 0.5f32.sqrt())).abs() < 1e-5);
    }

    #[test]
    fn the_budget_holds() {
        let (mut g, mut d) = scene(6);
        let statistics = Statistics { pull: vec![1.0; 6], seen: vec![1; 6] };
        let settings = DensifySettings { growth: 1.0, ..crate::train::TrainSettings::default().densify };
        densify(&mut g, &mut d, &statistics, &settings, 6, 0.1, &mut ChaCha8Rng::seed_from_u64(1));
        assert_eq!(g.len(), 6);
    }
}
