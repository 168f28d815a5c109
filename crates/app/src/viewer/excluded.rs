//! Frames that are left out of everything: not shown, not exported, not trained on. Pictures from outside the
//! body may reveal the identity of the patient.

use super::document::Document;

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
        let name = format!("{} {frames}", if is_out { "taking back in" } else { "leaving out" });
        let rest = cut(self.excluded(), (from, to));
        self.edit(name, None, |content| {
            content.excluded = if is_out { rest } else { joined(rest, (from, to)) }
        });
    }

    /// Returns the frame to show in place of an excluded one while playing: the next included frame in that
    /// direction, wrapping around at the end.
    pub(crate) fn next_included(&self, frame: usize, is_forwards: bool, num_frames: usize) -> Option<usize> {
        let step = |k: usize| {
            let to = if is_forwards { frame + k } else { frame + num_frames - k };
            to % num_frames.max(1)
        };
        (0..num_frames).map(step).find(|frame| !self.is_excluded(*frame))
    }
}

/// Removes the frames of `out` from the ranges.
fn cut(ranges: &[(usize, usize)], out: (usize, usize)) -> Vec<(usize, usize)> {
    let parts = |&(from, to): &(usize, usize)| {
        let before = out.0.checked_sub(1).map(|end| (from, to.min(end)));
        let after = Some((from.max(out.1 + 1), to));
        [before, after].into_iter().flatten().filter(|(from, to)| from <= to)
    };
    ranges.iter().flat_map(parts).collect()
}

/// Adds `more` to the ranges, keeps them in order, and joins neighbours.
fn joined(mut ranges: Vec<(usize, usize)>, more: (usize, usize)) -> Vec<(usize, usize)> {
    ranges.push(more);
    ranges.sort_unstable();
    let mut whole: Vec<(usize, usize)> = Vec::new();
    for (from, to) in ranges {
        match whole.last_mut() {
            Some(last) if from <= last.1 + 1 => last.1 = last.1.max(to),
            _ => whole.push((from, to)),
        }
    }
    whole
}

/// Limits the ranges to what is possible for `num_frames` frames, because files may hold any values.
pub(crate) fn mended(ranges: Vec<(usize, usize)>, num_frames: usize) -> Vec<(usize, usize)> {
    ranges.into_iter().filter(|(from, to)| from <= to && *to < num_frames).fold(Vec::new(), joined)
}

/// Returns the frames from `from` to `to` that are not excluded.
pub(crate) fn included((from, to): (usize, usize), excluded: &[(usize, usize)]) -> Vec<usize> {
    (from..=to).filter(|frame| !excluded.iter().any(|(a, b)| (*a..=*b).contains(frame))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
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
        let next = |document: &Document, frame, is_forwards| document.next_included(frame, is_forwards, 10);
        assert_eq!((next(&document, 8, true), next(&document, 8, false)), (Some(0), Some(6)));
        assert_eq!(next(&document, 3, true), Some(3));
        document.toggle_excluded(0, 9);
        assert_eq!(next(&document, 3, true), None);
        assert_eq!(mended(vec![(5, 3), (2, 4), (4, 7), (8, 99)], 10), [(2, 7)]);
    }
}
