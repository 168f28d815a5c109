//! Notes on marks that show nothing.

use super::{Canvas, Evidence, Mark, Marks, name_of};
use crate::grid::Mask;
use rayon::prelude::*;

/// Largest number of marks that are named.
const MOST_NAMED: usize = 8;

impl Marks {
    /// Names the marks that lie outside of the endoscope's picture, and the names whose marks leave nothing.
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
        let others = Self { marks: others.into_iter().map(|(_, mark)| mark.clone()).collect() };
        let cancelled: Vec<String> =
            others.names().into_iter().filter(|name| others.cancels(name, size, &inside)).collect();
        let cancelled =
            cancelled.into_iter().map(|name| format!("the marks of \"{name}\" cancel each other"));
        outside.iter().take(MOST_NAMED).map(name).chain(more).chain(cancelled).collect()
    }

    /// Returns `true` if marks and their opposites leave nothing of a name that is marked.
    fn cancels(&self, name: &String, size: [usize; 2], inside: &Mask) -> bool {
        let own = self.named(&[name]);
        let shown = own.filtered(|mark| mark.add);
        let shows = |frame: usize| {
            let evidence = Evidence::of(&own, frame, std::slice::from_ref(name), size);
            evidence.shown().any(|(mut pixels, _)| pixels.any(|i| is_inside(inside, i)))
        };
        let is_mixed = !shown.is_empty() && shown.marks.len() < own.marks.len();
        is_mixed && !shown.frames().into_iter().any(shows)
    }
}

/// Returns `true` if no pixel of a mark lies inside of the endoscope's picture.
fn lies_outside(mark: &Mark, [width, height]: [usize; 2], inside: &Mask) -> bool {
    let pixels = mark.shape.pixels(width, height);
    let mut marked = (0..pixels.data.len()).filter(|i| pixels.data[*i]).peekable();
    marked.peek().is_some() && !marked.any(|i| is_inside(inside, i))
}

/// Returns `true` if a pixel lies inside of the endoscope's picture; every pixel does if that is not known.
fn is_inside(inside: &Mask, i: usize) -> bool {
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
}
