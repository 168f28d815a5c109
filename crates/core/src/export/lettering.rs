//! Words in pictures: white letters on a black plate.

use ab_glyph::{Font, FontRef, GlyphId, PxScale, ScaleFont, point};
use image::{Rgb, RgbImage};
use std::sync::LazyLock;

/// Latin, Greek and Cyrillic letters.
static FONT: LazyLock<Option<FontRef<'static>>> =
    LazyLock::new(|| FontRef::try_from_slice(epaint_default_fonts::UBUNTU_LIGHT).ok());

/// Height of a line as a multiple of that of its letters, from the top of the highest to the bottom of the
/// lowest.
const LINE: f32 = 1.15;

/// Power of a pixel's share of a letter that is its brightness: thin letters stay white.
const THIN: f32 = 0.6;

/// Returns the rows of a line of words for a picture of `rows` rows: legible where the picture is seen whole.
pub(super) fn line_px(rows: u32) -> u32 {
    (rows / 28).clamp(12, 96)
}

/// Returns the columns of words in lines of `line_px` rows.
pub(super) fn width_px(words: &str, line_px: u32) -> u32 {
    let end = FONT.as_ref().map_or(0.0, |font| layout(font, words, line_px, |_, _| ()));
    end.ceil() as u32 + line_px / 3
}

/// Writes a line, the upper left corner of its plate at `(left, top)`. Pixels outside the picture are left
/// out; a letter that the font lacks is a box.
pub(super) fn write(picture: &mut RgbImage, words: &str, (left, top): (u32, u32), line_px: u32) {
    let width = width_px(words, line_px);
    for (x, y) in (0..width).flat_map(|x| (0..line_px).map(move |y| (x, y))) {
        if let Some(pixel) = picture.get_pixel_mut_checked(left.saturating_add(x), top.saturating_add(y)) {
            *pixel = Rgb([0; 3]);
        }
    }
    let Some(font) = FONT.as_ref() else { return };
    let scaled = font.as_scaled(scale(line_px));
    let baseline = top as f32 + (line_px as f32 - scaled.height()) / 2.0 + scaled.ascent();
    let start = left as f32 + line_px as f32 / 6.0;
    layout(font, words, line_px, |glyph, x| {
        let glyph = glyph.with_scale_and_position(scale(line_px), point(start + x, baseline));
        let Some(outlined) = font.outline_glyph(glyph) else { return };
        let corner = outlined.px_bounds().min;
        outlined.draw(|x, y, coverage| {
            let (x, y) = (corner.x as i64 + i64::from(x), corner.y as i64 + i64::from(y));
            let (Ok(x), Ok(y)) = (u32::try_from(x), u32::try_from(y)) else { return };
            if let Some(pixel) = picture.get_pixel_mut_checked(x, y) {
                *pixel = Rgb([(255.0 * coverage.clamp(0.0, 1.0).powf(THIN)) as u8; 3]);
            }
        });
    });
}

/// Breaks words into lines of at most `width` columns, one word at least.
pub(super) fn wrap(words: &str, width: u32, line_px: u32) -> Vec<String> {
    let mut lines: Vec<String> = Vec::new();
    for word in words.split(' ') {
        match lines.last_mut() {
            Some(line) if width_px(&format!("{line} {word}"), line_px) <= width => {
                *line = format!("{line} {word}");
            }
            _ => lines.push(word.to_owned()),
        }
    }
    lines
}

fn scale(line_px: u32) -> PxScale {
    PxScale::from(line_px as f32 / LINE)
}

/// Calls `place` with every letter and its distance from the start, px; returns the distance of the end.
fn layout(font: &FontRef<'_>, words: &str, line_px: u32, mut place: impl FnMut(GlyphId, f32)) -> f32 {
    let scaled = font.as_scaled(scale(line_px));
    let (mut x, mut last) = (0.0, None);
    for letter in words.chars() {
        let id = font.glyph_id(letter);
        x += last.map_or(0.0, |last| scaled.kern(last, id));
        place(id, x);
        x += scaled.h_advance(id);
        last = Some(id);
    }
    x
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_lie_on_their_plate_and_nowhere_else() {
        let mut picture = RgbImage::from_pixel(200, 60, Rgb([90, 0, 0]));
        write(&mut picture, "Жёлчный gλ", (10, 20), 16);
        let width = width_px("Жёлчный gλ", 16);
        let is_on_plate = |x, y| (10..10 + width).contains(&x) && (20..36).contains(&y);
        assert!(picture.enumerate_pixels().all(|(x, y, p)| is_on_plate(x, y) != (p.0 == [90, 0, 0])));
        assert!(picture.pixels().any(|p| p.0[0] > 200), "white letters");
    }

    #[test]
    fn wider_words_take_more_room_and_the_border_cuts_them_off() {
        assert!(width_px("www", 20) > width_px("iii", 20));
        assert!(width_px("gallbladder", 40) > 2 * width_px("gallbladder", 20) - 20);
        let mut small = RgbImage::new(5, 4);
        write(&mut small, "gallbladder", (2, 2), 20);
        write(&mut small, "gallbladder", (u32::MAX, u32::MAX), 20);
        assert_eq!(small.dimensions(), (5, 4));
    }
}
