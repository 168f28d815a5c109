//! The words on every overlay. They are part of the picture, because screenshots travel
//! without their caption.

use super::lettering::{line_px, width_px, write};
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

/// Breaks words into lines of at most `width` columns, one word at least.
fn wrap(words: &str, width: u32, height: u32) -> Vec<String> {
    let mut lines: Vec<String> = Vec::new();
    for word in words.split(' ') {
        match lines.last_mut() {
            Some(line) if width_px(&format!("{line} {word}"), height) <= width => {
                *line = format!("{line} {word}");
            }
            _ => lines.push(word.to_owned()),
        }
    }
    lines
}
