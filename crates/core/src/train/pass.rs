//! The passes of training.

use crate::clock::PassName;

/// The passes of a step, in order.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Pass {
    /// Computes ψ(t) and the Gaussians at time t.
    Deform,
    /// Projects and packs.
    Project,
    /// Sorts by depth and distributes over tiles.
    Bin,
    /// Blends.
    Raster,
    /// Computes the loss and its gradient.
    Loss,
    /// Blends backwards.
    Backward,
    /// Projects and deforms backwards.
    Chain,
    /// Updates the parameters.
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
