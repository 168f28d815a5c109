//! Files are written whole: to a temporary neighbour, synced, then renamed into place.

use crate::{Error, Result};
use std::{
    io::{Seek, SeekFrom, Write},
    path::{Path, PathBuf},
};

/// `path` from the root on, so that it means the same wherever a program is started; as it is where nothing is found.
pub fn full_path(path: &Path) -> PathBuf {
    std::fs::canonicalize(path).unwrap_or_else(|_| path.to_owned())
}

/// Writes `bytes` to `path` so that a reader sees the old file or the new one, never a part.
/// Missing parent folders are created.
pub fn write_whole(path: &Path, bytes: &[u8]) -> Result<()> {
    write_whole_with(path, |file| file.write_all(bytes))
}

/// As [`write_whole`], for writers that stream into the file.
pub fn write_whole_with(
    path: &Path,
    write: impl FnOnce(&mut std::fs::File) -> std::io::Result<()>,
) -> Result<()> {
    let mut file = WholeFile::create(path)?;
    write(file.temporary.as_file_mut()).map_err(|e| Error::io("write the file", path, e))?;
    file.commit()
}

/// A file that is written bit by bit and appears whole at [`WholeFile::commit`]; dropped before, it leaves no trace.
#[derive(Debug)]
pub struct WholeFile {
    temporary: tempfile::NamedTempFile,
    path: PathBuf,
}

impl WholeFile {
    /// Begins the file at `path`; missing parent folders are created.
    pub fn create(path: &Path) -> Result<Self> {
        let fail = |e| Error::io("write the file", path, e);
        let folder: PathBuf = match path.parent() {
            Some(p) if !p.as_os_str().is_empty() => p.to_owned(),
            _ => PathBuf::from("."),
        };
        std::fs::create_dir_all(&folder).map_err(fail)?;
        let temporary = tempfile::Builder::new().prefix(".part-").tempfile_in(&folder).map_err(fail)?;
        Ok(Self { temporary, path: path.to_owned() })
    }

    /// Where the file will be.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Where what was written so far is.
    pub fn temporary_path(&self) -> &Path {
        self.temporary.path()
    }

    /// Puts the file in its place, over what is there.
    pub fn commit(self) -> Result<()> {
        let Self { temporary, path } = self;
        let fail = |e| Error::io("write the file", &path, e);
        temporary.as_file().sync_all().map_err(fail)?;
        set_default_permissions(&temporary).map_err(fail)?;
        temporary.persist(&path).map_err(|e| fail(e.error))?;
        Ok(())
    }
}

impl Write for WholeFile {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        self.temporary.write(bytes)
    }

    fn flush(&mut self) -> std::io::Result<()> {
        self.temporary.flush()
    }
}

impl Seek for WholeFile {
    fn seek(&mut self, to: SeekFrom) -> std::io::Result<u64> {
        self.temporary.seek(to)
    }
}

/// Temporary files are private to their owner; results get the usual permissions.
#[cfg(unix)]
fn set_default_permissions(file: &tempfile::NamedTempFile) -> std::io::Result<()> {
    use std::os::unix::fs::PermissionsExt;
    file.as_file().set_permissions(std::fs::Permissions::from_mode(0o644))
}

#[cfg(not(unix))]
fn set_default_permissions(_: &tempfile::NamedTempFile) -> std::io::Result<()> {
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_full_path_means_the_same_everywhere() {
        let here = std::env::current_dir().unwrap();
        assert_eq!(full_path(Path::new("src/../src/files.rs")), full_path(&here.join("src/files.rs")));
        assert!(full_path(Path::new("src")).is_absolute());
        assert_eq!(full_path(Path::new("not/there")), Path::new("not/there"));
    }

    #[test]
    fn a_failed_write_leaves_the_old_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a/b.txt");
        write_whole(&path, b"old").unwrap();
        let failed = write_whole_with(&path, |f| {
            f.write_all(b"ne")?;
            Err(std::io::Error::other("disk full"))
        });
        assert!(failed.unwrap_err().to_string().contains("disk full"));
        assert_eq!(std::fs::read(&path).unwrap(), b"old");
        assert_eq!(std::fs::read_dir(folder.path().join("a")).unwrap().count(), 1);
    }
}
