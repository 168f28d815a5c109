//! Times at which frames were taken, as the files of the recording tell.

use crate::num::median;

/// Frames per second of moving pictures if the recording's own speed is not known.
pub(crate) const USUAL_SPEED: f32 = 25.0;
/// Difference from an even pace that is none, seconds: clocks of files round to a millisecond.
const SAME_TIME_S: f64 = 1.5e-3;
/// Frames are said to be unevenly spaced if the longest time between two is more than this many times the
/// shortest.
const UNEVEN: f64 = 1.5;

/// Returns the frames per second from the first to the last of some times, seconds.
pub(super) fn mean_speed(seconds: &[f64]) -> Option<f32> {
    speed_of(seconds.len(), seconds.last()? - seconds.first()?, 1.0)
}

/// Returns the frames per second of `frames`, the first and the last of which are `ticks` apart.
pub(super) fn speed_of(frames: usize, ticks: f64, ticks_per_second: f64) -> Option<f32> {
    let speed = frames.checked_sub(1)? as f64 * ticks_per_second / ticks;
    (speed.is_finite() && speed > 0.0).then_some(speed as f32)
}

/// Returns the times of all frames after the first, seconds, unless frames follow each other at a known speed
/// anyway. Times that run backwards tell nothing.
pub(super) fn uneven(seconds: &[f64], frames_per_second: Option<f32>) -> Vec<f64> {
    let Some(first) = seconds.first() else { return Vec::new() };
    // To a millionth: nothing measures them better, and they are written into files.
    let since_first: Vec<f64> = seconds.iter().map(|t| (1e6 * (t - first)).round() / 1e6).collect();
    let expected = |i: usize| frames_per_second.map(|speed| i as f64 / f64::from(speed));
    let is_late = |(i, t): (usize, &f64)| expected(i).is_none_or(|e| (t - e).abs() > SAME_TIME_S);
    let is_known = since_first.is_sorted() && since_first.iter().all(|t| t.is_finite());
    if is_known && since_first.iter().enumerate().any(is_late) { since_first } else { Vec::new() }
}

/// Pictures whose numbers leave some out.
#[derive(Debug, PartialEq)]
pub(super) struct Gaps {
    /// Place of every frame, counted in usual steps from the first one.
    places: Vec<f64>,
    /// The first frame after a gap.
    first: usize,
    /// Number of gaps.
    count: usize,
}

impl Gaps {
    /// Finds the gaps in the numbers that end the names of pictures. A constant step is none; and numbers that do
    /// not ascend count something else.
    pub(super) fn of(names: &[&str]) -> Option<Self> {
        let numbers: Vec<u64> = names.iter().map(|name| last_number(name)).collect::<Option<_>>()?;
        if !numbers.is_sorted_by(|a, b| a < b) {
            return None;
        }
        let steps: Vec<f64> = numbers.windows(2).map(|pair| (pair[1] - pair[0]) as f64).collect();
        let usual = median(&mut steps.clone())?;
        let is_gap = |step: &f64| *step > UNEVEN * usual;
        let places = numbers.iter().map(|number| (number - numbers[0]) as f64 / usual).collect();
        let first = steps.iter().position(is_gap)? + 1;
        Some(Self { places, first, count: steps.iter().filter(|step| is_gap(step)).count() })
    }

    /// Returns the time of every frame, seconds, where `frames_per_second` follow each other without a gap.
    pub(super) fn seconds(&self, frames_per_second: f32) -> Vec<f64> {
        self.places.iter().map(|place| place / f64::from(frames_per_second)).collect()
    }

    /// Returns a note about the gaps.
    pub(super) fn describe(&self, names: &[&str], frames_per_second: Option<f32>) -> String {
        let more = match self.count {
            1 => String::new(),
            2 => " and at another place".to_owned(),
            count => format!(" and at {} other places", count - 1),
        };
        let times = match frames_per_second {
            Some(_) => "times follow the numbers",
            None => "no time passes there, unless frames_per_second is given under [time]",
        };
        let (before, after) = (names[self.first - 1], names[self.first]);
        format!("Pictures seem to be missing between {before} and {after}{more}; {times}")
    }
}

/// Returns the last number in a name.
fn last_number(name: &str) -> Option<u64> {
    let is_digit = |c: char| c.is_ascii_digit();
    let end = name.rfind(is_digit)? + 1;
    let start = name[..end].rfind(|c| !is_digit(c)).map_or(0, |at| at + 1);
    name[start..end].parse().ok()
}

/// Returns a note if frames are shown for very unequal times.
pub(super) fn describe(seconds: &[f64]) -> Option<String> {
    let between = || seconds.windows(2).map(|pair| pair[1] - pair[0]);
    let (shortest, longest) = (between().reduce(f64::min)?, between().reduce(f64::max)?);
    (longest > UNEVEN * shortest).then(|| {
        let [shortest, longest] = [shortest, longest].map(|seconds| 1e3 * seconds);
        format!(
            "The time between two frames varies from {shortest:.0} to {longest:.0} ms; each keeps its own"
        )
    })
}

/// Returns the seconds from the first frame to `frame`: by the times of all frames if there are some, else by
/// the speed, if that is known.
pub fn seconds_of(frame: usize, frame_seconds: &[f64], frames_per_second: Option<f32>) -> Option<f64> {
    let even = || frames_per_second.map(|speed| frame as f64 / f64::from(speed));
    frame_seconds.get(frame).copied().or_else(even)
}

/// Returns the seconds for which a player shows `frame`, by the times of all frames; `None` for the last one,
/// and without such times.
pub fn shown_for(frame: usize, frame_seconds: &[f64]) -> Option<f64> {
    /// Longest time that one frame is shown, whatever the pause after it, seconds.
    const LONGEST_SHOWN_S: f64 = 2.0;
    let lasts = frame_seconds.get(frame + 1)? - frame_seconds.get(frame)?;
    Some(lasts.clamp(0.0, LONGEST_SHOWN_S))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_times_that_a_speed_does_not_tell_are_kept() {
        let even: Vec<f64> = (0..50).map(|i| 7.0 + (40.0 * f64::from(i)).round() / 1e3).collect();
        assert_eq!(uneven(&even, Some(25.0)), [0.0; 0]);
        assert_eq!(mean_speed(&even), Some(25.0));
        let mut late = even.clone();
        late[20..].iter_mut().for_each(|t| *t += 0.5);
        let kept = uneven(&late, mean_speed(&late));
        assert!((kept[0], kept.len()) == (0.0, 50) && (kept[20] - 1.3).abs() < 1e-9);
        assert!(describe(&kept).unwrap().contains("from 40 to 540 ms"));
        assert_eq!(describe(&even), None);
        assert_eq!(uneven(&even, None).len(), 50, "the speed is not known");
        late.swap(3, 9);
        assert_eq!(uneven(&late, None), [0.0; 0], "times that run backwards");
        assert_eq!((mean_speed(&[]), mean_speed(&[1.0]), mean_speed(&[1.0, 1.0])), (None, None, None));
    }

    #[test]
    fn gaps_are_leaps_in_the_numbers_of_pictures() {
        let names = ["f_08_x", "f_09_x", "f_10_x", "f_40_x", "f_41_x", "f_43_x"];
        let gaps = Gaps::of(&names).unwrap();
        assert_eq!(gaps.seconds(10.0), [0.0, 0.1, 0.2, 3.2, 3.3, 3.5]);
        let note = gaps.describe(&names, None);
        assert!(note.contains("between f_10_x and f_40_x and at another place; no time passes"), "{note}");
        assert_eq!(Gaps::of(&["10", "20", "30", "60"]).unwrap().seconds(1.0), [0.0, 1.0, 2.0, 5.0]);
        for even in [&["10", "20", "30"][..], &["3", "2", "9"], &["1_left", "b_left"], &["1"], &[]] {
            assert_eq!(Gaps::of(even), None, "{even:?}");
        }
        assert_eq!(Gaps::of(&["1000", "1033", "1067", "1100"]), None, "times, about even");
    }

    #[test]
    fn seconds_are_those_of_the_frame_or_of_the_speed() {
        assert_eq!(seconds_of(2, &[0.0, 0.1, 0.5], Some(25.0)), Some(0.5));
        assert_eq!((seconds_of(50, &[], Some(25.0)), seconds_of(50, &[], None)), (Some(2.0), None));
        assert_eq!([0, 1, 2].map(|i| shown_for(i, &[0.0, 0.5, 60.0])), [Some(0.5), Some(2.0), None]);
    }
}
