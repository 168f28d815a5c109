//! Videos that only an installed `ffmpeg` program can read. Short ones are unpacked once into lossless
//! pictures; of long ones, frames are decoded as they are asked for. What the program says about a video is
//! compared with what the file promises.

use super::{
    decoding::Decoding,
    h264::cut_off,
    read,
    recording::{FrameFiles, Picture, Recording, Selection},
    times::mean_speed,
};
use crate::{Error, Result};
use command::{WHOLE_PICTURES, add_filters};
use listing::Listing;
use messages::{Told, compare};
use std::{
    path::{Path, PathBuf},
    process::ExitStatus,
    sync::{Arc, Mutex, PoisonError},
};
use stream::Process;
use tempfile::TempDir;

mod command;
mod listing;
mod messages;
mod stream;

pub(super) use messages::damage;
pub(super) use stream::Stream;

/// Decoding of the videos of one recording that ffmpeg reads.
pub(super) type Shared = Arc<Mutex<Decoding<Process>>>;

/// The program, wherever it is installed.
pub(super) const PROGRAM: &str = "ffmpeg";
/// Number of pixels of all frames up to which a video is unpacked: 260 frames of 1920×1080.
const MOST_UNPACKED_PIXELS: u64 = 1 << 29;

/// Kind of file that holds a video.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Container {
    Mp4,
    Other,
}

/// A video that is not decoded here.
#[derive(Clone, Debug)]
pub(super) struct Unread {
    /// The ffmpeg program.
    pub program: PathBuf,
    pub path: PathBuf,
    /// The file that ffmpeg reads: `path`, or what was taken out of it.
    pub input: PathBuf,
    /// ffmpeg's name of the form of that file, if the file does not say it.
    pub form: Option<&'static str>,
    pub kind: Container,
    /// Number of frames that have to come, as the index tells, or the file that the video lies in. `None` if
    /// neither does.
    pub promised: Option<usize>,
    /// `true` if an edit list is followed, which hides frames at the ends: they are not promised.
    pub follows_edits: bool,
    /// The reason why it is not decoded here, without a full stop.
    pub why_not_here: String,
}

impl Unread {
    /// Returns the largest number of frames that are used. Where ffmpeg follows an edit list, one more may come:
    /// the list's clock rounds.
    fn most_frames(&self) -> usize {
        self.promised.filter(|_| self.follows_edits).unwrap_or(usize::MAX)
    }
}

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

/// Opens the selected frames. `shared` is that of the videos of the same recording.
pub(super) fn open(video: Unread, selection: &Selection, shared: Shared) -> Result<Recording> {
    open_within(video, selection, shared, MOST_UNPACKED_PIXELS)
}

/// Opens the selected frames; videos of more than `most` pixels are not unpacked.
fn open_within(video: Unread, selection: &Selection, shared: Shared, most: u64) -> Result<Recording> {
    let Selection { first, last, every } = *selection;
    if last.is_some_and(|last| last < first || video.promised.is_some_and(|all| last >= all)) {
        let there = video.promised.map_or(String::new(), |all| format!(", the video has {all}"));
        let what = format!("frames {first} to {} are asked for{there}", last.unwrap_or(first));
        return Err(Error::input_at(&video.path, what, "Look at [frames] in its settings."));
    }
    let (listing, told) = Listing::of_packets(&video)?;
    let all = listing.as_ref().map_or_else(|| told.usual_frames(), |listing| listing.ticks.len());
    let used = last.map_or(all, |last| all.min(last + 1)).saturating_sub(first).div_ceil(every.max(1));
    let (width, height) = told.announced_size.unwrap_or_default();
    if used as u64 * width as u64 * height as u64 <= most {
        return unpack(&video, selection);
    }
    stream(video, listing, told, selection, shared)?.select(selection)
}

/// Makes a recording whose frames are decoded as they are asked for, of all frames of a video.
fn stream(
    video: Unread,
    listing: Option<Listing>,
    mut told: Told,
    selection: &Selection,
    shared: Shared,
) -> Result<Recording> {
    let compared = listing.map(|mut listing| Ok((listing.compare_ends(&video)?, listing))).transpose()?;
    let (listing, there, size) = if let Some((Some((there, size)), listing)) = compared {
        told.count_listed(&listing.ticks, listing.tick_s);
        (listing, there, size)
    } else {
        told = Listing::of_pictures(&video)?;
        let listing = Listing::of_decoded(&told).zip(told.size).ok_or_else(|| {
            let what = "its frames have no times, and it is too long to be unpacked whole";
            Error::input_at(&video.path, what, "Convert it to H.264 in mp4.")
        })?;
        (listing.0, told.frames, listing.1)
    };
    if there < listing.ticks.len() && selection.last.is_none_or(|last| last >= there) {
        let what = format!("it lists {} frames, {there} could be decoded", listing.ticks.len());
        return Err(cut_off(&video.path, &what, there));
    }
    let notes = compare(&video, selection, &told, there)?;
    let (path, used) = (video.path.clone(), there.min(video.most_frames()));
    let stream = Arc::new(Stream::new(video, listing, size, shared));
    let frame = |index| {
        FrameFiles::new(format!("{index:06}"), Picture::Stream { stream: Arc::clone(&stream), index })
    };
    let mut recording = Recording::new(&path, size, (0..used).map(frame).collect());
    recording.seconds = told.seconds;
    recording.seconds.truncate(used);
    recording.frames_per_second = mean_speed(&recording.seconds).or(told.frames_per_second);
    recording.notes = notes;
    recording.shape_pixels(told.pixel_aspect);
    recording.read_by_ffmpeg.push(path);
    Ok(recording)
}

/// Unpacks the selected frames into a temporary folder that lives as long as the recording.
fn unpack(video: &Unread, selection: &Selection) -> Result<Recording> {
    let (places, scratch) = (std::env::temp_dir(), scratch_folder()?);
    let Selection { first, every, .. } = *selection;
    let (status, told) = run_unpacking(video, selection, scratch.path())?;
    if told.is_full {
        return Err(Error::Missing {
            what: format!("the temporary folder {} is full: the video is unpacked there", places.display()),
            hint: "Free some space, or set TMPDIR to a folder with more.".into(),
        });
    }
    let mut pictures = read::list(scratch.path(), &["png"])?;
    if !status.success() || pictures.is_empty() {
        return Err(unreadable(video, &told));
    }
    let notes = compare(video, selection, &told, pictures.len())?;
    if let Some(last) = selection.last {
        pictures.truncate((last - selection.first) / selection.every.max(1) + 1);
    }
    pictures.truncate(video.most_frames().saturating_sub(first).div_ceil(every.max(1)));
    let mut recording = Recording::of_pictures(&video.path, &pictures)?;
    for (k, frame) in recording.frames.iter_mut().enumerate() {
        frame.name = format!("{:06}", first + k * every);
    }
    let used = (first..).step_by(every.max(1)).take(pictures.len());
    let seconds: Option<Vec<f64>> = used.map(|i| told.seconds.get(i).copied()).collect();
    recording.seconds = seconds.unwrap_or_default();
    recording.frames_per_second = mean_speed(&told.seconds).or(told.frames_per_second);
    recording.notes.extend(notes);
    recording.shape_pixels(told.pixel_aspect);
    recording.scratch.push(scratch);
    recording.read_by_ffmpeg.push(video.path.clone());
    Ok(recording)
}

/// Returns the error about a video of which no frames came out.
fn unreadable(video: &Unread, told: &Told) -> Error {
    if let Some(what) = told.no_video() {
        return Error::input_at(&video.path, what, "Open the file that holds the pictures.");
    }
    let last_line = if told.last_line.is_empty() { "no frames came out" } else { &told.last_line };
    Error::input_at(
        &video.path,
        format!("the video cannot be read here ({}), nor by ffmpeg: {last_line}", video.why_not_here),
        "The file may be damaged, or the frames asked for in its settings may not exist.",
    )
}

/// Runs ffmpeg and collects its messages.
fn run_unpacking(video: &Unread, selection: &Selection, folder: &Path) -> Result<(ExitStatus, Told)> {
    let Selection { first, last, every } = *selection;
    let range = last.map_or_else(|| format!("gte(n,{first})"), |last| format!("between(n,{first},{last})"));
    let mut command = video.reading(None);
    let is_used = format!("{range}*not(mod(n-{first},{every}))");
    add_filters(&mut command, &format!("showinfo,{WHOLE_PICTURES},select='{is_used}'"));
    command.args(["-pix_fmt", "rgb24", "-compression_level", "1", "-start_number", "0"]);
    if let Some(last) = last.filter(|last| *last >= first) {
        command.args(["-frames:v", &((last - first) / every.max(1) + 1).to_string()]);
    }
    let folder = folder.to_string_lossy().replace('%', "%%");
    command.arg(Path::new(&folder).join("%08d.png"));
    let mut child = command.spawn().map_err(|e| video.missing(&e))?;
    let told = child.stderr.take().map_or_else(Told::default, Told::listen);
    Ok((child.wait().map_err(|e| video.missing(&e))?, told))
}
