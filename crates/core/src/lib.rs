#![doc = include_str!("../README.md")]

pub mod about;
pub mod clock;
pub mod error;
pub mod files;
pub mod grid;
pub mod hash;
mod lanes;
mod linear;
pub mod num;
pub mod progress;
mod raster_limits;
pub mod reading;
pub mod real;

pub mod camera;
pub mod flow;
pub mod gaussian;

pub mod deform;

pub mod mask;

pub mod annotations;

mod dicom;
pub mod sequence;

pub mod demo;
pub mod poses;

pub mod codec;
pub mod meaning;
pub mod segment;

pub mod prepare;

pub mod scene;

pub mod raster;
pub mod stress;

pub mod object;
pub mod overlay;
pub mod palette;
pub mod relevancy;
pub mod strokes;
pub mod summary;
pub mod unseen;

pub mod export;
pub mod metrics;

pub mod marks;

pub mod train;

pub use error::{Error, Kept, Remedy, Result};
