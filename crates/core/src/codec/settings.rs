//! Settings and shape of a codec.

/// Stage of the training in its progress.
pub(super) const STAGE: &str = "training the codec";
/// Widths of the encoder's hidden layers.
pub(super) const ENCODER_HIDDEN: [usize; 4] = [256, 128, 64, 32];
/// Widths of the decoder's hidden layers.
pub(super) const DECODER_HIDDEN: [usize; 6] = [16, 32, 64, 128, 256, 256];

/// Kind of a codec.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum CodecKind {
    /// A network with few latent numbers, which snaps to classes where there are few.
    #[default]
    Network,
    /// One latent number for each of up to 16 different features, in closed form.
    Codebook,
}

/// Settings of a codec's training.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct CodecSettings {
    /// Kind of the codec.
    #[serde(default)]
    pub kind: CodecKind,
    /// Latent numbers per pixel of a network, 1..=16.
    pub latent_dim: usize,
    /// Optimiser steps.
    pub steps: usize,
    /// Seed of initial weights and batches.
    pub seed: u64,
}

impl Default for CodecSettings {
    fn default() -> Self {
        Self { kind: CodecKind::Network, latent_dim: 3, steps: 2000, seed: 0 }
    }
}
