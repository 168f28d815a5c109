//! Chapters: parts of a long recording, each with Gaussians of its own.
//!
//! Motion is learned in full up to a certain length, and what one set of Gaussians can show ends, too. A
//! recording is cut where the shot changes, and if it is long into parts of equal length. Each chapter also
//! learns from a few frames of its neighbours, so that it knows what goes on at its ends.

use super::{TrainSettings, seeds, settings::OVERLAP};
use crate::{
    Error, Result,
    num::spread,
    poses,
    prepare::Prepared,
    progress::Observer,
    scene::Chapter,
    sequence::{Sequence, pace, shots},
};
use std::{collections::BTreeMap, ops::Range};

/// Number of frames that a shot has at least to be a chapter of its own.
const SHORTEST: usize = 8;
/// Most chapters that the lens of a shot is looked for in.
const PARTS_FOR_LENS: usize = 3;

/// Times and chapters of a recording.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Plan {
    /// Time of every frame, 0 to 1; none if frame i of N is at i / N.
    pub times: Vec<f32>,
    /// The chapters in order; none if the recording is learned as a whole.
    pub chapters: Vec<Chapter>,
    /// Factor from the assumed focal length to the one of each shot that was asked for, by its first chapter.
    zooms: BTreeMap<usize, f32>,
}

impl Plan {
    /// Plans the training of a recording; reads all frames that may be learned from.
    ///
    /// # Errors
    /// A frame that cannot be read, or the observer's wish to stop.
    pub fn of(
        sequence: &Sequence,
        prepared: Option<&Prepared>,
        settings: &TrainSettings,
        observer: &mut Observer<'_>,
    ) -> Result<Self> {
        if settings.chapter_frames == 0 {
            return Self::whole(sequence, prepared, settings, observer);
        }
        let n = sequence.num_frames();
        let frames = seen_frames(sequence, prepared, settings);
        if frames.is_empty() {
            return Err(no_frames_left());
        }
        let differences = pace::differences(sequence, &frames, observer)?;
        let times = if settings.finds_repeats {
            pace::frame_times(&differences, &frames, sequence.frame_seconds())
        } else {
            Vec::new()
        };
        let mut ends = shots::cuts_of(&differences);
        let is_long = settings.is_long(n);
        let longest = if is_long { settings.chapter_frames } else { n };
        if is_long {
            // What is left out separates, too.
            ends.extend(settings.excluded.iter().flat_map(|(from, to)| [*from, to.saturating_add(1)]));
        }
        let chapters = chapters(n, longest, ends, &times);
        let mut seen = Vec::new();
        for chapter in chapters {
            let own: Vec<usize> = frames.iter().copied().filter(|i| chapter.learned.contains(i)).collect();
            if have_pixels(sequence, &own)? {
                seen.push(chapter);
            }
        }
        if matches!(&seen[..], [only] if only.shown == (0..n)) {
            seen.clear();
        }
        let count = seen.len();
        let numbered = |(index, chapter)| Chapter { index, count, ..chapter };
        let chapters = seen.into_iter().enumerate().map(numbered).collect();
        Ok(Self { times, chapters, ..Self::default() })
    }

    /// Returns the factor from the focal length that is assumed to the one of the shot of a chapter. That is
    /// looked for once for all of them. `None` if the lens is known, or the shot is one chapter, which looks for
    /// itself.
    ///
    /// # Errors
    /// A frame that cannot be read, or the observer's wish to stop.
    pub(super) fn zoom(
        &mut self,
        sequence: &Sequence,
        settings: &TrainSettings,
        chapter: &Chapter,
        observer: &mut Observer<'_>,
    ) -> Result<Option<f32>> {
        let is_wanted =
            settings.finds_path && poses::are_wanted(sequence) && poses::has_unknown_lens(sequence);
        let shot = self.shot(chapter);
        if !is_wanted || shot.len() < 2 {
            return Ok(None);
        }
        if let Some(zoom) = self.zooms.get(&shot.start) {
            return Ok(Some(*zoom));
        }
        let frames = |chapter: &Chapter| {
            let settings = TrainSettings { chapter: Some(chapter.clone()), ..settings.clone() };
            settings.frames(sequence.num_frames())
        };
        let chapters = &self.chapters[shot.clone()];
        let parts: Vec<Vec<usize>> =
            spread(chapters.len(), PARTS_FOR_LENS).map(|k| frames(&chapters[k])).collect();
        let times = times_of(sequence, &self.times);
        let zoom = poses::shared_zoom(sequence, &parts, &times, observer)?.unwrap_or(1.0);
        Ok(Some(*self.zooms.entry(shot.start).or_insert(zoom)))
    }

    /// Returns the places of the chapters of one shot with `chapter`: those that learn from frames of their
    /// neighbours.
    fn shot(&self, chapter: &Chapter) -> Range<usize> {
        let is_joined = |k: usize| self.chapters[k].goes_on_from(&self.chapters[k - 1]);
        let at = self.chapters.iter().position(|other| other == chapter).unwrap_or(0);
        let start = (1..=at).rev().find(|k| !is_joined(*k)).unwrap_or(0);
        let end = (at + 1..self.chapters.len()).find(|k| !is_joined(*k)).unwrap_or(self.chapters.len());
        start..end
    }

    /// Plans the training of a recording as a whole.
    pub(super) fn whole(
        sequence: &Sequence,
        prepared: Option<&Prepared>,
        settings: &TrainSettings,
        observer: &mut Observer<'_>,
    ) -> Result<Self> {
        if !settings.finds_repeats {
            return Ok(Self::default());
        }
        let frames = seen_frames(sequence, prepared, settings);
        let differences = pace::differences(sequence, &frames, observer)?;
        let times = pace::frame_times(&differences, &frames, sequence.frame_seconds());
        Ok(Self { times, ..Self::default() })
    }
}

/// Time of frame `i`: the planned one, or that of the recording where none is planned, see [`Plan::times`].
pub(super) fn time_of(sequence: &Sequence, planned: &[f32], i: usize) -> f32 {
    planned.get(i).copied().unwrap_or_else(|| sequence.time(i))
}

/// Times of all frames, see [`time_of`].
pub(super) fn times_of(sequence: &Sequence, planned: &[f32]) -> Vec<f32> {
    (0..sequence.num_frames()).map(|i| time_of(sequence, planned, i)).collect()
}

/// Error of a recording all of whose frames are excluded.
pub(super) fn no_frames_left() -> Error {
    Error::input("every frame is excluded", "Take some of them back in.")
}

/// Returns `true` if something is left of one of the frames to learn from.
fn have_pixels(sequence: &Sequence, frames: &[usize]) -> Result<bool> {
    for &frame in frames {
        if seeds::has_pixels(sequence, frame)? {
            return Ok(true);
        }
    }
    Ok(false)
}

/// Frames that may be learned from.
fn seen_frames(sequence: &Sequence, prepared: Option<&Prepared>, settings: &TrainSettings) -> Vec<usize> {
    let eval = settings.eval || prepared.is_some_and(|p| p.eval);
    TrainSettings { eval, ..settings.clone() }.frames(sequence.num_frames())
}

/// Cuts `n` frames into chapters of about `longest` at most, at all of `ends` that leave enough frames
/// between them. Frames of one time stay in one chapter, because a time tells the chapter.
fn chapters(n: usize, longest: usize, mut ends: Vec<usize>, times: &[f32]) -> Vec<Chapter> {
    let is_repeat = |i: &usize| times.get(*i).is_some_and(|time| Some(time) == times.get(i - 1));
    let new_from = |i: usize| (i..n).find(|i| !is_repeat(i)).unwrap_or(n);
    ends.sort_unstable();
    let mut borders = vec![0];
    for end in ends.into_iter().filter(|end| *end > 0).map(new_from) {
        if end >= borders[borders.len() - 1] + SHORTEST && end + SHORTEST <= n {
            borders.push(end);
        }
    }
    borders.push(n);
    let mut chapters = Vec::new();
    for shot in borders.windows(2) {
        let (first, len) = (shot[0], shot[1] - shot[0]);
        let count = len.div_ceil(longest.max(1));
        let border = |k: usize| if k == 0 { first } else { new_from(first + k * len / count) };
        for shown in (0..count).map(|k| border(k)..border(k + 1)).filter(|shown| !shown.is_empty()) {
            let learned =
                shown.start.saturating_sub(OVERLAP).max(shot[0])..(shown.end + OVERLAP).min(shot[1]);
            chapters.push(Chapter { index: chapters.len(), count: 0, shown, learned });
        }
    }
    chapters
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        demo::{self, DemoSettings},
        progress::unobserved,
    };
    use image::GrayImage;

    #[test]
    fn one_frame_with_pixels_is_enough_for_a_chapter() {
        let folder = tempfile::tempdir().unwrap();
        let small = DemoSettings::of_size(48, 32, 40);
        demo::write(&small, folder.path(), &mut unobserved).unwrap();
        let hide = |frame: usize| {
            let path = folder.path().join(format!("masks/frame_{frame:06}.png"));
            GrayImage::new(48, 32).save(path).unwrap();
        };
        let count = || {
            let sequence = Sequence::open(folder.path()).unwrap();
            let settings = TrainSettings { chapter_frames: 16, finds_repeats: false, ..Default::default() };
            Plan::of(&sequence, None, &settings, &mut unobserved).unwrap().chapters.len()
        };
        // The last of three chapters learns from frames 18 to 39.
        (18..39).for_each(hide);
        assert_eq!(count(), 3);
        hide(39);
        assert_eq!(count(), 2);
    }

    #[test]
    fn the_only_chapter_that_is_left_is_one_unless_it_is_the_whole_recording() {
        let folder = tempfile::tempdir().unwrap();
        let small = DemoSettings::of_size(48, 32, 40);
        demo::write(&small, folder.path(), &mut unobserved).unwrap();
        let sequence = Sequence::open(folder.path()).unwrap();
        let plan = |chapter_frames: usize, excluded: Vec<(usize, usize)>| {
            let settings =
                TrainSettings { chapter_frames, excluded, finds_repeats: false, ..Default::default() };
            Plan::of(&sequence, None, &settings, &mut unobserved).unwrap().chapters
        };
        let left = Chapter { index: 0, count: 1, shown: 32..40, learned: 32..40 };
        assert_eq!(plan(8, vec![(0, 31)]), [left]);
        assert!(plan(96, vec![(0, 31)]).is_empty() && plan(96, Vec::new()).is_empty());
    }

    #[test]
    fn chapters_follow_each_other_and_learn_from_their_neighbours() {
        let found = chapters(250, 96, Vec::new(), &[]);
        let shown: Vec<Range<usize>> = found.iter().map(|c| c.shown.clone()).collect();
        assert_eq!(shown, [0..83, 83..166, 166..250]);
        assert_eq!(found[1].learned, 75..174);
        assert_eq!((found[0].learned.clone(), found[2].learned.clone()), (0..91, 158..250));
        assert_eq!(found.iter().map(|c| c.index).collect::<Vec<_>>(), [0, 1, 2]);
    }

    #[test]
    fn nothing_is_learned_across_a_cut() {
        let found = chapters(200, 96, vec![120, 123, 2, 199], &[]);
        let ranges: Vec<_> = found.iter().map(|c| (c.shown.clone(), c.learned.clone())).collect();
        assert_eq!(ranges, [(0..60, 0..68), (60..120, 52..120), (120..200, 120..200)]);
    }

    #[test]
    fn frames_of_one_time_are_in_one_chapter() {
        // Every third frame repeats the one before, and frames 100 to 180 are frozen.
        let is_repeat = |i: usize| i % 3 == 1 || (101..180).contains(&i);
        let times = (0..250).scan(0.0, |at, i| {
            *at += if is_repeat(i) { 0.0 } else { 0.001 };
            Some(*at)
        });
        let times: Vec<f32> = times.collect();
        let found = chapters(250, 60, vec![220], &times);
        let shown: Vec<Range<usize>> = found.iter().map(|c| c.shown.clone()).collect();
        assert_eq!(shown, [0..56, 56..180, 180..221, 221..250]);
    }
}
