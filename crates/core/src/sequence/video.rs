//! Video files. H.264 in an mp4 container is decoded here, frame by frame as asked for; anything else is
//! unpacked once into lossless pictures by an installed `ffmpeg` program.
//!
//! Any frame can be asked for in any order: decoding starts at the last picture before it that needs no
//! other (an IDR picture), or goes on from where the last request ended, and the frames that come by are
//! kept while [`CACHE_BYTES`] allow. Colours follow BT.601 with limited range, whatever the file says.

use super::{
    Layout,
    layout::{Frame, Picture, Recording},
    mp4::{CodedPicture, Mp4},
    read,
    settings::Selection,
};
use crate::{Error, Result, camera::check_image_size};
use image::RgbImage;
use openh264::{
    OpenH264API,
    decoder::{DecodedYUV, Decoder, DecoderConfig, Flush},
    formats::YUVSource,
};
use std::{
    collections::BTreeMap,
    fs::File,
    io::{Read, Seek, SeekFrom},
    ops::Range,
    path::{Path, PathBuf},
    process::Command,
    sync::{Arc, Mutex, PoisonError},
};

/// File name endings (lower case) of videos, for folders that hold a single one.
pub(super) const VIDEOS: &[&str] =
    &["mp4", "m4v", "mov", "mkv", "avi", "webm", "mpg", "mpeg", "ts", "wmv", "flv"];

/// Memory for decoded frames of one video.
const CACHE_BYTES: usize = 256 << 20;

/// NAL unit type of a slice of an IDR picture (H.264, table 7-1).
const IDR_SLICE: u8 = 5;

pub(super) fn open(path: &Path, selection: &Selection) -> Result<Recording> {
    expect_video(path)?;
    match H264::open(path) {
        Ok(video) => open_h264(path, video, selection),
        Err(why) => open_with_ffmpeg(path, selection, Path::new("ffmpeg"), &why),
    }
}

fn open_h264(path: &Path, video: H264, selection: &Selection) -> Result<Recording> {
    let size = (video.width, video.height);
    let frames_per_second = video.frames_per_second;
    let indices = selection.indices(video.samples.len()).map_err(|what| Error::input_at(path, what, ""))?;
    let video = Arc::new(video);
    let frame =
        |index| Frame::new(format!("{index:06}"), Picture::Video { video: Arc::clone(&video), index });
    let mut recording = Recording::new(path, Layout::Video, size, indices.into_iter().map(frame).collect());
    recording.frames_per_second = frames_per_second;
    Ok(recording)
}

/// Errs where the first bytes are no kind of video.
fn expect_video(path: &Path) -> Result<()> {
    let mut head = Vec::new();
    let file = File::open(path).map_err(|e| Error::io("open the file", path, e))?;
    file.take(16).read_to_end(&mut head).map_err(|e| Error::io("read the file", path, e))?;
    let starts: [&[u8]; 9] = [
        b"\x1a\x45\xdf\xa3",     // Matroska, WebM
        b"RIFF",                 // AVI
        b"\x00\x00\x01\xba",     // MPEG program stream
        b"\x00\x00\x01\xb3",     // MPEG video
        b"\x00\x00\x00\x01",     // H.264, H.265 elementary stream
        b"\x00\x00\x01",         // the same
        b"\x47",                 // MPEG transport stream
        b"FLV",                  // Flash
        b"\x30\x26\xb2\x75\x8e", // Windows Media
    ];
    if head.get(4..8) == Some(b"ftyp") || starts.iter().any(|start| head.starts_with(start)) {
        return Ok(());
    }
    Err(Error::input_at(
        path,
        "this file is not a video",
        "Open a video file, or the folder that holds the frames.",
    ))
}

/// An H.264 video in an mp4 file.
pub(super) struct H264 {
    path: PathBuf,
    width: usize,
    height: usize,
    frames_per_second: Option<f32>,
    /// Bytes of the length before each NAL unit.
    length_bytes: usize,
    /// Sequence and picture parameter sets with start codes.
    parameter_sets: Vec<u8>,
    /// In decoding order; as many as frames.
    samples: Vec<CodedPicture>,
    /// The sample of each frame.
    shown: Vec<usize>,
    /// Where decoding can start; ascending, the first at sample 0.
    starts: Vec<Start>,
    state: Mutex<State>,
}

/// An IDR picture: its place in decoding order and in the order of showing.
#[derive(Clone, Copy)]
struct Start {
    sample: usize,
    frame: usize,
}

#[derive(Default)]
struct State {
    running: Option<Running>,
    cache: Cache,
}

/// A decoder on its way.
struct Running {
    decoder: Decoder,
    file: File,
    next_sample: usize,
    /// The frame that comes out next.
    next_frame: usize,
}

impl std::fmt::Debug for H264 {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("H264")
            .field("path", &self.path)
            .field("frames", &self.samples.len())
            .finish_non_exhaustive()
    }
}

impl H264 {
    /// Reads the tables of `path` and decodes one frame; says why where that is not possible.
    fn open(path: &Path) -> Result<Self, String> {
        let mut video = Self::read_tables(path)?;
        video.starts = video.find_starts().map_err(|e| e.to_string())?;
        video.frame(0).map_err(|e| e.to_string())?;
        Ok(video)
    }

    fn read_tables(path: &Path) -> Result<Self, String> {
        let mp4 = Mp4::read(path)?;
        check_image_size(mp4.width, mp4.height)?;
        let mut parameter_sets = Vec::new();
        mp4.parameter_sets.iter().for_each(|unit| push_unit(&mut parameter_sets, unit));
        Ok(Self {
            path: path.to_owned(),
            width: mp4.width,
            height: mp4.height,
            frames_per_second: mean_speed(&mp4),
            length_bytes: mp4.length_bytes,
            parameter_sets,
            starts: candidates(&mp4.pictures),
            shown: in_order_of_showing(&mp4.pictures),
            samples: mp4.pictures,
            state: Mutex::default(),
        })
    }

    /// Those of the candidates that are IDR pictures: after others, references may reach back.
    fn find_starts(&self) -> Result<Vec<Start>> {
        let mut file = self.open_file()?;
        let mut starts = Vec::new();
        for &start in &self.starts {
            let sample = self.read_sample(&mut file, start.sample)?;
            let is_idr = units(&sample, self.length_bytes)
                .any(|unit| unit.first().is_some_and(|b| b & 31 == IDR_SLICE));
            if is_idr || start.sample == 0 {
                starts.push(start);
            }
        }
        Ok(starts)
    }

    /// The last frame before `index`, or `index` itself, at which decoding can start.
    pub(super) fn entry_before(&self, index: usize) -> usize {
        self.starts[self.starts.partition_point(|s| s.frame <= index).max(1) - 1].frame
    }

    /// Coded bytes of some frames in the order of showing.
    pub(super) fn coded_bytes(&self, frames: Range<usize>) -> u64 {
        self.shown[frames].iter().map(|&sample| self.samples[sample].size as u64).sum()
    }

    /// Reads the coded bytes of some frames in the order of showing.
    pub(super) fn read_coded(&self, frames: Range<usize>, mut take: impl FnMut(&[u8])) -> Result<()> {
        let mut file = self.open_file()?;
        self.shown[frames].iter().try_for_each(|&sample| {
            take(&self.read_sample(&mut file, sample)?);
            Ok(())
        })
    }

    /// Frame `index` in the order of showing.
    pub(super) fn frame(&self, index: usize) -> Result<RgbImage> {
        let mut state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(frame) = state.cache.get(index) {
            return Ok(frame.clone());
        }
        let State { running, cache } = &mut *state;
        let start = self.starts[self.starts.partition_point(|s| s.frame <= index).max(1) - 1];
        let on_the_way = running.take().filter(|r| (start.frame..=index).contains(&r.next_frame));
        let mut decoder = match on_the_way {
            Some(decoder) => decoder,
            None => self.start_at(start)?,
        };
        while decoder.next_frame <= index {
            self.advance(&mut decoder, cache, index)?;
        }
        *running = Some(decoder);
        cache.get(index).cloned().ok_or_else(|| self.damaged(index, "the decoder left it out"))
    }

    fn start_at(&self, start: Start) -> Result<Running> {
        let config = DecoderConfig::new().flush_after_decode(Flush::NoFlush);
        let mut decoder = Decoder::with_api_config(OpenH264API::from_source(), config)
            .map_err(|e| self.damaged(start.frame, &e.to_string()))?;
        decoder.decode(&self.parameter_sets).map_err(|e| self.damaged(start.frame, &e.to_string()))?;
        Ok(Running { decoder, file: self.open_file()?, next_sample: start.sample, next_frame: start.frame })
    }

    /// Feeds one sample; what comes out goes into the cache.
    fn advance(&self, running: &mut Running, cache: &mut Cache, wanted: usize) -> Result<()> {
        let next = running.next_sample;
        let start = self.starts.iter().find(|s| s.sample == next && next > 0);
        // Before a new start, and at the end, everything that waits for its turn comes out.
        if start.is_some() || next == self.samples.len() {
            self.flush(running, cache, wanted)?;
        }
        if let Some(start) = start {
            if running.next_frame != start.frame {
                return Err(self.damaged(running.next_frame, "the decoder left it out"));
            }
            // A fresh decoder: the emptied one runs out of picture buffers.
            *running = self.start_at(*start)?;
        }
        if next == self.samples.len() {
            return match running.next_frame {
                frame if frame > wanted => Ok(()),
                frame => Err(self.damaged(wanted, &format!("the video ends after {frame} frames"))),
            };
        }
        let sample = self.read_sample(&mut running.file, next)?;
        let mut stream = Vec::with_capacity(sample.len() + 64);
        units(&sample, self.length_bytes).for_each(|unit| push_unit(&mut stream, unit));
        let picture = running.decoder.decode(&stream).map_err(|e| self.damaged(wanted, &e.to_string()))?;
        if let Some(picture) = picture {
            cache.insert(running.next_frame, self.to_rgb(&picture, running.next_frame)?, wanted);
            running.next_frame += 1;
        }
        running.next_sample += 1;
        Ok(())
    }

    /// Fetches the pictures that the decoder still holds back to show them in order.
    fn flush(&self, running: &mut Running, cache: &mut Cache, wanted: usize) -> Result<()> {
        let pictures = running.decoder.flush_remaining().map_err(|e| self.damaged(wanted, &e.to_string()))?;
        for picture in &pictures {
            cache.insert(running.next_frame, self.to_rgb(picture, running.next_frame)?, wanted);
            running.next_frame += 1;
        }
        Ok(())
    }

    fn to_rgb(&self, picture: &DecodedYUV<'_>, index: usize) -> Result<RgbImage> {
        let (width, height) = picture.dimensions();
        if (width, height) != (self.width, self.height) {
            return Err(
                self.damaged(index, &format!("it is {width}×{height}, not {}×{}", self.width, self.height))
            );
        }
        let mut frame = RgbImage::new(width as u32, height as u32);
        picture.write_rgb8(frame.as_mut());
        Ok(frame)
    }

    fn open_file(&self) -> Result<File> {
        File::open(&self.path).map_err(|e| Error::io("open the video", &self.path, e))
    }

    fn read_sample(&self, file: &mut File, i: usize) -> Result<Vec<u8>> {
        let fail = |e| Error::io("read the video", &self.path, e);
        let mut bytes = Vec::new();
        file.seek(SeekFrom::Start(self.samples[i].offset)).map_err(fail)?;
        file.take(self.samples[i].size as u64).read_to_end(&mut bytes).map_err(fail)?;
        Ok(bytes)
    }

    fn damaged(&self, frame: usize, why: &str) -> Error {
        Error::input_at(&self.path, format!("frame {frame} of the video cannot be decoded: {why}"), "")
    }
}

/// Frames per second from the first to the last time of showing.
fn mean_speed(mp4: &Mp4) -> Option<f32> {
    let times = || mp4.pictures.iter().map(|picture| picture.shown_at);
    let ticks = times().max()?.checked_sub(times().min()?)?;
    let speed = (mp4.pictures.len() - 1) as f64 * f64::from(mp4.timescale) / ticks as f64;
    (speed.is_finite() && speed > 0.0).then_some(speed as f32)
}

/// Samples in the order of showing.
fn in_order_of_showing(pictures: &[CodedPicture]) -> Vec<usize> {
    let mut by_time: Vec<_> = (0..pictures.len()).collect();
    by_time.sort_by_key(|&i| (pictures[i].shown_at, i));
    by_time
}

/// Sync samples with their place in the order of showing, where nothing earlier is shown after them.
fn candidates(pictures: &[CodedPicture]) -> Vec<Start> {
    let by_time = in_order_of_showing(pictures);
    let mut frame_of = vec![0; by_time.len()];
    by_time.iter().enumerate().for_each(|(frame, &sample)| frame_of[sample] = frame);
    let mut latest_before = None;
    let mut starts = Vec::new();
    for (sample, &frame) in frame_of.iter().enumerate() {
        let closed = frame == sample && latest_before.is_none_or(|latest| latest < frame);
        if sample == 0 || (pictures[sample].is_sync && closed) {
            starts.push(Start { sample, frame: sample });
        }
        latest_before = latest_before.max(Some(frame));
    }
    starts
}

/// The NAL units of a sample; stops where a length leads outside.
fn units(sample: &[u8], length_bytes: usize) -> impl Iterator<Item = &[u8]> {
    let mut rest = sample;
    std::iter::from_fn(move || {
        let (length, tail) = rest.split_at_checked(length_bytes)?;
        let length = length.iter().fold(0_usize, |n, &b| n << 8 | usize::from(b));
        let (unit, tail) = tail.split_at_checked(length)?;
        rest = tail;
        Some(unit)
    })
}

/// Appends a NAL unit with its start code (H.264, annex B).
fn push_unit(stream: &mut Vec<u8>, unit: &[u8]) {
    stream.extend_from_slice(&[0, 0, 0, 1]);
    stream.extend_from_slice(unit);
}

/// Decoded frames; those farthest from the last request go first.
#[derive(Default)]
struct Cache {
    frames: BTreeMap<usize, RgbImage>,
    bytes: usize,
}

impl Cache {
    fn get(&self, index: usize) -> Option<&RgbImage> {
        self.frames.get(&index)
    }

    /// Adds a frame that came by on the way to `wanted`.
    fn insert(&mut self, index: usize, frame: RgbImage, wanted: usize) {
        self.bytes += frame.as_raw().len();
        if let Some(old) = self.frames.insert(index, frame) {
            self.bytes -= old.as_raw().len();
        }
        while self.bytes > CACHE_BYTES && self.frames.len() > 1 {
            let (Some((&low, _)), Some((&high, _))) =
                (self.frames.first_key_value(), self.frames.last_key_value())
            else {
                return;
            };
            let farthest = if wanted.abs_diff(low) > wanted.abs_diff(high) { low } else { high };
            self.bytes -= self.frames.remove(&farthest).map_or(0, |f| f.as_raw().len());
        }
    }
}

/// Unpacks the selected frames into a temporary folder that lives as long as the recording.
fn open_with_ffmpeg(
    path: &Path,
    selection: &Selection,
    program: &Path,
    why_not_here: &str,
) -> Result<Recording> {
    let scratch = tempfile::Builder::new().prefix("surgtpgs-video-").tempdir();
    let scratch = scratch.map_err(|e| Error::io("make a temporary folder", std::env::temp_dir(), e))?;
    let Selection { first, last, every } = *selection;
    let range = last.map_or_else(|| format!("gte(n,{first})"), |last| format!("between(n,{first},{last})"));
    let output = Command::new(program)
        .args(["-hide_banner", "-nostats", "-nostdin", "-i"])
        .arg(path)
        // A fresh steady clock: by its own, ffmpeg would repeat and drop frames to keep a steady rate.
        .args(["-map", "0:v:0", "-vf"])
        .arg(format!("select='{range}*not(mod(n-{first},{every}))',setpts=N/(25*TB)"))
        .args(["-r", "25", "-pix_fmt", "rgb24", "-compression_level", "1", "-start_number", "0"])
        .arg(scratch.path().join("%08d.png"))
        .output()
        .map_err(|e| Error::Missing {
            what: format!("this video cannot be read here ({why_not_here}), nor by the program ffmpeg ({e})"),
            hint: "Install ffmpeg, or convert the video to H.264 in mp4 or to a folder of PNG frames."
                .to_owned(),
        })?;
    let messages = String::from_utf8_lossy(&output.stderr);
    let pictures = read::list(scratch.path(), &["png"])?;
    if !output.status.success() || pictures.is_empty() {
        let last_line = messages.lines().rfind(|l| !l.trim().is_empty()).unwrap_or("no frames came out");
        return Err(Error::input_at(
            path,
            format!("the video cannot be read here ({why_not_here}), nor by ffmpeg: {}", last_line.trim()),
            "The file may be damaged, or the frames asked for in its settings may not exist.",
        ));
    }
    let mut recording = Recording::of_pictures(path, Layout::Video, &pictures)?;
    for (k, frame) in recording.frames.iter_mut().enumerate() {
        frame.name = format!("{:06}", first + k * every);
    }
    recording.frames_per_second = announced_speed(&messages);
    recording.scratch = Some(scratch);
    recording.unpacked_from = Some(path.to_owned());
    Ok(recording)
}

/// The speed in ffmpeg's description of the input: `… 640x512, 25 fps, …`.
fn announced_speed(messages: &str) -> Option<f32> {
    let input = messages.lines().find(|line| line.contains("Video:"))?;
    let speed = input.split(',').find_map(|part| part.trim().strip_suffix(" fps"))?;
    speed.parse().ok().filter(|fps: &f32| fps.is_finite() && *fps > 0.0)
}
