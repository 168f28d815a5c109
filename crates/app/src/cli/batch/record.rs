//! Records of steps: a small file beside each result, from which a later run sees what is still to be done.

use super::plan::{Job, Task};
use crate::args::Step;
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
    prepare::Prepared,
    reading::{read_regular, read_text},
    sequence::{Identity, Sequence, settings_files},
};
use walkdir::{DirEntry, WalkDir};

/// Record of how a step went.
#[derive(Clone, Debug, serde::Serialize, serde::Deserialize)]
pub(super) struct Record {
    /// Hash of everything that the result depends on.
    fingerprint: String,
    pub(super) state: State,
    /// Hash of the names and sizes of the files made.
    files: String,
    /// Wall time in seconds; of the last run if there were several.
    pub(super) seconds: f64,
    /// JSON report of the verb.
    pub(super) report: serde_json::Value,
}

#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum State {
    Begun,
    Failed(String),
    Done,
}

/// State of a step, which decides what is to be done about it.
#[derive(Debug)]
pub(super) enum Status {
    /// It is done: there is nothing to do.
    Done(Record),
    /// It was begun or failed, with the same settings.
    Unfinished(Record),
    /// It was run with other settings or inputs, or its files have changed since.
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

/// Returns the state of a task with this fingerprint; `folder` is the folder of its job.
pub(super) fn status(folder: &Path, task: &Task, fingerprint: &str) -> Result<Status> {
    let Some(record) = Record::read(folder, task.step)? else { return Ok(Status::New) };
    Ok(match record.state {
        _ if record.fingerprint != fingerprint => Status::Outdated,
        State::Done if record.files == files_made(&task.output) => Status::Done(record),
        State::Done => Status::Outdated,
        State::Begun | State::Failed(_) => Status::Unfinished(record),
    })
}

/// Facts about the recording whose results are in a folder: enough to recognise it, wherever it lies.
#[derive(Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub(super) struct Source {
    path: PathBuf,
    /// Hash of the names, sizes and times of its files: while it stays the same, nothing is read again.
    listing: String,
    /// Hash of the names and content of its files; masks, labels and depth are among them.
    contents: String,
    /// `None` if the recording cannot be opened.
    identity: Option<Identity>,
}

/// Most bytes of a file that says which recording it is: that of some million frames.
const MOST_SOURCE: u64 = 1 << 28;

impl Source {
    /// Looks at the job's recording; reads its files only if it moved, changed or could not be opened before.
    fn of(job: &Job) -> Self {
        let listing = listing(&places_of(&job.recording), &job.folder, true);
        match Self::read(&job.folder) {
            Ok(Some(known)) if known.is_whole_and_at(&job.recording) && known.listing == listing => {
                return known;
            }
            _ => {}
        }
        let identity = Sequence::open(&job.recording).and_then(|s| s.identity()).ok();
        let identity = identity.map(|identity| Identity::clone(&identity));
        Self {
            path: job.recording.clone(),
            listing,
            contents: contents(&places_of(&job.recording), &job.folder),
            identity,
        }
    }

    fn is_whole_and_at(&self, recording: &Path) -> bool {
        self.path == recording && self.identity.is_some()
    }

    fn file(folder: &Path) -> PathBuf {
        folder.join("steps").join("recording.json")
    }

    fn read(folder: &Path) -> Result<Option<Self>> {
        let path = Self::file(folder);
        let text = match read_regular(&path, MOST_SOURCE) {
            Err(e) if e.kind() == std::io::ErrorKind::NotFound => return Ok(None),
            text => text.map_err(|e| Error::io("read what was done", &path, e))?,
        };
        serde_json::from_slice(&text).map(Some).map_err(|e| {
            let what = format!("this does not say which recording the folder is of: {e}");
            Error::input_at(&path, what, "Remove the recording's folder to do it again.")
        })
    }

    fn write(&self, folder: &Path) -> Result<()> {
        let text = serde_json::to_string_pretty(self).unwrap_or_default() + "\n";
        write_whole(&Self::file(folder), text.as_bytes())
    }
}

/// Checks and records the recording of a job before its steps. Fails if the job's folder holds results of
/// another recording. Writes down which recording the folder belongs to, points what was prepared to the
/// recording's present place, and returns the fingerprints of the tasks.
pub(super) fn settle_source(job: &Job) -> Result<Vec<String>> {
    let before = Source::read(&job.folder)?;
    let now = job.source.get_or_init(|| Source::of(job));
    if before.as_ref() == Some(now) {
        return Ok(fingerprints(job));
    }
    if let Some(before) = &before {
        require_same(job, before, now)?;
    }
    let fingerprints = fingerprints(job);
    let before_is_unknown = before.as_ref().is_none_or(|before| before.identity.is_none());
    if before.is_some_and(|before| before.path != now.path) {
        follow(job, &fingerprints)?;
    }
    // A recording that cannot be opened does not replace the one that the folder is known to belong to.
    if now.identity.is_some() || before_is_unknown {
        now.write(&job.folder)?;
    }
    Ok(fingerprints)
}

/// Fails if this is another recording. It counts as the same one, perhaps changed, if at least half
/// of its frames are the same.
fn require_same(job: &Job, before: &Source, now: &Source) -> Result<()> {
    let (Some(then), Some(identity)) = (&before.identity, &now.identity) else { return Ok(()) };
    let (common, of) = (identity.frames_in_common(then), identity.num_frames().min(then.num_frames()));
    if 2 * common >= of || !job.tasks.iter().any(|task| task.output.exists()) {
        return Ok(());
    }
    let what = format!(
        "this folder holds the results of another recording: {common} of {of} frames are the same as those of {}",
        job.recording.display()
    );
    let hint = "Give the recording a `name` of its own, correct its `path`, or choose another folder with `--output`.";
    Err(Error::input_at(&job.folder, what, hint))
}

/// Points what was prepared to the place that the recording has moved to.
fn follow(job: &Job, fingerprints: &[String]) -> Result<()> {
    for (task, fingerprint) in job.tasks.iter().zip(fingerprints).filter(|(t, _)| t.step == Step::Prepare) {
        if let Status::Done(record) = status(&job.folder, task, fingerprint)? {
            Prepared::relocate(&task.output, &job.recording)?;
            Record { files: files_made(&task.output), ..record }.write(&job.folder, task.step)?;
        }
    }
    Ok(())
}

/// Returns a hash for each task of everything that its result depends on: the program, its command line, its
/// inputs, the recording wherever it lies, and the steps before it.
pub(super) fn fingerprints(job: &Job) -> Vec<String> {
    // Nothing is read of a recording that was never begun.
    let is_begun = job.source.get().is_some() || Source::file(&job.folder).exists();
    let source = is_begun.then(|| job.source.get_or_init(|| Source::of(job)));
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
        add(source.map_or("", |source| &source.contents).as_bytes());
        let identity = source.and_then(|source| source.identity.as_ref());
        add(identity.map_or(String::new(), Identity::digest).as_bytes());
        for part in &task.command {
            let is_recording = part == job.recording.as_os_str();
            add(if is_recording { b"the recording" } else { part.as_encoded_bytes() });
        }
        task.inputs
            .iter()
            .for_each(|input| add(listing(std::slice::from_ref(input), &job.folder, true).as_bytes()));
        known.push((task.step, format!("{:x}", hash.finalize())));
    }
    known.into_iter().map(|(_, fingerprint)| fingerprint).collect()
}

fn files_made(output: &Path) -> String {
    listing(&[output], Path::new(""), false)
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
fn listing(places: &[impl AsRef<Path>], except: &Path, with_times: bool) -> String {
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
        let list = || (listing(&[at("in")], &at("in/out"), true), files_made(&at("in")));
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
