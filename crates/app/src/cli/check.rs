//! `surgtpgs check`: what a recording holds, and what would make training go wrong.

use super::{
    args::HideArgs,
    console::{ProgressView, print_report},
    remedy,
    verb::{Exit, Run},
};
use crate::{
    jobs::{self, Material},
    memory::{LATENT_DIM, Work, require_for},
};
use clap::Args;
use std::path::PathBuf;
use surgtpgs_core::{Error, Result, sequence::CheckReport, train::Quality};

/// Report what a recording holds and what would make training go wrong
#[derive(Debug, Args)]
pub(super) struct CheckArgs {
    /// A recording (folder or video file) or a prepared folder
    sequence: PathBuf,
    /// Parts of the frames to hide
    #[command(flatten)]
    hide: HideArgs,
    /// Report as JSON
    #[arg(long)]
    json: bool,
}

impl Run for CheckArgs {
    fn run(&self) -> Result<Exit> {
        let report = match Material::open_hiding(&self.sequence, &self.hide.hide) {
            Ok(material) => {
                require_for(&Work::Reading(material.sequence()))?;
                let mut view = ProgressView::default();
                jobs::check(material.sequence(), &mut |p| view.show(p))?
            }
            // What this machine lacks says nothing about the recording.
            Err(lacking @ Error::Missing { .. }) => return Err(lacking),
            Err(error) if self.json => unreadable(remedy::message(&error).replace('\n', " ")),
            Err(error) => return Err(error),
        };
        let report = Whole::of(report);
        print_report(&report, &as_text(&report), self.json)?;
        Ok(if report.report.ok { Exit::Done } else { Exit::WrongInput })
    }
}

/// The report, with what to expect of a reconstruction with standard quality.
#[derive(serde::Serialize)]
struct Whole {
    #[serde(flatten)]
    report: CheckReport,
    /// Expected duration of the training on two processor cores, seconds.
    training_seconds: f64,
    /// Expected size of the scene file at most, bytes.
    scene_bytes: usize,
}

impl Whole {
    fn of(report: CheckReport) -> Self {
        let (frames, size) = (report.frames, [report.width, report.height]);
        // Nothing comes of a recording that could not be read.
        let scene_bytes = if frames > 0 { Quality::Standard.expected_bytes(frames, LATENT_DIM) } else { 0 };
        let training_seconds = Quality::Standard.expected_seconds(frames, size, None);
        Self { report, training_seconds, scene_bytes }
    }
}

/// Returns the report on a recording that could not even be opened.
fn unreadable(error: String) -> CheckReport {
    CheckReport {
        ok: false,
        frames: 0,
        width: 0,
        height: 0,
        camera: String::new(),
        depth: String::new(),
        masks: String::new(),
        labels: String::new(),
        cuts: Vec::new(),
        without_tissue: Vec::new(),
        warnings: Vec::new(),
        errors: vec![error],
    }
}

fn as_text(whole: &Whole) -> String {
    let report = &whole.report;
    let minutes = match (whole.training_seconds / 60.0).ceil() {
        ..=1.0 => "a minute".to_owned(),
        minutes => format!("{minutes:.0} minutes"),
    };
    let mut lines = vec![
        format!("frames   {} of {}×{}", report.frames, report.width, report.height),
        format!("camera   {}", report.camera),
        format!("depth    {}", report.depth),
        format!("masks    {}", report.masks),
        format!("labels   {}", report.labels),
        format!(
            "training about {minutes} on two processor cores; a scene of up to {} MB",
            whole.scene_bytes.div_ceil(1_000_000)
        ),
    ];
    lines.extend(report.warnings.iter().map(|w| format!("note     {w}")));
    lines.extend(report.errors.iter().map(|e| format!("WRONG    {e}")));
    lines.push(
        if report.ok { "This recording can be trained on." } else { "Training would be wrong." }.into(),
    );
    lines.join("\n") + "\n"
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nothing_is_expected_of_what_cannot_be_read() {
        let whole = Whole::of(unreadable("there is nothing".into()));
        assert_eq!((whole.scene_bytes, whole.training_seconds), (0, 0.0));
    }
}
