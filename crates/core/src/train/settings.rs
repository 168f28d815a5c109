//! All settings of training in one place; recorded in the scene file. Differences from the released code have
//! switches of their own, so that both can be compared, but for those that method §0.1 calls not imitated
//! (method §0.1, §6, §11.1).

use super::{Quality, loss::LossWeights};
use crate::{
    deform::{BasisShape, GATE_SLOPE, RELEASED_GATE_SLOPE, default_bases, length_warning},
    prepare::{Origin, Prepared},
    scene::{Chapter, RELEASED_BASES},
    sequence::Sequence,
};
use std::ops::Range;

/// Sets of defaults.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Profile {
    /// The paper's formulas, with improvements that were measured.
    #[default]
    Default,
    /// The behaviour of the authors' released code, for comparison.
    Paper,
}

/// Number of frames of a chapter at most.
pub(super) const CHAPTER_FRAMES: usize = 96;
/// Number of frames of a neighbour that a chapter learns from.
pub(super) const OVERLAP: usize = 8;

/// Order in which frames are visited.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum FrameOrder {
    /// Random, every frame once a round.
    Random,
    /// Consecutive.
    Cyclic,
}

/// Unit of the learning rates of lengths.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum LengthUnit {
    /// A pixel of the full-size image at the typical depth.
    Pixel,
    /// The scene's unit, independent of its size.
    Scene,
}

/// Learning rates.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct LearningRates {
    /// Unit of `mean` and `motion`.
    pub unit: LengthUnit,
    /// Rate of centres.
    pub mean: f32,
    /// Rate of the basis weights of the centres.
    pub motion: f32,
    /// Rate of the basis weights of rotation, scale, colour and gate, relative to the rate of the
    /// parameter they move.
    pub motion_relative: f32,
    /// `true` to train the basis weights of all channels at the rate of those of the centres.
    pub uniform_motion: bool,
    /// Share of their start that the rates of centres and basis weights reach at the end; they fall
    /// log-linearly.
    pub final_share: f32,
    /// `true` if they fall less where frames are visited less than 200 times: to 10 / visits, at most 0.2.
    pub falls_by_visits: bool,
    /// Share of all steps, at the end, over which the rates of everything but features fall to zero, in a line:
    /// the last steps settle what the ones before leave shaking. 0 for none.
    pub cooldown: f32,
    /// Rate of quaternions.
    pub rotation: f32,
    /// Rate of log-scales.
    pub log_scale: f32,
    /// Rate of opacity logits.
    pub opacity: f32,
    /// Rate of band-0 colours.
    pub colour: f32,
    /// Rate of higher colour bands.
    pub sh_rest: f32,
    /// Rate of latent features and the feature network.
    pub feature: f32,
    /// Rate of a camera's pose, px of the picture for each round of all frames; it falls as that of centres
    /// does. 0 if poses stay as they are.
    pub pose: f32,
}

impl LearningRates {
    /// Share of their rates that falling at the end leaves at the share `progress` of training.
    pub fn cooldown_at(&self, progress: f32) -> f32 {
        if self.cooldown > 0.0 { ((1.0 - progress) / self.cooldown).clamp(0.0, 1.0) } else { 1.0 }
    }
}

/// Schedule and rules for adding and removing Gaussians.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct DensifySettings {
    /// First step that may densify, as a share of all steps.
    pub from: f32,
    /// Last step that may densify, as a share of all steps. None does after the last step of all, from which
    /// nothing would be learned.
    pub until: f32,
    /// Number of steps between two densifications; 0 for a fortieth of all steps, 10 to 100.
    pub every: usize,
    /// Share of the Gaussians that may be divided each time, those of largest mean positional gradient first.
    /// Without effect if `threshold` is above 0.
    pub growth: f32,
    /// If above 0: divides all Gaussians whose mean positional gradient, in half image sizes, is at least this,
    /// as far as `max_gaussians` allows, and no others.
    pub threshold: f32,
    /// `true` to never clone, and to place both halves of a split at random.
    pub split_only: bool,
    /// `true` if the step that densifies updates nothing.
    pub loses_step: bool,
    /// Largest number of Gaussians.
    pub max_gaussians: usize,
    /// Smallest number of supervised pixels per Gaussian, which ends the growth in long runs on small images.
    pub min_px_per_gaussian: f32,
    /// Smallest opacity; Gaussians that fall below are removed.
    pub min_opacity: f32,
    /// Size above which Gaussians are split (standard deviation, px); smaller ones are cloned.
    pub split_px: f32,
}

/// Ways to get the features.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum FeatureMode {
    /// Learned with everything else, starting at zero.
    Learned,
    /// Learned with everything else, starting at the mean of the features that each initial Gaussian shows.
    LiftedFirst,
    /// Not learned, but computed at the end: the mean of the features that each Gaussian shows. Faster,
    /// but features then do not change over time.
    Lifted,
}

/// Training settings.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct TrainSettings {
    /// Set of defaults that these settings began with; it also decides how the scene is asked.
    #[serde(default)]
    pub profile: Profile,
    /// Number of optimiser steps.
    pub iterations: usize,
    /// Seed of all random numbers.
    pub seed: u64,
    /// `true` to hold test frames out.
    pub eval: bool,
    /// Ranges of frames that nothing is learned from, both ends included; e.g. those seen outside of the
    /// body.
    pub excluded: Vec<(usize, usize)>,
    /// Number of frames that a chapter has at most; 0 to learn any recording as a whole. A recording of less than
    /// two chapters is cut where the shot changes alone.
    #[serde(default)]
    pub chapter_frames: usize,
    /// The chapter that is learned; `None` for the whole recording.
    #[serde(default)]
    pub chapter: Option<Chapter>,
    /// Order of the frames.
    pub frame_order: FrameOrder,
    /// `true` to give frames that repeat the one before the time of that one.
    pub finds_repeats: bool,
    /// `true` to estimate the poses of the camera where they are not known, and it moves.
    pub finds_path: bool,
    /// `true` to guess held-out frames from the frames around them, and to learn from the guesses.
    pub guesses_held_out: bool,
    /// Number of supervised pixels per initial Gaussian.
    pub px_per_gaussian: f32,
    /// Opacity of an initial Gaussian.
    pub initial_opacity: f32,
    /// `true` to derive initial sizes from the distances to the three nearest neighbours, not from the
    /// spacing in the image.
    pub neighbour_sizes: bool,
    /// `true` to place initial Gaussians on test frames too.
    pub seed_test_frames: bool,
    /// Number of temporal basis functions; 0 for one per three frames, at most 64. The time of a step
    /// does not depend on it, the memory does.
    pub num_bases: usize,
    /// Shape of a basis function.
    pub basis_shape: BasisShape,
    /// Width σ of a basis function, in units of the distance between two centres.
    pub basis_width: f32,
    /// `true` if every Gaussian and channel learns its own centres and widths of the basis functions.
    pub own_bases: bool,
    /// `true` if colour may change over time.
    pub colour_over_time: bool,
    /// `true` if centres may move along the world's z axis over time. They always may where depth or a moving
    /// camera tells of it.
    pub depth_over_time: bool,
    /// Slope δ of the feature gate (2.5 in the paper).
    pub gate_slope: f32,
    /// `true` if the gate reads the channels of scale instead of its own.
    pub gate_on_scale: bool,
    /// Way to get the features.
    pub feature_mode: FeatureMode,
    /// `true` if features may change over time (the paper's deformation tracking).
    pub feature_motion: bool,
    /// Degree of the spherical harmonics.
    pub sh_degree: usize,
    /// `true` to use spherical harmonics even if the camera is still, and they have no effect.
    pub sh_when_still: bool,
    /// Number of steps after which the next degree is learned too; 0 for all from the start.
    pub sh_every: usize,
    /// `true` to learn poses with the Gaussians that are known, too. Estimated ones always are.
    pub refines_poses: bool,
    /// `true` if the gradient of depth moves centres.
    pub depth_moves_centres: bool,
    /// Share of the steps that are done at half size, at the start.
    pub half_size_share: f32,
    /// Edge of the squares of pixels of which a full-size step renders one pixel, another one each time.
    pub pixel_step: usize,
    /// Edge of these squares in a half-size step.
    pub half_size_pixel_step: usize,
    /// Smallest number of pixels that are rendered: squares are made smaller for it, and a small image is
    /// rendered whole.
    pub min_pixels: usize,
    /// Learning rates.
    pub rates: LearningRates,
    /// Settings for adding and removing Gaussians.
    pub densify: DensifySettings,
    /// Weights of the loss terms.
    pub loss: LossWeights,
    /// Memory for decoded frames, bytes.
    pub frame_cache_bytes: usize,
}

impl Default for TrainSettings {
    fn default() -> Self {
        Self {
            profile: Profile::Default,
            iterations: Quality::Standard.steps(),
            seed: 0,
            eval: false,
            excluded: Vec::new(),
            chapter_frames: CHAPTER_FRAMES,
            chapter: None,
            frame_order: FrameOrder::Random,
            finds_repeats: true,
            finds_path: true,
            guesses_held_out: true,
            px_per_gaussian: 30.0,
            initial_opacity: 0.6,
            neighbour_sizes: false,
            seed_test_frames: false,
            num_bases: 0,
            basis_shape: BasisShape::Spline,
            basis_width: 1.0,
            own_bases: false,
            colour_over_time: true,
            depth_over_time: false,
            gate_slope: GATE_SLOPE,
            gate_on_scale: false,
            feature_mode: FeatureMode::Learned,
            feature_motion: true,
            sh_degree: 1,
            sh_when_still: false,
            sh_every: 0,
            refines_poses: false,
            depth_moves_centres: true,
            half_size_share: 0.2,
            pixel_step: 2,
            half_size_pixel_step: 2,
            min_pixels: 20_000,
            rates: LearningRates {
                unit: LengthUnit::Pixel,
                mean: 0.02,
                motion: 0.1,
                motion_relative: 6.0,
                uniform_motion: false,
                final_share: 0.05,
                falls_by_visits: true,
                cooldown: 0.1,
                rotation: 2e-3,
                log_scale: 1e-2,
                opacity: 0.05,
                colour: 5e-3,
                sh_rest: 1.25e-4,
                feature: 2.5e-3,
                pose: 0.05,
            },
            densify: DensifySettings {
                from: 0.05,
                until: 0.8,
                every: 0,
                growth: 0.07,
                threshold: 0.0,
                split_only: false,
                loses_step: false,
                max_gaussians: Quality::Standard.gaussians(),
                min_px_per_gaussian: 2.0,
                min_opacity: 0.005,
                split_px: 1.5,
            },
            loss: LossWeights::default(),
            frame_cache_bytes: 1 << 30,
        }
    }
}

impl TrainSettings {
    /// Settings of a profile.
    pub fn of(profile: Profile) -> Self {
        match profile {
            Profile::Default => Self::default(),
            Profile::Paper => Self::paper(),
        }
    }

    /// Takes the numbers of steps and Gaussians of `quality`; profile `paper` keeps its own limit of Gaussians.
    #[must_use]
    pub fn with_quality(mut self, quality: Quality) -> Self {
        self.iterations = quality.steps();
        if self.profile == Profile::Default {
            self.densify.max_gaussians = quality.gaussians();
        }
        self
    }

    /// Learns known poses with the Gaussians, too: at the default rate if the profile leaves poses as they are.
    #[must_use]
    pub fn refining_poses(mut self) -> Self {
        self.refines_poses = true;
        if self.rates.pose == 0.0 {
            self.rates.pose = Self::default().rates.pose;
        }
        self
    }

    /// Frames that are learned from, whether they may be seen or not.
    pub(super) fn window(&self, num_frames: usize) -> Range<usize> {
        self.chapter.as_ref().map_or(0..num_frames, |chapter| within(&chapter.learned, num_frames))
    }

    /// Frames that what is learned is shown on.
    pub(super) fn shown(&self, num_frames: usize) -> Range<usize> {
        self.chapter.as_ref().map_or(0..num_frames, |chapter| within(&chapter.shown, num_frames))
    }

    /// Frames of a recording of `num_frames` that are learned from.
    pub(super) fn frames(&self, num_frames: usize) -> Vec<usize> {
        let mut frames = self.frames_and_held_out(num_frames);
        frames.retain(|i| !(self.eval && Sequence::is_test_frame(*i)));
        frames
    }

    /// The same and those that are held out.
    pub(super) fn frames_and_held_out(&self, num_frames: usize) -> Vec<usize> {
        let is_excluded = |i: usize| self.excluded.iter().any(|(from, to)| (*from..=*to).contains(&i));
        self.window(num_frames).filter(|i| !is_excluded(*i)).collect()
    }

    /// Number of basis functions for a recording of `num_frames` frames.
    pub fn num_bases(&self, num_frames: usize) -> usize {
        if self.num_bases > 0 { self.num_bases.max(2) } else { default_bases(num_frames) }
    }

    /// Returns `true` if a recording of `num_frames` frames is learned in chapters even if it is one shot.
    pub fn is_long(&self, num_frames: usize) -> bool {
        self.chapter_frames > 0 && num_frames >= 2 * self.chapter_frames
    }

    /// Number of chapters of a recording of `num_frames` frames without cuts; 1 if it is learned as a whole.
    pub fn expected_chapters(&self, num_frames: usize) -> usize {
        if self.is_long(num_frames) { num_frames.div_ceil(self.chapter_frames) } else { 1 }
    }

    /// Largest number of frames that are learned together, of a recording of `num_frames` frames.
    pub fn frames_together(&self, num_frames: usize) -> usize {
        if self.is_long(num_frames) { self.chapter_frames + 2 * OVERLAP } else { num_frames }
    }

    /// Warning about the loss on a recording of `num_frames` frames. `None` if it is not too long, if it is
    /// learned in chapters, or if the number of basis functions was chosen.
    pub fn length_warning(&self, num_frames: usize) -> Option<String> {
        let is_cared_for = self.num_bases > 0 || self.is_long(num_frames);
        if is_cared_for { None } else { length_warning(num_frames) }
    }

    /// Returns `true` if trainings of a chapter with these settings and with `other` come to the same, whichever
    /// chapters they name.
    pub fn agrees_with(&self, other: &Self) -> bool {
        Self { chapter: None, ..self.clone() } == Self { chapter: None, ..other.clone() }
    }

    /// Returns the settings as far as a recording, or the chapter of it, allows them; `has_path` if a path of the
    /// scope was estimated.
    pub(super) fn applied(&self, sequence: &Sequence, prepared: Option<&Prepared>, has_path: bool) -> Self {
        let mut applied = self.clone();
        if prepared.is_some_and(|p| p.origin == Origin::Marks) {
            // Marks are carried once the motion is known.
            (applied.feature_mode, applied.feature_motion) = (FeatureMode::Lifted, false);
        }
        applied.rates.final_share = self.final_share(self.window(sequence.num_frames()).len());
        let sees_around = sequence.camera_moves() || has_path || self.refines_poses;
        let has_bands = sees_around || self.sh_when_still;
        applied.sh_degree = if has_bands { self.sh_degree.min(3) } else { 0 };
        applied.depth_over_time |= sees_around || sequence.has_depth();
        applied
    }

    /// Share of their start that rates reach at the end, where `num_frames` frames are visited equally often.
    pub(super) fn final_share(&self, num_frames: usize) -> f32 {
        let rates = &self.rates;
        let visits = self.iterations as f32 / num_frames.max(1) as f32;
        let by_visits = if rates.falls_by_visits { (10.0 / visits.max(1.0)).min(0.2) } else { 0.0 };
        rates.final_share.max(by_visits)
    }

    /// Returns `true` if a densification follows step `step` (counted from 1).
    pub(super) fn densifies_at(&self, step: usize) -> bool {
        let d = &self.densify;
        let at = |share: f32| (share * self.iterations as f32) as usize;
        let every = if d.every > 0 { d.every } else { (self.iterations / 40).clamp(10, 100) };
        step >= at(d.from) && step <= at(d.until) && step.is_multiple_of(every)
    }

    /// Number of the colour's `bands` above 0 that are learned at `step`.
    pub fn learned_bands(&self, bands: usize, step: usize) -> usize {
        if self.sh_every == 0 {
            return bands;
        }
        let degree = step / self.sh_every;
        ((degree + 1) * (degree + 1) - 1).min(bands)
    }

    /// Constants of the released code (method §2, §3, §5, §6), as shares of its 3000 steps.
    fn paper() -> Self {
        Self {
            profile: Profile::Paper,
            iterations: 3000,
            chapter_frames: 0,
            frame_order: FrameOrder::Cyclic,
            finds_repeats: false,
            finds_path: false,
            guesses_held_out: false,
            px_per_gaussian: 10.0,
            initial_opacity: 0.1,
            neighbour_sizes: true,
            seed_test_frames: true,
            num_bases: RELEASED_BASES,
            basis_shape: BasisShape::Quartic,
            // σ = 0.01 with 17 centres.
            basis_width: 0.16,
            own_bases: true,
            colour_over_time: false,
            depth_over_time: true,
            gate_slope: RELEASED_GATE_SLOPE,
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
                // The rates fall to 1 % at step 4000, of which 3000 are done.
                final_share: 0.031_622_78,
                falls_by_visits: false,
                cooldown: 0.0,
                rotation: 1e-3,
                log_scale: 5e-3,
                colour: 2.5e-3,
                pose: 0.0,
                ..Self::default().rates
            },
            densify: DensifySettings {
                from: 0.2,
                until: 1.0,
                every: 100,
                threshold: 2e-4,
                split_only: true,
                loses_step: true,
                max_gaussians: 500_000,
                min_px_per_gaussian: 0.0,
                ..Self::default().densify
            },
            loss: LossWeights {
                absolute: 1.0,
                square: 0.0,
                raw_depth: true,
                pooled_regions: true,
                unmasked_variation: true,
                ..LossWeights::default()
            },
            ..Self::default()
        }
    }
}

/// A range of frames without those beyond `num_frames`.
fn within(frames: &Range<usize>, num_frames: usize) -> Range<usize> {
    frames.start.min(num_frames)..frames.end.min(num_frames)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::deform::LONGEST;

    #[test]
    fn rates_fall_less_where_frames_are_seldom_visited() {
        let settings = TrainSettings { iterations: 6000, ..TrainSettings::default() };
        assert_eq!([20, 60, 5000].map(|frames| settings.final_share(frames)), [0.05, 0.1, 0.2]);
        let paper = TrainSettings::of(Profile::Paper);
        assert_eq!(paper.final_share(5000), paper.rates.final_share);
    }

    #[test]
    fn rates_fall_to_zero_at_the_end() {
        let rates = LearningRates { cooldown: 0.25, ..TrainSettings::default().rates };
        assert_eq!([0.0, 0.75, 0.875, 1.0].map(|progress| rates.cooldown_at(progress)), [1.0, 1.0, 0.5, 0.0]);
        assert_eq!(TrainSettings::of(Profile::Paper).rates.cooldown_at(1.0), 1.0);
    }

    #[test]
    fn poses_are_refined_at_some_rate_in_every_profile() {
        let rate = |profile| TrainSettings::of(profile).refining_poses().rates.pose;
        assert_eq!([Profile::Default, Profile::Paper].map(rate), [TrainSettings::default().rates.pose; 2]);
        let mut faster = TrainSettings::default();
        faster.rates.pose = 0.3;
        assert_eq!(faster.refining_poses().rates.pose, 0.3);
    }

    #[test]
    fn length_is_no_matter_where_the_number_of_bases_was_chosen() {
        let settings = TrainSettings::default();
        let whole = TrainSettings { chapter_frames: 0, ..settings.clone() };
        assert_eq!(whole.length_warning(800), length_warning(800));
        assert_eq!(TrainSettings { num_bases: 17, ..whole }.length_warning(800), None);
        assert_eq!(settings.length_warning(800), None, "it is learned in chapters");
        const { assert!(2 * CHAPTER_FRAMES == LONGEST + 1) };
        let expected =
            [48, LONGEST, 800].map(|n| (settings.expected_chapters(n), settings.frames_together(n)));
        assert_eq!(expected, [(1, 48), (1, LONGEST), (9, CHAPTER_FRAMES + 2 * OVERLAP)]);
    }
}
