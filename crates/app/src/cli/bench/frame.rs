//! `bench frame`: cost of a shown frame, pass by pass; each shortcut beside the exact way, with its error.

use super::{
    measure::{Files, Measure},
    plot::{self, Axes, Point},
    reference::reference_error,
    shown,
    timing::{ROUNDS, Timing, time},
};
use crate::{
    cli::{
        args::{RelevancyArgs, SceneArgs},
        console::{print_report, say},
        verb::Exit,
    },
    engine::{Engine, SceneView},
    tables,
    text::one_line,
    viewer::time_pictures,
};
use clap::Args;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::{path::PathBuf, sync::Arc, time::Instant};
use surgtpgs_core::{
    Error, Result,
    camera::Camera,
    clock::PassName,
    codec::Codec,
    deform::{Deformed, deform_by},
    grid::Grid,
    num,
    overlay::{OverlayLook, OverlayPrompt, overlay},
    raster::{CpuRenderer, FrameClock, FramePass, Images, Renderer},
    relevancy::{Exact, Folded, Lattice, Query, Relevancy, RelevancySettings, Rivals},
    scene::Scene,
};

/// Time every pass of a shown frame and every way to score it, with its error: frame.csv, frame.svg
#[derive(Debug, Args)]
pub(super) struct BenchFrameArgs {
    /// The scene
    #[command(flatten)]
    scene: SceneArgs,
    /// Folder to write
    #[arg(short, long, value_name = "DIR")]
    output: Option<PathBuf>,
    /// Frames to measure, evenly spread
    #[arg(long, default_value_t = 8, value_parser = clap::value_parser!(u32).range(1..))]
    frames: u32,
    /// Image size, if not that of the recording
    #[arg(long, value_name = "WIDTHxHEIGHT", value_parser = image_size)]
    size: Option<(u32, u32)>,
    /// Words to look for, if not the scene's classes; may be repeated
    #[arg(long, value_name = "TEXT")]
    prompt: Vec<String>,
    /// Options for answering prompts
    #[command(flatten)]
    relevancy: RelevancyArgs,
    /// Report as JSON
    #[arg(long)]
    json: bool,
}

/// Reads a size such as `640x512`.
fn image_size(text: &str) -> Result<(u32, u32), String> {
    let number = |part: &str| part.trim().parse().ok().filter(|n| (1..=8192).contains(n));
    let sides = text.split_once(['x', '×']).map(|(w, h)| (number(w), number(h)));
    match sides {
        Some((Some(width), Some(height))) => Ok((width, height)),
        _ => Err("give width and height in pixels, such as 640x512".to_owned()),
    }
}

/// The whole report.
#[derive(serde::Serialize)]
struct FrameBench {
    renderer: String,
    width: usize,
    height: usize,
    gaussians: usize,
    frames: usize,
    prompts: Vec<String>,
    rows: Vec<Timing>,
}

impl Measure for BenchFrameArgs {
    fn run(&self, force: bool) -> Result<Exit> {
        let mut engine = self.scene.open(&self.relevancy, None)?;
        let inputs = engine.inputs(&self.scene.scene);
        let files = Files::claim(self.output.as_ref(), &inputs, force)?;
        let scene = engine.scene().clone();
        let cameras: Vec<(f32, Camera)> = cameras(&scene, self);
        let Some((_, camera)) = cameras.first() else {
            return Err(Error::input("the scene has no frames", "Train it again from its recording."));
        };
        let prompts = wanted_prompts(&scene, self);
        let mut rows = rendering_rows(&mut engine, &scene, &cameras)?;
        rows.iter().for_each(|row| say(&line(row)));
        if scene.codec.is_some() && !prompts.is_empty() {
            engine.set_prompts(&prompts)?;
            let mut found = relevancy_rows(&engine, &scene, &cameras)?;
            found.extend(shown::rows(&mut engine, &cameras)?);
            if self.size.is_none() {
                let engine = self.scene.open(&self.relevancy, None)?;
                found.extend(window_rows(engine, &prompts, &shown::spread(&scene, self.frames as usize))?);
            }
            found.iter().for_each(|row| say(&line(row)));
            rows.extend(found);
        }
        let bench = FrameBench {
            renderer: engine.renderer_name(),
            width: camera.width as usize,
            height: camera.height as usize,
            gaussians: scene.gaussians.len(),
            frames: cameras.len(),
            prompts,
            rows,
        };
        let table = csv(&bench)?;
        write(&bench, &table, &files)?;
        print_report(&bench, &String::from_utf8_lossy(&table), self.json)?;
        files.finish()?;
        Ok(Exit::Done)
    }
}

/// Returns times and cameras of the frames that are measured.
fn cameras(scene: &Scene, args: &BenchFrameArgs) -> Vec<(f32, Camera)> {
    let camera = |i: usize| {
        let camera = scene.cameras[i];
        args.size.map_or(camera, |(width, height)| camera.resized(width, height))
    };
    shown::spread(scene, args.frames as usize).into_iter().map(|i| (scene.time(i), camera(i))).collect()
}

/// Times the window's pictures, with what it takes besides rendering and scoring.
fn window_rows(engine: Engine, prompts: &[String], frames: &[usize]) -> Result<[Timing; 3]> {
    let times = time_pictures(engine, prompts, frames)?;
    let row = |way: &str, ms| Timing::of("window", way, ms);
    Ok([
        row("picture of another frame", times.whole),
        row("the same, neither cleaned nor outlined", times.source),
        row("picture at another threshold", times.again),
    ])
}

/// Returns the prompts that were asked for, or the classes of the scene.
fn wanted_prompts(scene: &Scene, args: &BenchFrameArgs) -> Vec<String> {
    if args.prompt.is_empty() {
        scene.classes.iter().map(|(class, _)| class.name.clone()).collect()
    } else {
        args.prompt.clone()
    }
}

fn rendering_rows(engine: &mut Engine, scene: &Arc<Scene>, cameras: &[(f32, Camera)]) -> Result<Vec<Timing>> {
    let mut rows = vec![through_engine(engine, cameras)?];
    rows.extend(passes(scene, cameras)?);
    let mut kept = CpuRenderer::default();
    let mut images = Images::default();
    let mut clock = FrameClock::default();
    let ms = time(cameras, ROUNDS, |(t, camera)| {
        kept.render_into(scene, camera, *t, true, &mut images, &mut clock)
    })?;
    let (t, camera) = cameras[cameras.len() / 2];
    let error = reference_error(scene, &camera, t);
    rows.push(Timing { max_error: Some(error), ..Timing::of("frame", "CPU, colour, depth, features", ms) });
    let ms = time(cameras, ROUNDS, |(t, camera)| {
        CpuRenderer::default().render(scene, camera, *t, true).map(|_| ())
    })?;
    rows.push(Timing::of("frame", "CPU, nothing kept from the last frame", ms));
    let ms = time(cameras, ROUNDS, |(t, camera)| {
        kept.render_into(scene, camera, *t, false, &mut images, &mut clock)
    })?;
    rows.push(Timing::of("frame", "CPU, no prompt: no features", ms));
    let (t, _) = cameras[0];
    let zooms: Vec<Camera> = (0..cameras.len() as u32)
        .map(|k| camera.resized(camera.width.saturating_sub(k).max(1), camera.height))
        .collect();
    let ms =
        time(&zooms, ROUNDS, |camera| kept.render_into(scene, camera, t, true, &mut images, &mut clock))?;
    rows.push(Timing::of("frame", "CPU, only the camera moves: not deformed anew", ms));
    rows.push(half_size(scene, cameras)?);
    Ok(rows)
}

/// Times a frame as the viewer waits for it, on whatever renders here. Checks that a view that is asked for
/// twice is rendered only once.
fn through_engine(engine: &mut Engine, cameras: &[(f32, Camera)]) -> Result<Timing> {
    let name = format!("{}, through the engine", engine.renderer_name());
    let ms = time(cameras, ROUNDS, |(t, camera)| {
        let view = SceneView { time: *t, camera: *camera, recorded: Some(0) };
        engine.render(&view, true)?;
        let before = engine.clock().clone();
        engine.render(&view, true)?;
        let again = engine.clock().ran_since(&before);
        if again > 0 {
            return Err(Error::input(format!("{again} passes ran for a view that was there"), ""));
        }
        Ok(())
    })?;
    Ok(Timing::of("frame", name, ms))
}

/// Times each pass by itself, and the shortcuts within passes.
fn passes(scene: &Scene, cameras: &[(f32, Camera)]) -> Result<Vec<Timing>> {
    let (gaussians, deformation) = (&scene.gaussians, &scene.deformation);
    let n = gaussians.len();
    let mut rows = Vec::new();
    let mut clock = FrameClock::default();
    let (mut renderer, mut images) = (CpuRenderer::default(), Images::default());
    let mut ms = vec![Vec::new(); FramePass::ALL.len()];
    time(cameras, ROUNDS, |(t, camera)| {
        let before = clock.clone();
        renderer.render_into(scene, camera, *t, true, &mut images, &mut clock)?;
        for (pass, ms) in FramePass::ALL.iter().zip(&mut ms) {
            ms.push((clock.seconds(*pass) - before.seconds(*pass)) * 1e3);
        }
        Ok(())
    })?;
    let names = ["deform", "project", "bin", "raster"];
    for (name, ms) in names.into_iter().zip(ms) {
        // Without the first round, which warms up.
        rows.push(Timing::of(name, "as in a frame", ms[cameras.len()..].to_vec()));
    }

    let (mut psi, mut deformed) = (Vec::new(), Deformed::default());
    let mut largest = 0.0_f64;
    let all = time(cameras, ROUNDS, |(t, _)| {
        let values = if deformation.is_shared() { deformation.basis_values(*t).0 } else { Vec::new() };
        deformation.psi_of(0..deformation.num_bases, &values, n, *t, &mut psi);
        deform_by(gaussians, deformation, &psi, *t, true, &mut deformed);
        let live = deformation.psi(n, *t);
        let differences = psi.iter().zip(&live).map(|(a, b)| f64::from((a - b).abs()));
        largest = differences.fold(largest, f64::max);
        Ok(())
    })?;
    let live = time(cameras, ROUNDS, |(t, _)| {
        deformation.psi_into(n, *t, &mut psi);
        deform_by(gaussians, deformation, &psi, *t, true, &mut deformed);
        // As much work as above, so that only the bases differ.
        std::hint::black_box(deformation.psi(n, *t));
        Ok(())
    })?;
    rows.push(Timing::of("deform", format!("all {} bases, and ψ once more", deformation.num_bases), all));
    let live = Timing::of("deform", "live bases alone, and ψ once more", live);
    rows.push(Timing { max_error: Some(largest), ..live });
    Ok(rows)
}

/// Compares half the width and height, as while scrubbing, with the full picture.
fn half_size(scene: &Scene, cameras: &[(f32, Camera)]) -> Result<Timing> {
    let (mut renderer, mut images) = (CpuRenderer::default(), Images::default());
    let half = |c: &Camera| c.resized((c.width / 2).max(1), (c.height / 2).max(1));
    let mut clock = FrameClock::default();
    let ms = time(cameras, ROUNDS, |(t, camera)| {
        renderer.render_into(scene, &half(camera), *t, true, &mut images, &mut clock)
    })?;
    let (t, camera) = &cameras[cameras.len() / 2];
    let full = renderer.render(scene, camera, *t, false)?.to_rgb();
    let small = renderer.render(scene, &half(camera), *t, false)?.to_rgb();
    let filter = image::imageops::FilterType::Triangle;
    let enlarged = image::imageops::resize(&small, full.width(), full.height(), filter);
    let psnr = surgtpgs_core::metrics::psnr_db(&enlarged, &full, None);
    Ok(Timing { psnr_db: psnr, ..Timing::of("frame", "CPU, half width and height, as while scrubbing", ms) })
}

/// Compares every way to score the engine's prompts with decoding every pixel.
fn relevancy_rows(engine: &Engine, scene: &Scene, cameras: &[(f32, Camera)]) -> Result<Vec<Timing>> {
    let Some(codec) = scene.codec.clone() else { return Ok(Vec::new()) };
    let (queries, settings) = (engine.queries().to_vec(), engine.settings().clone());
    let mut renderer = CpuRenderer::default();
    let mut images: Vec<Images> =
        cameras.iter().map(|(t, camera)| renderer.render(scene, camera, *t, true)).collect::<Result<_>>()?;
    images.iter_mut().for_each(|images| blank_outside(images, scene));
    let ask = Asked { images: &images, queries: &queries, settings: &settings };
    let (truth, ms) = ask.of(&mut Exact::new(codec.clone()));
    let mut rows =
        vec![with_errors(Timing::of("relevancy", "exact: every pixel decoded", ms), &truth, &truth)];
    let (scores, ms) = ask.of(&mut Folded::new(codec.clone()));
    rows.push(with_errors(Timing::of("relevancy", "folded", ms), &scores, &truth));
    if let Some(mut lattice) = Lattice::new(&codec) {
        let (_, first) = ask.of(&mut lattice);
        // Cells that one prompt has cut are tabulated for the others in their next round.
        let (scores, _) = ask.of(&mut lattice);
        let known = ask.timed(&mut lattice);
        let report = lattice.report();
        rows.push(Timing::of("relevancy", "lattice: cells made", first));
        let way = format!("lattice: cells known ({} of {:.0} MB)", report.cells, report.bytes as f64 / 1e6);
        rows.push(with_errors(Timing::of("relevancy", way, known), &scores, &truth));
    }
    if let Some(mut lattice) = Lattice::new(&codec) {
        rows.extend(prompt_rows(&ask, &mut lattice));
    }
    rows.extend(crowded_rows(&ask, &codec));
    rows.push(drawing(&images, &truth));
    Ok(rows)
}

/// Number of texts that compete in [`crowded_rows`].
const CROWD: usize = 1000;

/// Times and checks prompts that compete with a thousand texts near the scene's classes.
fn crowded_rows(ask: &Asked<'_>, codec: &Codec) -> Vec<Timing> {
    let mut rng = ChaCha8Rng::seed_from_u64(0);
    let near = |row: &[f32], rng: &mut ChaCha8Rng| -> Vec<f32> {
        let scale = 1.0 / (row.len() as f32).sqrt();
        row.iter().map(|v| v + scale * rng.random_range(-1.7..1.7)).collect()
    };
    let classes: Vec<&[f32]> = ask.queries.iter().flat_map(Query::texts).collect();
    let crowd: Vec<Vec<f32>> = (0..CROWD)
        .filter_map(|k| num::normalised(&near(classes.get(k % classes.len().max(1))?, &mut rng)))
        .collect();
    let rivals = Rivals::new(crowd.iter().map(|row| ("", row.as_slice())));
    let queries: Vec<Query> =
        ask.queries.iter().map(|query| query.clone().among(&rivals, vec![0, 5, 700])).collect();
    let ask = Asked { queries: &queries, ..*ask };
    let Some(mut lattice) = Lattice::new(codec) else { return Vec::new() };
    let (truth, _) = ask.of(&mut Folded::new(codec.clone()));
    let (_, first) = ask.of(&mut lattice);
    let (scores, _) = ask.of(&mut lattice);
    let known = ask.timed(&mut lattice);
    let way = |what: &str| format!("lattice, {CROWD} competing texts: {what}");
    let mut rows = vec![
        Timing::of("relevancy", way("cells made"), first),
        with_errors(Timing::of("relevancy", way("cells known"), known), &scores, &truth),
    ];
    let new: Vec<Query> = queries.iter().cloned().map(renamed).collect();
    let images = &ask.images[..ask.images.len().min(1)];
    let (_, ms) = Asked { images, queries: &new, ..ask }.of(&mut lattice);
    rows.push(Timing::of("relevancy", way("a new prompt"), ms));
    rows
}

/// Renames the query so that no cached table is used.
fn renamed(query: Query) -> Query {
    Query { prompt: format!("new {}", query.prompt), ..query }
}

/// Frames, and prompts to ask on them.
#[derive(Clone, Copy)]
struct Asked<'a> {
    images: &'a [Images],
    queries: &'a [Query],
    settings: &'a RelevancySettings,
}

impl Asked<'_> {
    /// Returns the scores of each frame and prompt, and the milliseconds that each of them took.
    fn of(&self, rung: &mut dyn Relevancy) -> (Vec<Grid<f32>>, Vec<f64>) {
        let (mut scores, mut ms) = (Vec::new(), Vec::new());
        // One prompt after the other, as a user asks.
        for query in self.queries.chunks(1) {
            for images in self.images {
                let started = Instant::now();
                let mut found = rung.score(images, query, self.settings);
                ms.push(started.elapsed().as_secs_f64() * 1e3);
                scores.append(&mut found);
            }
        }
        (scores, ms)
    }

    /// Returns the milliseconds for each frame and prompt. Scores are dropped at once, so that their
    /// memory is used again.
    fn timed(&self, rung: &mut dyn Relevancy) -> Vec<f64> {
        let mut ms = Vec::new();
        for query in self.queries.chunks(1) {
            for images in self.images {
                let started = Instant::now();
                drop(rung.score(images, query, self.settings));
                ms.push(started.elapsed().as_secs_f64() * 1e3);
            }
        }
        ms
    }
}

/// Sets everything outside the field of view to zero, as in every recorded view.
fn blank_outside(images: &mut Images, scene: &Scene) {
    let inside = scene.field_of_view.sampled(images.width, images.height).data;
    for plane in images.planes.chunks_exact_mut(inside.len().max(1)) {
        plane.iter_mut().zip(&inside).filter(|(_, inside)| !**inside).for_each(|(v, _)| *v = 0.0);
    }
}

/// Times a prompt that was never asked before, and all prompts at once.
fn prompt_rows(ask: &Asked<'_>, lattice: &mut Lattice) -> Vec<Timing> {
    // All but the first prompt find the cells that the prompts before them made.
    let mut fresh = Vec::new();
    for query in ask.queries.chunks(1) {
        let started = Instant::now();
        lattice.score(&ask.images[0], query, ask.settings);
        fresh.push(started.elapsed().as_secs_f64() * 1e3);
        ask.images.iter().for_each(|images| drop(lattice.score(images, query, ask.settings)));
    }
    let mut rows = Vec::new();
    if let [_, others @ ..] = &fresh[..]
        && !others.is_empty()
    {
        rows.push(Timing::of("relevancy", "lattice, the first frame of another prompt", others.to_vec()));
    }
    let together: Vec<f64> = ask
        .images
        .iter()
        .map(|images| {
            let started = Instant::now();
            lattice.score(images, ask.queries, ask.settings);
            started.elapsed().as_secs_f64() * 1e3
        })
        .collect();
    let way = format!("lattice, {} prompts at once", ask.queries.len());
    rows.push(Timing::of("relevancy", way, together));
    rows
}

/// Times drawing the outlines of the first prompt over every frame, as exports do.
fn drawing(images: &[Images], scores: &[Grid<f32>]) -> Timing {
    let pairs: Vec<_> = images.iter().map(Images::to_rgb).zip(scores).collect();
    let ms = pairs
        .iter()
        .map(|(frame, scores)| {
            let started = Instant::now();
            let prompts = [(OverlayPrompt::new(scores, 0.4, [0, 200, 80]), false)];
            std::hint::black_box(overlay(frame, &prompts, None, OverlayLook::default(), frame.dimensions()));
            started.elapsed().as_secs_f64() * 1e3
        })
        .collect();
    Timing::of("overlay", "outline of one prompt, drawn as in exports", ms)
}

fn with_errors(row: Timing, found: &[Grid<f32>], truth: &[Grid<f32>]) -> Timing {
    let pairs = || found.iter().zip(truth).flat_map(|(a, b)| a.data.iter().zip(&b.data));
    let error = |(a, b): (&f32, &f32)| f64::from((a - b).abs());
    let count = pairs().count().max(1) as f64;
    let iou = |threshold: f32| {
        let both = pairs().filter(|(a, b)| **a > threshold && **b > threshold).count() as f64;
        let either = pairs().filter(|(a, b)| **a > threshold || **b > threshold).count() as f64;
        if either > 0.0 { both / either } else { 1.0 }
    };
    Timing {
        max_error: Some(pairs().map(error).fold(0.0, f64::max)),
        mean_error: Some(pairs().map(error).sum::<f64>() / count),
        iou_40: Some(iou(0.4)),
        iou_50: Some(iou(0.5)),
        ..row
    }
}

fn line(o: &Timing) -> String {
    let number = |v: Option<f64>| v.map_or("-".to_owned(), |v| format!("{v:.2e}"));
    format!(
        "{:<10} {:<52} {:>9.2} ms (95 %: {:>8.2})  largest error {}",
        o.pass,
        o.way,
        o.median_ms,
        o.p95_ms,
        number(o.max_error)
    )
}

/// Returns a line about the scene, then the table.
fn csv(bench: &FrameBench) -> Result<Vec<u8>> {
    let about = format!(
        "# {}; {}×{}, {} Gaussians, {} frames, prompts: {}\n",
        bench.renderer,
        bench.width,
        bench.height,
        bench.gaussians,
        bench.frames,
        one_line(&bench.prompts.join("; "))
    );
    Ok([about.into_bytes(), tables::csv(&bench.rows)?].concat())
}

fn write(bench: &FrameBench, table: &[u8], files: &Files) -> Result<()> {
    files.write("frame.csv", table)?;
    let scored = bench.rows.iter().filter(|o| o.pass == "relevancy");
    let points: Vec<Point<'_>> = scored
        .filter_map(|o| {
            // The number of cells, in brackets, is only for the table.
            let name = o.way.split(" (").next().unwrap_or_default();
            o.max_error.map(|e| Point { name, x: o.median_ms, y: 255.0 * e })
        })
        .collect();
    let axes = Axes {
        title: "Scores of one prompt in a frame: error against time",
        x: "milliseconds",
        y: "largest error of a score, 1/255",
    };
    plot::write(files, "frame.svg", axes, &points)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn image_sizes_are_two_numbers() {
        assert_eq!(image_size("640x512"), Ok((640, 512)));
        for wrong in ["640", "x512", "0x5", "640x9999", "axb", "-1x4"] {
            assert!(image_size(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn errors_and_overlaps_are_of_all_frames_together() {
        let truth = [Grid::from_vec(2, 1, vec![0.9, 0.1]), Grid::from_vec(2, 1, vec![0.45, 0.0])];
        let found = [Grid::from_vec(2, 1, vec![0.8, 0.1]), Grid::from_vec(2, 1, vec![0.35, 0.0])];
        let row = with_errors(Timing::of("relevancy", "x", vec![3.0, 1.0, 2.0]), &found, &truth);
        assert_eq!((row.median_ms, row.p95_ms), (2.0, 3.0));
        assert!((row.max_error.unwrap() - 0.1).abs() < 1e-6 && (row.mean_error.unwrap() - 0.05).abs() < 1e-6);
        assert_eq!((row.iou_40, row.iou_50), (Some(0.5), Some(1.0)));
    }
}
