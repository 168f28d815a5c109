//! Frames that are left out of everything: not shown, not exported, not trained on. Pictures from outside the
//! body may reveal the identity of the patient.

use crate::viewer::{
    backend::ranges::{cut, joined},
    state::document::Document,
};

/// Message in place of an excluded frame.
pub(crate) const EXCLUDED: &str = "This frame is left out of everything";

impl Document {
    pub(crate) fn excluded(&self) -> &[(usize, usize)] {
        &self.content().excluded
    }

    pub(crate) fn is_excluded(&self, frame: usize) -> bool {
        self.excluded().iter().any(|(from, to)| (*from..=*to).contains(&frame))
    }

    /// Excludes the frames from `from` to `to`; if all of them are excluded already, includes them again.
    pub(crate) fn toggle_excluded(&mut self, from: usize, to: usize) {
        let is_out = (from..=to).all(|frame| self.is_excluded(frame));
        let frames = if from == to {
            format!("frame {}", from + 1)
        } else {
            format!("frames {} to {}", from + 1, to + 1)
        };
        let name = if is_out { format!("taking {frames} back in") } else { format!("leaving out {frames}") };
        let rest = cut(self.excluded(), (from, to));
        self.edit(name, None, |content| {
            content.excluded = if is_out { rest } else { joined(rest, (from, to)) }
        });
    }

    /// Excludes ranges of frames, as one edit of this name.
    pub(crate) fn exclude(&mut self, name: &str, ranges: &[(usize, usize)]) {
        let all = ranges.iter().fold(self.excluded().to_vec(), |all, range| joined(all, *range));
        self.edit(name.to_owned(), None, |content| content.excluded = all);
    }

    /// Returns `true` if anything between two frames, both included, is not left out.
    pub(crate) fn has_included(&self, (from, to): (usize, usize)) -> bool {
        (from..=to).any(|frame| !self.is_excluded(frame))
    }

    /// Returns the frame to show in place of an excluded one while playing: the next included one in that
    /// direction within the `bounds`. If it `wraps`, the other end follows the end.
    pub(crate) fn next_included(
        &self,
        frame: usize,
        is_forwards: bool,
        (first, last): (usize, usize),
        wraps: bool,
    ) -> Option<usize> {
        let (ahead, around): (Vec<usize>, Vec<usize>) = if is_forwards {
            ((frame..=last).collect(), (first..frame).collect())
        } else {
            ((first..=frame).rev().collect(), (frame + 1..=last).rev().collect())
        };
        let around = around.into_iter().filter(|_| wraps);
        ahead.into_iter().chain(around).find(|frame| !self.is_excluded(*frame))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::viewer::backend::ranges::{included, mended};
    use proptest::prelude::*;
    use surgtpgs_core::overlay::OverlayLook;

    proptest! {
        #[test]
        fn ranges_are_what_frames_one_by_one_would_be(
            toggles in proptest::collection::vec((0_usize..20, 0_usize..6), 0..12),
        ) {
            let mut document = Document::new(OverlayLook::default(), 0.4);
            let mut out = [false; 26];
            for (from, length) in toggles {
                let range = from..=from + length;
                let is_out = !range.clone().all(|i| out[i]);
                range.for_each(|i| out[i] = is_out);
                document.toggle_excluded(from, from + length);
                prop_assert_eq!((0..26).map(|i| document.is_excluded(i)).collect::<Vec<_>>(), out.to_vec());
                let kept = included((0, 25), document.excluded());
                prop_assert_eq!(kept, (0..26).filter(|i| !out[*i]).collect::<Vec<_>>());
                prop_assert!(document.excluded().windows(2).all(|w| w[0].1 + 1 < w[1].0), "neighbours are one");
            }
        }
    }

    #[test]
    fn playing_goes_on_behind_what_is_left_out() {
        let mut document = Document::new(OverlayLook::default(), 0.4);
        document.toggle_excluded(7, 9);
        assert_eq!(document.undo_name(), Some("leaving out frames 8 to 10"));
        let next = |document: &Document, frame, is_forwards| {
            document.next_included(frame, is_forwards, (0, 9), true)
        };
        assert_eq!((next(&document, 8, true), next(&document, 8, false)), (Some(0), Some(6)));
        assert_eq!(next(&document, 3, true), Some(3));
        assert_eq!(document.next_included(8, true, (0, 9), false), None, "it stops at the end");
        assert_eq!(document.next_included(8, true, (5, 9), true), Some(5), "it stays in the range");
        assert!(!document.has_included((7, 9)) && document.has_included((6, 9)));
        document.toggle_excluded(0, 9);
        assert_eq!(next(&document, 3, true), None);
        assert_eq!(mended(vec![(5, 3), (2, 4), (4, 7), (8, 99)], 10), [(2, 7)]);
    }
}
