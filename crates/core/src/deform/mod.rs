//! Motion, rotation, stretch and colour change of the Gaussians over time (method §3).
//!
//! ψ_c(t) = Σ_b ω_{b,c} · G(t; θ_b, σ_b) for each channel c of a Gaussian.

mod apply;
mod basis;
mod length;
mod travel;

pub use apply::{
    FeatureNet, Geometry, MAX_LOG_SCALE, MAX_SCALE, Moved, gate_feature, gate_feature_backward,
    move_geometry, move_geometry_backward,
};
#[cfg(test)]
pub(crate) use length::LONGEST;
pub(crate) use length::default_bases;
pub(crate) use length::length_warning;
pub use travel::travel_px;

pub use basis::{BasisShape, LIVE_BASIS, MIN_WIDTH, QUARTIC_EPSILON, basis, basis_backward};

use crate::{gaussian::Gaussians, linear::Symmetric, num::sigmoid};
use fearless_simd::{Level, Simd, dispatch};
use fearless_simd_macros::simd;
use glam::{Affine3A, Mat3A};
use rayon::prelude::*;
use std::ops::Range;

/// Share by which the diagonal is enlarged where motion is fitted: bases that no frame tells of stay at rest.
const FOLLOW_DAMPING: f64 = 1e-4;
/// Length of time, as a share of a recording, that basis functions are spread over at least.
const SHORTEST_SPAN: f32 = 1e-5;

/// δ of the gate in the paper (method §3.3).
pub const GATE_SLOPE: f32 = 2.5;
/// δ of the released code's gate, which reads the channels of scale.
pub const RELEASED_GATE_SLOPE: f32 = 1.5;

/// First channel of each deformed quantity; gate channels follow [`COLOUR_CHANNEL`] + 3.
pub const MEAN_CHANNEL: usize = 0;
/// Δ quaternion (w, x, y, z), added before normalising.
pub const ROTATION_CHANNEL: usize = 3;
/// Δ log-scale.
pub const SCALE_CHANNEL: usize = 7;
/// Δ colour (spherical-harmonic band 0).
pub const COLOUR_CHANNEL: usize = 10;
/// ψ(t; Θ^f), one per latent feature: the gate of the feature network.
pub const GATE_CHANNEL: usize = 13;

/// Number of channels for latent dimension D.
pub const fn num_channels(latent_dim: usize) -> usize {
    GATE_CHANNEL + latent_dim
}

/// Floats per Gaussian and basis: the channels, padded to whole vectors of 16.
pub const fn stride_for(latent_dim: usize) -> usize {
    num_channels(latent_dim).next_multiple_of(16)
}

/// Basis weights of all Gaussians, and the basis functions they belong to.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Deformation {
    /// Shape of every basis function.
    pub shape: BasisShape,
    /// Number of basis functions, B.
    pub num_bases: usize,
    /// Floats per Gaussian and basis: [`stride_for`] the latent dimension.
    pub stride: usize,
    /// ω, [B][N][stride] flat; basis-major so that the live bases are a contiguous block.
    pub weights: Vec<f32>,
    /// θ: [B] when shared by all Gaussians, else [B][N][stride].
    pub centres: Vec<f32>,
    /// σ: as `centres`.
    pub widths: Vec<f32>,
    /// Slope δ of the gate σ(δψ^f).
    pub gate_slope: f32,
    /// First channel of ψ^f: [`GATE_CHANNEL`]; the released code takes those of scale.
    pub gate_channel: usize,
    /// The feature network g([f, t]) = W [f; t] + b: W as [D][D + 1] flat.
    pub feature_weight: Vec<f32>,
    /// b, [D].
    pub feature_bias: Vec<f32>,
}

/// The Gaussians at one time, activated: the input of every later pass.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Deformed {
    /// Centres in the world.
    pub means: Vec<[f32; 3]>,
    /// Unit quaternions (w, x, y, z).
    pub rotations: Vec<[f32; 4]>,
    /// Standard deviations, > 0.
    pub scales: Vec<[f32; 3]>,
    /// Opacities, 0–1.
    pub opacities: Vec<f32>,
    /// Band-0 colour coefficients at this time.
    pub colours: Vec<[f32; 3]>,
    /// Latent features at this time, [N][D]; empty if not asked for.
    pub features: Vec<f32>,
}

impl Deformation {
    /// A deformation without any motion, for `n` Gaussians: bases spread evenly over [0, 1], all weights
    /// zero.
    pub fn at_rest(n: usize, latent_dim: usize, num_bases: usize, width: f32, gate_slope: f32) -> Self {
        let stride = stride_for(latent_dim);
        let spacing = 1.0 / (num_bases.max(2) - 1) as f32;
        Self {
            shape: BasisShape::Gaussian,
            num_bases,
            stride,
            weights: vec![0.0; num_bases * n * stride],
            centres: (0..num_bases).map(|b| b as f32 * spacing).collect(),
            widths: vec![width; num_bases],
            gate_slope,
            gate_channel: GATE_CHANNEL,
            feature_weight: vec![0.0; latent_dim * (latent_dim + 1)],
            feature_bias: vec![0.0; latent_dim],
        }
    }

    /// Squeezes all basis functions from the times 0 to 1 into `from` to `to`.
    pub(crate) fn squeeze(&mut self, from: f32, to: f32) {
        let length = (to - from).max(SHORTEST_SPAN);
        self.centres.iter_mut().for_each(|centre| *centre = from + length * *centre);
        self.widths.iter_mut().for_each(|width| *width *= length);
    }

    /// Changes the unit of time: what was at `first` is at 0, and what was `len` later is at 1.
    pub(crate) fn begin_at(&mut self, first: f32, len: f32) {
        self.centres.iter_mut().for_each(|centre| *centre = (*centre - first) / len);
        let shape = self.shape;
        self.widths.iter_mut().for_each(|width| *width = basis::width_in_unit(shape, *width, len));
        let dim = self.feature_bias.len();
        for (row, bias) in self.feature_weight.chunks_exact_mut(dim + 1).zip(&mut self.feature_bias) {
            *bias += row[dim] * first;
            row[dim] *= len;
        }
    }

    /// Makes Gaussians that rest at `means` move with the world, whose motions are given with their times, as
    /// well as the shared basis functions allow. Each of these then moves centres by an affine function of where
    /// they rest, the least-squares fit to all times.
    pub(crate) fn follow(&mut self, means: &[[f32; 3]], motions: &[(f32, Affine3A)]) {
        if motions.is_empty() {
            return;
        }
        let values: Vec<Vec<f32>> = motions.iter().map(|(time, _)| self.basis_values(*time).0).collect();
        let product = |a: usize, b: usize| values.iter().map(|v| f64::from(v[a]) * f64::from(v[b])).sum();
        let mut matrix = Symmetric::from_fn(self.num_bases, product);
        matrix.damp(FOLLOW_DAMPING);
        if !matrix.factorize() {
            return;
        }
        // Motion less rest, as twelve numbers that are fitted one by one: the columns, then the shift.
        let moved = |(_, motion): &(f32, Affine3A)| {
            let still = Affine3A { matrix3: motion.matrix3 - Mat3A::IDENTITY, ..*motion };
            still.to_cols_array()
        };
        let moved: Vec<[f32; 12]> = motions.iter().map(moved).collect();
        let mut maps = vec![[0.0_f32; 12]; self.num_bases];
        for k in 0..12 {
            let along =
                |b: usize| moved.iter().zip(&values).map(|(m, v)| f64::from(m[k]) * f64::from(v[b])).sum();
            let mut weights: Vec<f64> = (0..self.num_bases).map(along).collect();
            if matrix.substitute(&mut weights) {
                maps.iter_mut().zip(weights).for_each(|(map, w)| map[k] = w as f32);
            }
        }
        let block = means.len() * self.stride;
        for (weights, map) in self.weights.chunks_exact_mut(block.max(1)).zip(&maps) {
            let map = Affine3A::from_cols_array(map);
            for (row, mean) in weights.chunks_exact_mut(self.stride).zip(means) {
                let way = map.transform_point3((*mean).into());
                row[MEAN_CHANNEL..MEAN_CHANNEL + 3].copy_from_slice(&way.to_array());
            }
        }
    }

    /// The same deformation, with centres and widths of their own for every Gaussian and channel.
    pub fn with_own_bases(mut self) -> Self {
        let block = self.weights.len() / self.num_bases.max(1);
        let spread = |shared: &[f32]| shared.iter().flat_map(|v| std::iter::repeat_n(*v, block)).collect();
        (self.centres, self.widths) = (spread(&self.centres), spread(&self.widths));
        self
    }

    /// Returns `true` if all Gaussians share centres and widths.
    pub fn is_shared(&self) -> bool {
        self.centres.len() == self.num_bases
    }

    /// Values of shared bases at `time`, and the range outside which none is above [`LIVE_BASIS`].
    pub fn basis_values(&self, time: f32) -> (Vec<f32>, Range<usize>) {
        let values: Vec<f32> =
            (0..self.num_bases).map(|b| basis(self.shape, time, self.centres[b], self.widths[b])).collect();
        let is_live = |v: &f32| *v > LIVE_BASIS;
        let first = values.iter().position(is_live).unwrap_or(0);
        let end = values.iter().rposition(is_live).map_or(first, |last| last + 1);
        (values, first..end)
    }

    /// ψ(t) of all `n` Gaussians, [N][stride].
    pub fn psi(&self, n: usize, time: f32) -> Vec<f32> {
        let mut psi = Vec::new();
        self.psi_into(n, time, &mut psi);
        psi
    }

    /// Computes [`Deformation::psi`] into memory of the caller.
    pub fn psi_into(&self, n: usize, time: f32, psi: &mut Vec<f32>) {
        let (values, live) =
            if self.is_shared() { self.basis_values(time) } else { (Vec::new(), 0..self.num_bases) };
        self.psi_of(live, &values, n, time, psi);
    }

    /// ψ(t) from some of the bases only. If the bases are shared, `values` holds those of all bases at
    /// `time`.
    pub fn psi_of(&self, bases: Range<usize>, values: &[f32], n: usize, time: f32, psi: &mut Vec<f32>) {
        psi.resize(n * self.stride, 0.0);
        let plane = n * self.stride;
        let chunk = 1024 * self.stride;
        psi.par_chunks_mut(chunk).enumerate().for_each(|(k, psi)| {
            psi.fill(0.0);
            let len = psi.len();
            for b in bases.clone() {
                let at = b * plane + k * chunk..b * plane + k * chunk + len;
                if let Some(value) = values.get(b) {
                    add_scaled(psi, *value, &self.weights[at]);
                } else {
                    self.add_own_basis(psi, at, time);
                }
            }
        });
    }

    /// Adds a basis function that is not shared, for the Gaussians and channels at `at`.
    fn add_own_basis(&self, psi: &mut [f32], at: Range<usize>, time: f32) {
        let own = self.centres[at.clone()].iter().zip(&self.widths[at.clone()]);
        for ((sum, weight), (centre, width)) in psi.iter_mut().zip(&self.weights[at]).zip(own) {
            let value = basis(self.shape, time, *centre, *width);
            *sum += if value > LIVE_BASIS { value * weight } else { 0.0 };
        }
    }

    /// The feature network.
    pub fn feature_net(&self) -> FeatureNet<'_, f32> {
        FeatureNet { weight: &self.feature_weight, bias: &self.feature_bias, slope: self.gate_slope }
    }
}

/// Deforms and activates all Gaussians at time `t`; the CPU twin of `shaders/deform.wgsl`.
pub fn deform(gaussians: &Gaussians, deformation: &Deformation, time: f32, features: bool) -> Deformed {
    let psi = deformation.psi(gaussians.len(), time);
    let mut deformed = Deformed::default();
    deform_by(gaussians, deformation, &psi, time, features, &mut deformed);
    deformed
}

/// Does the work of [`deform`] with a given ψ(t) and into memory of the caller.
pub fn deform_by(
    gaussians: &Gaussians,
    deformation: &Deformation,
    psi: &[f32],
    time: f32,
    features: bool,
    out: &mut Deformed,
) {
    let n = gaussians.len();
    let stride = deformation.stride;
    out.resize(n);
    let outputs = (&mut out.means, &mut out.rotations, &mut out.scales, &mut out.opacities, &mut out.colours);
    outputs.into_par_iter().zip(psi.par_chunks(stride)).with_min_len(1024).enumerate().for_each(
        |(i, ((mean, rotation, scale, opacity, colour), psi))| {
            let moved =
                move_geometry(gaussians.means[i], gaussians.rotations[i], gaussians.log_scales[i], psi);
            *mean = moved.geometry.mean;
            *rotation = moved.geometry.rotation;
            *scale = moved.geometry.scale;
            *opacity = sigmoid(gaussians.opacity_logits[i]);
            *colour = std::array::from_fn(|c| gaussians.colours[i][c] + psi[COLOUR_CHANNEL + c]);
        },
    );
    let dim = if features { gaussians.latent_dim } else { 0 };
    out.features.resize(n * dim, 0.0);
    if dim > 0 {
        let net = deformation.feature_net();
        out.features.par_chunks_mut(dim).zip(psi.par_chunks(stride)).with_min_len(1024).enumerate().for_each(
            |(i, (out, psi))| {
                let gate = &psi[deformation.gate_channel..deformation.gate_channel + dim];
                gate_feature(&net, &gaussians.features[i * dim..(i + 1) * dim], gate, time, out);
            },
        );
    }
}

impl Deformed {
    /// Returns centre, rotation and scale of Gaussian `i`.
    pub fn geometry(&self, i: usize) -> Geometry<f32> {
        Geometry { mean: self.means[i], rotation: self.rotations[i], scale: self.scales[i] }
    }

    /// Makes room for `n` Gaussians; the contents have no meaning.
    fn resize(&mut self, n: usize) {
        self.means.resize(n, [0.0; 3]);
        self.rotations.resize(n, [0.0; 4]);
        self.scales.resize(n, [0.0; 3]);
        self.opacities.resize(n, 0.0);
        self.colours.resize(n, [0.0; 3]);
    }
}

/// sum += factor · values.
fn add_scaled(sum: &mut [f32], factor: f32, values: &[f32]) {
    #[simd]
    fn kernel<S: Simd>(_: S, sum: &mut [f32], factor: f32, values: &[f32]) {
        for (sum, value) in sum.iter_mut().zip(values) {
            *sum += factor * value;
        }
    }
    dispatch!(Level::new(), simd => kernel(simd, sum, factor, values));
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_still_scene_stays_as_it_is() {
        let gaussians = Gaussians {
            means: vec![[1.0, 2.0, 3.0]],
            rotations: vec![[2.0, 0.0, 0.0, 0.0]],
            log_scales: vec![[0.0, -1.0, 1.0]],
            opacity_logits: vec![0.0],
            colours: vec![[0.1, 0.2, 0.3]],
            features: vec![0.5, -0.5, 1.0],
            latent_dim: 3,
            ..Default::default()
        };
        let deformation = Deformation::at_rest(1, 3, 17, 0.05, GATE_SLOPE);
        let d = deform(&gaussians, &deformation, 0.3, true);
        assert_eq!(d.means, gaussians.means);
        assert_eq!(d.rotations, vec![[1.0, 0.0, 0.0, 0.0]]);
        assert_eq!(d.scales[0][0], 1.0);
        assert_eq!(d.opacities, vec![0.5]);
        assert_eq!(d.features, gaussians.features);
    }

    #[test]
    fn gaussians_follow_a_motion_of_the_world() {
        let gaussians = Gaussians {
            means: vec![[1.0, 2.0, 3.0], [-20.0, 5.0, 90.0]],
            rotations: vec![[1.0, 0.0, 0.0, 0.0]; 2],
            log_scales: vec![[0.0; 3]; 2],
            opacity_logits: vec![0.0; 2],
            colours: vec![[0.0; 3]; 2],
            ..Default::default()
        };
        let mut deformation = Deformation::at_rest(2, 0, 21, 0.05, GATE_SLOPE);
        deformation.shape = BasisShape::Spline;
        let motion = |time: f32| {
            let phase = 12.0 * time;
            let turn = Affine3A::from_axis_angle(glam::Vec3::Y, 0.02 * phase.sin());
            Affine3A::from_translation(glam::Vec3::new(0.0, 2.0 * phase.cos(), 1.0)) * turn
        };
        let motions: Vec<_> = (0..48).map(|i| i as f32 / 48.0).map(|time| (time, motion(time))).collect();
        deformation.follow(&gaussians.means, &motions);
        for (time, motion) in &motions {
            let moved = deform(&gaussians, &deformation, *time, false).means;
            for (rest, there) in gaussians.means.iter().zip(moved) {
                let expected = motion.transform_point3((*rest).into());
                assert!(expected.distance(there.into()) < 0.12, "{there:?} instead of {expected} at {time}");
            }
        }
    }

    #[test]
    fn another_unit_of_time_changes_no_motion() {
        let (n, first, len) = (3, 0.4, 0.1);
        for shape in [BasisShape::Gaussian, BasisShape::Quartic, BasisShape::Spline] {
            let mut before = Deformation::at_rest(n, 0, 41, 0.01, GATE_SLOPE);
            before.shape = shape;
            before.weights.iter_mut().enumerate().for_each(|(i, w)| *w = (i as f32).sin());
            let mut after = before.clone();
            after.begin_at(first, len);
            for share in [0.0, 0.13, 0.5, 0.88, 1.0] {
                let pairs = before.psi(n, first + share * len).into_iter().zip(after.psi(n, share));
                for (before, after) in pairs {
                    assert!((before - after).abs() < 1e-2, "{shape:?}: {before}, then {after}");
                }
            }
        }
    }

    #[test]
    fn shared_bases_equal_the_same_bases_held_by_every_gaussian() {
        let n = 5;
        let mut shared = Deformation::at_rest(n, 3, 7, 0.1, GATE_SLOPE);
        for (i, w) in shared.weights.iter_mut().enumerate() {
            *w = ((i * 37 % 101) as f32 / 101.0) - 0.5;
        }
        let own = shared.clone().with_own_bases();
        assert!(shared.is_shared() && !own.is_shared());
        for time in [0.0, 0.31, 0.98] {
            for (a, b) in shared.psi(n, time).iter().zip(own.psi(n, time)) {
                assert!((a - b).abs() < 1e-6);
            }
        }
    }
}
