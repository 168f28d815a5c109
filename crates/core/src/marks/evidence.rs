//! Verdicts of the marks on a frame, pixel by pixel.

use super::{Mark, Marks};
use crate::scene::Scene;
use rayon::prelude::*;
use std::{
    collections::{BTreeMap, BTreeSet},
    ops::Range,
};

/// Evidence of the marks on one frame. It is kept as runs, so that masks on hundreds of frames take little
/// memory.
#[derive(Clone, Debug, PartialEq)]
pub struct Evidence {
    /// The frame.
    pub frame: usize,
    num_names: usize,
    /// Runs of pixels of which the marks say the same, one after the other over the whole picture.
    runs: Vec<Run>,
    /// Distinct verdicts in the order of their first runs, [places][names].
    verdicts: Vec<i8>,
}

/// Pixels from the end of the run before to `end`.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Run {
    end: usize,
    /// Place of its verdicts.
    place: usize,
}

/// Verdicts of the marks on a pixel, for each name: 1 for names that it shows, −1 for names that it does not,
/// 0 where the marks say nothing or as much for as against, and for names that leave it to a smaller mark.
#[derive(Clone, Copy)]
pub(super) struct Verdicts<'a>(&'a [i8]);

impl Verdicts<'_> {
    /// Returns the weight (0 or 1) and the share (0–1) of name `k`. A pixel that shows some names is shared by
    /// them, and shows no other.
    pub(super) fn of(self, k: usize) -> (f32, f32) {
        let shown = self.0.iter().filter(|verdict| **verdict > 0).count();
        match (self.0[k], shown) {
            (1, shown) => (1.0, 1.0 / shown as f32),
            (_, 1..) | (-1, 0) => (1.0, 0.0),
            _ => (0.0, 0.0),
        }
    }

    /// Returns the first name that is shown.
    fn shown(self) -> Option<usize> {
        self.all_shown().next()
    }

    /// Returns all names that are shown.
    fn all_shown(self) -> impl Iterator<Item = usize> {
        (0..self.0.len()).filter(move |k| self.0[*k] > 0)
    }

    /// Returns `true` if the marks say nothing.
    fn is_nothing(self) -> bool {
        self.0.iter().all(|verdict| *verdict == 0)
    }

    /// Returns `true` if marks deny some names, and leave the pixel to the others.
    fn denies_some(self) -> bool {
        !self.is_nothing() && !self.decides()
    }

    /// Returns `true` if the label is decided: marks show a name, or deny every name.
    fn decides(self) -> bool {
        self.shown().is_some() || self.0.iter().all(|verdict| *verdict < 0)
    }
}

impl Evidence {
    /// Sums up the marks on a frame. `names` are those that count, in the order of the verdicts. A pixel that
    /// is marked as several names belongs to the one whose mark lies inside of the others, or to all of them.
    pub fn of(marks: &Marks, frame: usize, names: &[String], size: [usize; 2]) -> Self {
        let (num_names, num_pixels) = (names.len(), size[0] * size[1]);
        let place = |mark: &Mark| names.iter().position(|name| *name == mark.name);
        let placed: Vec<Placed> =
            marks.on(frame).filter_map(|mark| Some(Placed::new(place(mark)?, mark, size))).collect();
        let is_inner = are_inner(&placed, num_names, num_pixels);
        let mut evidence = Self::none(frame, num_names);
        let mut verdicts = vec![0; num_names];
        sweep(&placed, num_names, num_pixels, |pixels, here, votes| {
            verdicts.iter_mut().zip(votes).for_each(|(verdict, vote)| *verdict = vote.signum() as i8);
            let inner = here.iter().filter(|m| is_inner[**m] && placed[**m].shows(votes));
            leave_to_smallest(&mut verdicts, &inner.map(|m| &placed[*m]).collect::<Vec<_>>());
            evidence.push(pixels.end, &verdicts);
        });
        evidence
    }

    /// Sums up all marks, by frame: those frames on which they say something.
    pub(super) fn of_all(marks: &Marks, names: &[String], scene: &Scene) -> BTreeMap<usize, Self> {
        let size = scene.cameras.first().map_or([0; 2], |c| [c.width as usize, c.height as usize]);
        let of = |frame| (frame, Self::of(marks, frame, names, size));
        marks.frames().into_par_iter().map(of).filter(|(_, evidence)| !evidence.is_empty()).collect()
    }

    /// Sums up the marks that grow to whole structures, by frame: clicks and strokes. Outlines decide
    /// their own pixels alone, but for names that no click or stroke shows.
    /// `all` is the evidence of all marks. Returns the frames, too, on which clicks or strokes say something.
    pub(super) fn of_growing(
        marks: &Marks,
        all: &BTreeMap<usize, Self>,
        names: &[String],
        scene: &Scene,
    ) -> (BTreeMap<usize, Self>, BTreeSet<usize>) {
        if !marks.all().iter().any(|mark| mark.shape.is_outlined()) {
            return (all.clone(), all.keys().copied().collect());
        }
        let pointed = Self::of_all(&marks.filtered(|mark| !mark.shape.is_outlined()), names, scene);
        let is_pointed_at = |k: usize| pointed.values().any(|evidence| evidence.shows(k));
        let outlined: Vec<&String> =
            names.iter().enumerate().filter(|(k, _)| !is_pointed_at(*k)).map(|(_, name)| name).collect();
        let grows = |mark: &Mark| !mark.shape.is_outlined() || outlined.contains(&&mark.name);
        let growing = Self::of_all(&marks.filtered(grows), names, scene);
        let agreed = |(frame, own): (usize, Self)| Some((frame, own.agreeing_with(all.get(&frame)?)));
        let growing = growing.into_iter().filter_map(agreed).filter(|(_, evidence)| !evidence.is_empty());
        (growing.collect(), pointed.into_keys().collect())
    }

    /// Returns evidence of no pixel yet.
    fn none(frame: usize, num_names: usize) -> Self {
        Self { frame, num_names, runs: Vec::new(), verdicts: Vec::new() }
    }

    /// Adds the verdicts of the pixels up to `end`.
    fn push(&mut self, end: usize, verdicts: &[i8]) {
        let says = |place: usize| self.verdicts_at(place).0 == verdicts;
        let goes_on = self.runs.last().is_some_and(|last| says(last.place));
        if let Some(last) = self.runs.last_mut().filter(|_| goes_on) {
            last.end = end;
            return;
        }
        let places = self.verdicts.len() / self.num_names.max(1);
        let place = (0..places).find(|place| self.verdicts_at(*place).0 == verdicts).unwrap_or(places);
        if place == places {
            self.verdicts.extend(verdicts);
        }
        self.runs.push(Run { end, place });
    }

    fn verdicts_at(&self, place: usize) -> Verdicts<'_> {
        Verdicts(&self.verdicts[place * self.num_names..(place + 1) * self.num_names])
    }

    /// Returns all runs of pixels of which the marks say the same, with what they say.
    pub(super) fn runs(&self) -> impl Iterator<Item = (Range<usize>, Verdicts<'_>)> {
        let starts = std::iter::once(0).chain(self.runs.iter().map(|run| run.end));
        starts.zip(&self.runs).map(|(start, run)| (start..run.end, self.verdicts_at(run.place)))
    }

    /// Returns the runs of pixels that show a name, with the first one that they show.
    pub(crate) fn shown(&self) -> impl Iterator<Item = (Range<usize>, usize)> {
        self.runs().filter_map(|(pixels, verdicts)| Some((pixels, verdicts.shown()?)))
    }

    /// Returns the runs of pixels that show names, with all names that they show, ascending.
    pub(crate) fn all_shown(&self) -> impl Iterator<Item = (Range<usize>, Vec<usize>)> {
        let each = self.runs().map(|(pixels, verdicts)| (pixels, verdicts.all_shown().collect::<Vec<_>>()));
        each.filter(|(_, names)| !names.is_empty())
    }

    /// Returns the runs of pixels that the marks say something of.
    pub(super) fn said(&self) -> impl Iterator<Item = (Range<usize>, Verdicts<'_>)> {
        self.runs().filter(|(_, verdicts)| !verdicts.is_nothing())
    }

    /// Returns those verdicts that others share: an outline can erase a stroke. Both are of the same picture.
    fn agreeing_with(&self, other: &Self) -> Self {
        let mut agreed = Self::none(self.frame, self.num_names);
        let mut others = other.runs().peekable();
        for (pixels, own) in self.runs() {
            while let Some((other_pixels, other)) = others.peek() {
                let end = other_pixels.end.min(pixels.end);
                let shared = |(a, b): (&i8, &i8)| if a == b { *a } else { 0 };
                agreed.push(end, &own.0.iter().zip(other.0).map(shared).collect::<Vec<i8>>());
                if other_pixels.end == end {
                    others.next();
                }
                if pixels.end == end {
                    break;
                }
            }
        }
        agreed
    }

    /// Returns what is said of name `k` alone. Pixels that show other names do not show it.
    pub(super) fn alone(&self, k: usize) -> Self {
        let mut alone = Self::none(self.frame, 1);
        for (pixels, verdicts) in self.runs() {
            let verdict = match verdicts.of(k) {
                (0.0, _) => 0,
                (_, 0.0) => -1,
                _ => 1,
            };
            alone.push(pixels.end, &[verdict]);
        }
        alone
    }

    /// Returns the evidence without what is said of pixels of which marks deny some names alone; `None` if
    /// there are no such pixels.
    pub(super) fn without_denials(&self) -> Option<Self> {
        self.runs().any(|(_, verdicts)| verdicts.denies_some()).then(|| {
            let mut open = Self::none(self.frame, self.num_names);
            let nothing = vec![0; self.num_names];
            for (pixels, verdicts) in self.runs() {
                open.push(pixels.end, if verdicts.denies_some() { &nothing } else { verdicts.0 });
            }
            open
        })
    }

    /// Returns `true` if some pixel shows name `k`.
    pub(super) fn shows(&self, k: usize) -> bool {
        self.verdicts.iter().skip(k).step_by(self.num_names).any(|verdict| *verdict > 0)
    }

    /// Returns `true` if the marks say nothing of any pixel.
    pub(super) fn is_empty(&self) -> bool {
        self.verdicts.iter().all(|v| *v == 0)
    }

    /// Returns the pixels whose label is decided: marks show a name there, or deny every name.
    pub(super) fn decided(&self) -> impl Iterator<Item = usize> {
        self.runs().filter(|(_, verdicts)| verdicts.decides()).flat_map(|(pixels, _)| pixels)
    }

    /// Returns weight and share planes of some names: [names][pixels] each.
    pub(super) fn planes(&self, names: Range<usize>) -> (Vec<f32>, Vec<f32>) {
        let plane = |k: usize| {
            let each = self.runs().map(|(pixels, verdicts)| (pixels.len(), verdicts.of(k)));
            each.flat_map(|(count, said)| std::iter::repeat_n(said, count))
                .unzip::<f32, f32, Vec<_>, Vec<_>>()
        };
        let planes: Vec<(Vec<f32>, Vec<f32>)> = names.into_par_iter().map(plane).collect();
        let (weights, shares): (Vec<_>, Vec<_>) = planes.into_iter().unzip();
        (weights.concat(), shares.concat())
    }
}

/// A mark of a name that counts, on a picture.
struct Placed {
    /// Place of the name.
    name: usize,
    /// 1 if it shows the name, −1 if it denies it.
    vote: i32,
    /// Its pixels, as runs that do not touch, ascending.
    runs: Vec<Range<usize>>,
    /// Number of its pixels.
    area: usize,
}

impl Placed {
    fn new(name: usize, mark: &Mark, [width, height]: [usize; 2]) -> Self {
        let mask = mark.shape.pixels(width, height);
        let (mut runs, mut start, mut area) = (Vec::new(), 0, 0);
        for run in mask.data.chunk_by(|a, b| a == b) {
            let end = start + run.len();
            if run[0] {
                runs.push(start..end);
                area += run.len();
            }
            start = end;
        }
        Self { name, vote: if mark.add { 1 } else { -1 }, runs, area }
    }

    /// Returns `true` if pixels of the mark with these votes show its name.
    fn shows(&self, votes: &[i32]) -> bool {
        self.vote > 0 && votes[self.name] > 0
    }
}

/// Visits the runs of pixels in which the same marks lie, one after the other over the whole picture, with
/// the places of these marks and the sum of their votes for each name. So no vote is kept for each pixel and
/// name: there may be thousands of names.
fn sweep(
    placed: &[Placed],
    num_names: usize,
    num_pixels: usize,
    mut visit: impl FnMut(Range<usize>, &[usize], &[i32]),
) {
    let borders = |(m, mark): (usize, &Placed)| -> Vec<(usize, usize)> {
        mark.runs.iter().flat_map(|run| [(run.start, m), (run.end, m)]).collect()
    };
    let mut borders: Vec<(usize, usize)> = placed.iter().enumerate().flat_map(borders).collect();
    borders.sort_unstable();
    let (mut start, mut here, mut votes) = (0, Vec::new(), vec![0; num_names]);
    for (at, m) in borders {
        if start < at {
            visit(start..at, &here, &votes);
            start = at;
        }
        let Placed { name, vote, .. } = &placed[m];
        match here.iter().position(|other| *other == m) {
            Some(place) => {
                here.swap_remove(place);
                votes[*name] -= vote;
            }
            None => {
                here.push(m);
                votes[*name] += vote;
            }
        }
    }
    if start < num_pixels {
        visit(start..num_pixels, &here, &votes);
    }
}

/// Returns for each mark if it lies inside of others: if more than three quarters of its pixels show other
/// names, too. Outlines that merely overlap share their pixels.
fn are_inner(placed: &[Placed], num_names: usize, num_pixels: usize) -> Vec<bool> {
    let mut contested = vec![0; placed.len()];
    sweep(placed, num_names, num_pixels, |pixels, here, votes| {
        if votes.iter().filter(|vote| **vote > 0).count() > 1 {
            let shown = here.iter().filter(|m| placed[**m].shows(votes));
            shown.for_each(|m| contested[*m] += pixels.len());
        }
    });
    placed.iter().zip(contested).map(|(mark, contested)| 4 * contested > 3 * mark.area).collect()
}

/// Leaves a pixel to the smallest of the inner marks that show their names there, if there are any.
fn leave_to_smallest(verdicts: &mut [i8], inner: &[&Placed]) {
    let Some(least) = inner.iter().map(|mark| mark.area).min() else { return };
    verdicts.iter_mut().for_each(|verdict| *verdict = (*verdict).min(0));
    inner.iter().filter(|mark| mark.area == least).for_each(|mark| verdicts[mark.name] = 1);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::annotations::Shape;
    use proptest::prelude::*;

    /// A box on frame 3 from one corner to another one.
    fn square(name: &str, add: bool, low: f32, high: f32) -> Mark {
        Mark::new(3, name, add, Shape::Box { corners_px: [[low, low], [high, high]] })
    }

    /// Verdicts of marks at pixels on the diagonal of 8×8, of fat and liver.
    fn on_diagonal(marks: Vec<Mark>, at: &[usize]) -> Vec<Vec<i8>> {
        let names = ["fat", "liver"].map(str::to_owned);
        let said = dense(&Evidence::of(&Marks::unchecked(marks), 3, &names, [8, 8]));
        at.iter().map(|at| said[at * 9].clone()).collect()
    }

    #[test]
    fn a_pixel_belongs_to_the_smallest_inner_mark_in_any_order() {
        let mut marks = vec![
            square("liver", true, 0.0, 8.0),
            square("fat", true, 2.0, 5.0),
            square("liver", true, 4.0, 5.0),
            square("fat", false, 6.0, 7.0),
        ];
        let expected = [[0, 1], [1, 0], [0, 1], [-1, 1]];
        assert_eq!(on_diagonal(marks.clone(), &[0, 3, 4, 6]), expected);
        marks.reverse();
        assert_eq!(on_diagonal(marks, &[0, 3, 4, 6]), expected);
    }

    #[test]
    fn marks_that_overlap_or_are_the_same_share_pixels() {
        let beside = vec![square("liver", true, 2.0, 5.0), square("fat", true, 4.0, 8.0)];
        assert_eq!(on_diagonal(beside.clone(), &[2, 4, 7]), [[0, 1], [1, 1], [1, 0]]);
        let same = vec![square("liver", true, 2.0, 5.0), square("fat", true, 2.0, 5.0)];
        assert_eq!(on_diagonal(same, &[2, 5]), [[1, 1], [0, 0]]);
        let names = ["fat", "liver"].map(str::to_owned);
        let evidence = Evidence::of(&Marks::unchecked(beside), 3, &names, [8, 8]);
        let shared: Vec<_> = evidence.all_shown().filter(|(_, shown)| shown.len() > 1).collect();
        assert_eq!(shared, [(36..37, vec![0, 1])]);
    }

    /// A mark on 8×8 pixels: place of its name, `true` if it shows it, and its pixels.
    type Marked = (usize, bool, Vec<bool>);

    /// Returns the verdicts at each pixel of 8×8 on frame 3, by the definition.
    fn by_definition(marks: &Marks, names: &[String]) -> Vec<Vec<i8>> {
        let place = |mark: &Mark| names.iter().position(|name| *name == mark.name).unwrap();
        let placed: Vec<Marked> =
            marks.on(3).map(|mark| (place(mark), mark.add, mark.shape.pixels(8, 8).data)).collect();
        let votes = |i: usize, k: usize| -> i32 {
            let here = placed.iter().filter(|(name, _, pixels)| *name == k && pixels[i]);
            here.map(|(_, add, _)| if *add { 1 } else { -1 }).sum()
        };
        let is_contested = |i: usize| (0..names.len()).filter(|k| votes(i, *k) > 0).count() > 1;
        let is_shared =
            |mark: &Marked, i: usize| mark.1 && mark.2[i] && votes(i, mark.0) > 0 && is_contested(i);
        let area = |mark: &Marked| mark.2.iter().filter(|is_marked| **is_marked).count();
        let is_inner = |mark: &Marked| 4 * (0..64).filter(|i| is_shared(mark, *i)).count() > 3 * area(mark);
        let inner: Vec<&Marked> = placed.iter().filter(|mark| is_inner(mark)).collect();
        let verdicts = |i: usize| -> Vec<i8> {
            let here: Vec<&Marked> = inner.iter().copied().filter(|mark| is_shared(mark, i)).collect();
            let least = here.iter().map(|mark| area(mark)).min();
            let is_left = |k: usize| here.iter().any(|mark| mark.0 == k && Some(area(mark)) == least);
            let verdict = |k: usize| match least {
                None => votes(i, k).signum() as i8,
                Some(_) if is_left(k) => 1,
                Some(_) => votes(i, k).signum().min(0) as i8,
            };
            (0..names.len()).map(verdict).collect()
        };
        (0..64).map(verdicts).collect()
    }

    #[test]
    fn names_take_no_memory_at_each_pixel() {
        let names: Vec<String> = (0..4000).map(|k| format!("name {k:04}")).collect();
        let marks = [square(&names[7], true, 10.0, 20.0), square(&names[3999], true, 15.0, 30.0)];
        let evidence = Evidence::of(&Marks::unchecked(marks.to_vec()), 3, &names, [2000, 1000]);
        let shown: Vec<Vec<usize>> = evidence.all_shown().map(|(_, shown)| shown).collect();
        for expected in [&[7][..], &[7, 3999], &[3999]] {
            assert!(shown.iter().any(|shown| shown == expected), "{expected:?}");
        }
        assert_eq!(evidence.verdicts.len(), 4 * names.len(), "nothing, one, both, the other");
    }

    /// Verdicts of a few pixels, [pixels][2], as runs.
    fn evidence(verdicts: &[[i8; 2]]) -> Evidence {
        let mut evidence = Evidence::none(3, 2);
        verdicts.iter().enumerate().for_each(|(i, verdicts)| evidence.push(i + 1, verdicts));
        evidence
    }

    fn dense(evidence: &Evidence) -> Vec<Vec<i8>> {
        evidence.runs().flat_map(|(pixels, verdicts)| pixels.map(move |_| verdicts.0.to_vec())).collect()
    }

    #[test]
    fn pixels_that_show_two_names_are_shared() {
        let both = evidence(&[[1, 1], [1, 0], [-1, 0], [0, 0], [-1, -1]]);
        let said: Vec<[(f32, f32); 2]> =
            both.runs().map(|(_, verdicts)| [0, 1].map(|k| verdicts.of(k))).collect();
        let expected = [[(1.0, 0.5); 2], [(1.0, 1.0), (1.0, 0.0)], [(1.0, 0.0), (0.0, 0.0)], [(0.0, 0.0); 2]];
        assert_eq!(said[..4], expected);
        assert_eq!(said[4], [(1.0, 0.0); 2]);
        assert_eq!(both.decided().collect::<Vec<_>>(), [0, 1, 4]);
        assert_eq!(both.said().map(|(pixels, _)| pixels.len()).sum::<usize>(), 4);
        assert_eq!(dense(&both.alone(1)), [[1], [-1], [0], [0], [-1]]);
        let open = both.without_denials().unwrap();
        assert_eq!(dense(&open), [[1, 1], [1, 0], [0, 0], [0, 0], [-1, -1]]);
        assert_eq!(open.without_denials(), None);
    }

    #[test]
    fn masks_take_no_memory_for_each_pixel() {
        let one = [1, -1];
        let all = evidence(&[one; 5000]);
        assert_eq!((all.runs.len(), all.verdicts.len()), (1, 2));
        let (weights, shares) = all.planes(0..2);
        assert!(
            weights == vec![1.0; 10_000]
                && shares[..5000] == vec![1.0; 5000]
                && shares[5000..] == vec![0.0; 5000]
        );
    }

    proptest! {
        #[test]
        fn pixels_say_what_their_marks_say(
            boxes in proptest::collection::vec(
                (0_usize..3, any::<bool>(), [0_u8..8, 0..8], [1_u8..9, 1..9]),
                1..7,
            ),
        ) {
            let names = ["fat", "liver", "vein"].map(str::to_owned);
            let mark = |(k, add, low, size): &(usize, bool, [u8; 2], [u8; 2])| {
                let high = [0, 1].map(|side| f32::from((low[side] + size[side]).min(8)));
                let shape = Shape::Box { corners_px: [low.map(f32::from), high] };
                Mark::new(3, &names[*k], *add, shape)
            };
            let marks = Marks::unchecked(boxes.iter().map(mark).collect());
            let found = dense(&Evidence::of(&marks, 3, &names, [8, 8]));
            prop_assert_eq!(found, by_definition(&marks, &names));
        }

        #[test]
        fn runs_say_what_pixels_say(
            pixels in proptest::collection::vec((-1_i8..2, -1_i8..2, -1_i8..2, -1_i8..2), 1..40),
        ) {
            let [own, other] = [0, 1].map(|part| -> Vec<[i8; 2]> {
                pixels.iter().map(|(a, b, c, d)| if part == 0 { [*a, *b] } else { [*c, *d] }).collect()
            });
            let (own, other) = (evidence(&own), evidence(&other));
            let expected: Vec<Vec<i8>> = pixels
                .iter()
                .map(|(a, b, c, d)| vec![if a == c { *a } else { 0 }, if b == d { *b } else { 0 }])
                .collect();
            let agreed = own.agreeing_with(&other);
            prop_assert_eq!(dense(&agreed), expected.clone());
            prop_assert_eq!(agreed.is_empty(), expected.iter().flatten().all(|verdict| *verdict == 0));
            for k in 0..2 {
                prop_assert_eq!(own.shows(k), dense(&own).iter().any(|verdicts| verdicts[k] > 0));
            }
        }
    }
}
