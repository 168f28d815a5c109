//! Smooth lines along the borders of masks, for drawing at any size.

use super::{Corner, Mask, contours};
use rayon::prelude::*;

/// Number of rounds in which each point moves towards its neighbours: steps of pixels vanish, corners become
/// round over some three pixels.
const ROUNDS: usize = 12;

/// Fewest points of a part of a border that is drawn: what peeps out from under an instrument is no line.
const LEAST_PIECE: usize = 5;

/// Fewest corners of a closed line as it is drawn, about.
const LEAST_CORNERS: f32 = 8.0;

/// Steps in which a smoothed line may be outside of its mask, px.
const SMOOTHED: usize = 2;
/// Largest way across a mask that is looked for, px.
const WIDEST: usize = 64;

/// A smooth line along a border, or along a part of one. Where it is closed, the last point joins the first.
#[derive(Clone, Debug, PartialEq)]
pub struct BorderLine {
    /// Points from the image's upper left corner, px. The mask lies to the right of the direction of travel.
    pub points_px: Vec<[f32; 2]>,
    /// Number of earlier masks with the same border at each point: the line runs inside of theirs.
    lanes: Vec<f32>,
    /// Way from each point to the middle of the mask, px: no lane runs beyond it.
    rooms_px: Vec<f32>,
    /// `true` for a line all around.
    pub is_closed: bool,
}

/// A point of a line as it is drawn, with its lane and its room.
type Placed = ([f32; 2], f32, f32);

impl BorderLine {
    /// Returns the points where a line of `width` is drawn: inside of the mask, along its border, beside the
    /// lines of earlier masks with the same border. `place` maps the mask's pixels to the drawing. Details
    /// that are smaller than the line is wide are left out, because wide lines have spikes there.
    pub fn placed(&self, width: f32, place: impl Fn([f32; 2]) -> [f32; 2]) -> Vec<[f32; 2]> {
        let points = (0..self.points_px.len()).map(|i| {
            let ([x, y], room) = (self.points_px[i], self.rooms_px[i]);
            let point = place([x, y]);
            (point, self.lanes[i], distance(point, place([x + room, y])))
        });
        // The further inside a line runs, the sharper it turns.
        let mean_lane = self.lanes.iter().sum::<f32>() / self.lanes.len().max(1) as f32;
        let step = 0.5 * width * (1.0 + mean_lane);
        let points = self.thinned(&points.collect::<Vec<Placed>>(), step);
        let moved = |i: usize| {
            let ([x, y], lane, room) = points[i];
            let [nx, ny] = inwards(i, self.is_closed, points.len(), |i| points[i].0);
            let by = ((0.5 + lane) * width).min(room.max(0.5 * width));
            [x + by * nx, y + by * ny]
        };
        let moved: Vec<[f32; 2]> = (0..points.len()).map(moved).collect();
        // A line inside of a tight turn would run backwards.
        let is_backwards = |i: usize, j: usize| {
            let along = |c: usize| (points[j].0[c] - points[i].0[c]) * (moved[j][c] - moved[i][c]);
            along(0) + along(1) < 0.0
        };
        let runs_on = |i: usize| {
            let [before, after] = beside(i, self.is_closed, points.len());
            !is_backwards(before, i) && !is_backwards(i, after)
        };
        let kept: Vec<[f32; 2]> = (0..moved.len()).filter(|i| runs_on(*i)).map(|i| moved[i]).collect();
        // Around what is smaller than the line is wide there is no room inside.
        let is_too_small = kept.len() < if self.is_closed { 3 } else { 2 };
        if is_too_small { points.into_iter().map(|(point, ..)| point).collect() } else { kept }
    }

    /// Replaces points that are closer together than `step` by their means. The ends of an open line stay, and
    /// a closed line keeps [`LEAST_CORNERS`].
    fn thinned(&self, points: &[Placed], step: f32) -> Vec<Placed> {
        let way = |pair: &[Placed]| distance(pair[0].0, pair[1].0);
        let around = || points.windows(2).map(way).sum::<f32>();
        let step = if self.is_closed { step.min(around() / LEAST_CORNERS) } else { step };
        let mut ways = points.windows(2).map(way);
        let mut gone = 0.0;
        let parts = points.chunk_by(|_, _| {
            gone += ways.next().unwrap_or_default();
            let goes_on = gone < step;
            gone = if goes_on { gone } else { 0.0 };
            goes_on
        });
        let mean = |part: &[Placed]| {
            let of = |value: fn(&Placed) -> f32| part.iter().map(value).sum::<f32>() / part.len() as f32;
            ([of(|p| p.0[0]), of(|p| p.0[1])], of(|p| p.1), of(|p| p.2))
        };
        let mut means: Vec<Placed> = parts.map(mean).collect();
        if let (false, [first, .., last]) = (self.is_closed, points) {
            means[0] = *first;
            let end = means.len().max(2) - 1;
            means.splice(end.., [*last]);
        }
        means
    }
}

/// Returns the points before and after one of `n`; the ends of an open line are their own neighbours.
fn beside(i: usize, is_closed: bool, n: usize) -> [usize; 2] {
    if is_closed { [(i + n - 1) % n, (i + 1) % n] } else { [i.saturating_sub(1), (i + 1).min(n - 1)] }
}

/// Returns the direction from a point of a line into the mask, of length 1.
fn inwards(i: usize, is_closed: bool, n: usize, point: impl Fn(usize) -> [f32; 2]) -> [f32; 2] {
    let [[x0, y0], [x1, y1]] = beside(i, is_closed, n).map(point);
    let length = (x1 - x0).hypot(y1 - y0).max(f32::MIN_POSITIVE);
    [(y0 - y1) / length, (x1 - x0) / length]
}

fn distance([x0, y0]: [f32; 2], [x1, y1]: [f32; 2]) -> f32 {
    (x1 - x0).hypot(y1 - y0)
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

/// A part of a border, points with their lanes; `true` for a whole line.
type Piece = (Vec<[f32; 3]>, bool);

/// Draws one set of lines around each mask; the image's own border is none. All masks have one size. Nothing
/// is drawn where `hidden` covers a mask's border. Where several masks have the same border, their lines run
/// side by side.
pub fn border_lines(
    masks: &[Mask],
    hidden: impl Fn(usize, usize, usize) -> bool + Sync,
) -> Vec<Vec<BorderLine>> {
    let Some((width, height)) = masks.first().map(|m| (m.width, m.height)) else { return Vec::new() };
    let edges_of = |(k, mask): (usize, &Mask)| {
        let edges = contours(mask).into_iter().map(|contour| edges(&contour, (width, height)));
        let is_drawn = |e: &Edge| !e.is_at_image_border && !hidden(k, e.pixel.0, e.pixel.1);
        let with_drawn = |edges: Vec<Edge>| {
            let drawn: Vec<bool> = edges.iter().map(is_drawn).collect();
            (edges, drawn)
        };
        edges.map(with_drawn).collect::<Vec<_>>()
    };
    let contours: Vec<Vec<(Vec<Edge>, Vec<bool>)>> = masks.par_iter().enumerate().map(edges_of).collect();
    // Masks that had each edge before.
    let mut used = vec![0_u8; 4 * (width + 1) * (height + 1)];
    let mut all: Vec<Vec<Piece>> = Vec::new();
    for contours in &contours {
        let point = |e: &Edge| [e.middle[0], e.middle[1], f32::from(used[e.index])];
        let pieces = contours.iter().flat_map(|(edges, drawn)| {
            let points: Vec<[f32; 3]> = edges.iter().map(point).collect();
            pieces(&points, drawn)
        });
        all.push(pieces.collect());
        for (edge, _) in
            contours.iter().flat_map(|(edges, drawn)| edges.iter().zip(drawn)).filter(|(_, d)| **d)
        {
            used[edge.index] = used[edge.index].saturating_add(1);
        }
    }
    let smooth = |(pieces, mask): (Vec<Piece>, &Mask)| {
        pieces.into_par_iter().map(|(points, is_closed)| smooth(points, is_closed, mask)).collect()
    };
    all.into_par_iter().zip(masks).map(smooth).collect()
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
fn pieces(points: &[[f32; 3]], drawn: &[bool]) -> Vec<Piece> {
    let Some(gap) = drawn.iter().position(|drawn| !drawn) else { return vec![(points.to_vec(), true)] };
    let mut pieces: Vec<Piece> = Vec::new();
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
fn smooth(mut points: Vec<[f32; 3]>, is_closed: bool, mask: &Mask) -> BorderLine {
    let n = points.len();
    for _ in 0..ROUNDS.min(n / 4) {
        let before = points.clone();
        for i in 0..n {
            let is_end = !is_closed && (i == 0 || i + 1 == n);
            if !is_end {
                let [a, b] = beside(i, is_closed, n).map(|j| before[j]);
                points[i] = std::array::from_fn(|c| 0.25 * (a[c] + b[c]) + 0.5 * before[i][c]);
            }
        }
    }
    let lanes = points.iter().map(|p| p[2]).collect();
    let points_px: Vec<[f32; 2]> = points.into_iter().map(|[x, y, _]| [x, y]).collect();
    let room = |i: usize| room(mask, points_px[i], inwards(i, is_closed, n, |i| points_px[i]));
    let rooms_px = (0..n).map(room).collect();
    BorderLine { points_px, lanes, rooms_px, is_closed }
}

/// Returns half the way from a point of the border to the other side of the mask, px.
fn room(mask: &Mask, [x, y]: [f32; 2], [nx, ny]: [f32; 2]) -> f32 {
    let is_inside = |step: usize| {
        let at = |p: f32, n: f32| p + (step as f32 - 0.5) * n;
        let (x, y) = (at(x, nx), at(y, ny));
        let is_in_image = x >= 0.0 && y >= 0.0 && x < mask.width as f32 && y < mask.height as f32;
        is_in_image && mask.at(x as usize, y as usize)
    };
    0.5 * (1..=WIDEST).take_while(|step| *step <= SMOOTHED || is_inside(*step)).count() as f32
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
    fn wide_lines_side_by_side_around_a_ragged_mask_have_no_spikes() {
        // Drawn at half its size, as in a small window, the teeth are narrower than the lines.
        let comb = || mask(120, 50, |x, y| (5..115).contains(&x) && (18..26 + 3 * (x / 3 % 4)).contains(&y));
        let lines = border_lines(&[comb(), comb(), comb()], |_, _, _| false);
        let length = |points: &[[f32; 2]]| -> f32 {
            let next = points.iter().cycle().skip(1);
            points.iter().zip(next).map(|(a, b)| (b[0] - a[0]).hypot(b[1] - a[1])).sum()
        };
        for (width, scale) in [(5.0, 0.5), (2.5, 0.5), (2.5, 1.0), (2.5, 4.0)] {
            for line in lines.concat() {
                let border: Vec<[f32; 2]> = line.points_px.iter().map(|p| p.map(|v| scale * v)).collect();
                let placed = line.placed(width, |p| p.map(|v| scale * v));
                let [drawn, border] = [&placed, &border].map(|points| length(points));
                assert!(drawn < 1.2 * border, "{drawn} along {border}: width {width}, scale {scale}");
            }
        }
    }

    #[test]
    fn a_single_pixel_keeps_a_line_around_it() {
        let lines = border_lines(&[mask(5, 5, |x, y| (x, y) == (2, 2))], |_, _, _| false);
        assert_eq!((lines[0].len(), lines[0][0].points_px.len()), (1, 4));
        let width = lines[0][0].points_px.iter().map(|p| p[0]).fold(0.0, f32::max) - 2.5;
        assert!(width > 0.2, "{width}");
    }
}
