//! Real places of outputs once links are followed, and the inputs that they must not touch.

use super::{
    paths::{absolute_path, full_path, is_same_file},
    record::Record,
};
use crate::{Error, Result};
use std::{
    io::ErrorKind,
    path::{Path, PathBuf},
};

/// Inputs of a run, which it never writes into or over: recording, prepared folder, scene, models.
#[derive(Clone, Debug, Default)]
pub struct Inputs(Vec<NamedInput>);

#[derive(Clone, Debug)]
struct NamedInput {
    /// Description in words, e.g. "the recording".
    what: &'static str,
    /// Path without links.
    path: PathBuf,
}

impl Inputs {
    /// Creates an empty list.
    pub fn none() -> Self {
        Self::default()
    }

    /// Adds a file or folder; `what` describes it, e.g. "the scene". One that does not exist
    /// cannot be harmed.
    pub fn with(mut self, what: &'static str, path: &Path) -> Self {
        if !path.as_os_str().is_empty() {
            self.0.push(NamedInput { what, path: full_path(path) });
        }
        self
    }

    /// Adds an input that is optional; see [`Inputs::with`].
    pub fn with_some(self, what: &'static str, path: Option<&Path>) -> Self {
        path.into_iter().fold(self, |inputs, path| inputs.with(what, path))
    }

    /// Returns an error if `output`, without links, is an input, lies in one, or has one inside.
    pub(super) fn require_apart(&self, output: &Path) -> Result<()> {
        let refuse = |relation: &str, input: &NamedInput| {
            let what = format!("{relation} {}, and inputs are never written to", input.what);
            Err(Error::input_at(output, what, "Choose another place for the result."))
        };
        for input in &self.0 {
            if is_same(output, &input.path) {
                return refuse("this is", input);
            }
            if output.ancestors().skip(1).any(|folder| is_same(folder, &input.path)) {
                return refuse("this place lies inside", input);
            }
            if input.path.ancestors().skip(1).any(|folder| is_same(folder, output)) {
                return refuse("this folder contains", input);
            }
        }
        Ok(())
    }
}

/// Returns an error if `output`, with links followed, is an input, lies in one, or has one inside.
pub fn require_apart(output: &Path, inputs: &Inputs) -> Result<()> {
    inputs.require_apart(&real_place(output)?)
}

/// Tells if two paths without links name the same thing. Mounts, hard links and file systems that ignore
/// case give it several names.
fn is_same(a: &Path, b: &Path) -> bool {
    a == b || a.metadata().ok().zip(b.metadata().ok()).is_some_and(|(a, b)| is_same_file(&a, &b))
}

/// Returns the place that `path` names, with links followed as far as it exists. Returns an error for
/// anything that a result cannot replace: links that lead nowhere, devices, pipes and sockets.
pub(super) fn real_place(path: &Path) -> Result<PathBuf> {
    let absolute = absolute_path(path);
    let mut missing = Vec::new();
    let mut there = absolute.as_path();
    while there.symlink_metadata().is_err_and(|e| matches!(e.kind(), ErrorKind::NotFound)) {
        let (Some(parent), Some(name)) = (there.parent(), there.file_name()) else {
            return Err(Error::input_at(path, "this place does not exist", "Choose another one."));
        };
        missing.push(name);
        there = parent;
    }
    let fail = |e: std::io::Error| match e.kind() {
        ErrorKind::NotFound => {
            Error::input_at(there, "this link leads to nothing", "Remove it, or choose another place.")
        }
        ErrorKind::InvalidFilename => {
            let bytes = there.file_name().map_or(0, |name| name.len());
            let what = format!("a file name of {bytes} bytes is needed, which is too long for this folder");
            Error::input_at(there, what, "Give a shorter name.")
        }
        _ => Error::io("find the place of the result", path, e),
    };
    let real = there.canonicalize().map_err(fail)?;
    let data = real.metadata().map_err(|e| Error::io("find the place of the result", path, e))?;
    if !data.is_file() && !data.is_dir() {
        let what = "this is a device, a pipe or a socket";
        return Err(Error::input_at(path, what, "Choose the name of an ordinary file or folder."));
    }
    if !missing.is_empty() && !data.is_dir() {
        return Err(Error::input_at(&real, "this is a file, a folder is needed", "Choose another place."));
    }
    Ok(missing.iter().rev().fold(real, |place, name| place.join(name)))
}

/// Returns an error if `output` lies inside another output of this program that holds no others.
pub(super) fn require_outside_of_outputs(output: &Path) -> Result<()> {
    let above = output.ancestors().skip(1).find_map(|folder| Some((folder, Record::read(folder)?)));
    match above {
        Some((folder, record)) if !record.holds_outputs => {
            let what = format!("this place lies inside a result of this program ({})", record.kind);
            Err(Error::input_at(folder, what, "Choose a place outside of it."))
        }
        _ => Ok(()),
    }
}
