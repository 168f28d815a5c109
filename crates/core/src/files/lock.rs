//! Locks that keep two programs out of one output. The operating system holds them, so that they end
//! with their owner.

use super::{paths::is_same_file, record::LOCK_FILE};
use crate::{Error, Result, hash::sha256};
use std::{
    fs::{File, OpenOptions, TryLockError},
    io::{Read, Write},
    path::{Path, PathBuf},
    time::{Duration, Instant},
};

/// Time between two attempts at a lock that another program holds.
const PAUSE: Duration = Duration::from_millis(50);

/// A lock on an output, which no other program may write to; released when dropped.
#[derive(Debug)]
pub struct Lock {
    path: PathBuf,
    /// The open file that holds the system's lock.
    _file: File,
}

impl Lock {
    /// Locks the existing folder `folder`.
    pub(super) fn of_folder(folder: &Path) -> Result<Self> {
        Self::acquire(&folder.join(LOCK_FILE), folder)
    }

    /// Locks the file `path`, which need not exist; its folder must.
    pub(super) fn of_file(path: &Path) -> Result<Self> {
        // A hash is used: with our ending, the longest names would not fit.
        Self::acquire(&path.with_file_name(format!(".surgtpgs-{}.lock", short_hash(path))), path)
    }

    /// Locks `output` by way of the file `path`, which need not exist; its folder must. Fails, and names the
    /// owner, if another program holds the lock.
    pub fn acquire(path: &Path, output: &Path) -> Result<Self> {
        Self::attempt(path, output)?
    }

    /// Does the same as [`Lock::acquire`], but tries again for as long as `patience` while another program holds
    /// the lock.
    pub fn acquire_within(patience: Duration, path: &Path, output: &Path) -> Result<Self> {
        retried(patience, || Self::attempt(path, output))
    }

    /// Tries to take the lock; the inner error says that another program holds it.
    pub(super) fn attempt(path: &Path, output: &Path) -> Result<Result<Self>> {
        let fail = |e| Error::io("reserve the output", output, e);
        loop {
            if path.symlink_metadata().is_ok_and(|data| !data.is_file()) {
                let what = "something else has the name of the lock of this output";
                return Err(Error::input_at(path, what, "Move it away."));
            }
            let options = OpenOptions::new().create(true).truncate(false).read(true).write(true).to_owned();
            let mut file = options.open(path).map_err(fail)?;
            match file.try_lock() {
                Err(TryLockError::Error(e)) if !is_unsupported(&e) => return Err(fail(e)),
                Err(TryLockError::WouldBlock) => return Ok(Err(taken(&mut file, output))),
                _ => {}
            }
            // Its owner may have removed it between the two steps.
            if !is_at(&file, path) {
                continue;
            }
            let owner = format!("process {} on {}", std::process::id(), gethostname::gethostname().display());
            // The owner is only named in the message to another program.
            let _ = file.set_len(0).and_then(|()| file.write_all(owner.as_bytes()));
            return Ok(Ok(Self { path: path.to_owned(), _file: file }));
        }
    }

    /// Notes that the folders of the two locks have changed places.
    pub(super) fn change_places(&mut self, other: &mut Self) {
        std::mem::swap(&mut self.path, &mut other.path);
    }

    /// Notes that the folder of the lock was renamed to `folder`.
    pub(super) fn move_to(&mut self, folder: &Path) {
        self.path = folder.join(LOCK_FILE);
    }
}

/// Tries again for as long as `patience` while the inner result is an error, and returns the last one.
pub(super) fn retried<T>(patience: Duration, mut attempt: impl FnMut() -> Result<Result<T>>) -> Result<T> {
    let started = Instant::now();
    loop {
        match attempt()? {
            Err(_) if started.elapsed() < patience => std::thread::sleep(PAUSE),
            last => return last,
        }
    }
}

/// Returns `true` if the file system has no locks: conflicts cannot be detected then.
fn is_unsupported(error: &std::io::Error) -> bool {
    let no_lock_server = cfg!(unix) && error.raw_os_error() == Some(NO_LOCKS);
    no_lock_server || error.kind() == std::io::ErrorKind::Unsupported
}

#[cfg(unix)]
const NO_LOCKS: i32 = rustix::io::Errno::NOLCK.raw_os_error();
#[cfg(not(unix))]
const NO_LOCKS: i32 = 0;

impl Drop for Lock {
    fn drop(&mut self) {
        // A lock file that cannot be removed locks nothing.
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

/// Returns `true` if the open file is still the one at `path`.
fn is_at(file: &File, path: &Path) -> bool {
    let both = file.metadata().ok().zip(path.metadata().ok());
    both.is_some_and(|(open, there)| cfg!(not(unix)) || is_same_file(&open, &there))
}

/// Returns the beginning of a hash of the path's last part.
pub(super) fn short_hash(path: &Path) -> String {
    let name = path.file_name().unwrap_or_default().as_encoded_bytes();
    sha256(name).chars().take(12).collect()
}
