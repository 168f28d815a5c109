//! `bench gpu`: everything that judges a GPU, on one page: quality beside time, and each pass beside the
//! least time that the device's memory allows.

mod frames;
mod page;
mod scale;
mod steps;
mod trainings;

use super::measure::{Files, Measure};
use crate::{
    cli::{
        console::{print_report, say, watch_interrupts},
        verb::Exit,
    },
    text::one_line,
};
use clap::Args;
use frames::Frames;
use scale::{Budget, Scale};
use std::{panic::AssertUnwindSafe, path::PathBuf, sync::Arc};
use steps::{PassRow, StepRow};
use surgtpgs_core::{
    Error, Result,
    files::Inputs,
    raster::{CpuRenderer, Renderer},
    scene::Scene,
};
use surgtpgs_render::{AdapterChoice, AdapterFacts, Gpu};
use trainings::{Place, TrainingRow};

/// Judge the GPU: steps, passes, frames and trainings, beside the CPU: gpu.md, gpu.json
#[derive(Debug, Args)]
pub(super) struct BenchGpuArgs {
    /// Recording to train on, after the demo; may be repeated
    #[arg(long, value_name = "RECORDING")]
    recording: Vec<PathBuf>,
    /// Folder to write
    #[arg(short, long, value_name = "DIR")]
    output: Option<PathBuf>,
    /// Tiny sizes and a tiny training, to try the measurement itself
    #[arg(long)]
    short: bool,
    /// Seconds to take at most: trainings that would take longer end early, and the page says so
    #[arg(long, default_value_t = 300, value_parser = clap::value_parser!(u32).range(1..))]
    seconds: u32,
    /// Report as JSON
    #[arg(long)]
    json: bool,
}

/// The whole report.
#[derive(serde::Serialize)]
struct Report {
    adapter: String,
    driver: String,
    cpu: String,
    version: &'static str,
    /// All adapters that were found, the one in use among them: the name, then driver and features.
    adapters: Vec<[String; 2]>,
    scale: &'static str,
    /// Bytes read and written a second by a copy on the device; 0 if that failed.
    bandwidth: f64,
    steps: Vec<StepRow>,
    step_passes: Vec<PassRow>,
    trainings: Vec<TrainingRow>,
    frames: Vec<Frames>,
    failures: Vec<Failure>,
    seconds: f64,
}

/// A part of the report that could not be made.
#[derive(Debug, PartialEq, serde::Serialize)]
struct Failure {
    part: String,
    reason: String,
}

impl Measure for BenchGpuArgs {
    fn run(&self, force: bool) -> Result<Exit> {
        let inputs =
            self.recording.iter().fold(Inputs::none(), |inputs, path| inputs.with("a recording", path));
        let files = Files::claim(self.output.as_ref(), &inputs, force)?;
        watch_interrupts();
        let gpu = Gpu::open(AdapterChoice::Any)?;
        say(&format!("adapter: {}", gpu.name()));
        let scale = Scale::of(self.short, gpu.is_software());
        let mut bench =
            Bench { files, gpu, budget: Budget::new(self.seconds), report: Report::new(scale.name) };
        bench.run(&scale, &self.recording)?;
        bench.write()?;
        let Bench { files, report, .. } = bench;
        print_report(&report, &report.page(), self.json)?;
        files.finish()?;
        report.failures.iter().for_each(|f| say(&format!("failed: {}: {}", f.part, f.reason)));
        Ok(if report.failures.is_empty() { Exit::Done } else { Exit::Lacking })
    }
}

impl Report {
    fn new(scale: &'static str) -> Self {
        Self {
            adapter: String::new(),
            driver: String::new(),
            cpu: CpuRenderer::default().name(),
            version: env!("CARGO_PKG_VERSION"),
            adapters: Gpu::adapters().iter().map(described).collect(),
            scale,
            bandwidth: 0.0,
            steps: Vec::new(),
            step_passes: Vec::new(),
            trainings: Vec::new(),
            frames: Vec::new(),
            failures: Vec::new(),
            seconds: 0.0,
        }
    }
}

fn described(adapter: &AdapterFacts) -> [String; 2] {
    let features = if adapter.features.is_empty() { "no extras".into() } else { adapter.features.join(", ") };
    [adapter.name.clone(), format!("{}; {features}", adapter.driver)]
}

/// A measurement under way.
struct Bench {
    files: Files,
    gpu: Gpu,
    budget: Budget,
    report: Report,
}

impl Bench {
    fn run(&mut self, scale: &Scale, recordings: &[PathBuf]) -> Result<()> {
        self.report.adapter = self.gpu.name();
        self.report.driver = self.gpu.driver();
        let gpu = self.gpu.clone();
        self.report.bandwidth =
            self.attempt("memory bandwidth", |_| gpu.copy_bandwidth())?.unwrap_or_default();
        let scene = self.trainings_of("the demo", scale, Place::Demo, 1 + recordings.len())?;
        self.frames_of("the demo", scale, scene)?;
        for &size in &scale.sizes {
            let part = format!("steps at {}×{}", size.width, size.height);
            if let Some((rows, passes)) =
                self.attempt(&part, |b| steps::measure(&b.gpu, size, scale.steps))?
            {
                self.report.steps.extend(rows);
                self.report.step_passes.extend(passes);
            }
            self.write()?;
        }
        for (k, path) in recordings.iter().enumerate() {
            let name =
                path.file_name().map_or_else(|| path.display().to_string(), |n| n.display().to_string());
            let scene = self.trainings_of(&name, scale, Place::Recording(path), recordings.len() - k)?;
            self.frames_of(&name, scale, scene)?;
        }
        Ok(())
    }

    /// Trains on a recording with both backends, each within its share of the time that is left. Returns the
    /// scene that the GPU has learned, or else the CPU's.
    fn trainings_of(
        &mut self,
        name: &str,
        scale: &Scale,
        place: Place<'_>,
        num_left: usize,
    ) -> Result<Option<Arc<Scene>>> {
        let part = format!("preparing {name}");
        let Some(studio) = self.attempt(&part, |_| trainings::Studio::new(name, place, scale))? else {
            return Ok(None);
        };
        let mut scene = None;
        for (k, backend) in trainings::BACKENDS.into_iter().enumerate() {
            let part = format!("training on {name}, {}", trainings::backend_name(backend));
            let seconds = self.budget.share(2 * num_left - k);
            if let Some((row, learned)) = self.attempt(&part, |_| studio.train(backend, seconds))? {
                self.report.trainings.push(row);
                scene.get_or_insert(learned);
            }
        }
        self.write()?;
        Ok(scene)
    }

    fn frames_of(&mut self, name: &str, scale: &Scale, scene: Option<Arc<Scene>>) -> Result<()> {
        let Some(scene) = scene else { return Ok(()) };
        for num_prompts in frames::NUM_PROMPTS {
            let part = format!("frames of {name}, {num_prompts} prompts");
            let frames =
                self.attempt(&part, |_| frames::measure(name, scene.clone(), num_prompts, scale.frames))?;
            self.report.frames.extend(frames.flatten());
        }
        self.write()
    }

    /// Makes a part of the report. A part that fails, or panics because a driver did what none should do, is
    /// noted and the others are made all the same; so is one that there is no time for.
    fn attempt<T>(&mut self, part: &str, work: impl FnOnce(&mut Self) -> Result<T>) -> Result<Option<T>> {
        if self.budget.is_spent() {
            let reason = "left out, because the time was used up".to_owned();
            self.report.failures.push(Failure { part: part.to_owned(), reason });
            return Ok(None);
        }
        say(&format!("{part} …"));
        let done = std::panic::catch_unwind(AssertUnwindSafe(|| work(self)));
        let reason = match done {
            Ok(Ok(done)) => return Ok(Some(done)),
            Ok(Err(Error::Cancelled)) => return Err(Error::Cancelled),
            Ok(Err(error)) => error.to_string(),
            Err(_) => "the driver or this program made a mistake, see standard error".to_owned(),
        };
        self.report.failures.push(Failure { part: part.to_owned(), reason: one_line(&reason) });
        if let Some(loss) = self.gpu.loss() {
            // What follows gets a device that works, if there is one.
            say(&format!("the device was lost: {}", loss.reason));
            self.gpu = Gpu::open(AdapterChoice::Any)?;
        }
        Ok(None)
    }

    /// Writes down what there is so far, so that nothing is lost with a program that a driver takes down.
    fn write(&mut self) -> Result<()> {
        self.report.seconds = self.budget.spent();
        self.files.write("gpu.md", self.report.page().as_bytes())?;
        let json = serde_json::to_string_pretty(&self.report).unwrap_or_default() + "\n";
        self.files.write("gpu.json", json.as_bytes())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_part_that_fails_or_panics_is_noted_and_the_next_is_made() {
        let Ok(gpu) = Gpu::open(AdapterChoice::Any) else { return };
        let files = Files::claim(None, &Inputs::none(), false).unwrap();
        let mut bench = Bench { files, gpu, budget: Budget::new(9), report: Report::new("short") };
        let failed = bench.attempt::<()>("one", |_| Err(Error::input("it is\nbroken", "")));
        let panicked = bench.attempt::<()>("two", |_| panic!("on purpose"));
        assert!(failed.unwrap().is_none() && panicked.unwrap().is_none());
        assert_eq!(bench.attempt("three", |_| Ok(3)).unwrap(), Some(3));
        assert!(bench.attempt::<()>("four", |_| Err(Error::Cancelled)).is_err());
        let parts: Vec<&str> = bench.report.failures.iter().map(|f| f.part.as_str()).collect();
        assert_eq!(parts, ["one", "two"]);
        assert!(bench.report.failures[0].reason.starts_with("it is broken"));
        bench.budget = Budget::new(0);
        assert_eq!(bench.attempt("five", |_| Ok(5)).unwrap(), None);
        let page = bench.report.page();
        assert!(
            page.contains("- five: left out")
                && page.contains("- one: it is broken")
                && page.contains("- two: "),
            "{page}"
        );
    }
}
