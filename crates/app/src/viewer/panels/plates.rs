//! Places for texts over the picture, so that none covers another.

use crate::viewer::theme;
use egui::{Align, Align2, Color32, FontId, Painter, Rect, Vec2, vec2};

/// Gap between two texts, and between a text and the border of the picture.
const GAP: f32 = 6.0;
/// Space around the text on its plate.
const MARGIN: Vec2 = vec2(8.0, 4.5);

/// The places that are taken.
#[derive(Clone, Debug, Default)]
pub(crate) struct Plates {
    taken: Vec<Rect>,
}

impl Plates {
    /// Takes a place for good, for something that is painted elsewhere.
    pub(crate) fn take(&mut self, rect: Rect) {
        self.taken.push(rect);
    }

    /// Returns `true` if nothing is at a place yet.
    pub(crate) fn is_free(&self, rect: Rect) -> bool {
        !self.taken.iter().any(|other| other.shrink(0.5).intersects(rect))
    }

    /// Finds a free place of a size at a corner or a side of `within`: the nearest one on the way to the
    /// other side. Returns `None` if there is no room.
    pub(crate) fn place(&mut self, within: Rect, anchor: Align2, size: Vec2) -> Option<Rect> {
        let room = within.shrink(GAP);
        let mut rect = anchor.align_size_within_rect(size, room);
        let down = if anchor.y() == Align::Max { -1.0 } else { 1.0 };
        while let Some(other) = self.taken.iter().find(|other| other.shrink(0.5).intersects(rect)) {
            let by = if down > 0.0 { other.bottom() - rect.top() } else { rect.bottom() - other.top() };
            rect = rect.translate(vec2(0.0, down * (by.max(0.0) + GAP)));
        }
        room.expand(0.5).contains_rect(rect).then(|| {
            self.taken.push(rect);
            rect
        })
    }

    /// Paints a text on a dark plate, readable on any picture; returns the plate. Long texts are wrapped.
    pub(crate) fn text(
        &mut self,
        painter: &Painter,
        within: Rect,
        anchor: Align2,
        text: &str,
        colour: Color32,
    ) -> Option<Rect> {
        let width = within.width() - 2.0 * (GAP + MARGIN.x);
        let galley = painter.layout(text.to_owned(), FontId::proportional(14.5), colour, width.max(0.0));
        let rect = self.place(within, anchor, galley.size() + 2.0 * MARGIN)?;
        painter.rect_filled(rect, 5.0, theme::PLATE);
        painter.galley(rect.min + MARGIN, galley, colour);
        Some(rect)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use egui::{Pos2, pos2};

    #[test]
    fn what_comes_later_makes_way_and_what_has_no_room_is_left_out() {
        let within = Rect::from_min_max(Pos2::ZERO, pos2(200.0, 100.0));
        let mut plates = Plates::default();
        let size = vec2(120.0, 20.0);
        let mut put = |anchor| plates.place(within, anchor, size);
        let first = put(Align2::LEFT_TOP).unwrap();
        let beside = put(Align2::RIGHT_TOP).unwrap();
        let last = put(Align2::LEFT_BOTTOM).unwrap();
        assert_eq!((first.top(), beside.top(), last.bottom()), (GAP, 2.0 * GAP + 20.0, 100.0 - GAP));
        assert!(put(Align2::CENTER_TOP).is_none(), "a fourth does not fit between them");
        assert!(Plates::default().place(within, Align2::LEFT_TOP, vec2(300.0, 20.0)).is_none());
    }
}
