//! `surgtpgs convert`

use super::{FrameRange, frame_range, unit_number};
use clap::{Args, ValueEnum};
use std::path::PathBuf;

/// `surgtpgs convert`
#[derive(Debug, Args)]
pub struct ConvertArgs {
    /// A scene, or a .ply: ordinary Gaussian splats, or the released code's deforming ones (its feature
    /// network is taken from a lang_deformation.safetensors beside it)
    #[arg(value_name = "IN")]
    pub input: PathBuf,
    /// NAME.safetensors, NAME.ply or NAME.glb; a name without extension is a folder of
    /// frame0000.ply, frame0001.ply …
    #[arg(value_name = "OUT")]
    pub output: PathBuf,
    /// The frame whose Gaussians are written (default: the first)
    #[arg(long, value_name = "I", conflicts_with_all = ["time", "frames"])]
    pub frame: Option<usize>,
    /// The time whose Gaussians are written, 0 to 1
    #[arg(long, value_name = "T", value_parser = unit_number, conflicts_with = "frames")]
    pub time: Option<f32>,
    /// Frames for a folder, e.g. 12 or 10..20 (the end is not included)
    #[arg(long, value_name = "A..B", value_parser = frame_range)]
    pub frames: Option<FrameRange>,
    /// Files in a folder
    #[arg(long, value_enum, default_value_t = StillFormat::Ply)]
    pub format: StillFormat,
    /// Write the deforming .ply of the released code, with its feature network as
    /// lang_deformation.safetensors beside it
    #[arg(long, conflicts_with_all = ["frame", "time", "frames"])]
    pub reference: bool,
    /// A scene of the same recording: what a .ply does not hold (cameras, codec, classes) is taken from it
    #[arg(long, value_name = "SCENE")]
    pub like: Option<PathBuf>,
    /// Write a scene in few bits, about a sixth of the size
    #[arg(long, conflicts_with_all = ["frame", "time", "frames", "reference"])]
    pub quantize: bool,
    /// Overwrite what is there
    #[arg(long)]
    pub force: bool,
    /// Report as JSON
    #[arg(long)]
    pub json: bool,
}

/// Files of Gaussians that do not move.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum StillFormat {
    /// 3D Gaussian splatting's .ply
    Ply,
    /// Binary glTF with KHR_gaussian_splatting
    Glb,
}

impl StillFormat {
    /// Extension of file names.
    pub fn extension(self) -> &'static str {
        match self {
            Self::Ply => "ply",
            Self::Glb => "glb",
        }
    }
}
