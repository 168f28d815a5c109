//! Frames of a scene from Gaussians to the marked picture: on the GPU, whole and pass by pass, and on the
//! CPU.

use super::steps::PassRow;
use crate::{
    cli::bench::shown::{AGAIN, Show, WAYS, spread},
    engine::{BackendChoice, Engine, EngineOptions},
    viewer::time_pictures,
};
use image::RgbImage;
use std::sync::Arc;
use surgtpgs_core::{Error, Result, camera::Camera, num::median, scene::Scene};
use surgtpgs_render::Wanted;

/// Numbers of prompts that are marked at once.
pub(super) const NUM_PROMPTS: [usize; 2] = [1, 8];

/// Words that fill up the classes of a scene.
const MORE_WORDS: [&str; 8] =
    ["spleen", "stomach", "needle", "bile duct", "clip", "bowel", "blood vessel", "kidney"];

/// Measurements of one scene with a number of prompts.
#[derive(serde::Serialize)]
pub(super) struct Frames {
    pub(super) scene: String,
    pub(super) width: u32,
    pub(super) height: u32,
    pub(super) gaussians: usize,
    pub(super) prompts: usize,
    pub(super) ways: Vec<WayRow>,
    pub(super) passes: Vec<PassRow>,
    /// Share of the channels of the marked pictures that are more than one level of 255 from the CPU's.
    pub(super) beyond_a_level: f64,
    /// Mean difference of the marked pictures from the CPU's, levels of 255.
    pub(super) mean_levels: f64,
}

/// One way to show a frame. Times are medians.
#[derive(serde::Serialize)]
pub(super) struct WayRow {
    pub(super) way: &'static str,
    pub(super) gpu_ms: f64,
    pub(super) cpu_ms: f64,
    /// Bytes that cross between this program and the device for each frame.
    pub(super) uploaded: f64,
    pub(super) read_back: f64,
}

/// Measures a scene; `None` if it has no features and nothing can be asked.
pub(super) fn measure(
    name: &str,
    scene: Arc<Scene>,
    num_prompts: usize,
    num_frames: usize,
) -> Result<Option<Frames>> {
    if scene.codec.is_none() {
        return Ok(None);
    }
    let words: Vec<String> = prompts(&scene).take(num_prompts).collect();
    let frames = spread(&scene, num_frames);
    let cameras: Vec<(f32, Camera)> = frames.iter().map(|&i| (scene.time(i), scene.cameras[i])).collect();
    let Some(&(_, camera)) = cameras.first() else {
        return Err(Error::input("the scene has no frames", ""));
    };
    let open = |backend| -> Result<Engine> {
        let mut engine = Engine::new(scene.clone(), None, EngineOptions { backend, ..Default::default() })?;
        engine.set_prompts(&words)?;
        Ok(engine)
    };
    let (mut gpu, mut cpu) = (open(BackendChoice::Gpu)?, open(BackendChoice::Cpu)?);
    let show = Show::new(&gpu, &cameras);
    let mut ways: Vec<WayRow> = WAYS
        .into_iter()
        .map(|(way, wanted)| way_row(way, wanted, &show, &mut gpu, &mut cpu))
        .collect::<Result<_>>()?;
    let (again, wanted) = AGAIN;
    ways.push(way_row(again, wanted, &show.again(), &mut gpu, &mut cpu)?);
    let [beyond_a_level, mean_levels] = differences(&show, &mut gpu, &mut cpu)?;
    let of = format!("frame of {name}, {num_prompts} prompts");
    let costs = show.pass_costs(&mut gpu)?;
    ways.extend(window_rows(gpu, cpu, &words, &frames)?);
    Ok(Some(Frames {
        scene: name.to_owned(),
        width: camera.width,
        height: camera.height,
        gaussians: scene.gaussians.len(),
        prompts: words.len(),
        ways,
        passes: costs
            .iter()
            .map(|c| PassRow { of: of.clone(), pass: c.name.to_owned(), ms: c.ms, bytes: c.bytes as f64 })
            .collect(),
        beyond_a_level,
        mean_levels,
    }))
}

/// Returns the scene's classes, then other words.
fn prompts(scene: &Scene) -> impl Iterator<Item = String> {
    let classes = scene.classes.iter().map(|(class, _)| class.name.clone());
    classes.chain(MORE_WORDS.map(str::to_owned))
}

fn way_row(
    way: &'static str,
    wanted: Wanted,
    show: &Show,
    gpu: &mut Engine,
    cpu: &mut Engine,
) -> Result<WayRow> {
    let on_gpu = show.time(gpu, wanted)?;
    // In a round of its own, because the times' first round uploads the scene.
    let before = gpu.gpu().map(|renderer| renderer.gpu().traffic()).unwrap_or_default();
    for view in &show.views {
        gpu.show(view, show.ask(), wanted)?;
    }
    let after = gpu.gpu().map(|renderer| renderer.gpu().traffic()).unwrap_or_default();
    let crossed = after.since(&before);
    let frames = show.views.len().max(1) as f64;
    Ok(WayRow {
        way,
        gpu_ms: median_ms(on_gpu),
        cpu_ms: median_ms(show.time(cpu, wanted)?),
        uploaded: crossed.uploaded as f64 / frames,
        read_back: crossed.read_back as f64 / frames,
    })
}

/// Times the window's pictures, which are cleaned and outlined as well. Their scores come back from a device.
fn window_rows(gpu: Engine, cpu: Engine, words: &[String], frames: &[usize]) -> Result<[WayRow; 3]> {
    let on_gpu = time_pictures(gpu, words, frames)?;
    let on_cpu = time_pictures(cpu, words, frames)?;
    let row = |way, gpu: Vec<f64>, cpu: Vec<f64>, [uploaded, read_back]: [f64; 2]| WayRow {
        way,
        gpu_ms: median_ms(gpu),
        cpu_ms: median_ms(cpu),
        uploaded,
        read_back,
    };
    let crossed = [on_gpu.uploaded, on_gpu.read_back];
    Ok([
        row("Gaussians to the window's picture", on_gpu.whole, on_cpu.whole, crossed),
        row("the same, neither cleaned nor outlined", on_gpu.source, on_cpu.source, crossed),
        row("another threshold to the window's picture", on_gpu.again, on_cpu.again, [0.0; 2]),
    ])
}

/// Returns the median; 0 of nothing.
fn median_ms(mut ms: Vec<f64>) -> f64 {
    median(&mut ms).unwrap_or(0.0)
}

/// Compares the marked pictures of both: the share of channels beyond a level, and the mean difference.
fn differences(show: &Show, gpu: &mut Engine, cpu: &mut Engine) -> Result<[f64; 2]> {
    let pictures = Wanted { pictures: true, ..Wanted::default() };
    let (mut beyond, mut sum, mut count) = (0_u64, 0_u64, 0_usize);
    for view in &show.views {
        let marked = |engine: &mut Engine| -> Result<RgbImage> {
            let shown = engine.show(view, show.ask(), pictures)?;
            shown.marked.ok_or_else(|| Error::input("the picture did not come back", ""))
        };
        let (found, expected) = (marked(gpu)?, marked(cpu)?);
        for (a, b) in found.as_raw().iter().zip(expected.as_raw()) {
            beyond += u64::from(a.abs_diff(*b) > 1);
            sum += u64::from(a.abs_diff(*b));
        }
        count += expected.as_raw().len();
    }
    Ok([beyond, sum].map(|v| v as f64 / count.max(1) as f64))
}
