//! `NAME.surgtpgs.toml`: what was decided in the program about a recording, in a file of ours beside it, since nothing is
//! ever written into a recording. It overrides `sequence.toml`, for the recording of which it was decided and no other.

use super::{
    Identity,
    layout::{MaskRule, Recording},
    read,
    settings::Keep,
};
use crate::{
    Error, Result,
    files::{FileClaim, Inputs, OutputFile, full_path},
    reading::read_text,
};
use serde::{Deserialize, Serialize};
use std::{
    io::ErrorKind,
    path::{Path, PathBuf},
};

/// Begins the file, and tells it from anybody else's.
const HEAD: &str =
    "# Decided in SurgTPGS about the recording of this name. Delete this file to take it back.\n";

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Decided {
    /// Names and sizes of the recording's frames, hashed: [`Identity::outline_digest`].
    recording: String,
    /// Which side of the mask files is supervised.
    keep_masks: Keep,
}

/// The file beside the recording `path`.
pub(super) fn file(path: &Path) -> PathBuf {
    let path = full_path(path);
    path.with_file_name(format!("{}.surgtpgs.toml", read::file_name(&path)))
}

impl Decided {
    /// Reads the file; `None` where there is none of ours.
    fn read(file: &Path) -> Result<Option<Self>> {
        let text = match read_text(file) {
            // With our ending, the longest names of recordings are no names.
            Err(e) if [ErrorKind::NotFound, ErrorKind::InvalidFilename].contains(&e.kind()) => {
                return Ok(None);
            }
            text => text.map_err(|e| Error::io("read what was decided about the recording", file, e))?,
        };
        if !text.starts_with(HEAD) {
            return Ok(None);
        }
        let wrong = |e: toml::de::Error| Error::input_at(file, e.message().to_owned(), "Delete this file.");
        toml::from_str(&text).map(Some).map_err(wrong)
    }
}

/// Applies what was decided about this very recording.
pub(super) fn apply(recording: &mut Recording, outline: &Identity) -> Result<()> {
    let file = file(&recording.path);
    let Some(decided) = Decided::read(&file)? else { return Ok(()) };
    if decided.recording != outline.outline_digest() {
        recording.notes.push(format!(
            "What was decided in {} was about other frames, and does not count",
            read::file_name(&file)
        ));
    } else if !matches!(recording.mask_rule, MaskRule::DropCode(_)) {
        recording.mask_rule = decided.keep_masks.rule();
    }
    Ok(())
}

/// Writes down which side of the masks of a recording is kept, for whoever opens it from now on. Returns the file.
pub(super) fn keep_masks(recording: &Path, outline: &Identity, keep: Keep) -> Result<PathBuf> {
    let file = file(recording);
    let decided = Decided { recording: outline.outline_digest(), keep_masks: keep };
    let text = toml::to_string(&decided).map_err(|e| Error::input_at(&file, e.to_string(), ""))?;
    let inputs = Inputs::none().with("the recording", recording);
    let is_ours = |file: &Path| read_text(file).is_ok_and(|text| text.starts_with(HEAD));
    let claim = FileClaim { kind: "decisions", inputs: &inputs, replace: true, is_ours };
    OutputFile::claim(&file, claim)?.write(format!("{HEAD}{text}").as_bytes())?;
    Ok(file)
}
