//! Writing files: completely or not at all, never into or over inputs of a run, and over earlier results
//! only on request.
//!
//! ```text
//! Inputs ─▶ OutputFolder::claim | OutputFile::claim ─▶ write_whole, WholeFile ─▶ finish: the result is in its place
//!                   (lock, record)                     (temporary, sync, rename)
//! ```
//!
//! A folder that this program fills holds a record of its files, `.surgtpgs`. Only files listed in a
//! record are ever replaced.

mod lock;
mod output;
mod output_file;
mod place;
mod record;
mod temporary;
#[cfg(test)]
mod tests;
mod whole;

pub use lock::Lock;
pub use output::{Claim, Earlier, OutputFolder, claim_collection};
pub use output_file::{FileClaim, OutputFile};
pub use place::{Inputs, require_apart};
pub use whole::{WholeFile, write_whole, write_whole_with};

use crate::{Error, Result};
use std::path::{Path, PathBuf};

/// Returns `path` from the root on, so that it means the same wherever a program is started; links stay.
pub fn absolute_path(path: &Path) -> PathBuf {
    std::path::absolute(path).unwrap_or_else(|_| path.to_owned())
}

/// Returns the absolute path with links resolved, if it exists; else as [`absolute_path`].
pub fn full_path(path: &Path) -> PathBuf {
    path.canonicalize().unwrap_or_else(|_| absolute_path(path))
}

/// Tells if a folder may be taken: it does not exist, or holds nothing but files that this program keeps
/// for itself in one (its record, its lock, and remains of a killed writer).
pub fn is_free_folder(path: &Path) -> Result<bool> {
    let fail = |e| Error::io("list the folder", path, e);
    let mut entries = match std::fs::read_dir(path) {
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => return Ok(true),
        entries => entries.map_err(fail)?,
    };
    entries.try_fold(true, |free, entry| Ok(free && is_own(&entry.map_err(fail)?.path())))
}

/// Tells if `folder` was taken for a result of this program.
pub(crate) fn is_taken(folder: &Path) -> bool {
    record::head(folder).is_some()
}

/// Returns the kind of the unfinished result that `folder` holds, if it holds one.
pub fn unfinished_kind(folder: &Path) -> Option<String> {
    let head = record::head(folder).filter(|head| !head.complete && !head.holds_outputs);
    head.map(|head| head.kind)
}

/// Files that file managers leave in the folders they open.
const DROPPINGS: [&str; 3] = [".DS_Store", "Thumbs.db", "desktop.ini"];

/// Tells if a file is no result: it is one that this program keeps beside its own, or that
/// file managers leave.
fn is_own(path: &Path) -> bool {
    let name = path.file_name().unwrap_or_default();
    DROPPINGS.iter().any(|dropping| name == *dropping)
        || name == record::RECORD_FILE && path.parent().is_some_and(is_taken)
        || name == lock::LOCK_FILE
        || name.to_string_lossy().starts_with(temporary::TEMPORARY)
}
