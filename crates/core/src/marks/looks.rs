//! Shares told by looks: a marked frame, once segmented, is an example of what each name looks like. They
//! count where the flow to the marked frame leads to nothing that looks the same, such as where a tool was
//! before it left.

use super::{
    appearance::{Prediction, Regression, Unlabelled},
    cells::{CellFeatures, MIN_SHOWN_SHARE},
    hints::SCORE_POWER,
};
use crate::grid::Mask;

/// Largest number of names that are told by looks: the time grows with its square.
pub(super) const MAX_NAMES: usize = 64;

/// Looks of each name on a segmented frame, and of what shows none of them.
pub(super) struct Looks(Regression);

/// Shares told by looks, at half size.
pub(super) struct Told {
    /// [names][pixels].
    pub(super) shares: Vec<Vec<f32>>,
    /// Certainty of each pixel, 0–1: near 0 where nothing on the segmented frame looks like it, or two names do.
    pub(super) certainty: Vec<f32>,
}

impl Told {
    /// Returns the sum of all names at each pixel.
    pub(super) fn sums(&self) -> Vec<f32> {
        (0..self.certainty.len()).map(|i| self.shares.iter().map(|plane| plane[i]).sum()).collect()
    }
}

impl Looks {
    /// Takes the cells of a picture with the shares of its pixels at half size, [names][pixels].
    pub(super) fn of(cells: &CellFeatures, field_of_view: &Mask, shares: &[Vec<f32>]) -> Self {
        let shares: Vec<Vec<f32>> = shares.iter().map(|plane| cells.means_of_half(plane)).collect();
        let inside = cells.inside(field_of_view);
        let of = |is_so: &dyn Fn(usize) -> bool| -> Vec<usize> {
            (0..inside.len()).filter(|i| inside[*i] > 0.5 && is_so(*i)).collect()
        };
        let mut shown: Vec<Vec<usize>> =
            shares.iter().map(|plane| of(&|i| plane[i] > MIN_SHOWN_SHARE)).collect();
        // What shows no name is a class like any other.
        let sum = |i: usize| shares.iter().map(|plane| plane[i]).sum::<f32>();
        shown.push(of(&|i| sum(i) < 1.0 - MIN_SHOWN_SHARE));
        Self(cells.features().fit(&shown, &[], Unlabelled::NONE))
    }

    /// Tells the shares of another picture of the same size.
    pub(super) fn tell(&self, picture: &CellFeatures) -> Told {
        let Prediction { mut score, nearness } = self.0.predict(picture.features());
        let mut certainty = nearness;
        for (i, certainty) in certainty.iter_mut().enumerate() {
            *certainty *= lead(score.iter().map(|plane| plane[i]));
            score.iter_mut().for_each(|plane| plane[i] = plane[i].powi(SCORE_POWER));
            let sum: f32 = score.iter().map(|plane| plane[i]).sum();
            score.iter_mut().for_each(|plane| plane[i] /= sum.max(f32::MIN_POSITIVE));
        }
        // The last class is no name.
        score.pop();
        Told {
            shares: score.iter().map(|plane| picture.at_half(plane)).collect(),
            certainty: picture.at_half(&certainty),
        }
    }
}

/// Returns by how much the largest score leads over the second one.
fn lead(scores: impl Iterator<Item = f32>) -> f32 {
    let [largest, second] = scores
        .fold([0.0_f32; 2], |[largest, second], score| [largest.max(score), second.max(score.min(largest))]);
    largest - second
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::{Rgb, RgbImage};

    const SIZE: [u32; 2] = [240, 160];
    const TOOL: [u8; 3] = [120, 125, 135];
    const TISSUE: [u8; 3] = [150, 60, 50];

    /// A tool of 80 columns, which begins at `left`, before tissue. The right border is of another colour.
    fn picture(left: u32) -> RgbImage {
        RgbImage::from_fn(SIZE[0], SIZE[1], |x, y| {
            let grain = ((x * 7 + y * 13) % 5) as u8;
            let colour = match x {
                220.. => [20, 90, 30],
                x if (left..left + 80).contains(&x) => TOOL,
                _ => TISSUE,
            };
            Rgb(colour.map(|level| level + grain))
        })
    }

    #[test]
    fn where_a_tool_was_is_told_by_looks() {
        let shows_tool = |i: usize| if (20..60).contains(&(i % 120)) { 1.0 } else { 0.0 };
        let shares = [(0..120 * 80).map(shows_tool).collect::<Vec<f32>>()];
        let first = RgbImage::from_fn(SIZE[0], SIZE[1], |x, y| {
            if x < 220 { *picture(40).get_pixel(x, y) } else { Rgb(TISSUE) }
        });
        let field_of_view = Mask::filled(SIZE[0] as usize, SIZE[1] as usize, true);
        let looks = Looks::of(&CellFeatures::of(&first, None), &field_of_view, &shares);
        let told = looks.tell(&CellFeatures::of(&picture(100), None));
        let at = |x: usize| [told.shares[0][40 * 120 + x], told.certainty[40 * 120 + x]];
        let [[was, sure], [is, as_sure], [_, unsure]] = [30, 70, 115].map(at);
        assert!(was < 0.1 && sure > 0.7, "{was} {sure}");
        assert!(is > 0.9 && as_sure > 0.7, "{is} {as_sure}");
        assert!(unsure < 0.1, "nothing looked like this: {unsure}");
    }

    #[test]
    fn two_names_that_look_the_same_tell_nothing() {
        assert_eq!(lead([0.25, 1.0, 0.75].into_iter()), 0.25);
        assert_eq!(lead([0.5, 0.5].into_iter()), 0.0);
        assert_eq!(lead(std::iter::empty()), 0.0);
    }
}
