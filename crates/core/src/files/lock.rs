//! Locks that keep two programs out of one output. The system holds them, so that they end with their owner.

use crate::{Error, Result};
use sha2::{Digest, Sha256};
use std::{
    fs::{File, OpenOptions, TryLockError},
    io::{Read, Write},
    path::{Path, PathBuf},
};

/// The lock of an output folder, inside it.
pub(super) const LOCK_FILE: &str = ".surgtpgs.lock";

/// An output that no other program may write to; given back when dropped.
#[derive(Debug)]
pub(super) struct Lock {
    path: PathBuf,
    /// Holds the system's lock.
    _file: File,
}

impl Lock {
    /// Locks the existing folder `folder`.
    pub(super) fn of_folder(folder: &Path) -> Result<Self> {
        Self::acquire(folder.join(LOCK_FILE), folder)
    }

    /// Locks the file `path`, which need not exist; its folder must.
    pub(super) fn of_file(path: &Path) -> Result<Self> {
        // A hash: with an ending of ours, the longest names would not fit.
        Self::acquire(path.with_file_name(format!(".surgtpgs-{}.lock", short_hash(path))), path)
    }

    fn acquire(path: PathBuf, output: &Path) -> Result<Self> {
        let fail = |e| Error::io("reserve the output", output, e);
        loop {
            if path.symlink_metadata().is_ok_and(|data| !data.is_file()) {
                let what = "something else has the name of the lock of this output";
                return Err(Error::input_at(&path, what, "Move it away."));
            }
            let options = OpenOptions::new().create(true).truncate(false).read(true).write(true).to_owned();
            let mut file = options.open(&path).map_err(fail)?;
            match file.try_lock() {
                // Where the file system has no locks, nothing can be told.
                Err(TryLockError::Error(e)) if e.kind() != std::io::ErrorKind::Unsupported => {
                    return Err(fail(e));
                }
                Err(TryLockError::WouldBlock) => return Err(taken(&mut file, output)),
                _ => {}
            }
            // Its owner may have removed it between the two steps.
            if !is_at(&file, &path) {
                continue;
            }
            let owner = format!("process {} on {}", std::process::id(), gethostname::gethostname().display());
            // Only for the message of who comes second.
            let _ = file.set_len(0).and_then(|()| file.write_all(owner.as_bytes()));
            return Ok(Self { path, _file: file });
        }
    }
}

impl Drop for Lock {
    fn drop(&mut self) {
        // Where it stays, it holds nothing.
        let _ = std::fs::remove_file(&self.path);
    }
}

fn taken(file: &mut File, output: &Path) -> Error {
    let mut owner = String::new();
    let _ = file.take(200).read_to_string(&mut owner);
    let owner = if owner.is_empty() { String::new() } else { format!(" ({owner})") };
    Error::input_at(
        output,
        format!("another program is writing there{owner}"),
        "Wait until it is done, or choose another name.",
    )
}

#[cfg(unix)]
fn is_at(file: &File, path: &Path) -> bool {
    use std::os::unix::fs::MetadataExt;
    let identity = |data: std::fs::Metadata| (data.dev(), data.ino());
    file.metadata().map(identity).ok() == path.metadata().map(identity).ok()
}

#[cfg(not(unix))]
fn is_at(_: &File, path: &Path) -> bool {
    path.exists()
}

/// The beginning of a hash of the path's last part.
pub(super) fn short_hash(path: &Path) -> String {
    let name = path.file_name().unwrap_or_default().as_encoded_bytes();
    Sha256::digest(name).iter().take(6).map(|b| format!("{b:02x}")).collect()
}
