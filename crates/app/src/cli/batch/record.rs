//! Records of steps: a small file beside each result, from which a later run sees what is still to be done.

use super::{
    facts::{RecordingFacts, listing, read_json},
    plan::{BatchJob, Task},
    steps::Step,
};
use sha2::{Digest, Sha256};
use std::path::{Path, PathBuf};
use surgtpgs_core::{Error, Result, files::write_whole, prepare::Prepared, sequence::Identity};

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
        read_json(&path(folder, step), "this is no record of a step")
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

fn facts_of(job: &BatchJob) -> &RecordingFacts {
    job.facts.get_or_init(|| RecordingFacts::of(&job.recording, &job.folder))
}

/// Checks and records the recording of a job before its steps. Fails if the job's folder holds results of
/// another recording. Writes down which recording the folder belongs to, points what was prepared to the
/// recording's present place, and returns the fingerprints of the tasks.
pub(super) fn settle_recording(job: &BatchJob) -> Result<Vec<String>> {
    let before = RecordingFacts::read(&job.folder)?;
    let now = facts_of(job);
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
fn require_same(job: &BatchJob, before: &RecordingFacts, now: &RecordingFacts) -> Result<()> {
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
fn follow(job: &BatchJob, fingerprints: &[String]) -> Result<()> {
    for (task, fingerprint) in job.tasks.iter().zip(fingerprints).filter(|(t, _)| t.step == Step::Prepare) {
        if let Status::Done(record) = status(&job.folder, task, fingerprint)? {
            Prepared::relocate(&task.output, &job.recording)?;
            Record { files: files_made(&task.output), ..record }.write(&job.folder, task.step)?;
        }
    }
    Ok(())
}

/// Returns a hash for each task of everything that its result depends on: the program, its command line, its
/// inputs, the recording wherever it and the results lie, and the steps before it.
pub(super) fn fingerprints(job: &BatchJob) -> Vec<String> {
    // Nothing is read of a recording that was never begun.
    let is_begun = job.facts.get().is_some() || RecordingFacts::file(&job.folder).exists();
    let facts = is_begun.then(|| facts_of(job));
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
        add(facts.map_or("", |facts| &facts.contents).as_bytes());
        let identity = facts.and_then(|facts| facts.identity.as_ref());
        add(identity.map_or(String::new(), Identity::digest).as_bytes());
        for part in &task.command {
            let inside = Path::new(part).strip_prefix(&job.folder).ok();
            match inside {
                _ if part == job.recording.as_os_str() => add(b"the recording"),
                Some(inside) => add(inside.as_os_str().as_encoded_bytes()),
                None => add(part.as_encoded_bytes()),
            }
        }
        task.inputs
            .iter()
            .for_each(|input| add(listing(std::slice::from_ref(input), &job.folder, true).as_bytes()));
        known.push((task.step, format!("{:x}", hash.finalize())));
    }
    known.into_iter().map(|(_, fingerprint)| fingerprint).collect()
}

/// Hashes the names and sizes of the files that a step made.
fn files_made(output: &Path) -> String {
    listing(&[output], Path::new(""), false)
}
