//! The Gaussians at rest, as a structure of arrays.

pub mod init;

/// Raw (unactivated) parameters of N Gaussians at rest; every array has N rows.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Gaussians {
    /// Centres in the world, scene units.
    pub means: Vec<[f32; 3]>,
    /// Quaternions (w, x, y, z), not normalised.
    pub rotations: Vec<[f32; 4]>,
    /// Natural logarithm of the standard deviation along each axis, scene units.
    pub log_scales: Vec<[f32; 3]>,
    /// Logit of opacity.
    pub opacity_logits: Vec<f32>,
    /// Spherical-harmonic band 0 of the colour: rgb = 0.5 + [`SH_C0`] · value.
    pub colours: Vec<[f32; 3]>,
    /// Higher bands, [N][bands][3] flat with bands = (degree + 1)² − 1; empty for degree 0.
    pub sh_rest: Vec<f32>,
    /// Degree of the spherical harmonics, 0..=3; 0 if the camera never moves.
    pub sh_degree: usize,
    /// Latent features, [N][latent_dim] flat.
    pub features: Vec<f32>,
    /// Latent numbers per Gaussian, D; 0 for a scene without features.
    pub latent_dim: usize,
}

/// Largest number of spherical-harmonic bands above 0, that of degree 3.
pub const MAX_SH_BANDS: usize = 15;

/// Y₀₀, the constant spherical harmonic.
pub const SH_C0: f32 = 0.282_094_79;

impl Gaussians {
    /// Returns the number of Gaussians.
    pub fn len(&self) -> usize {
        self.means.len()
    }
    /// Returns `true` if there are no Gaussians.
    pub fn is_empty(&self) -> bool {
        self.means.is_empty()
    }
    /// Number of spherical-harmonic bands above 0: (degree + 1)² − 1.
    pub fn sh_bands(&self) -> usize {
        (self.sh_degree + 1) * (self.sh_degree + 1) - 1
    }
}
