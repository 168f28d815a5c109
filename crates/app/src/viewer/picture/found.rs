//! Summary of a prompt's result in one view.

use std::{borrow::Cow, sync::Arc};
use surgtpgs_core::{
    grid::Grid,
    mask::CleanUp,
    summary::{SCORE_BINS, Summary},
};

/// Result of one prompt in one view.
#[derive(Clone, Debug)]
pub(crate) struct Found {
    /// Number of pixels above the threshold.
    pub(crate) area_px: usize,
    /// Share of the picture, 0–1.
    pub(crate) area_fraction: f32,
    /// The highest similarity score.
    pub(crate) max_score: f32,
    /// Number of pixels of the reconstruction by score, in equal steps from 0 to 1.
    pub(crate) histogram: [u32; SCORE_BINS],
    /// Found pixel near the middle of everything found, as share of width and height.
    pub(crate) anchor: Option<[f32; 2]>,
    pub(crate) scores: Arc<Grid<f32>>,
    /// Scores after the clean-up of masks: a pixel is found if its cleaned score is above the threshold.
    pub(crate) cleaned: Arc<Grid<f32>>,
}

impl Found {
    pub(crate) fn new(scores: Arc<Grid<f32>>, threshold: f32, clean_up: CleanUp) -> Self {
        let summary = Summary::new(&scores, threshold);
        let (cleaned, found) = match clean_up.scores(&scores, threshold) {
            Cow::Borrowed(_) => (scores.clone(), None),
            Cow::Owned(cleaned) => {
                let found = Summary::new(&cleaned, threshold);
                (Arc::new(cleaned), Some(found))
            }
        };
        let found = found.as_ref().unwrap_or(&summary);
        let area_px = found.area_px();
        Self {
            area_px,
            area_fraction: area_px as f32 / scores.data.len().max(1) as f32,
            max_score: summary.max_score,
            histogram: summary.histogram,
            anchor: found.centre().and_then(|c| nearest_found(&cleaned, threshold, c)),
            scores,
            cleaned,
        }
    }
}

/// Returns the found pixel nearest to `centre`, as share of width and height.
fn nearest_found(scores: &Grid<f32>, threshold: f32, centre: [f64; 2]) -> Option<[f32; 2]> {
    let found = (0..scores.data.len()).filter(|&i| scores.data[i] > threshold);
    let distance = |i: &usize| {
        let (dx, dy) = ((i % scores.width) as f64 - centre[0], (i / scores.width) as f64 - centre[1]);
        dx * dx + dy * dy
    };
    let i = found.min_by(|a, b| distance(a).total_cmp(&distance(b)))?;
    let share = |v: usize, n: usize| (v as f32 + 0.5) / n as f32;
    Some([share(i % scores.width, scores.width), share(i / scores.width, scores.height)])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_area_is_that_of_the_whole_picture() {
        let found =
            Found::new(Arc::new(Grid::from_vec(4, 1, vec![0.0, 0.1, 0.5, 1.0])), 0.4, CleanUp::default());
        assert_eq!((found.area_px, found.area_fraction, found.max_score), (2, 0.5, 1.0));
    }

    #[test]
    fn cleaning_up_changes_what_is_found_and_no_score() {
        let scores = Arc::new(Grid::from_vec(5, 1, vec![0.9, 0.1, 0.8, 0.8, 0.1]));
        let as_it_is = Found::new(scores.clone(), 0.4, CleanUp::default());
        assert!(Arc::ptr_eq(&as_it_is.scores, &as_it_is.cleaned));
        let cleaned = Found::new(scores, 0.4, CleanUp { min_area_px: 2, ..Default::default() });
        assert_eq!((as_it_is.area_px, cleaned.area_px), (3, 2));
        assert_eq!((cleaned.max_score, cleaned.histogram), (0.9, as_it_is.histogram));
        assert_eq!(cleaned.anchor, Some([0.5, 0.5]));
    }

    #[test]
    fn the_anchor_is_a_found_pixel_even_where_the_middle_is_not_found() {
        let scores = Grid::from_vec(5, 1, vec![0.9, 0.9, 0.1, 0.1, 0.9]);
        assert_eq!(Found::new(Arc::new(scores), 0.4, CleanUp::default()).anchor, Some([0.3, 0.5]));
        assert_eq!(Found::new(Arc::new(Grid::filled(3, 3, f32::NAN)), 0.4, CleanUp::default()).anchor, None);
    }
}
