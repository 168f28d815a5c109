//! YOLO's segmentation labels: a line per part of what was found, with the number of its prompt and a
//! polygon.
//!
//! The corners are the centres of the border's pixels, as trainers fill polygons with their border. Holes are
//! joined to the border around them by a line. What touches itself or is thinner than its border changes by
//! some pixels: this format does not keep masks exactly.

use super::{Provenance, frame::FrameContent};
use crate::{
    grid::Mask,
    mask::{Corner, contours},
};
use std::fmt::Write;

/// Column and row of a pixel.
type Pixel = (usize, usize);

/// Returns the labels of a frame; prompts count from 0.
pub(super) fn labels(frame: &FrameContent<'_>) -> String {
    let (width, height) = frame.size();
    let mut text = String::new();
    for (prompt, mask) in frame.masks.iter().enumerate() {
        for polygon in polygons(mask) {
            let _ = write!(text, "{prompt}");
            for (x, y) in polygon {
                let share = |v: usize, size: usize| (v as f64 + 0.5) / size as f64;
                let _ = write!(text, " {:.6} {:.6}", share(x, width), share(y, height));
            }
            text.push('\n');
        }
    }
    text
}

/// Returns `data.yaml`, which names the prompts.
pub(super) fn names(provenance: &Provenance) -> String {
    let mut text = format!("# {}\npath: .\ntrain: images\nval: images\nnames:\n", provenance.intended_use);
    for (i, prompt) in provenance.prompts.iter().enumerate() {
        // Texts of JSON are texts of YAML.
        let _ = writeln!(text, "  {i}: {}", serde_json::Value::from(prompt.text.as_str()));
    }
    text
}

/// Returns a polygon of at least three pixels for each connected part of the mask.
fn polygons(mask: &Mask) -> Vec<Vec<Pixel>> {
    let lines = contours(mask);
    let (outer, holes): (Vec<_>, Vec<_>) = lines.iter().partition(|line| doubled_area(line) > 0);
    let mut polygons: Vec<Vec<Pixel>> = outer.iter().map(|line| border(line)).collect();
    for hole in holes {
        let hole = border(hole);
        let around = (0..outer.len()).filter(|k| holds(outer[*k], hole[0]));
        if let Some(k) = around.min_by_key(|k| doubled_area(outer[*k])) {
            polygons[k] = joined(&polygons[k], &hole);
        }
    }
    for polygon in &mut polygons {
        let last = polygon[polygon.len() - 1];
        polygon.resize(polygon.len().max(3), last);
    }
    polygons
}

/// Returns twice the area to the right of a line.
fn doubled_area(line: &[Corner]) -> i64 {
    let part = |(a, b): (&Corner, &Corner)| a.0 as i64 * b.1 as i64 - b.0 as i64 * a.1 as i64;
    line.iter().zip(line.iter().cycle().skip(1)).map(part).sum()
}

/// Returns the pixels to the right of a line, without those between two corners.
fn border(line: &[Corner]) -> Vec<Pixel> {
    let mut pixels: Vec<Pixel> = Vec::new();
    for (&(ax, ay), &(bx, by)) in line.iter().zip(line.iter().cycle().skip(1)) {
        let ends = if ay == by && bx > ax {
            [(ax, ay), (bx - 1, ay)]
        } else if ay == by {
            [(ax - 1, ay - 1), (bx, ay - 1)]
        } else if by > ay {
            [(ax - 1, ay), (ax - 1, by - 1)]
        } else {
            [(ax, ay - 1), (ax, by)]
        };
        pixels.extend(ends);
    }
    pixels.dedup();
    if pixels.len() > 1 && pixels.first() == pixels.last() {
        pixels.pop();
    }
    pixels
}

/// Returns `true` if a line goes around a pixel.
fn holds(line: &[Corner], (x, y): Pixel) -> bool {
    let crosses =
        |(a, b): &(&Corner, &Corner)| a.0 == b.0 && a.0 <= x && (a.1.min(b.1)..a.1.max(b.1)).contains(&y);
    line.iter().zip(line.iter().cycle().skip(1)).filter(crosses).count() % 2 == 1
}

/// Returns one line around a part and its hole, joined where they are closest.
fn joined(part: &[Pixel], hole: &[Pixel]) -> Vec<Pixel> {
    let distance = |a: Pixel, b: Pixel| a.0.abs_diff(b.0).pow(2) + a.1.abs_diff(b.1).pow(2);
    let pairs = (0..part.len()).flat_map(|i| (0..hole.len()).map(move |j| (i, j)));
    let (i, j) = pairs.min_by_key(|&(i, j)| distance(part[i], hole[j])).unwrap_or_default();
    [&part[..=i], &hole[j..], &hole[..=j], &part[i..]].concat()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mask::iou;

    /// Fills a polygon and its border.
    fn filled(polygon: &[Pixel], width: usize, height: usize) -> Mask {
        let points_px = polygon.iter().map(|(x, y)| [*x as f32 + 0.5, *y as f32 + 0.5]).collect();
        let mut mask = crate::annotations::Shape::Polygon { points_px }.pixels(width, height);
        for (a, b) in polygon.iter().zip(polygon.iter().cycle().skip(1)) {
            let steps = a.0.abs_diff(b.0).max(a.1.abs_diff(b.1)).max(1);
            for k in 0..=steps {
                let at = |a: usize, b: usize| (a * (steps - k) + b * k + steps / 2) / steps;
                mask.set(at(a.0, b.0), at(a.1, b.1), true);
            }
        }
        mask
    }

    #[test]
    fn polygons_go_through_the_pixels_of_the_border() {
        let square = Mask::drawn(&["....", ".##.", ".##.", "...."]);
        assert_eq!(polygons(&square), [[(1, 1), (2, 1), (2, 2), (1, 2)]]);
        assert_eq!(polygons(&Mask::drawn(&["...", ".#."])), [[(1, 1); 3]], "a pixel is a polygon, too");
        assert!(polygons(&Mask::drawn(&["..."])).is_empty());
    }

    #[test]
    fn parts_and_holes_are_nearly_kept() {
        let mask = Mask::from_vec(
            120,
            90,
            (0..120 * 90)
                .map(|i| {
                    let (x, y) = ((i % 120) as f32, (i / 120) as f32);
                    let within = |cx: f32, cy: f32, r: f32| (x - cx).hypot(y - cy) < r;
                    within(45.0, 45.0, 38.0) && !within(50.0, 40.0, 14.0) && !within(30.0, 60.0, 6.0)
                        || within(50.0, 40.0, 5.0)
                        || within(104.0, 20.0, 9.5)
                })
                .collect(),
        );
        let found = polygons(&mask);
        assert_eq!(found.len(), 3, "the disc, the island in its hole, and the other disc");
        let mut all = Mask::filled(120, 90, false);
        for polygon in &found {
            let one = filled(polygon, 120, 90);
            all.data.iter_mut().zip(&one.data).for_each(|(all, one)| *all |= *one);
        }
        let iou = iou(&mask, &all).unwrap();
        assert!(iou > 0.99, "IoU {iou}");
    }
}
