//! The backend that trains: the CPU, or a GPU if it is faster and comes to the same.

use crate::engine::{BackendChoice, may_have_gpu};
use surgtpgs_core::{
    Result,
    train::{CpuBackend, LossTerms, Trainer},
};
use surgtpgs_render::{AdapterChoice, Gpu, GpuBackend};

/// Number of steps that each backend is tried for.
const TRIED_STEPS: usize = 8;

/// Relative difference between the losses of both backends after the tried steps, beyond which the GPU is not
/// trusted: a hundred times the difference seen on correct adapters.
const MAX_DIFFERENCE: f32 = 0.02;

/// Gives the trainer the chosen backend, and returns its name with the reason for it.
/// [`BackendChoice::Auto`] measures a few steps of each backend and takes them back, so that the training
/// does not depend on the measurement.
pub fn choose(trainer: &mut Trainer, backend: BackendChoice) -> Result<String> {
    match backend {
        BackendChoice::Cpu => {}
        BackendChoice::Gpu => {
            trainer.set_backend(Box::new(GpuBackend::new(Gpu::open(AdapterChoice::Any)?)?))?
        }
        BackendChoice::Auto => return automatic(trainer),
    }
    Ok(trainer.backend_name())
}

/// Gives the trainer any GPU, with its passes timed, one step at a time.
pub fn time_passes(trainer: &mut Trainer) -> Result<()> {
    let mut backend = GpuBackend::new(Gpu::open(AdapterChoice::Any)?)?;
    backend.time_passes();
    trainer.set_backend(Box::new(backend))
}

fn automatic(trainer: &mut Trainer) -> Result<String> {
    let cpu = trainer.backend_name();
    if !may_have_gpu() {
        return Ok(cpu);
    }
    let Ok(gpu) = Gpu::open(AdapterChoice::RealGpu) else { return Ok(cpu) };
    let tried = GpuBackend::new(gpu.clone()).and_then(|b| trainer.try_out(Box::new(b), TRIED_STEPS));
    let on_gpu = match tried {
        Ok(on_gpu) => on_gpu,
        // If the GPU does not work, the CPU learns the same.
        Err(error) => return Ok(format!("{cpu}; the GPU failed: {error}")),
    };
    let on_cpu = trainer.try_out(Box::new(CpuBackend::default()), TRIED_STEPS)?;
    let judged = judge(on_gpu, on_cpu);
    let ms = |seconds: f64| seconds * 1e3 / TRIED_STEPS as f64;
    let times = format!("{:.1} ms a step on the GPU, {:.1} on the CPU", ms(on_gpu.0), ms(on_cpu.0));
    if judged == Judgement::Gpu {
        trainer.set_backend(Box::new(GpuBackend::new(gpu)?))?;
    }
    let why = if judged == Judgement::Wrong { ", whose losses differ" } else { "" };
    Ok(format!("{}: {times}{why}", trainer.backend_name()))
}

/// Result of trying out both backends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Judgement {
    Gpu,
    Cpu,
    /// The GPU came to another loss.
    Wrong,
}

/// Judges by the seconds and the last loss of each backend.
fn judge(gpu: (f64, LossTerms<f32>), cpu: (f64, LossTerms<f32>)) -> Judgement {
    let (found, expected) = (gpu.1.total(), cpu.1.total());
    // Written so that NaN fails.
    if !((found - expected).abs() <= MAX_DIFFERENCE * expected.abs()) {
        Judgement::Wrong
    } else if gpu.0 < cpu.0 {
        Judgement::Gpu
    } else {
        Judgement::Cpu
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_faster_one_trains_unless_it_is_wrong() {
        let of = |seconds, colour| (seconds, LossTerms { colour, ..LossTerms::default() });
        assert_eq!(judge(of(1.0, 0.500), of(2.0, 0.501)), Judgement::Gpu);
        assert_eq!(judge(of(3.0, 0.500), of(2.0, 0.501)), Judgement::Cpu);
        assert_eq!(judge(of(1.0, 0.520), of(2.0, 0.500)), Judgement::Wrong);
        assert_eq!(judge(of(1.0, f32::NAN), of(2.0, 0.500)), Judgement::Wrong);
    }
}
