//! Curves of the area of every visible prompt over time, under the time bar. A click goes to the frame.

use crate::viewer::{picture::areas::Curve, shared::Shared, state::content::Prompt, text::percent, theme};
use egui::{Align2, Color32, FontId, Painter, Pos2, Rect, Shape, Stroke, Ui, pos2};

/// Height of the curves.
pub(crate) const HEIGHT: f32 = 46.0;

/// Paints the curves; `x` maps a frame to its position. All curves share one scale, from nothing to the
/// largest area.
pub(crate) fn paint(
    ui: &Ui,
    shared: &Shared,
    curves: &[(usize, Prompt, Curve)],
    rect: Rect,
    x: &dyn Fn(usize) -> f32,
) {
    let painter = &ui.painter().with_clip_rect(rect.intersect(ui.clip_rect()));
    painter.rect_filled(rect, 4.0, theme::BACKDROP);
    if curves.is_empty() {
        return;
    }
    let top = curves.iter().map(|(.., c)| c.top()).fold(0.0, f32::max);
    let inner = rect.shrink2(egui::vec2(0.0, 4.0));
    let mut numbers = Vec::new();
    let y = |share: f32| inner.bottom() - inner.height() * share / top.max(f32::MIN_POSITIVE);
    for (number, prompt, curve) in curves {
        let is_selected = shared.document.selected == Some(prompt.id);
        let colour = theme::colour32(prompt.colour);
        for part in known_parts(curve, x, &y) {
            if is_selected {
                fill(painter, &part, inner.bottom(), colour.gamma_multiply(0.22));
            }
            painter.add(Shape::line(part, Stroke::new(if is_selected { 2.0 } else { 1.3 }, colour)));
        }
        if let Some(frame) = curve.largest().filter(|frame| rect.x_range().contains(x(*frame))) {
            numbers.push(number_at(painter, pos2(x(frame), y(curve.top())), rect, *number, prompt.colour));
        }
    }
    let is_counted = curves.iter().all(|(.., c)| c.has_no_answer() || c.is_complete());
    let text = match is_counted {
        _ if top > 0.0 => format!("{} of the picture", percent(top)),
        true if curves.iter().all(|(.., c)| c.has_no_answer()) => "no answer".into(),
        true => "nothing found".into(),
        false => "counting…".into(),
    };
    let galley = painter.layout_no_wrap(text, FontId::proportional(12.0), theme::TEXT_WEAK);
    let plate = Align2::RIGHT_TOP.anchor_size(rect.right_top() + egui::vec2(-5.0, 2.0), galley.size());
    let plate = beside(plate, &numbers, rect.left() + 5.0);
    painter.rect_filled(plate.expand(2.0), 3.0, theme::PLATE);
    painter.galley(plate.min, galley, theme::TEXT_WEAK);
}

/// Moves a plate to the left of the numbers in its way, as far as there is room.
fn beside(plate: Rect, numbers: &[Rect], left: f32) -> Rect {
    const APART: f32 = 4.0;
    let mut place = plate;
    while let Some(number) = numbers.iter().find(|number| number.intersects(place.expand(APART))) {
        place = place.translate(egui::vec2(number.left() - APART - 1.0 - place.right(), 0.0));
    }
    if place.left() < left { plate } else { place }
}

/// Splits a curve into lines over known frames that follow each other, or are near enough while it is
/// counted; a single frame becomes a short line.
fn known_parts(curve: &Curve, x: &dyn Fn(usize) -> f32, y: &impl Fn(f32) -> f32) -> Vec<Vec<Pos2>> {
    let mut parts: Vec<Vec<Pos2>> = Vec::new();
    let (reach, mut last) = (curve.reach(), None);
    for (frame, point) in curve.points.iter().enumerate().filter_map(|(i, p)| Some((i, p.as_ref()?))) {
        let at = pos2(x(frame), y(point.share()));
        match parts.last_mut() {
            Some(part) if last.is_some_and(|last| frame - last <= reach) => part.push(at),
            _ => parts.push(vec![at]),
        }
        last = Some(frame);
    }
    parts.iter_mut().filter(|p| p.len() == 1).for_each(|p| p.push(p[0] + egui::vec2(1.0, 0.0)));
    parts
}

fn fill(painter: &Painter, line: &[Pos2], bottom: f32, colour: Color32) {
    for pair in line.windows(2) {
        let corners = vec![pair[0], pair[1], pos2(pair[1].x, bottom), pos2(pair[0].x, bottom)];
        painter.add(Shape::convex_polygon(corners, colour, Stroke::NONE));
    }
}

/// Paints the prompt's number at its largest area, so that colour is not the only difference between curves.
/// Returns its place.
fn number_at(painter: &Painter, at: Pos2, within: Rect, number: usize, colour: [u8; 3]) -> Rect {
    let size = egui::vec2(15.0, 15.0);
    let room = within.shrink2(size / 2.0);
    let centre = at.clamp(room.min, room.max);
    let place = Rect::from_center_size(centre, size);
    crate::viewer::panels::widgets::swatch(painter, place, colour, &number.to_string());
    place
}

/// Describes the curves in words.
pub(crate) fn describe(curves: &[(usize, Prompt, Curve)]) -> String {
    let one = |(_, prompt, curve): &(usize, Prompt, Curve)| match (curve.largest(), curve.is_complete()) {
        _ if curve.has_no_answer() => format!("{}: cannot be looked for", prompt.text),
        (_, false) => format!("{}: still being counted", prompt.text),
        (None, true) => format!("{}: found on no frame", prompt.text),
        (Some(frame), true) => {
            format!(
                "{}: largest on frame {}, {} of the picture",
                prompt.text,
                frame + 1,
                percent(curve.top())
            )
        }
    };
    format!("Area over time. {}", curves.iter().map(one).collect::<Vec<_>>().join("; "))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_plate_gives_way_to_numbers_as_far_as_there_is_room() {
        let rect = |left: f32, right: f32| Rect::from_x_y_ranges(left..=right, 0.0..=12.0);
        let plate = rect(300.0, 400.0);
        let numbers = [rect(280.0, 295.0), rect(390.0, 405.0), rect(20.0, 35.0)];
        assert_eq!(beside(plate, &numbers[2..], 0.0), plate);
        let place = beside(plate, &numbers, 0.0);
        assert!(place.right() < 280.0 && place.width() == 100.0, "{place:?}");
        assert!(!numbers.iter().any(|number| number.intersects(place)));
        assert_eq!(beside(plate, &numbers, 250.0), plate, "there is no room");
    }
}
