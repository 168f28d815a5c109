//! The machine that renders: a GPU, or the CPU with the same pictures.

use std::path::Path;
use surgtpgs_core::{
    Result,
    camera::Camera,
    raster::{CpuRenderer, FrameClock, Images, Renderer},
    scene::Scene,
};
use surgtpgs_render::{AdapterChoice, Gpu, GpuRenderer, Loss};

/// Choice of the device that renders or trains.
#[derive(
    Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum, serde::Serialize, serde::Deserialize,
)]
#[serde(rename_all = "snake_case")]
pub enum BackendChoice {
    /// The GPU if there is a real one and it is worth it, otherwise the CPU
    #[default]
    Auto,
    /// The CPU
    Cpu,
    /// Any graphics adapter, a software one included
    Gpu,
}

/// The machine that renders.
pub(crate) enum Machine {
    Cpu(Box<CpuRenderer>),
    Gpu(Box<GpuRenderer>),
}

impl Machine {
    /// Opens the machine of choice.
    pub(crate) fn open(backend: BackendChoice) -> Result<Self> {
        let cpu = || Self::Cpu(Box::default());
        let gpu = |adapters| Ok(Self::Gpu(Box::new(GpuRenderer::new(Gpu::open(adapters)?)?)));
        match backend {
            BackendChoice::Cpu => Ok(cpu()),
            BackendChoice::Gpu => gpu(AdapterChoice::Any),
            // If no GPU works, the CPU makes the same pictures.
            BackendChoice::Auto => {
                let found: Option<Result<Self>> = may_have_gpu().then(|| gpu(AdapterChoice::RealGpu));
                Ok(found.and_then(Result::ok).unwrap_or_else(cpu))
            }
        }
    }

    pub(super) fn is_gpu(&self) -> bool {
        matches!(self, Self::Gpu(_))
    }

    /// Returns the loss of the graphics device, if there was one: then another machine is needed.
    pub(super) fn loss(&self) -> Option<Loss> {
        match self {
            Self::Cpu(_) => None,
            Self::Gpu(gpu) => gpu.gpu().loss(),
        }
    }

    fn renderer(&self) -> &dyn Renderer {
        match self {
            Self::Cpu(cpu) => &**cpu,
            Self::Gpu(gpu) => &**gpu,
        }
    }
}

impl Renderer for Machine {
    fn name(&self) -> String {
        self.renderer().name()
    }

    fn render_into(
        &mut self,
        scene: &Scene,
        camera: &Camera,
        time: f32,
        features: bool,
        images: &mut Images,
        clock: &mut FrameClock,
    ) -> Result<()> {
        match self {
            Self::Cpu(cpu) => cpu.render_into(scene, camera, time, features, images, clock),
            Self::Gpu(gpu) => gpu.render_into(scene, camera, time, features, images, clock),
        }
    }
}

/// Returns `true` if it is worth loading the graphics drivers, which takes time and may print warnings of its
/// own. Linux shows every real GPU as one of these devices.
pub(crate) fn may_have_gpu() -> bool {
    let devices = ["/dev/dri", "/dev/nvidiactl", "/dev/dxg"];
    !cfg!(target_os = "linux") || devices.iter().any(|d| Path::new(d).exists())
}
