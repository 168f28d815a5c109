//! Edit lists of mp4 files (ISO/IEC 14496-12, 8.6.6): the parts of a track that players show. A program that
//! cuts a video without encoding it anew keeps the pictures that the first shown one is decoded from, and
//! hides them by such a list. What is hidden is no part of the recording.

use super::recording::Selection;
use shiguredo_mp4::boxes::{ElstEntry, MoovBox, TrakBox};
use std::ops::Range;

/// Number of times in a second of the shortest time that counts: clocks of lists tick 600 or 1000 times, and
/// round.
const SHORTEST_PER_SECOND: u32 = 500;

/// The parts of a track that players show, in ticks of its clock.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct EditList {
    /// Ascending; none if the whole track is shown.
    parts: Vec<Range<i64>>,
    /// `true` if this is one part at the usual speed, of a file that is not in fragments.
    is_plain: bool,
    /// The shortest time that counts.
    shortest: i64,
    /// Time that the length of a part may be short of what is meant.
    tick: i64,
}

impl EditList {
    /// Reads the list of a track. Empty parts, which delay what follows, do not count.
    pub(super) fn of(track: &TrakBox, movie: &MoovBox) -> Self {
        let list = track.edts_box.as_ref().and_then(|edits| edits.elst_box.as_ref());
        let entries = list.map_or(&[][..], |list| &list.entries[..]);
        let (clock, movie_clock) = (track.mdia_box.mdhd_box.timescale.get(), movie.mvhd_box.timescale.get());
        // The list of a file in fragments does not know how long they are.
        let is_whole = movie.mvex_box.is_none();
        let part = |entry: &ElstEntry| {
            let lasts = if is_whole { u128::from(entry.edit_duration) } else { 0 };
            let movie_clock = u128::from(movie_clock);
            let ticks = (lasts * u128::from(clock) + movie_clock / 2) / movie_clock;
            let ticks = if lasts == 0 { i64::MAX } else { i64::try_from(ticks).unwrap_or(i64::MAX) };
            entry.media_time..entry.media_time.saturating_add(ticks)
        };
        let shown: Vec<&ElstEntry> = entries.iter().filter(|entry| entry.media_time >= 0).collect();
        let is_at_speed = |entry: &ElstEntry| (entry.media_rate.integer, entry.media_rate.fraction) == (1, 0);
        let mut parts: Vec<Range<i64>> = shown.iter().copied().map(part).collect();
        parts.sort_by_key(|part| part.start);
        Self {
            parts,
            is_plain: is_whole && matches!(shown[..], [only] if is_at_speed(only)),
            shortest: i64::from(clock / SHORTEST_PER_SECOND),
            tick: i64::from(clock.div_ceil(movie_clock)),
        }
    }

    /// Finds the frames that are used of those that are shown at `times`, ascending, and last `lasts` ticks
    /// together.
    pub(super) fn cut(&self, times: &[i64], lasts: i64) -> Cut {
        let all = times.len();
        let hidden = self.hidden(times, lasts);
        if !self.is_plain || hidden.len() == all {
            return Cut { used: 0..all, all, unfollowed: hidden };
        }
        let before = hidden.iter().enumerate().take_while(|(k, frame)| k == *frame).count();
        Cut { used: before..before + all - hidden.len(), all, unfollowed: Vec::new() }
    }

    /// Returns the frames that players do not show.
    fn hidden(&self, times: &[i64], lasts: i64) -> Vec<usize> {
        let first = times.first().copied().unwrap_or(0);
        let last = times.last().copied().unwrap_or(0);
        let end = first.saturating_add(lasts);
        // The last picture may last for no time at all.
        let is_open = |until: i64| until.saturating_add(self.shortest.max(self.tick)) >= end;
        let shows_last = |until: i64| is_open(until) || last.saturating_add(self.shortest) < until;
        let mut latest = i64::MIN;
        let parts = self.parts.iter().map(|part| {
            // A part that begins before the first picture begins with it, if it lasts as long as the pictures do.
            let late = first.saturating_sub(part.start).max(0);
            let late = if shows_last(part.end.saturating_add(late)) { late } else { 0 };
            let until = part.end.saturating_add(late);
            latest = latest.max(if is_open(until) { i64::MAX } else { until });
            part.start.saturating_add(late)..latest
        });
        let parts: Vec<Range<i64>> = parts.collect();
        let is_hidden = |frame: &usize| {
            let time = times[*frame].saturating_add(self.shortest);
            let begun = parts.partition_point(|part| part.start <= time);
            begun.checked_sub(1).is_none_or(|k| parts[k].end <= time)
        };
        let frames = if parts.is_empty() { 0..0 } else { 0..times.len() };
        frames.filter(is_hidden).collect()
    }
}

/// The frames of a track that are used, as places in the order of showing.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Cut {
    /// Frames that follow each other, at least one if there are any.
    pub used: Range<usize>,
    /// Number of all frames.
    all: usize,
    /// Those of the used frames that players do not show: the list is not followed.
    unfollowed: Vec<usize>,
}

impl Cut {
    /// Uses all frames.
    pub(super) fn nothing(all: usize) -> Self {
        Self { used: 0..all, all, unfollowed: Vec::new() }
    }

    /// Returns `true` if all frames are used.
    pub(super) fn is_whole(&self) -> bool {
        self.used == (0..self.all)
    }

    /// Describes for the user what the list hides; `None` if that is nothing of what is asked for.
    pub(super) fn note(&self, selection: &Selection) -> Option<String> {
        if self.is_whole() {
            return self.note_of_unfollowed(selection);
        }
        let ends = [("first", self.used.start), ("last", self.all - self.used.end)];
        let ends = ends.into_iter().filter(|(_, count)| *count > 0).map(|(which, count)| match count {
            1 => format!("the {which} frame"),
            _ => format!("the {which} {count} frames"),
        });
        Some(format!(
            "An edit list in the file hides {}: they are left out, and numbers begin with the first frame that \
             players show",
            ends.collect::<Vec<_>>().join(" and ")
        ))
    }

    fn note_of_unfollowed(&self, selection: &Selection) -> Option<String> {
        let is_used =
            |frame: &usize| *frame >= selection.first && selection.last.is_none_or(|last| *frame <= last);
        let hidden: Vec<usize> = self.unfollowed.iter().copied().filter(is_used).collect();
        let run = hidden.chunk_by(|a, b| a + 1 == *b).next()?;
        let named = match run {
            [only] => format!("frame {only}"),
            _ => format!("frames {} to {}", run[0], run[run.len() - 1]),
        };
        let more = match hidden.len() - run.len() {
            0 => String::new(),
            count => format!(" and {count} more"),
        };
        Some(format!(
            "Players do not show {named}{more}: an edit list in the file hides them. It is not followed, because \
             it has several parts or another speed, leaves nothing, or is of a file in fragments. [frames] leaves \
             frames out"
        ))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Ten frames with 1000 ticks per second, 40 ticks apart. The first is shown at 80, because pictures are
    /// coded in another order.
    fn times() -> Vec<i64> {
        (0..10).map(|i| 80 + 40 * i).collect()
    }

    fn list(parts: &[Range<i64>]) -> EditList {
        EditList { parts: parts.to_vec(), is_plain: parts.len() == 1, shortest: 2, tick: 1 }
    }

    /// Cuts the frames by a list of one part.
    fn cut(part: Range<i64>) -> Cut {
        list(std::slice::from_ref(&part)).cut(&times(), 400)
    }

    fn used(part: Range<i64>) -> Range<usize> {
        let cut = cut(part);
        assert!(cut.unfollowed.is_empty(), "{cut:?}");
        cut.used
    }

    #[test]
    fn usual_lists_hide_nothing() {
        for part in [80..480, 0..400, 0..390, 80..i64::MAX, 79..478, 81..481, 80..479] {
            assert_eq!(used(part.clone()), 0..10, "{part:?}");
        }
        assert_eq!(EditList::default().cut(&times(), 400), Cut::nothing(10));
        let last_is_instant = list(std::slice::from_ref(&(80..440))).cut(&times(), 360);
        assert!(last_is_instant.is_whole() && last_is_instant.note(&Selection::ALL).is_none());
    }

    #[test]
    fn what_is_cut_off_at_either_end_is_left_out() {
        assert_eq!(used(200..480), 3..10);
        assert_eq!(used(201..480), 3..10, "rounded");
        assert_eq!(used(210..480), 4..10, "a part of a frame");
        assert_eq!((used(80..400), used(80..401)), (0..8, 0..8));
        assert_eq!(
            (used(0..320), used(40..400)),
            (0..6, 0..8),
            "parts that begin too early end when they say"
        );
        let note = cut(120..400).note(&Selection::ALL).unwrap();
        assert!(note.contains("hides the first frame and the last 2 frames: they are left out"), "{note}");
    }

    #[test]
    fn lists_that_are_not_followed_are_told_as_far_as_they_matter() {
        let middle = list(&[80..200, 320..480]).cut(&times(), 400);
        assert!(middle.is_whole());
        let note = middle.note(&Selection::ALL).unwrap();
        assert!(note.contains("do not show frames 3 to 5: an edit list"), "{note}");
        assert_eq!(middle.note(&Selection { first: 6, ..Selection::ALL }), None);
        let several = list(&[80..120, 160..200, 240..280]).cut(&times(), 400);
        let note = several.note(&Selection { last: Some(6), ..Selection::ALL }).unwrap();
        assert!(note.contains("do not show frame 1 and 3 more"), "{note}");
        let beyond = cut(9000..9400);
        assert!(beyond.is_whole() && beyond.note(&Selection::ALL).unwrap().contains("frames 0 to 9:"));
    }
}
