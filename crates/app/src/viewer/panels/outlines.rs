//! Lines around what was found, as wide on an enlarged picture as on the whole one.

use crate::viewer::{picture::request::Outlines, theme};
use egui::{Color32, Painter, Pos2, Rect, Shape, Stroke, pos2};
use surgtpgs_core::{overlay::HALO_DARKNESS, strokes::HALO};

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

fn shape(points: &[[f32; 2]], is_closed: bool, stroke: Stroke) -> Shape {
    let points: Vec<Pos2> = points.iter().map(|[x, y]| pos2(*x, *y)).collect();
    if is_closed { Shape::closed_line(points, stroke) } else { Shape::line(points, stroke) }
}
