//! Settings and shape of a codec.

/// Stage of the training in its progress.
pub(super) const STAGE: &str = "training the codec";
/// Widths of the encoder's hidden layers.
pub(super) const ENCODER_HIDDEN: [usize; 4] = [256, 128, 64, 32];
/// Widths of the decoder's hidden layers.
pub(super) const DECODER_HIDDEN: [usize; 6] = [16, 32, 64, 128, 256, 256];

/// Settings of a codec's training.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct CodecSettings {
    /// Latent numbers per pixel, 1..=16.
    pub latent_dim: usize,
    /// Optimiser steps.
    pub steps: usize,
    /// Seed of initial weights and batches.
    pub seed: u64,
}

impl Default for CodecSettings {
    fn default() -> Self {
        Self { latent_dim: 3, steps: 2000, seed: 0 }
    }
}
