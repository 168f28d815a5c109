//! Reads the tables of an mp4 file, plain or in fragments: the places of the coded pictures of its video
//! track, and which of them are used. Tells if the file is long enough to hold them all.

use super::{
    colours::Colours,
    edit_list::{Cut, EditList},
    nal,
};
use crate::reading::{Pieces, PiecesReader};
use shiguredo_mp4::{
    BoxType, Decode, TrackKind,
    boxes::{AvccBox, MoovBox, SampleEntry, TrakBox, UnknownBox},
    demux::{
        DemuxError, Fmp4FileDemuxer, Input, Mp4FileDemuxer, Mp4FileKind, Mp4FileKindDetector, RequiredInput,
        Sample, TrackInfo,
    },
};
use std::{
    collections::BTreeMap,
    io::{Read, Seek, SeekFrom},
    ops::Range,
};

/// Largest number of pictures: two days of video.
pub(super) const MAX_PICTURES: usize = 1 << 22;
/// Number of times that the same bytes are read again before the file counts as ended: two parts of the
/// parser may ask for them one after the other.
const MOST_REPEATS: usize = 3;

/// The H.264 track of a file, or its first video track of any kind. Also the pictures of a bare H.264 stream,
/// see [`super::annex_b`].
pub(super) struct Mp4 {
    /// Descriptions of how to decode its pictures, the first from picture 0 on; empty unless it is H.264.
    pub descriptions: Vec<Description>,
    /// Ticks per second.
    pub timescale: u32,
    /// `true` if the pictures are shown turned or mirrored.
    pub is_turned: bool,
    /// All pictures that the tables name, in decoding order, at least one.
    pub pictures: Vec<CodedPicture>,
    /// The frames that are used.
    pub cut: Cut,
    /// Time for which all pictures together are shown, in ticks; 0 if they have no times.
    pub lasts: i64,
    /// Number of pictures, counted from the first, that are in the file.
    pub present: usize,
    /// Total size of all pictures.
    pub bytes: u64,
    /// `true` if the file ends within its tables, so that the number of pictures is unknown.
    pub is_open_ended: bool,
    /// Number of video tracks in the file.
    pub num_tracks: usize,
}

/// Parameters with which a run of pictures is decoded.
#[derive(Clone, PartialEq)]
pub(super) struct Description {
    /// The first of these pictures, in decoding order.
    pub from: usize,
    pub width: usize,
    pub height: usize,
    /// Width of a pixel by its height, if the file says it.
    pub pixel_aspect: Option<f32>,
    pub colours: Colours,
    pub framing: Framing,
    /// NAL units: the sequence parameter sets, then the picture parameter sets.
    pub parameter_sets: Vec<Vec<u8>>,
}

/// The marks between the NAL units of a picture.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Framing {
    /// A length before each unit, of so many bytes.
    Lengths(usize),
    /// Start codes (H.264, annex B).
    StartCodes,
}

/// The bytes of one coded picture.
pub(super) struct CodedPicture {
    pub offset: u64,
    pub size: usize,
    /// Time at which it is shown, in ticks.
    pub shown_at: i64,
    /// `true` if decoding may start there.
    pub is_sync: bool,
}

impl Mp4 {
    /// Reads the tables. The error says why that is not possible, without a full stop.
    pub(super) fn read(file: &Pieces) -> Result<Self, String> {
        let len = file.len();
        let file = file.open().map_err(|e| e.to_string())?;
        let mut source = BoundedFile { file, len, last: None, repeats: 0 };
        let kind = source.kind()?;
        let showing = source.showing().unwrap_or_default();
        match kind {
            Mp4FileKind::Mp4 => Self::collect(Mp4FileDemuxer::new(), &mut source, &showing),
            Mp4FileKind::FragmentedMp4 => Self::collect(Fmp4FileDemuxer::new(), &mut source, &showing),
        }
    }

    /// Collects the pictures of all video tracks and returns the chosen track, which is shown as `showing` says.
    fn collect(
        mut demuxer: impl Demuxer,
        source: &mut BoundedFile,
        showing: &BTreeMap<u32, Showing>,
    ) -> Result<Self, String> {
        let mut tracks: BTreeMap<u32, Self> = BTreeMap::new();
        let mut is_open_ended = false;
        loop {
            let sample = match demuxer.next_sample() {
                Ok(Some(sample)) => sample,
                Ok(None) => break,
                Err(DemuxError::InputRequired(required)) => {
                    match source.read(required) {
                        Ok(data) => demuxer.handle_input(required.to_input(&data)),
                        Err(_) if !tracks.is_empty() => {
                            is_open_ended = true;
                            break;
                        }
                        Err(why) => return Err(why),
                    }
                    continue;
                }
                // A part of a file in fragments is missing or damaged.
                Err(_) if !tracks.is_empty() => {
                    is_open_ended = true;
                    break;
                }
                Err(e) => return Err(unreadable(&e)),
            };
            if sample.track.kind == TrackKind::Video {
                let (id, timescale) = (sample.track.track_id, sample.track.timescale.get());
                let track = tracks.entry(id).or_insert_with(|| Self::empty(timescale));
                track.push(&sample, source)?;
            }
        }
        let num_tracks = tracks.len();
        let h264 = tracks.iter().find(|(_, track)| !track.descriptions.is_empty()).map(|(id, _)| *id);
        let first = demuxer.tracks().ok().and_then(|t| t.iter().find(|t| t.kind == TrackKind::Video));
        let id = h264.or(first.map(|track| track.track_id)).unwrap_or_default();
        let track = tracks.remove(&id).ok_or("there is no video in it")?;
        let Some(Showing { is_turned, edits }) = showing.get(&id) else {
            return Ok(Self { is_open_ended, num_tracks, cut: Cut::nothing(track.pictures.len()), ..track });
        };
        let cut = edits.cut(&track.times_in_order(), track.lasts);
        Ok(Self { is_open_ended, num_tracks, is_turned: *is_turned, cut, ..track })
    }

    fn empty(timescale: u32) -> Self {
        let (descriptions, pictures) = (Vec::new(), Vec::new());
        Self {
            descriptions,
            timescale,
            is_turned: false,
            pictures,
            cut: Cut::nothing(0),
            lasts: 0,
            present: 0,
            bytes: 0,
            is_open_ended: false,
            num_tracks: 1,
        }
    }

    /// Adds the next picture.
    fn push(&mut self, sample: &Sample<'_>, source: &BoundedFile) -> Result<(), String> {
        let at = self.pictures.len();
        // A small table can name any number of pictures; the file's length limits how many can exist.
        if at as u64 >= source.len.min(MAX_PICTURES as u64) {
            return Err("its tables lead beyond its end".to_owned());
        }
        if let Some(description) = sample.sample_entry.and_then(|entry| Description::of(entry, at)) {
            let last = self.descriptions.last();
            // If the first pictures are of another kind, the track does not count as H.264, whatever follows.
            if last.is_none_or(|last| !last.is_like(&description)) && (last.is_some() || at == 0) {
                self.descriptions.push(description);
            }
        }
        self.bytes = self.bytes.saturating_add(sample.data_size as u64);
        if self.present == at && self.bytes > source.len {
            return Err("its pictures lie over each other".to_owned());
        }
        let decoded_at = i64::try_from(sample.timestamp).map_err(|_| "its times are damaged")?;
        self.lasts = self.lasts.saturating_add(i64::from(sample.duration));
        let end = sample.data_offset.checked_add(sample.data_size as u64);
        if self.present == at && end.is_some_and(|end| end <= source.len) {
            self.present += 1;
        }
        self.pictures.push(CodedPicture {
            offset: sample.data_offset,
            size: sample.data_size,
            shown_at: decoded_at.saturating_add(sample.composition_time_offset.map_or(0, signed)),
            is_sync: sample.keyframe,
        });
        Ok(())
    }

    /// Returns the frames that are used, if ffmpeg sees the same ones: it may choose another one of several
    /// tracks.
    pub(super) fn clear_cut(&self) -> Option<&Cut> {
        (!self.is_open_ended && self.num_tracks == 1).then_some(&self.cut)
    }

    /// Returns the pictures in the order of showing.
    pub(super) fn in_order_of_showing(&self) -> Vec<usize> {
        let mut by_time: Vec<_> = (0..self.pictures.len()).collect();
        by_time.sort_by_key(|&i| (self.pictures[i].shown_at, i));
        by_time
    }

    /// Returns the times of all frames, in ticks.
    fn times_in_order(&self) -> Vec<i64> {
        self.in_order_of_showing().into_iter().map(|i| self.pictures[i].shown_at).collect()
    }

    /// Returns the position of every picture in the order of showing.
    pub(super) fn frame_of(&self) -> Vec<usize> {
        let by_time = self.in_order_of_showing();
        let mut frame_of = vec![0; by_time.len()];
        by_time.iter().enumerate().for_each(|(frame, &picture)| frame_of[picture] = frame);
        frame_of
    }

    /// Returns the number of used frames, counted from the first, that are in the file.
    pub(super) fn frames_there(&self) -> usize {
        let Range { start, end } = self.cut.used;
        let there = self.frame_of().into_iter().skip(self.present).min().unwrap_or(self.pictures.len());
        there.clamp(start, end) - start
    }

    /// Describes the missing part of the file in words; `None` if it is complete.
    pub(super) fn cut_off(&self) -> Option<String> {
        let (there, all) = (self.frames_there(), self.cut.used.len());
        if there < all {
            Some(format!("it lists {all} frames and holds {there} of them"))
        } else if self.is_open_ended {
            Some(format!("it ends in the middle of a part, after {there} frames"))
        } else {
            None
        }
    }
}

impl Description {
    /// Returns the description of an H.264 sample entry; `None` for other kinds.
    fn of(entry: &SampleEntry, from: usize) -> Option<Self> {
        let SampleEntry::Avc1(avc1) = entry else { return None };
        let AvccBox { length_size_minus_one, sps_list, pps_list, .. } = &avc1.avcc_box;
        let sequence = sps_list.first().map_or(&[][..], Vec::as_slice);
        let boxes = &avc1.unknown_boxes;
        let colours = boxes.iter().find_map(Colours::of_box).unwrap_or_default();
        Some(Self {
            from,
            width: usize::from(avc1.visual.width),
            height: usize::from(avc1.visual.height),
            pixel_aspect: boxes.iter().find_map(pixel_aspect).or_else(|| nal::pixel_aspect(sequence)),
            colours: Colours::of_parameters(sequence).or(colours),
            framing: Framing::Lengths(usize::from(length_size_minus_one.get()) + 1),
            parameter_sets: sps_list.iter().chain(pps_list).cloned().collect(),
        })
    }

    fn is_like(&self, other: &Self) -> bool {
        *self == Self { from: self.from, ..other.clone() }
    }
}

/// Returns the width of a pixel by its height that a box tells (ISO/IEC 14496-12, 12.1.4).
fn pixel_aspect(inner: &UnknownBox) -> Option<f32> {
    let (sides, _) = inner.payload.as_chunks::<4>();
    let [width, height] = sides.first_chunk::<2>()?.map(u32::from_be_bytes);
    let is_usable = inner.box_type == BoxType::Normal(*b"pasp") && width > 0 && height > 0;
    is_usable.then(|| width as f32 / height as f32)
}

/// Facts about how the pictures of a track are shown.
struct Showing {
    /// `true` if they are shown turned or mirrored: the matrix says so (ISO/IEC 14496-12, 8.3.2).
    is_turned: bool,
    edits: EditList,
}

impl Showing {
    fn of(track: &TrakBox, movie: &MoovBox) -> Self {
        let [a, b, _, c, d, ..] = track.tkhd_box.matrix;
        Self { is_turned: (b, c) != (0, 0) || a < 0 || d < 0, edits: EditList::of(track, movie) }
    }
}

/// The common part of the demuxers of both kinds of file.
trait Demuxer {
    fn handle_input(&mut self, input: Input<'_>);
    fn next_sample(&mut self) -> Result<Option<Sample<'_>>, DemuxError>;
    fn tracks(&mut self) -> Result<&[TrackInfo], DemuxError>;
}

macro_rules! demuxer {
    ($name:ty) => {
        impl Demuxer for $name {
            fn handle_input(&mut self, input: Input<'_>) {
                self.handle_input(input);
            }
            fn next_sample(&mut self) -> Result<Option<Sample<'_>>, DemuxError> {
                self.next_sample()
            }
            fn tracks(&mut self) -> Result<&[TrackInfo], DemuxError> {
                self.tracks()
            }
        }
    };
}
demuxer!(Mp4FileDemuxer);
demuxer!(Fmp4FileDemuxer);

/// The file. It is never read beyond its end, nor twice in a row at the same place.
struct BoundedFile {
    file: PiecesReader,
    len: u64,
    last: Option<RequiredInput>,
    /// Number of times that the last request was made again.
    repeats: usize,
}

impl BoundedFile {
    fn kind(&mut self) -> Result<Mp4FileKind, String> {
        let mut detector = Mp4FileKindDetector::new();
        loop {
            if let Some(kind) = detector.file_kind().map_err(|e| unreadable(&e))? {
                self.last = None;
                return Ok(kind);
            }
            let required = detector.required_input().ok_or("it is not a readable mp4 file")?;
            let data = self.read(required)?;
            detector.handle_input(required.to_input(&data));
        }
    }

    /// Returns how each track is shown.
    fn showing(&mut self) -> Option<BTreeMap<u32, Showing>> {
        const HEAD: u64 = 16;
        let mut at = 0;
        loop {
            let head = self.bytes(at, HEAD)?;
            let size = u64::from(u32::from_be_bytes(head.get(..4)?.try_into().ok()?));
            let size = match size {
                0 => self.len - at,
                1 => u64::from_be_bytes(head.get(8..16)?.try_into().ok()?),
                _ => size,
            };
            if head.get(4..8)? == b"moov" {
                let (moov, _) = MoovBox::decode(&self.bytes(at, size)?).ok()?;
                let track = |track: &TrakBox| (track.tkhd_box.track_id, Showing::of(track, &moov));
                return Some(moov.trak_boxes.iter().map(track).collect());
            }
            at = at.checked_add(size.max(8)).filter(|at| *at < self.len)?;
        }
    }

    /// Reads `size` bytes, or as many as there are.
    fn bytes(&mut self, at: u64, size: u64) -> Option<Vec<u8>> {
        let mut data = Vec::new();
        self.file.seek(SeekFrom::Start(at)).ok()?;
        (&mut self.file).take(size).read_to_end(&mut data).ok()?;
        Some(data)
    }

    fn read(&mut self, required: RequiredInput) -> Result<Vec<u8>, String> {
        // In a fragmented file, the demuxer finds the end by reading there.
        self.repeats = if self.last.replace(required) == Some(required) { self.repeats + 1 } else { 0 };
        if self.repeats > MOST_REPEATS || required.position > self.len {
            return Err("its tables lead beyond its end".to_owned());
        }
        self.file.seek(SeekFrom::Start(required.position)).map_err(|e| e.to_string())?;
        let rest = self.len - required.position;
        let size = required.size.map_or(rest, |size| rest.min(size as u64));
        let mut data = Vec::new();
        (&mut self.file).take(size).read_to_end(&mut data).map_err(|e| e.to_string())?;
        Ok(data)
    }
}

/// Returns the time from decoding to showing. It has 32 bits, and may be below zero also in files whose
/// version says that it is not.
fn signed(offset: i64) -> i64 {
    i64::from(offset as i32)
}

fn unreadable(error: &DemuxError) -> String {
    format!("it is not a readable mp4 file: {error}")
}

#[cfg(test)]
mod tests {
    use super::*;
    use shiguredo_mp4::BoxSize;

    #[test]
    fn the_shape_of_pixels_is_read() {
        let aspect = |kind: &[u8; 4], payload: &[u8]| {
            let (box_type, payload) = (BoxType::Normal(*kind), payload.to_vec());
            pixel_aspect(&UnknownBox { box_type, box_size: BoxSize::with_payload_size(box_type, 8), payload })
        };
        assert_eq!(aspect(b"pasp", &[0, 0, 0, 16, 0, 0, 0, 12]), Some(4.0 / 3.0));
        assert_eq!(aspect(b"pasp", &[0, 0, 0, 16, 0, 0, 0, 0]), None);
        assert_eq!(aspect(b"pasp", &[0, 0, 0, 16, 0]), None);
        assert_eq!(aspect(b"colr", &[0, 0, 0, 16, 0, 0, 0, 12]), None);
    }
}
