//! Tests of the shaders against their Rust twins, pass by pass, and proofs that these comparisons can fail.
//!
//! They need a graphics adapter; software Vulkan is enough (`apt-get install libvulkan1
//! mesa-vulkan-drivers`). Without one they say so and pass; under `CI=true` they fail.

#![expect(
    clippy::unwrap_used,
    clippy::print_stderr,
    reason = "helpers of tests fail by panicking, and say which adapter they used"
)]

/// Comparers, with the reasons for their tolerances.
mod compare;
/// Adding and removing Gaussians against its twin.
mod densify;
/// Scenes, cameras and the adapter.
mod fixture;
/// Whole frames against stored pictures.
mod golden;
/// Each comparer refuses values just beyond its tolerance.
mod harness_can_fail;
/// Adapters with low limits.
mod limits;
/// The renderer as a whole: twin, growth of buffers, scene changes, bad scenes.
mod renderer;
/// Every .wgsl file compiles; Rust and WGSL agree on every struct.
mod shaders;
/// From Gaussians to picture and scores.
mod shown;
/// Each pass of a training step against its twin.
mod train;
/// Training as a whole on both backends.
mod training;
/// Each pass against its twin.
mod twins;
