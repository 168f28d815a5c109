//! `bench train`: every setting of training on one recording, quality beside time.

use super::{
    measure::{Files, Measure},
    plot::{self, Axes, Point},
    rows::{Row, rows},
};
use crate::{
    cli::{
        console::{self, ProgressView, print_report, say},
        verb::Exit,
    },
    engine::{BackendChoice, Engine, EngineOptions},
    evaluation::{Extras, evaluate},
    jobs::{self, Material},
    tables,
};
use clap::Args;
use std::{path::PathBuf, sync::Arc};
use surgtpgs_core::{Error, Result, clock::PassName, train::Pass};

/// Train once for every setting: train.csv, train_psnr.svg, train_miou.svg
#[derive(Debug, Args)]
pub(super) struct BenchTrainArgs {
    /// A folder prepared with --eval, or a recording (then without features)
    sequence: PathBuf,
    /// Folder to write
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
    /// Optimiser steps of every row
    #[arg(long, default_value_t = 3000, value_parser = clap::value_parser!(u32).range(1..))]
    iterations: u32,
    /// Seed of everything random
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Device to train on
    #[arg(long, value_enum, default_value_t = BackendChoice::Cpu)]
    backend: BackendChoice,
    /// Only these rows, e.g. default,paper
    #[arg(long, value_delimiter = ',')]
    rows: Vec<String>,
    /// Report as JSON, too
    #[arg(long)]
    json: bool,
}

/// Measurements of one row, in the order of the columns of `train.csv`.
#[derive(serde::Serialize)]
struct Outcome {
    name: &'static str,
    what: &'static str,
    seconds: f64,
    steps_per_second: f64,
    gaussians: usize,
    dropped_steps: usize,
    psnr_masked_db: Option<f64>,
    ssim: Option<f64>,
    miou_paper: Option<f64>,
    miou_strict: Option<f64>,
    /// Lowest IoU of a class: methods fail first on small, fast things.
    worst_iou: Option<f64>,
    /// Milliseconds of each pass per step, in the order of [`Pass::ALL`].
    pass_ms: Vec<f64>,
}

impl Measure for BenchTrainArgs {
    fn run(&self, force: bool) -> Result<Exit> {
        let material = Material::open(&self.sequence)?;
        let inputs = material.inputs(&self.sequence);
        let files = Files::claim(Some(&self.output), &inputs, force)?;
        let wanted = wanted_rows(self)?;
        console::watch_interrupts();
        let mut outcomes = Vec::new();
        for (k, row) in wanted.iter().enumerate() {
            say(&format!("{} of {}: {} ({})", k + 1, wanted.len(), row.name, row.what));
            let outcome = measure(&material, row, self)?;
            say(&line(&outcome));
            outcomes.push(outcome);
            // The files are written after every row, so that an interrupted benchmark keeps what it has.
            write(&outcomes, &files)?;
        }
        let text: String = outcomes.iter().map(|o| line(o) + "\n").collect();
        print_report(&outcomes, &text, self.json)?;
        files.finish()?;
        Ok(Exit::Done)
    }
}

fn wanted_rows(args: &BenchTrainArgs) -> Result<Vec<Row>> {
    let all = rows(args.iterations as usize, args.seed);
    let names = || all.iter().map(|r| r.name).collect::<Vec<_>>().join("\", \"");
    if let Some(unknown) = args.rows.iter().find(|name| !all.iter().any(|r| r.name == *name)) {
        return Err(Error::input(
            format!("there is no row \"{unknown}\""),
            format!("The rows are \"{}\".", names()),
        ));
    }
    let is_wanted = |row: &Row| args.rows.is_empty() || args.rows.iter().any(|name| name == row.name);
    Ok(all.into_iter().filter(is_wanted).collect())
}

fn measure(material: &Material, row: &Row, args: &BenchTrainArgs) -> Result<Outcome> {
    let mut view = ProgressView::default();
    let mut pass_ms = Vec::new();
    let trained = jobs::train_watched(
        material,
        row.settings.clone(),
        args.backend,
        &mut |p| view.show(p),
        &mut |watched, _| {
            let per_step = 1e3 / watched.trainer.steps_done().max(1) as f64;
            pass_ms = Pass::ALL.iter().map(|p| watched.trainer.clock().seconds(*p) * per_step).collect();
        },
    )?;
    if trained.steps < row.settings.iterations {
        return Err(Error::Cancelled);
    }
    let (seconds, steps, dropped_steps) = (trained.seconds, trained.steps, trained.dropped);
    let options = EngineOptions {
        backend: BackendChoice::Cpu,
        sequence: Some(args.sequence.clone()),
        ..Default::default()
    };
    let mut engine = Engine::new(Arc::new(trained.scene), None, options)?;
    let report = evaluate(&mut engine, Extras::default(), &mut |p| view.show(p))?.report;
    let iou = report.iou.as_ref();
    Ok(Outcome {
        name: row.name,
        what: row.what,
        seconds,
        steps_per_second: steps as f64 / seconds.max(1e-9),
        gaussians: engine.scene().gaussians.len(),
        dropped_steps,
        psnr_masked_db: report.psnr_masked_db,
        ssim: report.ssim,
        miou_paper: iou.and_then(|iou| iou.paper.mean),
        miou_strict: iou.and_then(|iou| iou.strict.mean),
        worst_iou: iou.and_then(|iou| iou.paper.classes.values().copied().reduce(f64::min)),
        pass_ms,
    })
}

fn number(value: Option<f64>) -> String {
    value.map_or(String::new(), |v| format!("{v:.4}"))
}

fn line(o: &Outcome) -> String {
    format!(
        "{:<30} {:>7.1} s {:>6.1} steps/s {:>7} Gaussians  PSNR {:>7} dB  mIoU {:>6} (worst {:>6}, strict {:>6})",
        o.name,
        o.seconds,
        o.steps_per_second,
        o.gaussians,
        number(o.psnr_masked_db),
        number(o.miou_paper),
        number(o.worst_iou),
        number(o.miou_strict)
    )
}

fn csv(outcomes: &[Outcome]) -> Result<Vec<u8>> {
    let columns = "row,differs_in,seconds,steps_per_second,gaussians,dropped_steps,psnr_masked_db,ssim,miou_paper,\
                   miou_strict,worst_iou";
    let passes = Pass::ALL.iter().map(|pass| format!("{pass:?}_ms").to_lowercase());
    let columns: Vec<String> = columns.split(',').map(str::to_owned).chain(passes).collect();
    tables::csv_under(&columns, outcomes)
}

fn write(outcomes: &[Outcome], files: &Files) -> Result<()> {
    files.write("train.csv", &csv(outcomes)?)?;
    let points = |value: fn(&Outcome) -> Option<f64>| -> Vec<Point<'_>> {
        let point = |o: &Outcome| value(o).map(|y| Point { name: o.name, x: o.seconds, y });
        outcomes.iter().filter_map(point).collect()
    };
    let axes = |y| Axes { title: "Quality against training time", x: "training, s", y };
    plot::write(files, "train_psnr.svg", axes("PSNR inside the masks, dB"), &points(|o| o.psnr_masked_db))?;
    plot::write(files, "train_miou.svg", axes("mIoU (paper's protocol)"), &points(|o| o.miou_paper))
}
