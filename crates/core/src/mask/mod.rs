//! Masks from scores: threshold, outline, overlap, measures, and the clean-up at the user's request.

mod bits;
mod border;
mod clean_up;
mod contour;
mod parts;
mod region;
mod rle;

pub use border::{BorderLine, border_lines};
pub use clean_up::{CleanUp, MAX_SMOOTH, mean_scores};
pub use contour::{Corner, contours};
pub use region::Region;
pub use rle::{Runs, column_runs, compressed, decompressed};

pub(crate) use bits::{Bits, WORD, set_bits};
pub(crate) use parts::{Run, Touching, area, parts};

use crate::grid::{Grid, Mask};
use rayon::prelude::*;

/// Pixels whose score is above `threshold` (strictly); NaN never is.
pub fn threshold(scores: &Grid<f32>, threshold: f32) -> Mask {
    scores.map(|&s| s > threshold)
}

/// Makes one mask per score image, with each pixel in at most one of them. If a pixel is above several
/// thresholds, the highest score wins (the earlier image on a tie). Images of another size than the first
/// get an empty mask.
pub fn exclusive(scores: &[&Grid<f32>], thresholds: &[f32]) -> Vec<Mask> {
    let Some((width, height)) = scores.first().map(|s| (s.width, s.height)) else { return Vec::new() };
    let mut masks = vec![Grid::filled(width, height, false); scores.len()];
    for pixel in 0..width * height {
        let mut best: Option<(usize, f32)> = None;
        for (k, (image, &limit)) in scores.iter().zip(thresholds).enumerate() {
            let score = if (image.width, image.height) == (width, height) { image.data[pixel] } else { 0.0 };
            if score > limit && best.is_none_or(|(_, s)| score > s) {
                best = Some((k, score));
            }
        }
        if let Some((k, _)) = best {
            masks[k].data[pixel] = true;
        }
    }
    masks
}

/// Band of `width_px` inside the border of the mask (4-neighbourhood, image border excluded): the pixels
/// that `width_px` erosions would take away.
pub fn outline(mask: &Mask, width_px: usize) -> Mask {
    let bits = Bits::of_mask(mask);
    // No pixel is further from the border than this.
    let erosions = width_px.min(mask.width + mask.height);
    let inside = (0..erosions).fold(bits.clone(), |bits, _| bits.eroded());
    bits.without(&inside).to_mask()
}

/// |a ∩ b| / |a ∪ b|; `None` if both are empty or their sizes differ.
pub fn iou(a: &Mask, b: &Mask) -> Option<f64> {
    if (a.width, a.height) != (b.width, b.height) {
        return None;
    }
    let (mut both, mut either) = (0_usize, 0_usize);
    for (&a, &b) in a.data.iter().zip(&b.data) {
        both += usize::from(a && b);
        either += usize::from(a || b);
    }
    (either > 0).then(|| both as f64 / either as f64)
}

/// A rectangle of whole pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub struct PixelRect {
    /// Leftmost column.
    pub x: usize,
    /// Topmost row.
    pub y: usize,
    /// Number of columns.
    pub width: usize,
    /// Number of rows.
    pub height: usize,
}

/// Smallest rectangle around the `true` pixels; `None` for an empty mask.
pub fn bounding_box(mask: &Mask) -> Option<PixelRect> {
    let mut corners: Option<[usize; 4]> = None;
    for (i, _) in mask.data.iter().enumerate().filter(|(_, v)| **v) {
        let (x, y) = (i % mask.width, i / mask.width);
        let [x0, y0, x1, y1] = corners.unwrap_or([x, y, x, y]);
        corners = Some([x0.min(x), y0.min(y), x1.max(x), y1.max(y)]);
    }
    corners.map(|[x0, y0, x1, y1]| PixelRect { x: x0, y: y0, width: x1 - x0 + 1, height: y1 - y0 + 1 })
}

/// Removes connected parts (8-neighbourhood) of fewer than `min_area_px` pixels.
pub fn remove_small(mask: &Mask, min_area_px: usize) -> Mask {
    let mut kept = mask.clone();
    let parts = parts_of(mask, true, Touching::Corners);
    parts.iter().filter(|part| area(part) < min_area_px).for_each(|part| set(&mut kept, part, false));
    kept
}

/// Fills holes (4-neighbourhood) of at most `max_area_px` pixels. Parts that touch the image border are
/// no holes.
pub fn fill_holes(mask: &Mask, max_area_px: usize) -> Mask {
    let mut filled = mask.clone();
    let (width, height) = (mask.width, mask.height);
    let at_border = |run: &Run| run.y == 0 || run.y + 1 == height || run.from == 0 || run.to == width;
    let is_hole = |part: &&Vec<Run>| area(part) <= max_area_px && !part.iter().any(at_border);
    let parts = parts_of(mask, false, Touching::Sides);
    parts.iter().filter(is_hole).for_each(|part| set(&mut filled, part, true));
    filled
}

fn parts_of(mask: &Mask, value: bool, touching: Touching) -> Vec<Vec<Run>> {
    let bits = Bits::of_mask(mask);
    parts(bits.rows(), mask.width, value, touching)
}

fn set(mask: &mut Mask, part: &[Run], value: bool) {
    for run in part {
        mask.data[run.y * mask.width..][run.from..run.to].fill(value);
    }
}

/// Rows of a mask that one thread rounds at once.
const BAND: usize = 32;

/// Rounds the border: a pixel is in the mask if most of the pixels are that are at most `radius_px` columns
/// and rows away. Only pixels of the image count.
pub fn smoothed(mask: &Mask, radius_px: usize) -> Mask {
    let (w, h) = (mask.width, mask.height);
    let near = |at: usize, end: usize| at.saturating_sub(radius_px)..(at + radius_px + 1).min(end);
    let row = |y: usize| mask.row(y).iter().map(|found| u32::from(*found));
    let mut rounded = Grid::filled(w, h, false);
    rounded.data.par_chunks_mut(w.max(1) * BAND).enumerate().for_each(|(band, out)| {
        // Number of found pixels in the rows that are near: of each column, and of all columns before one.
        let (mut columns, mut before) = (vec![0_u32; w], vec![0_u32; w + 1]);
        let mut rows = 0..0;
        for (y, out) in (band * BAND..).zip(out.chunks_exact_mut(w)) {
            let now = near(y, h);
            for y in rows.start..now.start.min(rows.end) {
                columns.iter_mut().zip(row(y)).for_each(|(sum, found)| *sum -= found);
            }
            for y in rows.end.max(now.start)..now.end {
                columns.iter_mut().zip(row(y)).for_each(|(sum, found)| *sum += found);
            }
            rows = now;
            let mut sum = 0;
            before[1..].iter_mut().zip(&columns).for_each(|(before, column)| {
                sum += column;
                *before = sum;
            });
            let is_most = |x: usize| {
                let near = near(x, w);
                2 * (before[near.end] - before[near.start]) as usize > near.len() * rows.len()
            };
            let (left, right) = (radius_px.min(w), w.saturating_sub(radius_px).max(radius_px.min(w)));
            (0..left).chain(right..w).for_each(|x| out[x] = is_most(x));
            // Away from the edges all windows are as wide, which makes many pixels at once.
            let most = ((2 * radius_px + 1) * rows.len()) as u32;
            let ends = before.get(2 * radius_px + 1..).unwrap_or_default();
            for ((out, start), end) in out[left..right].iter_mut().zip(&before).zip(ends) {
                *out = 2 * (end - start) > most;
            }
        }
    });
    rounded
}

/// Returns for each pixel of the mask the number of steps (right, left, up, down) to the nearest pixel that
/// is not in it, or out of the picture; 0 for all others.
pub(crate) fn depths(mask: &Mask) -> Grid<u32> {
    let (w, h) = (mask.width, mask.height);
    let mut depths = mask.map(|inside| if *inside { (w + h) as u32 } else { 0 });
    let mut step = |i: usize, neighbour: Option<usize>| {
        let there = neighbour.map_or(0, |n| depths.data[n]);
        depths.data[i] = depths.data[i].min(there + 1);
    };
    for i in (0..w * h).filter(|i| mask.data[*i]) {
        step(i, (i % w > 0).then(|| i - 1));
        step(i, i.checked_sub(w));
    }
    for i in (0..w * h).rev().filter(|i| mask.data[*i]) {
        step(i, (i % w + 1 < w).then_some(i + 1));
        step(i, (i + w < w * h).then_some(i + w));
    }
    depths
}

/// Returns column and row of the pixel of the mask that is farthest from its border, by city-block distance;
/// the first one of several. Beyond the image there is no mask. `None` for an empty mask.
pub fn innermost(mask: &Mask) -> Option<(usize, usize)> {
    let depths = depths(mask);
    let (i, depth) = depths.data.iter().enumerate().rev().max_by_key(|(_, depth)| **depth)?;
    (*depth > 0).then(|| (i % mask.width, i / mask.width))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn threshold_is_strict_and_nan_is_never_found() {
        let scores = Grid::from_vec(3, 1, vec![0.4, 0.400_1, f32::NAN]);
        assert_eq!(threshold(&scores, 0.4).data, [false, true, false]);
    }

    #[test]
    fn outline_follows_the_border_but_not_the_image_edge() {
        let image = Mask::drawn(&["#####", "#####", "###..", "###..", "###.."]);
        assert_eq!(outline(&image, 1), Mask::drawn(&[".....", "...##", "..#..", "..#..", "..#.."]));
        assert_eq!(outline(&image, 2), Mask::drawn(&["...##", "..###", ".##..", ".##..", ".##.."]));
        assert_eq!(outline(&image, 0).count(), 0);
        assert_eq!(outline(&Mask::drawn(&["###", "###"]), 2).count(), 0);
        assert_eq!(outline(&Grid::filled(0, 0, true), 2).data.len(), 0);
    }

    #[test]
    fn iou_of_known_masks() {
        let (a, b) = (Mask::drawn(&["##.", "..."]), Mask::drawn(&[".##", "..."]));
        assert_eq!(iou(&a, &b), Some(1.0 / 3.0));
        assert_eq!(iou(&a, &a), Some(1.0));
        let empty = Mask::drawn(&["...", "..."]);
        assert_eq!(iou(&a, &empty), Some(0.0));
        assert_eq!(iou(&empty, &empty), None);
        assert_eq!(iou(&a, &Mask::drawn(&["##"])), None);
    }

    #[test]
    fn bounding_box_is_tight() {
        let rect = bounding_box(&Mask::drawn(&["....", ".#..", "..#.", "...."]));
        assert_eq!(rect, Some(PixelRect { x: 1, y: 1, width: 2, height: 2 }));
        assert_eq!(bounding_box(&Mask::drawn(&["..", ".."])), None);
    }

    #[test]
    fn small_parts_go_and_holes_close() {
        let image = Mask::drawn(&["#....", "...##", ".##..", "....."]);
        assert_eq!(remove_small(&image, 2), Mask::drawn(&[".....", "...##", ".##..", "....."]));
        assert_eq!(remove_small(&image, 5).count(), 0);
        let ring = Mask::drawn(&["####.", "#..#.", "#.##.", "####."]);
        assert_eq!(fill_holes(&ring, 3).count(), 16);
        assert_eq!(fill_holes(&ring, 2), ring);
    }

    #[test]
    fn rounding_takes_away_what_is_thin_and_fills_notches() {
        let image = Mask::drawn(&["........", "....#...", "########", "###.####", "########", "........"]);
        assert_eq!(
            smoothed(&image, 1),
            Mask::drawn(&["........", "........", "########", "########", "########", "........"])
        );
        assert_eq!(smoothed(&image, 0), image);
        assert_eq!(smoothed(&Grid::filled(0, 0, true), 2).data.len(), 0);
    }

    #[test]
    fn depths_count_steps_to_the_outside() {
        let depths = depths(&Mask::drawn(&["#####", "#####", "##.##"]));
        assert_eq!(depths.data, [1, 1, 1, 1, 1, 1, 2, 1, 2, 1, 1, 1, 0, 1, 1]);
    }

    #[test]
    fn the_innermost_pixel_is_far_from_every_border() {
        let image = Mask::drawn(&["#########", "##.######", "#########", "#########", "#########"]);
        assert_eq!(innermost(&image), Some((4, 2)));
        let crescent = Mask::drawn(&["#####.", "#.....", "#.....", "######", "######", "######"]);
        assert_eq!(innermost(&crescent), Some((1, 4)), "a pixel of the mask, though the middle is none");
        assert_eq!(innermost(&Mask::drawn(&["...."])), None);
    }

    #[test]
    fn exclusive_masks_give_each_pixel_to_the_highest_score() {
        let a = Grid::from_vec(4, 1, vec![0.9, 0.5, 0.5, 0.1]);
        let b = Grid::from_vec(4, 1, vec![0.8, 0.6, 0.5, 0.2]);
        let masks = exclusive(&[&a, &b], &[0.4, 0.4]);
        assert_eq!(masks[0].data, [true, false, true, false]);
        assert_eq!(masks[1].data, [false, true, false, false]);
    }
}
