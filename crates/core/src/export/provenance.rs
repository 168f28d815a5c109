//! `provenance.json`: a record of how the files of an export were made, and of their names and hashes.

use super::{ExportOptions, ExportPrompt, LeftOut};
use crate::{
    Error, Result,
    about::intended_use,
    files::write_whole,
    meaning::EncoderIdentity,
    reading::{MOST_BYTES, read_regular},
    relevancy::RelevancySettings,
    scene::Scene,
    sequence::{HiddenRectangle, MAX_FRAMES_PER_SECOND, USUAL_SPEED, seconds_of, shown_for},
};
use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
};

/// Name of the record inside an export.
pub const FILE_NAME: &str = "provenance.json";

/// Version of the record's layout.
const SCHEMA: u32 = 4;

/// Lowest frames per second of moving pictures: the times of slower mp4 files cannot be stored.
const SLOWEST: f32 = 1e-3;

/// Description of how an export is made. Two exports of equal provenance write the same files. It
/// contains no path of this machine.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Provenance {
    /// Layout version of this record.
    pub schema: u32,
    /// Program and version.
    pub tool: String,
    /// Permitted use of the files.
    pub intended_use: String,
    /// SHA-256 of the scene file, hexadecimal.
    pub scene_sha256: String,
    /// The recording's folder or file name.
    pub sequence_name: String,
    /// Number of frames of the recording.
    pub sequence_frames: usize,
    /// SHA-256 over names, sizes and content of its frames, hexadecimal, if known.
    #[serde(default)]
    pub sequence_sha256: Option<String>,
    /// File names of its frames, from frame 0 on (or their numbers, for a video), if known.
    #[serde(default)]
    pub sequence_frame_names: Vec<String>,
    /// Rectangles that are black in every frame, in pixels. The recorded files show what is there.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub hidden: Vec<HiddenRectangle>,
    /// Runs of frames that no chapter of the scene shows, each by its first and last frame.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub frames_not_shown: Vec<[usize; 2]>,
    /// Its frame rate, if known; finite and above 0.
    pub frames_per_second: Option<f32>,
    /// Time of every frame after the first, seconds; empty if the frame rate tells it, or nothing does.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub frame_seconds: Vec<f64>,
    /// `true` if test frames were held out of training.
    pub held_out: bool,
    /// Program, steps and settings that the scene was trained with.
    pub training: serde_json::Value,
    /// Name of the text encoder.
    pub encoder: String,
    /// SHA-256 over the encoder's files, hexadecimal.
    pub encoder_sha256: String,
    /// Template that prompts are put into.
    pub template: String,
    /// Sharpness, phrases and the other settings of the query; its threshold is that of new
    /// prompts, see `prompts`.
    pub relevancy: RelevancySettings,
    /// Method by which scores were computed, e.g. "lattice".
    pub relevancy_rung: String,
    /// Renderer without the number of its threads, which changes no file, e.g. "CPU, Avx512".
    pub rendered_by: String,
    /// Prompts of the export.
    pub prompts: Vec<ExportPrompt>,
    /// SHA-256 over the marks by hand that the answers follow, hexadecimal; `None` without marks.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub marks_sha256: Option<String>,
    /// SHA-256 over the network that made masks of what marks point at, hexadecimal; `None` without one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub marks_model_sha256: Option<String>,
    /// SHA-256 over the identifiers of the DICOM files that a segmentation refers to, hexadecimal; `None` without
    /// references. The identifiers themselves are in the segmentation alone.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub dicom_sources_sha256: Option<String>,
    /// Words of which nothing was written, because they mean nothing in the recording.
    #[serde(default)]
    pub left_out: Vec<LeftOut>,
    /// Measure of how far the text encoder tells words apart, and what unrelated words reach with the scene's
    /// classes; if the scene knows.
    #[serde(default)]
    pub calibration: serde_json::Value,
    /// Options of the export.
    pub options: ExportOptions,
}

impl Provenance {
    /// Collects the provenance of an export of `scene`. `rendered_by` and `rung` are the names of
    /// renderer and relevancy.
    pub fn new(
        scene: &Scene,
        scene_sha256: String,
        encoder: &EncoderIdentity,
        relevancy: RelevancySettings,
        (rendered_by, rung): (String, &str),
        prompts: Vec<ExportPrompt>,
        options: ExportOptions,
    ) -> Self {
        let made = &scene.provenance;
        Self {
            schema: SCHEMA,
            tool: format!("SurgTPGS {}", env!("CARGO_PKG_VERSION")),
            intended_use: intended_use().to_owned(),
            scene_sha256,
            sequence_name: made.sequence_name.clone(),
            sequence_frames: scene.num_frames(),
            sequence_sha256: made.identity.as_ref().map(|identity| identity.digest()),
            sequence_frame_names: made
                .identity
                .iter()
                .flat_map(|identity| identity.names().map(str::to_owned))
                .collect(),
            hidden: made.identity.as_ref().map_or(Vec::new(), |identity| identity.hidden().to_vec()),
            frames_not_shown: scene.frames_not_shown(),
            frames_per_second: made.speed(),
            frame_seconds: made.frame_seconds.clone(),
            held_out: made.held_out,
            training: serde_json::json!({
                "made_by": made.made_by, "steps": made.steps, "settings": made.settings,
            }),
            encoder: encoder.name.clone(),
            encoder_sha256: encoder.sha256.clone(),
            template: encoder.template.clone(),
            relevancy,
            relevancy_rung: rung.to_owned(),
            rendered_by: without_threads(&rendered_by),
            prompts,
            marks_sha256: None,
            marks_model_sha256: None,
            dicom_sources_sha256: None,
            left_out: Vec::new(),
            calibration: scene.words.summary(),
            options,
        }
    }

    /// Returns the file name of the recording's frame, if known.
    pub fn source(&self, frame: usize) -> Option<&str> {
        self.sequence_frame_names.get(frame).map(String::as_str)
    }

    /// Returns `true` if the scene shows `frame`. What it does not show was looked for by nobody.
    pub fn shows(&self, frame: usize) -> bool {
        !self.frames_not_shown.iter().any(|[first, last]| (first..=last).contains(&&frame))
    }

    /// Returns the seconds from the recording's beginning to `frame`; `None` if its speed is not known.
    pub fn seconds(&self, frame: usize) -> Option<f64> {
        seconds_of(frame, &self.frame_seconds, self.frames_per_second)
    }

    /// Returns the seconds of [`Provenance::seconds`], by the usual speed where the recording's is not known, as
    /// the window does.
    pub fn shown_seconds(&self, frame: usize) -> f64 {
        self.seconds(frame).unwrap_or(frame as f64 / f64::from(USUAL_SPEED))
    }

    /// Returns the frames per second at which moving pictures of the export play: those of the recording,
    /// if a player supports them.
    pub fn playing_speed(&self) -> f32 {
        self.frames_per_second.unwrap_or(USUAL_SPEED).clamp(SLOWEST, MAX_FRAMES_PER_SECOND)
    }

    /// Returns the seconds at which each of `frames` appears where the export plays, and those of the end. Each
    /// is shown as long as in the recording.
    pub fn starts(&self, frames: &[usize]) -> Vec<f64> {
        let usual = 1.0 / f64::from(self.playing_speed());
        let lasts = |frame: usize| shown_for(frame, &self.frame_seconds).unwrap_or(usual);
        let after = |at: &mut f64, frame: &usize| {
            *at += lasts(*frame);
            Some(*at)
        };
        std::iter::once(0.0).chain(frames.iter().scan(0.0, after)).collect()
    }
}

/// Returns the name of a renderer without the number of its threads.
fn without_threads(name: &str) -> String {
    name.split(", ").filter(|part| !part.ends_with(" threads")).collect::<Vec<_>>().join(", ")
}

/// One file of an export.
#[derive(Clone, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub struct ExportedFile {
    /// Path inside the export, with `/`.
    pub name: String,
    /// SHA-256 of its bytes, hexadecimal.
    pub sha256: String,
    /// Frame, counted from 0; `None` if it is about all frames of its name.
    pub frame: Option<usize>,
    /// The prompt it is about; `None` if it shows all of them.
    pub prompt: Option<String>,
}

/// Returns the files of the export that lies in `folder`, or around it, by their paths from `folder`; none if
/// there is no record of one.
pub(crate) fn exported_files(folder: &Path) -> BTreeMap<PathBuf, ExportedFile> {
    let mut found: BTreeMap<_, _> =
        recorded_files(folder).into_iter().map(|file| (PathBuf::from(&file.name), file)).collect();
    // A path as it was given may not name the folder around.
    let whole = folder.canonicalize().unwrap_or_default();
    if let (Some(around), Some(part)) = (whole.parent(), whole.file_name()) {
        for file in recorded_files(around) {
            if let Ok(path) = Path::new(&file.name).strip_prefix(part) {
                found.entry(path.to_owned()).or_insert(file);
            }
        }
    }
    found
}

/// Returns the files that the record in `folder` lists; none if there is none, or one of another program.
fn recorded_files(folder: &Path) -> Vec<ExportedFile> {
    #[derive(serde::Deserialize)]
    struct Files {
        files: Vec<ExportedFile>,
    }
    let bytes = read_regular(&folder.join(FILE_NAME), MOST_BYTES).unwrap_or_default();
    serde_json::from_slice(&bytes).map_or(Vec::new(), |Files { files }| files)
}

/// The complete file: provenance, whether the export is finished, and its files.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub(super) struct Record {
    #[serde(flatten)]
    pub(super) provenance: Provenance,
    pub(super) complete: bool,
    pub(super) files: Files,
}

impl Record {
    pub(super) fn new(provenance: Provenance) -> Self {
        Self { provenance, complete: false, files: Files::default() }
    }

    /// Reads the record of an earlier export in `folder`; `None` if there is none.
    pub(super) fn read(folder: &Path) -> Result<Option<Self>> {
        let path = folder.join(FILE_NAME);
        let bytes = match std::fs::read(&path) {
            Ok(bytes) => bytes,
            Err(e) if e.kind() == std::io::ErrorKind::NotFound => return Ok(None),
            Err(e) => return Err(Error::io("read the record of the earlier export", path, e)),
        };
        let mut record: Self = serde_json::from_slice(&bytes).map_err(|e| {
            Error::input_at(
                path,
                format!("the record of the earlier export cannot be read: {e}"),
                "Choose an empty folder, or remove this file.",
            )
        })?;
        // Older records have the number of threads.
        record.provenance.rendered_by = without_threads(&record.provenance.rendered_by);
        Ok(Some(record))
    }

    /// Adds the files of a frame and removes earlier entries about it.
    pub(super) fn add(&mut self, frame: usize, files: Vec<ExportedFile>) {
        self.files.0.remove(&Some(frame));
        files.into_iter().for_each(|file| self.files.add(file));
    }

    /// Adds a file about all frames and removes an earlier entry of its name.
    pub(super) fn add_series(&mut self, file: ExportedFile) {
        self.files.add(file);
    }

    pub(super) fn write(&self, folder: &Path) -> Result<()> {
        write_whole(&folder.join(FILE_NAME), pretty(self).as_bytes())
    }
}

/// Files of an export by the frame that they are about, each frame's by name. In JSON they are one list in
/// this order.
#[derive(Clone, Debug, Default, PartialEq, serde::Deserialize)]
#[serde(from = "Vec<ExportedFile>")]
pub(super) struct Files(BTreeMap<Option<usize>, Vec<ExportedFile>>);

impl Files {
    /// Returns the files about `frame`; for `None`, those about all frames.
    pub(super) fn of(&self, frame: Option<usize>) -> &[ExportedFile] {
        self.0.get(&frame).map_or(&[], Vec::as_slice)
    }

    /// Returns all files, those about all frames first.
    pub(super) fn all(&self) -> impl Iterator<Item = &ExportedFile> {
        self.0.values().flatten()
    }

    /// Adds a file and removes an earlier entry of its name about the same frame.
    fn add(&mut self, file: ExportedFile) {
        let of_frame = self.0.entry(file.frame).or_default();
        match of_frame.binary_search_by(|other| other.name.cmp(&file.name)) {
            Ok(place) => of_frame[place] = file,
            Err(place) => of_frame.insert(place, file),
        }
    }
}

impl From<Vec<ExportedFile>> for Files {
    fn from(listed: Vec<ExportedFile>) -> Self {
        let mut files = Self::default();
        listed.into_iter().for_each(|file| files.add(file));
        files
    }
}

impl serde::Serialize for Files {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_seq(self.all())
    }
}

/// Returns indented JSON with a final line break.
pub(super) fn pretty(value: &impl serde::Serialize) -> String {
    // Maps with text keys and finite numbers can always be serialized.
    serde_json::to_string_pretty(value).unwrap_or_default() + "\n"
}
