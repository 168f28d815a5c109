//! Smooth lines along the borders of masks, for drawing at any size.

use super::{Corner, Mask, contours};

/// Number of rounds in which each point moves towards its neighbours: steps of pixels vanish, corners become
/// round over some three pixels.
const ROUNDS: usize = 12;

/// Fewest points of a part of a border that is drawn: what peeps out from under an instrument is no line.
const LEAST_PIECE: usize = 5;

/// A smooth line along a border, or along a part of one. Where it is closed, the last point joins the first.
#[derive(Clone, Debug, PartialEq)]
pub struct BorderLine {
    /// Points from the image's upper left corner, px. The mask lies to the right of the direction of travel.
    pub points_px: Vec<[f32; 2]>,
    /// Number of earlier masks with the same border at each point: the line runs inside of theirs.
    lanes: Vec<f32>,
    /// `true` for a line all around.
    pub is_closed: bool,
}

impl BorderLine {
    /// Returns the points where a line of `width` is drawn: inside of the mask, along its border, beside the
    /// lines of earlier masks with the same border. `place` maps the mask's pixels to the drawing.
    pub fn placed(&self, width: f32, place: impl Fn([f32; 2]) -> [f32; 2]) -> Vec<[f32; 2]> {
        let points: Vec<[f32; 2]> = self.points_px.iter().map(|p| place(*p)).collect();
        let last = points.len().saturating_sub(1);
        let beside = |i: usize, forwards: bool| match (forwards, self.is_closed) {
            (true, true) => (i + 1) % points.len(),
            (false, true) => (i + last) % points.len(),
            (true, false) => (i + 1).min(last),
            (false, false) => i.saturating_sub(1),
        };
        let inside = |i: usize| {
            let ([x0, y0], [x1, y1]) = (points[beside(i, false)], points[beside(i, true)]);
            let (dx, dy) = (x1 - x0, y1 - y0);
            let by = (0.5 + self.lanes[i]) * width / dx.hypot(dy).max(f32::MIN_POSITIVE);
            [points[i][0] - dy * by, points[i][1] + dx * by]
        };
        (0..points.len()).map(inside).collect()
    }
}

/// An edge between two pixels of a border, with the pixel of the mask beside it.
#[derive(Clone, Copy)]
struct Edge {
    middle: [f32; 2],
    pixel: (usize, usize),
    /// Index of the edge among all of the image, for both directions.
    index: usize,
    is_at_image_border: bool,
}

/// Draws one set of lines around each mask; the image's own border is none. All masks have one size. Nothing
/// is drawn where `hidden` covers a mask's border. Where several masks have the same border, their lines run
/// side by side.
pub fn border_lines(masks: &[Mask], hidden: impl Fn(usize, usize, usize) -> bool) -> Vec<Vec<BorderLine>> {
    let Some((width, height)) = masks.first().map(|m| (m.width, m.height)) else { return Vec::new() };
    let mut used = vec![0_u8; 4 * (width + 1) * (height + 1)];
    let mut all = Vec::new();
    for (k, mask) in masks.iter().enumerate() {
        let mut lines = Vec::new();
        let mut taken = Vec::new();
        for contour in contours(mask) {
            let edges = edges(&contour, (width, height));
            let is_drawn = |e: &Edge| !e.is_at_image_border && !hidden(k, e.pixel.0, e.pixel.1);
            let drawn: Vec<bool> = edges.iter().map(is_drawn).collect();
            let point = |e: &Edge| [e.middle[0], e.middle[1], f32::from(used[e.index])];
            let points: Vec<[f32; 3]> = edges.iter().map(point).collect();
            lines.extend(pieces(&points, &drawn).into_iter().map(|(points, closed)| smooth(points, closed)));
            taken.extend(edges.iter().zip(&drawn).filter(|(_, drawn)| **drawn).map(|(e, _)| e.index));
        }
        taken.into_iter().for_each(|index| used[index] = used[index].saturating_add(1));
        all.push(lines);
    }
    all
}

/// Divides a contour into edges of one pixel.
fn edges(contour: &[Corner], (width, height): (usize, usize)) -> Vec<Edge> {
    let mut edges = Vec::new();
    for (from, to) in contour.iter().zip(contour.iter().cycle().skip(1)) {
        let (dx, dy) = (signum(from.0, to.0), signum(from.1, to.1));
        let step = match (dx, dy) {
            (1, _) => 0,
            (_, 1) => 1,
            (-1, _) => 2,
            _ => 3,
        };
        let mut at = *from;
        while at != *to {
            let next = (at.0.wrapping_add_signed(dx), at.1.wrapping_add_signed(dy));
            let (left, top) = (at.0.min(next.0), at.1.min(next.1));
            // The mask lies to the right of the direction of travel.
            let pixel = match step {
                0 => (left, top),
                1 => (left.saturating_sub(1), top),
                2 => (left, top.saturating_sub(1)),
                _ => (left, top),
            };
            let is_at_image_border =
                if dx == 0 { at.0 == 0 || at.0 == width } else { at.1 == 0 || at.1 == height };
            edges.push(Edge {
                middle: [(at.0 + next.0) as f32 / 2.0, (at.1 + next.1) as f32 / 2.0],
                pixel,
                index: 4 * (at.1 * (width + 1) + at.0) + step,
                is_at_image_border,
            });
            at = next;
        }
    }
    edges
}

fn signum(from: usize, to: usize) -> isize {
    match to.cmp(&from) {
        std::cmp::Ordering::Less => -1,
        std::cmp::Ordering::Equal => 0,
        std::cmp::Ordering::Greater => 1,
    }
}

/// Splits a closed line into the pieces that are drawn; `true` for a whole line.
fn pieces(points: &[[f32; 3]], drawn: &[bool]) -> Vec<(Vec<[f32; 3]>, bool)> {
    let Some(gap) = drawn.iter().position(|drawn| !drawn) else { return vec![(points.to_vec(), true)] };
    let mut pieces: Vec<(Vec<[f32; 3]>, bool)> = Vec::new();
    let mut is_going_on = false;
    for i in (gap..points.len()).chain(0..gap) {
        match pieces.last_mut().filter(|_| is_going_on && drawn[i]) {
            Some((piece, _)) => piece.push(points[i]),
            None if drawn[i] => pieces.push((vec![points[i]], false)),
            None => {}
        }
        is_going_on = drawn[i];
    }
    pieces.retain(|(piece, _)| piece.len() >= LEAST_PIECE);
    pieces
}

/// Moves each point towards its neighbours. The ends of an open line stay, and a short line keeps its shape.
fn smooth(mut points: Vec<[f32; 3]>, is_closed: bool) -> BorderLine {
    let n = points.len();
    for _ in 0..ROUNDS.min(n / 4) {
        let before = points.clone();
        for i in 0..n {
            let is_end = !is_closed && (i == 0 || i + 1 == n);
            if !is_end {
                let (a, b) = (before[(i + n - 1) % n], before[(i + 1) % n]);
                points[i] = std::array::from_fn(|c| 0.25 * (a[c] + b[c]) + 0.5 * before[i][c]);
            }
        }
    }
    let lanes = points.iter().map(|p| p[2]).collect();
    BorderLine { points_px: points.into_iter().map(|[x, y, _]| [x, y]).collect(), lanes, is_closed }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::grid::Grid;

    fn mask(width: usize, height: usize, is_set: impl Fn(usize, usize) -> bool) -> Mask {
        Grid::from_vec(width, height, (0..width * height).map(|i| is_set(i % width, i / width)).collect())
    }

    fn disc(size: usize, radius: f32) -> Mask {
        let middle = size as f32 / 2.0;
        mask(size, size, |x, y| (x as f32 + 0.5 - middle).hypot(y as f32 + 0.5 - middle) < radius)
    }

    #[test]
    fn the_line_around_a_disc_has_no_steps() {
        let lines = border_lines(&[disc(60, 20.0)], |_, _, _| false);
        let [line] = &lines[0][..] else { panic!("{} lines", lines[0].len()) };
        assert!(line.is_closed);
        let radii = line.points_px.iter().map(|[x, y]| (x - 30.0).hypot(y - 30.0));
        let (least, most) = radii.fold((f32::MAX, 0.0_f32), |(a, b), r| (a.min(r), b.max(r)));
        assert!(most - least < 0.6 && (19.2..20.4).contains(&least), "{least} to {most}");
        let placed = line.placed(4.0, |[x, y]| [2.0 * x, 2.0 * y]);
        let mean = placed.iter().map(|[x, y]| (x - 60.0).hypot(y - 60.0)).sum::<f32>() / placed.len() as f32;
        assert!((mean - (2.0 * (least + most) / 2.0 - 2.0)).abs() < 0.3, "half a width inside: {mean}");
    }

    #[test]
    fn the_border_of_the_image_and_what_is_hidden_are_not_drawn() {
        let left = mask(20, 10, |x, _| x < 8);
        let lines = border_lines(std::slice::from_ref(&left), |_, _, _| false);
        assert_eq!(lines[0].len(), 1);
        assert!(!lines[0][0].is_closed && lines[0][0].points_px.iter().all(|[x, _]| *x == 8.0));
        let lines = border_lines(&[left], |_, _, y| y < 4);
        assert!(lines[0][0].points_px.iter().all(|[_, y]| *y > 4.0));
        assert!(border_lines(&[mask(4, 4, |_, _| true)], |_, _, _| false)[0].is_empty());
        assert!(border_lines(&[], |_, _, _| false).is_empty());
    }

    #[test]
    fn equal_borders_run_side_by_side() {
        let masks = [disc(60, 20.0), disc(60, 20.0), mask(60, 60, |x, _| x < 8)];
        let lines = border_lines(&masks, |_, _, _| false);
        let radius = |k: usize| {
            let placed = lines[k][0].placed(2.0, |p| p);
            placed.iter().map(|[x, y]| (x - 30.0).hypot(y - 30.0)).sum::<f32>() / placed.len() as f32
        };
        assert!((radius(0) - radius(1) - 2.0).abs() < 0.1, "{} and {}", radius(0), radius(1));
        assert!(lines[2][0].placed(2.0, |p| p).iter().all(|[x, _]| (*x - 7.0).abs() < 1e-4));
        // Regions that touch have their lines on either side of the border.
        let touching = [mask(20, 10, |x, _| x < 8), mask(20, 10, |x, _| x >= 8)];
        let lines = border_lines(&touching, |_, _, _| false);
        let x = |k: usize| lines[k][0].placed(2.0, |p| p)[0][0];
        assert_eq!((x(0), x(1)), (7.0, 9.0));
    }

    #[test]
    fn a_single_pixel_keeps_a_line_around_it() {
        let lines = border_lines(&[mask(5, 5, |x, y| (x, y) == (2, 2))], |_, _, _| false);
        assert_eq!((lines[0].len(), lines[0][0].points_px.len()), (1, 4));
        let width = lines[0][0].points_px.iter().map(|p| p[0]).fold(0.0, f32::max) - 2.5;
        assert!(width > 0.2, "{width}");
    }
}
