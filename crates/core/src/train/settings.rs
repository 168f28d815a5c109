//! Every choice of training, in one place; recorded in the scene file.

use super::loss::LossWeights;

/// Learning rates; those of lengths are in pixels of the full-size image at the typical depth.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct LearningRates {
    /// Centres, px.
    pub mean_px: f32,
    /// Basis weights of the centres, px.
    pub motion_px: f32,
    /// Basis weights of rotation, scale, colour and gate, relative to the rate of the parameter they move.
    pub motion_relative: f32,
    /// Rates of centres and basis weights fall log-linearly to this share over training.
    pub final_share: f32,
    /// Quaternions.
    pub rotation: f32,
    /// Log-scales.
    pub log_scale: f32,
    /// Opacity logits.
    pub opacity: f32,
    /// Band-0 colours.
    pub colour: f32,
    /// Higher colour bands.
    pub sh_rest: f32,
    /// Latent features and the feature network.
    pub feature: f32,
}

/// When and how Gaussians are added and removed.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct DensifySettings {
    /// First step that may densify, as a share of all steps.
    pub from: f32,
    /// Last step that may densify, as a share of all steps.
    pub until: f32,
    /// Steps between two densifications.
    pub every: usize,
    /// Share of the Gaussians that may be added each time, those of largest positional gradient first.
    pub growth: f32,
    /// Never more than this many Gaussians.
    pub max_gaussians: usize,
    /// Gaussians whose opacity falls below are removed.
    pub min_opacity: f32,
    /// Gaussians larger than this (standard deviation, px) are split, smaller ones are cloned.
    pub split_px: f32,
}

/// Training settings.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct TrainSettings {
    /// Optimiser steps.
    pub iterations: usize,
    /// Seed of everything random.
    pub seed: u64,
    /// Hold test frames out.
    pub eval: bool,
    /// Supervised pixels per initial Gaussian.
    pub px_per_gaussian: f32,
    /// Number of temporal basis functions.
    pub num_bases: usize,
    /// Width σ of a basis function, in units of the distance between two centres.
    pub basis_width: f32,
    /// Whether colour may change over time.
    pub colour_over_time: bool,
    /// Slope δ of the feature gate (2.5 in the paper).
    pub gate_slope: f32,
    /// Spherical-harmonic degree where the camera moves; 0 where it is still.
    pub sh_degree: usize,
    /// Share of the steps done at half size, first.
    pub half_size_share: f32,
    /// Learning rates.
    pub rates: LearningRates,
    /// Adding and removing Gaussians.
    pub densify: DensifySettings,
    /// Weights of the loss terms.
    pub loss: LossWeights,
    /// Decoded frames kept in memory, bytes.
    pub frame_cache_bytes: usize,
}

impl Default for TrainSettings {
    fn default() -> Self {
        Self {
            iterations: 3000,
            seed: 0,
            eval: false,
            px_per_gaussian: 10.0,
            num_bases: 17,
            basis_width: 0.8,
            colour_over_time: true,
            gate_slope: 2.5,
            sh_degree: 1,
            half_size_share: 0.3,
            rates: LearningRates {
                mean_px: 0.02,
                motion_px: 0.05,
                motion_relative: 1.0,
                final_share: 0.05,
                rotation: 2e-3,
                log_scale: 5e-3,
                opacity: 0.05,
                colour: 2.5e-3,
                sh_rest: 1.25e-4,
                feature: 2.5e-3,
            },
            densify: DensifySettings {
                from: 0.1,
                until: 0.7,
                every: 100,
                growth: 0.06,
                max_gaussians: 60_000,
                min_opacity: 0.005,
                split_px: 1.5,
            },
            loss: LossWeights::default(),
            frame_cache_bytes: 1 << 30,
        }
    }
}
