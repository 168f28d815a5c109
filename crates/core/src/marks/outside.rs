//! Outlines end where their structure ends: what lies outside of them is denied.

use super::{Evidence, Mark, Marks};
use crate::{annotations::Shape, grid::Mask, mask::Bits, scene::Scene};
use rayon::prelude::*;
use std::{
    collections::{BTreeMap, BTreeSet},
    ops::Range,
};

/// Least area of a structure's outlines on a frame, as a part of its largest one on any. Smaller ones add a
/// piece, and say nothing of the rest of the structure.
const LEAST_PART: f32 = 0.5;
/// Number of columns of a picture for each pixel of the band around outlines that is left open: they are
/// drawn by hand.
const COLUMNS_PER_BAND_PX: usize = 80;

impl Marks {
    /// Adds what outlines on `frames` deny. Where polygons, boxes and masks alone show a name that the scene does
    /// not find by its features, they show all of it on their frame: the rest of the frame, but for a band around
    /// them, does not show it. A pixel is inside if more marks of the name are for it than against it.
    pub fn with_outsides(&self, scene: &Scene, frames: &Range<usize>) -> Self {
        let Some(camera) = scene.cameras.first() else { return self.clone() };
        let size = [camera.width, camera.height].map(|side| side as usize);
        let mut outlined = self.outlined(scene);
        outlined.retain(|(_, frame)| frames.contains(frame));
        let denied = outlined.into_par_iter().filter_map(|(name, frame)| {
            let shown = self.shown(&name, frame, size);
            let outside = outside(&shown);
            let is_some = shown.data.contains(&true) && outside.data.contains(&true);
            is_some.then(|| Mark::new(frame, &name, false, Shape::from(&outside)))
        });
        let denied: Vec<Mark> = denied.collect();
        Self::unchecked(self.standing().cloned().chain(denied).collect())
    }

    /// Returns the names that outlines show all of, with the frame.
    pub(super) fn outlined(&self, scene: &Scene) -> BTreeSet<(String, usize)> {
        let mut outlined = BTreeSet::new();
        for name in self.names().into_iter().filter(|name| !scene.finds(name)) {
            let shown = || self.standing().filter(|mark| mark.add && mark.name == name);
            if shown().any(|mark| !mark.shape.is_outlined()) {
                continue;
            }
            let mut areas: BTreeMap<usize, f32> = BTreeMap::new();
            shown().for_each(|mark| *areas.entry(mark.frame).or_default() += mark.shape.area_px());
            let largest = areas.values().copied().fold(0.0, f32::max);
            let complete = areas.into_iter().filter(|(_, area)| *area >= LEAST_PART * largest);
            outlined.extend(complete.map(|(frame, _)| (name.clone(), frame)));
        }
        outlined
    }

    /// Returns the pixels of a frame that the marks of a name show: those where they sum up to more than 0.
    fn shown(&self, name: &String, frame: usize, size: [usize; 2]) -> Mask {
        let mut shown = Mask::filled(size[0], size[1], false);
        let evidence = Evidence::of(self, frame, std::slice::from_ref(name), size);
        evidence.shown().for_each(|(pixels, _)| shown.data[pixels].fill(true));
        shown
    }
}

/// Returns the pixels outside of a mask and the band around it.
fn outside(mask: &Mask) -> Mask {
    let mut covered = Bits::of_mask(mask);
    for _ in 0..mask.width / COLUMNS_PER_BAND_PX {
        covered = covered.dilated();
    }
    covered.to_mask().map(|covered| !covered)
}

#[cfg(test)]
mod tests {
    use super::super::tests::{FRAMES, SIZE, any_marks, canvas, scene};
    use super::*;
    use proptest::prelude::*;

    /// Returns the marks of the only name with what outlines deny.
    fn with_outsides(marks: &[Mark]) -> Marks {
        Marks::new(marks.to_vec(), &canvas()).unwrap().with_outsides(&scene(), &(0..FRAMES))
    }

    /// Returns the pixels of a frame that marks show, and those that they deny.
    fn shown_and_denied(marks: &Marks, name: &String, frame: usize) -> [Vec<bool>; 2] {
        let evidence = Evidence::of(marks, frame, std::slice::from_ref(name), SIZE);
        let (weights, shares) = evidence.planes(0..1);
        let is_denied = |(weight, share): (&f32, &f32)| *weight > 0.0 && *share == 0.0;
        let denied = weights.iter().zip(&shares).map(is_denied).collect();
        [shares.iter().map(|share| *share > 0.0).collect(), denied]
    }

    #[test]
    fn an_outline_that_is_drawn_twice_counts_twice_against_one_denial() {
        let square = |add: bool, low: f32, high: f32| {
            Mark::new(0, "liver", add, Shape::Box { corners_px: [[low; 2], [high; 2]] })
        };
        let marks = [square(true, 4.0, 40.0), square(true, 8.0, 30.0), square(false, 16.0, 36.0)];
        let [shown, denied] = shown_and_denied(&with_outsides(&marks), &"liver".to_owned(), 0);
        // In both outlines, in both and the denial, in one of them and the denial, outside.
        let at = [10, 20, 33, 44].map(|i: usize| (shown[i * SIZE[0] + i], denied[i * SIZE[0] + i]));
        assert_eq!(at, [(true, false), (true, false), (false, true), (false, true)]);
    }

    proptest! {
        #![proptest_config(ProptestConfig { cases: 64, ..ProptestConfig::default() })]

        #[test]
        fn outlines_deny_no_pixel_that_marks_show(marks in any_marks(), turn in 0usize..5) {
            let mut turned = marks.clone();
            turned.rotate_left(turn % marks.len());
            let found = with_outsides(&marks);
            prop_assert_eq!(found.digest(), with_outsides(&turned).digest());
            let by_hand = Marks::new(marks.clone(), &canvas()).unwrap();
            for name in by_hand.names() {
                for frame in 0..FRAMES {
                    let [before, after] = [&by_hand, &found].map(|m| shown_and_denied(m, &name, frame));
                    prop_assert!(before[0] == after[0], "{name} on frame {frame}");
                    prop_assert!(before[1].iter().zip(&after[1]).all(|(before, after)| *after || !before));
                }
            }
            let opposite = |mark: &Mark| Mark { add: !mark.add, ..mark.clone() };
            let both: Vec<Mark> = marks.iter().cloned().chain(marks.iter().map(opposite)).collect();
            prop_assert_eq!(with_outsides(&both).standing().count(), 0);
        }
    }
}
