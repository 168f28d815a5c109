//! Training steps at one size: on the GPU, whole and pass by pass, and on the CPU.

use crate::{
    cli::bench::step::{self, PIXELS, Size, Speed},
    engine::BackendChoice,
    jobs,
};
use surgtpgs_core::{
    Error, Result,
    clock::PassName,
    prepare::Prepared,
    train::{Pass, TrainSettings, Trainer},
};
use surgtpgs_render::{Gpu, GpuBackend, Traffic};

/// Speed of steps at one size with one choice of pixels.
#[derive(serde::Serialize)]
pub(super) struct StepRow {
    pub(super) width: usize,
    pub(super) height: usize,
    pub(super) gaussians: usize,
    pub(super) pixels: &'static str,
    pub(super) gpu_steps_per_second: f64,
    pub(super) cpu_steps_per_second: f64,
    /// Bytes that cross between this program and the device in each step.
    pub(super) uploaded: f64,
    pub(super) read_back: f64,
}

/// Cost of one pass of a step, or of a frame, in which nothing was left out.
#[derive(serde::Serialize)]
pub(super) struct PassRow {
    pub(super) of: String,
    pub(super) pass: String,
    pub(super) ms: f64,
    /// Bytes that it has to move at least.
    pub(super) bytes: f64,
}

/// Measures steps with all pixels, and with the pixels that a training usually takes.
pub(super) fn measure(gpu: &Gpu, size: Size, steps: usize) -> Result<(Vec<StepRow>, Vec<PassRow>)> {
    let folder = tempfile::tempdir().map_err(|e| Error::io("make a folder", std::env::temp_dir(), e))?;
    let prepared = step::prepared(size, folder.path())?;
    let (mut rows, mut passes) = (Vec::new(), Vec::new());
    for (pixels, pixel_step, half_size_share) in PIXELS.into_iter().take(2) {
        let settings = TrainSettings {
            pixel_step,
            half_size_pixel_step: pixel_step,
            half_size_share,
            ..step::base(&prepared, size.gaussians)?
        };
        let traffic = traffic(gpu, &prepared, settings.clone(), steps)?;
        let speed = |backend| -> Result<Speed> {
            let mut trainer = Trainer::new(&prepared.sequence, Some(&prepared), settings.clone())?;
            let name = jobs::backend::choose(&mut trainer, backend)?;
            step::timed(&mut trainer, name, pixels, steps)
        };
        let on_gpu = speed(BackendChoice::Gpu)?;
        rows.push(StepRow {
            width: on_gpu.width,
            height: on_gpu.height,
            gaussians: on_gpu.gaussians,
            pixels,
            gpu_steps_per_second: on_gpu.steps_per_second,
            cpu_steps_per_second: speed(BackendChoice::Cpu)?.steps_per_second,
            uploaded: traffic.uploaded as f64 / steps as f64,
            read_back: traffic.read_back as f64 / steps as f64,
        });
        if pixel_step == 1 {
            passes.extend(pass_rows(&on_gpu));
        }
    }
    Ok((rows, passes))
}

/// Returns the bytes that cross in `steps` steps, after each frame of the clip has been uploaded.
fn traffic(gpu: &Gpu, prepared: &Prepared, settings: TrainSettings, steps: usize) -> Result<Traffic> {
    let mut trainer = Trainer::new(&prepared.sequence, Some(prepared), settings)?;
    trainer.set_backend(Box::new(GpuBackend::new(gpu.clone())?))?;
    step::run_steps(&mut trainer, step::WARM_UP)?;
    let before = gpu.traffic();
    for _ in 0..steps {
        trainer.step()?;
    }
    Ok(gpu.traffic().since(&before))
}

fn pass_rows(speed: &Speed) -> Vec<PassRow> {
    let of = format!("step, {}×{}, {} Gaussians", speed.width, speed.height, speed.gaussians);
    let costs = speed.pass_ms.iter().zip(&speed.pass_bytes);
    let row = |(pass, (ms, bytes)): (&Pass, (&f64, &f64))| PassRow {
        of: of.clone(),
        pass: format!("{pass:?}").to_lowercase(),
        ms: *ms,
        bytes: *bytes,
    };
    // Without bytes there was no device that could time its passes.
    Pass::ALL.iter().zip(costs).map(row).filter(|row| row.bytes > 0.0).collect()
}
