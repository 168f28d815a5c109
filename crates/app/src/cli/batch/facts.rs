//! Facts that tell a recording from others, kept beside its results.

use rayon::prelude::*;
use serde::de::DeserializeOwned;
use serde_json::Value;
use sha2::{Digest, Sha256};
use std::{
    path::{Path, PathBuf},
    time::UNIX_EPOCH,
};
use surgtpgs_core::{
    Error, Result,
    files::{is_aside, write_whole},
    hash::{file_sha256, sha256},
    reading::read_regular,
    sequence::{Identity, Sequence, Settings, settings_files},
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

/// Most bytes of a file beside results: facts of some million frames.
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
        read_json(&Self::file(folder), "this does not say which recording the folder is of")
    }

    pub(super) fn write(&self, folder: &Path) -> Result<()> {
        let text = serde_json::to_string_pretty(self).unwrap_or_default() + "\n";
        write_whole(&Self::file(folder), text.as_bytes())
    }
}

/// Reads a file of JSON beside the results of a recording; `None` if there is none. `not_such` says what is
/// wrong if the file cannot be understood.
pub(super) fn read_json<T: DeserializeOwned>(path: &Path, not_such: &str) -> Result<Option<T>> {
    let text = match read_regular(path, MOST_BYTES) {
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => return Ok(None),
        text => text.map_err(|e| Error::io("read what was done", path, e))?,
    };
    serde_json::from_slice(&text).map(Some).map_err(|e| {
        let hint = "Remove the recording's folder to do it again.";
        Error::input_at(path, format!("{not_such}: {e}"), hint)
    })
}

/// Returns the paths of a recording, of its settings files, and of the labels that these name. They may lie
/// beside it.
fn places_of(recording: &Path) -> Vec<PathBuf> {
    let settings = settings_files(recording);
    // Settings that cannot be read are an error of the recording, which its steps report.
    let named = |file: &PathBuf| Some(file.with_file_name(Settings::read(file).ok()?.labels.file?));
    let labels = settings.first().and_then(named);
    let settings = settings.into_iter().filter(|file| !file.starts_with(recording));
    std::iter::once(recording.to_owned()).chain(settings).chain(labels).collect()
}

/// Returns the mask pictures that a file of marks names, seen from there; none if it is another file.
pub(super) fn masks_named_by(marks: &Path) -> Vec<PathBuf> {
    let text = read_regular(marks, MOST_BYTES).unwrap_or_default();
    let text = text.strip_prefix(b"\xef\xbb\xbf").unwrap_or(&text);
    let json: Value = serde_json::from_slice(text).unwrap_or_default();
    let entries = json.get("marks").and_then(Value::as_array).into_iter().flatten();
    entries.filter_map(|entry| Some(marks.with_file_name(entry.get("mask")?.as_str()?))).collect()
}

/// Returns the files at `places`, each with its path from there. Those under `except` are left out, and so is
/// what is hidden or left by file managers.
fn files_at(places: &[impl AsRef<Path>], except: &Path) -> Vec<(PathBuf, DirEntry)> {
    let files = places.iter().flat_map(|place| {
        let place = place.as_ref();
        let entries = WalkDir::new(place).follow_links(true).sort_by_file_name().into_iter();
        // A place itself may have any name.
        let is_part = |e: &DirEntry| e.path() != except && (e.depth() == 0 || !is_aside(e.file_name()));
        let files = entries.filter_entry(is_part).flatten().filter(|e| e.file_type().is_file());
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
        for dropping in [".hidden", ".DS_Store", "Thumbs.db"] {
            std::fs::write(at("in").join(dropping), b"1").unwrap();
            assert_eq!(list().1, first.1, "{dropping}");
        }
        std::fs::rename(at("in"), at(".in")).unwrap();
        let hidden = listing(&[at(".in")], Path::new(""), false);
        std::fs::rename(at(".in"), at("in")).unwrap();
        assert_eq!(hidden, first.1, "what is asked for may be hidden");
        std::fs::write(at("in/a"), b"12").unwrap();
        assert_ne!(list().1, first.1);
        std::fs::rename(at("in/a"), at("in/b")).unwrap();
        let renamed = list().1;
        std::fs::remove_dir_all(at("in")).unwrap();
        assert_ne!(list().1, renamed);
    }

    #[test]
    fn labels_that_settings_name_and_masks_that_marks_name_count() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        std::fs::create_dir(at("in")).unwrap();
        std::fs::write(at("in/a"), b"1").unwrap();
        std::fs::write(at("clip.mp4"), b"1").unwrap();
        std::fs::write(at("labels.xml"), b"old").unwrap();
        let named = |file: &str| format!("[labels]\nfile = \"{file}\"\n");
        std::fs::write(at("in/sequence.toml"), named("../labels.xml")).unwrap();
        std::fs::write(at("clip.mp4.toml"), named("labels.xml")).unwrap();
        let facts =
            || [at("in"), at("clip.mp4")].map(|recording| contents(&places_of(&recording), Path::new("")));
        let before = facts();
        std::fs::write(at("labels.xml"), b"new").unwrap();
        let now = facts();
        assert!(before[0] != now[0] && before[1] != now[1]);

        let marks = "\u{feff}{\"marks\": [{\"mask\": \"masks/1.png\"}, {\"mask\": {\"size\": [1, 1]}}, {}]}";
        std::fs::write(at("marks.json"), marks).unwrap();
        assert_eq!(masks_named_by(&at("marks.json")), [at("masks/1.png")]);
        assert!(masks_named_by(&at("labels.xml")).is_empty() && masks_named_by(&at("none")).is_empty());
    }
}
