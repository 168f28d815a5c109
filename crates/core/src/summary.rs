//! Summary of the scores of a prompt in one picture; twin of `shaders/summary.wgsl`.

use crate::grid::Grid;

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
    /// Number of pixels above the threshold in each column.
    pub columns: Vec<u32>,
    /// Number of pixels above the threshold in each row.
    pub rows: Vec<u32>,
}

impl Summary {
    /// Summarises `scores`. Pixels strictly above `threshold` are found. NaN counts as not seen.
    pub fn new(scores: &Grid<f32>, threshold: f32) -> Self {
        let (columns, rows) = (vec![0; scores.width], vec![0; scores.height]);
        let mut summary = Self { histogram: [0; SCORE_BINS], max_score: 0.0, columns, rows };
        for (y, row) in scores.data.chunks_exact(scores.width.max(1)).enumerate() {
            for (x, &score) in row.iter().enumerate() {
                // Also false for NaN.
                if !(score > 0.0) {
                    continue;
                }
                summary.histogram[((score * SCORE_BINS as f32) as usize).min(SCORE_BINS - 1)] += 1;
                summary.max_score = summary.max_score.max(score);
                if score > threshold {
                    summary.columns[x] += 1;
                    summary.rows[y] += 1;
                }
            }
        }
        summary
    }

    /// Returns the number of pixels above the threshold.
    pub fn area_px(&self) -> usize {
        self.rows.iter().map(|n| *n as usize).sum()
    }

    /// Returns the mean column and row of the pixels above the threshold; `None` if there are none.
    pub fn centre(&self) -> Option<[f64; 2]> {
        let area = self.area_px() as f64;
        let mean = |counts: &[u32]| {
            counts.iter().enumerate().map(|(at, n)| at as f64 * f64::from(*n)).sum::<f64>() / area
        };
        (area > 0.0).then(|| [mean(&self.columns), mean(&self.rows)])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_seen_pixel_is_counted_and_no_hole() {
        let scores = Grid::from_vec(4, 1, vec![0.0, 0.1, 0.5, 1.0]);
        let summary = Summary::new(&scores, 0.4);
        assert_eq!(summary.histogram.iter().sum::<u32>(), 3);
        assert_eq!((summary.histogram[5], summary.histogram[25], summary.histogram[49]), (1, 1, 1));
        assert_eq!((summary.area_px(), summary.max_score), (2, 1.0));
        assert_eq!((summary.columns, summary.rows), (vec![0, 0, 1, 1], vec![2]));
    }

    #[test]
    fn the_centre_is_the_mean_of_what_is_found() {
        let scores = Grid::from_vec(3, 2, vec![0.9, 0.1, 0.9, 0.1, 0.1, 0.9]);
        assert_eq!(Summary::new(&scores, 0.4).centre(), Some([4.0 / 3.0, 1.0 / 3.0]));
        assert_eq!(Summary::new(&Grid::filled(3, 3, f32::NAN), 0.4).centre(), None);
        assert_eq!(Summary::new(&Grid::filled(0, 0, 1.0), 0.4).area_px(), 0);
    }
}
