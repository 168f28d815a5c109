//! The autoencoder that squeezes embeddings (512 and the like) into D latent numbers a pixel (method §7).

use crate::Result;
use ndarray::{Array1, Array2, ArrayView2};

/// `y = x Wᵀ + b`; weight is [out, in].
#[derive(Clone, Debug, PartialEq)]
pub struct Linear {
    /// [out, in].
    pub weight: Array2<f32>,
    /// [out].
    pub bias: Array1<f32>,
}

/// Encoder (dim → D, unit length) and decoder (D → dim, unit length).
/// Normalisation layers of training are folded into the linear layers; ReLU between layers, none after the last.
#[derive(Clone, Debug, PartialEq)]
pub struct Codec {
    /// Encoder layers in order.
    pub encoder: Vec<Linear>,
    /// Decoder layers in order.
    pub decoder: Vec<Linear>,
}

/// How a codec is trained.
#[derive(Clone, Debug, serde::Serialize, serde::Deserialize)]
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

impl Codec {
    /// Trains on embedding rows [n, dim] (unit length) with occurrence `weights` [n].
    pub fn train(
        rows: ArrayView2<'_, f32>,
        weights: &[f32],
        settings: &CodecSettings,
        progress: &mut dyn FnMut(usize, usize),
    ) -> Result<Self> {
        let _ = (rows, weights, settings, progress);
        todo!()
    }
    /// Latent numbers per pixel, D.
    pub fn latent_dim(&self) -> usize {
        self.decoder.first().map_or(0, |l| l.weight.ncols())
    }
    /// Length of an embedding.
    pub fn embedding_dim(&self) -> usize {
        self.decoder.last().map_or(0, |l| l.weight.nrows())
    }
    /// [n, dim] → [n, D], unit rows.
    pub fn encode(&self, rows: ArrayView2<'_, f32>) -> Array2<f32> {
        let _ = rows;
        todo!()
    }
    /// [n, D] → [n, dim], unit rows.
    pub fn decode(&self, latents: ArrayView2<'_, f32>) -> Array2<f32> {
        let _ = latents;
        todo!()
    }
}
