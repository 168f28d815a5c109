//! The order in which frames with growing marks are segmented. A mark on a second frame is often for one
//! structure alone. The other names come from the guides of the frame: marked frames that show as many names
//! or more. Names that neither the frame nor its guides show may be propagated: their marks are carried to it
//! from the nearest frames that have some.

use super::Evidence;
use std::{
    cmp::Reverse,
    collections::{BTreeMap, BTreeSet},
};

/// Largest distance, in frames, from which a marked frame is looked up.
pub(super) const MAX_LOOKUP_FRAMES: usize = 100;
/// Largest number of guides in a row among frames that show equally many names.
const MAX_GUIDES_IN_A_ROW: usize = 8;

/// Guides and propagation sources of each frame with growing marks.
///
/// A frame has at most one guide on each side: of the frames there that come before it in the order, the one
/// that shows most names, and of several such frames the nearest. Frames come in the order of the number of
/// names that they show, the most first; of frames that show equally many, the earlier comes first. Frames
/// with outlines alone have no guides: outlines say where structures end.
pub(super) struct Plan {
    places: BTreeMap<usize, Place>,
    /// For each name, `true` if a mark that grows shows it.
    is_shown: Vec<bool>,
}

struct Place {
    guides: Vec<usize>,
    /// Frames whose marks may be propagated here, with the names that count.
    propagation_sources: BTreeMap<usize, BTreeSet<usize>>,
    num_shown: usize,
    /// Length of the longest row of guides that leads to it.
    num_steps: usize,
    /// Names that marks on the frame, on its guides, on their guides and so on show.
    known: BTreeSet<usize>,
}

impl Plan {
    /// Makes the plan for the evidence of marks that grow. `pointed` are the frames with clicks or strokes.
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
        let is_shown = (0..num_names).map(|name| frames_of.contains_key(&name)).collect();
        let mut plan = Self { places: BTreeMap::new(), is_shown };
        for (frame, mut known) in shown {
            let num_shown = known.len();
            let has_guides = pointed.contains(&frame);
            let guides = if has_guides { plan.choose_guides(frame, num_shown) } else { Vec::new() };
            guides.iter().for_each(|guide| known.extend(&plan.places[guide].known));
            let mut propagation_sources: BTreeMap<usize, BTreeSet<usize>> = BTreeMap::new();
            for (name, frames) in frames_of.iter().filter(|(name, _)| !known.contains(name)) {
                for source in beside(frame, frames) {
                    propagation_sources.entry(source).or_default().insert(*name);
                }
            }
            let steps = guides.iter().map(|guide| plan.places[guide].num_steps + 1);
            let num_steps = steps.max().unwrap_or(0);
            let place = Place { guides, propagation_sources, num_shown, num_steps, known };
            plan.places.insert(frame, place);
        }
        plan
    }

    /// Returns the guides of a frame that shows `num_shown` names, chosen among the frames that have a place.
    fn choose_guides(&self, frame: usize, num_shown: usize) -> Vec<usize> {
        let richest = |frames: &mut dyn Iterator<Item = (&usize, &Place)>| {
            let rank = |(other, place): &(&usize, &Place)| (place.num_shown, Reverse(other.abs_diff(frame)));
            let best = frames.max_by_key(rank);
            let is_near =
                |place: &Place| place.num_shown > num_shown || place.num_steps < MAX_GUIDES_IN_A_ROW;
            best.filter(|(_, place)| is_near(place)).map(|(other, _)| *other)
        };
        let before = richest(&mut self.places.range(frame.saturating_sub(MAX_LOOKUP_FRAMES)..frame));
        let after = richest(&mut self.places.range(frame + 1..=frame + MAX_LOOKUP_FRAMES));
        before.into_iter().chain(after).collect()
    }

    /// Returns the guides of a frame.
    pub(super) fn guides(&self, frame: usize) -> &[usize] {
        self.places.get(&frame).map_or(&[], |place| &place.guides)
    }

    /// Returns the frames whose marks may be propagated to a frame, with the names that count.
    pub(super) fn propagation_sources(&self, frame: usize) -> BTreeMap<usize, BTreeSet<usize>> {
        self.places.get(&frame).map(|place| place.propagation_sources.clone()).unwrap_or_default()
    }

    /// Returns a frame, its guides, their guides and so on, and the propagation sources of all of these.
    pub(super) fn with_sources(&self, frame: usize) -> BTreeSet<usize> {
        let mut all = BTreeSet::new();
        let mut next = vec![frame];
        while let Some(frame) = next.pop() {
            if all.insert(frame) {
                next.extend(self.guides(frame));
            }
        }
        let sources: Vec<usize> =
            all.iter().flat_map(|frame| self.propagation_sources(*frame).into_keys()).collect();
        all.extend(sources);
        all
    }

    /// Returns `true` if a frame has the same guides and propagation sources in another plan.
    pub(super) fn has_same_place_as(&self, other: &Self, frame: usize) -> bool {
        let place = |plan: &Self| {
            (plan.guides(frame).to_vec(), plan.propagation_sources(frame), plan.shows_all(frame))
        };
        place(self) == place(other)
    }

    /// Returns `true` if the marks on a frame show all names.
    pub(super) fn shows_all(&self, frame: usize) -> bool {
        let num_names = self.is_shown.iter().filter(|is_shown| **is_shown).count();
        self.places.get(&frame).is_some_and(|place| place.num_shown == num_names)
    }

    /// Returns for each name whether a frame knows it, with those that were `propagated` to it or to its guides.
    /// Its pixels may show any other name, unless they show one that it knows.
    pub(super) fn known_names(&self, frame: usize, propagated: &BTreeSet<usize>) -> Vec<bool> {
        let knows = |place: &Place, name: usize| place.known.contains(&name) || propagated.contains(&name);
        let is_known = |(name, is_shown): (usize, &bool)| {
            !is_shown || self.places.get(&frame).is_none_or(|place| knows(place, name))
        };
        self.is_shown.iter().enumerate().map(is_known).collect()
    }
}

/// Returns the nearest of `frames` on each side of a frame, as far as frames are looked up.
pub(super) fn beside<T>(frame: usize, frames: &BTreeMap<usize, T>) -> Vec<usize> {
    let before = frames.range(..frame).next_back();
    let after = frames.range(frame + 1..).next();
    let both = before.into_iter().chain(after).map(|(marked, _)| *marked);
    both.filter(|marked| marked.abs_diff(frame) <= MAX_LOOKUP_FRAMES).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::marks::{Mark, Marks, Shape};

    fn plan(marks: &[(usize, &str, bool)]) -> Plan {
        let click = Shape::Click { point_px: [2.5, 2.5], radius_px: 1.0 };
        let mark = |&(frame, name, add): &(usize, &str, bool)| Mark::new(frame, name, add, click.clone());
        let marks = Marks::unchecked(marks.iter().map(mark).collect());
        let names = marks.names();
        let of = |frame| (frame, Evidence::of(&marks, frame, &names, [8, 8]));
        let frames = marks.frames();
        Plan::of(&frames.iter().copied().map(of).collect(), &frames.into_iter().collect(), names.len())
    }

    #[test]
    fn frames_that_show_most_names_guide_the_others() {
        let all = [(10, "liver", true), (10, "fat", true), (14, "liver", true), (14, "fat", true)];
        let more = [(4, "fat", true), (6, "liver", false), (12, "liver", true), (300, "fat", true)];
        let plan = plan(&[&all[..], &more[..]].concat());
        let guides = [(10, &[][..]), (14, &[10]), (4, &[10]), (6, &[4, 10]), (12, &[10, 14]), (300, &[])];
        for (frame, guides) in guides {
            assert_eq!(plan.guides(frame), guides, "{frame}");
        }
        let known = |frame: usize| plan.known_names(frame, &BTreeSet::new());
        assert!([4, 6, 10, 12].into_iter().all(|frame| known(frame) == [true; 2]));
        assert!(plan.shows_all(14) && !plan.shows_all(12));
        assert_eq!(plan.with_sources(6), [4, 6, 10].into());
        assert!(known(300) == [true, false] && plan.propagation_sources(300).is_empty(), "too far away");
    }

    #[test]
    fn rows_of_guides_are_short() {
        let marks: Vec<(usize, &str, bool)> = (0..5000).map(|frame| (frame, "liver", true)).collect();
        let plan = plan(&marks);
        assert_eq!((plan.guides(0), plan.guides(1), plan.guides(9)), (&[][..], &[0][..], &[][..]));
        assert!((0..5000).all(|frame| plan.with_sources(frame).len() <= MAX_GUIDES_IN_A_ROW + 1));
    }

    #[test]
    fn frames_with_outlines_alone_have_no_guides() {
        let outline = Shape::Box { corners_px: [[1.0, 1.0], [6.0, 6.0]] };
        let marks = [3, 4].map(|frame| Mark::new(frame, "liver", true, outline.clone()));
        let marks = Marks::unchecked(marks.into());
        let evidence = [3, 4].map(|frame| (frame, Evidence::of(&marks, frame, &marks.names(), [8, 8])));
        let plan = Plan::of(&evidence.into(), &BTreeSet::new(), 1);
        assert!(plan.guides(4).is_empty() && plan.known_names(4, &BTreeSet::new()) == [true]);
    }

    #[test]
    fn where_no_frame_shows_all_names_marks_are_propagated() {
        let plan = plan(&[(3, "liver", true), (9, "fat", true), (14, "fat", true), (99, "clip", true)]);
        let [clip, fat] = [0, 1].map(|name| BTreeSet::from([name]));
        assert_eq!((plan.guides(3), plan.guides(9)), (&[][..], &[3][..]));
        assert_eq!(
            plan.propagation_sources(3),
            [(9, fat.clone()), (99, clip.clone())].into(),
            "the nearest frames"
        );
        assert_eq!(
            plan.propagation_sources(9),
            [(99, clip.clone())].into(),
            "its guide does not show the clip"
        );
        assert_eq!(plan.known_names(9, &BTreeSet::new()), [false, true, true]);
        assert_eq!(plan.known_names(3, &fat), [false, true, true]);
        assert_eq!(plan.known_names(3, &(&fat | &clip)), [true; 3]);
        assert_eq!(plan.with_sources(9), [3, 9, 99].into());
    }
}
