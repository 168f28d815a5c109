//! Writes complete files: to a temporary neighbour, synced, then renamed into place.

use super::{
    record::{Record, recorded_above},
    temporary::{TEMPORARY, without_name},
};
use crate::{Error, Result};
use std::{
    io::{ErrorKind, Seek, SeekFrom, Write},
    path::{Path, PathBuf},
};

/// Writes `bytes` to `path` so that a reader sees the old file or the new one, never a part. Missing
/// parent folders are created.
pub fn write_whole(path: &Path, bytes: &[u8]) -> Result<()> {
    write_whole_with(path, |file| file.write_all(bytes))
}

/// Writes a file in the same way as [`write_whole`], for writers that stream into it.
pub fn write_whole_with(
    path: &Path,
    write: impl FnOnce(&mut std::fs::File) -> std::io::Result<()>,
) -> Result<()> {
    let mut file = WholeFile::create(path)?;
    write(file.temporary.as_file_mut()).map_err(|e| Error::io("write the file", path, e))?;
    file.commit()
}

/// A file that is written bit by bit and appears complete at [`WholeFile::commit`]. If it is dropped
/// before, it leaves no trace.
#[derive(Debug)]
pub struct WholeFile {
    temporary: tempfile::NamedTempFile,
    path: PathBuf,
}

impl WholeFile {
    /// Begins the file at `path`; missing parent folders are created, a link is followed. Returns an
    /// error if a folder, a device, a pipe or a socket has this name.
    pub fn create(path: &Path) -> Result<Self> {
        let fail = |e| Error::io("write the file", path, e);
        let followed = if path.is_symlink() { Some(path.canonicalize().map_err(fail)?) } else { None };
        if followed.is_some() && recorded_above(path).is_some() {
            let what = "a link has taken the place of a file of this result";
            return Err(Error::input_at(path, what, "Remove it."));
        }
        let path = followed.as_deref().unwrap_or(path);
        if path.symlink_metadata().is_ok_and(|data| !data.is_file()) {
            return Err(Error::input_at(path, "this is no ordinary file", "Choose another name."));
        }
        let folder: PathBuf = match path.parent() {
            Some(p) if !p.as_os_str().is_empty() => p.to_owned(),
            _ => PathBuf::from("."),
        };
        std::fs::create_dir_all(&folder).map_err(fail)?;
        let mut builder = tempfile::Builder::new();
        builder.prefix(TEMPORARY);
        // Temporary files are private to their owner; results get the permissions that the user
        // gives new files.
        #[cfg(unix)]
        builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o666));
        let temporary = builder.tempfile_in(&folder).map_err(|e| fail(without_name(e)))?;
        Record::note(path)?;
        Ok(Self { temporary, path: path.to_owned() })
    }

    /// Returns the final path of the file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Returns the path of the data written so far.
    pub fn temporary_path(&self) -> &Path {
        self.temporary.path()
    }

    /// Puts the file in its place, over an existing one.
    pub fn commit(self) -> Result<()> {
        self.persist(|temporary, path| temporary.persist(path).map_err(|e| e.error))
    }

    /// Puts the file in its place; returns an error if something is there.
    pub fn commit_new(self) -> Result<()> {
        self.persist(|temporary, path| match temporary.persist_noclobber(path) {
            // Some file systems can neither link nor rename without replacing.
            Err(e) if e.error.kind() != ErrorKind::AlreadyExists && path.symlink_metadata().is_err() => {
                e.file.persist(path).map_err(|e| e.error)
            }
            done => done.map_err(|e| e.error),
        })
    }

    fn persist(
        self,
        persist: impl FnOnce(tempfile::NamedTempFile, &Path) -> std::io::Result<std::fs::File>,
    ) -> Result<()> {
        let Self { temporary, path } = self;
        let fail = |e| Error::io("write the file", &path, e);
        temporary.as_file().sync_all().map_err(fail)?;
        persist(temporary, &path).map_err(fail)?;
        sync_parent(&path);
        Ok(())
    }
}

impl Write for WholeFile {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        self.temporary.write(bytes).map_err(without_name)
    }

    fn flush(&mut self) -> std::io::Result<()> {
        self.temporary.flush().map_err(without_name)
    }
}

impl Seek for WholeFile {
    fn seek(&mut self, to: SeekFrom) -> std::io::Result<u64> {
        self.temporary.seek(to).map_err(without_name)
    }
}

/// Syncs the parent folder: without it, a power cut may undo the renaming.
pub(super) fn sync_parent(path: &Path) {
    let folder =
        path.parent().filter(|p| p.as_os_str() != std::ffi::OsStr::new("")).unwrap_or(Path::new("."));
    let _ = std::fs::File::open(folder).and_then(|folder| folder.sync_all());
}
