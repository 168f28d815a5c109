//! The report of a batch, made from the results on disk, whoever put them there and when.

use super::{
    plan::{BatchJob, BatchPlan, Task},
    record::{self, State, Status},
    steps::Step,
    work::{ANSWERS, RECONSTRUCTION},
};
use crate::{
    cli::{
        answers::Answers,
        document::{escaped, number, table, write_report},
        figures::{answers_table, classes_table},
        remedy,
    },
    evaluation::Iou,
    text::one_line,
};
use serde::Deserialize;
use serde_json::Value;
use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
};
use surgtpgs_core::{Result, about::intended_use, files::write_whole};

/// Errors that kept recordings from being worked on at all, by the recordings' names.
pub(super) type Troubles = BTreeMap<String, String>;

/// `report.json`; its keys are a contract.
#[derive(serde::Serialize)]
pub(super) struct BatchReport {
    intended_use: &'static str,
    recordings: Vec<Entry>,
}

#[derive(serde::Serialize)]
struct Entry {
    name: String,
    folder: PathBuf,
    /// `done`, `failed`, `unfinished` or `new`.
    state: &'static str,
    error: Option<String>,
    scene_bytes: Option<u64>,
    steps: Vec<StepEntry>,
}

#[derive(serde::Serialize)]
struct StepEntry {
    step: Step,
    /// `done`, `failed`, `unfinished` or `new`; a step that was done with other settings is `new`, too.
    state: &'static str,
    seconds: Option<f64>,
    error: Option<String>,
    /// Report of the verb itself.
    report: Option<Value>,
    command: String,
}

/// Values that the report takes from an evaluation.
#[derive(Default, Deserialize)]
struct Measured {
    psnr_masked_db: Option<f64>,
    ssim: Option<f64>,
    lpips: Option<f64>,
    frames: usize,
    held_out: bool,
    iou: Option<Iou>,
}

/// Values that the report takes from a training.
#[derive(Deserialize)]
struct Trained {
    steps: usize,
    seconds: f64,
    steps_per_second: f64,
    gaussians: usize,
    backend: String,
}

/// Values that the report takes from an export.
#[derive(Deserialize)]
struct Exported {
    query: Answers,
}

/// Writes the three reports.
pub(super) fn write(plan: &BatchPlan, jobs_file: &Path, troubles: &Troubles) -> Result<BatchReport> {
    let entries = plan.jobs.iter().map(|job| Entry::of(job, troubles));
    let report = BatchReport { intended_use: intended_use(), recordings: entries.collect::<Result<_>>()? };
    let text = serde_json::to_string_pretty(&report).unwrap_or_default() + "\n";
    write_whole(&plan.output.join("report.json"), text.as_bytes())?;
    let name = jobs_file.file_name().unwrap_or_default().to_string_lossy();
    let title = format!("SurgTPGS, {}", one_line(&name));
    write_report(&plan.output, &title, &report.markdown(&title, &plan.output))?;
    Ok(report)
}

/// Returns a task's command as it is typed.
pub(super) fn command_line(task: &Task) -> String {
    let words: Vec<String> = task.command.iter().map(|w| w.to_string_lossy().into_owned()).collect();
    shlex::try_join(words.iter().map(String::as_str)).unwrap_or_else(|_| words.join(" "))
}

impl Entry {
    fn of(job: &BatchJob, troubles: &Troubles) -> Result<Self> {
        let mut steps = Vec::new();
        for (task, fingerprint) in job.tasks.iter().zip(record::fingerprints(job)) {
            let (state, record) = match record::status(&job.folder, task, &fingerprint) {
                Ok(Status::Done(record)) => ("done", Some(record)),
                Ok(Status::Unfinished(record)) if record.state == State::Begun => ("unfinished", None),
                Ok(Status::Unfinished(record)) => ("failed", Some(record)),
                Ok(Status::Outdated | Status::New) => ("new", None),
                Err(_) => ("failed", None),
            };
            let error = record.as_ref().and_then(|r| match &r.state {
                State::Failed(error) => Some(error.clone()),
                _ => None,
            });
            let record = record.filter(|r| r.state == State::Done);
            steps.push(StepEntry {
                step: task.step,
                state,
                seconds: record.as_ref().map(|r| r.seconds),
                error,
                report: record.map(|r| r.report),
                command: command_line(task),
            });
        }
        let missing = job.require_recording().err().map(|e| remedy::message(&e));
        let failed =
            steps.iter().find_map(|s| Some(format!("{} failed: {}", s.step.name(), s.error.as_ref()?)));
        let error = troubles.get(&job.name).cloned().or(missing).or(failed);
        let states = |state: &str| steps.iter().filter(|s| s.state == state).count();
        let state = match () {
            () if error.is_some() || states("failed") > 0 => "failed",
            () if states("done") == steps.len() => "done",
            () if states("new") == steps.len() => "new",
            () => "unfinished",
        };
        let scene = std::fs::metadata(job.folder.join("scene.safetensors")).ok();
        let scene_bytes = scene.map(|data| data.len()).filter(|_| job.has(Step::Train));
        Ok(Self { name: job.name.clone(), folder: job.folder.clone(), state, error, scene_bytes, steps })
    }

    fn step(&self, step: Step) -> Option<&StepEntry> {
        self.steps.iter().find(|s| s.step == step)
    }

    /// Returns a step's report, if the step is done.
    fn reported<T: serde::de::DeserializeOwned>(&self, step: Step) -> Option<T> {
        T::deserialize(self.step(step)?.report.as_ref()?).ok()
    }

    /// Returns a line of the table of all recordings.
    fn row(&self) -> Vec<String> {
        let dash = || String::from("–");
        let measured: Option<Measured> = self.reported(Step::Eval);
        let of_eval = |value: fn(&Measured) -> Option<f64>, digits| {
            measured.as_ref().and_then(value).map_or_else(dash, |v| number(Some(v), digits))
        };
        let trained: Option<Trained> = self.reported(Step::Train);
        let scene = self.scene_bytes.filter(|_| trained.is_some());
        // A training may have been interrupted: its own report has the time of all its runs.
        let training = trained.as_ref().map(|t| t.seconds);
        let seconds = |step| {
            let seconds = training.filter(|_| step == Step::Train).or(self.step(step)?.seconds);
            seconds.map(|s| format!("{s:.1}"))
        };
        let mut row = vec![
            escaped(&self.name),
            self.state.into(),
            of_eval(|m| m.psnr_masked_db, 2),
            of_eval(|m| m.ssim, 3),
            of_eval(|m| m.iou.as_ref()?.paper.mean, 3),
            of_eval(|m| m.iou.as_ref()?.strict.mean, 3),
            trained.map_or_else(dash, |t| t.gaussians.to_string()),
            scene.map_or_else(dash, |bytes| format!("{:.1}", bytes as f64 / 1e6)),
        ];
        row.extend(Step::ALL.map(|step| seconds(step).unwrap_or_else(dash)));
        row
    }

    /// Returns the part of the report about this recording.
    fn section(&self, output: &Path) -> String {
        let mut text = format!("## {}\n\n", escaped(&self.name));
        if let Some(error) = &self.error {
            text += &format!("**Failed.** {}\n\n", escaped(error));
        }
        if let Some(t) = self.reported::<Trained>(Step::Train) {
            text += &format!(
                "{} steps in {:.1} s, {:.1} a second ({}); {} Gaussians.",
                t.steps,
                t.seconds,
                t.steps_per_second,
                escaped(&t.backend),
                t.gaussians
            );
            text += "\n\n";
        }
        if let Some(m) = self.reported::<Measured>(Step::Eval) {
            let kind =
                if m.held_out { "that training never saw" } else { "of the training, none was held out" };
            text += &format!("Frames measured on, {kind}: {}.", m.frames);
            text += &m.lpips.map(|v| format!(" LPIPS {v:.4}.")).unwrap_or_default();
            text += "\n\n";
            text += &self.picture(output, &["eval", RECONSTRUCTION], "Recorded, reconstructed, depth");
            text += &m.iou.as_ref().map(classes_table).unwrap_or_default();
        }
        if let Some(exported) = self.reported::<Exported>(Step::Export) {
            text += &answers_table(&exported.query);
            text += &self.picture(
                output,
                &["masked-frames", ANSWERS],
                "What was found, in the order of the prompts, each where it covers most",
            );
        } else if self.step(Step::Export).is_none() {
            text += "Nothing to export: that needs features and prompts.\n\n";
        }
        // An indented line is shown as it is. Shell quoting leaves line breaks alone, so they become spaces.
        let line = |s: &StepEntry| format!("    {}\n", s.command.replace(char::is_control, " "));
        text + &self.steps.iter().map(line).collect::<String>() + "\n"
    }

    fn picture(&self, output: &Path, name: &[&str], about: &str) -> String {
        let path: PathBuf =
            [&self.folder].into_iter().cloned().chain(name.iter().map(PathBuf::from)).collect();
        if !path.is_file() {
            return String::new();
        }
        let folder = self.folder.strip_prefix(output).unwrap_or(&self.folder).to_string_lossy();
        format!("![{about}]({folder}/{})\n\n{about}.\n\n", name.join("/"))
    }
}

impl BatchReport {
    pub(super) fn has_failed(&self, name: &str) -> bool {
        self.recordings.iter().any(|r| r.name == name && r.state == "failed")
    }

    fn count(&self, state: &str) -> usize {
        self.recordings.iter().filter(|r| r.state == state).count()
    }

    fn counts(&self) -> String {
        let states = ["done", "failed", "unfinished", "new"].map(|state| (self.count(state), state));
        let said = states.into_iter().filter(|(n, _)| *n > 0).map(|(n, state)| format!("{n} {state}"));
        let (n, s) = (self.recordings.len(), if self.recordings.len() == 1 { "" } else { "s" });
        format!("{n} recording{s}: {}", said.collect::<Vec<_>>().join(", "))
    }

    /// Returns the summary that a person reads at the end of the run.
    pub(super) fn summary(&self, output: &Path) -> String {
        let failed = self.recordings.iter().filter_map(|r| Some((&r.name, r.error.as_ref()?)));
        let failed: String = failed.map(|(name, error)| format!("  {}: {error}\n", one_line(name))).collect();
        format!("{}\n{failed}{}\n", self.counts(), output.join("report.html").display())
    }

    fn markdown(&self, title: &str, output: &Path) -> String {
        let head = [
            "recording",
            "state",
            "PSNR, dB",
            "SSIM",
            "mIoU, paper's",
            "mIoU, strict",
            "Gaussians",
            "scene, MB",
            "prepare, s",
            "train, s",
            "eval, s",
            "export, s",
        ];
        let mut text = format!(
            "# {}\n\n{}\n\n{}. PSNR is inside the supervision masks, SSIM of whole pictures.\n\n{}",
            escaped(title),
            self.intended_use,
            self.counts(),
            table(&head, self.recordings.iter().map(Entry::row))
        );
        for entry in &self.recordings {
            text += &entry.section(output);
        }
        text
    }
}
