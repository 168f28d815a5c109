//! The record in a folder that this program fills: which output it is, which files are its own, and
//! whether it is complete.
//!
//! Each line is one JSON value. A file is noted before it is written, by adding a line. A line that was
//! cut off by a kill is skipped.

use super::temporary::{TEMPORARY, without_name};
use crate::{Error, Result, reading::read_regular};
use std::{
    collections::BTreeSet,
    ffi::OsStr,
    fs::{File, OpenOptions},
    io::{BufRead, BufReader, Read, Write},
    path::{Component, Path, PathBuf},
};
use walkdir::WalkDir;

/// Name of the record inside its folder.
pub(super) const RECORD_FILE: &str = ".surgtpgs";

/// Name of the lock of an output folder, inside it.
pub(super) const LOCK_FILE: &str = ".surgtpgs.lock";

/// Name of the file that tells what was prepared; it is written last.
pub(crate) const PREPARED_FILE: &str = "prepared.json";

/// Largest size of a record in bytes: that of some million files.
const MOST_RECORD: u64 = 1 << 28;

/// Largest size of a record's first line in bytes.
const MOST_HEAD: u64 = 4096;

/// Number of folders above a file in which its record is looked for.
const DEPTH: usize = 3;

/// Kind and contents of an output folder.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Record {
    /// Kind of output, e.g. "export".
    pub(super) kind: String,
    /// `true` if it is a place for other outputs.
    pub(super) holds_outputs: bool,
    pub(super) complete: bool,
    /// Paths inside the folder, with `/`.
    pub(super) files: BTreeSet<String>,
}

/// A line of the record.
#[derive(serde::Serialize, serde::Deserialize)]
#[serde(untagged)]
enum Line {
    Head(Head),
    File(String),
}

/// The first line: the record without its files.
#[derive(Clone, serde::Serialize, serde::Deserialize)]
pub(super) struct Head {
    #[serde(rename = "surgtpgs")]
    pub(super) kind: String,
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub(super) holds_outputs: bool,
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub(super) complete: bool,
}

impl Record {
    pub(super) fn new(kind: &str) -> Self {
        Self { kind: kind.to_owned(), holds_outputs: false, complete: false, files: BTreeSet::new() }
    }

    /// Reads the record of `folder`; `None` if there is none that can be understood.
    pub(super) fn read(folder: &Path) -> Option<Self> {
        let Head { kind, holds_outputs, complete } = head(folder)?;
        let text = read_regular(&folder.join(RECORD_FILE), MOST_RECORD).ok()?;
        let text = String::from_utf8_lossy(&text);
        let lines = text.lines().skip(1).map(serde_json::from_str::<Line>);
        // A record may have been tampered with: only files inside the folder belong to this output.
        let is_inside = |name: &str| Path::new(name).components().all(|c| matches!(c, Component::Normal(_)));
        let name = |line| match line {
            Ok(Line::File(name)) if is_inside(&name) => Some(name),
            _ => None,
        };
        Some(Self { kind, holds_outputs, complete, files: lines.filter_map(name).collect() })
    }

    /// Writes the complete record.
    pub(super) fn write(&self, folder: &Path) -> Result<()> {
        let fail = |e| Error::io("write the record of the folder", folder, without_name(e));
        let (kind, holds_outputs, complete) = (self.kind.clone(), self.holds_outputs, self.complete);
        let head = Line::Head(Head { kind, holds_outputs, complete });
        let mut file = tempfile::Builder::new().prefix(TEMPORARY).tempfile_in(folder).map_err(fail)?;
        let names = self.files.iter().cloned().map(Line::File);
        let text: String = std::iter::once(head).chain(names).map(|l| line(&l)).collect();
        file.write_all(text.as_bytes()).and_then(|()| file.as_file().sync_all()).map_err(fail)?;
        #[cfg(unix)]
        {
            let mode = std::os::unix::fs::PermissionsExt::from_mode(0o644);
            file.as_file().set_permissions(mode).map_err(fail)?;
        }
        file.persist(folder.join(RECORD_FILE)).map_err(|e| fail(e.error))?;
        Ok(())
    }

    /// Notes a file of this program in the record of the output that `path` is in, if there is one.
    pub(super) fn note(path: &Path) -> Result<()> {
        let Some((folder, _)) = recorded_above(path).filter(|(_, head)| !head.holds_outputs) else {
            return Ok(());
        };
        let Some(name) = name_inside(&folder, path) else { return Ok(()) };
        let record = folder.join(RECORD_FILE);
        let append =
            || OpenOptions::new().append(true).open(&record)?.write_all(line(&Line::File(name)).as_bytes());
        append().map_err(|e| Error::io("write the record of the folder", &record, e))
    }

    /// Returns a file in `folder` that is not in the record, by its path inside.
    pub(super) fn foreign_file(&self, folder: &Path) -> Result<Option<String>> {
        let entries = WalkDir::new(folder).sort_by_file_name().into_iter();
        for entry in entries {
            let entry = entry.map_err(|e| Error::io("list the folder", folder, e.into()))?;
            let is_ours = || {
                entry.depth() == 1 && is_own(entry.path())
                    || entry.file_name().to_string_lossy().starts_with(TEMPORARY)
                    || !entry.path_is_symlink()
                        && name_inside(folder, entry.path()).is_some_and(|name| self.files.contains(&name))
            };
            if !entry.file_type().is_dir() && !is_ours() {
                return Ok(Some(
                    entry.path().strip_prefix(folder).unwrap_or(entry.path()).display().to_string(),
                ));
            }
        }
        Ok(None)
    }
}

fn line(value: &Line) -> String {
    // Text and flags can always be serialized.
    serde_json::to_string(value).unwrap_or_default() + "\n"
}

/// Reads the first line of the record of `folder`; `None` if there is no record of this program.
pub(super) fn head(folder: &Path) -> Option<Head> {
    let path = folder.join(RECORD_FILE);
    if !path.symlink_metadata().is_ok_and(|data| data.is_file()) {
        return None;
    }
    let mut line = String::new();
    BufReader::new(File::open(path).ok()?.take(MOST_HEAD)).read_line(&mut line).ok()?;
    serde_json::from_str(&line).ok()
}

/// Returns the nearest folder above `path` that has a record, and the first line of that.
pub(super) fn recorded_above(path: &Path) -> Option<(PathBuf, Head)> {
    let folders = path.ancestors().skip(1).take(DEPTH);
    let here =
        |folder: &Path| if folder.as_os_str().is_empty() { PathBuf::from(".") } else { folder.to_owned() };
    folders.map(here).find_map(|folder| head(&folder).map(|head| (folder, head)))
}

/// Returns the path inside `folder`, with `/`; `None` if it lies outside. A name that is not Unicode is
/// given with replacement characters, both in the record and in comparisons with it.
fn name_inside(folder: &Path, path: &Path) -> Option<String> {
    let inside = match folder == Path::new(".") {
        true => path.strip_prefix(".").unwrap_or(path),
        false => path.strip_prefix(folder).ok()?,
    };
    Some(inside.iter().map(|part| part.to_string_lossy()).collect::<Vec<_>>().join("/"))
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
    head(folder).is_some()
}

/// Returns the kind of the result that `folder` holds, if it holds one.
pub(crate) fn kind_of_result(folder: &Path) -> Option<String> {
    head(folder).filter(|head| !head.holds_outputs).map(|head| head.kind)
}

/// Returns `true` if `folder` is a prepared one.
pub(crate) fn is_prepared(folder: &Path) -> bool {
    folder.join(PREPARED_FILE).is_file()
}

/// Returns the kind of the unfinished result that `folder` holds, if it holds one.
pub fn unfinished_kind(folder: &Path) -> Option<String> {
    let head = head(folder).filter(|head| !head.complete && !head.holds_outputs);
    head.map(|head| head.kind)
}

/// Files that file managers leave in the folders they open.
const DROPPINGS: [&str; 3] = [".DS_Store", "Thumbs.db", "desktop.ini"];

/// Tells if a file is part of nothing by its name: it is hidden, or one that file managers leave.
pub fn is_aside(name: &OsStr) -> bool {
    is_dropping(name) || name.as_encoded_bytes().starts_with(b".")
}

fn is_dropping(name: &OsStr) -> bool {
    DROPPINGS.iter().any(|dropping| name == *dropping)
}

/// Tells if a file is no result: it is one that this program keeps beside its own, or that
/// file managers leave.
pub(super) fn is_own(path: &Path) -> bool {
    let name = path.file_name().unwrap_or_default();
    is_dropping(name)
        || name == RECORD_FILE && path.parent().is_some_and(is_taken)
        || name == LOCK_FILE
        || name.to_string_lossy().starts_with(TEMPORARY)
}
