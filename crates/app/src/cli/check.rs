//! `surgtpgs check`: what a recording holds, and what would make training go wrong.

use super::{
    args::HideArgs,
    console::{ProgressView, print_report},
    remedy,
    verb::{Exit, Run},
};
use crate::{
    jobs::Material,
    memory::{Work, require_for},
};
use clap::Args;
use std::path::PathBuf;
use surgtpgs_core::{
    Result,
    sequence::{self, CheckReport},
};

/// CheckReport what a recording holds and what would make training go wrong
#[derive(Debug, Args)]
pub(super) struct CheckArgs {
    /// A recording (folder or video file) or a prepared folder
    sequence: PathBuf,
    /// Parts of the frames to hide
    #[command(flatten)]
    hide: HideArgs,
    /// CheckReport as JSON
    #[arg(long)]
    json: bool,
}

impl Run for CheckArgs {
    fn run(&self) -> Result<Exit> {
        let report = match Material::open_hiding(&self.sequence, &self.hide.hide) {
            Ok(material) => {
                require_for(&Work::Reading(material.sequence()))?;
                let mut view = ProgressView::default();
                sequence::check(material.sequence(), &mut |p| view.show(p))?
            }
            Err(error) if self.json => unreadable(remedy::message(&error)),
            Err(error) => return Err(error),
        };
        print_report(&report, &as_text(&report), self.json)?;
        Ok(if report.ok { Exit::Done } else { Exit::WrongInput })
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
        warnings: Vec::new(),
        errors: vec![error],
    }
}

fn as_text(report: &CheckReport) -> String {
    let mut lines = vec![
        format!("frames   {} of {}×{}", report.frames, report.width, report.height),
        format!("camera   {}", report.camera),
        format!("depth    {}", report.depth),
        format!("masks    {}", report.masks),
        format!("labels   {}", report.labels),
    ];
    lines.extend(report.warnings.iter().map(|w| format!("note     {w}")));
    lines.extend(report.errors.iter().map(|e| format!("WRONG    {e}")));
    lines.push(
        if report.ok { "This recording can be trained on." } else { "Training would be wrong." }.into(),
    );
    lines.join("\n") + "\n"
}
