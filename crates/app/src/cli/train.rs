//! `surgtpgs train`: from a prepared folder or a recording to a scene file.

use super::{
    Exit,
    console::{self, ProgressView, print, print_json, say},
};
use crate::{
    args::TrainArgs,
    jobs::{self, Material, Trained},
    memory::{Work, peak_rss_bytes, require_for},
    outputs,
};
use std::path::Path;
use surgtpgs_core::{Error, Result, train::Trainer};

/// The JSON report; its keys are a contract.
#[derive(serde::Serialize)]
pub(super) struct Report {
    backend: String,
    seconds: f64,
    steps: usize,
    steps_per_second: f64,
    gaussians: usize,
    peak_rss_bytes: Option<u64>,
    psnr_db: f64,
    held_out: bool,
    dropped_steps: usize,
    /// Reasons why the scene is worse than it could be.
    warnings: Vec<String>,
    pub(super) finished: bool,
}

pub(super) fn run(args: &TrainArgs) -> Result<Exit> {
    let report = train(args)?;
    if args.json {
        print_json(&report)?;
    } else {
        print(&as_text(&report, args))?;
    }
    Ok(Exit::Done)
}

/// Trains and saves the scene. A scene that is not finished was stopped by the user.
pub(super) fn train(args: &TrainArgs) -> Result<Report> {
    let material = Material::open(&args.sequence)?;
    let inputs = outputs::inputs_of_material(&args.sequence, &material);
    let checkpoint = jobs::checkpoint_path(&args.output);
    if checkpoint == args.output {
        let what = "this is the name of the file that keeps the unfinished training";
        return Err(Error::input_at(&args.output, what, "Give a name that ends in .safetensors."));
    }
    require_choice(args, &checkpoint)?;
    let output = outputs::scene_file(&args.output, &inputs, args.force || args.resume)?;
    let checkpoint = jobs::checkpoint_path(output.path());
    let _checkpoint = outputs::checkpoint_file(&checkpoint, &inputs)?;
    if material.prepared().is_none() {
        say("training without features: prompts will find nothing in this scene (see `surgtpgs prepare`)");
    }
    require_for(&Work::Training(material.sequence(), &args.settings()))?;
    let warning = args.settings().length_warning(material.sequence().num_frames());
    warning.iter().for_each(|warning| say(&format!("note: {warning}")));
    let mut trainer = match args.resume {
        true => Trainer::resume(material.sequence(), material.prepared(), &checkpoint)?,
        false => Trainer::new(material.sequence(), material.prepared(), args.settings())?,
    };
    let backend = jobs::backend::choose(&mut trainer, args.backend)?;
    if !args.resume && checkpoint.exists() {
        // An earlier training must not be gone on with once another one has begun.
        trainer.save_checkpoint(&checkpoint)?;
    }
    say(&format!("training on {backend}"));
    let asked = trainer.settings().iterations;
    console::watch_interrupts();
    let mut view = ProgressView::default();
    let trained = jobs::go_on(&mut trainer, Some(&checkpoint), &mut |p| view.show(p), &mut |_, _| {});
    drop(view);
    let mut trained = trained.inspect_err(|_| {
        if checkpoint.exists() {
            say("what was learned so far is kept, and --resume goes on from there");
        }
    })?;
    trained.scene.provenance.peak_rss_bytes = peak_rss_bytes();
    output.write(&trained.scene.to_bytes()?)?;
    let report =
        Report { warnings: warning.into_iter().collect(), ..report(&trained, asked, trainer.backend_name()) };
    if report.finished {
        jobs::remove_file(&checkpoint)?;
    } else {
        let then = if checkpoint.exists() { ", and --resume goes on from here" } else { "" };
        say(&format!("stopped after {} of {asked} steps; the scene is saved{then}", report.steps));
    }
    if report.dropped_steps > 0 {
        say(&format!("{} steps were dropped because they were not finite", report.dropped_steps));
    }
    Ok(report)
}

/// Fails if it is not clear whether to go on with an unfinished training: it is never lost by accident.
fn require_choice(args: &TrainArgs, checkpoint: &Path) -> Result<()> {
    match (args.resume, checkpoint.exists()) {
        (true, false) => Err(Error::input_at(
            checkpoint,
            "there is no unfinished training to go on with",
            "Train without --resume.",
        )),
        (false, true) if !args.force => Err(Error::input_at(
            checkpoint,
            "an earlier training of this scene is unfinished",
            "Go on with --resume, or begin again with --force.",
        )),
        _ => Ok(()),
    }
}

fn report(trained: &Trained, asked: usize, backend: String) -> Report {
    Report {
        backend,
        seconds: trained.seconds,
        steps: trained.steps,
        steps_per_second: trained.steps as f64 / trained.seconds.max(1e-9),
        gaussians: trained.scene.gaussians.len(),
        peak_rss_bytes: peak_rss_bytes(),
        psnr_db: trained.psnr_db,
        held_out: trained.scene.provenance.held_out,
        dropped_steps: trained.dropped,
        warnings: Vec::new(),
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
