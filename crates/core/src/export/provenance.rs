//! `provenance.json`: how the files of an export were made, and what they are.

use super::{ExportOptions, ExportPrompt};
use crate::{
    Error, Result, files::write_whole, prepare::EncoderIdentity, relevancy::RelevancySettings, scene::Scene,
    sequence::MAX_FRAMES_PER_SECOND,
};
use std::path::Path;

/// The record's name inside an export.
pub const FILE_NAME: &str = "provenance.json";

/// Version of the record's layout.
const SCHEMA: u32 = 3;

/// Frames per second of moving pictures where the recording's own speed is not known.
const USUAL_SPEED: f32 = 25.0;
/// The slowest of them: slower, the times of mp4 files have no numbers.
const SLOWEST: f32 = 1e-3;

/// What the program is for, and what not; the only copy of that text is in `assets/text`.
pub fn intended_use() -> &'static str {
    include_str!("../../../../assets/text/research_use.txt").trim()
}

/// How an export is made. Two exports of equal provenance write the same files. No path of this machine is in it.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Provenance {
    /// Layout version of this record.
    pub schema: u32,
    /// Program and version.
    pub tool: String,
    /// What the files may be used for.
    pub intended_use: String,
    /// SHA-256 of the scene file, hexadecimal.
    pub scene_sha256: String,
    /// The recording's folder or file name.
    pub sequence_name: String,
    /// Frames of the recording.
    pub sequence_frames: usize,
    /// SHA-256 over names, sizes and content of its frames, hexadecimal, where known.
    #[serde(default)]
    pub sequence_sha256: Option<String>,
    /// File names of its frames, from frame 0 on (or their numbers, of a video), where known.
    #[serde(default)]
    pub sequence_frame_names: Vec<String>,
    /// Its speed, where known; finite and above 0.
    pub frames_per_second: Option<f32>,
    /// Whether test frames were held out of training.
    pub held_out: bool,
    /// Program, steps and settings that the scene was trained with.
    pub training: serde_json::Value,
    /// Name of the text encoder.
    pub encoder: String,
    /// SHA-256 over the encoder's files, hexadecimal.
    pub encoder_sha256: String,
    /// Template that prompts are put into.
    pub template: String,
    /// Sharpness, phrases and the other settings of the query; its threshold is that of new prompts, see `prompts`.
    pub relevancy: RelevancySettings,
    /// How scores were computed, e.g. "lattice".
    pub relevancy_rung: String,
    /// What rendered, e.g. "CPU, 2 threads, Avx512".
    pub rendered_by: String,
    /// What was asked for.
    pub prompts: Vec<ExportPrompt>,
    /// What was written.
    pub options: ExportOptions,
}

impl Provenance {
    /// Collects what an export of `scene` is made with. `rendered_by` and `rung` are the names of renderer and relevancy.
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
            frames_per_second: made.frames_per_second.filter(|speed| speed.is_finite() && *speed > 0.0),
            held_out: made.held_out,
            training: serde_json::json!({
                "made_by": made.made_by, "steps": made.steps, "settings": made.settings,
            }),
            encoder: encoder.name.clone(),
            encoder_sha256: encoder.sha256.clone(),
            template: encoder.template.clone(),
            relevancy,
            relevancy_rung: rung.to_owned(),
            rendered_by,
            prompts,
            options,
        }
    }

    /// File name of the recording's frame, where known.
    pub fn source(&self, frame: usize) -> Option<&str> {
        self.sequence_frame_names.get(frame).map(String::as_str)
    }

    /// Seconds from the recording's beginning to `frame`; `None` where its speed is not known.
    pub fn seconds(&self, frame: usize) -> Option<f64> {
        self.frames_per_second.map(|speed| frame as f64 / f64::from(speed))
    }

    /// Frames per second at which moving pictures of the export play: the recording's, where a player can.
    pub fn playing_speed(&self) -> f32 {
        self.frames_per_second.unwrap_or(USUAL_SPEED).clamp(SLOWEST, MAX_FRAMES_PER_SECOND)
    }
}

/// One file of an export.
#[derive(Clone, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub struct ExportedFile {
    /// Path inside the export, with `/`.
    pub name: String,
    /// SHA-256 of its bytes, hexadecimal.
    pub sha256: String,
    /// Frame, counted from 0; `None` where it is about all frames of its name.
    pub frame: Option<usize>,
    /// The prompt it is about; `None` where it shows all of them.
    pub prompt: Option<String>,
}

/// The whole file: how, whether it is finished, and what there is.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub(super) struct Record {
    #[serde(flatten)]
    pub(super) provenance: Provenance,
    pub(super) complete: bool,
    pub(super) files: Vec<ExportedFile>,
}

impl Record {
    pub(super) fn new(provenance: Provenance) -> Self {
        Self { provenance, complete: false, files: Vec::new() }
    }

    /// The record of an earlier export in `folder`; `None` if there is none.
    pub(super) fn read(folder: &Path) -> Result<Option<Self>> {
        let path = folder.join(FILE_NAME);
        let bytes = match std::fs::read(&path) {
            Ok(bytes) => bytes,
            Err(e) if e.kind() == std::io::ErrorKind::NotFound => return Ok(None),
            Err(e) => return Err(Error::io("read the record of the earlier export", path, e)),
        };
        serde_json::from_slice(&bytes).map(Some).map_err(|e| {
            Error::input_at(
                path,
                format!("the record of the earlier export cannot be read: {e}"),
                "Choose an empty folder, or remove this file.",
            )
        })
    }

    /// Adds the files of a frame in place of what was recorded of it.
    pub(super) fn add(&mut self, frame: usize, files: Vec<ExportedFile>) {
        self.files.retain(|f| f.frame != Some(frame));
        self.files.extend(files);
    }

    /// Adds a file about all frames in place of what was recorded under its name.
    pub(super) fn add_series(&mut self, file: ExportedFile) {
        self.files.retain(|f| f.name != file.name);
        self.files.push(file);
    }

    pub(super) fn write(&mut self, folder: &Path) -> Result<()> {
        self.files.sort_by(|a, b| (a.frame, &a.name).cmp(&(b.frame, &b.name)));
        write_whole(&folder.join(FILE_NAME), pretty(self).as_bytes())
    }
}

/// Indented JSON with a final line break.
pub(super) fn pretty(value: &impl serde::Serialize) -> String {
    // Maps with text keys and finite numbers always serialize.
    serde_json::to_string_pretty(value).unwrap_or_default() + "\n"
}
