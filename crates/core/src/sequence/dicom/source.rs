//! Chooses how the pictures of files are decoded.

use super::{
    numbered,
    object::{Object, Pixels},
    pictures::{Coding, DicomPictures},
    references::Origin,
    stored::Form,
};
use crate::{
    Error, Result,
    dicom::{LeftUnread, uid},
    reading::Pieces,
    sequence::{
        annex_b,
        edit_list::Cut,
        ffmpeg::{self, Container, Unread, scratch_folder},
        h264::{self, H264},
        mp4::Mp4,
        recording::{Picture, Recording, Selection},
        video,
    },
};
use std::{
    io::Read,
    path::{Path, PathBuf},
    sync::Arc,
};

/// Decoder of a transfer syntax.
enum Decoder {
    Plain,
    RunLengths,
    Jpeg,
    /// Frames of a kind of picture that ffmpeg reads from a file with one after the other: its name of the form.
    Unpacked(&'static str),
    H264,
    /// A stream that ffmpeg reads.
    Stream,
}

/// Returns the decoder of a transfer syntax (PS3.6, A); `None` if there is none.
fn decoder(syntax: &str) -> Option<Decoder> {
    const ENCAPSULATED: &str = "1.2.840.10008.1.2.4.";
    if [uid::IMPLICIT, uid::EXPLICIT].contains(&syntax) {
        return Some(Decoder::Plain);
    }
    if syntax == "1.2.840.10008.1.2.5" {
        return Some(Decoder::RunLengths);
    }
    // Streams that may be in several fragments have names that end in ".1".
    let number = syntax.strip_prefix(ENCAPSULATED)?.split('.').next()?.parse().ok()?;
    match number {
        50 | 51 => Some(Decoder::Jpeg),
        57 | 70 => Some(Decoder::Unpacked("jpeg_pipe")),
        80 | 81 => Some(Decoder::Unpacked("jpegls_pipe")),
        90 | 91 => Some(Decoder::Unpacked("j2k_pipe")),
        100 | 101 | 107 | 108 => Some(Decoder::Stream),
        102..=106 => Some(Decoder::H264),
        _ => None,
    }
}

/// Opens the selected frames of the files of a series, in their order.
pub(super) fn open(path: &Path, series: &[Object], selection: &Selection) -> Result<Recording> {
    let mut pictures = Vec::new();
    for object in series {
        let decoder = decoder(&object.syntax)
            .ok_or_else(|| object.unreadable("they are coded in a way that is not known here"))?;
        let coding = match decoder {
            Decoder::Plain => Coding::Plain(Form::of(object).map_err(|why| object.unreadable(&why))?),
            Decoder::RunLengths => {
                let form = Form::of(object).map_err(|why| object.unreadable(&why))?;
                Coding::RunLengths(form.by_pixels())
            }
            Decoder::Jpeg => Coding::Jpeg { is_rgb: object.photometric() == "RGB" },
            Decoder::H264 | Decoder::Stream | Decoder::Unpacked(_) => {
                let [only] = series else { return Err(several(path, &decoder, series)) };
                return stream(path, only, &decoder, selection);
            }
        };
        let frames = Arc::new(DicomPictures::open(object, coding)?);
        let picture = |index| Picture::Dicom { frames: frames.clone(), index };
        pictures.extend((0..frames.num_frames()).map(picture));
    }
    let mut recording = Recording::new(path, series[0].size, numbered(pictures));
    recording.dicom = Some(Origin::of(series));
    let first = recording.frames.first();
    if let Some(Picture::Dicom { frames, .. }) = first.map(|frame| &frame.picture) {
        // A picture that cannot be decoded at all is reported at once.
        frames.frame(0)?;
    }
    recording.select(selection)
}

/// Returns the error that the files of a series cannot be read as one.
fn several(path: &Path, decoder: &Decoder, series: &[Object]) -> Error {
    let are_single = series.iter().all(|object| object.num_frames == 1);
    let (what, hint) = match decoder {
        Decoder::Unpacked(_) if are_single => (
            "a series of single pictures in this coding is not read",
            "Convert it to Explicit VR Little Endian, for instance by gdcmconv --raw.",
        ),
        _ => ("the series consists of several videos", "Open its files one by one."),
    };
    Error::input_at(path, what, hint)
}

/// Opens a video.
fn stream(path: &Path, object: &Object, decoder: &Decoder, selection: &Selection) -> Result<Recording> {
    let Pixels::Fragments { fragments, .. } = object.pixels()? else {
        return Err(object.unreadable("they are not stored as the file says"));
    };
    let file = Pieces::of(&object.path, fragments);
    let kind = video::container(&head(&file)).unwrap_or(Container::Other);
    let index = index(object, &file, kind, decoder);
    let cut = index.as_ref().ok().and_then(Mp4::clear_cut).cloned();
    let why_not_here = match decoder {
        Decoder::H264 => match index.and_then(|mp4| h264(object, &file, mp4, selection)) {
            Ok(found) => return found.map(|recording| with_origin(recording, path, object)),
            Err(why) => why,
        },
        _ => "its coding is another one than H.264".to_owned(),
    };
    let form = match decoder {
        Decoder::Unpacked(form) => Some(*form),
        _ => None,
    };
    let scratch = scratch_folder()?;
    let input = taken_out(&file, scratch.path().join("stream"))?;
    let followed = cut.as_ref().filter(|cut| !cut.is_whole());
    let (promised, follows_edits) =
        (Some(followed.map_or(object.num_frames, |cut| cut.used.len())), followed.is_some());
    let (program, path_of_object) = (PathBuf::from(ffmpeg::PROGRAM), object.path.clone());
    let video =
        Unread { program, path: path_of_object, input, form, kind, promised, follows_edits, why_not_here };
    let mut recording = by_ffmpeg(object, video, selection)?;
    recording.scratch.push(scratch);
    recording.cautions.extend(cut.and_then(|cut| cut.note(selection)));
    Ok(with_origin(recording, path, object))
}

/// Reads the index of a stream in mp4, or finds the pictures of a bare one; the error says why that is not
/// possible. An edit list hides no pictures that the file counts as its frames.
fn index(object: &Object, file: &Pieces, kind: Container, decoder: &Decoder) -> Result<Mp4, String> {
    let mut mp4 = match (kind, decoder) {
        (Container::Mp4, _) => Mp4::read(file)?,
        (Container::Other, Decoder::H264) if annex_b::is_bare(&head(file)) => {
            annex_b::index(file, object.size)?
        }
        _ => return Err("its container is neither mp4 nor a bare stream".to_owned()),
    };
    if mp4.pictures.len() == object.num_frames {
        mp4.cut = Cut::nothing(object.num_frames);
    }
    Ok(mp4)
}

/// Opens a video that is not decoded here.
fn by_ffmpeg(object: &Object, video: Unread, selection: &Selection) -> Result<Recording> {
    let there = video.promised.unwrap_or(object.num_frames);
    let note = compare(object, there, video.follows_edits, selection)?;
    let mut recording = ffmpeg::open(video, selection, ffmpeg::Shared::default())?;
    if (recording.width, recording.height) != object.size {
        let (width, height) = object.size;
        let what = format!("they are {}×{} instead of {width}×{height}", recording.width, recording.height);
        return Err(object.unreadable(&what));
    }
    recording.notes.extend(note);
    Ok(recording)
}

/// Compares the number of frames that the file tells with the number `there` that its video has. Returns a
/// note if they differ. The times in an edit list are rounded, so that it may hide a frame more than was
/// meant.
///
/// # Errors
/// A video without an edit list that has fewer, unless none of the requested ones is missing.
fn compare(
    object: &Object,
    there: usize,
    follows_edits: bool,
    selection: &Selection,
) -> Result<Option<String>> {
    let told = object.num_frames;
    let is_missing = there < told && selection.last.is_none_or(|last| last >= there);
    if is_missing && !follows_edits {
        let what = format!("it lists {told} frames and holds {there} of them");
        return Err(h264::cut_off(&object.path, &what, there));
    }
    let note = || format!("The file lists {told} frames; its video has {there}, and all are used");
    Ok((there > told || is_missing).then(note))
}

/// Opens an H.264 stream; the outer error says why that is not possible here.
fn h264(
    object: &Object,
    file: &Pieces,
    mp4: Mp4,
    selection: &Selection,
) -> Result<Result<Recording>, String> {
    let (there, follows_edits) = (mp4.frames_there(), !mp4.cut.is_whole());
    let is_whole = video::expect_whole(&object.path, &mp4, selection);
    let note = match is_whole.and_then(|()| compare(object, there, follows_edits, selection)) {
        Ok(note) => note,
        Err(e) => return Ok(Err(e)),
    };
    let video = H264::open(file, mp4, Arc::default())?;
    if video.size() != object.size {
        let ((width, height), (w, h)) = (object.size, video.size());
        return Err(format!("its pictures are {w}×{h} instead of {width}×{height}"));
    }
    let mut opened = video::open_h264(&object.path, video, selection);
    if let Ok(recording) = &mut opened {
        recording.notes.extend(note);
    }
    Ok(opened)
}

fn with_origin(mut recording: Recording, path: &Path, object: &Object) -> Recording {
    let numbers = recording.frames.iter().filter_map(|frame| frame.name.parse().ok()).collect();
    recording.dicom = Some(Origin::of_video(object, numbers));
    path.clone_into(&mut recording.path);
    recording
}

fn head(file: &Pieces) -> Vec<u8> {
    let mut head = Vec::new();
    // What cannot be read is reported by those that read the whole.
    let _ = file.open().and_then(|reader| reader.take(16).read_to_end(&mut head));
    head
}

/// Copies a stream into a file of its own.
fn taken_out(file: &Pieces, to: PathBuf) -> Result<PathBuf> {
    let fail = |e| Error::io("take the video out of", file.path(), e);
    let mut out = std::fs::File::create(&to).map_err(fail)?;
    std::io::copy(&mut file.open().map_err(fail)?, &mut out).map_err(fail)?;
    Ok(to)
}

/// Facts about a series that are not pictures.
pub(super) struct Facts {
    speed: Option<f64>,
    /// Times of the frames of the first file, seconds; empty if they are not listed.
    seconds: Vec<f64>,
    spacing_mm: Option<[f64; 2]>,
}

impl Facts {
    pub(super) fn of(series: &[Object]) -> Self {
        let first = &series[0];
        let seconds = if series.len() == 1 { first.seconds() } else { Vec::new() };
        Self { speed: first.speed(), seconds, spacing_mm: first.spacing_mm() }
    }

    /// Gives a recording its speed, and notes for the user.
    pub(super) fn add_to(&self, recording: &mut Recording, left_unread: LeftUnread) {
        if let Some(rate) = self.speed {
            recording.frames_per_second = Some(rate as f32);
            // The times of a video that lies in the file are not those of the operation.
            let numbers = recording.frames.iter().map(|frame| frame.name.parse::<usize>().ok());
            let times = numbers.map(|number| self.seconds.get(number?).copied());
            recording.seconds = times.collect::<Option<_>>().unwrap_or_default();
        }
        if let Some([rows, columns]) = self.spacing_mm {
            recording.notes.push(format!("By the file, pixels are {columns} × {rows} mm"));
        }
        if let Some(left) = left_unread.describe() {
            recording
                .notes
                .push(format!("Left unread in the DICOM files: {left} (their values are not kept)"));
        }
        if let Some(origin) = &mut recording.dicom {
            origin.spacing_mm = self.spacing_mm;
        }
    }
}
