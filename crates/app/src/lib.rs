#![doc = include_str!("../README.md")]

pub mod cli;
pub mod engine;
mod evaluation;
pub mod jobs;
mod memory;
mod outputs;
mod pictures;
pub mod settings;
mod tables;
mod text;
pub mod viewer;

/// The system's allocator, which counts the memory in use, so that a test sees what grows with time
/// (`viewer::tests::monkey`).
#[cfg(test)]
#[global_allocator]
static ALLOCATOR: cap::Cap<std::alloc::System> = cap::Cap::new(std::alloc::System, usize::MAX);
