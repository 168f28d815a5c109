//! Compromises between time and quality, and what each of them costs.

use super::TrainSettings;
use crate::deform::{default_bases, stride_for};

/// Duration of a step of [`Quality::Standard`] per pixel of a frame, seconds, on two processor cores.
const USUAL_PACE: f64 = 4.3e-8;
/// Numbers of a Gaussian at rest, without its features: centre, rotation, scale, opacity, colour.
const FLOATS_AT_REST: usize = 14;

/// Compromise between time and quality.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Quality {
    /// A first look.
    Quick,
    /// Good enough to work with.
    #[default]
    Standard,
    /// More detail, in ten times the time on a CPU.
    Best,
}

impl Quality {
    /// All of them, the fastest first.
    pub const ALL: [Self; 3] = [Self::Quick, Self::Standard, Self::Best];

    /// Number of optimiser steps.
    pub fn steps(self) -> usize {
        match self {
            Self::Quick => 600,
            Self::Standard => 4000,
            Self::Best => 10_000,
        }
    }

    /// Duration of a step, as a multiple of that of [`Quality::Standard`], by measurement.
    pub fn step_cost(self) -> f64 {
        match self {
            Self::Quick | Self::Standard => 1.0,
            Self::Best => 3.9,
        }
    }

    /// Returns the expected duration of a training on `num_frames` frames of columns × rows, seconds. `pace` is
    /// the duration of a step of [`Quality::Standard`] per pixel, seconds, if it is known.
    pub fn expected_seconds(self, num_frames: usize, [width, height]: [usize; 2], pace: Option<f64>) -> f64 {
        let chapters = TrainSettings::default().expected_chapters(num_frames);
        let steps = (chapters * self.steps()) as f64;
        pace.unwrap_or(USUAL_PACE) * (width * height) as f64 * steps * self.step_cost()
    }

    /// Returns the size of the scene file of `num_frames` frames to expect at most, bytes.
    pub fn expected_bytes(self, num_frames: usize, latent_dim: usize) -> usize {
        let settings = TrainSettings::default();
        let at_rest = FLOATS_AT_REST + latent_dim;
        let moving = default_bases(settings.frames_together(num_frames)) * stride_for(latent_dim);
        let of_chapter = self.gaussians() * size_of::<f32>() * (at_rest + moving);
        settings.expected_chapters(num_frames) * of_chapter
    }

    /// Largest number of Gaussians.
    pub fn gaussians(self) -> usize {
        match self {
            Self::Quick | Self::Standard => 40_000,
            Self::Best => 150_000,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::train::Profile;

    #[test]
    fn better_quality_takes_more_steps_and_no_fewer_gaussians() {
        let of = |quality| {
            let settings = TrainSettings::default().with_quality(quality);
            (settings.iterations, settings.densify.max_gaussians)
        };
        let [quick, standard, best] = Quality::ALL.map(of);
        assert!(quick.0 < standard.0 && standard.0 < best.0 && quick.1 <= standard.1 && standard.1 < best.1);
        assert_eq!(TrainSettings::default(), TrainSettings::default().with_quality(Quality::Standard));
        let paper = TrainSettings::of(Profile::Paper);
        assert_eq!(paper.clone().with_quality(Quality::Best).densify, paper.densify);
    }

    #[test]
    fn time_and_size_are_expected_as_they_were_measured() {
        let minutes = |pace, quality: Quality| quality.expected_seconds(48, [854, 480], pace) / 60.0;
        assert!((1.0..2.0).contains(&minutes(None, Quality::Standard)));
        assert!((9.0..13.0).contains(&minutes(None, Quality::Best)));
        assert!(minutes(Some(1e-7), Quality::Standard) > minutes(None, Quality::Standard));
        // 48 frames came to 48.6 MB.
        assert!((45_000_000..55_000_000).contains(&Quality::Standard.expected_bytes(48, 3)));
    }
}
