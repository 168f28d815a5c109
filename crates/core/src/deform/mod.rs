//! How the Gaussians move, turn, stretch and change over time (method §3).
//!
//! ψ_c(t) = Σ_b ω_{b,c} · G(t; θ_b, σ_b) for each channel c of a Gaussian.

use crate::gaussian::Gaussians;

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

/// Shape of one basis function over time.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum BasisShape {
    /// exp(−(t − θ)² / (2σ²)): the paper's Eq. 1.
    Gaussian,
    /// exp(−((t − θ)² / (σ² + 1e-4))²): what the released code computes.
    Quartic,
}

/// Basis weights of all Gaussians, and the basis functions they weigh.
#[derive(Clone, Debug, PartialEq)]
pub struct Deformation {
    /// Shape of every basis function.
    pub shape: BasisShape,
    /// Number of basis functions, B.
    pub num_bases: usize,
    /// Floats per Gaussian and basis: the channels, padded to a multiple of 16.
    pub stride: usize,
    /// ω, [B][N][stride] flat; basis-major so that the live bases are a contiguous block.
    pub weights: Vec<f32>,
    /// θ: [B] when shared by all Gaussians, else [B][N][stride].
    pub centres: Vec<f32>,
    /// σ: as `centres`.
    pub widths: Vec<f32>,
    /// Slope δ of the gate σ(δψ^f).
    pub gate_slope: f32,
    /// The feature network g([f, t]) = W [f; t] + b: W as [D][D + 1] flat.
    pub feature_weight: Vec<f32>,
    /// b, [D].
    pub feature_bias: Vec<f32>,
}

/// The Gaussians at one time, activated: what every later pass reads.
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
    /// G(t; θ_b, σ_b) of shared bases, and the range of bases whose value is above [`LIVE_BASIS`].
    pub fn basis_values(&self, time: f32) -> (Vec<f32>, std::ops::Range<usize>) {
        let _ = time;
        todo!()
    }
    /// Whether all Gaussians share centres and widths.
    pub fn is_shared(&self) -> bool {
        self.centres.len() == self.num_bases
    }
}

/// Bases with a smaller value at t are neither evaluated nor updated.
pub const LIVE_BASIS: f32 = 1e-4;

/// Deforms and activates all Gaussians at time `t`; the CPU twin of `shaders/deform.wgsl`.
pub fn deform(gaussians: &Gaussians, deformation: &Deformation, time: f32, features: bool) -> Deformed {
    let _ = (gaussians, deformation, time, features);
    todo!()
}
