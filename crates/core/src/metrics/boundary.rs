//! Quality of the borders of masks.

use crate::{grid::Mask, mask::outline};

/// Largest distance of matching borders as a share of the image's diagonal, as in DAVIS
/// (Perazzi et al. 2016).
const TOLERANCE: f64 = 0.008;

/// F-measure of borders (Martin et al. 2004). It combines two shares: of the predicted border that lies
/// near the labelled one, and of the labelled border that lies near the predicted one. 1 if neither has a
/// border inside the image; `None` if sizes differ.
pub fn boundary_f(prediction: &Mask, truth: &Mask) -> Option<f64> {
    if (prediction.width, prediction.height) != (truth.width, truth.height) {
        return None;
    }
    let reach = (TOLERANCE * (truth.width as f64).hypot(truth.height as f64)).ceil() as usize;
    let (predicted, labelled) = (outline(prediction, 1), outline(truth, 1));
    let near = |border: &Mask, other: &Mask| -> Option<f64> {
        let close = widened(other, reach);
        let met = border.data.iter().zip(&close.data).filter(|(b, c)| **b && **c).count();
        let all = border.count();
        (all > 0).then(|| met as f64 / all as f64)
    };
    match (near(&predicted, &labelled), near(&labelled, &predicted)) {
        (None, None) => Some(1.0),
        (Some(precision), Some(recall)) if precision + recall > 0.0 => {
            Some(2.0 * precision * recall / (precision + recall))
        }
        _ => Some(0.0),
    }
}

/// Returns every pixel whose distance to a `true` one is at most `reach`.
fn widened(mask: &Mask, reach: usize) -> Mask {
    let mut wide = Mask::filled(mask.width, mask.height, false);
    for i in (0..mask.data.len()).filter(|&i| mask.data[i]) {
        let (x, y) = (i % mask.width, i / mask.width);
        for row in y.saturating_sub(reach)..(y + reach + 1).min(mask.height) {
            let half = (((reach * reach) - row.abs_diff(y).pow(2)) as f64).sqrt() as usize;
            let (from, to) = (x.saturating_sub(half), (x + half + 1).min(mask.width));
            wide.data[row * mask.width + from..row * mask.width + to].fill(true);
        }
    }
    wide
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Draws a square of 20 px with its corner at (x, y), in an image of 100×75 px: borders match at 1 px.
    fn square(x: usize, y: usize) -> Mask {
        let inside = |i: usize| (x..x + 20).contains(&(i % 100)) && (y..y + 20).contains(&(i / 100));
        Mask::from_vec(100, 75, (0..7500).map(inside).collect())
    }

    #[test]
    fn borders_meet_within_the_tolerance() {
        let f = |a: &Mask, b: &Mask| boundary_f(a, b).unwrap();
        assert_eq!(f(&square(10, 10), &square(10, 10)), 1.0);
        assert_eq!(f(&square(11, 10), &square(10, 10)), 1.0);
        // Two of four sides match.
        let half = f(&square(15, 10), &square(10, 10));
        assert!((0.3..0.6).contains(&half), "{half}");
        assert_eq!(f(&square(60, 40), &square(10, 10)), 0.0);
    }

    #[test]
    fn empty_and_full_masks_have_no_border() {
        let (empty, full) = (Mask::filled(100, 75, false), Mask::filled(100, 75, true));
        assert_eq!(boundary_f(&empty, &full), Some(1.0));
        assert_eq!(boundary_f(&square(5, 5), &empty), Some(0.0));
        assert_eq!(boundary_f(&empty, &Mask::filled(3, 3, true)), None);
    }

    #[test]
    fn widening_is_round() {
        let mut point = Mask::filled(9, 9, false);
        point.set(4, 4, true);
        let wide = widened(&point, 3);
        let expected = |i: usize| (i % 9).abs_diff(4).pow(2) + (i / 9).abs_diff(4).pow(2) <= 9;
        assert_eq!(wide.data, (0..81).map(expected).collect::<Vec<_>>());
        assert_eq!(widened(&Mask::filled(4, 4, false), 3).count(), 0);
    }
}
