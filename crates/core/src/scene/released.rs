//! The released form of a scene: what the released code can express, as near to the scene as may be (method
//! §6.5).

use super::{Scene, fit::fit_motion};
use crate::deform::{
    BasisShape, COLOUR_CHANNEL, Deformation, GATE_CHANNEL, MEAN_CHANNEL, RELEASED_GATE_SLOPE, SCALE_CHANNEL,
    deform,
};
use std::ops::Range;

/// Largest number of basis functions in the released code's form.
pub const RELEASED_BASES: usize = 17;
/// Number of deformed channels in the released configuration: centre, quaternion, log-scale, in our order.
pub(super) const GEOMETRY: usize = COLOUR_CHANNEL;
/// Number of latent values of the released code.
pub(super) const DIM: usize = 3;
/// √(σ² + 1e-4) of bases that replace others, in units of the distance between two centres. Of values from
/// 0.7 to 3 this one follows 17 splines best.
const FITTED_WIDTH: f32 = 1.6;

/// A scene with nothing that the released code's format cannot hold.
#[derive(Clone, Debug)]
pub struct Released {
    /// The scene: at most 17 quartic bases, one colour for all times, three latent numbers or none.
    pub scene: Scene,
    /// Properties of the original that are not in it, each a clause.
    pub lost: Vec<String>,
}

impl Scene {
    /// Returns the scene in the released code's form. Its motion is fitted with 17 bases; changes that the
    /// form cannot hold are averaged over time. A scene that was trained like the released code stays as it
    /// is.
    pub fn released(&self) -> Released {
        let mut lost = Vec::new();
        let mut scene = self.clone();
        self.average(&mut scene, &mut lost);
        *scene.deformation = self.released_motion(scene.gaussians.latent_dim, &mut lost);
        Released { scene, lost }
    }

    /// Returns the motion with at most 17 quartic bases.
    fn released_motion(&self, latent_dim: usize, lost: &mut Vec<String>) -> Deformation {
        let (d, n) = (&*self.deformation, self.gaussians.len());
        let mut released = if d.shape == BasisShape::Quartic && d.num_bases <= RELEASED_BASES {
            let mut same = d.clone();
            let rows = same.weights.chunks_exact_mut(same.stride);
            rows.for_each(|row| row[COLOUR_CHANNEL..].fill(0.0));
            same
        } else {
            let (fitted, error) = fitted(d, n, latent_dim, &self.moments());
            if self.changes(0..GEOMETRY) {
                lost.push(format!(
                    "motion is fitted with {RELEASED_BASES} bases: centres are right to {error:.2e} scene units (root mean square)"
                ));
            }
            fitted
        };
        if !self.has_released_gate() {
            released.feature_weight = vec![0.0; latent_dim * (latent_dim + 1)];
            released.feature_bias = vec![0.0; latent_dim];
            (released.gate_channel, released.gate_slope) = (SCALE_CHANNEL, RELEASED_GATE_SLOPE);
        }
        released
    }

    /// Returns the times that motion is fitted at: those of the frames, and more between few frames.
    fn moments(&self) -> Vec<f32> {
        let samples = self.num_frames().max(4 * RELEASED_BASES);
        let even = (0..samples).map(|k| k as f32 / samples as f32);
        (0..self.num_frames()).map(|i| self.time(i)).chain(even).collect()
    }

    /// Averages colours over the frames in `still`, and features if the released code could not deform them
    /// the same way.
    fn average(&self, still: &mut Self, lost: &mut Vec<String>) {
        let (g, frames) = (&mut *still.gaussians, self.num_frames().max(1));
        let mut colours = vec![0.0; g.colours.as_flattened().len()];
        let mut features = vec![0.0; g.features.len()];
        for i in 0..frames {
            let now = deform(&self.gaussians, &self.deformation, self.time(i), true);
            let share = 1.0 / frames as f32;
            colours.iter_mut().zip(now.colours.as_flattened()).for_each(|(sum, c)| *sum += share * c);
            features.iter_mut().zip(&now.features).for_each(|(sum, f)| *sum += share * f);
        }
        if self.changes(COLOUR_CHANNEL..GATE_CHANNEL) {
            g.colours = colours.as_chunks().0.to_vec();
            lost.push("colour does not change over time".into());
        }
        match g.latent_dim {
            0 => {}
            DIM if self.has_released_gate() => {}
            DIM => {
                g.features = features;
                lost.push("features are averaged over time".into());
            }
            other => {
                (g.features, g.latent_dim) = (Vec::new(), 0);
                lost.push(format!("features have {other} numbers instead of {DIM} and are left out"));
            }
        }
    }

    fn has_released_gate(&self) -> bool {
        let d = &self.deformation;
        self.gaussians.latent_dim == DIM
            && d.gate_channel == SCALE_CHANNEL
            && d.gate_slope == RELEASED_GATE_SLOPE
    }

    /// Returns `true` if any of these channels moves.
    fn changes(&self, channels: Range<usize>) -> bool {
        let d = &self.deformation;
        d.weights.chunks_exact(d.stride).any(|row| row[channels.clone()].iter().any(|w| *w != 0.0))
    }
}

/// Returns the released code's bases with the weights that follow centres, rotations and scales best at
/// `times`, and by how much centres are off.
fn fitted(d: &Deformation, n: usize, latent_dim: usize, times: &[f32]) -> (Deformation, f64) {
    let mut fitted = Deformation::at_rest(n, latent_dim, RELEASED_BASES, 0.0, d.gate_slope);
    (fitted.shape, fitted.gate_channel) = (BasisShape::Quartic, d.gate_channel);
    if d.feature_bias.len() == latent_dim {
        fitted.feature_weight.clone_from(&d.feature_weight);
        fitted.feature_bias.clone_from(&d.feature_bias);
    }
    let spacing = FITTED_WIDTH / (RELEASED_BASES - 1) as f32;
    fitted.widths.fill((spacing * spacing - 1e-4).max(0.0).sqrt());
    fit_motion(&mut fitted, d, n, times, 0..GEOMETRY);
    let error = motion_error(d, &fitted, n, times);
    (fitted, error)
}

/// Returns the root mean square distance between two motions of the centres.
fn motion_error(a: &Deformation, b: &Deformation, n: usize, times: &[f32]) -> f64 {
    let mut sum = 0.0;
    for time in times {
        let (a_psi, b_psi) = (a.psi(n, *time), b.psi(n, *time));
        let rows = a_psi.chunks_exact(a.stride).zip(b_psi.chunks_exact(b.stride));
        sum += rows
            .flat_map(|(a, b)| (MEAN_CHANNEL..MEAN_CHANNEL + 3).map(|c| f64::from(a[c] - b[c]).powi(2)))
            .sum::<f64>();
    }
    (sum / (n * times.len()).max(1) as f64).sqrt()
}
