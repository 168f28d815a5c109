//! The command line of `prepare`.

use clap::{ArgGroup, Args, ValueEnum, ValueHint};
use std::path::PathBuf;
use surgtpgs_core::segment::{Level, MaskSettings};

/// `surgtpgs prepare`
#[derive(Debug, Args)]
#[command(group(ArgGroup::new("source").required(true).args(["labels", "masks_model", "dense_encoder", "features"])))]
pub struct PrepareArgs {
    /// A recording (folder or video file)
    pub sequence: PathBuf,
    /// Folder to write
    #[arg(short, long, value_name = "PREP")]
    pub output: PathBuf,
    /// Take features from the recording's label masks: each pixel gets the embedding of its class name
    #[arg(long)]
    pub labels: bool,
    /// Take features from automatic masks: a folder with encoder and decoder of a Segment Anything
    /// (.onnx, .ort)
    #[arg(long, value_name = "DIR", requires = "image_encoder")]
    pub masks_model: Option<PathBuf>,
    /// A folder with model.onnx that embeds what masks show: the other half of the text encoder
    #[arg(long, value_name = "DIR", requires = "masks_model")]
    pub image_encoder: Option<PathBuf>,
    /// Take features from maps of whole pictures: a folder with model.onnx, images [1,3,n,n] in, maps
    /// [1,dim,rows,columns] out
    #[arg(long, value_name = "DIR")]
    pub dense_encoder: Option<PathBuf>,
    /// A network that estimates depth from single pictures, for a recording without depth: its .onnx
    /// file, or its folder
    #[arg(long, value_name = "DIR|FILE")]
    pub depth_model: Option<PathBuf>,
    /// Take features that another program made: a folder with LangSplat's NAME_f.npy and NAME_s.npy, or with
    /// dense maps NAME_agg.npy, for each frame
    #[arg(long, value_name = "DIR")]
    pub features: Option<PathBuf>,
    /// Also write the features as LangSplat's and the paper's scripts read them
    #[arg(long, value_name = "DIR")]
    pub langsplat: Option<PathBuf>,
    /// Density of the points at which masks are asked for
    #[arg(long, value_enum, default_value_t = MaskDensity::Medium)]
    pub mask_density: MaskDensity,
    /// Masks that become regions
    #[arg(long, value_enum, default_value_t = LevelArg::Default)]
    pub mask_level: LevelArg,
    /// `builtin`, or a folder with model.onnx and tokenizer.json
    #[arg(long, value_name = "DIR|builtin", value_hint = ValueHint::DirPath, default_value = "builtin")]
    pub text_encoder: String,
    /// Hold every eighth frame out of everything, for evaluation
    #[arg(long)]
    pub eval: bool,
    /// Latent numbers per pixel
    #[arg(long, default_value_t = 3, value_parser = clap::value_parser!(u32).range(1..=16))]
    pub latent_dim: u32,
    /// Seed of the codec's weights and batches
    #[arg(long, default_value_t = 0)]
    pub seed: u64,
    /// Replace an earlier prepared folder; its masks are used again where nothing they depend on has changed
    #[arg(long)]
    pub force: bool,
}

/// Density of the points at which masks are asked for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum MaskDensity {
    /// 8×8 points, and groups of points that look alike
    Coarse,
    /// 16×16 points, and the same groups
    Medium,
    /// 32×32 points, and the same groups
    Fine,
    /// 32×32 points on the picture and on each of four crops, as the paper's authors: many minutes a
    /// frame on a CPU
    Paper,
}

impl From<MaskDensity> for MaskSettings {
    fn from(density: MaskDensity) -> Self {
        match density {
            MaskDensity::Coarse => Self::of_grid(8),
            MaskDensity::Medium => Self::of_grid(16),
            MaskDensity::Fine => Self::of_grid(32),
            MaskDensity::Paper => Self::paper(),
        }
    }
}

/// Choice among the masks of a point.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum LevelArg {
    /// All of them
    Default,
    /// Parts
    S,
    /// Larger parts
    M,
    /// Wholes
    L,
}

impl From<LevelArg> for Level {
    fn from(level: LevelArg) -> Self {
        match level {
            LevelArg::Default => Self::Default,
            LevelArg::S => Self::Small,
            LevelArg::M => Self::Medium,
            LevelArg::L => Self::Large,
        }
    }
}

#[cfg(test)]
mod tests {
    use crate::args::Cli;
    use clap::Parser;

    #[test]
    fn features_come_from_labels_or_from_masks_with_an_image_encoder() {
        let parses = |args: &str| {
            let line = format!("surgtpgs prepare rec -o prep {args}");
            Cli::try_parse_from(line.split_whitespace()).is_ok()
        };
        assert!(parses("--labels") && parses("--masks-model sam --image-encoder clip --mask-level l"));
        assert!(!parses("") && !parses("--masks-model sam") && !parses("--image-encoder clip"));
        assert!(!parses("--labels --masks-model sam --image-encoder clip"));
        assert!(
            parses("--dense-encoder net --depth-model depth.onnx") && !parses("--depth-model depth.onnx")
        );
        assert!(
            parses("--features dir --mask-level s --langsplat out") && !parses("--labels --features dir")
        );
    }
}
