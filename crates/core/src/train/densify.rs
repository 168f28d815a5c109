//! Adds Gaussians where the gradient of the picture pulls at them, and removes those that have faded
//! (method §6.3–6.4).
//!
//! In the released code the scene extent is 0, so that every densification is a split. Here size is
//! judged in pixels, which also works with a still camera. [`Densify`] is the policy, the same for all
//! backends. Each pass that follows it has a twin of its name in `shaders/densify.wgsl`.

use super::{
    model::{Model, Statistics},
    random::normal4,
    settings::TrainSettings,
};
use crate::{
    deform::Deformation,
    gaussian::Gaussians,
    num::{logit, sigmoid},
    real::{rotation_matrix, transform, unit_quaternion},
};

/// Numbers that determine one densification.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Densify {
    /// Smallest logit of opacity; Gaussians with a lower one are removed.
    pub min_opacity_logit: f32,
    /// Smallest mean pull of a Gaussian that is divided into two.
    pub min_pull: f32,
    /// Largest share of the kept Gaussians that may be added.
    pub growth: f32,
    /// Largest number of Gaussians.
    pub budget: usize,
    /// Log-scale above which a Gaussian is split; others are cloned.
    pub split_log_scale: f32,
    /// `true` to place both halves at random, with fresh moments.
    pub split_only: bool,
    /// Seed of the random numbers, which also depend on the parent's row.
    pub seed: [u32; 2],
}

/// Decrease of the log-scale along the axis of a split: ln 1.6, as in the released code.
pub const LN_SPLIT: f32 = 0.470_003_63;
/// Distance of the two halves of a split Gaussian from its centre, in its standard deviations.
pub const SPLIT_DISTANCE: f32 = 0.8;
/// Distance of the two Gaussians of a clone from its centre, in its standard deviations.
pub const CLONE_DISTANCE: f32 = 0.4;

/// Key of a Gaussian that is not to be divided; the others' keys are lower.
const NOT_PULLED: u32 = u32::MAX;

impl Densify {
    /// Policy after step `step`, for at most `budget` Gaussians. `world_per_px` is the length of a pixel
    /// at the typical depth.
    pub fn new(settings: &TrainSettings, budget: usize, world_per_px: f32, step: usize) -> Self {
        let d = &settings.densify;
        let by_threshold = d.threshold > 0.0;
        Self {
            min_opacity_logit: logit(d.min_opacity),
            min_pull: if by_threshold { d.threshold } else { f32::MIN_POSITIVE },
            growth: if by_threshold { f32::INFINITY } else { d.growth },
            budget,
            split_log_scale: (d.split_px * world_per_px).ln(),
            split_only: d.split_only,
            seed: [settings.seed as u32 ^ (settings.seed >> 32) as u32, step as u32],
        }
    }

    /// Number of Gaussians to divide, the most pulled first, of `num_kept` that are kept and `num_pulled`
    /// of these that are pulled.
    pub fn num_children(&self, num_kept: usize, num_pulled: usize) -> usize {
        let room = self.budget.saturating_sub(num_kept);
        // The conversion turns infinity into the largest integer.
        num_pulled.min(room).min((self.growth * num_kept as f32) as usize)
    }
}

/// Decides on one densify-and-prune and carries it out. The kept Gaussians stay in their order; the
/// children follow in the order of their parents. The statistics are reset.
pub fn densify(model: &mut Model, how: &Densify) {
    let Model { gaussians, deformation, optimiser, statistics } = model;
    let decisions = decide(gaussians, statistics, how);
    let num_kept = decisions.iter().filter(|d| d.is_kept).count();
    let mut parted = rank(&decisions);
    parted.truncate(how.num_children(num_kept, parted.len()));
    // Sorted by index: if pulls differ in the last digit, at most the choice between two Gaussians
    // changes, not the order.
    parted.sort_unstable();
    let (rows, pairs) = list(&decisions, &parted, how.split_only);
    let (bands, dim, stride) = (gaussians.sh_bands() * 3, gaussians.latent_dim, deformation.stride);
    copy_rows(gaussians, deformation, &rows);
    let moments: Vec<Option<u32>> = rows.iter().map(|r| (!r.is_fresh).then_some(r.parent)).collect();
    optimiser.rearrange(&moments, bands, dim, stride);
    for (pair, parent) in pairs.into_iter().zip(&parted) {
        if how.split_only {
            scatter(gaussians, pair, how.seed, *parent);
        } else {
            split_or_clone(gaussians, pair, how.split_log_scale);
        }
    }
    *statistics = Statistics::new(gaussians.len());
}

/// Decision about one Gaussian.
#[derive(Clone, Copy)]
struct Decision {
    is_kept: bool,
    /// Sort key; the more it is pulled, the lower.
    pull_key: u32,
}

fn decide(gaussians: &Gaussians, statistics: &Statistics, how: &Densify) -> Vec<Decision> {
    let decide_one = |i: usize| {
        let numbers = gaussians.means[i].iter().chain(&gaussians.log_scales[i]);
        let is_kept = numbers.into_iter().all(|v| v.is_finite())
            && gaussians.opacity_logits[i] >= how.min_opacity_logit;
        let mean_pull = statistics.pull[i] / statistics.seen[i].max(1) as f32;
        let is_pulled = is_kept && mean_pull >= how.min_pull;
        // Pulls are positive, so their bits sort like the numbers.
        Decision { is_kept, pull_key: if is_pulled { !mean_pull.to_bits() } else { NOT_PULLED } }
    };
    (0..gaussians.len()).map(decide_one).collect()
}

/// Gaussians to divide if there is room, the most pulled first, ties by index.
fn rank(decisions: &[Decision]) -> Vec<u32> {
    let key = |i: &u32| decisions[*i as usize].pull_key;
    let mut ranked: Vec<u32> = (0..decisions.len() as u32).filter(|i| key(i) != NOT_PULLED).collect();
    ranked.sort_by_key(key);
    ranked
}

/// A row of the new set.
#[derive(Clone, Copy, Debug, PartialEq)]
struct NewRow {
    /// Row of the old set that it copies.
    parent: u32,
    /// `true` if its moments start afresh.
    is_fresh: bool,
}

/// The new rows, and the indices of the two rows of each divided Gaussian.
fn list(decisions: &[Decision], parted: &[u32], split_only: bool) -> (Vec<NewRow>, Vec<[usize; 2]>) {
    let mut places = vec![0; decisions.len()];
    let mut rows = Vec::new();
    for (parent, _) in decisions.iter().enumerate().filter(|(_, decision)| decision.is_kept) {
        places[parent] = rows.len();
        rows.push(NewRow { parent: parent as u32, is_fresh: false });
    }
    let mut pairs = Vec::new();
    for parent in parted {
        let place = places[*parent as usize];
        rows[place].is_fresh = split_only;
        pairs.push([place, rows.len()]);
        rows.push(NewRow { parent: *parent, is_fresh: true });
    }
    (rows, pairs)
}

/// Makes two Gaussians of one. A large one becomes two smaller ones along its longest axis. A small one
/// becomes two side by side that together cover the same area. Both rows start as copies of it.
fn split_or_clone(gaussians: &mut Gaussians, [parent, child]: [usize; 2], split_log_scale: f32) {
    let log_scale = gaussians.log_scales[parent];
    // If several are equal, the last one is taken.
    let longest = (1..3).fold(0, |best, axis| if log_scale[axis] >= log_scale[best] { axis } else { best });
    let is_large = log_scale[longest] > split_log_scale;
    let distance = if is_large { SPLIT_DISTANCE } else { CLONE_DISTANCE };
    let mut along = [0.0; 3];
    along[longest] = distance * log_scale[longest].exp();
    let (unit, _) = unit_quaternion(gaussians.rotations[parent]);
    let offset = transform(&rotation_matrix(unit), along);
    for (axis, offset) in offset.into_iter().enumerate() {
        gaussians.means[parent][axis] -= offset;
        gaussians.means[child][axis] += offset;
    }
    for i in [parent, child] {
        if is_large {
            gaussians.log_scales[i][longest] -= LN_SPLIT;
        } else {
            let rest = 1.0 - sigmoid(gaussians.opacity_logits[i]);
            gaussians.opacity_logits[i] = logit(1.0 - rest.sqrt());
        }
    }
}

/// Places two smaller Gaussians at random where one was, as the released code does (method §6.4).
fn scatter(gaussians: &mut Gaussians, pair: [usize; 2], [first, second]: [u32; 2], seed: u32) {
    let (mean, log_scale) = (gaussians.means[pair[0]], gaussians.log_scales[pair[0]]);
    let turn = rotation_matrix(unit_quaternion(gaussians.rotations[pair[0]]).0);
    for (half, i) in pair.into_iter().enumerate() {
        let random = normal4([first, second, seed, half as u32]);
        let offset = transform(&turn, std::array::from_fn(|axis| log_scale[axis].exp() * random[axis]));
        gaussians.means[i] = std::array::from_fn(|axis| mean[axis] + offset[axis]);
        gaussians.log_scales[i] = log_scale.map(|s| s - LN_SPLIT);
    }
}

/// Rebuilds every array for the new rows.
fn copy_rows(gaussians: &mut Gaussians, deformation: &mut Deformation, rows: &[NewRow]) {
    fn copy<T: Copy>(values: &[T], rows: &[NewRow], width: usize) -> Vec<T> {
        let row = |r: &NewRow| &values[r.parent as usize * width..(r.parent as usize + 1) * width];
        rows.iter().flat_map(row).copied().collect()
    }
    let plane = gaussians.len() * deformation.stride;
    let (bands, dim, stride) = (gaussians.sh_bands() * 3, gaussians.latent_dim, deformation.stride);
    gaussians.means = copy(&gaussians.means, rows, 1);
    gaussians.rotations = copy(&gaussians.rotations, rows, 1);
    gaussians.log_scales = copy(&gaussians.log_scales, rows, 1);
    gaussians.opacity_logits = copy(&gaussians.opacity_logits, rows, 1);
    gaussians.colours = copy(&gaussians.colours, rows, 1);
    gaussians.sh_rest = copy(&gaussians.sh_rest, rows, bands);
    gaussians.features = copy(&gaussians.features, rows, dim);
    let by_plane = |values: &[f32]| -> Vec<f32> {
        values.chunks(plane.max(1)).flat_map(|plane| copy(plane, rows, stride)).collect()
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
    use crate::deform::GATE_SLOPE;

    fn model(pull: &[f32]) -> Model {
        let n = pull.len();
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
        let mut deformation = Deformation::at_rest(n, 3, 2, 0.1, GATE_SLOPE);
        deformation.weights.iter_mut().enumerate().for_each(|(i, w)| *w = i as f32);
        let mut model = Model::new(gaussians, deformation);
        model.statistics = Statistics { pull: pull.to_vec(), seen: vec![1; n] };
        model.optimiser.features.first = model.gaussians.features.clone();
        model
    }

    fn how(growth: f32, budget: usize) -> Densify {
        let mut settings = TrainSettings::default();
        settings.densify.growth = growth;
        Densify::new(&settings, budget, 0.1, 100)
    }

    #[test]
    fn the_most_pulled_are_parted_and_the_faded_removed() {
        let mut m = model(&[9.0, 0.1, 5.0, 8.0, 0.0, 0.2]);
        let before = m.clone();
        densify(&mut m, &how(0.4, 100));
        let g = &m.gaussians;
        let parents: Vec<f32> = g.features.iter().step_by(3).map(|f| f / 3.0).collect();
        assert_eq!(parents, [1.0, 2.0, 3.0, 4.0, 5.0, 2.0, 3.0]);
        let fresh = |i: usize| m.optimiser.features.first[3 * i..3 * i + 3] == [0.0; 3];
        assert_eq!((0..7).map(fresh).collect::<Vec<_>>(), [false, false, false, false, false, true, true]);
        let stride = m.deformation.stride;
        for b in 0..2 {
            let child = m.deformation.weights[(b * 7 + 6) * stride];
            assert_eq!(child, before.deformation.weights[(b * 6 + 3) * stride]);
        }
        // Gaussian 2 is large and is split. Gaussian 3 is small and is cloned with shared opacity.
        assert!(g.log_scales[1].iter().any(|s| *s < 0.0) && (g.log_scales[2][0] + 3.0).abs() < 1e-6);
        assert!((sigmoid(g.opacity_logits[2]) - (1.0 - 0.5f32.sqrt())).abs() < 1e-5);
        assert_eq!(m.statistics, Statistics::new(7));
    }

    #[test]
    fn halves_placed_at_random_both_start_afresh() {
        let mut m = model(&[0.0, 0.0, 5.0, 0.0]);
        densify(&mut m, &Densify { split_only: true, ..how(1.0, 100) });
        let (g, moments) = (&m.gaussians, &m.optimiser.features.first);
        assert_eq!(g.len(), 4);
        assert!(g.means[1] != g.means[3] && g.means[1] != [2.0, 0.0, 10.0]);
        assert!(g.log_scales[1] == [-LN_SPLIT; 3] && g.log_scales[3] == [-LN_SPLIT; 3]);
        assert!(moments[3..6] == [0.0; 3] && moments[9..12] == [0.0; 3]);
    }

    #[test]
    fn the_budget_holds() {
        let mut m = model(&[1.0; 6]);
        densify(&mut m, &how(1.0, 6));
        assert_eq!(m.gaussians.len(), 6);
        assert_eq!(how(f32::INFINITY, 9).num_children(5, 100), 4);
        assert_eq!(how(0.5, 9).num_children(0, 0), 0);
    }
}
