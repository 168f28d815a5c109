//! One spelling for each name: names that capitals, spaces and hyphens alone tell apart are one.

use super::{Mark, Marks, names_of};
use crate::sequence::letters;
use std::collections::BTreeMap;

/// Gives marks the names that are `known` for theirs. Of other names that are one (see
/// [`is_same_name`](crate::sequence::is_same_name)), the marks get the one that comes first in the alphabet:
/// their order does not matter.
pub fn join_names(marks: &mut [Mark], known: impl Fn(&str) -> Option<String>) {
    let mut spellings: BTreeMap<String, String> = BTreeMap::new();
    let mut names: BTreeMap<String, String> = BTreeMap::new();
    for old in names_of(marks.iter()) {
        let first = || spellings.entry(letters(&old)).or_insert_with(|| old.clone()).clone();
        let new = known(&old).unwrap_or_else(first);
        names.insert(old, new);
    }
    for mark in marks {
        if let Some(new) = names.get(&mark.name) {
            mark.name.clone_from(new);
        }
    }
}

impl Marks {
    /// Gives marks names as [`join_names`] does.
    #[must_use]
    pub fn joined(mut self, known: impl Fn(&str) -> Option<String>) -> Self {
        join_names(&mut self.marks, known);
        Self::unchecked(self.marks)
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::{any_marks, canvas, stroke};
    use super::*;
    use proptest::prelude::*;

    const LINE: [[f32; 2]; 2] = [[8.0, 10.0], [20.0, 40.0]];

    /// Names of strokes once they are joined.
    fn joined(names: &[&str], known: impl Fn(&str) -> Option<String>) -> Vec<String> {
        let strokes = names.iter().map(|name| stroke(0, name, true, &LINE)).collect();
        Marks::new(strokes, &canvas()).unwrap().joined(known).names()
    }

    #[test]
    fn spellings_of_a_name_are_one_in_any_order() {
        let mut names = ["gallbladder", "liver", "Gall-Bladder", "GALL_BLADDER ", "livers"];
        for _ in 0..names.len() {
            names.rotate_left(1);
            assert_eq!(joined(&names, |_| None), ["gall bladder", "liver", "livers"], "{names:?}");
        }
        let known = |name: &str| name.starts_with("gall").then(|| "gallbladder".to_owned());
        assert_eq!(joined(&names, known), ["gallbladder", "liver", "livers"]);
    }

    #[test]
    fn a_mark_and_its_opposite_by_another_spelling_leave_nothing() {
        let marks = vec![stroke(0, "bile duct", true, &LINE), stroke(0, "Bileduct", false, &LINE)];
        let marks = Marks::new(marks, &canvas()).unwrap();
        assert_eq!((marks.standing().count(), marks.joined(|_| None).standing().count()), (2, 0));
    }

    proptest! {
        #[test]
        fn spellings_change_nothing_but_the_name(
            marks in any_marks(),
            spelled in proptest::collection::vec(any::<bool>(), 4),
            turn in 0usize..5,
        ) {
            let spell = |(mark, is_spelled): (&Mark, &bool)| match *is_spelled {
                true => Mark { name: mark.name.replace('i', " i"), ..mark.clone() },
                false => mark.clone(),
            };
            let other: Vec<Mark> = marks.iter().zip(&spelled).map(spell).collect();
            let mut turned = other.clone();
            turned.rotate_left(turn % marks.len());
            let digest = |marks: Vec<Mark>| Marks::unchecked(marks).joined(|_| None).digest();
            prop_assert_eq!(digest(other.clone()), digest(turned));
            let of_one_name = |mark: &Mark| Mark { name: mark.name.replace(' ', ""), ..mark.clone() };
            let joined = Marks::unchecked(other).joined(|_| None);
            let plain: Vec<Mark> = joined.all().iter().map(of_one_name).collect();
            prop_assert_eq!(Marks::unchecked(plain).digest(), Marks::unchecked(marks).digest());
        }
    }
}
