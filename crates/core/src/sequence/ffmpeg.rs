//! Videos that only an installed `ffmpeg` program can read. They are unpacked once into lossless
//! pictures. Its messages about them are compared with what the file promises.

use super::{
    h264::{cut_off, other_size, uneven},
    read,
    recording::{Recording, Selection},
};
use crate::{Error, Result};
use std::{
    ffi::OsString,
    io::{BufRead, BufReader, Read},
    path::{Path, PathBuf},
    process::{Command, ExitStatus, Stdio},
    sync::{Mutex, PoisonError},
};
use tempfile::TempDir;

/// Kind of file that holds a video.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Container {
    Mp4,
    Other,
}

/// A video that is not decoded here.
pub(super) struct Unread<'a> {
    pub path: &'a Path,
    /// The file that ffmpeg reads: `path`, or what was taken out of it.
    pub input: &'a Path,
    /// ffmpeg's name of the form of that file, if the file does not say it.
    pub form: Option<&'static str>,
    pub kind: Container,
    /// Number of frames that its index lists, if it has one.
    pub promised: Option<usize>,
    /// The reason why it is not decoded here, without a full stop.
    pub why_not_here: String,
}

/// Largest number of frames at the beginning that may be missing, because they need earlier frames
/// that were cut away.
const LEADING_FRAMES: usize = 16;
/// Allowed time between the last frame and the end of a file, seconds.
const SLACK: f64 = 0.1;

/// Folders with unpacked videos, those that are gone already among them.
static UNPACKED: Mutex<Vec<PathBuf>> = Mutex::new(Vec::new());

/// Removes the frames of all videos that were unpacked. For programs that end at once, without dropping
/// their recordings.
pub fn remove_unpacked_videos() {
    for folder in UNPACKED.lock().unwrap_or_else(PoisonError::into_inner).drain(..) {
        // Somebody else may have removed it.
        let _ = std::fs::remove_dir_all(folder);
    }
}

/// Makes a temporary folder that [`remove_unpacked_videos`] removes, too.
pub(super) fn scratch_folder() -> Result<TempDir> {
    let scratch = tempfile::Builder::new().prefix("surgtpgs-video-").tempdir();
    let scratch = scratch.map_err(|e| Error::io("make a temporary folder", std::env::temp_dir(), e))?;
    UNPACKED.lock().unwrap_or_else(PoisonError::into_inner).push(scratch.path().to_owned());
    Ok(scratch)
}

/// Unpacks the selected frames into a temporary folder that lives as long as the recording.
pub(super) fn open(program: &Path, video: &Unread<'_>, selection: &Selection) -> Result<Recording> {
    let Unread { path, promised, .. } = *video;
    let (places, scratch) = (std::env::temp_dir(), scratch_folder()?);
    let Selection { first, last, .. } = *selection;
    if last.is_some_and(|last| last < first || promised.is_some_and(|all| last >= all)) {
        let there = promised.map_or(String::new(), |all| format!(", the video has {all}"));
        let what = format!("frames {first} to {} are asked for{there}", last.unwrap_or(first));
        return Err(Error::input_at(path, what, "Look at [frames] in its settings."));
    }
    let (status, told) = unpack(program, video, selection, scratch.path())?;
    if told.is_full {
        return Err(Error::Missing {
            what: format!("the temporary folder {} is full: the video is unpacked there", places.display()),
            hint: "Free some space, or set TMPDIR to a folder with more.".into(),
        });
    }
    let mut pictures = read::list(scratch.path(), &["png"])?;
    if !status.success() || pictures.is_empty() {
        let last_line = if told.last_line.is_empty() { "no frames came out" } else { &told.last_line };
        return Err(Error::input_at(
            path,
            format!("the video cannot be read here ({}), nor by ffmpeg: {last_line}", video.why_not_here),
            "The file may be damaged, or the frames asked for in its settings may not exist.",
        ));
    }
    let notes = compare(video, selection, &told, pictures.len())?;
    if let Some(last) = selection.last {
        pictures.truncate((last - selection.first) / selection.every.max(1) + 1);
    }
    let mut recording = Recording::of_pictures(path, &pictures)?;
    for (k, frame) in recording.frames.iter_mut().enumerate() {
        frame.name = format!("{:06}", first + k * selection.every);
    }
    recording.frames_per_second = told.frames_per_second;
    recording.notes.extend(notes);
    recording.notes.extend(told.shortest.and_then(|shortest| uneven(shortest, told.longest)));
    recording.scratch.push(scratch);
    recording.unpacked_from.push(path.to_owned());
    Ok(recording)
}

/// Runs ffmpeg and collects its messages.
fn unpack(
    program: &Path,
    video: &Unread<'_>,
    selection: &Selection,
    folder: &Path,
) -> Result<(ExitStatus, Told)> {
    let Selection { first, last, every } = *selection;
    let range = last.map_or_else(|| format!("gte(n,{first})"), |last| format!("between(n,{first},{last})"));
    let mut command = Command::new(program);
    command.args(["-hide_banner", "-nostats", "-nostdin", "-loglevel", "level+info"]);
    if video.kind == Container::Mp4 {
        // Reads all frames of the index, as the decoder of this library does.
        command.args(["-ignore_editlist", "1"]);
    }
    // Names such as `concat:a` would be read as something else than a file.
    let mut input = OsString::from("file:");
    input.push(video.input);
    if let Some(form) = video.form {
        command.args(["-f", form]);
    }
    command.arg("-i").arg(input).args(["-map", "0:v:0", "-vf"]);
    // A new, steady clock. With its own clock ffmpeg would repeat and drop frames to keep a steady rate.
    // Two fields of one picture show two times; what is not interlaced stays as it is.
    command.arg(format!("bwdif=mode=send_frame:deint=interlaced,showinfo,select='{range}*not(mod(n-{first},{every}))',settb=1/25,setpts=N"));
    command.args(["-r", "25", "-pix_fmt", "rgb24", "-compression_level", "1", "-start_number", "0"]);
    if let Some(last) = last.filter(|last| *last >= first) {
        command.args(["-frames:v", &((last - first) / every.max(1) + 1).to_string()]);
    }
    let folder = folder.to_string_lossy().replace('%', "%%");
    command
        .arg(Path::new(&folder).join("%08d.png"))
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::piped());
    let missing = |e: std::io::Error| Error::Missing {
        what: format!(
            "this video cannot be read here ({}), nor by the program ffmpeg ({e})",
            video.why_not_here
        ),
        hint: "Install ffmpeg, or convert the video to H.264 in mp4 or to a folder of PNG frames.".into(),
    };
    let mut child = command.spawn().map_err(missing)?;
    let told = child.stderr.take().map_or_else(Told::default, Told::listen);
    Ok((child.wait().map_err(missing)?, told))
}

/// Facts collected from ffmpeg's messages.
#[derive(Debug, Default, PartialEq)]
struct Told {
    /// Duration of the whole file, seconds. Its clock begins at `start`.
    duration: Option<f64>,
    start: f64,
    has_audio: bool,
    has_video: bool,
    frames_per_second: Option<f32>,
    /// Number of decoded frames, used or not.
    frames: usize,
    size: Option<(usize, usize)>,
    /// Index and size of the first frame whose size differs from the first frame's.
    other_size: Option<(usize, (usize, usize))>,
    /// Time of the last frame, seconds. `longest` and `shortest` are the extremes of the time
    /// between two frames.
    reached: f64,
    longest: f64,
    shortest: Option<f64>,
    /// Seconds for which the last frame is shown, if ffmpeg tells.
    last_lasts: f64,
    /// The first complaint about the contents of the file.
    complaint: Option<String>,
    is_full: bool,
    last_line: String,
}

impl Told {
    fn listen(output: impl Read) -> Self {
        let mut told = Self::default();
        let mut lines = BufReader::new(output);
        let mut line = Vec::new();
        while lines.read_until(b'\n', &mut line).is_ok_and(|n| n > 0) {
            told.hear(String::from_utf8_lossy(&line).trim());
            line.clear();
        }
        told
    }

    fn hear(&mut self, line: &str) {
        if line.contains("showinfo") && line.contains(" pts_time:") {
            self.hear_frame(line);
            return;
        }
        if line.is_empty() || line.contains("showinfo") {
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
        }
        // Warnings about cut packets do not count: a broadcast stream usually ends within a packet.
        let is_complaint =
            ["[error]", "[fatal]", "corrupt decoded frame"].iter().any(|word| line.contains(word));
        if is_complaint && self.complaint.is_none() {
            self.complaint = Some(plain(line));
        }
        self.last_line = plain(line);
    }

    /// Takes note of a frame that `showinfo` describes.
    fn hear_frame(&mut self, line: &str) {
        let size = after(line, " s:").and_then(|s| s.split_once('x'));
        let size = size.and_then(|(w, h)| Some((w.parse().ok()?, h.parse().ok()?)));
        if let (Some(found), Some(first)) = (size, self.size) {
            if found != first && self.other_size.is_none() {
                self.other_size = Some((self.frames, found));
            }
        } else {
            self.size = size;
        }
        if let Some(time) = after(line, " pts_time:").and_then(|t| t.parse::<f64>().ok()) {
            if self.frames > 0 {
                let lasted = time - self.reached;
                self.longest = self.longest.max(lasted);
                self.shortest = Some(self.shortest.map_or(lasted, |shortest| shortest.min(lasted)));
            }
            self.reached = self.reached.max(time);
        }
        let lasts = after(line, " duration_time:").and_then(|t| t.parse::<f64>().ok());
        self.last_lasts = lasts.unwrap_or(0.0);
        self.frames += 1;
    }

    /// Returns the seconds between the last frame and the end of the file that no frame accounts for.
    fn lacking(&self) -> f64 {
        let end = self.duration.map_or(0.0, |duration| duration - self.start.max(0.0));
        let usual = self.frames_per_second.map_or(0.0, |speed| 1.0 / f64::from(speed));
        end - (self.reached + (3.0 * self.longest.max(usual)).max(self.last_lasts) + SLACK)
    }
}

/// Returns an error if fewer frames came than were promised, or if one has another size. Otherwise
/// returns notes for the user.
fn compare(video: &Unread<'_>, selection: &Selection, told: &Told, pictures: usize) -> Result<Vec<String>> {
    let path = video.path;
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
            let (all, reached) = (told.duration.unwrap_or(0.0), told.reached);
            let about = told.frames_per_second.map_or(String::new(), |speed| {
                format!(" of about {:.0}", (all - told.start.max(0.0)) * f64::from(speed))
            });
            let what = format!(
                "it lasts {all:.2} s, its frames end at {reached:.2} s: {}{about} could be decoded",
                told.frames
            );
            if told.complaint.is_some() || !told.has_audio {
                return cut_off(what + &complaint, told.frames);
            }
            notes.push(format!("The video may be cut off: {what}, or its sound is longer"));
        }
        _ => {}
    }
    if let Some(what) = told.complaint.as_ref().filter(|_| notes.is_empty()) {
        notes.push(format!("ffmpeg found damage in the video, and what it shows there is a guess: {what}"));
    }
    Ok(notes)
}

/// Returns the word after `key`, up to a comma or a space.
fn after<'a>(line: &'a str, key: &str) -> Option<&'a str> {
    let rest = line.split_once(key)?.1.trim_start();
    rest.split([',', ' ']).next()
}

/// Converts hours, minutes and seconds to seconds.
fn seconds(clock: &str) -> Option<f64> {
    clock.split(':').try_fold(0.0, |sum, part| part.parse::<f64>().ok().map(|v| sum * 60.0 + v))
}

/// Removes the prefixes that ffmpeg puts before a line: `[mov @ 0x55] [error] stream 0: partial file`.
fn plain(line: &str) -> String {
    let mut rest = line;
    while let Some((_, tail)) = rest.strip_prefix('[').and_then(|r| r.split_once(']')) {
        rest = tail.trim_start();
    }
    rest.to_owned()
}

/// Returns the frame rate in ffmpeg's description of the input: `… 640x512, 25 fps, …`.
fn announced_speed(line: &str) -> Option<f32> {
    let speed = line.split(',').find_map(|part| part.trim().strip_suffix(" fps"))?;
    // Thousands are abbreviated: "1k".
    let (digits, factor) = speed.strip_suffix('k').map_or((speed, 1.0), |digits| (digits, 1000.0));
    digits.parse().ok().map(|fps: f32| fps * factor).filter(|fps| fps.is_finite() && *fps > 0.0)
}

#[cfg(test)]
#[path = "tests/ffmpeg.rs"]
mod tests;
