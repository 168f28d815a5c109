//! Single files for results.

use super::{
    lock::Lock,
    place::{Inputs, real_place, require_outside_of_outputs},
    whole::WholeFile,
};
use crate::{Error, Remedy, Result};
use std::{
    io::Write,
    path::{Path, PathBuf},
    sync::atomic::{AtomicBool, Ordering},
};

/// A request for an output file: the result to write, and the earlier file that may be in its place.
#[derive(Clone, Copy)]
pub struct FileClaim<'a> {
    /// Kind of file, e.g. "scene".
    pub kind: &'a str,
    /// Inputs of the run.
    pub inputs: &'a Inputs,
    /// `true` if an earlier file of the same kind may be replaced.
    pub replace: bool,
    /// Returns `true` if the file at a path is of this kind and written by this program.
    pub is_ours: fn(&Path) -> bool,
}

/// A file that a result is written to, locked until it is dropped.
#[derive(Debug)]
pub struct OutputFile {
    path: PathBuf,
    kind: String,
    is_ours: fn(&Path) -> bool,
    /// `true` if a file of ours is there, to be overwritten.
    is_there: AtomicBool,
    _lock: Lock,
}

impl OutputFile {
    /// Takes the file `path`, which must be new or one that the claim may replace, in a folder that can
    /// be written to (created if missing); links are followed. Returns an error, and changes nothing, if
    /// the file is or lies in an input or another result, or is being written to by another program.
    pub fn claim(path: &Path, claim: FileClaim<'_>) -> Result<Self> {
        let real = real_place(path)?;
        if real.is_dir() {
            return Err(Error::input_at(path, "this is a folder, a file is needed", "Give a file name."));
        }
        claim.inputs.require_apart(&real)?;
        require_outside_of_outputs(&real)?;
        let is_there = require_replaceable(path, &real, &claim)?;
        // A place that cannot be written to is reported before the work begins.
        drop(WholeFile::create(&real)?);
        let lock = Lock::of_file(&real)?;
        let is_there = is_there || require_replaceable(path, &real, &claim)?;
        let FileClaim { kind, is_ours, .. } = claim;
        Ok(Self { path: real, kind: kind.to_owned(), is_ours, is_there: is_there.into(), _lock: lock })
    }

    /// Returns the final path of the file, without links.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Writes the complete file, over an earlier one; returns an error if another program has put a file
    /// there since the claim.
    pub fn write(&self, bytes: &[u8]) -> Result<()> {
        self.write_with(|file| file.write_all(bytes).map_err(|e| Error::io("write the file", &self.path, e)))
    }

    /// Does the same as [`OutputFile::write`], for writers that stream into the file.
    pub fn write_with(&self, write: impl FnOnce(&mut WholeFile) -> Result<()>) -> Result<()> {
        let is_there = self.is_there.load(Ordering::Relaxed);
        if is_there && self.path.exists() && !(self.is_ours)(&self.path) {
            return Err(foreign(&self.path, &self.kind));
        }
        let mut file = WholeFile::create(&self.path)?;
        write(&mut file).map_err(|error| match error {
            // It knows of the temporary file alone, and that is not the one that matters.
            Error::Io { doing, source, path } if path.as_os_str().is_empty() => {
                Error::io(doing, &self.path, source.kind().into())
            }
            other => other,
        })?;
        if is_there { file.commit() } else { file.commit_new() }?;
        self.is_there.store(true, Ordering::Relaxed);
        Ok(())
    }
}

/// Returns `true` if there is a file that the claim may replace; an error if it may not.
fn require_replaceable(path: &Path, real: &Path, claim: &FileClaim<'_>) -> Result<bool> {
    if !real.exists() {
        return Ok(false);
    }
    if !(claim.is_ours)(real) {
        return Err(foreign(path, claim.kind));
    }
    if !claim.replace {
        let what = format!("there is an earlier result here ({})", claim.kind);
        return Err(Error::input_at(path, what, Remedy::Replace.after("Give another name.")));
    }
    Ok(true)
}

fn foreign(path: &Path, kind: &str) -> Error {
    let what =
        format!("there is a file here that this program did not write as this kind of result ({kind})");
    Error::input_at(path, what, "Choose another name.")
}
