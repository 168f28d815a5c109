//! Chapters of a long recording as jobs of their own, for clusters. Each lies beside the scene, where the
//! step `train` finds it.

use super::{
    lock,
    plan::{BatchJob, Task},
    record::{self, Record, Status},
    require_needed,
    steps::{Step, StepVerb},
    work,
};
use crate::{
    cli::{
        console::say,
        train::{self, TrainArgs},
    },
    jobs,
};
use std::time::Duration;
use surgtpgs_core::{Error, Result};

/// Time for which a chapter waits for the others, which hold the lock of the step only to look at its record.
const PATIENCE: Duration = Duration::from_secs(10);

/// Returns the number of chapters in which a job's recording is trained; 0 if it is trained as a whole.
pub(super) fn count(job: &mut BatchJob) -> Result<usize> {
    let (tasks, at, _) = begin(job)?;
    train::count_chapters(args(&mut tasks[at])?)
}

/// Trains a chapter of a job's recording, unless it is done.
pub(super) fn train(job: &mut BatchJob, index: usize, label: &str) -> Result<()> {
    let folder = job.folder.clone();
    let (tasks, at, fingerprint) = begin(job)?;
    let task = &mut tasks[at];
    {
        // All chapters share the record of the step, and what is left of other settings goes once.
        let _lock = lock(&folder, Step::Train.name(), PATIENCE)?;
        match record::status(&folder, task, &fingerprint)? {
            Status::Done(_) => {
                say(&format!("{label}: train is done"));
                return Ok(());
            }
            Status::Unfinished(_) => {}
            status => {
                work::make_room(task, &status)?;
                jobs::remove_chapters(&task.output)?;
                Record::begun(&fingerprint).write(&folder, task.step)?;
            }
        }
    }
    let _lock = lock(&folder, &format!("chapter-{index}"), Duration::ZERO)?;
    let scene = task.output.clone();
    let args = args(task)?;
    args.take_chapter(index, &scene);
    if train::is_finished(args)? {
        say(&format!("{label}: chapter {index} is done"));
        return Ok(());
    }
    say(&format!("{label}: chapter {index}"));
    if train::train(args)?.finished { Ok(()) } else { Err(Error::Cancelled) }
}

/// Checks that a job's training can begin; returns the job's tasks, the place of that one, and its
/// fingerprint.
fn begin(job: &mut BatchJob) -> Result<(&mut [Task], usize, String)> {
    job.require_recording()?;
    let fingerprints = record::settle_recording(job)?;
    let at = job.tasks.iter().position(|task| task.step == Step::Train);
    let at = at.ok_or_else(|| Error::input("this recording is not trained", "Correct the jobs file."))?;
    require_needed(&job.folder, &job.tasks[..at], &fingerprints, Step::Train)?;
    Ok((&mut job.tasks, at, fingerprints[at].clone()))
}

fn args(task: &mut Task) -> Result<&mut TrainArgs> {
    match &mut task.verb {
        StepVerb::Train(args) => Ok(args),
        _ => Err(Error::input("this step trains nothing", "Correct the jobs file.")),
    }
}
