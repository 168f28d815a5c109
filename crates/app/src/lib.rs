//! The program: one binary with verbs on the command line and a viewer, over one engine.
//!
//! ```text
//! args ─▶ cli/<verb> ─▶ jobs (prepare, train, demo)  and  engine (render, ask), evaluation ─▶ standard output, files
//!      └▶ viewer ─────▶ the same jobs and engine ─▶ window
//! ```

pub mod args;
pub mod cli;
pub mod engine;
mod evaluation;
pub mod jobs;
mod memory;
mod pictures;
pub mod settings;
mod tables;
pub mod viewer;

/// A window open for hours starts many short-lived threads; the C library's allocator keeps what each of them left behind.
#[cfg(not(test))]
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;
/// The same, counting what is in use.
#[cfg(test)]
#[global_allocator]
static ALLOCATOR: cap::Cap<mimalloc::MiMalloc> = cap::Cap::new(mimalloc::MiMalloc, usize::MAX);
