//! Summary of a prompt's result in one view.

use std::{borrow::Cow, sync::Arc};
use surgtpgs_core::{
    grid::{Grid, Mask},
    mask::{self, CleanUp},
    summary::{SCORE_BINS, Summary},
};

/// Columns and rows of the cells by which the place of a number is looked for.
const CELL: usize = 4;

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
    /// Found pixel far from the border of everything found, as share of width and height.
    pub(crate) anchor: Option<[f32; 2]>,
    pub(crate) scores: Arc<Grid<f32>>,
    /// Scores after the clean-up of masks: a pixel is found if its cleaned score is above the threshold.
    pub(crate) cleaned: Arc<Grid<f32>>,
}

impl Found {
    pub(crate) fn new(scores: Arc<Grid<f32>>, threshold: f32, clean_up: CleanUp) -> Self {
        let clean = || {
            let cleaned = match clean_up.scores(&scores, threshold) {
                Cow::Borrowed(_) => scores.clone(),
                Cow::Owned(cleaned) => Arc::new(cleaned),
            };
            let found = mask::threshold(&cleaned, threshold);
            (cleaned, found.count(), anchor(&found))
        };
        let summarise = || Summary::of(&scores);
        let ((cleaned, area_px, anchor), summary) = rayon::join(clean, summarise);
        Self {
            area_px,
            area_fraction: area_px as f32 / scores.data.len().max(1) as f32,
            max_score: summary.max_score,
            histogram: summary.histogram,
            anchor,
            scores,
            cleaned,
        }
    }

    /// Moves the anchor to where nothing that is `covered` lies over what was found, if there is such a place.
    pub(crate) fn place_number(&mut self, threshold: f32, covered: &Mask) {
        let mut free = mask::threshold(&self.cleaned, threshold);
        let covered = covered.sampled(free.width, free.height);
        free.data.iter_mut().zip(covered.data).for_each(|(free, covered)| *free &= !covered);
        self.anchor = anchor(&free).or(self.anchor);
    }

    /// Returns `true` if a place, as share of width and height, is found.
    pub(crate) fn is_found_at(&self, [u, v]: [f32; 2], threshold: f32) -> bool {
        let Grid { width, height, data } = &*self.cleaned;
        let (x, y) = (u * *width as f32, v * *height as f32);
        let is_inside = (0.0..*width as f32).contains(&x) && (0.0..*height as f32).contains(&y);
        is_inside && data[y as usize * width + x as usize] > threshold
    }
}

/// Returns the place of a prompt's number, as share of width and height: the innermost of the cells that are
/// found as a whole, or of the pixels where there is no such cell.
fn anchor(mask: &Mask) -> Option<[f32; 2]> {
    let innermost = |mask: &Mask, side: usize| {
        let (x, y) = mask::innermost(mask)?;
        Some([x, y].map(|v| (v as f32 + 0.5) * side as f32))
    };
    let [x, y] = innermost(&whole_cells(mask), CELL).or_else(|| innermost(mask, 1))?;
    Some([x / mask.width as f32, y / mask.height as f32])
}

/// Returns the square cells of [`CELL`] columns and rows of which every pixel is in the mask.
fn whole_cells(mask: &Mask) -> Mask {
    let (width, height) = (mask.width / CELL, mask.height / CELL);
    let mut cells = Grid::filled(width, height, true);
    for y in 0..height * CELL {
        let row = mask.row(y).chunks_exact(CELL).map(|cell| cell.iter().all(|found| *found));
        cells.data[y / CELL * width..][..width].iter_mut().zip(row).for_each(|(cell, found)| *cell &= found);
    }
    cells
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
    fn the_number_lies_inside_of_what_was_found_and_beside_what_covers_it() {
        let row = |scores: Vec<f32>| Arc::new(Grid::from_vec(7, 1, scores));
        let scores = row(vec![0.9, 0.9, 0.9, 0.9, 0.1, 0.9, 0.9]);
        let mut found = Found::new(scores, 0.4, CleanUp::default());
        assert!(found.is_found_at(found.anchor.unwrap(), 0.4) && !found.is_found_at([4.5 / 7.0, 0.5], 0.4));
        let left = Grid::from_vec(7, 1, (0..7).map(|x| x < 4).collect());
        found.place_number(0.4, &left);
        assert_eq!(found.anchor, Some([5.5 / 7.0, 0.5]), "where nothing covers it");
        found.place_number(0.4, &Grid::filled(7, 1, true));
        assert_eq!(found.anchor, Some([5.5 / 7.0, 0.5]), "better covered than nowhere");
        assert_eq!(Found::new(Arc::new(Grid::filled(3, 3, f32::NAN)), 0.4, CleanUp::default()).anchor, None);
    }
}
