//! Scene files that are read when they are needed, and parts of files that are such.

use super::{Problem, Scene, file};
use crate::{Error, Result};
use std::{
    fs::File,
    io::{Read, Seek, SeekFrom},
    path::{Path, PathBuf},
    sync::{Arc, Mutex},
};

/// Advice where a chapter cannot be read.
pub(super) const HINT: &str = "Choose another scene file, or train the recording again.";

/// A scene file, or a part of a file that is one. The file stays open, so that it can be replaced meanwhile.
#[derive(Clone, Debug)]
pub(super) struct Part {
    path: PathBuf,
    file: Arc<Mutex<File>>,
    start: u64,
    len: u64,
}

impl Part {
    /// Takes bytes `start` to `start + len` of an open file.
    pub(super) fn new(path: &Path, file: &Arc<Mutex<File>>, [start, len]: [u64; 2]) -> Self {
        Self { path: path.to_owned(), file: file.clone(), start, len }
    }

    /// Returns the number of bytes.
    pub(super) fn len(&self) -> u64 {
        self.len
    }

    /// Reads the bytes.
    pub(super) fn bytes(&self) -> std::io::Result<Vec<u8>> {
        let mut file = self.file.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
        file.seek(SeekFrom::Start(self.start))?;
        let mut bytes = Vec::new();
        bytes.try_reserve_exact(self.len as usize)?;
        Read::by_ref(&mut *file).take(self.len).read_to_end(&mut bytes)?;
        Ok(bytes)
    }

    /// Reads the number of Gaussians, and nothing else.
    pub(super) fn num_gaussians(&self) -> Result<usize> {
        let mut file = self.file.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
        let fail = |e| Error::io("read a part of the scene", &self.path, e);
        file.seek(SeekFrom::Start(self.start)).map_err(fail)?;
        let number = file::num_gaussians(Read::by_ref(&mut *file).take(self.len));
        number.ok_or_else(|| wrong(&self.path, "a chapter of the scene is damaged".into()))
    }

    /// Reads the scene.
    pub(super) fn scene(&self) -> Result<Scene> {
        let bytes = self.bytes().map_err(|e| Error::io("read a part of the scene", &self.path, e))?;
        file::from_bytes(&bytes).map_err(|what| Error::input_at(&self.path, what, HINT))
    }
}

/// Says why a file of chapters cannot be read.
pub(super) fn wrong(path: &Path, what: Problem) -> Error {
    Error::input_at(path, what, HINT)
}
