//! Where the time of training goes, pass by pass.

use std::time::{Duration, Instant};

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

impl Pass {
    /// All of them, in order.
    pub const ALL: [Self; 8] = [
        Self::Deform,
        Self::Project,
        Self::Bin,
        Self::Raster,
        Self::Loss,
        Self::Backward,
        Self::Chain,
        Self::Adam,
    ];
}

/// Adds up the time of each pass.
#[derive(Clone, Debug, Default)]
pub struct PassClock {
    spent: [Duration; Pass::ALL.len()],
    lap: Option<Instant>,
}

impl PassClock {
    /// A step begins.
    pub(super) fn start(&mut self) {
        self.lap = Some(Instant::now());
    }

    /// `pass` is done; the next one begins.
    pub(super) fn lap(&mut self, pass: Pass) {
        let now = Instant::now();
        if let Some(before) = self.lap.replace(now) {
            self.spent[pass as usize] += now - before;
        }
    }

    /// Seconds spent in a pass.
    pub fn seconds(&self, pass: Pass) -> f64 {
        self.spent[pass as usize].as_secs_f64()
    }
}
