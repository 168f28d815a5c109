//! Unfinished training on disk: a short header with a checksum, then identity, settings and state in
//! postcard's format.

use super::{settings::TrainSettings, state::TrainState};
use crate::{
    Error, Kept, Result,
    files::write_whole_with,
    hash::sha256,
    prepare::Prepared,
    reading::{ANY_SIZE, read_regular},
    sequence::{Identity, Sequence},
};
use sha2::{Digest, Sha256};
use std::{
    fs::File,
    io::{BufWriter, IntoInnerError, Read, Seek, SeekFrom, Write},
    path::Path,
};

/// First bytes of a checkpoint; the last byte is the version of the layout. The SHA-256 of the rest of
/// the file follows.
const MAGIC: &[u8; 16] = b"SurgTPGS train B";
const SUM_BYTES: usize = 32;

/// Material that a checkpoint belongs to.
#[derive(Debug, PartialEq, serde::Serialize, serde::Deserialize)]
struct TrainedOn {
    frames: usize,
    width: usize,
    height: usize,
    /// Hash of what is learned from besides the pictures, see [`supervision_digest`].
    supervision: String,
}

impl TrainedOn {
    fn new(sequence: &Sequence, supervision: String) -> Self {
        let [frames, width, height] = [sequence.num_frames(), sequence.width(), sequence.height()];
        Self { frames, width, height, supervision }
    }
}

/// Returns the SHA-256, hexadecimal, over everything that a training learns from besides the pictures:
/// cameras, the meaning of depth and masks, and features. Poses and lenses that were estimated do not count.
pub fn supervision_digest(sequence: &Sequence, prepared: Option<&Prepared>) -> String {
    let features = prepared.map(Prepared::digest).unwrap_or_default();
    sha256(format!("{} {features}", sequence.supervision_digest()).as_bytes())
}

/// Contents of a checkpoint; `T` and `S` are settings and state, or borrow them.
#[derive(serde::Serialize, serde::Deserialize)]
struct Checkpoint<T, S> {
    source: TrainedOn,
    settings: T,
    state: S,
}

/// Returns `true` if the file at `path` is an unfinished training, of any version.
pub fn is_checkpoint(path: &Path) -> bool {
    let mut start = [0; MAGIC.len()];
    let read = std::fs::File::open(path).and_then(|mut file| file.read_exact(&mut start));
    // The last byte is the version.
    read.is_ok() && start.starts_with(&MAGIC[..MAGIC.len() - 1])
}

/// Writes a checkpoint completely or not at all.
pub(super) fn write(
    path: &Path,
    (sequence, supervision): (&Sequence, &str),
    identity: &Identity,
    settings: &TrainSettings,
    state: &TrainState,
) -> Result<()> {
    let checkpoint = Checkpoint { source: TrainedOn::new(sequence, supervision.to_owned()), settings, state };
    write_whole_with(path, |file| {
        let mut body = Summed { file: BufWriter::new(file), sum: Sha256::new() };
        // The checksum is only known at the end and is then written here.
        body.file.write_all(&[&MAGIC[..], &[0; SUM_BYTES]].concat())?;
        let Summed { file, sum } =
            postcard::to_io(&(identity, &checkpoint), body).map_err(std::io::Error::other)?;
        let file = file.into_inner().map_err(IntoInnerError::into_error)?;
        file.seek(SeekFrom::Start(MAGIC.len() as u64))?;
        file.write_all(&sum.finalize())
    })
}

/// A file and the checksum of everything written to it.
struct Summed<'a> {
    file: BufWriter<&'a mut File>,
    sum: Sha256,
}

impl Write for Summed<'_> {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        let written = self.file.write(bytes)?;
        self.sum.update(&bytes[..written]);
        Ok(written)
    }

    fn flush(&mut self) -> std::io::Result<()> {
        self.file.flush()
    }
}

const AGAIN: &str = "Train again from the beginning.";

/// Reads a checkpoint; one that is damaged, or of another version, is no failure.
///
/// # Errors
/// It cannot be read, or belongs to the training of other material.
pub(super) fn read(
    path: &Path,
    sequence: &Sequence,
    prepared: Option<&Prepared>,
    identity: &Identity,
) -> Result<Kept<(TrainSettings, TrainState)>> {
    let bytes =
        read_regular(path, ANY_SIZE).map_err(|e| Error::io("read the unfinished training", path, e))?;
    let (begun_on, checkpoint) = match parse(&bytes, path) {
        Ok(parsed) => parsed,
        Err(unusable) => return Ok(Kept::Damaged(unusable)),
    };
    identity.require(&begun_on, sequence.path(), "the unfinished training was begun on")?;
    if checkpoint.source != TrainedOn::new(sequence, supervision_digest(sequence, prepared)) {
        return Err(Error::input_at(
            path,
            "the unfinished training was begun with other cameras, depth, masks or features than these",
            AGAIN,
        ));
    }
    Ok(Kept::Usable((checkpoint.settings, checkpoint.state)))
}

fn parse(bytes: &[u8], path: &Path) -> Result<(Identity, Checkpoint<TrainSettings, TrainState>)> {
    let damaged =
        |what: &str| Error::input_at(path, format!("the unfinished training is damaged: {what}"), AGAIN);
    let foreign = || Error::input_at(path, "this is no unfinished training of this version", AGAIN);
    let rest = bytes.strip_prefix(MAGIC).ok_or_else(foreign)?;
    let (checksum, body) = rest.split_at_checked(SUM_BYTES).ok_or_else(|| damaged("it is cut off"))?;
    if Sha256::digest(body)[..] != *checksum {
        return Err(damaged("its checksum differs"));
    }
    let parsed: (Identity, Checkpoint<TrainSettings, TrainState>) =
        postcard::from_bytes(body).map_err(|e| damaged(&e.to_string()))?;
    if parsed.1.state.is_consistent() { Ok(parsed) } else { Err(damaged("its sizes differ")) }
}
