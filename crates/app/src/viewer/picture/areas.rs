//! Areas of what the prompts found on every frame, from the same scores as the pictures.
//!
//! Areas are kept for all thresholds at once: moving a threshold redraws the curve and computes nothing.

use crate::{engine::Question, viewer::state::marks::MarkList};
use std::{
    collections::{BTreeSet, HashMap},
    ops::Range,
};
use surgtpgs_core::{grid::Grid, marks::LookHere, mask::CleanUp};

/// A quantity that is counted on every frame: the area of a question. Where masks are cleaned up, the area
/// depends on the clean-up and the threshold, and is counted for that threshold alone.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(crate) struct Measure {
    pub(crate) question: Question,
    /// Clean-up of the masks, with the threshold in hundredths.
    pub(crate) cleaned: Option<(CleanUp, u8)>,
}

impl Measure {
    pub(crate) fn new(question: Question, clean_up: CleanUp, threshold: f32) -> Self {
        let cleaned = (!clean_up.is_off()).then(|| (clean_up, (threshold * 100.0).round() as u8));
        Self { question, cleaned }
    }

    /// Counts the levels of a frame from its scores. They must be smoothed already if the clean-up smooths.
    pub(crate) fn levels(&self, scores: &Grid<f32>) -> Levels {
        let Some((clean_up, hundredths)) = self.cleaned else { return Levels::of(scores) };
        let threshold = f32::from(hundredths) / 100.0;
        let cleaned = clean_up.scores(scores, threshold);
        let area = cleaned.data.iter().filter(|score| **score > threshold).count();
        Levels { above: Box::new([area as u32]), num_px: cleaned.data.len() }
    }

    /// Returns the number of frames before and after a frame that its scores are smoothed over.
    pub(crate) fn reach(&self) -> usize {
        self.cleaned.map_or(0, |(clean_up, _)| clean_up.smooth_frames)
    }
}

/// Number of possible thresholds, which are whole hundredths.
const STEPS: usize = 101;

/// Number of pixels of a frame above every possible threshold, or above the one that it was counted for.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Levels {
    above: Box<[u32]>,
    num_px: usize,
}

impl Levels {
    /// Counts the pixels of `scores`. A score that is not a number is above no threshold.
    pub(crate) fn of(scores: &Grid<f32>) -> Self {
        let thresholds: [f32; STEPS] = std::array::from_fn(|j| j as f32 / 100.0);
        // Number of thresholds that a score is above. The first estimate is off by one at most, by rounding.
        let exceeded = |score: f32| {
            let mut k = ((score * 100.0) as usize).min(STEPS);
            while k < STEPS && score > thresholds[k] {
                k += 1;
            }
            while k > 0
                && (k > STEPS || score.partial_cmp(&thresholds[k - 1]) != Some(std::cmp::Ordering::Greater))
            {
                k -= 1;
            }
            k
        };
        let mut counts = [0_u32; STEPS + 1];
        scores.data.iter().for_each(|score| counts[exceeded(*score)] += 1);
        let mut above: Box<[u32]> = Box::new([0; STEPS]);
        let mut sum = 0;
        for j in (0..STEPS).rev() {
            sum += counts[j + 1];
            above[j] = sum;
        }
        Self { above, num_px: scores.data.len() }
    }

    /// Returns the number of pixels above a threshold, which must be a whole number of hundredths.
    pub(crate) fn area_px(&self, threshold: f32) -> usize {
        self.above[((threshold * 100.0).round() as usize).min(self.above.len() - 1)] as usize
    }
}

/// Counts of one frame, for the prompts that had not been counted on it before.
#[derive(Clone, Debug)]
pub(crate) struct Measured {
    pub(crate) frame: usize,
    /// `None` where the prompt has no answer.
    pub(crate) prompts: Vec<(Measure, Option<Levels>)>,
    /// Measures whose counts are not kept any longer.
    pub(crate) forgotten: Vec<Measure>,
    /// Marks by hand that the prompts were answered with.
    pub(crate) marks: MarkList,
    /// Place where one more mark would help most; `None` without marks, and where the frame is marked.
    pub(crate) look_here: Option<LookHere>,
}

/// Number of frames above which a curve appears coarse first.
const LONG: usize = 512;
/// Distances of the frames that are counted one after the other in a long recording, and the factor to
/// further ones.
const STRIDES: [usize; 3] = [64, 8, 1];
const COARSER: usize = 8;
/// Number of frames that are counted first at most: the curve of hours shall appear in seconds, and each of
/// these frames has a chapter to be read.
const FIRST_FRAMES: usize = 32;

/// Number of counts that are kept of measures that are not asked for any longer: a prompt that is shown again
/// has its curve at once.
const KEPT_COUNTS: usize = 100_000;
/// Smallest and largest number of such measures.
const KEPT_MEASURES: [usize; 2] = [2, 32];

/// Returns the distances of the frames that are counted one after the other.
fn strides(num_frames: usize) -> Vec<usize> {
    if num_frames <= LONG {
        return vec![1];
    }
    let mut strides = STRIDES.to_vec();
    while num_frames / strides[0] > FIRST_FRAMES {
        strides.insert(0, strides[0] * COARSER);
    }
    strides
}

/// Record of the frames counted so far for each prompt, on the thread that counts.
#[derive(Debug, Default)]
pub(crate) struct Counted {
    /// Number of frames, with those that are not counted.
    num_frames: usize,
    /// Frames in the order in which they are counted.
    order: Vec<usize>,
    prompts: HashMap<Measure, Done>,
    /// Number of calls of [`Counted::forget`].
    now: u64,
}

/// Frames counted for one prompt.
#[derive(Debug)]
struct Done {
    frames: Vec<bool>,
    /// Number of frames in the order of counting before the first that is not counted.
    first_open: usize,
    /// Value of [`Counted::now`] when it was asked for last.
    asked: u64,
}

impl Counted {
    /// Makes the record of so many frames. On those that nothing reconstructs there is nothing to count.
    pub(crate) fn new(num_frames: usize, unlearned: &[Range<usize>]) -> Self {
        let strides = strides(num_frames);
        let mut order = Vec::with_capacity(num_frames);
        for (k, stride) in strides.iter().enumerate() {
            let is_new = |frame: &usize| strides[..k].iter().all(|coarser| !frame.is_multiple_of(*coarser));
            order.extend((0..num_frames).step_by(*stride).filter(is_new));
        }
        order.retain(|frame| !unlearned.iter().any(|frames| frames.contains(frame)));
        Self { num_frames, order, prompts: HashMap::new(), now: 0 }
    }

    /// Returns the first frame that has not been counted for all of `prompts`, and the prompts that it lacks.
    pub(crate) fn next(&self, prompts: &[Measure]) -> Option<(usize, Vec<Measure>)> {
        let first_open = |q: &Measure| self.prompts.get(q).map_or(0, |done| done.first_open);
        let frame = *self.order.get(prompts.iter().map(first_open).min()?)?;
        let is_counted = |q: &&Measure| self.prompts.get(*q).is_some_and(|done| done.frames[frame]);
        Some((frame, prompts.iter().filter(|q| !is_counted(q)).cloned().collect()))
    }

    pub(crate) fn note(&mut self, measured: &Measured) {
        for (measure, _) in &measured.prompts {
            let nothing = || Done { frames: vec![false; self.num_frames], first_open: 0, asked: self.now };
            let done = self.prompts.entry(measure.clone()).or_insert_with(nothing);
            if let Some(frame) = done.frames.get_mut(measured.frame) {
                *frame = true;
            }
            while self.order.get(done.first_open).is_some_and(|frame| done.frames[*frame]) {
                done.first_open += 1;
            }
        }
    }

    /// Forgets and returns all but `prompts` and those that were asked last: a threshold that moves over masks
    /// that are cleaned up leaves a measure at each of its values.
    pub(crate) fn forget(&mut self, prompts: &[Measure]) -> Vec<Measure> {
        self.now += 1;
        for measure in prompts {
            if let Some(done) = self.prompts.get_mut(measure) {
                done.asked = self.now;
            }
        }
        let [least, most] = KEPT_MEASURES;
        let kept = (KEPT_COUNTS / self.order.len().max(1)).clamp(least, most);
        let others = self.prompts.iter().filter(|(_, done)| done.asked < self.now);
        let mut others: Vec<(u64, Measure)> = others.map(|(m, done)| (done.asked, m.clone())).collect();
        others.sort_by_key(|(asked, _)| std::cmp::Reverse(*asked));
        let forgotten: Vec<Measure> = others.into_iter().skip(kept).map(|(_, measure)| measure).collect();
        forgotten.iter().for_each(|measure| drop(self.prompts.remove(measure)));
        forgotten
    }
}

/// Counts of all frames, on the thread that draws them.
#[derive(Debug, Default)]
pub(crate) struct Areas {
    num_frames: usize,
    prompts: HashMap<Measure, Counts>,
    /// Places where one more mark would help most, in the order of their frames.
    look_here: Vec<LookHere>,
}

/// Counts of all frames for one prompt.
#[derive(Debug)]
struct Counts {
    /// Levels by frame; `None` where they are not known yet, and where the prompt has no answer.
    levels: Vec<Option<Levels>>,
    /// Frames on which the prompt has no answer.
    unanswered: BTreeSet<usize>,
}

impl Areas {
    pub(crate) fn new(num_frames: usize) -> Self {
        Self { num_frames, prompts: HashMap::new(), look_here: Vec::new() }
    }

    pub(crate) fn take(&mut self, measured: Measured) {
        let found = self.look_here.binary_search_by_key(&measured.frame, |here| here.frame);
        match (found, measured.look_here) {
            (Ok(place), Some(here)) => self.look_here[place] = here,
            (Ok(place), None) => drop(self.look_here.remove(place)),
            (Err(place), Some(here)) => self.look_here.insert(place, here),
            (Err(_), None) => {}
        }
        self.prompts.retain(|measure, _| !measured.forgotten.contains(measure));
        for (measure, levels) in measured.prompts {
            let unknown = || Counts { levels: vec![None; self.num_frames], unanswered: BTreeSet::new() };
            let counts = self.prompts.entry(measure).or_insert_with(unknown);
            let Some(place) = counts.levels.get_mut(measured.frame) else { continue };
            match &levels {
                Some(_) => counts.unanswered.remove(&measured.frame),
                None => counts.unanswered.insert(measured.frame),
            };
            *place = levels;
        }
    }

    /// Returns the place on a frame where one more mark would help most, once it is known.
    pub(crate) fn look_here_on(&self, frame: usize) -> Option<&LookHere> {
        let found = self.look_here.binary_search_by_key(&frame, |here| here.frame);
        found.ok().map(|place| &self.look_here[place])
    }

    /// Returns the place of all counted frames that `count` where one more mark would help most.
    pub(crate) fn look_here(&self, counts: impl Fn(usize) -> bool) -> Option<LookHere> {
        let places: Vec<LookHere> =
            self.look_here.iter().filter(|here| counts(here.frame)).cloned().collect();
        LookHere::best(&places).cloned()
    }

    /// Returns `true` if there is such a place.
    pub(crate) fn knows_where_to_look(&self, counts: impl Fn(usize) -> bool) -> bool {
        self.look_here.iter().any(|here| counts(here.frame))
    }

    /// Returns the area of a prompt over time; `None` before the first frame was counted.
    pub(crate) fn curve(&self, measure: &Measure, threshold: f32) -> Option<Curve> {
        let counts = self.prompts.get(measure)?;
        let point = |levels: &Option<Levels>| {
            levels.as_ref().map(|l| Point { area_px: l.area_px(threshold), num_px: l.num_px })
        };
        let curve = Curve::new(counts.levels.iter().map(point).collect());
        Some(Curve { unanswered: counts.unanswered.iter().copied().collect(), ..curve })
    }
}

/// One frame of a [`Curve`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Point {
    pub(crate) area_px: usize,
    num_px: usize,
}

impl Point {
    /// Returns the share of the picture, 0–1.
    pub(crate) fn share(&self) -> f32 {
        self.area_px as f32 / self.num_px.max(1) as f32
    }
}

/// Area of a prompt over time.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Curve {
    /// Points by frame; `None` where the area is not known yet, where the frame does not count, and where the
    /// prompt has no answer.
    pub(crate) points: Vec<Option<Point>>,
    /// Frames that count and on which the prompt has no answer, in order.
    unanswered: Vec<usize>,
    /// Number of frames that count.
    num_frames: usize,
}

impl Curve {
    /// Makes a curve of which every frame counts.
    pub(crate) fn new(points: Vec<Option<Point>>) -> Self {
        Self { num_frames: points.len(), points, unanswered: Vec::new() }
    }

    /// Leaves out ranges of frames, which are in order and apart.
    pub(crate) fn without(mut self, ranges: &[(usize, usize)]) -> Self {
        let mut num_left_out = 0;
        for &(from, to) in ranges {
            for point in self.points.iter_mut().take(to.saturating_add(1)).skip(from) {
                *point = None;
                num_left_out += 1;
            }
        }
        self.num_frames = self.points.len() - num_left_out;
        self.unanswered.retain(|frame| !ranges.iter().any(|(from, to)| (*from..=*to).contains(frame)));
        self
    }

    /// Returns `true` if the prompt cannot be looked for: it has no answer on any frame that was counted.
    pub(crate) fn has_no_answer(&self) -> bool {
        !self.unanswered.is_empty() && self.num_known() == 0
    }

    /// Returns the number of frames that count and whose area is known.
    pub(crate) fn num_known(&self) -> usize {
        self.points.iter().flatten().count()
    }

    /// Returns the number of frames that count.
    pub(crate) fn num_frames(&self) -> usize {
        self.num_frames
    }

    /// Returns the number of frames on which something is found.
    pub(crate) fn num_found(&self) -> usize {
        self.found().count()
    }

    /// Returns the largest distance of two known frames that a line is drawn between: that of the frames which
    /// are counted first, until all are known.
    pub(crate) fn reach(&self) -> usize {
        if self.is_complete() { 1 } else { strides(self.points.len())[0] }
    }

    /// Returns `true` if all frames that count were counted, as far as the prompt has an answer on them.
    pub(crate) fn is_complete(&self) -> bool {
        self.num_known() + self.unanswered.len() == self.num_frames
    }

    /// Returns the first frame on which something is found.
    pub(crate) fn first(&self) -> Option<usize> {
        self.found().next().map(|(frame, _)| frame)
    }

    /// Returns the last frame on which something is found.
    pub(crate) fn last(&self) -> Option<usize> {
        self.found().last().map(|(frame, _)| frame)
    }

    /// Returns the frame with the largest area, the first of several.
    pub(crate) fn largest(&self) -> Option<usize> {
        let best = self.found().max_by_key(|(frame, p)| (p.area_px, std::cmp::Reverse(*frame)));
        best.map(|(frame, _)| frame)
    }

    /// Returns the largest share of the picture, 0–1.
    pub(crate) fn top(&self) -> f32 {
        self.found().map(|(_, p)| p.share()).fold(0.0, f32::max)
    }

    fn found(&self) -> impl DoubleEndedIterator<Item = (usize, &Point)> {
        let points = self.points.iter().enumerate().filter_map(|(frame, p)| Some((frame, p.as_ref()?)));
        points.filter(|(_, p)| p.area_px > 0)
    }
}

/// Formats the curves as a table with a header. Frames count from 1, as in the window. Numbers have a decimal
/// point in every system language.
pub(crate) fn csv<'a>(
    curves: impl Iterator<Item = (&'a str, f32, Curve)>,
    seconds: impl Fn(usize) -> f64,
) -> String {
    let mut text = String::from("frame_from_1,time_s,prompt,threshold,area_px,area_fraction\n");
    for (prompt, threshold, curve) in curves {
        let prompt = prompt.replace('"', "\"\"");
        for (frame, point) in curve.points.iter().enumerate() {
            if let Some(point) = point {
                let (time, area, share) = (seconds(frame), point.area_px, point.share());
                text += &format!("{},{time:.3},\"{prompt}\",{threshold:.2},{area},{share:.6}\n", frame + 1);
            }
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::engine::Negatives;
    use proptest::prelude::*;
    use surgtpgs_core::relevancy::RelevancySettings;

    proptest! {
        #[test]
        fn counts_are_those_of_the_mask_at_every_threshold(
            scores in proptest::collection::vec(prop_oneof![
                0.0_f32..1.0,
                (0_u8..=100).prop_map(|j| f32::from(j) / 100.0),
                Just(f32::NAN), Just(0.0), Just(1.0), Just(-1.0), Just(7.0), Just(f32::INFINITY),
            ], 0..200)
        ) {
            let levels = Levels::of(&Grid::from_vec(scores.len(), 1, scores.clone()));
            for j in 0..STEPS {
                let threshold = j as f32 / 100.0;
                let mask = scores.iter().filter(|s| **s > threshold).count();
                prop_assert_eq!(levels.area_px(threshold), mask, "above {}", threshold);
            }
        }
    }

    fn question(text: &str) -> Measure {
        let negatives = Negatives::of(&RelevancySettings::default());
        Measure::new(Question::words(text, negatives), CleanUp::default(), 0.4)
    }

    fn measured(frame: usize, area: usize) -> Measured {
        let scores = (0..10).map(|i| if i < area { 0.9 } else { 0.1 }).collect();
        let levels = Levels::of(&Grid::from_vec(10, 1, scores));
        Measured {
            frame,
            prompts: vec![(question("liver"), Some(levels))],
            forgotten: Vec::new(),
            marks: MarkList::default(),
            look_here: None,
        }
    }

    #[test]
    fn first_largest_and_last_appearance() {
        let mut areas = Areas::new(7);
        assert_eq!(areas.curve(&question("liver"), 0.4), None);
        for (frame, area) in [0, 0, 3, 6, 6, 1, 0].into_iter().enumerate() {
            assert!(!areas.curve(&question("liver"), 0.4).is_some_and(|c| c.is_complete()));
            areas.take(measured(frame, area));
        }
        areas.take(measured(99, 1));
        let curve = areas.curve(&question("liver"), 0.4).unwrap();
        assert!(curve.is_complete());
        assert_eq!(
            (curve.first(), curve.largest(), curve.last(), curve.top()),
            (Some(2), Some(3), Some(5), 0.6)
        );
        let nowhere = areas.curve(&question("liver"), 0.95).unwrap();
        assert_eq!((nowhere.first(), nowhere.largest(), nowhere.last()), (None, None, None));
    }

    #[test]
    fn frames_that_are_left_out_do_not_count() {
        let mut areas = Areas::new(7);
        for (frame, area) in [0, 9, 3, 6, 6, 1].into_iter().enumerate() {
            areas.take(measured(frame, area));
        }
        let curve = areas.curve(&question("liver"), 0.4).unwrap();
        assert!(!curve.is_complete());
        let curve = curve.without(&[(1, 3), (6, 6)]);
        assert!(curve.is_complete(), "the frame that is not known does not count");
        assert_eq!((curve.first(), curve.largest(), curve.last()), (Some(4), Some(4), Some(5)));
        assert_eq!((curve.num_found(), curve.num_frames()), (2, 3));
        assert_eq!(csv([("liver", 0.4, curve)].into_iter(), |_| 0.0).lines().count(), 4);
    }

    #[test]
    fn frames_without_an_answer_are_counted_and_have_no_area() {
        let mut areas = Areas::new(3);
        let unanswered = |frame| Measured { prompts: vec![(question("liver"), None)], ..measured(frame, 0) };
        areas.take(unanswered(0));
        let curve = |areas: &Areas| areas.curve(&question("liver"), 0.4).unwrap();
        assert!(curve(&areas).has_no_answer() && !curve(&areas).is_complete());
        areas.take(measured(1, 4));
        areas.take(unanswered(2));
        assert!(curve(&areas).is_complete() && !curve(&areas).has_no_answer());
        let shorter = curve(&areas).without(&[(2, 2)]);
        assert!(shorter.is_complete());
        assert_eq!((shorter.num_known(), shorter.num_frames()), (1, 2));
        areas.take(measured(2, 4));
        assert!(curve(&areas).is_complete());
        assert_eq!(curve(&areas).num_known(), 2);
    }

    #[test]
    fn every_frame_is_counted_once_for_every_prompt() {
        let mut counted = Counted::new(3, &[]);
        let liver = [question("liver")];
        for frame in 0..3 {
            assert_eq!(counted.next(&liver), Some((frame, liver.to_vec())));
            counted.note(&measured(frame, 1));
        }
        assert_eq!(counted.next(&liver), None);
        assert_eq!(counted.next(&[question("liver"), question("fat")]), Some((0, vec![question("fat")])));
        let mut other = question("liver");
        other.question.negatives.phrases.push("smoke".into());
        assert_eq!(
            counted.next(std::slice::from_ref(&other)),
            Some((0, vec![other])),
            "compared with something else"
        );
    }

    #[test]
    fn a_long_recording_is_counted_coarse_first_and_every_frame_once() {
        let mut counted = Counted::new(1000, &[]);
        let liver = [question("liver")];
        let mut frames = Vec::new();
        while let Some((frame, _)) = counted.next(&liver) {
            frames.push(frame);
            counted.note(&measured(frame, 1));
        }
        assert_eq!(frames[..3], [0, 64, 128]);
        assert_eq!(frames[16..19], [8, 16, 24]);
        frames.sort_unstable();
        assert!(frames.into_iter().eq(0..1000));
    }

    #[test]
    fn frames_that_nothing_reconstructs_are_not_counted() {
        let mut counted = Counted::new(6, &[0..2, 4..5]);
        let liver = [question("liver")];
        for frame in [2, 3, 5] {
            assert_eq!(counted.next(&liver), Some((frame, liver.to_vec())));
            counted.note(&measured(frame, 1));
        }
        assert_eq!(counted.next(&liver), None);
    }

    #[test]
    fn the_curve_of_hours_begins_with_few_frames() {
        assert_eq!([512, 513, 2111].map(strides), [vec![1], vec![64, 8, 1], vec![64, 8, 1]]);
        for num_frames in [2112, 50_000, 180_000, 4_000_000] {
            let strides = strides(num_frames);
            assert!(num_frames / strides[0] <= FIRST_FRAMES && strides.ends_with(&STRIDES));
            assert!(strides.windows(2).all(|pair| pair[0] == pair[1] * COARSER));
        }
        let nowhere = Curve::new(vec![None; 50_000]);
        assert_eq!(nowhere.reach(), 4096);
    }

    #[test]
    fn a_cleaned_area_is_that_of_the_cleaned_mask() {
        let clean_up = CleanUp { min_area_px: 2, ..Default::default() };
        let measure = Measure::new(question("liver").question, clean_up, 0.4);
        let scores = Grid::from_vec(5, 1, vec![0.9, 0.1, 0.9, 0.9, 0.1]);
        assert_eq!((measure.levels(&scores).area_px(0.4), measure.levels(&scores).above.len()), (2, 1));
        assert_eq!(question("liver").levels(&scores).area_px(0.4), 3);
    }

    #[test]
    fn thresholds_that_were_passed_are_forgotten_but_for_the_last() {
        let clean_up = CleanUp { min_area_px: 2, ..Default::default() };
        let at = |step: u8| Measure::new(question("liver").question, clean_up, f32::from(step) / 100.0);
        let num_frames = KEPT_COUNTS / 3;
        let (mut counted, mut areas) = (Counted::new(num_frames, &[]), Areas::new(num_frames));
        let always = question("fat");
        for step in 0..9 {
            let asked = [at(step), always.clone()];
            let (frame, new) = counted.next(&asked).unwrap();
            let levels = || Some(Levels::of(&Grid::from_vec(1, 1, vec![0.9])));
            let prompts = new.into_iter().map(|measure| (measure, levels())).collect();
            let mut counts = Measured { prompts, ..measured(frame, 0) };
            counted.note(&counts);
            counts.forgotten = counted.forget(&asked);
            areas.take(counts);
        }
        let kept =
            |measure: &Measure| (counted.prompts.contains_key(measure), areas.prompts.contains_key(measure));
        assert!((0..5).all(|step| kept(&at(step)) == (false, false)));
        assert!((5..9).all(|step| kept(&at(step)) == (true, true)) && kept(&always) == (true, true));
        assert_eq!(counted.next(&[at(0)]), Some((0, vec![at(0)])), "counted anew");
    }

    #[test]
    fn the_table_is_the_curve() {
        let mut areas = Areas::new(2);
        areas.take(measured(1, 3));
        let curve = areas.curve(&question("liver"), 0.4).unwrap();
        let table = csv([("a \"quoted\" liver", 0.4, curve)].into_iter(), |f| f as f64 / 25.0);
        let expected = "frame_from_1,time_s,prompt,threshold,area_px,area_fraction\n\
                        2,0.040,\"a \"\"quoted\"\" liver\",0.40,3,0.300000\n";
        assert_eq!(table, expected);
    }
}
