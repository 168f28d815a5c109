#![doc = include_str!("../README.md")]

pub mod clock;
pub mod error;
pub mod files;
pub mod grid;
pub mod hash;
mod lanes;
pub mod num;
pub mod progress;
pub mod reading;
pub mod real;

pub mod camera;
pub mod sequence;

pub mod demo;

pub mod codec;
pub mod prepare;
pub mod segment;

pub mod deform;
pub mod gaussian;
pub mod raster;

pub mod scene;
pub mod stress;

pub mod train;
pub mod unseen;

pub mod mask;
pub mod metrics;
pub mod object;
pub mod overlay;
pub mod relevancy;
pub mod summary;

pub mod export;

pub use error::{Error, Result};
