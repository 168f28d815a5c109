//! `surgtpgs bench` and what it measures.

use super::{MaskDensity, RelevancyArgs, SceneArgs};
use crate::engine::Backend;
use clap::{Args, Subcommand};
use std::path::PathBuf;

/// `surgtpgs bench`
#[derive(Clone, Debug, Args)]
pub struct BenchArgs {
    /// Measurement to make
    #[command(subcommand)]
    pub verb: BenchVerb,
    /// Replace an earlier benchmark in the folder, once the new one is whole
    #[arg(long, global = true)]
    pub force: bool,
}

/// Measurement of `surgtpgs bench`.
#[derive(Clone, Debug, Subcommand)]
pub enum BenchVerb {
    /// Train once for every setting: train.csv, train_psnr.svg, train_miou.svg
    Train(BenchTrainArgs),
    /// Time every pass of a training step on the demo, with its error against f64
    Step(BenchStepArgs),
    /// Time every pass of a shown frame and every way to score it, with its error: frame.csv, frame.svg
    Frame(BenchFrameArgs),
    /// Render scenes that break renderers, and compare with f64: stress.csv
    Stress(BenchStressArgs),
    /// Compare automatic masks with label masks, for every density: masks.csv, and pictures of them
    Masks(BenchMasksArgs),
    /// Compress text embeddings and count which classes and prompts survive it: codec.csv
    Codec(BenchCodecArgs),
}

impl BenchVerb {
    /// The folder to write, if there is one.
    pub fn output_mut(&mut self) -> Option<&mut PathBuf> {
        match self {
            Self::Train(args) => Some(&mut args.output),
            Self::Step(args) => args.output.as_mut(),
            Self::Frame(args) => args.output.as_mut(),
            Self::Stress(args) => args.output.as_mut(),
            Self::Masks(args) => args.output.as_mut(),
            Self::Codec(args) => args.output.as_mut(),
        }
    }
}

/// `surgtpgs bench codec`
#[derive(Clone, Debug, Args)]
pub struct BenchCodecArgs {
    /// A folder with one table of text embeddings, NAME.npy [texts, dim]
    #[arg(long, value_name = "DIR")]
    pub embeddings: PathBuf,
    /// Numbers of classes that a scene has
    #[arg(long, value_delimiter = ',', default_value = "7,13,50", value_parser = clap::value_parser!(u32).range(1..=10_000))]
    pub classes: Vec<u32>,
    /// Latent numbers per pixel
    #[arg(long, value_delimiter = ',', default_value = "3,4,8,16", value_parser = clap::value_parser!(u32).range(1..=16))]
    pub latent: Vec<u32>,
    /// Number of draws of classes from the table; results are means
    #[arg(long, default_value_t = 3, value_parser = clap::value_parser!(u32).range(1..))]
    pub draws: u32,
    /// Folder for codec.csv
    #[arg(short, long, value_name = "DIR")]
    pub output: Option<PathBuf>,
    /// Report as JSON
    #[arg(long)]
    pub json: bool,
}

/// `surgtpgs bench masks`
#[derive(Clone, Debug, Args)]
pub struct BenchMasksArgs {
    /// A recording with label masks
    pub sequence: PathBuf,
    /// A folder with encoder and decoder of a Segment Anything (.onnx, .ort)
    #[arg(long, value_name = "DIR")]
    pub masks_model: PathBuf,
    /// Frames to measure, evenly spread
    #[arg(long, default_value_t = 8, value_parser = clap::value_parser!(u32).range(1..))]
    pub frames: u32,
    /// Density of the points at which masks are asked for
    #[arg(long, value_enum, value_delimiter = ',', default_value = "coarse,medium,fine")]
    pub density: Vec<MaskDensity>,
    /// Folder for masks.csv and pictures
    #[arg(short, long, value_name = "DIR")]
    pub output: Option<PathBuf>,
    /// Report as JSON
    #[arg(long)]
    pub json: bool,
}

/// `surgtpgs bench stress`
#[derive(Clone, Debug, Args)]
pub struct BenchStressArgs {
    /// Device to render on
    #[arg(long, value_enum, default_value_t = Backend::Auto)]
    pub backend: Backend,
    /// Folder for stress.csv
    #[arg(short, long, value_name = "DIR")]
    pub output: Option<PathBuf>,
    /// Report as JSON
    #[arg(long)]
    pub json: bool,
}

/// `surgtpgs bench frame`
#[derive(Clone, Debug, Args)]
pub struct BenchFrameArgs {
    /// The scene
    #[command(flatten)]
    pub scene: SceneArgs,
    /// Folder to write
    #[arg(short, long, value_name = "DIR")]
    pub output: Option<PathBuf>,
    /// Frames to measure, evenly spread
    #[arg(long, default_value_t = 8, value_parser = clap::value_parser!(u32).range(1..))]
    pub frames: u32,
    /// Image size, if not that of the recording
    #[arg(long, value_name = "WIDTHxHEIGHT", value_parser = image_size)]
    pub size: Option<(u32, u32)>,
    /// Words to look for, if not the scene's classes; may be repeated
    #[arg(long, value_name = "TEXT")]
    pub prompt: Vec<String>,
    /// Options for answering prompts
    #[command(flatten)]
    pub relevancy: RelevancyArgs,
    /// Report as JSON
    #[arg(long)]
    pub json: bool,
}

/// Parses a size such as `640x512`.
fn image_size(text: &str) -> Result<(u32, u32), String> {
    let number = |part: &str| part.trim().parse().ok().filter(|n| (1..=8192).contains(n));
    let sides = text.split_once(['x', '×']).map(|(w, h)| (number(w), number(h)));
    match sides {
        Some((Some(width), Some(height))) => Ok((width, height)),
        _ => Err("give width and height in pixels, such as 640x512".to_owned()),
    }
}

/// `surgtpgs bench step`
#[derive(Clone, Debug, Args)]
pub struct BenchStepArgs {
    /// Folder for step.csv
    #[arg(short, long, value_name = "DIR")]
    pub output: Option<PathBuf>,
    /// Steps to average over
    #[arg(long, default_value_t = 40, value_parser = clap::value_parser!(u32).range(1..))]
    pub steps: u32,
    /// Device to train on
    #[arg(long, value_enum, default_value_t = Backend::Cpu)]
    pub backend: Backend,
    /// Report as JSON
    #[arg(long)]
    pub json: bool,
}

/// `surgtpgs bench train`
#[derive(Clone, Debug, Args)]
pub struct BenchTrainArgs {
    /// A folder prepared with --eval, or a recording (then without features)
    pub sequence: PathBuf,
    /// Folder to write
    #[arg(short, long, value_name = "DIR")]
    pub output: PathBuf,
    /// Optimiser steps of every row
    #[arg(long, default_value_t = 3000, value_parser = clap::value_parser!(u32).range(1..))]
    pub iterations: u32,
    /// Seed of everything random
    #[arg(long, default_value_t = 0)]
    pub seed: u64,
    /// Device to train on
    #[arg(long, value_enum, default_value_t = Backend::Cpu)]
    pub backend: Backend,
    /// Only these rows, e.g. default,paper
    #[arg(long, value_delimiter = ',')]
    pub rows: Vec<String>,
    /// Report as JSON, too
    #[arg(long)]
    pub json: bool,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn image_sizes_are_two_numbers() {
        assert_eq!(image_size("640x512"), Ok((640, 512)));
        for wrong in ["640", "x512", "0x5", "640x9999", "axb", "-1x4"] {
            assert!(image_size(wrong).is_err(), "{wrong}");
        }
    }
}
