//! Files are written whole: to a temporary neighbour, synced, then renamed into place.

use crate::{Error, Result};
use std::{
    io::{Seek, SeekFrom, Write},
    path::{Path, PathBuf},
};

/// `path` from the root on, so that it means the same wherever a program is started; links stay.
pub fn absolute_path(path: &Path) -> PathBuf {
    std::path::absolute(path).unwrap_or_else(|_| path.to_owned())
}

/// As [`absolute_path`], and without links where there is something.
pub fn full_path(path: &Path) -> PathBuf {
    path.canonicalize().unwrap_or_else(|_| absolute_path(path))
}

/// Beginning of the names of files that are being written.
const TEMPORARY: &str = ".part-";

/// Whether a folder may be taken: it does not exist, or holds nothing but what a killed writer left.
pub fn is_free_folder(path: &Path) -> Result<bool> {
    let fail = |e| Error::io("list the folder", path, e);
    let mut entries = match std::fs::read_dir(path) {
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => return Ok(true),
        entries => entries.map_err(fail)?,
    };
    entries.try_fold(true, |free, entry| {
        let name = entry.map_err(fail)?.file_name();
        Ok(free && name.to_string_lossy().starts_with(TEMPORARY))
    })
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
        let mut builder = tempfile::Builder::new();
        builder.prefix(TEMPORARY);
        // Temporary files are private to their owner; results get the permissions that the user gives new files.
        #[cfg(unix)]
        builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o666));
        let temporary = builder.tempfile_in(&folder).map_err(fail)?;
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
        temporary.persist(&path).map_err(|e| fail(e.error))?;
        // Without it, a power cut may take the new name back.
        #[cfg(unix)]
        if let Some(folder) = path.parent().filter(|p| !p.as_os_str().is_empty()) {
            std::fs::File::open(folder).and_then(|folder| folder.sync_all()).map_err(fail)?;
        }
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_full_path_means_the_same_everywhere() {
        let here = std::env::current_dir().unwrap();
        assert_eq!(full_path(Path::new("src/../src/files.rs")), full_path(&here.join("src/files.rs")));
        assert!(full_path(Path::new("src")).is_absolute());
        assert_eq!(full_path(Path::new("not/there")), here.join("not/there"));
    }

    #[cfg(unix)]
    #[test]
    fn results_have_the_permissions_of_other_new_files() {
        use std::os::unix::fs::PermissionsExt;
        let folder = tempfile::tempdir().unwrap();
        let [ours, theirs] = ["ours", "theirs"].map(|name| folder.path().join(name));
        write_whole(&ours, b"").unwrap();
        std::fs::write(&theirs, b"").unwrap();
        let [ours, theirs] = [ours, theirs].map(|path| path.metadata().unwrap().permissions().mode());
        assert_eq!(ours, theirs);
    }

    #[test]
    fn what_a_killed_writer_left_does_not_claim_a_folder() {
        let folder = tempfile::tempdir().unwrap();
        assert!(
            is_free_folder(&folder.path().join("none")).unwrap() && is_free_folder(folder.path()).unwrap()
        );
        std::fs::write(folder.path().join(".part-abc"), "half").unwrap();
        assert!(is_free_folder(folder.path()).unwrap());
        std::fs::write(folder.path().join("a"), "").unwrap();
        assert!(!is_free_folder(folder.path()).unwrap());
        assert!(is_free_folder(&folder.path().join("a")).is_err());
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
