//! Everything that a step of training changes.

use super::optimiser::Optimiser;
use crate::{
    deform::Deformation,
    gaussian::Gaussians,
    raster::project::{Splat, SplatGradient},
};

/// Everything that a step changes.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Model {
    /// Gaussians at rest.
    pub gaussians: Gaussians,
    /// Their motion.
    pub deformation: Deformation,
    /// Moments of all parameters.
    pub optimiser: Optimiser,
    /// Statistics since the last densification.
    pub statistics: Statistics,
}

impl Model {
    /// Makes a model with zero moments and empty statistics.
    pub fn new(gaussians: Gaussians, deformation: Deformation) -> Self {
        Self {
            optimiser: Optimiser::new(&gaussians, &deformation),
            statistics: Statistics::new(gaussians.len()),
            gaussians,
            deformation,
        }
    }
}

/// Statistics of each Gaussian since the last densification.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Statistics {
    /// Σ ‖∂L/∂centre‖, per px of the full-size image.
    pub pull: Vec<f32>,
    /// Number of frames in which it was visible.
    pub seen: Vec<u32>,
}

impl Statistics {
    /// Makes empty statistics for `n` Gaussians.
    pub fn new(n: usize) -> Self {
        Self { pull: vec![0.0; n], seen: vec![0; n] }
    }

    /// Adds one frame; `scale` converts from its pixels to the unit of the statistics.
    pub fn add(&mut self, splats: &[Splat<f32>], g: &[SplatGradient<f32>], scale: [f32; 2]) {
        for (i, (splat, g)) in splats.iter().zip(g).enumerate() {
            if splat.is_visible() {
                self.pull[i] += (g.centre[0] * scale[0]).hypot(g.centre[1] * scale[1]);
                self.seen[i] += 1;
            }
        }
    }
}
