//! Unfinished training on disk: a short header, then settings and state in postcard's format.

use super::{settings::TrainSettings, state::State};
use crate::{
    Error, Result,
    files::write_whole_with,
    prepare::Prepared,
    reading::{MOST_BYTES, read_regular},
    sequence::Sequence,
};
use std::{io::Read, path::Path};

/// First bytes of a checkpoint; the last one is the layout's version.
const MAGIC: &[u8; 16] = b"SurgTPGS train 1";

/// What a checkpoint belongs to.
#[derive(Debug, PartialEq, serde::Serialize, serde::Deserialize)]
struct Source {
    frames: usize,
    width: usize,
    height: usize,
    /// The features' table; empty without features.
    latents: Vec<f32>,
}

impl Source {
    fn of(sequence: &Sequence, prepared: Option<&Prepared>) -> Self {
        Self {
            frames: sequence.num_frames(),
            width: sequence.width(),
            height: sequence.height(),
            latents: prepared.map(|p| p.latents.clone()).unwrap_or_default(),
        }
    }
}

#[derive(serde::Serialize, serde::Deserialize)]
struct Checkpoint {
    source: Source,
    settings: TrainSettings,
    state: State,
}

/// Whether the file at `path` is an unfinished training, of whatever version.
pub fn is_checkpoint(path: &Path) -> bool {
    let mut start = [0; MAGIC.len()];
    let read = std::fs::File::open(path).and_then(|mut file| file.read_exact(&mut start));
    // The last bytes are the version's.
    read.is_ok() && start.starts_with(b"SurgTPGS train ")
}

/// Writes a checkpoint whole.
pub(super) fn write(
    path: &Path,
    sequence: &Sequence,
    prepared: Option<&Prepared>,
    settings: &TrainSettings,
    state: State,
) -> Result<()> {
    let checkpoint = Checkpoint { source: Source::of(sequence, prepared), settings: settings.clone(), state };
    write_whole_with(path, |file| {
        let mut file = std::io::BufWriter::new(file);
        std::io::Write::write_all(&mut file, MAGIC)?;
        let file = postcard::to_io(&checkpoint, file).map_err(std::io::Error::other)?;
        file.into_inner().map_err(std::io::IntoInnerError::into_error)?;
        Ok(())
    })
}

/// Reads a checkpoint of training on this very material.
pub(super) fn read(
    path: &Path,
    sequence: &Sequence,
    prepared: Option<&Prepared>,
) -> Result<(TrainSettings, State)> {
    const AGAIN: &str = "Train again from the beginning.";
    let bytes =
        read_regular(path, MOST_BYTES).map_err(|e| Error::io("read the unfinished training", path, e))?;
    let Some(body) = bytes.strip_prefix(MAGIC) else {
        return Err(Error::input_at(path, "this is no unfinished training of this version", AGAIN));
    };
    let checkpoint: Checkpoint = postcard::from_bytes(body)
        .map_err(|e| Error::input_at(path, format!("the unfinished training is damaged: {e}"), AGAIN))?;
    if checkpoint.source != Source::of(sequence, prepared) {
        return Err(Error::input_at(
            path,
            "the unfinished training belongs to another recording, or the recording was prepared anew",
            AGAIN,
        ));
    }
    if !checkpoint.state.is_consistent() {
        return Err(Error::input_at(path, "the unfinished training is damaged: its sizes differ", AGAIN));
    }
    Ok((checkpoint.settings, checkpoint.state))
}
