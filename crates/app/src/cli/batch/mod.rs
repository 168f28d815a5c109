//! `surgtpgs batch`: many recordings, each from its folder to masked frames, with one report.
//!
//! ```text
//! JOBS.toml ─▶ plan: command lines of prepare, train, eval, export ─▶ step: the code of these verbs
//!                       record: what is done of what ─┴▶ report.md, report.html, report.json
//! ```

mod folders;
mod plan;
mod record;
mod report;
mod step;

use super::{
    Exit,
    console::{self, print, print_json, say},
    one_line, remedy,
};
use crate::{
    args::{BatchArgs, Step},
    outputs,
};
use plan::{Job, Plan};
use record::Status;
use report::Troubles;
use std::path::Path;
use step::Outcome;
use surgtpgs_core::{
    Error, Result,
    files::{Inputs, Lock, claim_collection, require_apart},
};

/// Fails if a jobs file cannot be carried out as it is written.
pub fn check_jobs_file(path: &Path) -> Result<()> {
    Plan::read(path, None).map(drop)
}

pub(super) fn run(args: &BatchArgs) -> Result<Exit> {
    let mut plan = Plan::read(&args.jobs, args.output.as_deref())?;
    require_known(&plan, &args.only)?;
    let steps = if args.step.is_empty() { Step::ALL.to_vec() } else { args.step.clone() };
    let is_chosen = |job: &Job| args.only.is_empty() || args.only.contains(&job.name);
    if args.dry_run {
        return list(args, &plan, &steps, is_chosen);
    }
    let inputs = Inputs::none().with("the jobs file", &args.jobs);
    let inputs = plan.jobs.iter().fold(inputs, |inputs, job| {
        let read = job.tasks.iter().flat_map(|task| &task.inputs);
        let inputs = inputs.with("a recording", &job.recording);
        read.fold(inputs, |inputs, path| inputs.with("a file or folder that the jobs file names", path))
    });
    claim_collection(&plan.output, outputs::BATCH, &inputs)?;
    plan.jobs.iter().try_for_each(|job| require_apart(&job.folder, &inputs))?;
    let mut troubles = Troubles::new();
    let mut has_failed = false;
    if !args.report_only {
        console::watch_interrupts();
        let total = plan.jobs.iter().filter(|j| is_chosen(j)).count();
        for at in 0..plan.jobs.len() {
            if !is_chosen(&plan.jobs[at]) || console::interrupted() {
                continue;
            }
            let number = 1 + plan.jobs[..at].iter().filter(|j| is_chosen(j)).count();
            let job = &mut plan.jobs[at];
            let label = format!("{number} of {total}, {}", one_line(&job.name));
            match run_job(job, &steps, &label) {
                Ok(is_done) => has_failed |= !is_done,
                Err(error) => {
                    say(&format!("{label}: {}", one_line(&remedy::message(&error))));
                    troubles.insert(job.name.clone(), one_line(&remedy::message(&error)));
                }
            }
            // The report is written after every recording, since long batches are looked at while they run.
            report::write(&plan, &args.jobs, &troubles)?;
        }
    }
    let report = report::write(&plan, &args.jobs, &troubles)?;
    if args.json {
        print_json(&report)?;
    } else {
        print(&report.summary(&plan.output))?;
    }
    if console::interrupted() {
        return Err(Error::Cancelled);
    }
    has_failed |= plan.jobs.iter().filter(|j| is_chosen(j)).any(|j| report.has_failed(&j.name));
    Ok(if has_failed { Exit::WrongInput } else { Exit::Done })
}

fn require_known(plan: &Plan, names: &[String]) -> Result<()> {
    let Some(unknown) = names.iter().find(|n| !plan.jobs.iter().any(|j| j.name == **n)) else {
        return Ok(());
    };
    let known: Vec<&str> = plan.jobs.iter().map(|j| j.name.as_str()).collect();
    let hint = format!("There are: {}.", known.join(", "));
    Err(Error::input(format!("no recording has the name \"{unknown}\""), hint))
}

/// Runs the chosen steps of a job that are not done yet. Returns `false` if one of them failed.
fn run_job(job: &mut Job, steps: &[Step], label: &str) -> Result<bool> {
    require_recording(job)?;
    let fingerprints = record::settle_source(job)?;
    let Job { folder, tasks, .. } = job;
    let mut failed: Vec<Step> = Vec::new();
    for (i, fingerprint) in fingerprints.iter().enumerate() {
        let (before, task) = tasks.split_at_mut(i);
        let task = &mut task[0];
        let (name, needs) = (task.step.name(), task.step.needs());
        if needs.is_some_and(|step| failed.contains(&step)) {
            failed.push(task.step);
            continue;
        }
        if !steps.contains(&task.step) {
            continue;
        }
        let _lock = lock(folder, task.step)?;
        if let Some((needed, fingerprint)) =
            before.iter().zip(&fingerprints).find(|(t, _)| Some(t.step) == needs)
            && !matches!(record::status(folder, needed, fingerprint)?, Status::Done(_))
        {
            let what = format!("{name} needs the result of {}, which is not there", needed.step.name());
            return Err(Error::input(what, "Run that step, too."));
        }
        let status = record::status(folder, task, fingerprint)?;
        if matches!(status, Status::Done(_)) {
            say(&format!("{label}: {name} is done"));
            continue;
        }
        say(&format!("{label}: {name}"));
        match step::run(folder, task, &status, fingerprint)? {
            Outcome::Failed(error) => {
                say(&format!("{label}: {name} failed: {error}"));
                failed.push(task.step);
            }
            Outcome::Done if !console::interrupted() => {}
            Outcome::Done | Outcome::Stopped => break,
        }
    }
    Ok(failed.is_empty())
}

/// Fails if the recording is not at hand at the moment, so that its results are not thrown away.
fn require_recording(job: &Job) -> Result<()> {
    if job.recording.exists() {
        return Ok(());
    }
    Err(Error::input_at(&job.recording, "there is no recording here", "Correct its `path` in the jobs file."))
}

/// Locks a step of a recording against other batches until the returned file is dropped.
fn lock(folder: &Path, step: Step) -> Result<Lock> {
    let steps = folder.join("steps");
    std::fs::create_dir_all(&steps).map_err(|e| Error::io("reserve the folder", &steps, e))?;
    Lock::acquire(steps.join(format!("{}.lock", step.name())), folder)
}

/// A step in the output of `--dry-run --json`; the keys are a contract.
#[derive(serde::Serialize)]
struct Listed<'a> {
    name: &'a str,
    folder: &'a Path,
    step: Step,
    /// `done`, `unfinished`, `outdated` or `new`.
    state: &'static str,
    command: String,
}

fn list(args: &BatchArgs, plan: &Plan, steps: &[Step], is_chosen: impl Fn(&Job) -> bool) -> Result<Exit> {
    let mut all = Vec::new();
    for job in plan.jobs.iter().filter(|j| is_chosen(j)) {
        for (task, fingerprint) in job.tasks.iter().zip(record::fingerprints(job)) {
            if steps.contains(&task.step) {
                let state = match record::status(&job.folder, task, &fingerprint)? {
                    Status::Done(_) => "done",
                    Status::Unfinished(_) => "unfinished",
                    Status::Outdated => "outdated",
                    Status::New => "new",
                };
                let command = report::command_line(task);
                all.push(Listed { name: &job.name, folder: &job.folder, step: task.step, state, command });
            }
        }
    }
    if args.json {
        print_json(&serde_json::json!({ "output": plan.output, "steps": all }))?;
    } else {
        let line = |l: &Listed<'_>| {
            format!("{}, {} ({}): {}\n", one_line(l.name), l.step.name(), l.state, l.command)
        };
        print(&all.iter().map(line).collect::<String>())?;
    }
    Ok(Exit::Done)
}
