//! Frames of a scene from Gaussians to the picture and the scores: on the GPU, whole and pass by pass, and on
//! the CPU.

use super::steps::PassRow;
use crate::{
    cli::bench::shown::{Way, pass_costs, spread, views, ways},
    engine::{Ask, BackendChoice, Engine, EngineOptions, SceneView},
    viewer::time_pictures,
};
use std::sync::Arc;
use surgtpgs_core::{Error, Result, camera::Camera, num::median, scene::Scene};
use surgtpgs_render::{Traffic, Wanted};

/// Numbers of prompts that are asked at once.
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
    pub(super) pictures: Differences,
    pub(super) scores: Differences,
}

/// Differences of a device's results from the CPU's.
#[derive(Clone, Copy, Default, serde::Serialize)]
pub(super) struct Differences {
    /// Share of the values that are more than one level of 255 off.
    pub(super) beyond_a_level: f64,
    /// Mean difference, levels of 255.
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
    let views = views(&cameras);
    let rows = ways(&views).into_iter().map(|way| way_row(&way, &mut gpu, &mut cpu));
    let mut ways = rows.collect::<Result<Vec<WayRow>>>()?;
    let [pictures, scores] = differences(&views, &mut gpu, &mut cpu)?;
    let of = format!("frame of {name}, {num_prompts} prompts");
    let costs = pass_costs(&mut gpu, &views)?;
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
        pictures,
        scores,
    }))
}

/// Returns the scene's classes, then other words.
fn prompts(scene: &Scene) -> impl Iterator<Item = String> {
    let classes = scene.classes.iter().map(|(class, _)| class.name.clone());
    classes.chain(MORE_WORDS.map(str::to_owned))
}

fn way_row(way: &Way, gpu: &mut Engine, cpu: &mut Engine) -> Result<WayRow> {
    let on_gpu = way.time(gpu)?;
    // In a round of its own, because the times' first round uploads the scene.
    let before = traffic(gpu);
    way.show(gpu)?;
    let crossed = traffic(gpu).since(&before);
    let frames = way.views.len().max(1) as f64;
    Ok(WayRow {
        way: way.name,
        gpu_ms: median_ms(on_gpu),
        cpu_ms: median_ms(way.time(cpu)?),
        uploaded: crossed.uploaded as f64 / frames,
        read_back: crossed.read_back as f64 / frames,
    })
}

/// Returns the bytes that crossed between this program and the device so far.
fn traffic(engine: &mut Engine) -> Traffic {
    engine.gpu().map(|renderer| renderer.gpu().traffic()).unwrap_or_default()
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

/// Compares the pictures of both, and the scores.
fn differences(views: &[SceneView], gpu: &mut Engine, cpu: &mut Engine) -> Result<[Differences; 2]> {
    let (mut pictures, mut scores) = (Levels::default(), Levels::default());
    for view in views {
        let [found, expected] = [&mut *gpu, &mut *cpu].map(|engine| engine.show(view, Ask::Now, Wanted::ALL));
        let (found, expected) = (found?, expected?);
        for (a, b) in found.picture.iter().zip(&expected.picture) {
            pictures.add(a.as_raw().iter().zip(b.as_raw()).map(|(a, b)| f64::from(a.abs_diff(*b))));
        }
        for (a, b) in found.scores.iter().zip(&expected.scores) {
            scores.add(a.data.iter().zip(&b.data).map(|(a, b)| 255.0 * f64::from((a - b).abs())));
        }
    }
    Ok([pictures, scores].map(|levels| levels.differences()))
}

/// Differences that were added up, levels of 255.
#[derive(Default)]
struct Levels {
    beyond: usize,
    sum: f64,
    count: usize,
}

impl Levels {
    fn add(&mut self, differences: impl Iterator<Item = f64>) {
        for difference in differences {
            self.beyond += usize::from(difference > 1.0);
            self.sum += difference;
            self.count += 1;
        }
    }

    fn differences(&self) -> Differences {
        let count = self.count.max(1) as f64;
        Differences { beyond_a_level: self.beyond as f64 / count, mean_levels: self.sum / count }
    }
}
