//! Indices of the numbers in the trainer's status on the device.

/// Not 0 if a gradient of the current step is not finite.
pub(super) const BAD: u32 = 0;
/// 1 after a step whose gradients may be used.
pub(super) const OK: u32 = 1;
/// 1 once pairs did not fit; from then on nothing is changed.
pub(super) const OVERFLOWN: u32 = 2;
/// Number of steps in the history.
pub(super) const DONE: u32 = 3;
/// Largest number of pairs that a step wanted.
pub(super) const WANTED: u32 = 4;
/// Number of updates so far of the parameters at rest.
pub(super) const COUNT_REST: u32 = 5;
/// Number of updates so far of colour bands above 0.
pub(super) const COUNT_SH_REST: u32 = 6;
/// Number of updates so far of features.
pub(super) const COUNT_FEATURES: u32 = 7;
/// Number of updates so far of the feature network.
pub(super) const COUNT_NETWORK: u32 = 8;
/// Number of updates so far of basis 0; those of the other bases follow.
pub(super) const COUNT_BASES: u32 = 9;
