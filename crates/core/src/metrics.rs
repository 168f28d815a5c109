//! Picture and mask quality: PSNR, SSIM, depth error, IoU in the paper's protocol and in a strict one.

use crate::grid::{Grid, Mask};
use image::RgbImage;

/// Peak signal-to-noise ratio in dB over 8-bit RGB; `mask` (true = counted) or all pixels.
/// Identical images give infinity; an empty mask gives `None`.
pub fn psnr_db(image: &RgbImage, truth: &RgbImage, mask: Option<&Mask>) -> Option<f64> {
    let _ = (image, truth, mask);
    todo!()
}

/// Structural similarity, 11×11 Gaussian window of σ 1.5, mean over pixels and channels.
pub fn ssim(image: &RgbImage, truth: &RgbImage) -> f64 {
    let _ = (image, truth);
    todo!()
}

/// Root mean square error of depth over pixels where both are known (> 0) and `mask` is true.
pub fn depth_rmse(depth: &Grid<f32>, truth: &Grid<f32>, mask: Option<&Mask>) -> Option<f64> {
    let _ = (depth, truth, mask);
    todo!()
}
