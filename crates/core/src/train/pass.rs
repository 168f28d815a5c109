//! The passes of training.

use crate::clock::PassName;

/// The passes of a step, in order.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Pass {
    /// ψ(t) and the Gaussians at time t.
    Deform,
    /// Projection and packing.
    Project,
    /// Depth order and tiles.
    Bin,
    /// Blending.
    Raster,
    /// Loss and its gradient.
    Loss,
    /// Blending backwards.
    Backward,
    /// Projection and deformation backwards.
    Chain,
    /// The update.
    Adam,
}

impl PassName for Pass {
    const ALL: &'static [Self] = &[
        Self::Deform,
        Self::Project,
        Self::Bin,
        Self::Raster,
        Self::Loss,
        Self::Backward,
        Self::Chain,
        Self::Adam,
    ];
    fn number(self) -> usize {
        self as usize
    }
}
