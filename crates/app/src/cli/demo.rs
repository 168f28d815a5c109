//! `surgtpgs demo`: the built-in recording as an ordinary sequence folder.

use super::{
    console::{ProgressView, say},
    verb::{Exit, Run},
};
use crate::{
    jobs,
    memory::{Work, require_for},
};
use clap::Args;
use std::path::{Path, PathBuf};
use surgtpgs_core::{Result, demo::DemoSettings};

/// Seed of the recordings that users write.
const SEED: u64 = 7;

/// Write the built-in synthetic recording with all its ground truth
#[derive(Debug, Args)]
pub(super) struct DemoArgs {
    /// Folder to write
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
    /// Image columns
    #[arg(long, default_value_t = DemoSettings::default().width as u32, value_parser = clap::value_parser!(u32).range(16..=4096))]
    width: u32,
    /// Image rows
    #[arg(long, default_value_t = DemoSettings::default().height as u32, value_parser = clap::value_parser!(u32).range(16..=4096))]
    height: u32,
    /// Number of frames
    #[arg(long, default_value_t = DemoSettings::default().frames as u32, value_parser = clap::value_parser!(u32).range(1..=10_000))]
    frames: u32,
    /// Let the endoscope move
    #[arg(long)]
    moving_camera: bool,
    /// Let tissue and instrument stand still
    #[arg(long)]
    rigid: bool,
    /// Blur every fifth frame, as quick motion of the endoscope does
    #[arg(long)]
    blurred: bool,
    /// Let motion go on without ever repeating
    #[arg(long)]
    wandering: bool,
    /// Seed of textures and noise
    #[arg(long, default_value_t = SEED)]
    seed: u64,
    /// Replace an earlier result of this kind, once the new one is whole
    #[arg(long)]
    force: bool,
}

impl Run for DemoArgs {
    fn run(&self) -> Result<Exit> {
        require_for(&Work::Recording(self.width, self.height))?;
        let settings = DemoSettings {
            width: self.width as usize,
            height: self.height as usize,
            frames: self.frames as usize,
            moving_camera: self.moving_camera,
            rigid: self.rigid,
            blurred: self.blurred,
            wanders: self.wandering,
            seed: self.seed,
        };
        let mut view = ProgressView::default();
        jobs::record_demo(&settings, &self.output, self.force, &mut |p| view.show(p))?;
        drop(view);
        say(&format!("wrote {} frames to {}", self.frames, self.output.display()));
        Ok(Exit::Done)
    }

    fn output(&self) -> Option<&Path> {
        Some(&self.output)
    }
}
