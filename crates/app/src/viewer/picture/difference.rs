//! Comparison of the recorded frame with its reconstruction, pixel by pixel.

use crate::viewer::picture::layer_colours::depth_colour;
use egui::ColorImage;
use image::RgbImage;
use std::sync::Arc;
use surgtpgs_core::metrics::psnr_db;

/// Difference between two pictures of one frame.
#[derive(Clone, Debug)]
pub(crate) struct Difference {
    pub(crate) image: Arc<ColorImage>,
    /// PSNR of the whole picture; `None` where both pictures are the same.
    pub(crate) psnr_db: Option<f64>,
}

/// Difference at the bright end of the colour scale, in levels of 255. Fixed, so that frames can be compared.
pub(crate) const FULL_SCALE: f32 = 64.0;
/// Seconds for which each of the two pictures is shown when they alternate.
pub(crate) const BLINK_SECS: f64 = 0.6;

impl Difference {
    /// Compares two pictures at the size of the reconstruction.
    pub(crate) fn of(recorded: &RgbImage, rendered: &RgbImage) -> Self {
        let (width, height) = rendered.dimensions();
        let resized;
        let recorded = if recorded.dimensions() == (width, height) {
            recorded
        } else {
            resized = image::imageops::thumbnail(recorded, width, height);
            &resized
        };
        let level = |(a, b): (&image::Rgb<u8>, &image::Rgb<u8>)| {
            let largest = (0..3).map(|c| a.0[c].abs_diff(b.0[c])).max().unwrap_or(0);
            difference_colour(f32::from(largest) / FULL_SCALE)
        };
        let pixels = recorded.pixels().zip(rendered.pixels()).map(level).collect();
        let image = ColorImage::new([width as usize, height as usize], pixels);
        let psnr_db = psnr_db(rendered, recorded, None).filter(|_| rendered != recorded);
        Self { image: Arc::new(image), psnr_db }
    }
}

/// Returns the colour of a difference, dark where nothing differs; `share` is 0–1 of the scale.
pub(crate) fn difference_colour(share: f32) -> egui::Color32 {
    depth_colour(1.0 - share.clamp(0.0, 1.0))
}

/// Returns `true` while it is the recorded frame's turn.
pub(crate) fn is_recorded_turn(now: f64) -> bool {
    (now / BLINK_SECS).rem_euclid(2.0) < 1.0
}

/// Returns the seconds until the other picture's turn.
pub(crate) fn seconds_to_turn(now: f64) -> f64 {
    BLINK_SECS - now.rem_euclid(BLINK_SECS)
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::Rgb;

    #[test]
    fn equal_pixels_are_dark_and_the_largest_channel_counts() {
        let recorded = RgbImage::from_fn(2, 1, |x, _| Rgb([10, 20 + 32 * x as u8, 30]));
        let rendered = RgbImage::from_pixel(2, 1, Rgb([10, 20, 28]));
        let difference = Difference::of(&recorded, &rendered);
        assert_eq!(difference.image.pixels[0], difference_colour(2.0 / FULL_SCALE));
        assert_eq!(difference.image.pixels[1], difference_colour(0.5));
        let psnr = 10.0 * (255.0_f64.powi(2) * 6.0 / (4.0 + 32.0 * 32.0 + 4.0)).log10();
        assert!((difference.psnr_db.unwrap() - psnr).abs() < 1e-6);
    }

    #[test]
    fn the_same_picture_differs_nowhere_and_sizes_may_differ() {
        let picture = RgbImage::from_pixel(4, 4, Rgb([9; 3]));
        let same = Difference::of(&picture, &picture);
        assert_eq!((same.psnr_db, same.image.pixels[5]), (None, difference_colour(0.0)));
        assert_eq!(Difference::of(&picture, &RgbImage::new(2, 2)).image.size, [2, 2]);
        assert!(Difference::of(&RgbImage::new(0, 0), &RgbImage::new(0, 0)).image.pixels.is_empty());
    }

    #[test]
    fn turns_follow_the_clock() {
        assert!(
            is_recorded_turn(0.1)
                && !is_recorded_turn(BLINK_SECS + 0.1)
                && is_recorded_turn(2.1 * BLINK_SECS)
        );
        assert!((seconds_to_turn(BLINK_SECS * 0.75) - BLINK_SECS * 0.25).abs() < 1e-9);
    }
}
