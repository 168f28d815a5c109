//! Export of masked frames to disk as pictures, data and video, with a record of how they were made.
//!
//! An export is driven frame by frame, so that a window or a command line can show progress and
//! stop at any point:
//!
//! ```text
//! Export::begin ─▶ next_frame ─▶ (the caller renders and scores it) ─▶ write ─▶ … ─▶ finish ─▶ provenance.json
//! ```
//!
//! Files are written completely or not at all. Beginning again in the same folder with the same request
//! continues where it stopped: existing files of single frames stay, and files about all frames are made
//! anew unless they are finished. A file that does not belong to this export is never overwritten: an
//! earlier export is replaced by [`OutputFolder`](crate::files::OutputFolder), which claims the folder.

mod caption;
mod format;
mod frame;
mod lettering;
mod options;
mod outline;
mod pictures;
mod provenance;
mod series;
mod slugs;
mod stamp;
mod xml;
mod yolo;

pub use caption::{caption, draw_scale, frame_words, timecode};
pub use format::{Format, FormatGroup, num_files};
pub use options::{ExportOptions, ExportPrompt, LeftOut, PictureSource, SegType};
pub use provenance::{ExportedFile, FILE_NAME as PROVENANCE_FILE, Provenance};
pub use series::VideoFault;
pub use slugs::{distinct, slugs};
pub use stamp::stamp;

pub(crate) use provenance::exported_files;

use crate::{
    Error, Remedy, Result,
    files::{WholeFile, write_whole},
    grid::{Grid, Mask},
    hash::{file_sha256, sha256},
    sequence::SourceReferences,
};
use frame::FrameContent;
use image::RgbImage;
use provenance::Record;
use rayon::prelude::*;
use std::path::{Path, PathBuf};

/// Least number of finished frames between two updates of the record; one more is written at the end and
/// after a failure.
const RECORD_EVERY: usize = 32;
/// Share of the finished frames that may be missing in the record, as 1 over this number. The record lists
/// all files, so that equal steps would take time with the square of their number.
const RECORD_SHARE: usize = 8;

/// An export in progress; see the module documentation.
pub struct Export {
    folder: PathBuf,
    frames: Vec<usize>,
    next: usize,
    record: Record,
    unsaved: usize,
    skipped: usize,
    /// Formats of one file about all frames that still have to be made; they need every frame.
    due: Vec<Format>,
    /// The files of these formats, from the first frame on.
    series: Vec<OpenSeries>,
    /// Columns and rows, from the first frame on.
    size: Option<(usize, usize)>,
    /// The DICOM files that the frames come from.
    sources: Option<SourceReferences>,
}

/// An unfinished file about all frames.
struct OpenSeries {
    name: String,
    writer: Box<dyn series::Series>,
}

/// Result of an export.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize)]
pub struct ExportSummary {
    /// `true` if every requested frame is there.
    pub complete: bool,
    /// Number of requested frames.
    pub frames: usize,
    /// Number of frames that existed already and were left alone.
    pub skipped_frames: usize,
    /// Number of requested frames that the scene does not show, which have no files of their own.
    pub frames_not_shown: usize,
    /// Number of files of the export, without `provenance.json`, `labels.json` and `data.yaml`.
    pub files: usize,
    /// Words of which nothing was written, because they mean nothing in the recording.
    pub left_out: Vec<LeftOut>,
}

impl Export {
    /// Starts or continues the export of `frames` into `folder`, which the caller has claimed, so that nobody
    /// else writes into it.
    ///
    /// Where the provenance has no prompts but words that were left out, the record of them is everything that is
    /// written.
    ///
    /// Fails if there are no frames, words or formats, or if there are more prompts than labels. Fails
    /// if frames in between are left out and a format has one file about all frames. Also fails if the
    /// folder holds files of another export.
    pub fn begin(folder: &Path, mut frames: Vec<usize>, mut provenance: Provenance) -> Result<Self> {
        // The same formats are the same export, in whatever order they are requested.
        provenance.options.formats.sort_unstable();
        provenance.options.formats.dedup();
        validate(&frames, &provenance)?;
        if provenance.prompts.is_empty() {
            frames.clear();
        }
        let record = match Record::read(folder)? {
            Some(found) if found.provenance == provenance => found,
            Some(_) => {
                return Err(Error::input_at(
                    folder,
                    "the folder holds another export",
                    Remedy::Replace.after("Choose an empty folder."),
                ));
            }
            None => {
                refuse_foreign_files(folder, &provenance, &frames)?;
                Record::new(provenance)
            }
        };
        let mut export = Self {
            folder: folder.to_owned(),
            frames,
            next: 0,
            record,
            unsaved: 0,
            skipped: 0,
            due: Vec::new(),
            series: Vec::new(),
            size: None,
            sources: None,
        };
        export.due = export.unfinished_series()?;
        export.write_labels()?;
        export.save(false)?;
        Ok(export)
    }

    /// Gives the DICOM files that the frames come from, for references. Their digest must be in the provenance.
    pub fn with_sources(mut self, sources: Option<SourceReferences>) -> Self {
        self.sources = sources;
        self
    }

    /// Returns `true` if `folder` holds an export with this provenance, complete or in part.
    pub fn is_of(folder: &Path, provenance: &Provenance) -> bool {
        let mut asked = provenance.clone();
        asked.options.formats.sort_unstable();
        asked.options.formats.dedup();
        Record::read(folder).is_ok_and(|found| found.is_some_and(|found| found.provenance == asked))
    }

    /// Returns the number of requested frames.
    pub fn num_frames(&self) -> usize {
        self.frames.len()
    }

    /// Returns the number of frames that are done or skipped.
    pub fn frames_done(&self) -> usize {
        self.next
    }

    /// Returns the next frame to render and [`Export::write`]; frames that need nothing more are skipped.
    /// `None` at the end.
    pub fn next_frame(&mut self) -> Option<usize> {
        while let Some(&frame) = self.frames.get(self.next) {
            if !self.due.is_empty() || self.needs_files(frame) {
                return Some(frame);
            }
            self.next += 1;
            self.skipped += usize::from(self.record.provenance.shows(frame));
        }
        None
    }

    /// Writes the files of the frame that [`Export::next_frame`] returned, from `picture` and one score
    /// image per prompt. All have one size, the same for every frame. `tools` marks the pixels of
    /// instruments, if known. After a failure, finished files are complete and recorded, and the export
    /// has to be begun again.
    pub fn write(&mut self, picture: &RgbImage, scores: &[Grid<f32>], tools: Option<&Mask>) -> Result<()> {
        let Some(&frame) = self.frames.get(self.next) else { return Ok(()) };
        self.check_sizes(picture, scores)?;
        let written = self.write_frame(frame, picture, scores, tools);
        if let Err(e) = written {
            self.series.clear();
            // The disk may be full: the error to report is the one that stopped the export.
            let _ = self.save(false);
            return Err(e);
        }
        self.next += 1;
        self.unsaved += 1;
        if is_record_due(self.unsaved, self.next) { self.save(false) } else { Ok(()) }
    }

    /// Puts the files about all frames in their places if every frame was written, and writes the record.
    /// To be called after the last frame and after stopping early.
    pub fn finish(mut self) -> Result<ExportSummary> {
        let complete = self.next >= self.frames.len();
        let closed = if complete { self.close_series() } else { Ok(()) };
        self.save(complete && closed.is_ok())?;
        closed?;
        Ok(ExportSummary {
            complete,
            frames: self.frames.len(),
            skipped_frames: self.skipped,
            frames_not_shown: self.frames.iter().filter(|&&f| !self.record.provenance.shows(f)).count(),
            files: self.record.files.all().filter(|f| !is_labels(&f.name)).count(),
            left_out: self.record.provenance.left_out.clone(),
        })
    }

    fn write_frame(
        &mut self,
        frame: usize,
        picture: &RgbImage,
        scores: &[Grid<f32>],
        tools: Option<&Mask>,
    ) -> Result<()> {
        self.open_series((picture.width() as usize, picture.height() as usize))?;
        let is_to_draw = self.needs_files(frame);
        let content = FrameContent::new(&self.record.provenance, frame, picture, scores, tools);
        let files = if is_to_draw { pictures::draw(&content)? } else { Vec::new() };
        let folder = self.folder.as_path();
        let written: Result<Vec<ExportedFile>> =
            files.into_par_iter().map(|file| write_file(folder, frame, file)).collect();
        for OpenSeries { name, writer } in &mut self.series {
            writer.add(&content).map_err(|e| Error::io("write the file", folder.join(name), e))?;
        }
        if is_to_draw {
            self.record.add(frame, written?);
        }
        Ok(())
    }

    /// Begins the files that are due, at the first frame.
    fn open_series(&mut self, size: (usize, usize)) -> Result<()> {
        if self.size.replace(size).is_some() {
            return Ok(());
        }
        let options = &self.record.provenance.options;
        if let Some(fault) = VideoFault::of(options, size).filter(|_| self.due.contains(&Format::Video)) {
            return Err(Error::input(fault.to_string(), "Choose another size, or leave the video out."));
        }
        let plan = series::SeriesPlan {
            provenance: &self.record.provenance,
            frames: &self.frames,
            size,
            sources: self.sources.as_ref(),
        };
        for &format in &self.due {
            let name = series::name(format, &self.frames);
            let path = self.folder.join(&name);
            let file = WholeFile::create(&path)?;
            let writer =
                series::begin(format, file, plan).map_err(|e| Error::io("write the file", path, e))?;
            self.series.push(OpenSeries { name, writer });
        }
        Ok(())
    }

    fn close_series(&mut self) -> Result<()> {
        for OpenSeries { name, writer } in std::mem::take(&mut self.series) {
            let path = self.folder.join(&name);
            let file = writer.finish().map_err(|e| Error::io("write the file", &path, e))?;
            let sha256 = file_sha256(file.temporary_path())?;
            if is_to_be_written(&path, &sha256)? {
                file.commit()?;
            }
            self.record.add_series(ExportedFile { name, sha256, frame: None, prompt: None });
        }
        Ok(())
    }

    /// Returns the formats of one file about all frames whose file does not exist yet.
    fn unfinished_series(&self) -> Result<Vec<Format>> {
        let mut due = Vec::new();
        for format in series_formats(&self.record.provenance, &self.frames) {
            let name = series::name(format, &self.frames);
            let recorded = self.record.files.of(None).iter().find(|f| f.name == name);
            let path = self.folder.join(name);
            let is_due = match recorded {
                Some(file) => is_to_be_written(&path, &file.sha256)?,
                None => true,
            };
            if is_due {
                due.push(format);
            }
        }
        Ok(due)
    }

    /// Returns `true` if files of a single frame have to be written.
    fn needs_files(&self, frame: usize) -> bool {
        self.record.provenance.shows(frame) && !self.is_finished(frame)
    }

    fn is_finished(&self, frame: usize) -> bool {
        let expected = pictures::names(&self.record.provenance, frame);
        let recorded = self.record.files.of(Some(frame));
        expected.iter().all(|name| {
            let recorded = recorded.iter().find(|f| f.name == *name);
            recorded.is_some_and(|file| {
                file_sha256(&self.folder.join(name)).is_ok_and(|there| there == file.sha256)
            })
        })
    }

    fn check_sizes(&self, picture: &RgbImage, scores: &[Grid<f32>]) -> Result<()> {
        let size = (picture.width() as usize, picture.height() as usize);
        let prompts = self.record.provenance.prompts.len();
        let fault = |what: String| Err(Error::input(what, "Export at the recording's size."));
        if scores.len() != prompts {
            return Err(Error::input(
                format!("{} score images for {prompts} prompts", scores.len()),
                "Ask the scene for the prompts of the export.",
            ));
        }
        if size.0 * size.1 == 0 {
            return fault("the picture is empty".into());
        }
        if let Some(before) = self.size.filter(|before| *before != size) {
            let (w, h) = before;
            return fault(format!("the picture is {}×{}, those before it were {w}×{h}", size.0, size.1));
        }
        match scores.iter().find(|s| (s.width, s.height) != size) {
            None => Ok(()),
            Some(s) => fault(format!(
                "the picture is {}×{}, its scores are {}×{}",
                size.0, size.1, s.width, s.height
            )),
        }
    }

    /// Writes the files that say which number stands for which prompt.
    fn write_labels(&mut self) -> Result<()> {
        let provenance = &self.record.provenance;
        let formats = if self.frames.is_empty() { &[][..] } else { &provenance.options.formats };
        let texts = formats.iter().filter_map(|f| Some((labels_name(*f)?, labels_text(*f, provenance))));
        for (name, text) in texts.collect::<Vec<_>>() {
            write_whole(&self.folder.join(&name), text.as_bytes())?;
            let sha256 = sha256(text.as_bytes());
            self.record.add_series(ExportedFile { name, sha256, frame: None, prompt: None });
        }
        Ok(())
    }

    fn save(&mut self, complete: bool) -> Result<()> {
        self.unsaved = 0;
        self.record.complete = complete;
        self.record.write(&self.folder)
    }
}

/// Returns `true` if the record is to be written again. `unsaved` of the `done` frames are missing in it.
fn is_record_due(unsaved: usize, done: usize) -> bool {
    unsaved >= RECORD_EVERY.max(done / RECORD_SHARE)
}

/// Returns the path, inside the export, of the file that says which number of a format stands for which
/// prompt.
fn labels_name(format: Format) -> Option<String> {
    match format {
        Format::Index => Some(format!("{}/labels.json", format.name())),
        Format::Yolo => Some(format!("{}/data.yaml", format.name())),
        _ => None,
    }
}

/// Returns `true` for the name of such a file.
fn is_labels(name: &str) -> bool {
    Format::ALL.into_iter().filter_map(labels_name).any(|labels| labels == name)
}

fn labels_text(format: Format, provenance: &Provenance) -> String {
    if format == Format::Yolo {
        return yolo::names(provenance);
    }
    let label = |(i, p): (usize, &ExportPrompt)| serde_json::json!({ "id": i + 1, "prompt": p.text, "colour": p.colour });
    let labels: Vec<_> = provenance.prompts.iter().enumerate().map(label).collect();
    provenance::pretty(&serde_json::json!({ "background": 0, "labels": labels }))
}

fn write_file(folder: &Path, frame: usize, file: pictures::File) -> Result<ExportedFile> {
    let path = folder.join(&file.name);
    let sha256 = sha256(&file.bytes);
    if is_to_be_written(&path, &sha256)? {
        write_whole(&path, &file.bytes)?;
    }
    Ok(ExportedFile { name: file.name, sha256, frame: Some(frame), prompt: file.prompt })
}

/// Returns `true` if a file of the export with this hash does not exist yet; an error if another one is
/// in its place.
fn is_to_be_written(path: &Path, sha256: &str) -> Result<bool> {
    match file_sha256(path) {
        Ok(there) if there == sha256 => Ok(false),
        Ok(_) => Err(Error::input_at(
            path,
            "a file of the export is there already, with other content",
            Remedy::Replace.after("It was changed since. Choose an empty folder."),
        )),
        Err(_) => Ok(true),
    }
}

fn validate(frames: &[usize], provenance: &Provenance) -> Result<()> {
    let prompts = provenance.prompts.len();
    let formats = &provenance.options.formats;
    let has_labels = formats.iter().any(|f| matches!(f, Format::Index | Format::Nrrd | Format::DicomSeg));
    let has_gaps = frames.windows(2).any(|pair| pair[0] + 1 != pair[1]);
    let fault = if frames.is_empty() {
        Some(("there is no frame to export", "Give a range inside the recording."))
    } else if prompts == 0 && provenance.left_out.is_empty() {
        Some(("there is no prompt to export", "Give at least one."))
    } else if formats.is_empty() {
        Some(("no format was chosen", "Choose cutout, overlay, binary, index or another one."))
    } else if prompts > 255 && has_labels {
        Some(("label images and volumes can name at most 255 prompts", "Export fewer at a time."))
    } else if has_gaps && formats.iter().any(|f| f.is_series()) {
        Some(("a file about all frames needs them in one piece", "Give a range without gaps."))
    } else {
        None
    };
    fault.map_or(Ok(()), |(what, hint)| Err(Error::input(what, hint)))
}

/// Returns an error if existing files would be overwritten: without a record, they belong to
/// no earlier export.
fn refuse_foreign_files(folder: &Path, provenance: &Provenance, frames: &[usize]) -> Result<()> {
    let mut planned = series_formats(provenance, frames)
        .map(|format| series::name(format, frames))
        .chain(frames.iter().flat_map(|&f| pictures::names(provenance, f)));
    match planned.find(|name| folder.join(name).exists()) {
        None => Ok(()),
        Some(name) => Err(Error::input_at(
            folder.join(name),
            "a file of this name is there already",
            Remedy::Replace.after("Choose an empty folder."),
        )),
    }
}

/// Returns the formats that have one file about all frames; none if there are no frames.
fn series_formats(provenance: &Provenance, frames: &[usize]) -> impl Iterator<Item = Format> {
    let formats = if frames.is_empty() { &[][..] } else { &provenance.options.formats };
    formats.iter().copied().filter(|format| format.is_series())
}

#[cfg(test)]
pub(crate) mod tests;
