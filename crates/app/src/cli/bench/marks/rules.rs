//! Marks made from labels by rule, as a hand would make them.

use surgtpgs_core::{
    grid::Mask,
    marks::{Mark, Shape},
    mask::remove_small,
};

/// Smallest area of a class that is marked, px.
pub(super) const LEAST_PX: usize = 200;
/// Radius of clicks and strokes, px.
const RADIUS_PX: f32 = 3.0;
/// Columns of a picture for each pixel of the radius of a broad brush, and of an unsteady hand's way from the
/// line that it wants.
const BROAD_COLUMNS: f32 = 100.0;
const UNSTEADY_COLUMNS: f32 = 160.0;
/// Points of a stroke at most.
const STROKE_POINTS: usize = 12;

/// Rule by which a class is marked on a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Rule {
    /// All of its pixels.
    Mask,
    /// All of its pixels, with borders up to 5 px off.
    Sloppy,
    /// A stroke along its longest axis, through the deepest points.
    Stroke,
    /// The same, drawn with a broad brush and an unsteady hand: it leaves narrow structures.
    BroadStroke,
    /// Three clicks, each at the deepest point that is left.
    Clicks,
}

/// Returns the marks of a class on a frame; none of one that hardly shows.
pub(super) fn marks(rule: Rule, frame: usize, name: &str, class: &Mask) -> Vec<Mark> {
    if class.count() < LEAST_PX {
        return Vec::new();
    }
    let shapes = match rule {
        Rule::Mask => vec![Shape::from(class)],
        Rule::Sloppy => vec![Shape::from(&sloppy(class))],
        Rule::Stroke => vec![stroke(class)],
        Rule::BroadStroke => vec![broad(stroke(class), class.width as f32)],
        Rule::Clicks => clicks(class),
    };
    shapes.into_iter().map(|shape| Mark::new(frame, name, true, shape)).collect()
}

/// Distance of each pixel to the nearest one outside the mask, in steps of 1 and √2; 0 outside.
fn depths(mask: &Mask) -> Vec<f32> {
    let (width, height) = (mask.width as isize, mask.height as isize);
    let mut depths = vec![0.0_f32; mask.data.len()];
    let mut visit = |i: usize, steps: [(isize, isize); 4], first: bool| {
        let (x, y) = (i as isize % width, i as isize / width);
        let through = |(dx, dy): (isize, isize)| {
            let (u, v) = (x + dx, y + dy);
            let inside = u >= 0 && v >= 0 && u < width && v < height;
            let length = if dx != 0 && dy != 0 { std::f32::consts::SQRT_2 } else { 1.0 };
            length + if inside { depths[(v * width + u) as usize] } else { 0.0 }
        };
        let nearest = steps.into_iter().map(through).fold(f32::MAX, f32::min);
        depths[i] = if first { nearest } else { nearest.min(depths[i]) };
    };
    let inside: Vec<usize> = (0..mask.data.len()).filter(|i| mask.data[*i]).collect();
    inside.iter().for_each(|i| visit(*i, [(-1, 0), (0, -1), (-1, -1), (1, -1)], true));
    inside.iter().rev().for_each(|i| visit(*i, [(1, 0), (0, 1), (1, 1), (-1, 1)], false));
    depths
}

fn clicks(class: &Mask) -> Vec<Shape> {
    let mut left = class.clone();
    let mut shapes = Vec::new();
    for _ in 0..3 {
        let depths = depths(&left);
        let deepest = (0..depths.len()).max_by(|a, b| depths[*a].total_cmp(&depths[*b])).unwrap_or(0);
        let depth = depths[deepest];
        if depth <= 0.0 {
            break;
        }
        let (x, y) = ((deepest % left.width) as f32, (deepest / left.width) as f32);
        shapes.push(Shape::Click { point_px: [x + 0.5, y + 0.5], radius_px: RADIUS_PX });
        // The next one is to be elsewhere.
        let apart = Shape::Click { point_px: [x + 0.5, y + 0.5], radius_px: 0.8 * depth + RADIUS_PX };
        let near = apart.pixels(left.width, left.height);
        left.data.iter_mut().zip(&near.data).for_each(|(left, near)| *left &= !near);
    }
    shapes
}

/// Returns the largest connected part.
pub(super) fn largest_part(mask: &Mask) -> Mask {
    let (mut low, mut high) = (1, mask.count() + 1);
    // Largest area that some part has, by halving.
    while high - low > 1 {
        let middle = low.midpoint(high);
        if remove_small(mask, middle).count() > 0 { low = middle } else { high = middle }
    }
    remove_small(mask, low)
}

/// Returns a stroke through the largest part of a mask, along its longest axis.
pub(super) fn stroke(class: &Mask) -> Shape {
    let part = largest_part(class);
    let (width, depths) = (part.width, depths(&part));
    let inside: Vec<usize> = (0..part.data.len()).filter(|i| part.data[*i]).collect();
    let place = |i: usize| [(i % width) as f64, (i / width) as f64];
    let mean = [0, 1].map(|c| inside.iter().map(|i| place(*i)[c]).sum::<f64>() / inside.len() as f64);
    let moment = |a: usize, b: usize| -> f64 {
        inside.iter().map(|i| (place(*i)[a] - mean[a]) * (place(*i)[b] - mean[b])).sum()
    };
    let angle = 0.5 * (2.0 * moment(0, 1)).atan2(moment(0, 0) - moment(1, 1));
    let along = |i: usize| (place(i)[0] - mean[0]) * angle.cos() + (place(i)[1] - mean[1]) * angle.sin();
    let start = inside.iter().map(|i| along(*i)).fold(f64::MAX, f64::min);
    let end = inside.iter().map(|i| along(*i)).fold(f64::MIN, f64::max);
    let mut deepest: [Option<usize>; STROKE_POINTS] = [None; STROKE_POINTS];
    for &i in &inside {
        let slice = ((along(i) - start) / (end - start).max(1e-9) * STROKE_POINTS as f64) as usize;
        let best = &mut deepest[slice.min(STROKE_POINTS - 1)];
        if best.is_none_or(|best| depths[i] > depths[best]) {
            *best = Some(i);
        }
    }
    let most = inside.iter().map(|i| depths[*i]).fold(0.0, f32::max);
    let is_deep = |i: &usize| depths[*i] >= (0.25 * most).max(2.0_f32.min(most));
    let points = deepest.into_iter().flatten().filter(is_deep);
    let points_px = points.map(|i| [(i % width) as f32 + 0.5, (i / width) as f32 + 0.5]).collect();
    Shape::Stroke { points_px, radius_px: RADIUS_PX }
}

/// Draws a stroke with a broad brush and an unsteady hand.
fn broad(stroke: Shape, width: f32) -> Shape {
    let Shape::Stroke { points_px, .. } = stroke else { return stroke };
    let amplitude = width / UNSTEADY_COLUMNS;
    let unsteady = |(i, [x, y]): (usize, [f32; 2])| {
        let angle = 2.4 * i as f32;
        [x + amplitude * angle.cos(), y + amplitude * angle.sin()]
    };
    let points_px = points_px.into_iter().enumerate().map(unsteady).collect();
    Shape::Stroke { points_px, radius_px: width / BROAD_COLUMNS }
}

/// Moves the border in and out by up to 5 px, in waves.
fn sloppy(class: &Mask) -> Mask {
    let (inner, outer) = (depths(class), depths(&class.map(|v| !v)));
    let wave = |i: usize| {
        let (x, y) = ((i % class.width) as f32, (i / class.width) as f32);
        5.0 * (x / 11.0 + (y / 17.0).sin()).sin() * (y / 13.0 + (x / 19.0).cos()).cos()
    };
    let data = (0..class.data.len()).map(|i| inner[i] - outer[i] + wave(i) > 0.0).collect();
    Mask::from_vec(class.width, class.height, data)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn bar() -> Mask {
        let inside = |i: usize| (10..70).contains(&(i % 80)) && (8..20).contains(&(i / 80));
        Mask::from_vec(80, 30, (0..2400).map(inside).collect())
    }

    #[test]
    fn marks_lie_on_their_class() {
        for rule in [Rule::Stroke, Rule::Clicks] {
            for mark in marks(rule, 2, "liver", &bar()) {
                let pixels = mark.shape.pixels(80, 30);
                assert!(
                    pixels.data.iter().zip(&bar().data).all(|(marked, class)| !marked || *class),
                    "{rule:?}"
                );
            }
        }
        assert_eq!(marks(Rule::Clicks, 2, "liver", &bar()).len(), 3);
        assert!(marks(Rule::Mask, 2, "liver", &Mask::filled(80, 30, false)).is_empty());
        let rough = sloppy(&bar());
        let moved = rough.data.iter().zip(&bar().data).filter(|(a, b)| a != b).count();
        assert!(moved > 50 && moved < 600, "{moved}");
    }

    #[test]
    fn the_largest_part_is_found() {
        let mut two = bar();
        two.set(0, 0, true);
        assert_eq!(largest_part(&two), bar());
    }
}
