//! What is known of a step: a small file beside its result, from which a later run sees what is still to be done.

use super::plan::{Job, Task};
use crate::args::Step;
use sha2::{Digest, Sha256};
use std::{
    path::{Path, PathBuf},
    time::UNIX_EPOCH,
};
use surgtpgs_core::{Error, Result, files::write_whole, reading::read_text};
use walkdir::WalkDir;

/// How a step went.
#[derive(Clone, Debug, serde::Serialize, serde::Deserialize)]
pub(super) struct Record {
    /// Of everything that the result depends on.
    fingerprint: String,
    pub(super) state: State,
    /// Names and sizes of the files made, hashed.
    files: String,
    /// Wall time, of the last run where there were several.
    pub(super) seconds: f64,
    /// What the verb reports as JSON.
    pub(super) report: serde_json::Value,
}

#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum State {
    Begun,
    Failed(String),
    Done,
}

/// What is to be done about a step.
#[derive(Debug)]
pub(super) enum Status {
    /// Nothing.
    Done(Record),
    /// It was begun with the same settings, or failed.
    Unfinished(Record),
    /// It was done, but of other settings or inputs, or its files have changed.
    Outdated,
    /// It was never begun.
    New,
}

impl Record {
    pub(super) fn begun(fingerprint: &str) -> Self {
        let (fingerprint, files) = (fingerprint.to_owned(), String::new());
        Self { fingerprint, state: State::Begun, files, seconds: 0.0, report: serde_json::Value::Null }
    }

    pub(super) fn failed(self, error: String) -> Self {
        Self { state: State::Failed(error), ..self }
    }

    pub(super) fn done(self, output: &Path, seconds: f64, report: serde_json::Value) -> Self {
        Self { state: State::Done, files: files_made(output), seconds, report, ..self }
    }

    pub(super) fn write(&self, folder: &Path, step: Step) -> Result<()> {
        let text = serde_json::to_string_pretty(self).unwrap_or_default() + "\n";
        write_whole(&path(folder, step), text.as_bytes())
    }

    fn read(folder: &Path, step: Step) -> Result<Option<Self>> {
        let path = path(folder, step);
        let text = match read_text(&path) {
            Err(e) if e.kind() == std::io::ErrorKind::NotFound => return Ok(None),
            text => text.map_err(|e| Error::io("read what was done", &path, e))?,
        };
        serde_json::from_str(&text).map(Some).map_err(|e| {
            let what = format!("this is no record of a step: {e}");
            Error::input_at(&path, what, "Remove the recording's folder to do it again.")
        })
    }
}

fn path(folder: &Path, step: Step) -> PathBuf {
    folder.join("steps").join(format!("{}.json", step.name()))
}

/// The state of a task whose fingerprint is given, in the folder of its job.
pub(super) fn status(folder: &Path, task: &Task, fingerprint: &str) -> Result<Status> {
    let Some(record) = Record::read(folder, task.step)? else { return Ok(Status::New) };
    Ok(match record.state {
        _ if record.fingerprint != fingerprint => Status::Outdated,
        State::Done if record.files == files_made(&task.output) => Status::Done(record),
        State::Done => Status::Outdated,
        State::Begun | State::Failed(_) => Status::Unfinished(record),
    })
}

/// Of each task, what its result depends on: the program, its command line, its inputs, and the steps before it.
pub(super) fn fingerprints(job: &Job) -> Vec<String> {
    let recording = listing(&job.recording, &job.folder, true);
    let mut known: Vec<(Step, String)> = Vec::new();
    for task in &job.tasks {
        let before = known.iter().find(|(step, _)| Some(*step) == task.step.needs());
        let mut hash = Sha256::new();
        let mut add = |part: &[u8]| {
            hash.update((part.len() as u64).to_le_bytes());
            hash.update(part);
        };
        add(env!("CARGO_PKG_VERSION").as_bytes());
        add(before.map_or("", |(_, fingerprint)| fingerprint).as_bytes());
        add(recording.as_bytes());
        task.command.iter().for_each(|part| add(part.as_encoded_bytes()));
        task.inputs.iter().for_each(|input| add(listing(input, &job.folder, true).as_bytes()));
        known.push((task.step, format!("{:x}", hash.finalize())));
    }
    known.into_iter().map(|(_, fingerprint)| fingerprint).collect()
}

fn files_made(output: &Path) -> String {
    listing(output, Path::new(""), false)
}

/// Names, sizes and, if asked for, times of the files at `path`, hashed; those under `except` are not looked at.
fn listing(path: &Path, except: &Path, with_times: bool) -> String {
    let mut hash = Sha256::new();
    let entries = WalkDir::new(path).follow_links(true).sort_by_file_name();
    for entry in entries.into_iter().filter_entry(|e| e.path() != except).flatten() {
        let Some(data) = entry.metadata().ok().filter(|m| m.is_file()) else { continue };
        let name = entry.path().strip_prefix(path).unwrap_or(entry.path());
        let time = data.modified().ok().and_then(|t| t.duration_since(UNIX_EPOCH).ok());
        let nanoseconds = time.filter(|_| with_times).map_or(0, |t| t.as_nanos());
        hash.update(name.as_os_str().as_encoded_bytes());
        hash.update(format!("\0{} {nanoseconds}\0", data.len()));
    }
    format!("{:x}", hash.finalize())
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
        let list = || (listing(&at("in"), &at("in/out"), true), files_made(&at("in")));
        let first = list();
        assert_eq!(first, list());
        std::fs::create_dir(at("in/out")).unwrap();
        std::fs::write(at("in/out/b"), b"1").unwrap();
        assert_eq!(list().0, first.0, "results are no input");
        std::fs::remove_file(at("in/out/b")).unwrap();
        let file = std::fs::File::options().write(true).open(at("in/a")).unwrap();
        // A clock that was put right, or never was.
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
