//! Summary of the scores of a prompt in one picture; twin of `shaders/summary.wgsl`.

use crate::grid::Grid;
use rayon::prelude::*;

/// Rows that one thread summarises at once.
const ROWS_AT_ONCE: usize = 32;
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
        let nothing = || Self::nothing(scores.width);
        let rows = scores.data.par_chunks_exact(scores.width.max(1)).with_min_len(ROWS_AT_ONCE);
        rows.fold(nothing, |summary, row| summary.with_row(row, threshold)).reduce(nothing, Self::with_rows)
    }

    /// Summarises no rows of this width.
    fn nothing(width: usize) -> Self {
        Self { histogram: [0; SCORE_BINS], max_score: 0.0, columns: vec![0; width], rows: Vec::new() }
    }

    /// Adds the next row.
    fn with_row(mut self, row: &[f32], threshold: f32) -> Self {
        let mut found = 0;
        for (&score, column) in row.iter().zip(&mut self.columns) {
            // Also false for NaN.
            let is_found = u32::from(score > threshold && score > 0.0);
            *column += is_found;
            found += is_found;
        }
        self.rows.push(found);
        for &score in row {
            if score > 0.0 {
                self.histogram[((score * SCORE_BINS as f32) as usize).min(SCORE_BINS - 1)] += 1;
            }
        }
        self.max_score = row.iter().copied().fold(self.max_score, f32::max);
        self
    }

    /// Adds the rows below.
    fn with_rows(mut self, below: Self) -> Self {
        let add = |sums: &mut [u32], more: &[u32]| sums.iter_mut().zip(more).for_each(|(a, b)| *a += b);
        add(&mut self.histogram, &below.histogram);
        add(&mut self.columns, &below.columns);
        self.rows.extend(below.rows);
        Self { max_score: self.max_score.max(below.max_score), ..self }
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
