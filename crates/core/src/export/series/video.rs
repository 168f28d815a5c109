//! The overlays as H.264 in an mp4 file.

use super::{Series, SeriesPlan};
use crate::{
    export::{
        ExportOptions, Format,
        frame::{FrameContent, drawn_size, scaled_size},
    },
    files::WholeFile,
};
use image::RgbImage;
use openh264::{
    OpenH264API, Timestamp,
    encoder::{
        BitRate, Encoder, EncoderConfig, FrameRate, FrameType, IntraFramePeriod, QpRange, RateControlMode,
        VuiConfig,
    },
    formats::{RgbSliceU8, YUVBuffer},
};
use shiguredo_mp4::{
    TrackKind,
    bitstream::h264::{self, H264NalUnitType, H264SampleEntryConfig, LengthSize},
    boxes::SampleEntry,
    mux::{Mp4FileMuxer, Mp4FileMuxerOptions, Sample, estimate_maximum_moov_box_size},
};
use std::{
    borrow::Cow,
    fmt,
    io::{self, BufWriter, Seek, SeekFrom, Write},
    num::NonZeroU32,
    ops::RangeInclusive,
};

/// Units of time per second; usual frame rates divide it without remainder.
const TIMESCALE: NonZeroU32 = NonZeroU32::new(90_000).unwrap();
/// Number of frames between two that a player can jump to.
const JUMP_EVERY: u32 = 25;
/// Approximate number of bits per pixel and frame; players are told to expect this rate.
const BITS: f64 = 0.5;
/// Range of H.264's quantiser that keeps lines sharp and tissue free of blocks.
const QUANTISER: QpRange = QpRange::new(20, 22);

/// Length of the longer and of the shorter side up to which the encoder takes pictures, px.
const MOST: [u32; 2] = [3840, 2160];
/// Length of a side from which on it takes them, px.
const FEWEST: u32 = 16;
/// Widths that can be chosen for videos, px.
const WIDTHS: RangeInclusive<u32> = 64..=MOST[0];

/// A video that cannot be written, because the encoder takes no pictures of its size.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct VideoFault {
    /// Columns and rows that it would have, px.
    size: (u32, u32),
    /// Number of columns nearest to these with which it can be written; `None` if there is none.
    pub fitting: Option<u32>,
}

impl VideoFault {
    /// Looks at the video that an export makes of pictures of a size; `None` if it makes none, or can.
    pub fn of(options: &ExportOptions, size: (usize, usize)) -> Option<Self> {
        let recorded = (size.0 as u32, size.1 as u32);
        let size = drawn_size(options, recorded);
        if !options.formats.contains(&Format::Video) || is_encodable(size) {
            return None;
        }
        let fitting = WIDTHS.filter(|&width| is_encodable(scaled_size(recorded, width)));
        Some(Self { size, fitting: fitting.min_by_key(|width| width.abs_diff(size.0)) })
    }
}

impl fmt::Display for VideoFault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let ((columns, rows), [longer, shorter]) = (self.size, MOST);
        match (columns.min(rows) + 1 < FEWEST, columns < rows) {
            (true, _) => write!(f, "a video has at least {FEWEST}×{FEWEST} pixels")?,
            (false, false) => write!(f, "a video has at most {longer}×{shorter} pixels")?,
            (false, true) => write!(f, "a video has at most {shorter}×{longer} pixels")?,
        }
        write!(f, ", and this one would have {columns}×{rows}")
    }
}

/// Tests whether the encoder takes pictures of a size, once odd sides have grown by a pixel.
fn is_encodable((columns, rows): (u32, u32)) -> bool {
    let (longer, shorter) = (columns.max(rows), columns.min(rows));
    longer <= MOST[0] && shorter <= MOST[1] && shorter + 1 >= FEWEST
}

pub(super) struct Video {
    file: BufWriter<WholeFile>,
    encoder: Encoder,
    muxer: Mp4FileMuxer,
    /// Number of bytes written.
    position: u64,
    /// Times at which frames appear, and the end.
    starts: Vec<u64>,
    added: usize,
}

impl Video {
    pub(super) fn begin(file: WholeFile, plan: SeriesPlan<'_>) -> io::Result<Self> {
        let speed = plan.provenance.playing_speed();
        // The encoder supports no lower rate; playback follows the times of the file.
        let coded_speed = speed.max(1.0);
        let (width, height) = plan.drawn_size();
        let bits = BITS * f64::from(width) * f64::from(height) * f64::from(coded_speed);
        // One thread: the bytes must not depend on the machine. Quality is kept whatever the rate, and no
        // frame is skipped, because the video must have the same frames as the other files.
        let config = EncoderConfig::new()
            .rate_control_mode(RateControlMode::Bufferbased)
            .max_frame_rate(FrameRate::from_hz(coded_speed))
            .bitrate(BitRate::from_bps(bits.min(2e9) as u32))
            .qp(QUANTISER)
            .skip_frames(false)
            .intra_frame_period(IntraFramePeriod::from_num_frames(JUMP_EVERY))
            .vui(VuiConfig::bt601())
            .num_threads(1);
        let encoder =
            Encoder::with_api_config(OpenH264API::from_source(), config).map_err(io::Error::other)?;
        // With the table of contents at the beginning, playback can start at once.
        let reserved_moov_box_size = estimate_maximum_moov_box_size(&[plan.frames.len()]);
        let options = Mp4FileMuxerOptions { reserved_moov_box_size, ..Default::default() };
        let muxer = Mp4FileMuxer::with_options(options).map_err(other)?;
        let mut file = BufWriter::new(file);
        file.write_all(muxer.initial_boxes_bytes())?;
        let position = muxer.initial_boxes_bytes().len() as u64;
        let starts = plan.provenance.starts(plan.frames);
        let starts = starts.into_iter().map(|s| (f64::from(TIMESCALE.get()) * s).round() as u64).collect();
        Ok(Self { file, encoder, muxer, position, starts, added: 0 })
    }
}

impl Series for Video {
    fn add(&mut self, frame: &FrameContent<'_>) -> io::Result<()> {
        let picture = even(frame.overlay());
        let size = (picture.width() as usize, picture.height() as usize);
        let yuv = YUVBuffer::from_rgb8_source(RgbSliceU8::new(picture.as_raw(), size));
        let [start, end] = [self.added, self.added + 1].map(|i| self.starts[i.min(self.starts.len() - 1)]);
        let milliseconds = 1000 * start / u64::from(TIMESCALE.get());
        let coded =
            self.encoder.encode_at(&yuv, Timestamp::from_millis(milliseconds)).map_err(io::Error::other)?;
        let keyframe = matches!(coded.frame_type(), FrameType::IDR);
        let stream = coded.to_vec();
        let sample_entry = (self.added == 0).then(|| sample_entry(&stream)).transpose()?;
        let data = length_prefixed(&stream)?;
        self.file.write_all(&data)?;
        let sample = Sample {
            track_kind: TrackKind::Video,
            sample_entry,
            keyframe,
            timescale: TIMESCALE,
            duration: end.saturating_sub(start).max(1) as u32,
            composition_time_offset: None,
            data_offset: self.position,
            data_size: data.len(),
        };
        self.muxer.append_sample(&sample).map_err(other)?;
        self.position += data.len() as u64;
        self.added += 1;
        Ok(())
    }

    fn finish(mut self: Box<Self>) -> io::Result<WholeFile> {
        let boxes = self.muxer.finalize().map_err(other)?;
        for (offset, bytes) in boxes.offset_and_bytes_pairs() {
            self.file.seek(SeekFrom::Start(offset))?;
            self.file.write_all(bytes)?;
        }
        Ok(self.file.into_inner()?)
    }
}

/// Returns the description of how to decode the stream.
fn sample_entry(stream: &[u8]) -> io::Result<SampleEntry> {
    let config = H264SampleEntryConfig { length_size: LengthSize::FourBytes };
    h264::build_avc1_box_from_annexb(stream, &config).map(SampleEntry::Avc1).map_err(other)
}

/// Returns the units of a coded picture in the form of mp4; parameter sets are only in the sample entry.
fn length_prefixed(stream: &[u8]) -> io::Result<Vec<u8>> {
    let mut data = Vec::with_capacity(stream.len());
    for unit in h264::parse_annexb_nal_units(stream).map_err(other)? {
        if !matches!(unit.nal_unit_type, H264NalUnitType::Sps | H264NalUnitType::Pps) {
            data.extend((unit.data.len() as u32).to_be_bytes());
            data.extend(unit.data);
        }
    }
    Ok(data)
}

/// Repeats an odd last column or row: widely supported H.264 has one colour for two by two pixels.
fn even(picture: &RgbImage) -> Cow<'_, RgbImage> {
    let (width, height) = picture.dimensions();
    if width.is_multiple_of(2) && height.is_multiple_of(2) {
        return Cow::Borrowed(picture);
    }
    let at = |x: u32, y: u32| *picture.get_pixel(x.min(width - 1), y.min(height - 1));
    Cow::Owned(RgbImage::from_fn(width + width % 2, height + height % 2, at))
}

fn other(e: impl std::fmt::Display) -> io::Error {
    io::Error::other(e.to_string())
}
