//! Choice of the masks that stay among many overlapping ones.

use super::{MaskNms, bit_mask::BitMask};
use crate::mask::PixelRect;
use rayon::prelude::*;

/// Returns the numbers of the boxes that stay, best score first. Of two that overlap by more than
/// `max_iou` the better one stays, on a tie the earlier one. A score that is not a number is the worst.
pub(super) fn box_nms(boxes: &[PixelRect], scores: &[f32], max_iou: f32) -> Vec<usize> {
    let mut kept: Vec<usize> = Vec::new();
    for i in best_first(scores) {
        if kept.iter().all(|&k| box_iou(boxes[k], boxes[i]) <= max_iou) {
            kept.push(i);
        }
    }
    kept
}

fn best_first(scores: &[f32]) -> Vec<usize> {
    let mut order: Vec<usize> = (0..scores.len()).collect();
    let score = |i: usize| if scores[i].is_nan() { f32::NEG_INFINITY } else { scores[i] };
    order.sort_by(|&a, &b| score(b).total_cmp(&score(a)));
    order
}

/// Overlap of two boxes between their first and last pixels, as Segment Anything measures it: a box one
/// pixel wide has no area and overlaps nothing.
fn box_iou(a: PixelRect, b: PixelRect) -> f32 {
    let shared = |a: usize, a_length: usize, b: usize, b_length: usize| {
        (a + a_length - 1).min(b + b_length - 1).saturating_sub(a.max(b))
    };
    let both = shared(a.x, a.width, b.x, b.width) * shared(a.y, a.height, b.y, b.height);
    let area = |r: PixelRect| (r.width - 1) * (r.height - 1);
    if both == 0 { 0.0 } else { both as f32 / (area(a) + area(b) - both) as f32 }
}

/// Returns the numbers of the masks that stay, ascending (LangSplat's `mask_nms`). A mask is removed if
///
/// - a better one overlaps it by more than `iou`,
/// - its score is not above `score`, or
/// - it lies inside a larger one (at least 0.85 of it, which is less than half of the other) and 1 minus
///   the product of both shares is above `containment`.
///
/// If no mask passes the second or the third rule, the three best ones pass it.
pub(super) fn mask_nms(masks: &[&BitMask], scores: &[f32], rule: &MaskNms) -> Vec<usize> {
    let order = best_first(scores);
    let (mut is_new, mut is_good, mut is_apart) =
        (vec![true; order.len()], vec![true; order.len()], vec![true; order.len()]);
    let overlaps: Vec<Vec<usize>> = (0..order.len())
        .into_par_iter()
        .map(|i| (i + 1..order.len()).map(|j| masks[order[i]].intersection_px(masks[order[j]])).collect())
        .collect();
    for (i, overlaps) in overlaps.iter().enumerate() {
        is_good[i] = scores[order[i]] > rule.score;
        for (j, &both) in (i + 1..).zip(overlaps).filter(|(_, both)| **both > 0) {
            let (a, b) = (masks[order[i]].area_px(), masks[order[j]].area_px());
            let both = both as f32;
            is_new[j] &= both / (a as f32 + b as f32 - both) <= rule.iou;
            let (of_a, of_b) = (both / a as f32, both / b as f32);
            let is_far_inside = 1.0 - of_a * of_b > rule.containment;
            is_apart[j] &= !(of_a < 0.5 && of_b >= 0.85 && is_far_inside);
            is_apart[i] &= !(of_a >= 0.85 && of_b < 0.5 && is_far_inside);
        }
    }
    for passes in [&mut is_good, &mut is_apart] {
        if passes.iter().all(|passes| !passes) {
            passes.iter_mut().take(3).for_each(|passes| *passes = true);
        }
    }
    let stays = |i: &usize| is_new[*i] && is_good[*i] && is_apart[*i];
    let mut kept: Vec<usize> = (0..order.len()).filter(stays).map(|i| order[i]).collect();
    kept.sort_unstable();
    kept
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::grid::Grid;

    fn rect(x: usize, y: usize, width: usize, height: usize) -> PixelRect {
        PixelRect { x, y, width, height }
    }

    fn mask(r: PixelRect) -> BitMask {
        let inside = |i: usize| {
            let (x, y) = (i % 100, i / 100);
            (r.x..r.x + r.width).contains(&x) && (r.y..r.y + r.height).contains(&y)
        };
        BitMask::of(&Grid::from_vec(100, 100, (0..10_000).map(inside).collect())).unwrap()
    }

    const RULE: MaskNms = MaskNms { iou: 0.8, score: 0.7, containment: 0.5 };

    fn kept(rects: &[PixelRect], scores: &[f32]) -> Vec<usize> {
        let masks: Vec<_> = rects.iter().map(|r| mask(*r)).collect();
        mask_nms(&masks.iter().collect::<Vec<_>>(), scores, &RULE)
    }

    #[test]
    fn of_two_boxes_the_better_stays() {
        // Ten of a hundred columns apart: the first two overlap by 90 / 110.
        let boxes = [rect(0, 0, 101, 11), rect(10, 0, 101, 11), rect(60, 0, 101, 11)];
        assert_eq!(box_nms(&boxes, &[0.7, 0.9, 0.8], 0.7), [1, 2]);
        assert_eq!(box_nms(&boxes, &[0.7, 0.9, 0.8], 0.85), [1, 2, 0]);
        assert_eq!(box_nms(&boxes, &[0.5, 0.5, 0.5], 0.7), [0, 2], "the earlier one on a tie");
        assert_eq!(box_nms(&boxes, &[f32::NAN, 0.1, f32::NAN], 0.7), [1, 2]);
        assert!(box_nms(&[], &[], 0.7).is_empty());
        assert_eq!(box_nms(&[rect(3, 3, 1, 9), rect(3, 3, 1, 9)], &[0.2, 0.1], 0.7), [0, 1]);
    }

    #[test]
    fn nearly_the_same_mask_stays_once() {
        // 90 of 110 columns are shared: 0.82.
        assert_eq!(kept(&[rect(0, 0, 50, 50), rect(2, 0, 50, 50)], &[0.8, 0.9]), [1]);
        assert_eq!(kept(&[rect(0, 0, 50, 50), rect(8, 0, 50, 50)], &[0.8, 0.9]), [0, 1]);
    }

    #[test]
    fn what_lies_inside_goes_whatever_its_score() {
        let (large, small, half) = (rect(0, 0, 60, 60), rect(10, 10, 20, 20), rect(0, 0, 60, 40));
        assert_eq!(kept(&[large, small], &[0.8, 0.95]), [0]);
        assert_eq!(kept(&[large, small], &[0.95, 0.8]), [0]);
        assert_eq!(kept(&[large, half], &[0.8, 0.95]), [0, 1], "two thirds are not a part");
        let without = MaskNms { containment: 1.0, ..RULE };
        let (a, b) = (mask(large), mask(small));
        assert_eq!(mask_nms(&[&a, &b], &[0.8, 0.95], &without), [0, 1]);
    }

    #[test]
    fn low_scores_go_unless_all_are_low() {
        let rects = [rect(0, 0, 9, 9), rect(20, 0, 9, 9), rect(40, 0, 9, 9), rect(60, 0, 9, 9)];
        assert_eq!(kept(&rects, &[0.9, 0.7, 0.71, 0.1]), [0, 2]);
        assert_eq!(kept(&rects, &[0.1, 0.4, 0.2, 0.3]), [1, 2, 3]);
        assert!(kept(&[], &[]).is_empty());
    }
}
