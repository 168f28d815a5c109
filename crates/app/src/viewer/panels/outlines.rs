//! Lines around what was found, as wide on an enlarged picture as on the whole one.

use crate::viewer::{picture::request::Outlines, theme};
use egui::{Color32, Painter, Pos2, Rect, Shape, Stroke, pos2};
use surgtpgs_core::strokes::{HALO, HALO_DARKNESS};

/// Width of a line, points.
const WIDTH: f32 = 2.5;

/// Paints the lines on a picture at `rect`. The halos lie below all lines.
pub(crate) fn paint_outlines(painter: &Painter, rect: Rect, outlines: &Outlines) {
    let scale = [rect.width() / outlines.size.0.max(1) as f32, rect.height() / outlines.size.1.max(1) as f32];
    let place = |[x, y]: [f32; 2]| [rect.left() + x * scale[0], rect.top() + y * scale[1]];
    let strokes: Vec<_> = outlines.lines.iter().map(|o| (o.colour, o.strokes(WIDTH, place))).collect();
    let halo = Color32::BLACK.gamma_multiply(HALO_DARKNESS * outlines.opacity);
    let halo = Stroke::new(WIDTH * (1.0 + 2.0 * HALO), halo);
    for (points, is_closed) in strokes.iter().flat_map(|(_, strokes)| strokes) {
        painter.add(shape(points, *is_closed, halo));
    }
    for (colour, strokes) in &strokes {
        let stroke = Stroke::new(WIDTH, theme::colour32(*colour).gamma_multiply(outlines.opacity));
        for (points, is_closed) in strokes {
            painter.add(shape(points, *is_closed, stroke));
        }
    }
}

/// Makes a line of points. The ends of a closed one meet where it is straightest: egui cuts off the sharp
/// corners of open lines alone, and others grow spikes.
fn shape(points: &[[f32; 2]], is_closed: bool, stroke: Stroke) -> Shape {
    let mut points: Vec<Pos2> = points.iter().map(|[x, y]| pos2(*x, *y)).collect();
    if is_closed && points.len() > 2 {
        let start = straightest(&points);
        points.rotate_left(start);
        points.push(points[0]);
    }
    Shape::line(points, stroke)
}

/// Returns the point of a closed line where it turns least.
fn straightest(points: &[Pos2]) -> usize {
    let n = points.len();
    let cosine = |i: usize| {
        let [before, after] = [points[i] - points[(i + n - 1) % n], points[(i + 1) % n] - points[i]];
        before.normalized().dot(after.normalized())
    };
    (0..n).max_by(|a, b| cosine(*a).total_cmp(&cosine(*b))).unwrap_or(0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_closed_line_ends_where_it_is_straightest() {
        // A sliver: two sharp tips, and a bend of a few degrees on one side.
        let sliver = [[0.0, 0.0], [50.0, 2.0], [100.0, 0.0], [50.0, -9.0]];
        let Shape::Path(path) = shape(&sliver, true, Stroke::new(2.0, Color32::WHITE)) else { panic!() };
        assert!(!path.closed && path.points.len() == 5);
        assert_eq!([path.points[0], path.points[4]], [pos2(50.0, 2.0); 2]);
        let Shape::Path(open) = shape(&sliver, false, Stroke::new(2.0, Color32::WHITE)) else { panic!() };
        assert_eq!((open.points.len(), open.points[0]), (4, pos2(0.0, 0.0)));
    }
}
