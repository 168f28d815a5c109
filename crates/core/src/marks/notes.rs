//! Notes on marks that show nothing, and on places that several names share.

use super::{Canvas, Evidence, Mark, Marks, name_of, names_of};
use crate::grid::Mask;
use rayon::prelude::*;
use std::collections::BTreeMap;

/// Largest number of marks that are named, and of places.
const MOST_NAMED: usize = 8;

impl Marks {
    /// Names the marks that lie outside of the endoscope's picture, the names whose marks leave nothing, and
    /// places that are marked as two names by marks of the same size.
    /// `field_of_view` is `true` inside of the picture; it may have another size than `canvas`. Marks on frames
    /// that do not count are passed over.
    pub fn notes(
        &self,
        canvas: &Canvas,
        field_of_view: &Mask,
        counts: impl Fn(usize) -> bool,
    ) -> Vec<String> {
        let size = [canvas.width, canvas.height];
        let inside = field_of_view.sampled(canvas.width, canvas.height);
        let counted: Vec<(usize, &Mark)> =
            self.marks.iter().enumerate().filter(|(_, mark)| counts(mark.frame)).collect();
        let (outside, others): (Vec<_>, Vec<_>) =
            counted.into_par_iter().partition(|(_, mark)| lies_outside(mark, size, &inside));
        let name = |(i, mark): &(usize, &Mark)| {
            let which = name_of(*i, &mark.name, Some(mark.frame));
            format!("{which} lies outside of the endoscope's picture and shows nothing")
        };
        let more = outside.len().saturating_sub(MOST_NAMED);
        let more = (more > 0).then(|| format!("marks outside that are not named here: {more}"));
        let others = Self::unchecked(others.into_iter().map(|(_, mark)| mark.clone()).collect());
        let cancelled = names_of(others.marks.iter()).into_iter();
        let cancelled: Vec<String> = cancelled.filter(|name| others.cancels(name, size, &inside)).collect();
        let cancelled =
            cancelled.into_iter().map(|name| format!("the marks of \"{name}\" cancel each other"));
        let shared = others.shared_places(size, &inside);
        outside.iter().take(MOST_NAMED).map(name).chain(more).chain(cancelled).chain(shared).collect()
    }

    /// Returns `true` if marks and their opposites leave nothing of a name that is marked.
    fn cancels(&self, name: &String, size: [usize; 2], inside: &Mask) -> bool {
        let own = || self.marks.iter().filter(|mark| mark.name == *name);
        let is_mixed = own().any(|mark| mark.add) && own().any(|mark| !mark.add);
        let shows = |frame: usize| {
            let evidence = Evidence::of(self, frame, std::slice::from_ref(name), size);
            evidence.shown().any(|(mut pixels, _)| pixels.any(|i| is_inside(inside, i)))
        };
        is_mixed && !self.named(&[name]).frames().into_iter().any(shows)
    }

    /// Names the pairs of names of which one shares more than half of its place on a frame with the other.
    fn shared_places(&self, size: [usize; 2], inside: &Mask) -> Vec<String> {
        let names = self.shown_names();
        let pairs_on = |frame: usize| {
            let mut areas = vec![0; names.len()];
            let mut shared: BTreeMap<(usize, usize), usize> = BTreeMap::new();
            for (pixels, shown) in Evidence::of(self, frame, &names, size).all_shown() {
                let area = pixels.filter(|i| is_inside(inside, *i)).count();
                for (place, &a) in shown.iter().enumerate() {
                    areas[a] += area;
                    shown[place + 1..].iter().for_each(|b| *shared.entry((a, *b)).or_default() += area);
                }
            }
            let is_same = |&((a, b), area): &((usize, usize), usize)| 2 * area > areas[a].min(areas[b]);
            shared.into_iter().filter(is_same).map(|((a, b), _)| (frame, a, b)).collect::<Vec<_>>()
        };
        let is_contested = |frame: &usize| names_of(self.on(*frame).filter(|mark| mark.add)).len() > 1;
        let frames: Vec<usize> = self.frames().into_iter().filter(is_contested).collect();
        let pairs: Vec<(usize, usize, usize)> = frames.into_par_iter().flat_map_iter(pairs_on).collect();
        let more = pairs.len().saturating_sub(MOST_NAMED);
        let more = (more > 0).then(|| format!("places of two names that are not named here: {more}"));
        let note = |(frame, a, b): &(usize, usize, usize)| {
            let names = format!("\"{}\" and as \"{}\"", names[*a], names[*b]);
            format!("the same place is marked as {names} on frame {frame}: neither is found there")
        };
        pairs.iter().take(MOST_NAMED).map(note).chain(more).collect()
    }
}

/// Returns `true` if no pixel of a mark lies inside of the endoscope's picture.
pub(super) fn lies_outside(mark: &Mark, [width, height]: [usize; 2], inside: &Mask) -> bool {
    let pixels = mark.shape.pixels(width, height);
    let mut marked = (0..pixels.data.len()).filter(|i| pixels.data[*i]).peekable();
    marked.peek().is_some() && !marked.any(|i| is_inside(inside, i))
}

/// Returns `true` if a pixel lies inside of the endoscope's picture; every pixel does if that is not known.
pub(super) fn is_inside(inside: &Mask, i: usize) -> bool {
    inside.data.get(i).is_none_or(|inside| *inside)
}

#[cfg(test)]
mod tests {
    use super::super::tests::{SIZE, canvas, stroke};
    use super::*;

    /// Notes where the left half of the picture is the unused border.
    fn notes(marks: Vec<Mark>, counts: impl Fn(usize) -> bool) -> Vec<String> {
        let right = Mask::from_vec(2, 1, vec![false, true]);
        Marks::new(marks, &canvas()).unwrap().notes(&canvas(), &right, counts)
    }

    const LEFT: [[f32; 2]; 2] = [[8.0, 10.0], [20.0, 40.0]];
    const RIGHT: [[f32; 2]; 2] = [[50.0, 10.0], [44.0, 40.0]];
    const ACROSS: [[f32; 2]; 2] = [LEFT[0], RIGHT[0]];

    #[test]
    fn marks_outside_of_the_picture_are_named() {
        let marks = || vec![stroke(2, "duct", true, &LEFT), stroke(2, "fat", true, &ACROSS)];
        let expected =
            "marks[0] (\"duct\" on frame 2) lies outside of the endoscope's picture and shows nothing";
        assert_eq!(notes(marks(), |_| true), [expected]);
        assert!(notes(marks(), |frame| frame != 2).is_empty());
        let many = notes((0..11).map(|_| stroke(0, "duct", true, &LEFT)).collect(), |_| true);
        assert_eq!(
            (many.len(), &*many[MOST_NAMED]),
            (MOST_NAMED + 1, "marks outside that are not named here: 3")
        );
        let whole = Marks::new(marks(), &canvas()).unwrap();
        for field_of_view in [Mask::default(), Mask::filled(SIZE[0], SIZE[1], true)] {
            assert!(whole.notes(&canvas(), &field_of_view, |_| true).is_empty());
        }
    }

    #[test]
    fn names_whose_marks_cancel_each_other_are_told() {
        let [duct, not_duct] = [true, false].map(|add| stroke(0, "duct", add, &RIGHT));
        let expected = ["the marks of \"duct\" cancel each other"];
        assert_eq!(notes(vec![duct.clone(), not_duct.clone()], |_| true), expected);
        // On another frame it is still shown.
        assert!(
            notes(vec![duct.clone(), not_duct.clone(), stroke(1, "duct", true, &RIGHT)], |_| true).is_empty()
        );
        assert!(notes(vec![not_duct.clone()], |_| true).is_empty(), "a correction alone says enough");
        assert!(notes(vec![duct, stroke(0, "fat", false, &RIGHT)], |_| true).is_empty());
    }

    #[test]
    fn a_place_of_two_names_is_told() {
        let [liver, fat] = ["liver", "fat"].map(|name| stroke(2, name, true, &RIGHT));
        let told = notes(vec![liver.clone(), fat.clone()], |_| true);
        let expected =
            "the same place is marked as \"fat\" and as \"liver\" on frame 2: neither is found there";
        assert_eq!(told, [expected]);
        let small = stroke(2, "fat", true, &RIGHT[..1]);
        assert!(notes(vec![liver.clone(), small], |_| true).is_empty(), "it belongs to the smaller one");
        let not_fat = stroke(2, "fat", false, &RIGHT);
        assert_eq!(notes(vec![liver, fat, not_fat], |_| true), ["the marks of \"fat\" cancel each other"]);
    }
}
