//! The tables of an mp4 file, plain or in fragments: where the coded pictures of its H.264 track lie.

use shiguredo_mp4::{
    TrackKind,
    boxes::{AvccBox, SampleEntry},
    demux::{
        DemuxError, Fmp4FileDemuxer, Input, Mp4FileDemuxer, Mp4FileKind, Mp4FileKindDetector, RequiredInput,
        Sample,
    },
};
use std::{
    fs::File,
    io::{Read, Seek, SeekFrom},
    path::Path,
};

/// The H.264 track of a file.
pub(super) struct Mp4 {
    pub width: usize,
    pub height: usize,
    /// Bytes of the length before each NAL unit.
    pub length_bytes: usize,
    /// NAL units: the sequence parameter sets, then the picture parameter sets.
    pub parameter_sets: Vec<Vec<u8>>,
    /// Ticks per second.
    pub timescale: u32,
    /// In decoding order, at least one.
    pub pictures: Vec<CodedPicture>,
}

/// The bytes of one coded picture.
pub(super) struct CodedPicture {
    pub offset: u64,
    pub size: usize,
    /// When it is shown, in ticks.
    pub shown_at: i64,
    /// Whether decoding may start there.
    pub is_sync: bool,
}

impl Mp4 {
    /// Reads the tables; says why where that is not possible, without a full stop.
    pub(super) fn read(path: &Path) -> Result<Self, String> {
        let file = File::open(path).map_err(|e| e.to_string())?;
        let len = file.metadata().map_err(|e| e.to_string())?.len();
        let mut source = Source { file, len, last: None };
        match source.kind()? {
            Mp4FileKind::Mp4 => Self::collect(Mp4FileDemuxer::new(), &mut source),
            Mp4FileKind::FragmentedMp4 => Self::collect(Fmp4FileDemuxer::new(), &mut source),
        }
    }

    fn collect(mut demuxer: impl Demuxer, source: &mut Source) -> Result<Self, String> {
        let mut track: Option<(u32, Self)> = None;
        loop {
            let sample = match demuxer.next_sample() {
                Ok(Some(sample)) => sample,
                Ok(None) => break,
                Err(DemuxError::InputRequired(required)) => {
                    let data = source.read(required)?;
                    demuxer.handle_input(required.to_input(&data));
                    continue;
                }
                Err(e) => return Err(unreadable(&e)),
            };
            if track.is_none() {
                track = Self::beginning_with(&sample).map(|video| (sample.track.track_id, video));
            }
            match &mut track {
                Some((id, video)) if *id == sample.track.track_id => {
                    video.pictures.push(source.coded_picture(&sample, video.pictures.len())?);
                }
                _ => {}
            }
        }
        track.map(|(_, video)| video).ok_or_else(|| "there is no H.264 video in it".to_owned())
    }

    /// The description of a track from its first sample; `None` unless it is H.264.
    fn beginning_with(sample: &Sample<'_>) -> Option<Self> {
        let (TrackKind::Video, Some(SampleEntry::Avc1(avc1))) = (sample.track.kind, sample.sample_entry)
        else {
            return None;
        };
        let AvccBox { length_size_minus_one, sps_list, pps_list, .. } = &avc1.avcc_box;
        Some(Self {
            width: usize::from(avc1.visual.width),
            height: usize::from(avc1.visual.height),
            length_bytes: usize::from(length_size_minus_one.get()) + 1,
            parameter_sets: sps_list.iter().chain(pps_list).cloned().collect(),
            timescale: sample.track.timescale.get(),
            pictures: Vec::new(),
        })
    }
}

/// What both kinds of file have in common.
trait Demuxer {
    fn handle_input(&mut self, input: Input<'_>);
    fn next_sample(&mut self) -> Result<Option<Sample<'_>>, DemuxError>;
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
        }
    };
}
demuxer!(Mp4FileDemuxer);
demuxer!(Fmp4FileDemuxer);

/// The file, which is read no further than it reaches and never twice at the same place.
struct Source {
    file: File,
    len: u64,
    last: Option<RequiredInput>,
}

impl Source {
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

    fn read(&mut self, required: RequiredInput) -> Result<Vec<u8>, String> {
        // The end of a file in fragments is found by reading there.
        if self.last.replace(required) == Some(required) || required.position > self.len {
            return Err("its tables lead beyond its end".to_owned());
        }
        self.file.seek(SeekFrom::Start(required.position)).map_err(|e| e.to_string())?;
        let rest = self.len - required.position;
        let size = required.size.map_or(rest, |size| rest.min(size as u64));
        let mut data = Vec::new();
        (&self.file).take(size).read_to_end(&mut data).map_err(|e| e.to_string())?;
        Ok(data)
    }

    /// A small table can name any number of samples of any size; the file's length says what can be true.
    fn coded_picture(&self, sample: &Sample<'_>, before: usize) -> Result<CodedPicture, String> {
        let end = sample.data_offset.checked_add(sample.data_size as u64);
        if end.is_none_or(|end| end > self.len) || before as u64 >= self.len {
            return Err("its tables lead beyond its end".to_owned());
        }
        let decoded_at = i64::try_from(sample.timestamp).map_err(|_| "its times are damaged")?;
        Ok(CodedPicture {
            offset: sample.data_offset,
            size: sample.data_size,
            shown_at: decoded_at.saturating_add(sample.composition_time_offset.unwrap_or(0)),
            is_sync: sample.keyframe,
        })
    }
}

fn unreadable(error: &DemuxError) -> String {
    format!("it is not a readable mp4 file: {error}")
}
