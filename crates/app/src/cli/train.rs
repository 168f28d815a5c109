//! `surgtpgs train`: from a prepared folder or a recording to a scene file.

use super::{
    Exit,
    console::{self, ProgressView, print, print_json, say},
};
use crate::{
    args::TrainArgs,
    jobs::{self, Material, Trained},
};
use surgtpgs_core::{Result, train::TrainSettings};

/// The JSON report; its keys are a contract.
#[derive(serde::Serialize)]
struct Report {
    seconds: f64,
    steps: usize,
    steps_per_second: f64,
    gaussians: usize,
    peak_rss_bytes: Option<u64>,
    psnr_db: f64,
    held_out: bool,
    dropped_steps: usize,
    finished: bool,
}

pub(super) fn run(args: &TrainArgs) -> Result<Exit> {
    let material = Material::open(&args.sequence)?;
    console::require_writable(&args.output)?;
    if material.prepared().is_none() {
        say("training without features: prompts will find nothing in this scene (see `surgtpgs prepare`)");
    }
    let settings = settings(args);
    console::watch_interrupts();
    let mut view = ProgressView::default();
    let trained = jobs::train(&material, settings, &mut |p| view.show(p))?;
    drop(view);
    trained.scene.save(&args.output)?;
    let report = report(&trained, args.iterations as usize);
    if !report.finished {
        say(&format!("stopped after {} of {} steps; the scene is saved", report.steps, args.iterations));
    }
    if report.dropped_steps > 0 {
        say(&format!("{} steps were dropped because they were not finite", report.dropped_steps));
    }
    if args.json {
        print_json(&report);
    } else {
        print(&as_text(&report, args));
    }
    Ok(Exit::Done)
}

fn settings(args: &TrainArgs) -> TrainSettings {
    TrainSettings {
        iterations: args.iterations as usize,
        seed: args.seed,
        eval: args.eval,
        ..Default::default()
    }
}

fn report(trained: &Trained, asked: usize) -> Report {
    Report {
        seconds: trained.seconds,
        steps: trained.steps,
        steps_per_second: trained.steps as f64 / trained.seconds.max(1e-9),
        gaussians: trained.scene.gaussians.len(),
        peak_rss_bytes: peak_rss_bytes(),
        psnr_db: trained.psnr_db,
        held_out: trained.scene.provenance.held_out,
        dropped_steps: trained.dropped,
        finished: trained.steps >= asked,
    }
}

fn as_text(report: &Report, args: &TrainArgs) -> String {
    let frames = if report.held_out { "held-out frames" } else { "training frames, none was held out" };
    let memory = report.peak_rss_bytes.map_or(String::new(), |b| format!(", {} MB at most", b / 1_000_000));
    format!(
        "{} steps in {:.1} s ({:.0} a second{memory}), {} Gaussians, PSNR {:.2} dB ({frames})\n{}\n",
        report.steps,
        report.seconds,
        report.steps_per_second,
        report.gaussians,
        report.psnr_db,
        args.output.display()
    )
}

/// The most memory this process has had, where the system tells (Linux).
fn peak_rss_bytes() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find(|l| l.starts_with("VmHWM:"))?;
    line.split_whitespace().nth(1)?.parse::<u64>().ok().map(|kib| kib * 1024)
}
