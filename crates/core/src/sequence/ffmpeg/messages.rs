//! Facts that ffmpeg's messages tell about a video, compared with what the file promises.

use super::Unread;
use crate::{
    Error, Result,
    sequence::{
        h264::{cut_off, other_size},
        recording::Selection,
    },
};
use std::io::{BufRead, BufReader, Read};

/// Largest number of frames at the beginning that may be missing, because they need earlier frames
/// that were cut away.
pub(super) const LEADING_FRAMES: usize = 16;
/// Allowed time between the last frame and the end of a file, seconds.
const SLACK: f64 = 0.1;
/// Beginning of a line that advises on ffmpeg's options, which nobody gave here.
const ADVICE: &str = "To ignore this, add a trailing";

/// A decoded picture, as `showinfo` describes it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Shown {
    /// Time at which it is shown, in ticks of the track.
    pub ticks: Option<i64>,
    /// The same in seconds, to six digits.
    seconds: Option<f64>,
    /// Seconds for which it is shown, if ffmpeg tells.
    lasts: Option<f64>,
    /// Number of columns and rows.
    pub size: Option<(usize, usize)>,
    /// `true` if decoding may start there.
    is_key: bool,
}

impl Shown {
    /// Reads a line; `None` if it is not about a picture.
    pub(super) fn of(line: &str) -> Option<Self> {
        if !(line.contains("showinfo") && line.contains(" pts_time:")) {
            return None;
        }
        Some(Self {
            ticks: after(line, " pts:").and_then(|t| t.parse().ok()),
            seconds: after(line, " pts_time:").and_then(|t| t.parse().ok()),
            lasts: after(line, " duration_time:").and_then(|t| t.parse().ok()),
            size: after(line, " s:").and_then(size),
            is_key: line.contains(" iskey:1"),
        })
    }
}

/// Facts collected from ffmpeg's messages.
#[derive(Debug, Default, PartialEq)]
pub(super) struct Told {
    /// Duration of the whole file, seconds. Its clock begins at `start`.
    pub duration: Option<f64>,
    start: f64,
    has_audio: bool,
    has_video: bool,
    pub frames_per_second: Option<f32>,
    /// Number of columns and rows by the description of the video.
    pub announced_size: Option<(usize, usize)>,
    /// Width of a pixel by its height, if the video says it.
    pub pixel_aspect: Option<f32>,
    /// Number of decoded frames, used or not.
    pub frames: usize,
    pub size: Option<(usize, usize)>,
    /// Seconds per tick of the track.
    pub tick_s: Option<f64>,
    /// Time of every frame in ticks, where it has one.
    pub ticks: Vec<Option<i64>>,
    /// Frames at which decoding may start.
    pub keys: Vec<usize>,
    /// Index and size of the first frame whose size differs from the first frame's.
    other_size: Option<(usize, (usize, usize))>,
    /// Time of every frame, seconds, as far as they are known one after the other.
    pub seconds: Vec<f64>,
    /// Seconds for which the last frame is shown, if ffmpeg tells.
    last_lasts: f64,
    /// The first complaint about the contents of the file.
    pub complaint: Option<String>,
    pub is_full: bool,
    pub last_line: String,
}

impl Told {
    pub(super) fn listen(output: impl Read) -> Self {
        let mut told = Self::default();
        let mut lines = BufReader::new(output);
        let mut line = Vec::new();
        while lines.read_until(b'\n', &mut line).is_ok_and(|n| n > 0) {
            told.hear(String::from_utf8_lossy(&line).trim());
            line.clear();
        }
        told
    }

    pub(super) fn hear(&mut self, line: &str) {
        if let Some(shown) = Shown::of(line) {
            self.count(shown);
            return;
        }
        if line.is_empty() || line.contains("showinfo") || line.contains(ADVICE) {
            self.tick_s = self.tick_s.or_else(|| ratio(after(line, "config in time_base:")?));
            return;
        }
        self.is_full |=
            ["No space left on device", "Disk quota exceeded"].iter().any(|full| line.contains(full));
        if line.contains("Duration:") && self.duration.is_none() {
            self.duration = after(line, "Duration:").and_then(seconds);
            self.start = after(line, "start:").and_then(|s| s.parse().ok()).unwrap_or(0.0);
        } else if line.contains("Stream #") && line.contains("Audio:") {
            self.has_audio = true;
        } else if line.contains("Stream #") && line.contains("Video:") && !self.has_video {
            self.has_video = true;
            self.frames_per_second = announced_speed(line);
            self.announced_size = line.split([',', ' ']).find_map(size);
            let aspect = after(line, "SAR ").and_then(|aspect| ratio(&aspect.replace(':', "/")));
            self.pixel_aspect = aspect.map(|aspect| aspect as f32);
        }
        // Warnings about cut packets do not count: a broadcast stream usually ends within a packet.
        let is_complaint =
            ["[error]", "[fatal]", "corrupt decoded frame"].iter().any(|word| line.contains(word));
        if is_complaint && self.complaint.is_none() {
            self.complaint = Some(plain(line));
        }
        self.last_line = plain(line);
    }

    /// Takes note of the next frame.
    fn count(&mut self, shown: Shown) {
        match (shown.size, self.size) {
            (Some(found), Some(first)) if found != first && self.other_size.is_none() => {
                self.other_size = Some((self.frames, found));
            }
            (size, None) => self.size = size,
            _ => {}
        }
        if shown.is_key {
            self.keys.push(self.frames);
        }
        self.ticks.push(shown.ticks);
        let exact = self.tick_s.zip(shown.ticks).map(|(tick, ticks)| tick * ticks as f64);
        if let Some(seconds) = exact.or(shown.seconds).filter(|_| self.seconds.len() == self.frames) {
            self.seconds.push(seconds);
        }
        self.last_lasts = shown.lasts.unwrap_or(0.0);
        self.frames += 1;
    }

    /// Returns the flaw of a file that has no video track, without a full stop; `None` if it has one, or
    /// ffmpeg could not read it.
    pub(super) fn no_video(&self) -> Option<&'static str> {
        let is_unmatched = self.complaint.as_ref().is_some_and(|what| what.contains("matches no streams"));
        match (self.has_video, self.has_audio) {
            (false, true) => Some("there is no video track in this file, only sound"),
            (false, false) if is_unmatched => Some("there is no video track in this file"),
            _ => None,
        }
    }

    /// Returns the time of the last frame, seconds after the start of the file.
    fn reached(&self) -> f64 {
        self.seconds.iter().copied().fold(0.0, f64::max)
    }

    /// Takes note of frames that are listed, by the ticks of their times, as if they had been decoded.
    pub(super) fn count_listed(&mut self, ticks: &[i64], tick_s: f64) {
        self.tick_s = Some(tick_s);
        (self.frames, self.ticks, self.seconds) = (0, Vec::new(), Vec::new());
        ticks.iter().for_each(|ticks| self.count(Shown { ticks: Some(*ticks), ..Shown::default() }));
    }

    /// Returns how many frames the video has by its duration and speed.
    pub(super) fn usual_frames(&self) -> usize {
        let duration = self.duration.unwrap_or(0.0) - self.start.max(0.0);
        (duration * f64::from(self.frames_per_second.unwrap_or(0.0))) as usize
    }

    /// Returns the seconds between the last frame and the end of the file that no frame accounts for.
    fn lacking(&self) -> f64 {
        let end = self.duration.map_or(0.0, |duration| duration - self.start.max(0.0));
        let usual = self.frames_per_second.map_or(0.0, |speed| 1.0 / f64::from(speed));
        let longest = self.seconds.windows(2).map(|pair| pair[1] - pair[0]).fold(usual, f64::max);
        end - (self.reached() + (3.0 * longest).max(self.last_lasts) + SLACK)
    }
}

/// Returns an error if fewer frames came than were promised, or if one has another size. Otherwise
/// returns notes for the user.
pub(super) fn compare(
    video: &Unread,
    selection: &Selection,
    told: &Told,
    pictures: usize,
) -> Result<Vec<String>> {
    let path = &video.path;
    let is_used = |frame: usize| selection.last.is_none_or(|last| frame <= last);
    if let (Some((frame, size)), Some(first)) = (told.other_size, told.size)
        && is_used(frame)
    {
        return Err(other_size(path, frame, size, first));
    }
    let complaint = told.complaint.as_ref().map_or(String::new(), |what| format!("; ffmpeg says: {what}"));
    let cut_off = |what: String, there| Err(cut_off(path, &what, there));
    if let Some(last) = selection.last {
        // Only the used frames matter.
        let asked = (last - selection.first) / selection.every.max(1) + 1;
        if pictures < asked {
            let what = format!("{asked} frames up to {last} are asked for, {pictures} came{complaint}");
            return cut_off(what, told.frames);
        }
        return Ok(Vec::new());
    }
    let selected = (selection.first..told.frames).step_by(selection.every.max(1)).len();
    if told.frames > 0 && pictures != selected {
        let what = format!("{selected} of its {} frames are used, ffmpeg unpacked {pictures}", told.frames);
        return Err(Error::input_at(path, what + &complaint, "Convert it to H.264 in mp4."));
    }
    let mut notes = Vec::new();
    match video.promised {
        // If ffmpeg gave no count (`told.frames` is 0), its pictures are accepted.
        Some(all) if told.frames > 0 && told.frames < all => {
            let what = format!("it lists {all} frames, {} could be decoded", told.frames);
            if told.complaint.is_some() || told.frames + LEADING_FRAMES < all {
                return cut_off(what + &complaint, told.frames);
            }
            notes.push(format!("The video lists {all} frames, ffmpeg shows {} of them", told.frames));
        }
        None if told.frames > 0 && told.duration.is_none() => {
            notes.push("The video does not say how long it is: whether it is whole is not known".to_owned());
        }
        None if told.frames > 0 && told.lacking() > 0.0 => {
            let (all, reached) = (told.duration.unwrap_or(0.0), told.reached());
            let about = told.frames_per_second.map_or(String::new(), |speed| {
                format!(" of about {:.0}", (all - told.start.max(0.0)) * f64::from(speed))
            });
            let what = format!(
                "it lasts {all:.2} s, its frames end at {reached:.2} s: {}{about} could be decoded",
                told.frames
            );
            // With an edit list that delays frames, or repeats some, a video lasts longer than they do.
            if told.complaint.is_some() || !(told.has_audio || video.ignores_edits()) {
                return cut_off(what + &complaint, told.frames);
            }
            let longer = if told.has_audio { "its sound is longer" } else { "an edit list makes it longer" };
            notes.push(format!("The video may be cut off: {what}, or {longer}"));
        }
        _ => {}
    }
    if let Some(what) = told.complaint.as_ref().filter(|_| notes.is_empty()) {
        notes.push(damage(what));
    }
    Ok(notes)
}

/// Says that pictures may be guesses, as ffmpeg complained.
pub(in super::super) fn damage(what: &str) -> String {
    format!("ffmpeg found damage in the video, and what it shows there is a guess: {what}")
}

/// Returns the word after `key`, up to a comma or a space.
fn after<'a>(line: &'a str, key: &str) -> Option<&'a str> {
    let rest = line.split_once(key)?.1.trim_start();
    rest.split([',', ' ']).next()
}

/// Reads a size such as 640x512.
fn size(text: &str) -> Option<(usize, usize)> {
    let (width, height) = text.split_once('x')?;
    let both = (width.parse().ok()?, height.parse().ok()?);
    (both.0 > 0 && both.1 > 0).then_some(both)
}

/// Reads a ratio such as 1/12800.
pub(super) fn ratio(text: &str) -> Option<f64> {
    let (above, below) = text.split_once('/')?;
    let ratio = above.parse::<f64>().ok()? / below.parse::<f64>().ok()?;
    (ratio.is_finite() && ratio > 0.0).then_some(ratio)
}

/// Converts hours, minutes and seconds to seconds.
fn seconds(clock: &str) -> Option<f64> {
    clock.split(':').try_fold(0.0, |sum, part| part.parse::<f64>().ok().map(|v| sum * 60.0 + v))
}

/// Removes the full stop, and the prefixes that ffmpeg puts before a line:
/// `[mov @ 0x55] [error] stream 0: partial file`.
fn plain(line: &str) -> String {
    let mut rest = line;
    while let Some((_, tail)) = rest.strip_prefix('[').and_then(|r| r.split_once(']')) {
        rest = tail.trim_start();
    }
    rest.trim_end_matches('.').to_owned()
}

/// Returns the frame rate in ffmpeg's description of the input: `… 640x512, 25 fps, …`.
pub(super) fn announced_speed(line: &str) -> Option<f32> {
    let speed = line.split(',').find_map(|part| part.trim().strip_suffix(" fps"))?;
    // Thousands are abbreviated: "1k".
    let (digits, factor) = speed.strip_suffix('k').map_or((speed, 1.0), |digits| (digits, 1000.0));
    digits.parse().ok().map(|fps: f32| fps * factor).filter(|fps| fps.is_finite() && *fps > 0.0)
}

#[cfg(test)]
#[path = "../tests/ffmpeg.rs"]
mod tests;
