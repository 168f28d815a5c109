//! The program: one binary, verbs on the command line and a viewer, over one engine.

pub mod engine;
pub mod viewer;
