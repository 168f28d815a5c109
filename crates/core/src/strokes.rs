//! Draws smooth lines on pictures, with soft edges and a dark halo.

use crate::{grid::Grid, mask::BorderLine};
use image::RgbImage;

/// Number of rows of a picture for each pixel of a line's width.
const ROWS_PER_PX: f32 = 270.0;
/// Least width of a line, px.
const LEAST_WIDTH: f32 = 2.0;
/// Width of the halo on either side of a line, as share of the line's width.
pub const HALO: f32 = 0.5;
/// Amount by which the halo on either side of a contour darkens the frame. It keeps contours visible on any
/// tissue.
pub const HALO_DARKNESS: f32 = 0.6;
/// Length of a dash and of the gap behind it, in widths of the line.
const DASH: f32 = 4.0;

/// Precision of the ends of dashes: steps in the length of a dash.
const STEPS_PER_DASH: f32 = 8.0;
/// Most steps between two points.
const MAX_STEPS: f32 = 1000.0;

/// Lines of one prompt, with their look.
#[derive(Clone, Debug, PartialEq)]
pub struct Outline {
    /// Lines around what was found, in pixels of the scores.
    pub lines: Vec<BorderLine>,
    /// The prompt's own colour.
    pub colour: [u8; 3],
    /// `true` for a dashed line.
    pub is_dashed: bool,
}

/// A line as it is drawn: points, and `true` if the last one joins the first.
pub type Stroke = (Vec<[f32; 2]>, bool);

impl Outline {
    /// Returns the lines as they are drawn with a `width`; `place` maps pixels of the scores to the drawing.
    pub fn strokes(&self, width: f32, place: impl Fn([f32; 2]) -> [f32; 2] + Copy) -> Vec<Stroke> {
        let placed = self.lines.iter().map(|line| (line.placed(width, place), line.is_closed));
        if self.is_dashed {
            placed.flat_map(|stroke| dashes(stroke, DASH * width)).collect()
        } else {
            placed.collect()
        }
    }
}

/// Returns the width of lines on a picture with so many rows, px.
pub fn line_width(rows: u32) -> f32 {
    (rows as f32 / ROWS_PER_PX).max(LEAST_WIDTH)
}

/// Draws outlines on a picture, whatever its size; they are given in pixels of an image with `size` columns
/// and rows. The halos lie below all lines. `opacity` is 0–1.
pub fn draw_outlines(picture: &mut RgbImage, outlines: &[Outline], size: (usize, usize), opacity: f32) {
    let (width, height) = picture.dimensions();
    let scale = [width as f32 / size.0.max(1) as f32, height as f32 / size.1.max(1) as f32];
    let line = line_width(height);
    let place = |[x, y]: [f32; 2]| [x * scale[0], y * scale[1]];
    let strokes: Vec<Vec<Stroke>> = outlines.iter().map(|o| o.strokes(line, place)).collect();
    let mut cover = Grid::filled(width as usize, height as usize, 0.0);
    strokes.iter().flatten().for_each(|s| add_cover(&mut cover, s, line * (0.5 + HALO)));
    blend(picture, &cover, [0; 3], HALO_DARKNESS * opacity);
    for (outline, strokes) in outlines.iter().zip(&strokes).filter(|(_, strokes)| !strokes.is_empty()) {
        cover.data.fill(0.0);
        strokes.iter().for_each(|s| add_cover(&mut cover, s, 0.5 * line));
        blend(picture, &cover, outline.colour, opacity);
    }
}

/// Cuts a line into dashes.
fn dashes((points, is_closed): Stroke, length: f32) -> Vec<Stroke> {
    let first = if is_closed { points.first().copied() } else { None };
    let points: Vec<[f32; 2]> = points.into_iter().chain(first).collect();
    let mut dashes: Vec<Stroke> = Vec::new();
    let (mut way, mut was_gap) = (0.0_f32, true);
    for pair in points.windows(2) {
        let ([x0, y0], [x1, y1]) = (pair[0], pair[1]);
        let whole = (x1 - x0).hypot(y1 - y0);
        let steps = (whole / length * STEPS_PER_DASH).ceil().clamp(1.0, MAX_STEPS);
        for step in 0..steps as usize {
            let share = step as f32 / steps;
            let point = [x0 + share * (x1 - x0), y0 + share * (y1 - y0)];
            let is_gap = ((way + share * whole) / length) as usize % 2 == 1;
            match dashes.last_mut().filter(|_| !was_gap) {
                Some((dash, _)) if !is_gap => dash.push(point),
                _ if !is_gap => dashes.push((vec![point], false)),
                _ => {}
            }
            was_gap = is_gap;
        }
        way += whole;
    }
    dashes.retain(|(dash, _)| dash.len() > 1);
    dashes
}

/// Adds the share of each pixel that a line covers, as far as it is not covered yet.
fn add_cover(cover: &mut Grid<f32>, (points, is_closed): &Stroke, radius: f32) {
    let next = points.iter().cycle().skip(1);
    let count = if *is_closed { points.len() } else { points.len().saturating_sub(1) };
    for (a, b) in points.iter().zip(next).take(count) {
        let reach = radius + 1.0;
        let range = |c: usize, end: usize| {
            let (low, high) = (a[c].min(b[c]) - reach, a[c].max(b[c]) + reach);
            low.max(0.0) as usize..(high.max(0.0) as usize + 1).min(end)
        };
        for y in range(1, cover.height) {
            for x in range(0, cover.width) {
                let distance = distance([x as f32 + 0.5, y as f32 + 0.5], *a, *b);
                let share = (radius + 0.5 - distance).clamp(0.0, 1.0);
                let place = &mut cover.data[y * cover.width + x];
                *place = place.max(share);
            }
        }
    }
}

/// Distance of a point from the line between `a` and `b`.
fn distance([x, y]: [f32; 2], a: [f32; 2], b: [f32; 2]) -> f32 {
    let (dx, dy) = (b[0] - a[0], b[1] - a[1]);
    let along = ((x - a[0]) * dx + (y - a[1]) * dy) / (dx * dx + dy * dy).max(f32::MIN_POSITIVE);
    let along = along.clamp(0.0, 1.0);
    (x - a[0] - along * dx).hypot(y - a[1] - along * dy)
}

fn blend(picture: &mut RgbImage, cover: &Grid<f32>, colour: [u8; 3], opacity: f32) {
    for (pixel, share) in picture.pixels_mut().zip(&cover.data).filter(|(_, share)| **share > 0.0) {
        let share = share * opacity.clamp(0.0, 1.0);
        for (own, drawn) in pixel.0.iter_mut().zip(colour) {
            *own = (f32::from(*own) + (f32::from(drawn) - f32::from(*own)) * share).round() as u8;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{grid::Mask, mask::border_lines};
    use image::Rgb;

    fn outline(is_dashed: bool) -> Outline {
        let left: Mask = Grid::from_vec(40, 24, (0..40 * 24).map(|i| i % 40 < 20).collect());
        let lines = border_lines(&[left], |_, _, _| false).remove(0);
        Outline { lines, colour: [0, 200, 80], is_dashed }
    }

    fn drawn(width: u32, height: u32, outline: Outline) -> RgbImage {
        let mut picture = RgbImage::from_pixel(width, height, Rgb([100; 3]));
        draw_outlines(&mut picture, &[outline], (40, 24), 1.0);
        picture
    }

    #[test]
    fn a_line_lies_inside_the_border_between_halos_at_any_size() {
        let picture = drawn(40, 24, outline(false));
        let row: Vec<[u8; 3]> = (15..24).map(|x| picture.get_pixel(x, 12).0).collect();
        let (bare, dark, green) = ([100; 3], [40; 3], [0, 200, 80]);
        assert_eq!(row, [bare, bare, dark, green, green, dark, bare, bare, bare]);
        // Four times as large: as wide as before, because the picture still has few rows.
        let picture = drawn(160, 96, outline(false));
        let greens = (0..160).filter(|x| picture.get_pixel(*x, 50).0 == green).collect::<Vec<_>>();
        assert_eq!(greens, [78, 79]);
        assert_eq!((line_width(1080), line_width(480)), (4.0, 2.0));
    }

    #[test]
    fn a_dashed_line_has_gaps() {
        let picture = drawn(160, 96, outline(true));
        let is_line = |y: &u32| picture.get_pixel(78, *y).0 == [0, 200, 80];
        let count = (4..92).filter(is_line).count();
        assert!((30..60).contains(&count), "{count} of 88 rows");
    }

    #[test]
    fn a_faint_line_lets_the_picture_through() {
        let mut picture = RgbImage::from_pixel(40, 24, Rgb([100; 3]));
        draw_outlines(&mut picture, &[outline(false)], (40, 24), 0.5);
        assert_eq!(picture.get_pixel(18, 12).0, [35, 135, 75], "over its halo");
        draw_outlines(&mut picture, &[], (40, 24), 1.0);
        draw_outlines(&mut RgbImage::new(0, 0), &[outline(false)], (40, 24), 1.0);
    }
}
