//! Video files. H.264 in an mp4 container is decoded here, frame by frame on request. All other videos are
//! decoded by an installed `ffmpeg` program. A video that ends before its last frame is refused by either
//! decoder, and both leave out what an edit list hides.

use super::{
    decoding::Decoding,
    ffmpeg::{self, Container, Unread},
    h264::{self, H264, cut_off, other_size},
    mp4::Mp4,
    read,
    recording::{FrameFiles, Picture, Recording, Selection},
    settings::Settings,
    settings_file::own_file,
};
use crate::{
    Error, Result,
    reading::{Pieces, is_present},
};
use rayon::prelude::*;
use std::{
    fs::File,
    io::Read,
    ops::Range,
    path::{Path, PathBuf},
    sync::{Arc, Mutex},
};

/// File name endings (lower case) of videos, for folders that hold some.
pub(super) const VIDEOS: &[&str] =
    &["mp4", "m4v", "mov", "mkv", "avi", "webm", "mpg", "mpeg", "ts", "mts", "m2ts", "wmv", "flv"];

/// Decoders that the videos of one recording share.
#[derive(Clone, Default)]
struct Decoders {
    h264: Arc<Mutex<Decoding<h264::Running>>>,
    ffmpeg: ffmpeg::Shared,
}

/// Opens a video file.
pub(super) fn open(path: &Path, selection: &Selection) -> Result<Recording> {
    open_part(path, selection, Decoders::default())
}

/// Opens the videos of a folder, in this order, as one recording. The settings of each say which of its
/// frames are used. What they hide is hidden in all frames: too much is better than too little.
///
/// # Errors
/// A file that cannot be read, or whose pictures have another size than those of the first.
pub(super) fn open_folder(folder: &Path, files: &[PathBuf], selection: &Selection) -> Result<Recording> {
    let decoders = Decoders::default();
    if let [only] = files {
        let (own, beside) = (own_file(folder), own_file(only));
        if own == beside || !is_present(&beside) {
            return Ok(Recording { path: folder.to_owned(), ..open(only, selection)? });
        }
        let whole = open_with_settings(only, decoders)?;
        return Recording { path: folder.to_owned(), ..whole }.select(selection);
    }
    let mut whole = Recording::new(folder, (0, 0), Vec::new());
    let parts: Vec<_> = files.par_iter().map(|file| open_with_settings(file, decoders.clone())).collect();
    for (file, part) in files.iter().zip(parts) {
        whole.append(file, part?)?;
    }
    whole.select(selection)
}

/// Opens a video whose folder has settings of its own. Of those beside the video, `[frames]` and `[[hidden]]`
/// count.
fn open_with_settings(file: &Path, decoders: Decoders) -> Result<Recording> {
    let beside = own_file(file);
    let (settings, name) = (Settings::read(&beside)?, read::file_name(&beside));
    let selection = Selection { every: 1, ..settings.selection() };
    let mut part = open_part(file, &selection, decoders)?;
    let (frames, hidden) = (settings.frames.clone(), settings.hidden.clone());
    if settings != (Settings { frames, hidden, ..Settings::default() }) {
        part.notes.push(format!(
            "Of {name}, [frames] and [[hidden]] alone count here: sequence.toml in the folder has the others"
        ));
    }
    if !settings.hidden.is_empty() {
        part.notes.push(format!("What {name} hides is black in every frame of the folder"));
    }
    part.hidden = settings.hidden;
    Ok(part)
}

/// Caution about an mp4 whose index is left to ffmpeg.
const INDEX_UNREAD: &str =
    "Its index cannot be read here: if an edit list hides frames, they are part of the recording";

fn open_part(path: &Path, selection: &Selection, decoders: Decoders) -> Result<Recording> {
    let kind = expect_video(path)?;
    let file = Pieces::whole(path).map_err(|e| Error::io("open the file", path, e))?;
    let index = Mp4::read(&file);
    if let Ok(mp4) = &index {
        expect_whole(path, mp4, selection)?;
    }
    let cut = index.as_ref().ok().and_then(Mp4::clear_cut).cloned();
    match index.and_then(|mp4| H264::open(&file, mp4, decoders.h264)) {
        Ok(video) => open_h264(path, video, selection),
        Err(why_not_here) => {
            let (path, input) = (path.to_owned(), path.to_owned());
            let program = PathBuf::from(ffmpeg::PROGRAM);
            let promised = cut.as_ref().map(|cut| cut.used.len());
            let follows_edits = cut.as_ref().is_some_and(|cut| !cut.is_whole());
            let form = None;
            let video = Unread { program, path, input, form, kind, promised, follows_edits, why_not_here };
            let mut recording = ffmpeg::open(video, selection, decoders.ffmpeg)?;
            let caution = match cut {
                Some(cut) => cut.note(selection),
                None => (kind == Container::Mp4).then(|| INDEX_UNREAD.to_owned()),
            };
            recording.cautions.extend(caution);
            Ok(recording)
        }
    }
}

/// Returns an error if the file ends before its last frame, unless none of the requested frames is missing.
pub(super) fn expect_whole(path: &Path, mp4: &Mp4, selection: &Selection) -> Result<()> {
    let there = mp4.frames_there();
    match mp4.cut_off() {
        Some(what) if selection.last.is_none_or(|last| last >= there) => Err(cut_off(path, &what, there)),
        _ => Ok(()),
    }
}

pub(super) fn open_h264(path: &Path, video: H264, selection: &Selection) -> Result<Recording> {
    let size = video.size();
    let frames_per_second = video.frames_per_second;
    let Range { start, end } = video.used();
    let numbers = selection.indices(end - start).map_err(|what| Error::input_at(path, what, ""))?;
    let changed = video.descriptions.iter().find(|d| (d.width, d.height) != size);
    if let Some(d) = changed.filter(|d| numbers.last().is_some_and(|last| start + last >= d.from)) {
        return Err(other_size(path, d.from.saturating_sub(start), (d.width, d.height), size));
    }
    let seconds = numbers.iter().map(|number| video.seconds(start + number)).collect();
    let pixel_aspect = video.descriptions[0].pixel_aspect;
    let note = video.cut.note(selection);
    let video = Arc::new(video);
    let frame = |number: usize| {
        let picture = Picture::Video { video: Arc::clone(&video), index: start + number };
        FrameFiles::new(format!("{number:06}"), picture)
    };
    let mut recording = Recording::new(path, size, numbers.into_iter().map(frame).collect());
    recording.frames_per_second = frames_per_second;
    recording.seconds = seconds;
    recording.cautions.extend(note);
    recording.shape_pixels(pixel_aspect);
    Ok(recording)
}

/// Returns an error if the first bytes belong to no known kind of video.
fn expect_video(path: &Path) -> Result<Container> {
    let mut head = Vec::new();
    let file = File::open(path).map_err(|e| Error::io("open the file", path, e))?;
    file.take(16).read_to_end(&mut head).map_err(|e| Error::io("read the file", path, e))?;
    container(&head).ok_or_else(|| {
        let hint = "Open a video file, or the folder that holds the frames.";
        Error::input_at(path, "this file is not a video", hint)
    })
}

/// Returns the kind of a video by its first bytes; `None` if they belong to no known kind.
pub(super) fn container(head: &[u8]) -> Option<Container> {
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
    // Cameras put four bytes of time before each packet of a transport stream.
    if head.get(4) == Some(&0x47) {
        return Some(Container::Other);
    }
    // Older QuickTime files begin with another box.
    let boxes: [&[u8]; 6] = [b"ftyp", b"moov", b"mdat", b"wide", b"free", b"skip"];
    if head.get(4..8).is_some_and(|word| boxes.contains(&word)) {
        return Some(Container::Mp4);
    }
    starts.iter().any(|start| head.starts_with(start)).then_some(Container::Other)
}
