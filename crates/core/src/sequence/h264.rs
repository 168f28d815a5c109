//! H.264 in an mp4 container or as a bare stream, decoded frame by frame.
//!
//! Frames can be requested in any order. Decoding starts at the last picture before the frame that needs
//! no other (an IDR picture), or continues where the last request ended. Frames decoded on the way are
//! kept in a [`Cache`].

use super::{
    decoding::{Cache, Decoding, Position},
    edit_list::Cut,
    mp4::{CodedPicture, Description, Framing, Mp4},
    nal::{IDR_SLICE, START_CODE, is_slice, sequence_parameters, start_code},
    read,
    times::speed_of,
};
use crate::{
    Error, Result,
    camera::check_image_size,
    reading::{Pieces, PiecesReader},
};
use h264_reader::nal::sps::ChromaFormat;
use image::RgbImage;
use openh264::{
    OpenH264API,
    decoder::{DecodedYUV, Decoder, DecoderConfig, Flush},
    formats::YUVSource,
};
use std::{
    io::{BufReader, Read, Seek, SeekFrom},
    ops::Range,
    path::Path,
    sync::{Arc, Mutex, PoisonError},
};

/// An H.264 video.
pub(super) struct H264 {
    file: Pieces,
    pub frames_per_second: Option<f32>,
    /// Seconds per tick of the times of pictures.
    tick_s: f64,
    /// Descriptions of how to decode samples, the first from sample 0 on.
    pub descriptions: Vec<Description>,
    /// All samples, in decoding order.
    samples: Vec<CodedPicture>,
    /// The sample of each frame that can be shown, up to the last used one: fewer if the file is cut off.
    shown: Vec<usize>,
    /// The frames that are used. Others are decoded where used ones need them.
    pub cut: Cut,
    /// The points where decoding can start; ascending, the first at sample 0.
    starts: Vec<Start>,
    /// Shared by the videos of one recording, of which one at a time is decoded.
    state: Arc<Mutex<Decoding<Running>>>,
}

/// An IDR picture: its position in decoding order and in the order of showing.
#[derive(Clone, Copy)]
struct Start {
    sample: usize,
    frame: usize,
}

/// A decoder in the middle of the video.
pub(super) struct Running {
    decoder: Decoder,
    file: PiecesReader,
    next_sample: usize,
    /// The next frame that comes out.
    next_frame: usize,
}

impl Position for Running {
    fn next_frame(&self) -> usize {
        self.next_frame
    }
}

impl std::fmt::Debug for H264 {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("H264")
            .field("path", &self.file.path())
            .field("frames", &self.samples.len())
            .finish_non_exhaustive()
    }
}

impl H264 {
    /// Decodes one frame of the track; the error says why that is not possible. `state` is that of the videos
    /// of the same recording.
    pub(super) fn open(
        file: &Pieces,
        mp4: Mp4,
        state: Arc<Mutex<Decoding<Running>>>,
    ) -> Result<Self, String> {
        let Some(Description { width, height, .. }) = mp4.descriptions.first() else {
            return Err("there is no H.264 video in it".to_owned());
        };
        check_image_size(*width, *height)?;
        if mp4.is_turned {
            return Err("its pictures are stored turned or mirrored".to_owned());
        }
        let mut units = mp4.descriptions.iter().flat_map(|description| &description.parameter_sets);
        if !units.all(|unit| may_be_420(unit)) {
            return Err("its colours are not coded as 4:2:0".to_owned());
        }
        let end = mp4.cut.used.start + mp4.frames_there();
        let mut video = Self {
            file: file.clone(),
            frames_per_second: frames_per_second(&mp4),
            tick_s: 1.0 / f64::from(mp4.timescale),
            starts: candidates(&mp4),
            shown: mp4.in_order_of_showing(),
            cut: mp4.cut,
            descriptions: mp4.descriptions,
            samples: mp4.pictures,
            state,
        };
        video.samples.truncate(mp4.present);
        video.shown.truncate(end);
        video.starts = video.find_starts().map_err(|e| e.to_string())?;
        video.frame(video.cut.used.start).map_err(|e| e.to_string())?;
        Ok(video)
    }

    /// Returns the frames that are used and can be shown.
    pub(super) fn used(&self) -> Range<usize> {
        self.cut.used.start..self.shown.len()
    }

    /// Returns the columns and rows of the first frame, which all others share.
    pub(super) fn size(&self) -> (usize, usize) {
        (self.descriptions[0].width, self.descriptions[0].height)
    }

    /// Returns the description with which a sample is decoded.
    fn description(&self, sample: usize) -> &Description {
        &self.descriptions[self.descriptions.partition_point(|d| d.from <= sample).max(1) - 1]
    }

    /// Returns those candidates that are IDR pictures: after other pictures, references may reach back.
    fn find_starts(&self) -> Result<Vec<Start>> {
        let mut file = BufReader::new(self.open_file()?);
        let mut starts = Vec::new();
        for &start in self.starts.iter().filter(|s| s.sample < self.samples.len()) {
            if start.sample == 0 || self.is_idr(&mut file, start.sample).map_err(|e| self.unreadable(e))? {
                starts.push(start);
            }
        }
        Ok(starts)
    }

    /// Tells if a sample is an IDR picture, by the kind of its first slice; no more of it is read.
    fn is_idr(&self, file: &mut BufReader<PiecesReader>, sample: usize) -> std::io::Result<bool> {
        let CodedPicture { offset, size, is_sync, .. } = self.samples[sample];
        let Framing::Lengths(length_bytes) = self.description(sample).framing else { return Ok(is_sync) };
        let here = file.stream_position()?;
        file.seek_relative(offset as i64 - here as i64)?;
        let mut left = size;
        while left > length_bytes {
            let mut head = [0; 5];
            let head = &mut head[..=length_bytes];
            file.read_exact(head)?;
            match head[length_bytes] & 31 {
                IDR_SLICE => return Ok(true),
                1..IDR_SLICE => return Ok(false),
                _ => {}
            }
            let unit = head[..length_bytes].iter().fold(0_usize, |n, &b| n << 8 | usize::from(b));
            left = left.saturating_sub(length_bytes.saturating_add(unit));
            file.seek_relative(unit as i64 - 1)?;
        }
        Ok(false)
    }

    /// Returns the last frame up to `index` at which decoding starts.
    pub(super) fn entry_before(&self, index: usize) -> usize {
        self.start_before(index).frame
    }

    /// Returns the time at which frame `index` is shown, seconds on the file's own clock.
    pub(super) fn seconds(&self, index: usize) -> f64 {
        self.tick_s * self.samples[self.shown[index]].shown_at as f64
    }

    /// Returns the place of frame `index` in decoding order.
    pub(super) fn sample_of(&self, index: usize) -> usize {
        self.shown[index]
    }

    /// Returns the place in decoding order at which decoding starts for frame `index`.
    pub(super) fn start_of(&self, index: usize) -> usize {
        self.start_before(index).sample
    }

    /// Returns the last start that is not behind frame `index`.
    fn start_before(&self, index: usize) -> Start {
        self.starts[self.starts.partition_point(|s| s.frame <= index).max(1) - 1]
    }

    /// Returns the number of coded bytes of some pictures, given by their places in decoding order.
    pub(super) fn coded_bytes(&self, pictures: &[usize]) -> u64 {
        pictures.iter().map(|&sample| self.samples[sample].size as u64).sum()
    }

    /// Reads all that decides what some pictures show: their coded bytes, and what says how these are decoded.
    pub(super) fn read_coded(&self, pictures: &[usize], mut take: impl FnMut(&[u8])) -> Result<()> {
        let mut file = self.open_file()?;
        pictures.iter().try_for_each(|&sample| {
            self.description(sample).parameter_sets.iter().for_each(|unit| take(unit));
            take(&self.read_sample(&mut file, sample)?);
            Ok(())
        })
    }

    /// Returns frame `index` in the order of showing.
    pub(super) fn frame(&self, index: usize) -> Result<RgbImage> {
        let mut state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
        let start = self.start_before(index);
        let frame = state.frame(
            self.file.path(),
            (start.frame, index),
            || self.start_at(start),
            |running, cache| self.advance(running, cache, index),
        )?;
        frame.ok_or_else(|| self.damaged(index, "the decoder left it out"))
    }

    fn start_at(&self, start: Start) -> Result<Running> {
        let config = DecoderConfig::new().flush_after_decode(Flush::NoFlush);
        let mut decoder = Decoder::with_api_config(OpenH264API::from_source(), config)
            .map_err(|e| self.damaged(start.frame, &in_short(&e)))?;
        let mut stream = Vec::new();
        self.description(start.sample).parameter_sets.iter().for_each(|unit| push_unit(&mut stream, unit));
        decoder.decode(&stream).map_err(|e| self.damaged(start.frame, &in_short(&e)))?;
        Ok(Running { decoder, file: self.open_file()?, next_sample: start.sample, next_frame: start.frame })
    }

    /// Feeds one sample to the decoder; pictures that come out go into the cache.
    fn advance(&self, running: &mut Running, cache: &mut Cache, wanted: usize) -> Result<()> {
        let next = running.next_sample;
        let start = self.starts.binary_search_by_key(&next, |s| s.sample).ok().filter(|_| next > 0);
        let start = start.map(|i| &self.starts[i]);
        // Before a new start, and at the end, all pictures that the decoder still holds come out.
        if start.is_some() || next == self.samples.len() {
            self.flush(running, cache, wanted)?;
        }
        if let Some(start) = start {
            if running.next_frame != start.frame {
                return Err(self.damaged(running.next_frame, "the decoder left it out"));
            }
            // A new decoder is needed: the flushed one runs out of picture buffers.
            *running = self.start_at(*start)?;
        }
        if next == self.samples.len() {
            return match running.next_frame {
                frame if frame > wanted => Ok(()),
                frame => Err(self.damaged(wanted, &format!("the video ends after {frame} frames"))),
            };
        }
        let sample = self.read_sample(&mut running.file, next)?;
        if !units(&sample, self.description(next).framing).any(is_slice) {
            // The decoder would go on without a word, and every later picture would count as an earlier frame.
            let frame = self.shown.iter().position(|shown| *shown == next).unwrap_or(wanted);
            return Err(self.damaged(frame, "there is no picture in it"));
        }
        let mut stream = Vec::with_capacity(sample.len() + 64);
        let Description { from, framing, parameter_sets, .. } = self.description(next);
        if *from == next && next > 0 {
            parameter_sets.iter().for_each(|unit| push_unit(&mut stream, unit));
        }
        units(&sample, *framing).for_each(|unit| push_unit(&mut stream, unit));
        let picture = running.decoder.decode(&stream).map_err(|e| self.damaged(wanted, &in_short(&e)))?;
        if let Some(picture) = picture {
            cache.insert(running.next_frame, self.to_rgb(&picture, running.next_frame)?, wanted);
            running.next_frame += 1;
        }
        running.next_sample += 1;
        Ok(())
    }

    /// Fetches the pictures that the decoder still holds back to show them in order.
    fn flush(&self, running: &mut Running, cache: &mut Cache, wanted: usize) -> Result<()> {
        let pictures = running.decoder.flush_remaining().map_err(|e| self.damaged(wanted, &in_short(&e)))?;
        for picture in &pictures {
            cache.insert(running.next_frame, self.to_rgb(picture, running.next_frame)?, wanted);
            running.next_frame += 1;
        }
        Ok(())
    }

    fn to_rgb(&self, picture: &DecodedYUV<'_>, index: usize) -> Result<RgbImage> {
        let (width, height) = picture.dimensions();
        if (width, height) != self.size() {
            return Err(other_size(self.file.path(), self.number(index), (width, height), self.size()));
        }
        let mut frame = RgbImage::new(width as u32, height as u32);
        self.descriptions[0].colours.write_rgb8(picture, frame.as_mut());
        Ok(frame)
    }

    fn open_file(&self) -> Result<PiecesReader> {
        self.file.open().map_err(|e| Error::io("open the video", self.file.path(), e))
    }

    fn read_sample(&self, file: &mut PiecesReader, i: usize) -> Result<Vec<u8>> {
        let mut bytes = Vec::new();
        let CodedPicture { offset, size, .. } = self.samples[i];
        file.seek(SeekFrom::Start(offset)).map_err(|e| self.unreadable(e))?;
        file.take(size as u64).read_to_end(&mut bytes).map_err(|e| self.unreadable(e))?;
        Ok(bytes)
    }

    fn unreadable(&self, e: std::io::Error) -> Error {
        Error::io("read the video", self.file.path(), e)
    }

    /// Returns the number of a frame as the user knows it.
    fn number(&self, frame: usize) -> usize {
        frame.saturating_sub(self.cut.used.start)
    }

    fn damaged(&self, frame: usize, why: &str) -> Error {
        let frame = self.number(frame);
        Error::input_at(self.file.path(), format!("frame {frame} of the video cannot be decoded: {why}"), "")
    }
}

/// Returns the frames per second between the first and the last time of showing.
fn frames_per_second(mp4: &Mp4) -> Option<f32> {
    let times = || mp4.pictures.iter().map(|picture| picture.shown_at);
    let ticks = times().max()?.checked_sub(times().min()?)?;
    speed_of(mp4.pictures.len(), ticks as f64, f64::from(mp4.timescale))
}

/// Returns the sync samples with their position in the order of showing, if nothing earlier is
/// shown after them.
fn candidates(mp4: &Mp4) -> Vec<Start> {
    let mut latest_before = None;
    let mut starts = Vec::new();
    for (sample, frame) in mp4.frame_of().into_iter().enumerate() {
        let closed = frame == sample && latest_before.is_none_or(|latest| latest < frame);
        if sample == 0 || (mp4.pictures[sample].is_sync && closed) {
            starts.push(Start { sample, frame: sample });
        }
        latest_before = latest_before.max(Some(frame));
    }
    starts
}

/// Iterates over the NAL units of a sample; stops at a length that leads outside.
fn units(sample: &[u8], framing: Framing) -> impl Iterator<Item = &[u8]> {
    let mut rest = sample;
    std::iter::from_fn(move || match framing {
        Framing::Lengths(length_bytes) => {
            let (length, tail) = rest.split_at_checked(length_bytes)?;
            let length = length.iter().fold(0_usize, |n, &b| n << 8 | usize::from(b));
            let (unit, tail) = tail.split_at_checked(length)?;
            rest = tail;
            Some(unit)
        }
        Framing::StartCodes => {
            let begin = start_code(rest)? + START_CODE.len();
            let length = start_code(&rest[begin..]).unwrap_or(rest.len() - begin);
            let (unit, tail) = rest[begin..].split_at(length);
            rest = tail;
            // Zeros after a unit belong to the next start code.
            let end = unit.iter().rposition(|byte| *byte != 0).map_or(0, |last| last + 1);
            Some(&unit[..end])
        }
    })
}

/// Returns `false` if a sequence parameter set says that colour has another form than half the resolution of
/// brightness in both directions (4:2:0), the only form that the decoder knows.
fn may_be_420(unit: &[u8]) -> bool {
    sequence_parameters(unit).is_none_or(|set| set.chroma_info.chroma_format == ChromaFormat::YUV420)
}

/// Returns the first sentence of the decoder's message; the others tell of its insides.
fn in_short(error: &openh264::Error) -> String {
    let text = error.to_string();
    text.split(". ").next().unwrap_or_default().to_owned()
}

/// Appends a NAL unit with its start code (H.264, annex B).
fn push_unit(stream: &mut Vec<u8>, unit: &[u8]) {
    stream.extend_from_slice(&[0, 0, 0, 1]);
    stream.extend_from_slice(unit);
}

/// Creates the error about a video of which only the first `there` frames are available.
pub(super) fn cut_off(path: &Path, what: &str, there: usize) -> Error {
    let mut hint = "Copy it once more from where it was recorded".to_owned();
    if let Some(last) = there.checked_sub(1) {
        hint += &format!(", or use what is there: {}", use_until(path, last));
    }
    Error::input_at(path, format!("the video is cut off or damaged: {what}"), hint + ".")
}

/// Creates the error about a video whose size changes at `frame`.
pub(super) fn other_size(path: &Path, frame: usize, size: (usize, usize), first: (usize, usize)) -> Error {
    let hint = frame.checked_sub(1).map_or(String::new(), |last| {
        format!("Cut it there into two videos, or use the first part: {}.", use_until(path, last))
    });
    let what =
        format!("frame {frame} of the video is {}×{}, the first is {}×{}", size.0, size.1, first.0, first.1);
    Error::input_at(path, what, hint)
}

/// Names the setting that leaves out everything after frame `last`.
fn use_until(path: &Path, last: usize) -> String {
    let name = read::file_name(path);
    format!(
        "`last = {last}` under `[frames]` in {name}.toml beside it, or in sequence.toml of a folder that holds nothing else"
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parameters_of_another_form_of_colours_are_told_apart() {
        // 16×16 pixels of profile High 4:2:2; the first 4 bits are the number of the set and the form of colours.
        let high = |first: u8| [0x67, 122, 0, 10, first, 0xf7, 0x90];
        assert!(may_be_420(&high(0b1010_1100)) && !may_be_420(&high(0b1011_1100)));
        assert!(may_be_420(&[0x67, 122]), "the decoder knows");
        let other = [&[0x68], &high(0b1011_1100)[1..]].concat();
        assert!(may_be_420(&other), "it is no sequence parameter set");
    }
}
