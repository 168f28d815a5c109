//! `NAME.surgtpgs.toml`: decisions that the user made in the program about a recording. The file lies
//! beside the recording, because nothing is ever written into one. It overrides `sequence.toml`, but only
//! for the very recording that the decisions were about.

use super::{
    Identity, read,
    recording::{Keep, MaskRule, Recording},
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

/// First lines of the file, which tell it from files of other programs.
const HEAD: &str =
    "# Decided in SurgTPGS about the recording of this name. Delete this file to take it back.\n";

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Decided {
    /// Hash of the names and sizes of the recording's frames: [`Identity::outline_digest`].
    recording: String,
    /// The side of the mask files that is supervised.
    keep_masks: Keep,
}

/// Returns the path of the file beside the recording `path`.
pub(super) fn file(path: &Path) -> PathBuf {
    let path = full_path(path);
    path.with_file_name(format!("{}.surgtpgs.toml", read::file_name(&path)))
}

impl Decided {
    /// Reads the file; `None` if there is none or it is not ours.
    fn read(file: &Path) -> Result<Option<Self>> {
        let text = match read_text(file) {
            // Our ending can make the name of a recording too long for the file system.
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

/// Applies the decisions about this very recording.
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

/// Writes down which side of the masks of a recording is kept, for everyone who opens it later. Returns
/// the path of the file.
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
