//! The words on every overlay. They are part of the picture, because screenshots travel
//! without their caption.

use font8x8::UnicodeFonts;
use image::{Rgb, RgbImage};

pub(super) const WORDS: &str = "research use only";
/// Side of a letter at size 1, px.
pub(super) const LETTER: u32 = 8;
const INK: Rgb<u8> = Rgb([255, 255, 255]);
const PAPER: Rgb<u8> = Rgb([0, 0, 0]);

/// Writes "research use only" into the lower left corner, white on black; on several lines if one would be
/// too wide.
pub fn stamp(image: &mut RgbImage) {
    let size = (image.height() / 240).clamp(1, 8);
    let columns = (image.width() / (LETTER * size)) as usize;
    let lines = wrap(WORDS, columns);
    for (k, line) in lines.iter().rev().enumerate() {
        let top = image.height().checked_sub((k as u32 + 1) * LETTER * size);
        let Some(top) = top else { break };
        write(image, line, (0, top), size);
    }
}

/// Writes a line, white on black, its upper left corner at `(left, top)`.
pub(super) fn write(image: &mut RgbImage, line: &str, (left, top): (u32, u32), size: u32) {
    for (column, letter) in line.chars().enumerate() {
        draw_letter(image, letter, left + column as u32 * LETTER * size, top, size);
    }
}

fn wrap(words: &str, columns: usize) -> Vec<String> {
    let mut lines: Vec<String> = Vec::new();
    for word in words.split(' ') {
        match lines.last_mut() {
            Some(line) if line.len() + 1 + word.len() <= columns => *line = format!("{line} {word}"),
            _ => lines.push(word.to_owned()),
        }
    }
    lines
}

/// Returns the rows of a letter's dots; letters that the font lacks are question marks.
fn dots(letter: char) -> [u8; LETTER as usize] {
    let fonts = [
        font8x8::BASIC_FONTS.get(letter),
        font8x8::LATIN_FONTS.get(letter),
        font8x8::GREEK_FONTS.get(letter),
    ];
    fonts.into_iter().flatten().next().or(font8x8::BASIC_FONTS.get('?')).unwrap_or_default()
}

/// Draws a letter with `size` pixels per dot; pixels outside the image are left out.
fn draw_letter(image: &mut RgbImage, letter: char, left: u32, top: u32, size: u32) {
    let rows = dots(letter);
    for y in 0..LETTER * size {
        for x in 0..LETTER * size {
            let is_ink = rows[(y / size) as usize] >> (x / size) & 1 == 1;
            if let Some(pixel) = image.get_pixel_mut_checked(left + x, top + y) {
                *pixel = if is_ink { INK } else { PAPER };
            }
        }
    }
}
