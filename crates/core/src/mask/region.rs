//! Measures of the region that was found on a frame.

use super::Mask;
use crate::grid::Grid;

/// Area, place and score of the region that a prompt covers on an image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Region {
    /// Number of found pixels.
    pub area_px: usize,
    /// Their share of the image, 0–1; 0 for an empty image.
    pub area_fraction: f64,
    /// Mean score of the found pixels; `None` if nothing was found.
    pub mean_score: Option<f64>,
    /// Highest score of the whole image, found or not. NaN does not count; 0 if there is nothing else.
    pub max_score: f32,
    /// Mean place of the found pixels, x to the right and y down from the image's upper left corner. The
    /// middle of the first pixel is at (0.5, 0.5). `None` if nothing was found.
    pub centroid_px: Option<[f64; 2]>,
}

impl Region {
    /// Measures `mask` on the `scores` it was made from, which have the same size.
    pub fn of(scores: &Grid<f32>, mask: &Mask) -> Self {
        let (mut area_px, mut score, mut x, mut y) = (0_usize, 0.0, 0.0, 0.0);
        for (i, s) in
            mask.data.iter().zip(&scores.data).enumerate().filter_map(|(i, (m, s))| m.then_some((i, s)))
        {
            area_px += 1;
            score += f64::from(*s);
            x += (i % mask.width) as f64;
            y += (i / mask.width) as f64;
        }
        let mean = |sum: f64| (area_px > 0).then(|| sum / area_px as f64);
        Self {
            area_px,
            area_fraction: area_px as f64 / mask.data.len().max(1) as f64,
            mean_score: mean(score),
            max_score: scores.data.iter().copied().fold(0.0, f32::max),
            centroid_px: mean(x).zip(mean(y)).map(|(x, y)| [x + 0.5, y + 0.5]),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_region_is_measured_where_it_was_found() {
        let scores = Grid::from_vec(4, 2, vec![0.1, 0.9, 0.7, 0.0, f32::NAN, 0.5, 0.95, 0.0]);
        let found = Grid::from_vec(4, 2, vec![false, true, true, false, false, true, false, false]);
        let region = Region::of(&scores, &found);
        assert_eq!((region.area_px, region.area_fraction), (3, 0.375));
        assert!((region.mean_score.unwrap() - 0.7).abs() < 1e-7);
        assert_eq!(region.max_score, 0.95, "the best pixel need not be a found one");
        let [x, y] = region.centroid_px.unwrap();
        assert!((x - (4.0 / 3.0 + 0.5)).abs() < 1e-12 && (y - (1.0 / 3.0 + 0.5)).abs() < 1e-12);
    }

    #[test]
    fn nothing_found_has_no_place() {
        let region = Region::of(&Grid::filled(3, 2, 0.2), &Grid::filled(3, 2, false));
        assert_eq!((region.area_px, region.mean_score, region.centroid_px), (0, None, None));
        assert_eq!(region.max_score, 0.2);
        assert_eq!(Region::of(&Grid::filled(0, 0, 0.0), &Grid::filled(0, 0, true)).area_fraction, 0.0);
    }
}
