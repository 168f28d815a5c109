//! `surgtpgs check`: what a recording holds, and what would make training go wrong.

use super::{
    Exit,
    console::{ProgressView, print, print_json},
    remedy,
};
use crate::{
    args::CheckArgs,
    jobs::Material,
    memory::{Work, require_for},
};
use surgtpgs_core::{
    Result,
    sequence::{self, CheckReport},
};

pub(super) fn run(args: &CheckArgs) -> Result<Exit> {
    let report = match Material::open(&args.sequence) {
        Ok(material) => {
            require_for(&Work::Reading(material.sequence()))?;
            let mut view = ProgressView::default();
            sequence::check(material.sequence(), &mut |p| view.show(p))?
        }
        Err(error) if args.json => unreadable(remedy::message(&error)),
        Err(error) => return Err(error),
    };
    if args.json {
        print_json(&report)?;
    } else {
        print(&as_text(&report))?;
    }
    Ok(if report.ok { Exit::Done } else { Exit::WrongInput })
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
