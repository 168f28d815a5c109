//! The part of the recording that the time bar shows, from left to right.

use egui::Rect;

/// Fewest frames that the bar shows.
const FEWEST: f32 = 4.0;

/// First and last place on the bar, frames; `None` is the whole recording.
pub(crate) type Span = Option<(f32, f32)>;

/// Frames on a line from left to right.
#[derive(Clone, Copy, Debug)]
pub(crate) struct TimeScale {
    pub(crate) line: Rect,
    /// Index of the recording's last frame.
    last: usize,
    first_shown: f32,
    last_shown: f32,
}

impl TimeScale {
    pub(crate) fn new(line: Rect, last: usize, span: Span) -> Self {
        let (first_shown, last_shown) = span.unwrap_or((0.0, last.max(1) as f32));
        Self { line, last, first_shown, last_shown }
    }

    /// Returns the position of a frame, which may be beside the line.
    pub(crate) fn x(&self, frame: usize) -> f32 {
        let share = (frame as f32 - self.first_shown) / (self.last_shown - self.first_shown).max(1e-3);
        self.line.left() + self.line.width() * share
    }

    /// Returns the frame at a position.
    pub(crate) fn frame(&self, x: f32) -> usize {
        (self.place(x).round().max(0.0) as usize).min(self.last)
    }

    /// Returns the first and last frame that are shown, as far as they are whole.
    pub(crate) fn shown(&self) -> (usize, usize) {
        let first = self.first_shown.ceil().max(0.0) as usize;
        (first.min(self.last), (self.last_shown.floor().max(0.0) as usize).min(self.last))
    }

    /// Shows fewer frames (`by` above 1) or more; the place at `x` stays where it is.
    pub(crate) fn magnified(&self, by: f32, x: f32) -> Span {
        let place = self.place(x);
        let ends = [self.first_shown, self.last_shown].map(|end| place + (end - place) / by);
        self.within(ends[0], ends[1])
    }

    /// Moves what is shown by a distance on the line.
    pub(crate) fn moved(&self, by: f32) -> Span {
        let frames = by / self.line.width().max(1.0) * (self.last_shown - self.first_shown);
        self.within(self.first_shown + frames, self.last_shown + frames)
    }

    /// Moves what is shown so that a frame is seen.
    pub(crate) fn following(&self, frame: usize) -> Span {
        let (frame, width) = (frame as f32, self.last_shown - self.first_shown);
        let first = if (self.first_shown..=self.last_shown).contains(&frame) {
            self.first_shown
        } else {
            frame - 0.1 * width
        };
        self.within(first, first + width)
    }

    fn place(&self, x: f32) -> f32 {
        let share = ((x - self.line.left()) / self.line.width().max(1.0)).clamp(0.0, 1.0);
        self.first_shown + share * (self.last_shown - self.first_shown)
    }

    /// Limits a part to the recording; the whole is `None`.
    fn within(&self, first: f32, last: f32) -> Span {
        let end = self.last.max(1) as f32;
        let width = (last - first).clamp(FEWEST.min(end), end);
        let first = first.clamp(0.0, end - width);
        (width < 0.999 * end).then_some((first, first + width))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use egui::{pos2, vec2};

    fn scale(span: Span) -> TimeScale {
        TimeScale::new(Rect::from_min_size(pos2(10.0, 0.0), vec2(100.0, 8.0)), 100, span)
    }

    #[test]
    fn frames_and_positions_agree() {
        let whole = scale(None);
        assert_eq!((whole.x(0), whole.x(50), whole.x(100)), (10.0, 60.0, 110.0));
        assert_eq!([0.0, 60.4, 999.0].map(|x| whole.frame(x)), [0, 50, 100]);
        let part = scale(Some((20.0, 40.0)));
        assert_eq!((part.x(30), part.frame(60.0), part.shown()), (60.0, 30, (20, 40)));
        assert_eq!(TimeScale::new(whole.line, 0, None).frame(50.0), 0);
    }

    #[test]
    fn the_place_under_the_pointer_stays_and_the_ends_hold() {
        let closer = scale(None).magnified(2.0, 60.0);
        assert_eq!(closer, Some((25.0, 75.0)));
        assert_eq!(scale(closer).magnified(0.5, 60.0), None);
        assert_eq!(scale(None).magnified(2.0, 10.0), Some((0.0, 50.0)));
        let closest = scale(None).magnified(1e6, 110.0).unwrap();
        assert_eq!(closest, (96.0, 100.0));
        assert_eq!(scale(Some((0.0, 50.0))).moved(-40.0), Some((0.0, 50.0)));
        assert_eq!(scale(Some((0.0, 50.0))).moved(20.0), Some((10.0, 60.0)));
        assert_eq!(scale(None).moved(20.0), None);
    }

    #[test]
    fn what_plays_stays_in_sight() {
        assert_eq!(scale(Some((0.0, 50.0))).following(30), Some((0.0, 50.0)));
        assert_eq!(scale(Some((0.0, 50.0))).following(60), Some((50.0, 100.0)));
        assert_eq!(scale(Some((50.0, 100.0))).following(10), Some((5.0, 55.0)));
        assert_eq!(scale(None).following(10), None);
    }
}
