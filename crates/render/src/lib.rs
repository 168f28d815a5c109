//! The rendering passes on the GPU, from `shaders/*.wgsl`. Each has a Rust twin in `surgtpgs-core` that
//! is its specification. In the order in which data flows:
//!
//! ```text
//! scene ─▶ scene_buffers ─▶ deform (time t) ─▶ project (camera) ─▶ bin: sort by depth, emit, sort by tile
//!                                                                   │
//!            overlay ◀── relevancy (prompts) ◀── image planes ◀── raster
//! ```
//!
//! [`Gpu`] opens a graphics adapter or says why it cannot. [`GpuRenderer`] is the whole chain behind
//! [`surgtpgs_core::raster::Renderer`]. [`passes::Passes`] runs the passes one by one. [`GpuBackend`]
//! carries out training steps. Only core WGSL is used: no subgroups, no float atomics. Integer sums and
//! stable sorts make two runs give the same bytes.

mod buffers;
mod device;
mod kernel;
pub mod layout;
pub mod passes;
mod relevancy;
mod renderer;
mod scene_buffers;
pub mod shader_source;
mod shown;
mod timer;
mod train;

pub use device::{AdapterChoice, Gpu, Loss, Unavailable};
pub use relevancy::GpuExact;
pub use renderer::{Frame, GpuRenderer};
pub use shown::{Asked, Mark, Marking, Shown, Wanted};
pub use train::{GpuBackend, StepTrace};
