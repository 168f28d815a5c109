//! Facts that tell a recording from others, kept beside its results.

use rayon::prelude::*;
use sha2::{Digest, Sha256};
use std::{
    path::{Path, PathBuf},
    time::UNIX_EPOCH,
};
use surgtpgs_core::{
    Error, Result,
    files::write_whole,
    hash::{file_sha256, sha256},
    reading::read_regular,
    sequence::{Identity, Sequence, settings_files},
};
use walkdir::{DirEntry, WalkDir};

/// Facts about the recording whose results are in a folder: enough to recognise it, wherever it lies.
#[derive(Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub(super) struct RecordingFacts {
    pub(super) path: PathBuf,
    /// Hash of the names, sizes and times of its files: while it stays the same, nothing is read again.
    listing: String,
    /// Hash of the names and content of its files; masks, labels and depth are among them.
    pub(super) contents: String,
    /// `None` if the recording cannot be opened.
    pub(super) identity: Option<Identity>,
}

/// Most bytes of a file of facts: that of some million frames.
const MOST_BYTES: u64 = 1 << 28;

impl RecordingFacts {
    /// Looks at a recording whose results are in `folder`. Its files are read only if it moved, changed or
    /// could not be opened before.
    pub(super) fn of(recording: &Path, folder: &Path) -> Self {
        let places = places_of(recording);
        let listing = listing(&places, folder, true);
        match Self::read(folder) {
            Ok(Some(known)) if known.is_whole_and_at(recording) && known.listing == listing => return known,
            _ => {}
        }
        let identity = Sequence::open(recording).and_then(|s| s.identity()).ok();
        let identity = identity.map(|identity| Identity::clone(&identity));
        Self { path: recording.to_owned(), listing, contents: contents(&places, folder), identity }
    }

    fn is_whole_and_at(&self, recording: &Path) -> bool {
        self.path == recording && self.identity.is_some()
    }

    pub(super) fn file(folder: &Path) -> PathBuf {
        folder.join("steps").join("recording.json")
    }

    pub(super) fn read(folder: &Path) -> Result<Option<Self>> {
        let path = Self::file(folder);
        let text = match read_regular(&path, MOST_BYTES) {
            Err(e) if e.kind() == std::io::ErrorKind::NotFound => return Ok(None),
            text => text.map_err(|e| Error::io("read what was done", &path, e))?,
        };
        serde_json::from_slice(&text).map(Some).map_err(|e| {
            let what = format!("this does not say which recording the folder is of: {e}");
            Error::input_at(&path, what, "Remove the recording's folder to do it again.")
        })
    }

    pub(super) fn write(&self, folder: &Path) -> Result<()> {
        let text = serde_json::to_string_pretty(self).unwrap_or_default() + "\n";
        write_whole(&Self::file(folder), text.as_bytes())
    }
}

/// Returns the paths of a recording and of its settings files, which may lie beside it.
fn places_of(recording: &Path) -> Vec<PathBuf> {
    let settings = settings_files(recording).into_iter().filter(|file| !file.starts_with(recording));
    std::iter::once(recording.to_owned()).chain(settings).collect()
}

/// Returns the files at `places`, each with its path from there; those under `except` are left out.
fn files_at(places: &[impl AsRef<Path>], except: &Path) -> Vec<(PathBuf, DirEntry)> {
    let files = places.iter().flat_map(|place| {
        let place = place.as_ref();
        let entries = WalkDir::new(place).follow_links(true).sort_by_file_name().into_iter();
        let files =
            entries.filter_entry(|e| e.path() != except).flatten().filter(|e| e.file_type().is_file());
        files.map(move |e| (e.path().strip_prefix(place).unwrap_or(e.path()).to_owned(), e))
    });
    files.collect()
}

/// Hashes names, sizes and, if asked for, times of the files at `places`; those under `except` are left out.
pub(super) fn listing(places: &[impl AsRef<Path>], except: &Path, with_times: bool) -> String {
    let mut hash = Sha256::new();
    for (name, entry) in files_at(places, except) {
        let Ok(data) = entry.metadata() else { continue };
        let time = data.modified().ok().and_then(|t| t.duration_since(UNIX_EPOCH).ok());
        let nanoseconds = time.filter(|_| with_times).map_or(0, |t| t.as_nanos());
        hash.update(name.as_os_str().as_encoded_bytes());
        hash.update(format!("\0{} {nanoseconds}\0", data.len()));
    }
    format!("{:x}", hash.finalize())
}

/// Hashes the names and content of the files at `places`; those under `except` are left out.
fn contents(places: &[PathBuf], except: &Path) -> String {
    let line = |(name, entry): &(PathBuf, DirEntry)| {
        // A file that cannot be read counts as empty here; its step reports the error.
        format!("{}\0{}\0", name.to_string_lossy(), file_sha256(entry.path()).unwrap_or_default())
    };
    let lines: Vec<String> = files_at(places, except).par_iter().map(line).collect();
    sha256(lines.concat().as_bytes())
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;

    #[test]
    fn a_listing_sees_names_sizes_and_times() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        std::fs::create_dir(at("in")).unwrap();
        std::fs::write(at("in/a"), b"1").unwrap();
        let list = || (listing(&[at("in")], &at("in/out"), true), listing(&[at("in")], Path::new(""), false));
        let first = list();
        assert_eq!(first, list());
        std::fs::create_dir(at("in/out")).unwrap();
        std::fs::write(at("in/out/b"), b"1").unwrap();
        assert_eq!(list().0, first.0, "results are no input");
        std::fs::remove_file(at("in/out/b")).unwrap();
        let file = std::fs::File::options().write(true).open(at("in/a")).unwrap();
        // Times as of a clock that was put right, or never set.
        let years = Duration::from_secs(60 * 365 * 86_400);
        for time in [UNIX_EPOCH, UNIX_EPOCH - years, UNIX_EPOCH + 3 * years] {
            file.set_modified(time).unwrap();
            assert_ne!(list().0, first.0);
            assert_eq!(list().1, first.1);
        }
        std::fs::write(at("in/a"), b"12").unwrap();
        assert_ne!(list().1, first.1);
        std::fs::rename(at("in/a"), at("in/b")).unwrap();
        let renamed = list().1;
        std::fs::remove_dir_all(at("in")).unwrap();
        assert_ne!(list().1, renamed);
    }
}
