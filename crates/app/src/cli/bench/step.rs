//! `bench step`: the time of each pass of a training step, and the distance of its results from f64.

use super::{
    measure::{Files, Measure},
    reference::{Reduced, reduced},
};
use crate::{
    cli::{
        console::{print_report, say},
        verb::Exit,
    },
    engine::BackendChoice,
    jobs::{self, PrepareOptions},
};
use clap::Args;
use std::{
    fmt::Write,
    path::{Path, PathBuf},
};
use surgtpgs_core::{
    Error, Result,
    clock::PassName,
    demo::{self, DemoSettings},
    files::Inputs,
    prepare::Prepared,
    progress::unobserved,
    raster::{backward::raster_backward, bin::bin, project::SplatGradient},
    scene::Scene,
    sequence::Sequence,
    train::{Pass, TrainSettings, Trainer},
};

/// Image widths and heights, with the number of Gaussians, that are measured.
const SIZES: [(usize, usize, usize); 2] = [(320, 256, 10_000), (640, 512, 40_000)];
/// Number of frames of the clip.
const FRAMES: usize = 4;
/// Steps before the measurement, in which every frame is decoded.
const WARM_UP: usize = 8;

/// Time every pass of a training step on the demo, with its error against f64
#[derive(Debug, Args)]
pub(super) struct BenchStepArgs {
    /// Folder for step.csv
    #[arg(short, long, value_name = "DIR")]
    output: Option<PathBuf>,
    /// Steps to average over
    #[arg(long, default_value_t = 40, value_parser = clap::value_parser!(u32).range(1..))]
    steps: u32,
    /// Device to train on
    #[arg(long, value_enum, default_value_t = BackendChoice::Cpu)]
    backend: BackendChoice,
    /// Report as JSON
    #[arg(long)]
    json: bool,
}

/// Measurements of one way to do a step at one size.
#[derive(serde::Serialize)]
struct Outcome {
    backend: String,
    width: usize,
    height: usize,
    gaussians: usize,
    pixels: &'static str,
    steps_per_second: f64,
    /// Milliseconds of each pass per step, in the order of [`Pass::ALL`].
    pass_ms: Vec<f64>,
    /// Largest difference of a colour, opacity or feature from the f64 twin.
    image_error: f64,
    /// Root mean square difference of all gradients from the f64 twin's, relative to theirs.
    gradient_error: f64,
}

impl Measure for BenchStepArgs {
    fn run(&self, force: bool) -> Result<Exit> {
        let files = Files::claim(self.output.as_ref(), &Inputs::none(), force)?;
        let mut outcomes = Vec::new();
        for (width, height, gaussians) in SIZES {
            let folder =
                tempfile::tempdir().map_err(|e| Error::io("make a folder", std::env::temp_dir(), e))?;
            let prepared = prepared(width, height, folder.path())?;
            for (pixels, pixel_step, half_size_share) in
                [("all", 1, 0.0), ("a quarter, sampled", 2, 0.0), ("half size, sampled", 2, 1.0)]
            {
                let settings = TrainSettings {
                    pixel_step,
                    half_size_pixel_step: pixel_step,
                    half_size_share,
                    ..base(&prepared, gaussians)?
                };
                let outcome = measure(&prepared, settings, pixels, self)?;
                say(&line(&outcome));
                outcomes.push(outcome);
            }
        }
        let text = csv(&outcomes);
        files.write("step.csv", text.as_bytes())?;
        print_report(&outcomes, &text, self.json)?;
        files.finish()?;
        Ok(Exit::Done)
    }
}

/// Records and prepares the demo in a folder.
fn prepared(width: usize, height: usize, folder: &Path) -> Result<Prepared> {
    let settings = DemoSettings { width, height, frames: FRAMES, ..Default::default() };
    let recording = folder.join("recording");
    demo::write(&settings, &recording, &mut unobserved)?;
    let (sequence, to) = (Sequence::open(&recording)?, folder.join("prepared"));
    jobs::prepare(sequence, &to, &PrepareOptions::default(), &mut unobserved)
}

/// Returns settings that make as many Gaussians as wanted at the start, and no more later.
fn base(prepared: &Prepared, gaussians: usize) -> Result<TrainSettings> {
    let supervised = prepared.sequence.mask(0)?.data.iter().filter(|m| **m).count();
    let mut settings = TrainSettings {
        iterations: 1_000_000,
        min_pixels: 0,
        px_per_gaussian: supervised as f32 / gaussians as f32,
        ..Default::default()
    };
    settings.densify.growth = 0.0;
    Ok(settings)
}

fn measure(
    prepared: &Prepared,
    settings: TrainSettings,
    pixels: &'static str,
    args: &BenchStepArgs,
) -> Result<Outcome> {
    let steps = args.steps as usize;
    let mut trainer = Trainer::new(&prepared.sequence, Some(prepared), settings)?;
    let backend = jobs::backend::choose(&mut trainer, args.backend)?;
    run_steps(&mut trainer, WARM_UP)?;
    let mut before = clock_seconds(&trainer);
    let started = std::time::Instant::now();
    run_steps(&mut trainer, steps)?;
    let seconds = started.elapsed().as_secs_f64();
    if clock_seconds(&trainer) == before {
        // The passes of a GPU are timed one step at a time, in a run of their own.
        jobs::backend::time_passes(&mut trainer)?;
        run_steps(&mut trainer, WARM_UP)?;
        before = clock_seconds(&trainer);
        run_steps(&mut trainer, steps)?;
    }
    let spent = clock_seconds(&trainer).into_iter().zip(before).map(|(after, before)| after - before);
    let (image_error, gradient_error) = errors(&trainer.scene()?);
    Ok(Outcome {
        backend,
        width: prepared.sequence.width(),
        height: prepared.sequence.height(),
        gaussians: trainer.scene()?.gaussians.len(),
        pixels,
        steps_per_second: steps as f64 / seconds.max(1e-9),
        pass_ms: spent.map(|s| s * 1e3 / steps as f64).collect(),
        image_error,
        gradient_error,
    })
}

fn run_steps(trainer: &mut Trainer, steps: usize) -> Result<()> {
    for _ in 0..steps {
        trainer.step()?;
    }
    trainer.finish()
}

/// Returns the seconds spent in each pass so far.
fn clock_seconds(trainer: &Trainer) -> Vec<f64> {
    Pass::ALL.iter().map(|p| trainer.clock().seconds(*p)).collect()
}

/// Returns the largest error of the image, and the relative error of the gradients, against f64.
fn errors(scene: &Scene) -> (f64, f64) {
    let raster = reduced(scene, &scene.cameras[0], 0.5);
    (raster.image_error(), gradient_error(&raster))
}

fn gradient_error(raster: &Reduced) -> f64 {
    let Reduced { splats, packed, images, .. } = raster;
    // Any gradient of the image will do; this one has both signs.
    let pull: Vec<f32> = (0..images.planes.len()).map(|i| (i as f32 * 0.37).sin() * 1e-3).collect();
    let wide: Vec<f64> = pull.iter().map(|v| f64::from(*v)).collect();
    let bins = bin(splats, images.width, images.height);
    let (found, found_features) = raster_backward(splats, packed, &bins, images, &pull);
    let (expected, expected_features) = raster.with_twin(|twin| twin.backward(&wide));
    let found = found.iter().flat_map(SplatGradient::to_array).chain(found_features);
    let expected = expected.iter().flat_map(SplatGradient::to_array).chain(expected_features);
    let pairs = found.zip(expected);
    let (error, size) =
        pairs.fold((0.0, 0.0), |(error, size), (a, b)| (error + (f64::from(a) - b).powi(2), size + b * b));
    (error / f64::max(size, 1e-300)).sqrt()
}

fn line(o: &Outcome) -> String {
    format!(
        "{}×{}, {} Gaussians, pixels: {:<18} {:>6.1} steps/s, errors: image {:.1e}, gradients {:.1e}",
        o.width, o.height, o.gaussians, o.pixels, o.steps_per_second, o.image_error, o.gradient_error
    )
}

fn csv(outcomes: &[Outcome]) -> String {
    let passes: Vec<String> = Pass::ALL.iter().map(|p| format!("{p:?}_ms").to_lowercase()).collect();
    let mut text = format!(
        "width,height,gaussians,pixels,steps_per_second,{},image_error,gradient_error\n",
        passes.join(",")
    );
    for o in outcomes {
        let ms: Vec<String> = o.pass_ms.iter().map(|ms| format!("{ms:.3}")).collect();
        let _ = writeln!(
            text,
            "{},{},{},\"{}\",{:.2},{},{:.3e},{:.3e}",
            o.width,
            o.height,
            o.gaussians,
            o.pixels,
            o.steps_per_second,
            ms.join(","),
            o.image_error,
            o.gradient_error
        );
    }
    text
}
