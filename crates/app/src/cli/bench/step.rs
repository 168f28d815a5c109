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
    tables,
};
use clap::Args;
use std::path::{Path, PathBuf};
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
const SIZES: [Size; 2] = [Size::new(320, 256, 10_000), Size::new(640, 512, 40_000)];
/// Ways to choose the pixels of a step: a name, the edge of the squares of which one pixel is rendered, and
/// the share of steps at half size.
pub(super) const PIXELS: [(&str, usize, f32); 3] =
    [("all", 1, 0.0), ("a quarter, sampled", 2, 0.0), ("half size, sampled", 2, 1.0)];
/// Number of frames of the clip.
const FRAMES: usize = 4;
/// Steps before the measurement, in which every frame is decoded.
pub(super) const WARM_UP: usize = 8;

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

/// Speed of one way to do a step at one size.
#[derive(serde::Serialize)]
pub(super) struct Speed {
    pub(super) backend: String,
    pub(super) width: usize,
    pub(super) height: usize,
    pub(super) gaussians: usize,
    pub(super) pixels: &'static str,
    pub(super) steps_per_second: f64,
    /// Milliseconds of each pass per step, in the order of [`Pass::ALL`].
    pub(super) pass_ms: Vec<f64>,
    /// Bytes that each pass has to move in memory per step; 0 on the CPU, where they are not counted.
    pub(super) pass_bytes: Vec<f64>,
}

/// Measurements of one way to do a step at one size.
#[derive(serde::Serialize)]
struct Outcome {
    #[serde(flatten)]
    speed: Speed,
    /// Largest difference of a colour, opacity or feature from the f64 twin.
    image_error: f64,
    /// Root mean square difference of all gradients from the f64 twin's, relative to theirs.
    gradient_error: f64,
}

impl Measure for BenchStepArgs {
    fn run(&self, force: bool) -> Result<Exit> {
        let files = Files::claim(self.output.as_ref(), &Inputs::none(), force)?;
        let mut outcomes = Vec::new();
        for size in SIZES {
            let folder =
                tempfile::tempdir().map_err(|e| Error::io("make a folder", std::env::temp_dir(), e))?;
            let prepared = prepared(size, folder.path())?;
            for (pixels, pixel_step, half_size_share) in PIXELS {
                let settings = TrainSettings {
                    pixel_step,
                    half_size_pixel_step: pixel_step,
                    half_size_share,
                    ..base(&prepared, size.gaussians)?
                };
                let outcome = measure(&prepared, settings, pixels, self)?;
                say(&line(&outcome));
                outcomes.push(outcome);
            }
        }
        let table = csv(&outcomes)?;
        files.write("step.csv", &table)?;
        print_report(&outcomes, &String::from_utf8_lossy(&table), self.json)?;
        files.finish()?;
        Ok(Exit::Done)
    }
}

/// Size of a picture, and the number of Gaussians that make it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Size {
    pub(super) width: usize,
    pub(super) height: usize,
    pub(super) gaussians: usize,
}

impl Size {
    pub(super) const fn new(width: usize, height: usize, gaussians: usize) -> Self {
        Self { width, height, gaussians }
    }
}

/// Records and prepares the demo in a folder.
pub(super) fn prepared(size: Size, folder: &Path) -> Result<Prepared> {
    let Size { width, height, .. } = size;
    let settings = DemoSettings { width, height, frames: FRAMES, ..Default::default() };
    let recording = folder.join("recording");
    demo::write(&settings, &recording, &mut unobserved)?;
    let (sequence, to) = (Sequence::open(&recording)?, folder.join("prepared"));
    jobs::prepare(sequence, &to, &PrepareOptions::default(), &mut unobserved)
}

/// Returns settings that make as many Gaussians as wanted at the start, and no more later.
pub(super) fn base(prepared: &Prepared, gaussians: usize) -> Result<TrainSettings> {
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
    let mut trainer = Trainer::new(&prepared.sequence, Some(prepared), settings)?;
    let backend = jobs::backend::choose(&mut trainer, args.backend)?;
    let speed = timed(&mut trainer, backend, pixels, args.steps as usize)?;
    let (image_error, gradient_error) = errors(&trainer.scene()?);
    Ok(Outcome { speed, image_error, gradient_error })
}

/// Times steps of a trainer that has not begun, on its backend.
pub(super) fn timed(
    trainer: &mut Trainer,
    backend: String,
    pixels: &'static str,
    steps: usize,
) -> Result<Speed> {
    run_steps(trainer, WARM_UP)?;
    let mut before = pass_sums(trainer);
    let started = std::time::Instant::now();
    run_steps(trainer, steps)?;
    let seconds = started.elapsed().as_secs_f64();
    if pass_sums(trainer) == before {
        // The passes of a GPU are timed one step at a time, in a run of their own.
        jobs::backend::time_passes(trainer)?;
        run_steps(trainer, WARM_UP)?;
        before = pass_sums(trainer);
        run_steps(trainer, steps)?;
    }
    let spent = pass_sums(trainer).into_iter().zip(before);
    let (pass_ms, pass_bytes) = spent
        .map(|(after, before)| [after[0] - before[0], after[1] - before[1]].map(|sum| sum / steps as f64))
        .map(|[seconds, bytes]| (seconds * 1e3, bytes))
        .unzip();
    let scene = trainer.scene()?;
    let camera = scene.cameras.first();
    Ok(Speed {
        backend,
        width: camera.map_or(0, |c| c.width as usize),
        height: camera.map_or(0, |c| c.height as usize),
        gaussians: scene.gaussians.len(),
        pixels,
        steps_per_second: steps as f64 / seconds.max(1e-9),
        pass_ms,
        pass_bytes,
    })
}

pub(super) fn run_steps(trainer: &mut Trainer, steps: usize) -> Result<()> {
    for _ in 0..steps {
        trainer.step()?;
    }
    trainer.finish()
}

/// Returns the seconds spent in each pass so far, and the bytes that it moved.
fn pass_sums(trainer: &Trainer) -> Vec<[f64; 2]> {
    let clock = trainer.clock();
    Pass::ALL.iter().map(|p| [clock.seconds(*p), clock.bytes(*p) as f64]).collect()
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
        o.speed.width,
        o.speed.height,
        o.speed.gaussians,
        o.speed.pixels,
        o.speed.steps_per_second,
        o.image_error,
        o.gradient_error
    )
}

fn csv(outcomes: &[Outcome]) -> Result<Vec<u8>> {
    let passes: Vec<String> = Pass::ALL.iter().map(|p| format!("{p:?}_ms").to_lowercase()).collect();
    let columns = [
        &["width", "height", "gaussians", "pixels", "steps_per_second"][..],
        &passes.iter().map(String::as_str).collect::<Vec<_>>(),
        &["image_error", "gradient_error"],
    ];
    let row = |o: &Outcome| {
        let Speed { width, height, gaussians, pixels, steps_per_second, .. } = o.speed;
        let about = (width, height, gaussians, pixels, steps_per_second);
        (about, o.speed.pass_ms.clone(), o.image_error, o.gradient_error)
    };
    tables::csv_under(&columns.concat(), &outcomes.iter().map(row).collect::<Vec<_>>())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_pass_has_a_column() {
        let speed = Speed {
            backend: "CPU".to_owned(),
            width: 4,
            height: 3,
            gaussians: 9,
            pixels: PIXELS[1].0,
            steps_per_second: 2.5,
            pass_ms: vec![0.5; Pass::ALL.len()],
            pass_bytes: Vec::new(),
        };
        let outcome = Outcome { speed, image_error: 1e-7, gradient_error: 0.5 };
        let text = String::from_utf8(csv(&[outcome]).unwrap()).unwrap();
        let lines: Vec<&str> = text.lines().collect();
        assert!(
            lines[0].starts_with("width,height,gaussians,pixels,steps_per_second,deform_ms,"),
            "{}",
            lines[0]
        );
        assert!(lines[0].ends_with("_ms,image_error,gradient_error"), "{}", lines[0]);
        assert!(lines[1].starts_with("4,3,9,\"a quarter, sampled\",2.5,0.5,"), "{}", lines[1]);
        assert!(lines[1].ends_with(",0.5,1e-7,0.5"), "{}", lines[1]);
    }
}
