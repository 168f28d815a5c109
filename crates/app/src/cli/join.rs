//! `surgtpgs join`: one scene from scenes of chapters.

use super::{
    args::{not_shown_note, require_scene_name},
    console::{print_report, say},
    verb::{Exit, Run},
};
use crate::{
    jobs,
    memory::{Work, require_for},
    outputs,
};
use clap::Args;
use std::path::{Path, PathBuf};
use surgtpgs_core::{Result, files::Inputs};

/// Make one scene of those that `train --chapter` wrote
#[derive(Debug, Args)]
pub(super) struct JoinArgs {
    /// Scenes of chapters, in any order
    #[arg(required = true, value_name = "PART")]
    parts: Vec<PathBuf>,
    /// Scene file to write
    #[arg(short, long, value_name = "SCENE")]
    output: PathBuf,
    /// Replace an earlier scene
    #[arg(long)]
    force: bool,
    /// Report as JSON
    #[arg(long)]
    json: bool,
}

/// The JSON report; its keys are a contract.
#[derive(serde::Serialize)]
struct JoinReport {
    chapters: usize,
    frames: usize,
    /// Frames that no chapter shows.
    missing_frames: usize,
    /// Chapters whose training was stopped.
    unfinished_chapters: usize,
    bytes: u64,
}

impl Run for JoinArgs {
    fn run(&self) -> Result<Exit> {
        require_scene_name(&self.output)?;
        self.parts.iter().try_for_each(|part| require_for(&Work::Scene(part)))?;
        let scene = jobs::join(&self.parts)?;
        let stopped: Vec<_> =
            self.parts.iter().filter_map(|part| Some((part, jobs::stopped_at(part)?))).collect();
        let inputs = self.parts.iter().fold(Inputs::none(), |inputs, part| inputs.with("a chapter", part));
        let inputs = inputs.with("the scene's recording", &scene.provenance.sequence_path);
        outputs::scene_file(&self.output, &inputs, self.force)?
            .write_with(|file| scene.write(file, false))?;
        let frames = scene.num_frames();
        let report = JoinReport {
            chapters: scene.chapters.iter().len(),
            frames,
            missing_frames: scene.chapters.num_missing(frames),
            unfinished_chapters: stopped.len(),
            bytes: self.output.metadata().map_or(0, |about| about.len()),
        };
        if let Some(note) = not_shown_note(&scene) {
            say(&format!("note: {note}"));
        }
        for (part, jobs::Stopped { steps, of }) in stopped {
            say(&format!(
                "note: the training of {} was stopped after {steps} of {of} steps; `train --resume` goes on with it",
                part.display()
            ));
        }
        let text = format!("{} chapters, {frames} frames\n{}\n", report.chapters, self.output.display());
        print_report(&report, &text, self.json)?;
        Ok(Exit::Done)
    }

    fn output(&self) -> Option<&Path> {
        Some(&self.output)
    }
}
