#![doc = include_str!("../README.md")]

mod buffers;
mod device;
mod kernel;
mod planes;
mod renderer;
mod rows;
mod scene_buffers;
pub mod shader;
mod shown;
mod timer;
mod traffic;
mod train;

pub use device::{AdapterChoice, AdapterFacts, Gpu, Loss, Unavailable};
pub use planes::{PlanePasses, RenderInput};
pub use renderer::GpuRenderer;
pub use shown::{Asked, Shown, Wanted};
pub use timer::PassCost;
pub use traffic::Traffic;
pub use train::{GpuBackend, StepTrace};

/// Every shader with its declaration.
pub fn shaders() -> impl Iterator<Item = &'static shader::Shader> {
    let others = [planes::SHADERS, shown::SHADERS].into_iter().flatten();
    others.chain(train::shaders()).chain([&traffic::Wgsl::SHADER])
}
