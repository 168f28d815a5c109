//! Hands large filled rectangles of a window over to our own shader: grounds of cards, bars and buttons.

use crate::viewer::picture::texture::filled;
use egui::{
    Color32, Context, CornerRadius, FullOutput, Plugin, Rect, Shape, StrokeKind,
    emath::{GuiRounding as _, TSTransform},
    epaint::RectShape,
};

/// Smallest area that is worth a call of its own, square points.
const MIN_AREA: f32 = 2000.0;
/// Smallest side, points: egui makes thinner rectangles into lines.
const MIN_SIDE: f32 = 4.0;

/// Length by which egui makes round corners rounder than was asked, points.
const ROUNDER: f32 = 0.4;

/// Replaces the fill of large rectangles, whoever paints them, just before a frame is drawn.
pub(crate) struct Fills;

impl Plugin for Fills {
    fn debug_name(&self) -> &'static str {
        "fills"
    }

    fn output_hook(&mut self, ctx: &Context, output: &mut FullOutput) {
        let rounds_to_pixels = ctx.tessellation_options(|options| options.round_rects_to_pixels);
        let screen =
            Screen { rect: ctx.viewport_rect(), rounds_to_pixels, pixels_per_point: output.pixels_per_point };
        let is_in_place = |t: TSTransform| t == TSTransform::IDENTITY;
        for shape in output.shapes.iter_mut().filter(|s| is_in_place(s.transform_after_tessellation)) {
            screen.replace(&mut shape.shape, shape.clip_rect);
        }
    }
}

struct Screen {
    rect: Rect,
    rounds_to_pixels: bool,
    pixels_per_point: f32,
}

impl Screen {
    fn replace(&self, shape: &mut Shape, clip: Rect) {
        match shape {
            Shape::Vec(shapes) => shapes.iter_mut().for_each(|shape| self.replace(shape, clip)),
            Shape::Rect(rect) => {
                if let Some(ground) = self.ground(rect, clip) {
                    rect.fill = Color32::TRANSPARENT;
                    *shape = Shape::Vec(vec![ground, shape.clone()]);
                }
            }
            _ => {}
        }
    }

    /// Returns the fill of a rectangle, if it is large and plain. It ends below the middle of the line around
    /// it.
    fn ground(&self, shape: &RectShape, clip: Rect) -> Option<Shape> {
        let RectShape { rect, corner_radius, fill, stroke, stroke_kind, .. } = *shape;
        let visible = rect.intersect(clip).intersect(self.rect);
        let is_plain = shape.brush.is_none() && shape.angle == 0.0 && shape.blur_width == 0.0;
        let is_even = corner_radius == CornerRadius::same(corner_radius.nw);
        let has_inner_line = stroke.is_empty() || stroke_kind == StrokeKind::Inside;
        let is_large = rect.is_finite()
            && visible.is_positive()
            && visible.area() >= MIN_AREA
            && rect.size().min_elem() >= MIN_SIDE + 2.0 * stroke.width;
        if fill == Color32::TRANSPARENT || !(is_plain && is_even && has_inner_line && is_large) {
            return None;
        }
        let rounds = shape.round_to_pixels.unwrap_or(self.rounds_to_pixels);
        let rect = if rounds { rect.round_to_pixels(self.pixels_per_point) } else { rect };
        let inset = if stroke.is_empty() { 0.0 } else { stroke.width / 2.0 };
        let radius = if corner_radius.nw == 0 { 0.0 } else { f32::from(corner_radius.nw) + ROUNDER };
        let radius = (radius - inset).max(0.0);
        Some(filled(rect.shrink(inset), radius, fill, clip.intersect(self.rect)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use egui::{RawInput, Stroke, pos2, vec2};

    /// Returns the number of fills that are handed over when this is painted in a window of 400 × 300 points.
    fn num_replaced(paint: impl Fn(&egui::Painter)) -> usize {
        let ctx = Context::default();
        ctx.add_plugin(Fills);
        let screen = Rect::from_min_size(pos2(0.0, 0.0), vec2(400.0, 300.0));
        let input = RawInput { screen_rect: Some(screen), ..Default::default() };
        let mut output = ctx.run_ui(input, |ui| paint(&ui.ctx().layer_painter(egui::LayerId::background())));
        output.textures_delta.clear();
        let is_ours = |shape: &egui::epaint::ClippedPrimitive| {
            matches!(shape.primitive, egui::epaint::Primitive::Callback(_))
        };
        ctx.tessellate(output.shapes, 1.0).iter().filter(|shape| is_ours(shape)).count()
    }

    #[test]
    fn only_what_is_large_and_plain_is_handed_over() {
        let at = |width, height| Rect::from_min_size(pos2(10.0, 10.0), vec2(width, height));
        let of = |rect: Rect| {
            num_replaced(|painter| {
                painter.rect_filled(rect, 4.0, Color32::RED);
            })
        };
        assert_eq!([of(at(100.0, 50.0)), of(at(30.0, 30.0)), of(at(380.0, 2.0))], [1, 0, 0]);
        assert_eq!([of(Rect::EVERYTHING), of(at(100.0, 50.0).translate(vec2(500.0, 0.0)))], [0, 0]);
        let nested = |painter: &egui::Painter| {
            let rect =
                |x: f32| Shape::rect_filled(at(100.0, 50.0).translate(vec2(x, 0.0)), 0.0, Color32::RED);
            painter.add(Shape::Vec(vec![rect(0.0), Shape::Vec(vec![rect(120.0)])]));
        };
        assert_eq!(num_replaced(nested), 2);
        let line = Stroke::new(1.0, Color32::BLUE);
        let lined = |kind| {
            num_replaced(move |painter| {
                painter.rect(at(100.0, 50.0), 4.0, Color32::RED, line, kind);
            })
        };
        assert_eq!([lined(StrokeKind::Inside), lined(StrokeKind::Outside)], [1, 0]);
        let uneven = CornerRadius { nw: 4, ..CornerRadius::ZERO };
        assert_eq!(
            num_replaced(|painter| {
                painter.rect_filled(at(100.0, 50.0), uneven, Color32::RED);
            }),
            0
        );
    }
}
