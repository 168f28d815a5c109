//! `bench long`: recordings of several lengths, whose motion never repeats.

use super::{
    measure::{Files, Measure},
    plot::{self, Axes, Point},
};
use crate::{
    cli::{
        console::{self, ProgressView, print_report, say},
        verb::Exit,
    },
    engine::{BackendChoice, Engine, EngineOptions},
    evaluation::{Extras, evaluate},
    jobs::{self, Course, Material},
    memory::peak_rss_bytes,
    tables,
};
use clap::Args;
use std::{
    path::{Path, PathBuf},
    time::Instant,
};
use surgtpgs_core::{Error, Result, demo::DemoSettings, files::Inputs, scene::Scene, train::TrainSettings};

/// Train on synthetic recordings of several lengths: long.csv, long_psnr.svg, long_seconds.svg
#[derive(Debug, Args)]
pub(super) struct BenchLongArgs {
    /// Folder to write
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
    /// Numbers of frames
    #[arg(long, value_delimiter = ',', default_value = "48,200,800")]
    frames: Vec<u32>,
    /// Image columns
    #[arg(long, default_value_t = 320, value_parser = clap::value_parser!(u32).range(16..=4096))]
    width: u32,
    /// Image rows
    #[arg(long, default_value_t = 240, value_parser = clap::value_parser!(u32).range(16..=4096))]
    height: u32,
    /// Optimiser steps of each chapter
    #[arg(long, default_value_t = 4000, value_parser = clap::value_parser!(u32).range(1..))]
    iterations: u32,
    /// Most frames of a chapter; 0 for none
    #[arg(long, value_name = "N")]
    chapter_frames: Option<usize>,
    /// Let the endoscope move, by poses that are known
    #[arg(long)]
    moving_camera: bool,
    /// Device to train on
    #[arg(long, value_enum, default_value_t = BackendChoice::Cpu)]
    backend: BackendChoice,
    /// Report as JSON, too
    #[arg(long)]
    json: bool,
}

/// Number of frames before a seam at which two frames of one chapter are compared, like the two at the seam:
/// a multiple of the distance between held-out frames.
const ELSEWHERE: usize = 24;

/// Measurements of one length.
#[derive(serde::Serialize)]
struct Outcome {
    frames: usize,
    chapters: usize,
    steps: usize,
    seconds: f64,
    seconds_per_frame: f64,
    /// PSNR of held-out frames, and of the frames around them, moved by flow.
    psnr_masked_db: Option<f64>,
    flow_psnr_db: Option<f64>,
    /// PSNR of what changes from the last frame of a chapter to the first of the next, against the recording,
    /// and of the same between two frames of one chapter.
    seam_change_psnr_db: Option<f64>,
    other_change_psnr_db: Option<f64>,
    /// Largest memory of this process so far.
    peak_rss_bytes: Option<u64>,
    scene_bytes: u64,
    /// From the file to its first picture, seconds.
    open_s: f64,
    /// Reading of another chapter, milliseconds, mean.
    turn_ms: Option<f64>,
}

impl Measure for BenchLongArgs {
    fn run(&self, force: bool) -> Result<Exit> {
        let files = Files::claim(Some(&self.output), &Inputs::none(), force)?;
        console::watch_interrupts();
        let mut outcomes = Vec::new();
        for &frames in &self.frames {
            let outcome = self.measure(frames as usize)?;
            say(line(&outcome).trim_end());
            outcomes.push(outcome);
            // The files are written after every row, so that an interrupted benchmark keeps what it has.
            write(&outcomes, &files)?;
        }
        let text: String = outcomes.iter().map(line).collect();
        print_report(&outcomes, &text, self.json)?;
        files.finish()?;
        Ok(Exit::Done)
    }
}

impl BenchLongArgs {
    fn measure(&self, frames: usize) -> Result<Outcome> {
        let folder = tempfile::tempdir().map_err(|e| Error::io("make a folder", Path::new(""), e))?;
        let (recording, path) = (folder.path().join("recording"), folder.path().join("scene.safetensors"));
        let settings = DemoSettings {
            width: self.width as usize,
            height: self.height as usize,
            frames,
            moving_camera: self.moving_camera,
            wanders: true,
            ..DemoSettings::default()
        };
        let mut view = ProgressView::default();
        jobs::record_demo(&settings, &recording, false, &mut |p| view.show(p))?;
        let material = Material::open(&recording)?;
        let usual = TrainSettings::default();
        let settings = TrainSettings {
            iterations: self.iterations as usize,
            eval: true,
            chapter_frames: self.chapter_frames.unwrap_or(usual.chapter_frames),
            ..usual
        };
        let (backend, scene) = (self.backend, path.as_path());
        let course = Course {
            material: &material,
            settings,
            backend,
            scene,
            keeps_unfinished: false,
            replaces: false,
            look_at: None,
        };
        let trained = course.train(&mut |p| view.show(p), &mut |_, _| {})?;
        let peak_rss_bytes = peak_rss_bytes();
        trained.scene.save(&path)?;
        let started = Instant::now();
        let mut engine = Engine::open(&path, EngineOptions { backend, ..EngineOptions::default() })?;
        engine.render(&engine.view(0)?, false)?;
        let open_s = started.elapsed().as_secs_f64();
        let scene = engine.scene().clone();
        let report = evaluate(&mut engine, Extras::default(), &mut |p| view.show(p))?.report;
        let chapters = scene.chapters.iter().len();
        let seams: Vec<usize> = scene.chapters.iter().skip(1).map(|chapter| chapter.shown.start).collect();
        let others = elsewhere(&seams);
        Ok(Outcome {
            frames,
            chapters: chapters.max(1),
            steps: trained.steps,
            seconds: trained.seconds,
            seconds_per_frame: trained.seconds / frames as f64,
            psnr_masked_db: report.psnr_masked_db,
            flow_psnr_db: report.flow_psnr_db,
            seam_change_psnr_db: change_psnr_db(&mut engine, &seams)?,
            other_change_psnr_db: change_psnr_db(&mut engine, &others)?,
            peak_rss_bytes,
            scene_bytes: path.metadata().map_or(0, |about| about.len()),
            open_s,
            turn_ms: turn_ms(&scene)?,
        })
    }
}

/// Returns the frames that are compared with those at seams; none where there is no frame before.
fn elsewhere(seams: &[usize]) -> Vec<usize> {
    seams.iter().filter_map(|seam| seam.checked_sub(ELSEWHERE)).filter(|frame| *frame > 0).collect()
}

/// Compares the change of the picture from the frame before to each of `frames` with the recorded change.
/// Returns the mean PSNR, inside the field of view.
fn change_psnr_db(engine: &mut Engine, frames: &[usize]) -> Result<Option<f64>> {
    let mut error = |i: usize| -> Result<Vec<f64>> {
        let rendered = engine.render(&engine.view(i)?, false)?.to_rgb();
        let Some(recorded) = engine.original(i)? else { return Ok(Vec::new()) };
        let pixels = rendered.pixels().zip(recorded.pixels()).zip(&engine.scene().field_of_view.data);
        let seen = pixels.filter(|(_, is_seen)| **is_seen).flat_map(|((a, b), _)| a.0.into_iter().zip(b.0));
        Ok(seen.map(|(a, b)| f64::from(a) - f64::from(b)).collect())
    };
    let mut sum = 0.0;
    for &frame in frames {
        let (before, here) = (error(frame - 1)?, error(frame)?);
        let squares: f64 = before.iter().zip(&here).map(|(a, b)| (a - b) * (a - b)).sum();
        sum += 10.0 * (255.0 * 255.0 * here.len() as f64 / squares).log10();
    }
    Ok((!frames.is_empty()).then(|| sum / frames.len() as f64))
}

fn turn_ms(scene: &Scene) -> Result<Option<f64>> {
    let started = Instant::now();
    let mut count = 0;
    for chapter in scene.chapters.iter() {
        scene.of_chapter(chapter.index)?;
        count += 1;
    }
    Ok((count > 0).then(|| started.elapsed().as_secs_f64() * 1e3 / f64::from(count)))
}

fn number(value: Option<f64>) -> String {
    value.map_or(String::new(), |v| format!("{v:.2}"))
}

fn line(o: &Outcome) -> String {
    format!(
        "{:>5} frames, {:>2} chapters: {:>7.1} s ({:.2} a frame), PSNR {} dB (flow {}, change at seams {}, elsewhere {}), {} MB at most, \
         scene {} MB, first picture {:.2} s, next chapter {} ms\n",
        o.frames,
        o.chapters,
        o.seconds,
        o.seconds_per_frame,
        number(o.psnr_masked_db),
        number(o.flow_psnr_db),
        number(o.seam_change_psnr_db),
        number(o.other_change_psnr_db),
        o.peak_rss_bytes.unwrap_or(0) / 1_000_000,
        o.scene_bytes / 1_000_000,
        o.open_s,
        number(o.turn_ms)
    )
}

fn write(outcomes: &[Outcome], files: &Files) -> Result<()> {
    files.write("long.csv", &tables::csv(outcomes)?)?;
    let names: Vec<String> = outcomes.iter().map(|o| format!("{} frames", o.frames)).collect();
    let points = |value: fn(&Outcome) -> Option<f64>| -> Vec<Point<'_>> {
        let named = outcomes.iter().zip(&names);
        named.filter_map(|(o, name)| value(o).map(|y| Point { name, x: o.frames as f64, y })).collect()
    };
    let axes = |y| Axes { title: "Length of recordings", x: "frames", y };
    let psnr = points(|o| o.psnr_masked_db);
    plot::write(files, "long_psnr.svg", axes("PSNR of held-out frames, dB"), &psnr)?;
    let seconds = points(|o| Some(o.seconds_per_frame));
    plot::write(files, "long_seconds.svg", axes("training per frame, s"), &seconds)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn seams_of_short_chapters_are_compared_with_nothing() {
        assert_eq!(elsewhere(&[8, 23, 24, 25, 96]), [1, 72]);
    }
}
