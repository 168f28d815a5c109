//! Frames around a frame, and the pictures that they alone tell of it: baselines that a reconstruction should
//! beat.

use std::ops::Range;
use surgtpgs_core::{
    Result,
    flow::{Between, between},
    scene::Scene,
    sequence::Sequence,
};

/// The nearest frames before and after a frame that training may see.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Neighbours {
    pub(super) frame: usize,
    before: Option<usize>,
    after: Option<usize>,
}

impl Neighbours {
    /// Neighbours of `frame`, which is not one of them, among the `shown` frames of its `shot`, in ascending
    /// order.
    pub(super) fn of(frame: usize, shown: &[usize], shot: &Range<usize>, held_out: bool) -> Self {
        let may_see = |i: &usize| shot.contains(i) && !(held_out && Sequence::is_test_frame(*i));
        let (before, others) = shown.split_at(shown.partition_point(|i| *i < frame));
        let before = before.iter().copied().rev().find(may_see);
        let after = others.iter().copied().filter(|i| *i != frame).find(may_see);
        Self { frame, before, after }
    }

    /// Returns the frames whose labels may be copied as a guess of those of the frame, the best first: of those
    /// that are `known`, the nearest ones, and those of the frame's `shot` before all others.
    pub(super) fn copied_from(&self, known: &[usize], shot: &Range<usize>) -> Vec<usize> {
        let mut others: Vec<usize> = known.iter().copied().filter(|i| *i != self.frame).collect();
        others.sort_by_key(|i| (!shot.contains(i), i.abs_diff(self.frame)));
        others
    }

    /// Returns `true` if a neighbour has the frame's time: it shows the same.
    pub(super) fn repeats(&self, scene: &Scene) -> bool {
        let is_same = |i: usize| scene.time(i) == scene.time(self.frame);
        self.before.into_iter().chain(self.after).any(is_same)
    }

    /// Guesses at the picture of the frame. At an end of the recording the only neighbour is copied. `None` if
    /// there is no neighbour.
    pub(super) fn guess(&self, sequence: &Sequence) -> Result<Option<Between>> {
        let (Some(before), Some(after)) = (self.before.or(self.after), self.after.or(self.before)) else {
            return Ok(None);
        };
        let [start, here, end] = [before, self.frame, after].map(|i| sequence.time(i));
        Ok(between(&sequence.frame(before)?, &sequence.frame(after)?, share_of_way(start, here, end)))
    }
}

/// Returns how much of the way from `start` to `end` is done at `here`; nothing if both are the same.
fn share_of_way(start: f32, here: f32, end: f32) -> f32 {
    if end > start { (here - start) / (end - start) } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn neighbours_are_frames_that_training_sees() {
        let shown: Vec<usize> = (0..18).collect();
        let of = |frame, shown: &[usize], shot, held_out| {
            let Neighbours { before, after, .. } = Neighbours::of(frame, shown, &shot, held_out);
            (before, after)
        };
        assert_eq!(of(9, &shown, 0..18, true), (Some(8), Some(10)));
        assert_eq!(of(10, &shown, 0..18, true), (Some(8), Some(11)));
        assert_eq!(of(10, &shown, 0..18, false), (Some(9), Some(11)));
        assert_eq!(of(17, &shown, 0..18, true), (Some(16), None), "at the end");
        assert_eq!(of(9, &shown, 9..18, true), (None, Some(10)), "beyond a cut nothing is seen");
        assert_eq!(of(9, &[5, 9, 14], 0..18, true), (Some(5), Some(14)), "nor what was left out");
        assert_eq!(of(0, &[0], 0..1, true), (None, None));
    }

    #[test]
    fn frames_of_one_time_are_no_way_apart() {
        assert_eq!(share_of_way(0.25, 0.5, 0.75), 0.5);
        assert_eq!([0.5, 0.75].map(|end| share_of_way(0.5, 0.5, end)), [0.0; 2]);
    }

    #[test]
    fn copied_labels_are_those_that_are_known() {
        let shown: Vec<usize> = (0..18).collect();
        let copied = |frame, shot: Range<usize>, known: &[usize]| {
            Neighbours::of(frame, &shown, &shot, false).copied_from(known, &shot)
        };
        assert_eq!(copied(9, 0..18, &[7, 9, 10]), [10, 7], "never its own");
        assert_eq!(copied(9, 0..18, &[2, 14]), [14, 2]);
        assert_eq!(copied(8, 0..18, &[2, 14])[0], 2, "the earlier one of two");
        assert_eq!(copied(9, 0..10, &[2, 14])[0], 2, "before what lies beyond a cut");
        assert_eq!(copied(9, 5..18, &[2]), [2], "which counts where there is nothing else");
    }
}
