//! Masks from scores: threshold, area, outline.

use crate::grid::{Grid, Mask};

/// Pixels whose score is above `threshold` (strictly).
pub fn threshold(scores: &Grid<f32>, threshold: f32) -> Mask {
    scores.map(|&s| s > threshold)
}

/// `true` within `width_px` inside the border of the mask (4-neighbourhood, image border excluded).
pub fn outline(mask: &Mask, width_px: usize) -> Mask {
    let _ = (mask, width_px);
    todo!()
}

/// |a ∩ b| / |a ∪ b|; `None` when both are empty. Sizes must agree.
pub fn iou(a: &Mask, b: &Mask) -> Option<f64> {
    let _ = (a, b);
    todo!()
}
