//! Single files that results are written to.

use super::{
    lock::Lock,
    place::{Inputs, real_place, require_outside_of_outputs},
    whole::{WholeFile, write_whole},
};
use crate::{Error, Result};
use std::path::{Path, PathBuf};

/// What is to be written, and what may be in its place.
#[derive(Clone, Copy)]
pub struct FileClaim<'a> {
    /// Kind of file, e.g. "scene".
    pub kind: &'a str,
    /// What the run reads.
    pub inputs: &'a Inputs,
    /// Whether an earlier file of the same kind may be replaced.
    pub replace: bool,
    /// Whether the file at a path is of this kind and written by this program.
    pub is_ours: &'a dyn Fn(&Path) -> bool,
}

/// A file that a result is written to, locked until it is dropped.
#[derive(Debug)]
pub struct OutputFile {
    path: PathBuf,
    _lock: Lock,
}

impl OutputFile {
    /// Takes the file `path`, which must be new or one that the claim may replace, in a folder that can be written to (made
    /// where it is missing); links are followed. Errs, and changes nothing, where it is or lies in an input or another
    /// result, or is being written to by another program.
    pub fn claim(path: &Path, claim: FileClaim<'_>) -> Result<Self> {
        let real = real_place(path)?;
        if real.is_dir() {
            return Err(Error::input_at(path, "this is a folder, a file is needed", "Give a file name."));
        }
        claim.inputs.require_apart(&real)?;
        require_outside_of_outputs(&real)?;
        if real.exists() {
            let kind = claim.kind;
            if !(claim.is_ours)(&real) {
                let what = format!(
                    "there is a file here that this program did not write as this kind of result ({kind})"
                );
                return Err(Error::input_at(path, what, "Choose another name."));
            }
            if !claim.replace {
                let what = format!("there is an earlier result here ({kind})");
                return Err(Error::input_at(path, what, "Give another name, or replace it with `--force`."));
            }
        }
        // A place that cannot be written to is said before the work.
        drop(WholeFile::create(&real)?);
        let lock = Lock::of_file(&real)?;
        Ok(Self { path: real, _lock: lock })
    }

    /// Where the file is to be, without links.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Writes the file whole, over an earlier one.
    pub fn write(&self, bytes: &[u8]) -> Result<()> {
        write_whole(&self.path, bytes)
    }
}
