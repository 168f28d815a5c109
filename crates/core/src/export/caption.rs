//! Words in exported pictures: frame and time, the prompts that were found, the scale of a heatmap.

use super::{
    ExportPrompt,
    lettering::{line_px, width_px, wrap, write},
};
use crate::palette::Palette;
use image::{Rgb, RgbImage};

/// Words below the scale of a heatmap.
const SCALE_WORDS: &str = "0    similarity    1";

/// Formats seconds as m:ss.hh.
pub fn timecode(seconds: f64) -> String {
    let hundredths = (seconds.max(0.0) * 100.0).round() as u64;
    format!("{}:{:02}.{:02}", hundredths / 6000, hundredths / 100 % 60, hundredths % 100)
}

/// Names a frame as the window does, counted from 1, with its time.
pub fn frame_words(frame: usize, seconds: f64) -> String {
    format!("frame {}  {}", frame + 1, timecode(seconds))
}

/// Names a prompt, with what was asked for if it stands for that.
pub(super) fn prompt_words(prompt: &ExportPrompt) -> String {
    match &prompt.stands_for {
        Some(asked) => format!("{} (asked: {asked})", prompt.text),
        None => prompt.text.clone(),
    }
}

/// Writes a title into the upper left corner. Below it come notes, on several lines if one would be too wide,
/// and what was found, each with its colour.
pub fn caption(picture: &mut RgbImage, title: &str, notes: &[String], found: &[(String, [u8; 3])]) {
    let line = line_px(picture.height());
    write(picture, title, (0, 0), line);
    let notes: Vec<String> = notes.iter().flat_map(|note| wrap(note, picture.width(), line)).collect();
    for (k, words) in notes.iter().enumerate() {
        write(picture, words, (0, (k as u32 + 1) * line), line);
    }
    for (k, (words, colour)) in found.iter().enumerate() {
        let top = (notes.len() as u32 + k as u32 + 1) * line;
        write_entry(picture, words, *colour, (0, top), line);
    }
}

/// Writes a name with its colour, the upper left corner of their plate at `(left, top)`.
pub(super) fn write_entry(
    picture: &mut RgbImage,
    words: &str,
    colour: [u8; 3],
    (left, top): (u32, u32),
    line: u32,
) {
    fill(picture, (left, top), (line, line), |_| [0; 3]);
    let gap = line / 5;
    fill(picture, (left + gap, top + gap), (line - 2 * gap, line - 2 * gap), |_| colour);
    write(picture, words, (left + line, top), line);
}

/// Returns the columns of a name with its colour in lines of `line` rows.
pub(super) fn entry_px(words: &str, line: u32) -> u32 {
    line + width_px(words, line)
}

/// Draws the scale of a heatmap into the lower right corner: the colours of scores from 0 to 1.
pub fn draw_scale(picture: &mut RgbImage, palette: Palette) {
    let height = line_px(picture.height());
    let width = width_px(SCALE_WORDS, height);
    let (left, top) = match (picture.width().checked_sub(width), picture.height().checked_sub(2 * height)) {
        (Some(left), Some(top)) => (left, top),
        // The picture is too small for a scale.
        _ => return,
    };
    fill(picture, (left, top), (width, height), |x| {
        palette.colour(x as f32 / (width - 1).max(1) as f32).map(|v| v as u8)
    });
    write(picture, SCALE_WORDS, (left, top + height), height);
}

/// Fills a rectangle; `colour` is asked for each column. Pixels outside the picture are left out.
fn fill(
    picture: &mut RgbImage,
    (left, top): (u32, u32),
    (w, h): (u32, u32),
    colour: impl Fn(u32) -> [u8; 3],
) {
    for (x, y) in (0..w).flat_map(|x| (0..h).map(move |y| (x, y))) {
        if let Some(pixel) = picture.get_pixel_mut_checked(left + x, top + y) {
            *pixel = Rgb(colour(x));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_in_minutes() {
        assert_eq!(timecode(61.456), "1:01.46");
        assert_eq!(timecode(59.999), "1:00.00");
        assert_eq!(timecode(-1.0), "0:00.00");
    }

    #[test]
    fn notes_lie_below_the_title_and_are_never_cut_off() {
        const LONG: &str = "Synthesised view – not what the endoscope saw";
        let width = width_px(LONG, 12) - 1;
        let lines = |notes: &[&str]| {
            let mut picture = RgbImage::from_pixel(width, 120, Rgb([90, 0, 0]));
            let notes: Vec<String> = notes.iter().map(|note| (*note).to_owned()).collect();
            caption(&mut picture, "frame 1", &notes, &[("liver".into(), [0, 200, 0])]);
            (0..10).take_while(|line| picture.get_pixel(0, 12 * line + 6).0 != [90, 0, 0]).count()
        };
        assert_eq!([lines(&[]), lines(&["guessed"]), lines(&["guessed", LONG])], [2, 3, 5]);
    }

    #[test]
    fn the_scale_runs_from_dark_to_bright_and_small_pictures_have_none() {
        let mut picture = RgbImage::new(200, 60);
        draw_scale(&mut picture, Palette::Viridis);
        let left = 200 - width_px(SCALE_WORDS, 12);
        assert_eq!(picture.get_pixel(left, 40).0, Palette::Viridis.colour(0.0).map(|v| v as u8));
        assert_eq!(picture.get_pixel(199, 40).0, Palette::Viridis.colour(1.0).map(|v| v as u8));
        let mut small = RgbImage::new(40, 24);
        draw_scale(&mut small, Palette::Viridis);
        assert_eq!(small, RgbImage::new(40, 24));
    }
}
