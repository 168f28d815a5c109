//! The order in which frames with growing marks become known. A mark is often one more on a second frame, for
//! one structure alone: what it does not speak of is told by frames that show more. What none of these speaks
//! of either is lent: the marks themselves are carried over from the nearest frames that have some.

use super::Evidence;
use std::{
    cmp::Reverse,
    collections::{BTreeMap, BTreeSet},
};

/// Frames that a marked frame is looked up from at most, on either side.
pub(super) const REACH: usize = 100;
/// Frames that tell each other in a row at most, of those that show as many names.
const MOST_STEPS: usize = 8;

/// Tellers of each frame: of the frames on either side that show more names than it does, those that show
/// most, and the nearest of them. Of frames that show as many, the earlier one tells the later one. Frames
/// with outlines alone are not told: outlines say where structures end.
pub(super) struct Plan {
    places: BTreeMap<usize, Place>,
    /// Number of names that marks show.
    num_names: usize,
}

struct Place {
    tellers: Vec<usize>,
    /// Frames whose marks of these names are carried here.
    lenders: BTreeMap<usize, BTreeSet<usize>>,
    num_shown: usize,
    /// Number of frames in a row that told it.
    num_steps: usize,
    /// Names that the frame shows or is told.
    known: BTreeSet<usize>,
}

impl Plan {
    /// Makes the plan for the evidence of marks that grow. Clicks or strokes say something on the frames of
    /// `pointed`.
    pub(super) fn of(
        growing: &BTreeMap<usize, Evidence>,
        pointed: &BTreeSet<usize>,
        num_names: usize,
    ) -> Self {
        let names = |evidence: &Evidence| (0..num_names).filter(|k| evidence.shows(*k)).collect();
        let mut shown: Vec<(usize, BTreeSet<usize>)> =
            growing.iter().map(|(frame, evidence)| (*frame, names(evidence))).collect();
        shown.sort_by_key(|(frame, names)| (Reverse(names.len()), *frame));
        let mut frames_of: BTreeMap<usize, BTreeMap<usize, ()>> = BTreeMap::new();
        for (frame, names) in &shown {
            names.iter().for_each(|name| {
                frames_of.entry(*name).or_default().insert(*frame, ());
            });
        }
        let mut plan = Self { places: BTreeMap::new(), num_names: frames_of.len() };
        for (frame, mut known) in shown {
            let num_shown = known.len();
            let is_told = pointed.contains(&frame);
            let tellers = if is_told { plan.richest_beside(frame, num_shown) } else { Vec::new() };
            for teller in tellers.iter().map(|teller| &plan.places[teller]) {
                known.extend(teller.known.iter().chain(teller.lenders.values().flatten()));
            }
            let mut lenders: BTreeMap<usize, BTreeSet<usize>> = BTreeMap::new();
            for (name, frames) in frames_of.iter().filter(|(name, _)| !known.contains(name)) {
                for lender in beside(frame, frames) {
                    lenders.entry(lender).or_default().insert(*name);
                }
            }
            let steps = tellers.iter().map(|teller| plan.places[teller].num_steps + 1);
            let num_steps = steps.max().unwrap_or(0);
            plan.places.insert(frame, Place { tellers, lenders, num_shown, num_steps, known });
        }
        plan
    }

    /// Returns the frames on either side of one that shows `num_shown` names that show most names, of those that
    /// have a place.
    fn richest_beside(&self, frame: usize, num_shown: usize) -> Vec<usize> {
        let richest = |frames: &mut dyn Iterator<Item = (&usize, &Place)>| {
            let rank = |(other, place): &(&usize, &Place)| (place.num_shown, Reverse(other.abs_diff(frame)));
            let best = frames.max_by_key(rank);
            let is_near = |place: &Place| place.num_shown > num_shown || place.num_steps < MOST_STEPS;
            best.filter(|(_, place)| is_near(place)).map(|(other, _)| *other)
        };
        let before = richest(&mut self.places.range(frame.saturating_sub(REACH)..frame));
        let after = richest(&mut self.places.range(frame + 1..=frame + REACH));
        before.into_iter().chain(after).collect()
    }

    /// Returns the frames that tell a frame what its marks do not.
    pub(super) fn tellers(&self, frame: usize) -> &[usize] {
        self.places.get(&frame).map_or(&[], |place| &place.tellers)
    }

    /// Returns the frames whose marks are carried to a frame, with the names that count.
    pub(super) fn lenders(&self, frame: usize) -> BTreeMap<usize, BTreeSet<usize>> {
        self.places.get(&frame).map(|place| place.lenders.clone()).unwrap_or_default()
    }

    /// Returns a frame, those that tell it, those that tell these, and so on, and those that lend them marks.
    pub(super) fn with_tellers(&self, frame: usize) -> BTreeSet<usize> {
        let mut all = BTreeSet::new();
        let mut next = vec![frame];
        while let Some(frame) = next.pop() {
            if all.insert(frame) {
                next.extend(self.tellers(frame));
            }
        }
        let lenders: Vec<usize> = all.iter().flat_map(|frame| self.lenders(*frame).into_keys()).collect();
        all.extend(lenders);
        all
    }

    /// Returns `true` if another plan has the same place for a frame.
    pub(super) fn is_as_in(&self, other: &Self, frame: usize) -> bool {
        let place = |plan: &Self| (plan.tellers(frame).to_vec(), plan.lenders(frame), plan.shows_all(frame));
        place(self) == place(other)
    }

    /// Returns `true` if the marks on a frame show all names.
    pub(super) fn shows_all(&self, frame: usize) -> bool {
        self.places.get(&frame).is_some_and(|place| place.num_shown == self.num_names)
    }

    /// Returns `true` if a frame that marks of the names `lent` were carried to knows of all names; else it does
    /// not know what is left by those that it knows.
    pub(super) fn is_whole(&self, frame: usize, lent: &BTreeSet<usize>) -> bool {
        self.places.get(&frame).is_none_or(|place| place.known.union(lent).count() == self.num_names)
    }
}

/// Returns the nearest of `frames` on either side of a frame, as far as it is looked.
pub(super) fn beside<T>(frame: usize, frames: &BTreeMap<usize, T>) -> Vec<usize> {
    let before = frames.range(..frame).next_back();
    let after = frames.range(frame + 1..).next();
    let both = before.into_iter().chain(after).map(|(marked, _)| *marked);
    both.filter(|marked| marked.abs_diff(frame) <= REACH).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::marks::{Mark, Marks, Shape};

    fn plan(marks: &[(usize, &str, bool)]) -> Plan {
        let click = Shape::Click { point_px: [2.5, 2.5], radius_px: 1.0 };
        let mark = |&(frame, name, add): &(usize, &str, bool)| Mark::new(frame, name, add, click.clone());
        let marks = Marks { marks: marks.iter().map(mark).collect() };
        let names = marks.names();
        let of = |frame| (frame, Evidence::of(&marks, frame, &names, [8, 8]));
        let frames = marks.frames();
        Plan::of(&frames.iter().copied().map(of).collect(), &frames.into_iter().collect(), names.len())
    }

    #[test]
    fn frames_that_show_most_tell_the_others() {
        let whole = [(10, "liver", true), (10, "fat", true), (14, "liver", true), (14, "fat", true)];
        let more = [(4, "fat", true), (6, "liver", false), (12, "liver", true), (300, "fat", true)];
        let plan = plan(&[&whole[..], &more[..]].concat());
        let tellers = [(10, &[][..]), (14, &[10]), (4, &[10]), (6, &[4, 10]), (12, &[10, 14]), (300, &[])];
        for (frame, tellers) in tellers {
            assert_eq!(plan.tellers(frame), tellers, "{frame}");
        }
        assert!([4, 6, 10, 12].iter().all(|frame| plan.is_whole(*frame, &BTreeSet::new())));
        assert!(plan.shows_all(14) && !plan.shows_all(12));
        assert_eq!(plan.with_tellers(6), [4, 6, 10].into());
        assert!(!plan.is_whole(300, &BTreeSet::new()) && plan.lenders(300).is_empty(), "too far away");
    }

    #[test]
    fn many_marked_frames_are_told_in_short_rows() {
        let marks: Vec<(usize, &str, bool)> = (0..5000).map(|frame| (frame, "liver", true)).collect();
        let plan = plan(&marks);
        assert_eq!((plan.tellers(0), plan.tellers(1), plan.tellers(9)), (&[][..], &[0][..], &[][..]));
        assert!((0..5000).all(|frame| plan.with_tellers(frame).len() <= MOST_STEPS + 1));
    }

    #[test]
    fn frames_with_outlines_alone_speak_for_themselves() {
        let outline = Shape::Box { corners_px: [[1.0, 1.0], [6.0, 6.0]] };
        let marks = [3, 4].map(|frame| Mark::new(frame, "liver", true, outline.clone()));
        let marks = Marks { marks: marks.into() };
        let evidence = [3, 4].map(|frame| (frame, Evidence::of(&marks, frame, &marks.names(), [8, 8])));
        let plan = Plan::of(&evidence.into(), &BTreeSet::new(), 1);
        assert!(plan.tellers(4).is_empty() && plan.is_whole(4, &BTreeSet::new()));
    }

    #[test]
    fn where_no_frame_shows_all_names_marks_are_lent() {
        let plan = plan(&[(3, "liver", true), (9, "fat", true), (14, "fat", true), (99, "clip", true)]);
        let [clip, fat] = [0, 1].map(|name| BTreeSet::from([name]));
        assert_eq!((plan.tellers(3), plan.tellers(9)), (&[][..], &[3][..]));
        assert_eq!(plan.lenders(3), [(9, fat.clone()), (99, clip.clone())].into(), "the nearest frames");
        assert!(plan.lenders(9).is_empty() && plan.is_whole(9, &BTreeSet::new()), "the first told it");
        assert!(!plan.is_whole(3, &fat) && plan.is_whole(3, &(&fat | &clip)));
        assert_eq!(plan.with_tellers(9), [3, 9, 99].into());
    }
}
