//! The words on every overlay. They are part of the picture, because screenshots travel
//! without their caption.

use super::lettering::{line_px, wrap, write};
use image::RgbImage;

pub(super) const WORDS: &str = "research use only";

/// Writes "research use only" into the lower left corner, white on black; on several lines if one would be
/// too wide.
pub fn stamp(image: &mut RgbImage) {
    let height = line_px(image.height());
    let lines = wrap(WORDS, image.width(), height);
    for (k, line) in lines.iter().rev().enumerate() {
        let Some(top) = image.height().checked_sub((k as u32 + 1) * height) else { break };
        write(image, line, (0, top), height);
    }
}
