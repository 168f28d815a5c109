//! Clean-up of masks at the user's request; the same for the window and the exports.

use super::{Bits, Mask, fill_holes, remove_small, smoothed, threshold};
use crate::grid::Grid;
use rayon::prelude::*;
use std::borrow::Cow;

/// Steps of the clean-up of a prompt's mask, in the order of the fields. The default changes nothing.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, serde::Serialize, serde::Deserialize)]
#[serde(default)]
pub struct CleanUp {
    /// Scores are the mean over the frame itself, this many frames before and this many after it.
    pub smooth_frames: usize,
    /// Holes of at most this area are filled, px.
    pub fill_holes_px: usize,
    /// Connected parts of a smaller area are removed, px.
    pub min_area_px: usize,
    /// Radius in pixels over which the border is rounded.
    pub round_px: usize,
    /// Distance that the border moves outwards, px by city-block distance; negative moves it inwards.
    pub grow_px: i32,
}

/// Largest number of frames before and after that scores are smoothed over, in the window and in exports.
pub const MAX_SMOOTH: usize = 5;
/// Parts and holes below one in so many of a picture's pixels are no structure of their own.
const PIXELS_PER_SPECK: usize = 1000;
/// Number of rows of a picture for each pixel of the radius over which borders are rounded.
const ROWS_PER_ROUND_PX: usize = 160;

impl CleanUp {
    /// The clean-up for pictures to look at, in the window and in exports: no specks, no small holes, round
    /// borders. It leaves very small pictures as they are.
    pub fn usual(width: usize, height: usize) -> Self {
        let speck = width * height / PIXELS_PER_SPECK;
        let round_px = width.min(height) / ROWS_PER_ROUND_PX;
        Self { fill_holes_px: speck, min_area_px: speck, round_px, ..Self::default() }
    }

    /// Returns `true` if masks stay unchanged, to the bit.
    pub fn is_off(&self) -> bool {
        *self == Self::default()
    }

    /// Adapts the clean-up to pictures whose width and height are scaled by `share`.
    pub fn at_size(&self, share: f32) -> Self {
        let length = |px: f32| (px * share).round();
        let area = |px: usize| length(px as f32 * share) as usize;
        Self {
            fill_holes_px: area(self.fill_holes_px),
            min_area_px: area(self.min_area_px),
            round_px: length(self.round_px as f32) as usize,
            grow_px: length(self.grow_px as f32) as i32,
            ..*self
        }
    }

    /// Returns the mask without holes and specks, its border rounded and moved. The image's edge is no border.
    pub fn mask(&self, mask: &Mask) -> Mask {
        let mut mask = Cow::Borrowed(mask);
        if self.fill_holes_px > 0 {
            mask = Cow::Owned(fill_holes(&mask, self.fill_holes_px));
        }
        if self.min_area_px > 1 {
            mask = Cow::Owned(remove_small(&mask, self.min_area_px));
        }
        if self.round_px > 0 {
            mask = Cow::Owned(smoothed(&mask, self.round_px));
        }
        if self.grow_px != 0 {
            let bits = Bits::of_mask(&mask);
            // No distance in the mask is larger than this.
            let steps = (self.grow_px.unsigned_abs() as usize).min(mask.width + mask.height);
            let step = |bits: Bits, _| if self.grow_px > 0 { bits.dilated() } else { bits.eroded() };
            mask = Cow::Owned((0..steps).fold(bits, step).to_mask());
        }
        mask.into_owned()
    }

    /// Returns scores whose pixels above `threshold_score` are the cleaned mask. Scores of added pixels
    /// are just above it, those of removed pixels are at it. Nothing is found at pixels that were not
    /// seen (0 or not a number).
    pub fn scores<'a>(&self, scores: &'a Grid<f32>, threshold_score: f32) -> Cow<'a, Grid<f32>> {
        if (Self { smooth_frames: 0, ..*self }).is_off() {
            return Cow::Borrowed(scores);
        }
        let found = self.mask(&threshold(scores, threshold_score));
        let just_above = threshold_score.next_up();
        let agreed = |(&score, &found): (&f32, &bool)| match (score > 0.0, found) {
            (false, _) => score,
            (true, true) => score.max(just_above),
            (true, false) => score.min(threshold_score),
        };
        let data = scores.data.par_iter().zip(&found.data).with_min_len(1 << 14).map(agreed).collect();
        Cow::Owned(Grid::from_vec(scores.width, scores.height, data))
    }
}

/// Mean over time of the scores of a frame and of its neighbours, pixel by pixel. A neighbour's pixel
/// that was not seen (0 or not a number) does not count. A pixel that was not seen on the frame itself
/// stays unchanged. Neighbours of another size are left out.
pub fn mean_scores(frame: &Grid<f32>, neighbours: &[&Grid<f32>]) -> Grid<f32> {
    let size = (frame.width, frame.height);
    let neighbours: Vec<_> = neighbours.iter().filter(|n| (n.width, n.height) == size).collect();
    let mean = |(i, &own): (usize, &f32)| {
        // Also true for NaN.
        if !(own > 0.0) {
            return own;
        }
        let seen = neighbours.iter().map(|n| n.data[i]).filter(|s| *s > 0.0);
        let (sum, count) = seen.fold((own, 1.0), |(sum, count), s| (sum + s, count + 1.0));
        sum / count
    };
    Grid::from_vec(frame.width, frame.height, frame.data.iter().enumerate().map(mean).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn off_leaves_every_bit_alone() {
        let scores = Grid::from_vec(3, 1, vec![0.4, f32::NAN, 0.9]);
        assert!(
            matches!(CleanUp::default().scores(&scores, 0.4), Cow::Borrowed(same) if std::ptr::eq(same, &scores))
        );
        let found = Mask::drawn(&["#.#", ".#."]);
        assert_eq!(CleanUp::default().mask(&found), found);
    }

    #[test]
    fn holes_close_specks_go_and_the_border_moves() {
        let found = Mask::drawn(&["#......", "...###.", "...#.#.", "...###."]);
        let clean = |c: CleanUp| c.mask(&found);
        let filled = Mask::drawn(&["#......", "...###.", "...###.", "...###."]);
        let ring = Mask::drawn(&[".......", "...###.", "...#.#.", "...###."]);
        assert_eq!(clean(CleanUp { fill_holes_px: 1, ..Default::default() }), filled);
        assert_eq!(clean(CleanUp { min_area_px: 2, ..Default::default() }), ring);
        let all = CleanUp { fill_holes_px: 1, min_area_px: 9, grow_px: 1, ..Default::default() };
        assert_eq!(clean(all), Mask::drawn(&["...###.", "..#####", "..#####", "..#####"]));
        let shrunk = CleanUp { fill_holes_px: 1, grow_px: -1, ..Default::default() };
        assert_eq!(clean(shrunk), Mask::drawn(&[".......", ".......", "....#..", "....#.."]));
        let far = CleanUp { grow_px: i32::MIN, ..Default::default() };
        assert_eq!(far.mask(&found).count(), 0);
    }

    #[test]
    fn the_usual_clean_up_takes_specks_away_and_rounds_borders() {
        let usual = CleanUp::usual(854, 480);
        let expected = CleanUp { fill_holes_px: 409, min_area_px: 409, round_px: 3, ..Default::default() };
        assert_eq!(usual, expected);
        assert!(CleanUp::usual(32, 24).is_off());
        let stair = |i: usize| (i % 200) + 2 * (i / 200 / 4 * 2) < 150 || i == 199;
        let found = Grid::from_vec(200, 160, (0..200 * 160).map(stair).collect());
        let clean = CleanUp::usual(200, 160).mask(&found);
        assert!(found.data[199] && !clean.data[199], "a speck");
        assert!(found.data.iter().zip(&clean.data).filter(|(a, b)| a != b).count() < 200, "little else");
    }

    #[test]
    fn what_was_not_seen_is_not_found_by_growing() {
        let scores = Grid::from_vec(4, 1, vec![0.9, 0.0, f32::NAN, 0.2]);
        let grown = CleanUp { grow_px: 3, ..Default::default() };
        assert_eq!(threshold(&grown.scores(&scores, 0.4), 0.4).data, [true, false, false, true]);
    }

    #[test]
    fn at_half_size_lengths_are_half_and_areas_a_quarter() {
        let clean =
            CleanUp { smooth_frames: 2, fill_holes_px: 40, min_area_px: 100, round_px: 6, grow_px: -4 };
        let half = CleanUp { smooth_frames: 2, fill_holes_px: 10, min_area_px: 25, round_px: 3, grow_px: -2 };
        assert_eq!(clean.at_size(0.5), half);
        assert_eq!(clean.at_size(1.0), clean);
    }

    #[test]
    fn the_mean_over_time_leaves_out_what_was_not_seen() {
        let one = |v: Vec<f32>| Grid::from_vec(3, 1, v);
        let (a, b) = (one(vec![0.9, 0.0, f32::NAN]), one(vec![0.0, 0.6, 0.4]));
        let mean = mean_scores(&one(vec![0.3, 0.0, 0.2]), &[&a, &b, &Grid::filled(1, 1, 0.9)]);
        assert!((mean.data[0] - 0.6).abs() < 1e-6 && mean.data[1] == 0.0);
        assert!((mean.data[2] - 0.3).abs() < 1e-6);
        assert_eq!(mean_scores(&a, &[]).data[..2], a.data[..2]);
    }

    proptest! {
        #[test]
        fn the_scores_say_what_the_mask_says(
            scores in proptest::collection::vec(0.01_f32..1.0, 48),
            clean in (0_usize..4, 0_usize..5, 0_usize..2, -2_i32..3),
            limit in 0_u8..=100,
        ) {
            let (fill_holes_px, min_area_px, round_px, grow_px) = clean;
            let clean = CleanUp { smooth_frames: 0, fill_holes_px, min_area_px, round_px, grow_px };
            let (scores, limit) = (Grid::from_vec(8, 6, scores), f32::from(limit) / 100.0);
            let expected = clean.mask(&threshold(&scores, limit));
            prop_assert_eq!(threshold(&clean.scores(&scores, limit), limit), expected);
        }
    }
}
