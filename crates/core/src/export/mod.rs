//! Masked frames on disk: cut-outs, overlays, binary masks and label images, with a record of how they were made.
//!
//! An export is driven frame by frame, so that a window or a command line can show progress and stop at any point:
//!
//! ```text
//! Export::begin ─▶ next_frame ─▶ (the caller renders and scores it) ─▶ write ─▶ … ─▶ finish ─▶ provenance.json
//! ```
//!
//! Files are written whole. Beginning again in the same folder with the same request goes on where it stopped;
//! a file that is not this export's own is never overwritten unless that is asked for.

mod pictures;
mod provenance;
mod stamp;

pub use provenance::{ExportedFile, FILE_NAME as PROVENANCE_FILE, Provenance, file_sha256, intended_use};

use crate::{
    Error, Result,
    files::write_whole,
    grid::{Grid, Mask},
    mask,
    overlay::OverlayStyle,
};
use image::RgbImage;
use provenance::Record;
use rayon::prelude::*;
use std::path::{Path, PathBuf};

/// Finished frames between two updates of the record; one more is written at the end and after a failure.
const RECORD_EVERY: usize = 32;

/// What is written per frame; each format has its own folder.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Format {
    /// RGBA PNG per prompt, straight alpha 0 or 255; what is cut away is black.
    Cutout,
    /// RGB PNG of the frame with all prompts drawn over it, and the research-use stamp.
    Overlay,
    /// 8-bit grey PNG per prompt: 255 where found, else 0.
    Binary,
    /// 8-bit grey PNG of label ids, 0 = nothing; `labels.json` names them. A pixel has the best prompt's id.
    Index,
}

impl Format {
    /// The format's folder inside the export.
    pub fn folder(self) -> &'static str {
        match self {
            Self::Cutout => "cutout",
            Self::Overlay => "overlay",
            Self::Binary => "binary",
            Self::Index => "index",
        }
    }

    /// Whether there is one file per prompt, not one per frame.
    pub fn is_per_prompt(self) -> bool {
        matches!(self, Self::Cutout | Self::Binary)
    }
}

/// Which pictures the masks are applied to.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Source {
    /// The recorded frames.
    #[default]
    Original,
    /// The frames as the scene renders them.
    Reconstruction,
}

/// What to write.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct ExportOptions {
    /// What is written per frame.
    pub formats: Vec<Format>,
    /// Which pictures the masks are applied to; for the record, the caller hands them over.
    pub source: Source,
    /// Whether a pixel belongs to at most one prompt (the one with the best score).
    pub exclusive: bool,
    /// Whether overlays say "research use only".
    pub stamp: bool,
    /// How overlays are drawn.
    pub style: OverlayStyle,
    /// Opacity of fills and heatmaps in overlays, 0–1.
    pub opacity: f32,
}

impl Default for ExportOptions {
    fn default() -> Self {
        Self {
            formats: vec![Format::Cutout, Format::Overlay],
            source: Source::Original,
            exclusive: false,
            stamp: true,
            style: OverlayStyle::Outline,
            opacity: 0.35,
        }
    }
}

/// One prompt of an export.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct ExportPrompt {
    /// The words as typed.
    pub text: String,
    /// Score above which a pixel is found.
    pub threshold: f32,
    /// Colour in overlays and `labels.json` (sRGB).
    pub colour: [u8; 3],
    /// What the prompt was compared to.
    pub negatives: Vec<String>,
}

/// An export under way; see the module's page.
#[derive(Debug)]
pub struct Export {
    folder: PathBuf,
    frames: Vec<usize>,
    next: usize,
    overwrite: bool,
    record: Record,
    unsaved: usize,
    skipped: usize,
}

/// What an export left behind.
#[derive(Clone, Debug, PartialEq, Eq, serde::Serialize)]
pub struct ExportSummary {
    /// Whether every frame asked for is there.
    pub complete: bool,
    /// Frames asked for.
    pub frames: usize,
    /// Frames that were there already and left alone.
    pub skipped_frames: usize,
    /// Files of the export, `provenance.json` and `labels.json` not counted.
    pub files: usize,
}

impl Export {
    /// Starts, or goes on with, the export of `frames` into `folder`.
    ///
    /// Fails if there are no frames, prompts or formats, more than 255 prompts for label images, or if the folder holds
    /// files of another export and `overwrite` is false.
    pub fn begin(folder: &Path, frames: Vec<usize>, provenance: Provenance, overwrite: bool) -> Result<Self> {
        validate(&frames, &provenance)?;
        let record = match Record::read(folder)? {
            Some(found) if found.provenance == provenance => found,
            Some(_) if !overwrite => {
                return Err(Error::input_at(
                    folder,
                    "the folder holds another export",
                    "Choose an empty folder, or overwrite with `--force`.",
                ));
            }
            Some(_) => Record::new(provenance),
            None => {
                refuse_foreign_files(folder, &provenance, &frames, overwrite)?;
                Record::new(provenance)
            }
        };
        let mut export =
            Self { folder: folder.to_owned(), frames, next: 0, overwrite, record, unsaved: 0, skipped: 0 };
        export.write_labels()?;
        export.save(false)?;
        Ok(export)
    }

    /// How many frames were asked for.
    pub fn num_frames(&self) -> usize {
        self.frames.len()
    }

    /// How many of them are done or skipped.
    pub fn frames_done(&self) -> usize {
        self.next
    }

    /// The next frame to render and [`Export::write`]; frames whose files are all there are skipped. `None` at the end.
    pub fn next_frame(&mut self) -> Option<usize> {
        while let Some(&frame) = self.frames.get(self.next) {
            if self.overwrite || !self.is_finished(frame) {
                return Some(frame);
            }
            self.next += 1;
            self.skipped += 1;
        }
        None
    }

    /// Writes the files of the frame that [`Export::next_frame`] gave: `picture` and one score image per prompt, all of
    /// one size. Where it fails, finished files are complete and recorded.
    pub fn write(&mut self, picture: &RgbImage, scores: &[Grid<f32>]) -> Result<()> {
        let Some(&frame) = self.frames.get(self.next) else { return Ok(()) };
        self.check_sizes(picture, scores)?;
        let files = pictures::draw(&self.record.provenance, frame, picture, scores)?;
        let written: Result<Vec<ExportedFile>> =
            files.into_par_iter().map(|file| self.write_file(frame, file)).collect();
        match written {
            Ok(files) => self.record.add(frame, files),
            Err(e) => {
                // The disk may be full: what stopped the export is the error to report, not this one.
                let _ = self.save(false);
                return Err(e);
            }
        }
        self.next += 1;
        self.unsaved += 1;
        if self.unsaved >= RECORD_EVERY { self.save(false) } else { Ok(()) }
    }

    /// Writes the record; to be called after the last frame and after stopping early.
    pub fn finish(mut self) -> Result<ExportSummary> {
        let complete = self.next >= self.frames.len();
        self.save(complete)?;
        Ok(ExportSummary {
            complete,
            frames: self.frames.len(),
            skipped_frames: self.skipped,
            files: self.record.files.len(),
        })
    }

    fn is_finished(&self, frame: usize) -> bool {
        let provenance = &self.record.provenance;
        let expected = pictures::names(provenance, frame);
        expected.iter().all(|name| {
            let recorded = self.record.files.iter().find(|f| f.frame == frame && f.name == *name);
            recorded.is_some_and(|file| {
                std::fs::read(self.folder.join(name)).is_ok_and(|b| provenance::sha256(&b) == file.sha256)
            })
        })
    }

    fn write_file(&self, frame: usize, file: pictures::File) -> Result<ExportedFile> {
        let path = self.folder.join(&file.name);
        let sha256 = provenance::sha256(&file.bytes);
        match std::fs::read(&path) {
            Ok(there) if there == file.bytes => {}
            Ok(_) if !self.overwrite => {
                return Err(Error::input_at(
                    path,
                    "a file of the export is there already, with other content",
                    "It was changed since. Choose an empty folder, or overwrite with `--force`.",
                ));
            }
            _ => write_whole(&path, &file.bytes)?,
        }
        Ok(ExportedFile { name: file.name, sha256, frame, prompt: file.prompt })
    }

    fn check_sizes(&self, picture: &RgbImage, scores: &[Grid<f32>]) -> Result<()> {
        let size = (picture.width() as usize, picture.height() as usize);
        let prompts = self.record.provenance.prompts.len();
        if scores.len() != prompts {
            return Err(Error::input(
                format!("{} score images for {prompts} prompts", scores.len()),
                "Ask the scene for the prompts of the export.",
            ));
        }
        match scores.iter().find(|s| (s.width, s.height) != size) {
            None => Ok(()),
            Some(s) => Err(Error::input(
                format!("the picture is {}×{}, its scores are {}×{}", size.0, size.1, s.width, s.height),
                "Export at the recording's size.",
            )),
        }
    }

    fn write_labels(&self) -> Result<()> {
        if !self.record.provenance.options.formats.contains(&Format::Index) {
            return Ok(());
        }
        let label = |(i, p): (usize, &ExportPrompt)| serde_json::json!({ "id": i + 1, "prompt": p.text, "colour": p.colour });
        let labels: Vec<_> = self.record.provenance.prompts.iter().enumerate().map(label).collect();
        let text = provenance::pretty(&serde_json::json!({ "background": 0, "labels": labels }));
        write_whole(&self.folder.join(Format::Index.folder()).join("labels.json"), text.as_bytes())
    }

    fn save(&mut self, complete: bool) -> Result<()> {
        self.unsaved = 0;
        self.record.complete = complete;
        self.record.write(&self.folder)
    }
}

/// The part of a file name that stands for a prompt: lower-case ASCII letters, digits and hyphens; `_` and the prompt's
/// number are added where several prompts would give the same.
pub fn slugs<'a>(prompts: impl IntoIterator<Item = &'a str>) -> Vec<String> {
    let plain: Vec<String> = prompts.into_iter().map(slug).collect();
    let is_unique = |s: &str| !s.is_empty() && plain.iter().filter(|o| o.as_str() == s).count() == 1;
    let name = |(i, s): (usize, &String)| match (is_unique(s), s.is_empty()) {
        (true, _) => s.clone(),
        (false, true) => format!("prompt_{}", i + 1),
        (false, false) => format!("{s}_{}", i + 1),
    };
    plain.iter().enumerate().map(name).collect()
}

fn slug(text: &str) -> String {
    let words = text.split(|c: char| !c.is_ascii_alphanumeric()).filter(|w| !w.is_empty());
    let joined = words.map(str::to_ascii_lowercase).collect::<Vec<_>>().join("-");
    joined.chars().take(40).collect::<String>().trim_end_matches('-').to_owned()
}

/// One mask per prompt, from its scores and threshold; disjoint if `exclusive`.
pub fn masks(scores: &[Grid<f32>], prompts: &[ExportPrompt], exclusive: bool) -> Vec<Mask> {
    if exclusive {
        let thresholds: Vec<f32> = prompts.iter().map(|p| p.threshold).collect();
        mask::exclusive(&scores.iter().collect::<Vec<_>>(), &thresholds)
    } else {
        scores.iter().zip(prompts).map(|(s, p)| mask::threshold(s, p.threshold)).collect()
    }
}

fn validate(frames: &[usize], provenance: &Provenance) -> Result<()> {
    let prompts = provenance.prompts.len();
    let fault = if frames.is_empty() {
        Some(("there is no frame to export", "Give a range inside the recording."))
    } else if prompts == 0 {
        Some(("there is no prompt to export", "Give at least one."))
    } else if provenance.options.formats.is_empty() {
        Some(("no format was chosen", "Choose cutout, overlay, binary or index."))
    } else if prompts > 255 && provenance.options.formats.contains(&Format::Index) {
        Some(("label images can name at most 255 prompts", "Export fewer at a time."))
    } else {
        None
    };
    fault.map_or(Ok(()), |(what, hint)| Err(Error::input(what, hint)))
}

/// Without a record of an earlier export, nothing that is there may be overwritten.
fn refuse_foreign_files(
    folder: &Path,
    provenance: &Provenance,
    frames: &[usize],
    overwrite: bool,
) -> Result<()> {
    let mut planned = frames.iter().flat_map(|&f| pictures::names(provenance, f));
    match planned.find(|name| !overwrite && folder.join(name).exists()) {
        None => Ok(()),
        Some(name) => Err(Error::input_at(
            folder.join(name),
            "a file of this name is there already",
            "Choose an empty folder, or overwrite with `--force`.",
        )),
    }
}

#[cfg(test)]
mod tests;
