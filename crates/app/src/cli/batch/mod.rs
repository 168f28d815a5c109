//! `surgtpgs batch`: many recordings, each from its folder to masked frames, with one report.
//!
//! ```text
//! JOBS.toml ─▶ plan: command lines of prepare, train, eval, export ─▶ work: the code of these verbs
//!                       record: what is done of what ─┴▶ report.md, report.html, report.json
//! ```

mod chapters;
mod facts;
mod folders;
mod plan;
mod record;
mod report;
mod steps;
mod work;

use super::{
    console::{self, print_report, say},
    verb::{Exit, Run},
};
use crate::cli::remedy;
use crate::{outputs, text::one_line};
use clap::Args;
use plan::{BatchJob, BatchPlan, Task};
use record::Status;
use report::Troubles;
use std::{
    path::{Path, PathBuf},
    time::Duration,
};
use steps::Step;
use surgtpgs_core::{
    Error, Result,
    files::{Inputs, Lock, claim_collection, require_apart},
};
use work::Outcome;

/// Prepare, train, evaluate and export many recordings, with a report; a rerun does only what changed
#[derive(Debug, Args)]
pub(super) struct BatchArgs {
    /// Recordings and their settings: a TOML file with [defaults] and a [[recording]] for each; its keys are
    /// the options of prepare, train, eval and export, with _ for -
    #[arg(value_name = "JOBS.toml")]
    jobs: PathBuf,
    /// Folder to write, instead of the one that the file names (default: beside the file, with its name)
    #[arg(short, long, value_name = "DIR")]
    output: Option<PathBuf>,
    /// Only this recording; may be given several times
    #[arg(long, value_name = "NAME")]
    only: Vec<String>,
    /// Only these steps
    #[arg(long, value_enum, value_delimiter = ',', value_name = "STEP")]
    step: Vec<Step>,
    /// Train this chapter of the recording alone; the step `train` takes what is there
    #[arg(long, value_name = "K", requires = "only", conflicts_with_all = ["step", "dry_run"])]
    chapter: Option<usize>,
    /// Print in how many chapters the recording is trained: 0 if as a whole
    #[arg(long, requires = "only", conflicts_with_all = ["step", "dry_run", "chapter"])]
    count_chapters: bool,
    /// List the steps that would be run, and run nothing
    #[arg(long)]
    dry_run: bool,
    /// Run nothing, write the report of the results that are there
    #[arg(long, conflicts_with_all = ["dry_run", "only", "step"])]
    report_only: bool,
    /// Report as JSON
    #[arg(long)]
    json: bool,
}

/// Fails if a jobs file cannot be carried out as it is written.
pub fn check_jobs_file(path: &Path) -> Result<()> {
    BatchPlan::read(path, None).map(drop)
}

impl Run for BatchArgs {
    fn run(&self) -> Result<Exit> {
        let mut plan = BatchPlan::read(&self.jobs, self.output.as_deref())?;
        require_known(&plan, &self.only)?;
        let steps = if self.step.is_empty() { Step::ALL.to_vec() } else { self.step.clone() };
        if self.dry_run {
            return list(self, &plan, &steps);
        }
        let inputs = inputs(&self.jobs, &plan);
        claim_collection(&plan.output, outputs::BATCH, &inputs)?;
        plan.jobs.iter().try_for_each(|job| require_apart(&job.folder, &inputs))?;
        if self.count_chapters || self.chapter.is_some() {
            return self.run_chapters(&mut plan);
        }
        let mut troubles = Troubles::new();
        let mut has_failed = false;
        if !self.report_only {
            has_failed = run_jobs(self, &mut plan, &steps, &mut troubles)?;
        }
        let report = report::write(&plan, &self.jobs, &troubles)?;
        print_report(&report, &report.summary(&plan.output), self.json)?;
        if console::interrupted() {
            return Err(Error::Cancelled);
        }
        has_failed |= plan.jobs.iter().filter(|j| self.chooses(j)).any(|j| report.has_failed(&j.name));
        Ok(if has_failed { Exit::WrongInput } else { Exit::Done })
    }

    fn output(&self) -> Option<&Path> {
        self.output.as_deref()
    }
}

impl BatchArgs {
    fn chooses(&self, job: &BatchJob) -> bool {
        self.only.is_empty() || self.only.contains(&job.name)
    }

    /// Counts the chapters of the chosen recordings, or trains one of them.
    fn run_chapters(&self, plan: &mut BatchPlan) -> Result<Exit> {
        console::watch_interrupts();
        for job in plan.jobs.iter_mut().filter(|job| self.chooses(job)) {
            match self.chapter {
                Some(index) => chapters::train(job, index, &one_line(&job.name.clone()))?,
                None => {
                    let count = chapters::count(job)?;
                    let text = format!("{}: {count}\n", one_line(&job.name));
                    print_report(
                        &serde_json::json!({ "name": job.name, "chapters": count }),
                        &text,
                        self.json,
                    )?;
                }
            }
        }
        Ok(Exit::Done)
    }
}

/// Returns the files and folders that a batch reads.
fn inputs(jobs_file: &Path, plan: &BatchPlan) -> Inputs {
    let inputs = Inputs::none().with("the jobs file", jobs_file);
    plan.jobs.iter().fold(inputs, |inputs, job| {
        let read = job.tasks.iter().flat_map(|task| &task.inputs);
        let inputs = inputs.with("a recording", &job.recording);
        read.fold(inputs, |inputs, path| inputs.with("a file or folder that the jobs file names", path))
    })
}

/// Runs the chosen steps of the chosen jobs. Returns `true` if a step failed. Errors that kept a recording
/// from being worked on are added to `troubles`.
fn run_jobs(args: &BatchArgs, plan: &mut BatchPlan, steps: &[Step], troubles: &mut Troubles) -> Result<bool> {
    console::watch_interrupts();
    let mut has_failed = false;
    let chosen: Vec<usize> = (0..plan.jobs.len()).filter(|&at| args.chooses(&plan.jobs[at])).collect();
    for (k, &at) in chosen.iter().enumerate() {
        if console::interrupted() {
            break;
        }
        let job = &mut plan.jobs[at];
        let label = format!("{} of {}, {}", k + 1, chosen.len(), one_line(&job.name));
        match run_job(job, steps, &label) {
            Ok(is_done) => has_failed |= !is_done,
            Err(error) => {
                say(&format!("{label}: {}", one_line(&remedy::message(&error))));
                troubles.insert(job.name.clone(), one_line(&remedy::message(&error)));
            }
        }
        // The report is written after every recording, since long batches are looked at while they run.
        report::write(plan, &args.jobs, troubles)?;
    }
    Ok(has_failed)
}

fn require_known(plan: &BatchPlan, names: &[String]) -> Result<()> {
    let Some(unknown) = names.iter().find(|n| !plan.jobs.iter().any(|j| j.name == **n)) else {
        return Ok(());
    };
    let known: Vec<&str> = plan.jobs.iter().map(|j| j.name.as_str()).collect();
    let hint = format!("There are: {}.", known.join(", "));
    Err(Error::input(format!("no recording has the name \"{unknown}\""), hint))
}

/// Runs the chosen steps of a job that are not done yet. Returns `false` if one of them failed.
fn run_job(job: &mut BatchJob, steps: &[Step], label: &str) -> Result<bool> {
    job.require_recording()?;
    let fingerprints = record::settle_recording(job)?;
    let BatchJob { folder, tasks, .. } = job;
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
        let _lock = lock(folder, name, Duration::ZERO)?;
        require_needed(folder, before, &fingerprints, task.step)?;
        let status = record::status(folder, task, fingerprint)?;
        if matches!(status, Status::Done(_)) {
            say(&format!("{label}: {name} is done"));
            continue;
        }
        say(&format!("{label}: {name}"));
        match work::run(folder, task, &status, fingerprint)? {
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

/// Fails if the step that `step` works on, one of the tasks `before` it, is not done.
fn require_needed(folder: &Path, before: &[Task], fingerprints: &[String], step: Step) -> Result<()> {
    let needed = before.iter().zip(fingerprints).find(|(task, _)| Some(task.step) == step.needs());
    if let Some((needed, fingerprint)) = needed
        && !matches!(record::status(folder, needed, fingerprint)?, Status::Done(_))
    {
        let what = format!("{} needs the result of {}, which is not there", step.name(), needed.step.name());
        return Err(Error::input(what, "Run that step, too."));
    }
    Ok(())
}

/// Locks the work called `name` on a recording against other batches until the returned lock is dropped. If
/// another one holds it, waits for that as long as `patience`.
fn lock(folder: &Path, name: &str, patience: Duration) -> Result<Lock> {
    let steps = folder.join("steps");
    std::fs::create_dir_all(&steps).map_err(|e| Error::io("reserve the folder", &steps, e))?;
    Lock::acquire_within(patience, &steps.join(format!("{name}.lock")), folder)
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

fn list(args: &BatchArgs, plan: &BatchPlan, steps: &[Step]) -> Result<Exit> {
    let mut all = Vec::new();
    for job in plan.jobs.iter().filter(|j| args.chooses(j)) {
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
    let line =
        |l: &Listed<'_>| format!("{}, {} ({}): {}\n", one_line(l.name), l.step.name(), l.state, l.command);
    let text: String = all.iter().map(line).collect();
    print_report(&serde_json::json!({ "output": plan.output, "steps": all }), &text, args.json)?;
    Ok(Exit::Done)
}
