//! Times at which the frames of a recording were taken.
//!
//! Conversion to another frame rate repeats frames. A repeated frame shows what the one before shows, so both
//! get one time. Nothing is read of frames that are held out: the period of the others tells if these are
//! repeated, if there is a period.

use super::Sequence;
use crate::{
    Result,
    num::median,
    progress::{Observer, Progress},
};
use image::RgbImage;
use std::ops::Range;

/// Number of samples of a picture that are compared.
const SAMPLES: usize = 1 << 14;
/// Share of the usual difference between different neighbouring frames below which a frame repeats the one
/// before.
const REPEAT_SHARE: f32 = 0.1;
/// Difference, in 8-bit levels, below which frames may be the same, or the recording stands still.
const STILL: f32 = 0.3;
/// Share of frames that differ from the one before, below which a recording is too still to tell.
const LEAST_DIFFERENT: f32 = 0.15;
/// Number of frames on one side that tell what difference is usual; and the fewest of them that tell it.
const AROUND: usize = 48;
const FEWEST_AROUND: usize = 12;
/// Smallest number of repeated frames that make a period, and of times that it comes.
const FEWEST_REPEATS: usize = 3;
/// Number of frames that are read in parallel; no more are in memory.
const BATCH: usize = 64;
/// Longest time between two frames that counts as it is, as a multiple of the usual one: a pause of the
/// recording is no time in which tissue could be followed.
const LONGEST_STEP: f64 = 4.0;
/// Longest period, in frames.
const LONGEST_PERIOD: usize = 60;

/// Samples of a picture, enough to tell if another one is the same.
pub(super) struct Glance(Vec<u8>);

impl Glance {
    pub(super) fn of(picture: &RgbImage) -> Self {
        let bytes = picture.as_raw();
        // Odd and no multiple of three, so that every colour and column has its turn.
        let odd = (bytes.len() / SAMPLES) | 1;
        let step = if odd.is_multiple_of(3) { odd + 2 } else { odd };
        Self(bytes.iter().step_by(step).copied().collect())
    }

    /// Returns the mean difference in 8-bit levels; `None` if the pictures differ in size or are empty.
    pub(super) fn difference(&self, other: &Self) -> Option<f32> {
        let sum: u32 = self.0.iter().zip(&other.0).map(|(a, b)| u32::from(a.abs_diff(*b))).sum();
        (self.0.len() == other.0.len() && !self.0.is_empty()).then(|| sum as f32 / self.0.len() as f32)
    }
}

/// Returns the mean difference of each frame from the one of `frames` before it, in 8-bit levels; `None` for
/// the first one and for others than `frames`, which are in ascending order. No others are read.
///
/// # Errors
/// A frame that cannot be read, or the observer's wish to stop.
pub(crate) fn differences(
    sequence: &Sequence,
    frames: &[usize],
    observer: &mut Observer<'_>,
) -> Result<Vec<Option<f32>>> {
    let glance = |i: usize, frame: Result<RgbImage>| Ok((i, Glance::of(&frame?)));
    let mut differences = vec![None; sequence.num_frames()];
    let mut last: Option<Glance> = None;
    for (k, batch) in frames.chunks(BATCH).enumerate() {
        Progress::new("looking at the frames", k * BATCH, frames.len()).tell(observer)?;
        for (i, glance) in sequence.map_frames(batch, glance).into_iter().collect::<Result<Vec<_>>>()? {
            differences[i] = last.as_ref().and_then(|before| before.difference(&glance));
            last = Some(glance);
        }
    }
    Ok(differences)
}

/// Returns the time of every frame, 0 to 1, from the [`differences`] of `frames` and from the seconds of all
/// frames, if they are not evenly spaced.
pub(crate) fn frame_times(differences: &[Option<f32>], frames: &[usize], seconds: &[f64]) -> Vec<f32> {
    let mut from_next = vec![None; differences.len()];
    for pair in frames.windows(2).filter(|pair| pair[0] + 1 == pair[1]) {
        from_next[pair[1]] = differences[pair[1]];
    }
    times(&repeats(&from_next), seconds)
}

/// Returns for every frame if it repeats the one before, from their mean differences in 8-bit levels; `None`
/// where it is not known, and for the first frame.
///
/// Half of the frames or more may be repeats, and a recording has slow parts, so that the usual difference is
/// that of frames that differ, on the slower side of each frame.
pub(super) fn repeats(differences: &[Option<f32>]) -> Vec<bool> {
    let different = |frames: Range<usize>| -> Vec<f64> {
        let known = differences[frames].iter().flatten().filter(|d| **d >= STILL);
        known.map(|d| f64::from(*d)).collect()
    };
    let n = differences.len();
    let mut all = different(0..n);
    if (all.len() as f32) < LEAST_DIFFERENT * differences.iter().flatten().count().max(1) as f32 {
        return vec![false; n];
    }
    let usual = median(&mut all).unwrap_or(0.0);
    let usual_beside = |side: Range<usize>| {
        let num_known = differences[side.clone()].iter().flatten().count();
        let mut beside = different(side);
        // Where a recording is frozen, frames are the same to the last level.
        let is_frozen = (beside.len() as f32) < LEAST_DIFFERENT * num_known as f32;
        let usual = if is_frozen { Some(f64::from(STILL)) } else { median(&mut beside) };
        usual.filter(|_| num_known >= FEWEST_AROUND)
    };
    let is_repeat = |i: usize, difference: f32| {
        let sides = [i.saturating_sub(AROUND)..i, i + 1..(i + 1 + AROUND).min(n)];
        let known = sides.into_iter().filter_map(usual_beside).reduce(f64::min);
        f64::from(difference) < f64::from(REPEAT_SHARE) * known.unwrap_or(usual)
    };
    let seen: Vec<Option<bool>> =
        differences.iter().enumerate().map(|(i, d)| d.map(|d| is_repeat(i, d))).collect();
    let period = period(&seen);
    let expected = |i: usize| i > 0 && period.as_ref().is_some_and(|period| period[i % period.len()]);
    seen.iter().enumerate().map(|(i, seen)| seen.unwrap_or_else(|| expected(i))).collect()
}

/// Returns the shortest period that all frames keep to: which of its frames repeat the one before.
fn period(seen: &[Option<bool>]) -> Option<Vec<bool>> {
    if seen.iter().filter(|seen| **seen == Some(true)).count() < FEWEST_REPEATS {
        return None;
    }
    let of_length = |length: usize| {
        let mut period = vec![None; length];
        for (i, seen) in seen.iter().enumerate().filter_map(|(i, seen)| Some((i, (*seen)?))) {
            if *period[i % length].get_or_insert(seen) != seen {
                return None;
            }
        }
        Some(period.into_iter().map(|repeats| repeats.unwrap_or(false)).collect())
    };
    // A period has to come several times, or anything would keep to it.
    let longest = LONGEST_PERIOD.min(seen.len() / FEWEST_REPEATS);
    (2..=longest).find_map(of_length)
}

/// Returns the place of every frame, 0 to 1, from the seconds of frames that are not evenly spaced.
pub(super) fn places(seconds: &[f64]) -> Vec<f32> {
    times(&vec![false; seconds.len()], seconds)
}

/// Returns the time of every frame: the number of different pictures before it, by their number in all.
/// Without repeats it is i / N. If there are `seconds` of frames, a step between two is as long as they say.
fn times(repeats: &[bool], seconds: &[f64]) -> Vec<f32> {
    let between = |i: usize| Some(seconds.get(i)? - seconds.get(i - 1)?);
    let mut known: Vec<f64> = (1..repeats.len()).filter_map(between).filter(|step| *step > 0.0).collect();
    let usual = median(&mut known).unwrap_or(1.0);
    let step = |i: usize| between(i).map_or(1.0, |step| (step / usual).min(LONGEST_STEP));
    let mut at = 0.0;
    let places = repeats.iter().enumerate().map(|(i, repeats)| {
        at += if i == 0 || *repeats { 0.0 } else { step(i) };
        at
    });
    let places: Vec<f64> = places.collect();
    let whole = places.last().map_or(1.0, |last| last + 1.0);
    places.into_iter().map(|place| (place / whole) as f32).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_that_may_not_be_read_are_told_by_the_period() {
        let difference = |i: usize| match i {
            0 => None,
            i if i % 8 == 1 || i % 8 == 2 => None,
            i if i % 6 == 0 => Some(0.02),
            i => Some(5.0 + (i % 3) as f32),
        };
        let differences: Vec<_> = (0..48).map(difference).collect();
        let found = repeats(&differences);
        assert!((0..48).all(|i| found[i] == (i > 0 && i % 6 == 0)), "{found:?}");
        let times = times(&found, &[]);
        assert_eq!((times[17], times[5]), (times[18], times[6]));
        assert!((times[47] - 40.0 / 41.0).abs() < 1e-6 && times[0] == 0.0);
    }

    #[test]
    fn doubled_and_tripled_frames_are_repeats_and_slow_parts_are_none() {
        for (n, copies) in [(78, 2), (96, 2), (60, 3), (97, 3)] {
            // As with `--eval`: a frame and the one after it are not known.
            let difference = |i: usize| {
                (i % 8 > 1 + usize::from(i < 8)).then(|| if i.is_multiple_of(copies) { 6.0 } else { 0.1 })
            };
            let found = repeats(&(0..n).map(difference).collect::<Vec<_>>());
            assert!(
                (1..n).all(|i| found[i] != i.is_multiple_of(copies)),
                "{n} frames, {copies} copies: {found:?}"
            );
        }
        let slow = |i: usize| if (60..160).contains(&i) { 0.5 } else { 8.0 };
        assert!(!repeats(&(0..220).map(|i| Some(slow(i))).collect::<Vec<_>>()).contains(&true));
        let frozen = |i: usize| if (60..160).contains(&i) { 0.0 } else { 8.0 };
        let found = repeats(&(0..220).map(|i| Some(frozen(i))).collect::<Vec<_>>());
        assert!((0..220).all(|i| found[i] == (60..160).contains(&i)));
        assert_eq!(repeats(&[None, Some(4.0), Some(5.0)]), [false; 3], "too few to tell");
    }

    #[test]
    fn pictures_are_the_same_or_not() {
        let picture = |seed: u32| {
            RgbImage::from_fn(70, 50, |x, y| image::Rgb([(x * 3 + seed) as u8, (y * 5) as u8, (x ^ y) as u8]))
        };
        let [a, b, small] = [picture(0), picture(9), RgbImage::new(2, 2)].map(|p| Glance::of(&p));
        assert_eq!(a.difference(&Glance::of(&picture(0))), Some(0.0));
        assert!(a.difference(&b).is_some_and(|d| d > 2.0));
        assert_eq!((a.difference(&small), small.difference(&small)), (None, Some(0.0)));
    }

    #[test]
    fn what_has_no_period_is_not_guessed() {
        let mut differences = vec![Some(4.0); 40];
        for i in [5, 12, 30] {
            differences[i] = Some(0.0);
        }
        differences[19] = None;
        let found = repeats(&differences);
        assert_eq!(found.iter().filter(|r| **r).count(), 3);
        assert_eq!(repeats(&[None, Some(0.0), Some(0.0), Some(0.1)]), [false; 4], "a still recording");
        assert_eq!(times(&[false; 4], &[]), [0.0, 0.25, 0.5, 0.75]);
    }

    #[test]
    fn uneven_frames_are_as_far_apart_as_their_seconds_and_a_pause_is_short() {
        let seconds = [0.0, 0.1, 0.2, 0.5, 0.6, 60.0];
        let places = places(&seconds);
        let expected = [0.0, 1.0, 2.0, 5.0, 6.0, 10.0].map(|at: f32| at / 11.0);
        assert!(places.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-6), "{places:?}");
        let repeated = times(&[false, false, true, false, false, false], &seconds);
        assert_eq!((repeated[1], repeated[5]), (repeated[2], 0.9));
    }
}
