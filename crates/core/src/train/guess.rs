//! Guesses at held-out frames, from the frames around them.
//!
//! A frame that training may not see is a gap in time, and what fills it is learned from afar: the basis
//! functions that are live there serve the frames before and after. Short optical flow between these tells
//! more: where both, moved to the time of the gap, look alike, their mean is something to learn from.
//! Nothing is read of the frame itself.

use super::frames::TrainFrame;
use crate::{
    Result,
    flow::{Colour, arriving, arriving_mask, ways_around},
    grid::{Grid, Mask},
    sequence::Sequence,
};

/// Largest difference of a colour between the two moved frames, in 8-bit levels, where they look alike. They
/// differ at tools, at what these cover, and where the flow is wrong.
const ALIKE: f32 = 24.0;

/// Number and time of a frame.
type Place = (usize, f32);

/// A frame to be guessed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Guess {
    /// Number and time of the frame.
    pub place: Place,
    /// The frame before it and the one after, which training may see.
    nearest: [Place; 2],
    /// The next one before and after these, if there is one.
    next: [Option<Place>; 2],
}

/// A frame that was moved: its colours, and the pixels that are to be supervised.
type Moved = (Grid<Colour>, Mask);

/// Returns a guess for each of `frames` whose neighbours are among `seen`, which is in order. A frame that
/// repeats its neighbour, and so has its time, needs none.
pub fn guesses(frames: &[usize], seen: &[usize], time: impl Fn(usize) -> f32) -> Vec<Guess> {
    let place = |i: usize| (i, time(i));
    let is_seen = |i: &usize| seen.binary_search(i).is_ok();
    let guess = |&i: &usize| {
        let before = i.checked_sub(1).filter(is_seen).map(place)?;
        let after = Some(i + 1).filter(is_seen).map(place)?;
        let earlier = seen.iter().rev().map(|i| place(*i)).find(|p| p.1 < before.1);
        let later = seen.iter().map(|i| place(*i)).find(|p| p.1 > after.1);
        let is_between = before.1 < time(i) && time(i) < after.1;
        is_between.then_some(Guess { place: place(i), nearest: [before, after], next: [earlier, later] })
    };
    frames.iter().filter_map(guess).collect()
}

impl Guess {
    /// Guesses the frame at full size: its colours, and as mask the pixels where they can be relied on. It
    /// has neither depth nor features.
    pub fn load(&self, sequence: &Sequence) -> Result<TrainFrame> {
        let read = |(i, time): Place| Ok((sequence.frame(i)?, time));
        let [before, after] = self.nearest.map(read);
        let [earlier, later] = self.next.map(|place| place.map(read).transpose());
        let (before, after, earlier, later) = (before?, after?, earlier?, later?);
        let next = [&earlier, &later].map(|frame| frame.as_ref().map(|f| (&f.0, f.1)));
        let ways = ways_around([(&before.0, before.1), (&after.0, after.1)], next, self.place.1);
        let [mask_before, mask_after] = self.nearest.map(|(i, _)| sequence.mask(i));
        let moved = [
            (arriving(&before.0, &ways[0]), arriving_mask(&mask_before?, &ways[0])),
            (arriving(&after.0, &ways[1]), arriving_mask(&mask_after?, &ways[1])),
        ];
        let share = (self.place.1 - before.1) / (after.1 - before.1);
        Ok(merged(&moved, share))
    }
}

/// Makes one frame of two moved ones, of which the second weighs `share`. Where only one is to be
/// supervised, it alone counts.
fn merged([(a, mask_a), (b, mask_b)]: &[Moved; 2], share: f32) -> TrainFrame {
    let n = a.data.len();
    let (mut colour, mut mask) = (vec![0; 3 * n], vec![false; n]);
    for p in 0..n {
        let (a, b) = (a.data[p], b.data[p]);
        let apart = (0..3).map(|k| (a[k] - b[k]).abs()).fold(0.0, f32::max);
        let (share, is_known) = match (mask_a.data[p], mask_b.data[p]) {
            (true, true) => (share, apart <= ALIKE),
            (true, false) => (0.0, true),
            (false, true) => (1.0, true),
            (false, false) => (share, false),
        };
        mask[p] = is_known;
        for k in 0..3 {
            colour[k * n + p] = (a[k] + share * (b[k] - a[k])).round() as u8;
        }
    }
    TrainFrame { width: a.width, height: a.height, colour, mask, depth: Vec::new(), regions: Vec::new() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_are_guessed_between_others_that_are_seen() {
        let time = |i: usize| [0.0, 0.1, 0.2, 0.3, 0.4, 0.4, 0.5, 0.6, 0.7, 0.8][i];
        let seen = [0, 2, 3, 5, 6, 7, 9];
        let found = guesses(&[1, 4, 8], &seen, time);
        // Frame 5 repeats frame 4, so that this one is known.
        let places: Vec<usize> = found.iter().map(|g| g.place.0).collect();
        assert_eq!(places, [1, 8]);
        assert_eq!(found[0].nearest.map(|p| p.0), [0, 2]);
        assert_eq!(found[0].next.map(|p| p.map(|p| p.0)), [None, Some(3)]);
        assert_eq!(found[1].next.map(|p| p.map(|p| p.0)), [Some(6), None]);
        assert!(guesses(&[0, 4], &[2, 3, 6], time).is_empty(), "nothing on one side");
    }

    #[test]
    fn what_one_frame_hides_is_taken_from_the_other_and_what_differs_is_not_known() {
        let side = |level: f32, seen: [bool; 4]| {
            (Grid::from_vec(4, 1, vec![[level, 10.0, 0.0]; 4]), Mask::from_vec(4, 1, seen.to_vec()))
        };
        let close = [side(100.0, [true, true, false, false]), side(120.0, [true, false, true, false])];
        let frame = merged(&close, 0.25);
        assert_eq!(frame.mask, [true, true, true, false]);
        assert_eq!(frame.colour[..3], [105, 100, 120]);
        assert_eq!(frame.colour[4..8], [10; 4]);
        let apart = [side(100.0, [true; 4]), side(130.0, [true, false, true, true])];
        assert_eq!(merged(&apart, 0.5).mask, [false, true, false, false]);
    }
}
