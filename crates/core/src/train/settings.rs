//! Every choice of training, in one place; recorded in the scene file. What the released code does otherwise has a
//! switch of its own, so that both can be compared (method §0.1, §6, §11.1).

use super::loss::LossWeights;
use crate::deform::BasisShape;

/// A basis function of time for so many frames.
const FRAMES_PER_BASIS: usize = 3;
/// Never more than this many of them.
const MAX_BASES: usize = 64;
/// The longest recording that still has as many as it needs.
pub const LONGEST: usize = MAX_BASES * FRAMES_PER_BASIS - 1;
/// Held-out PSNR in dB of the demo at so many frames, after 1500 steps.
const PSNR_OF_LENGTH: [(f64, f64); 5] =
    [(48.0, 36.7), (96.0, 34.9), (200.0, 32.7), (800.0, 24.6), (2000.0, 24.4)];

/// PSNR that is lost against a recording of [`LONGEST`] frames, dB, by what was measured on the demo.
pub fn length_loss_db(num_frames: usize) -> f64 {
    let psnr = |frames: f64| {
        let [(_, first), .., (_, last)] = PSNR_OF_LENGTH;
        let between = PSNR_OF_LENGTH.windows(2).find(|pair| (pair[0].0..pair[1].0).contains(&frames));
        match between {
            Some(pair) => {
                let share = (frames / pair[0].0).ln() / (pair[1].0 / pair[0].0).ln();
                pair[0].1 + share * (pair[1].1 - pair[0].1)
            }
            None => {
                if frames < PSNR_OF_LENGTH[0].0 {
                    first
                } else {
                    last
                }
            }
        }
    };
    (psnr(LONGEST as f64) - psnr(num_frames as f64)).max(0.0)
}

/// Which defaults to start from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Profile {
    /// The paper's formulas, and better where measured.
    #[default]
    Default,
    /// What the authors' released code does, for comparison.
    Paper,
}

/// In which order frames are visited.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum FrameOrder {
    /// At random, every frame once a round.
    Random,
    /// One after the other.
    Cyclic,
}

/// What learning rates of lengths are measured in.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum LengthUnit {
    /// A pixel of the full-size image at the typical depth.
    Pixel,
    /// The scene's unit, whatever its size.
    Scene,
}

/// Learning rates.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct LearningRates {
    /// What `mean` and `motion` are measured in.
    pub unit: LengthUnit,
    /// Centres.
    pub mean: f32,
    /// Basis weights of the centres.
    pub motion: f32,
    /// Basis weights of rotation, scale, colour and gate, relative to the rate of the parameter they move.
    pub motion_relative: f32,
    /// Basis weights of all channels at the rate of those of the centres.
    pub uniform_motion: bool,
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
    /// Where above 0: add all whose mean positional gradient, in half image sizes, exceeds this, and no others.
    pub threshold: f32,
    /// Never clone; both halves of a split are placed at random.
    pub split_only: bool,
    /// The step that densifies updates nothing.
    pub loses_step: bool,
    /// Never more than this many Gaussians.
    pub max_gaussians: usize,
    /// Never more than one for so many supervised pixels: long runs on small images end somewhere, too.
    pub min_px_per_gaussian: f32,
    /// Gaussians whose opacity falls below are removed.
    pub min_opacity: f32,
    /// Gaussians larger than this (standard deviation, px) are split, smaller ones are cloned.
    pub split_px: f32,
}

/// How features come about.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum FeatureMode {
    /// Learned with everything else, from nothing.
    Learned,
    /// Learned with everything else, from the mean of what each first Gaussian shows.
    LiftedFirst,
    /// Not learned: in the end, the mean of what each Gaussian shows. Faster, and features then stay as they are over
    /// time.
    Lifted,
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
    /// Nothing is learned from frames of these ranges, both ends included; e.g. what is seen outside of the body.
    pub excluded: Vec<(usize, usize)>,
    /// The order of the frames.
    pub frame_order: FrameOrder,
    /// Supervised pixels per initial Gaussian.
    pub px_per_gaussian: f32,
    /// Opacity of an initial Gaussian.
    pub initial_opacity: f32,
    /// Initial sizes from the distances to the three nearest neighbours, not from the spacing in the image.
    pub neighbour_sizes: bool,
    /// Initial Gaussians from test frames too.
    pub seed_test_frames: bool,
    /// Number of temporal basis functions; 0 for one per three frames, at most 64: a step costs the same however many
    /// there are, memory does not.
    pub num_bases: usize,
    /// Shape of a basis function.
    pub basis_shape: BasisShape,
    /// Width σ of a basis function, in units of the distance between two centres.
    pub basis_width: f32,
    /// Every Gaussian and channel learns its own centres and widths of the basis functions.
    pub own_bases: bool,
    /// Whether colour may change over time.
    pub colour_over_time: bool,
    /// Slope δ of the feature gate (2.5 in the paper).
    pub gate_slope: f32,
    /// The gate reads the channels of scale instead of its own.
    pub gate_on_scale: bool,
    /// How features come about.
    pub feature_mode: FeatureMode,
    /// Whether features may change over time (the paper's deformation tracking).
    pub feature_motion: bool,
    /// Spherical-harmonic degree.
    pub sh_degree: usize,
    /// Spherical harmonics even if the camera is still, where they can tell nothing.
    pub sh_when_still: bool,
    /// Steps after which the next degree is learned too; 0 for all from the start.
    pub sh_every: usize,
    /// Whether the gradient of depth moves centres.
    pub depth_moves_centres: bool,
    /// Share of the steps done at half size, first.
    pub half_size_share: f32,
    /// A step of full size looks at one pixel of every square of this many columns and rows, another one each time.
    pub pixel_step: usize,
    /// The same for a step of half size.
    pub half_size_pixel_step: usize,
    /// Never fewer pixels than these for being looked at one of so many: a small image is looked at whole.
    pub min_pixels: usize,
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
            excluded: Vec::new(),
            frame_order: FrameOrder::Random,
            px_per_gaussian: 10.0,
            initial_opacity: 0.6,
            neighbour_sizes: false,
            seed_test_frames: false,
            num_bases: 0,
            basis_shape: BasisShape::Spline,
            basis_width: 1.0,
            own_bases: false,
            colour_over_time: true,
            gate_slope: 2.5,
            gate_on_scale: false,
            feature_mode: FeatureMode::Learned,
            feature_motion: true,
            sh_degree: 1,
            sh_when_still: false,
            sh_every: 0,
            depth_moves_centres: true,
            half_size_share: 0.5,
            pixel_step: 2,
            half_size_pixel_step: 2,
            min_pixels: 20_000,
            rates: LearningRates {
                unit: LengthUnit::Pixel,
                mean: 0.02,
                motion: 0.1,
                motion_relative: 2.0,
                uniform_motion: false,
                final_share: 0.05,
                rotation: 2e-3,
                log_scale: 1e-2,
                opacity: 0.05,
                colour: 5e-3,
                sh_rest: 1.25e-4,
                feature: 2.5e-3,
            },
            densify: DensifySettings {
                from: 0.1,
                until: 0.7,
                every: 100,
                growth: 0.05,
                threshold: 0.0,
                split_only: false,
                loses_step: false,
                max_gaussians: 32_000,
                min_px_per_gaussian: 4.0,
                min_opacity: 0.005,
                split_px: 1.5,
            },
            loss: LossWeights::default(),
            frame_cache_bytes: 1 << 30,
        }
    }
}

impl TrainSettings {
    /// The settings of a profile.
    pub fn of(profile: Profile) -> Self {
        match profile {
            Profile::Default => Self::default(),
            Profile::Paper => Self::paper(),
        }
    }

    /// Basis functions for a recording of so many frames.
    pub fn num_bases(&self, num_frames: usize) -> usize {
        if self.num_bases > 0 {
            self.num_bases.max(2)
        } else {
            (num_frames / FRAMES_PER_BASIS + 1).clamp(5, MAX_BASES)
        }
    }

    /// What is lost of a recording of so many frames; `None` where it is not too long, or where the number of basis functions
    /// was chosen.
    pub fn length_warning(&self, num_frames: usize) -> Option<String> {
        if self.num_bases > 0 || num_frames <= LONGEST {
            return None;
        }
        let every = num_frames.div_ceil(LONGEST);
        Some(format!(
            "The recording has {num_frames} frames, and motion is learned in full up to {LONGEST}: beyond that a reconstruction \
             gets worse, here by about {:.0} dB. Use one frame in {every} (`every = {every}` under `[time]` in its settings file), \
             a part of it (`first` and `last` under `[frames]`), or cut it into parts of at most {LONGEST} frames",
            length_loss_db(num_frames)
        ))
    }

    /// Whether step `step` (counted from 1) is followed by a densification.
    pub(super) fn densifies_at(&self, step: usize) -> bool {
        let d = &self.densify;
        let at = |share: f32| (share * self.iterations as f32) as usize;
        step >= at(d.from) && step <= at(d.until) && step.is_multiple_of(d.every.max(1))
    }

    /// How many of the colour's `bands` above 0 are learned at `step`.
    pub fn learned_bands(&self, bands: usize, step: usize) -> usize {
        if self.sh_every == 0 {
            return bands;
        }
        let degree = step / self.sh_every;
        ((degree + 1) * (degree + 1) - 1).min(bands)
    }

    /// The released code's constants (method §2, §3, §5, §6), as shares of its 3000 steps.
    fn paper() -> Self {
        Self {
            frame_order: FrameOrder::Cyclic,
            initial_opacity: 0.1,
            neighbour_sizes: true,
            seed_test_frames: true,
            num_bases: 17,
            basis_shape: BasisShape::Quartic,
            // σ = 0.01 with 17 centres.
            basis_width: 0.16,
            own_bases: true,
            colour_over_time: false,
            gate_slope: 1.5,
            gate_on_scale: true,
            sh_degree: 3,
            sh_when_still: true,
            sh_every: 500,
            depth_moves_centres: false,
            half_size_share: 0.0,
            pixel_step: 1,
            half_size_pixel_step: 1,
            rates: LearningRates {
                unit: LengthUnit::Scene,
                mean: 1.6e-3,
                motion: 1.6e-3,
                uniform_motion: true,
                // To 1 % at step 4000, of which 3000 are done.
                final_share: 0.031_622_78,
                rotation: 1e-3,
                log_scale: 5e-3,
                colour: 2.5e-3,
                ..Self::default().rates
            },
            densify: DensifySettings {
                from: 0.2,
                until: 1.0,
                threshold: 2e-4,
                split_only: true,
                loses_step: true,
                max_gaussians: 500_000,
                min_px_per_gaussian: 0.0,
                ..Self::default().densify
            },
            loss: LossWeights {
                raw_depth: true,
                pooled_regions: true,
                unmasked_variation: true,
                ..LossWeights::default()
            },
            ..Self::default()
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_length_costs_is_told_from_where_bases_run_out() {
        let settings = TrainSettings::default();
        assert_eq!(settings.num_bases(LONGEST), LONGEST / FRAMES_PER_BASIS + 1);
        const { assert!(LONGEST / FRAMES_PER_BASIS < MAX_BASES) };
        const { assert!((LONGEST + 1) / FRAMES_PER_BASIS + 1 > MAX_BASES) };
        assert_eq!(settings.length_warning(LONGEST), None);
        let text = settings.length_warning(800).unwrap();
        assert!(
            text.contains("800 frames") && text.contains("up to 191") && text.contains("about 8 dB"),
            "{text}"
        );
        assert!(text.contains("`every = 5`"), "{text}");
        assert_eq!(TrainSettings { num_bases: 17, ..settings }.length_warning(800), None);
    }

    #[test]
    fn losses_grow_with_length_between_what_was_measured() {
        assert_eq!(length_loss_db(48), 0.0);
        let losses = [192, 250, 400, 800, 1500, 2000, 100_000].map(length_loss_db);
        assert!(losses.is_sorted(), "{losses:?}");
        assert!((losses[3] - losses[5]).abs() < 0.3 && (8.0..8.5).contains(&losses[5]), "{losses:?}");
    }
}
