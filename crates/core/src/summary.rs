//! Summary of the scores of a prompt in one picture.

use crate::grid::Grid;
use rayon::prelude::*;

/// Pixels that one thread summarises at once.
const PIXELS_AT_ONCE: usize = 1 << 14;
/// Number of bins of a histogram of scores.
pub const SCORE_BINS: usize = 50;

/// Summary of the scores of one prompt in one picture.
#[derive(Clone, Debug, PartialEq)]
pub struct Summary {
    /// Number of seen pixels per score, in equal steps from 0 to 1. A score of exactly 0 marks a hole or
    /// a pixel outside the field of view: a real score is never 0.
    pub histogram: [u32; SCORE_BINS],
    /// The highest score; 0 if nothing is seen.
    pub max_score: f32,
}

impl Summary {
    /// Summarises `scores`. NaN counts as not seen.
    pub fn of(scores: &Grid<f32>) -> Self {
        let nothing = || Self { histogram: [0; SCORE_BINS], max_score: 0.0 };
        let parts = scores.data.par_chunks(PIXELS_AT_ONCE);
        parts.fold(nothing, Self::with_scores).reduce(nothing, Self::with)
    }

    /// Adds more scores.
    fn with_scores(mut self, scores: &[f32]) -> Self {
        // Also false for NaN.
        for &score in scores.iter().filter(|score| **score > 0.0) {
            self.histogram[((score * SCORE_BINS as f32) as usize).min(SCORE_BINS - 1)] += 1;
        }
        self.max_score = scores.iter().copied().fold(self.max_score, f32::max);
        self
    }

    /// Adds another summary.
    fn with(mut self, other: Self) -> Self {
        self.histogram.iter_mut().zip(other.histogram).for_each(|(count, more)| *count += more);
        Self { max_score: self.max_score.max(other.max_score), ..self }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_seen_pixel_is_counted_and_no_hole() {
        let summary = Summary::of(&Grid::from_vec(5, 1, vec![0.0, 0.1, 0.5, 1.0, f32::NAN]));
        assert_eq!(summary.histogram.iter().sum::<u32>(), 3);
        assert_eq!((summary.histogram[5], summary.histogram[25], summary.histogram[49]), (1, 1, 1));
        assert_eq!(summary.max_score, 1.0);
    }

    #[test]
    fn a_large_picture_is_summarised_as_a_whole() {
        let score = |i: usize| if i == 0 { 0.9 } else { 0.3 };
        let summary = Summary::of(&Grid::from_vec(300, 200, (0..60_000).map(score).collect()));
        assert_eq!((summary.histogram[45], summary.histogram[15], summary.max_score), (1, 59_999, 0.9));
        assert_eq!(Summary::of(&Grid::filled(0, 0, 1.0)).max_score, 0.0);
    }
}
