//! The command line: verbs in the order of the data flow.

mod batch;
mod bench;
mod convert;
mod eval;
mod export;
mod prepare;

pub use batch::{BatchArgs, Step};
pub use bench::{
    BenchArgs, BenchCodecArgs, BenchFrameArgs, BenchMasksArgs, BenchStepArgs, BenchStressArgs,
    BenchTrainArgs, BenchVerb,
};
pub use convert::{ConvertArgs, StillFormat};
pub use eval::EvalArgs;
pub use export::{CleanUpArgs, ExportArgs, SourceArg};
pub use prepare::{LevelArg, MaskDensity, PrepareArgs};

use crate::engine::{Backend, EncoderChoice, EngineOptions, Negatives, Question};
use clap::{Args, Parser, Subcommand, ValueEnum, ValueHint};
use std::path::{Path, PathBuf};
use surgtpgs_clip::Provider;
use surgtpgs_core::{
    relevancy::RelevancySettings,
    train::{FeatureMode, Profile, TrainSettings},
};

/// Version of the program and, in a release build, the commit it was built from.
pub const VERSION: &str = concat!(env!("CARGO_PKG_VERSION"), " (", env!("SURGTPGS_COMMIT"), ")");

/// See a deforming reconstruction of a recorded endoscopic clip, ask it for structures by name,
/// export masked frames.
///
/// Without a verb: the viewer on the built-in demo; with no display, the same job into `surgtpgs-demo/`.
/// Research use only. Not for diagnostic or intra-operative use.
#[derive(Debug, Parser)]
#[command(name = "surgtpgs", version = VERSION, about, max_term_width = 110, disable_help_subcommand = true)]
#[command(after_help = "Exit codes: 0 done, 1 the input is wrong, 2 usage, 3 the machine lacks something.")]
pub struct Cli {
    /// Verb to run
    #[command(subcommand)]
    pub verb: Option<Verb>,
    /// Device that ONNX Runtime runs the models on; an accelerator needs a library that was built for it
    #[arg(long, value_enum, global = true, default_value_t = ProviderArg::Cpu)]
    pub execution_provider: ProviderArg,
}

/// Device that ONNX Runtime runs the models on.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum ProviderArg {
    /// The processor
    Cpu,
    /// NVIDIA's GPUs
    Cuda,
    /// GPUs on Windows
    Directml,
    /// Apple's accelerators
    Coreml,
}

impl From<ProviderArg> for Provider {
    fn from(arg: ProviderArg) -> Self {
        match arg {
            ProviderArg::Cpu => Self::Cpu,
            ProviderArg::Cuda => Self::Cuda,
            ProviderArg::Directml => Self::DirectMl,
            ProviderArg::Coreml => Self::CoreMl,
        }
    }
}

/// Verb of the program, with its options.
#[derive(Debug, Subcommand)]
pub enum Verb {
    /// Open the viewer on a scene, a recording or a prepared folder
    View(ViewArgs),
    /// Write the built-in synthetic recording with all its ground truth
    Demo(DemoArgs),
    /// Report what a recording holds and what would make training go wrong
    Check(CheckArgs),
    /// Write features and codec into a folder beside the recording, which is never modified
    Prepare(PrepareArgs),
    /// Reconstruct a scene from a prepared folder, or from a bare recording (then without features)
    Train(TrainArgs),
    /// Render colour, depth, opacity and feature images of a scene
    Render(RenderArgs),
    /// Say on which frames a scene shows the structures that the prompts name
    Query(QueryVerbArgs),
    /// Write masked frames with a record of how they were made
    Export(ExportArgs),
    /// Compare a scene, or another program's masks, with the recording: PSNR, SSIM, depth, IoU, Dice, times
    Eval(EvalArgs),
    /// Prepare, train, evaluate and export many recordings, with a report; a rerun does only what changed
    Batch(BatchArgs),
    /// Measure run time beside quality for every setting; writes CSV and SVG
    Bench(BenchArgs),
    /// Turn scenes into files of other programs, and back
    Convert(ConvertArgs),
}

impl Verb {
    /// Returns the output of the verb, if it is one file or folder that the command line names.
    pub fn output(&self) -> Option<&Path> {
        match self {
            Self::Demo(args) => Some(&args.output),
            Self::Prepare(args) => Some(&args.output),
            Self::Train(args) => Some(&args.output),
            Self::Render(args) => Some(&args.output),
            Self::Query(args) => args.gaussians.as_deref(),
            Self::Export(args) => Some(&args.output),
            Self::Eval(args) => args.output.as_deref(),
            Self::Batch(args) => args.output.as_deref(),
            Self::Convert(args) => Some(&args.output),
            Self::View(_) | Self::Check(_) | Self::Bench(_) => None,
        }
    }
}

/// `surgtpgs view`
#[derive(Debug, Args)]
pub struct ViewArgs {
    /// A scene file, a .ply of Gaussian splats, a recording or a prepared folder
    pub path: PathBuf,
}

/// `surgtpgs demo`
#[derive(Debug, Args)]
pub struct DemoArgs {
    /// Folder to write
    #[arg(short, long, value_name = "DIR")]
    pub output: PathBuf,
    /// Image columns
    #[arg(long, default_value_t = 320, value_parser = clap::value_parser!(u32).range(16..=4096))]
    pub width: u32,
    /// Image rows
    #[arg(long, default_value_t = 240, value_parser = clap::value_parser!(u32).range(16..=4096))]
    pub height: u32,
    /// Number of frames
    #[arg(long, default_value_t = 48, value_parser = clap::value_parser!(u32).range(1..=10_000))]
    pub frames: u32,
    /// Let the endoscope move
    #[arg(long)]
    pub moving_camera: bool,
    /// Seed of textures and noise
    #[arg(long, default_value_t = 7)]
    pub seed: u64,
    /// Replace an earlier result of this kind, once the new one is whole
    #[arg(long)]
    pub force: bool,
}

/// `surgtpgs check`
#[derive(Debug, Args)]
pub struct CheckArgs {
    /// A recording (folder or video file) or a prepared folder
    pub sequence: PathBuf,
    /// Report as JSON
    #[arg(long)]
    pub json: bool,
}

/// `surgtpgs train`
#[derive(Debug, Args)]
pub struct TrainArgs {
    /// A prepared folder, or a recording (then without features)
    pub sequence: PathBuf,
    /// Scene file to write, e.g. scene.safetensors
    #[arg(short, long, value_name = "SCENE")]
    pub output: PathBuf,
    /// Hold every eighth frame out (a folder prepared with --eval does so anyway)
    #[arg(long)]
    pub eval: bool,
    /// Optimiser steps
    #[arg(long, default_value_t = 3000, value_parser = clap::value_parser!(u32).range(1..))]
    pub iterations: u32,
    /// Seed of everything random
    #[arg(long, default_value_t = 0)]
    pub seed: u64,
    /// Device to train on
    #[arg(long, value_enum, default_value_t = Backend::Auto)]
    pub backend: Backend,
    /// Settings to start from: our own, or those that the paper's authors released, for comparison
    #[arg(long, value_enum, default_value_t = TrainProfile::Default)]
    pub profile: TrainProfile,
    /// Compute features in closed form after training, not by learning: faster, but constant over time
    #[arg(long)]
    pub fast_features: bool,
    /// Go on with the unfinished training beside the scene file
    #[arg(long, conflicts_with_all = ["eval", "iterations", "seed", "profile", "fast_features", "force"])]
    pub resume: bool,
    /// Replace an earlier scene once the new one is whole, and begin an unfinished training anew
    #[arg(long)]
    pub force: bool,
    /// Report as JSON
    #[arg(long)]
    pub json: bool,
}

impl TrainArgs {
    /// Settings of a training from the beginning.
    pub fn settings(&self) -> TrainSettings {
        let mut settings = TrainSettings::of(match self.profile {
            TrainProfile::Default => Profile::Default,
            TrainProfile::Paper => Profile::Paper,
        });
        settings.iterations = self.iterations as usize;
        settings.seed = self.seed;
        settings.eval = self.eval;
        if self.fast_features {
            settings.feature_mode = FeatureMode::Lifted;
            settings.feature_motion = false;
        }
        settings
    }
}

/// Settings that training starts from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum TrainProfile {
    /// The paper's formulas, changed where another way measured better
    Default,
    /// The released code with its quirks
    Paper,
}

/// Options that open a scene; shared by the verbs that render.
#[derive(Clone, Debug, Args)]
pub struct SceneArgs {
    /// Scene file
    pub scene: PathBuf,
    /// Device to render on
    #[arg(long, value_enum, default_value_t = Backend::Auto)]
    pub backend: Backend,
}

/// Options that decide how prompts are answered; shared by the verbs that take or make prompts.
#[derive(Clone, Debug, Args)]
pub struct RelevancyArgs {
    /// `builtin`, or the text encoder's folder; needed only if it is not where it was when preparing
    #[arg(long, value_name = "DIR|builtin", value_hint = ValueHint::DirPath)]
    pub text_encoder: Option<String>,
    /// Score above which a pixel is found
    #[arg(long, default_value_t = RelevancySettings::default().threshold, value_parser = unit_number)]
    pub threshold: f32,
    /// Sharpness of scores
    #[arg(long, default_value_t = RelevancySettings::default().temperature, value_parser = positive_number)]
    pub temperature: f32,
    /// Compare prompts with these words as well; may be given several times
    #[arg(long, value_name = "TEXT", num_args = 1.., value_parser = words)]
    pub negative: Vec<String>,
    /// Leave out the canonical phrases (object, things, stuff, texture) that prompts are compared with
    #[arg(long)]
    pub no_canonical: bool,
    /// Leave out the scene's other classes, as the paper does
    #[arg(long)]
    pub no_class_negatives: bool,
}

impl RelevancyArgs {
    /// The settings of queries.
    pub fn settings(&self) -> RelevancySettings {
        let standard = RelevancySettings::default();
        let phrases = if self.no_canonical { Vec::new() } else { standard.phrases };
        let uses_classes = !self.no_class_negatives;
        let negatives = Negatives { phrases, samples: Vec::new(), uses_classes }.with(&self.negative);
        RelevancySettings {
            threshold: self.threshold,
            temperature: self.temperature,
            phrases: negatives.phrases,
            class_negatives: negatives.uses_classes,
            min_alpha: standard.min_alpha,
        }
    }

    /// Returns the options to open the engine of `scene` with.
    pub fn engine_options(&self, scene: &SceneArgs, sequence: Option<PathBuf>) -> EngineOptions {
        let encoder = self.text_encoder.as_deref().map_or(EncoderChoice::OfScene, encoder_choice);
        EngineOptions { backend: scene.backend, encoder, sequence, relevancy: self.settings() }
    }
}

/// Prompts to look for; shared by the verbs that take prompts.
#[derive(Debug, Args)]
pub struct PromptArgs {
    /// Words to look for; may be given several times
    #[arg(long, visible_alias = "prompts", value_name = "TEXT", required = true, num_args = 1..)]
    pub prompt: Vec<String>,
    /// Words that one prompt is not, such as "liver=fat, bile": it alone is compared with these words as well
    #[arg(long, value_name = "PROMPT=TEXT,…", value_parser = but_not)]
    pub but_not: Vec<(String, Vec<String>)>,
}

impl PromptArgs {
    /// Returns the prompts, each compared with the negatives of `settings` and with the words that it is not.
    pub fn questions(&self, settings: &RelevancySettings) -> surgtpgs_core::Result<Vec<Question>> {
        let is_asked = |name: &String| self.prompt.iter().any(|p| p.eq_ignore_ascii_case(name));
        if let Some((name, _)) = self.but_not.iter().find(|(name, _)| !is_asked(name)) {
            return Err(surgtpgs_core::Error::input(
                format!("--but-not is about \"{name}\", which is no prompt"),
                "Write one of the prompts before the equals sign.",
            ));
        }
        let question = |text: &String| {
            let own = self.but_not.iter().filter(|(name, _)| name.eq_ignore_ascii_case(text));
            let negatives = Negatives::of(settings).with(own.flat_map(|(_, words)| words));
            Question::words(text, negatives)
        };
        Ok(self.prompt.iter().map(question).collect())
    }
}

/// Reads `builtin` or the path of a folder.
pub fn encoder_choice(arg: &str) -> EncoderChoice {
    if arg == "builtin" { EncoderChoice::Builtin } else { EncoderChoice::Folder(arg.into()) }
}

/// `surgtpgs render`
#[derive(Debug, Args)]
pub struct RenderArgs {
    /// The scene
    #[command(flatten)]
    pub scene: SceneArgs,
    /// Folder to write
    #[arg(short, long, value_name = "DIR")]
    pub output: PathBuf,
    /// Frames, e.g. 12 or 10..20 (the end is not included)
    #[arg(long, value_name = "A..B", value_parser = frame_range)]
    pub frames: Option<FrameRange>,
    /// Images to write
    #[arg(long, value_enum, value_delimiter = ',', default_value = "colour")]
    pub kind: Vec<ImageKind>,
    /// Image columns, if not those of the recording (rows follow)
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..=8192))]
    pub width: Option<u32>,
    /// Replace an earlier result of this kind, once the new one is whole
    #[arg(long)]
    pub force: bool,
}

/// Images that `render` writes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, ValueEnum)]
pub enum ImageKind {
    /// 8-bit RGB PNG
    Colour,
    /// Depth in scene units, 0 in holes: .npy (f32, rows × columns) and a 16-bit PNG to look at
    Depth,
    /// Accumulated opacity: 8-bit grey PNG
    Alpha,
    /// Latent features: .npy (f32, rows × columns × latent numbers)
    Feature,
}

/// `surgtpgs query`
#[derive(Debug, Args)]
pub struct QueryVerbArgs {
    /// The scene
    #[command(flatten)]
    pub scene: SceneArgs,
    /// Prompts to look for
    #[command(flatten)]
    pub prompts: PromptArgs,
    /// Frames, e.g. 12 or 10..20 (the end is not included)
    #[arg(long, value_name = "A..B", value_parser = frame_range)]
    pub frames: Option<FrameRange>,
    /// Also write the Gaussians that each prompt finds on the frame where it covers most, as a .ply for splat
    /// viewers, and their place, size and motion over time, as objects.csv and objects.json
    #[arg(long, value_name = "DIR")]
    pub gaussians: Option<PathBuf>,
    /// Replace an earlier result in that folder, once the new one is whole
    #[arg(long, requires = "gaussians")]
    pub force: bool,
    /// Options for answering prompts
    #[command(flatten)]
    pub relevancy: RelevancyArgs,
    /// Report as JSON
    #[arg(long, conflicts_with = "csv")]
    pub json: bool,
    /// Report as CSV, a line per prompt and frame
    #[arg(long)]
    pub csv: bool,
}

/// Frames from `start` up to, not including, `end`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FrameRange {
    start: usize,
    end: usize,
}

impl FrameRange {
    /// The frames of the range in a recording of `num_frames`; all of them for `None`.
    pub fn frames(range: Option<Self>, num_frames: usize) -> surgtpgs_core::Result<Vec<usize>> {
        let Self { start, end } = range.unwrap_or(Self { start: 0, end: num_frames });
        let end = end.min(num_frames);
        if start >= end {
            return Err(surgtpgs_core::Error::input(
                format!("no frame is in the range; the scene has {num_frames}, counted from 0"),
                "Give a range such as 0..10.",
            ));
        }
        Ok((start..end).collect())
    }
}

fn frame_range(text: &str) -> Result<FrameRange, String> {
    let number = |t: &str, empty: usize| {
        if t.is_empty() { Ok(empty) } else { t.parse().map_err(|_| format!("\"{t}\" is not a frame number")) }
    };
    match text.split_once("..") {
        Some((start, end)) => Ok(FrameRange { start: number(start, 0)?, end: number(end, usize::MAX)? }),
        None => {
            let start: usize =
                text.parse().map_err(|_| "give a frame such as 12, or a range such as 10..20")?;
            Ok(FrameRange { start, end: start.saturating_add(1) })
        }
    }
}

/// Splits a text at commas, without words that are empty.
pub fn split_words(text: &str) -> Vec<String> {
    text.split(',').map(str::trim).filter(|w| !w.is_empty()).map(str::to_owned).collect()
}

fn but_not(text: &str) -> Result<(String, Vec<String>), String> {
    let parts = text.split_once('=').map(|(prompt, more)| (prompt.trim().to_owned(), split_words(more)));
    let is_whole = |(prompt, more): &(String, Vec<String>)| !prompt.is_empty() && !more.is_empty();
    parts
        .filter(is_whole)
        .ok_or_else(|| "give a prompt and what it is not, such as \"liver=fat, bile\"".into())
}

fn words(text: &str) -> Result<String, String> {
    let text = text.trim();
    if text.is_empty() { Err("give a few words".into()) } else { Ok(text.to_owned()) }
}

fn unit_number(text: &str) -> Result<f32, String> {
    text.parse().ok().filter(|v| (0.0..=1.0).contains(v)).ok_or_else(|| "give a number from 0 to 1".into())
}

fn positive_number(text: &str) -> Result<f32, String> {
    text.parse()
        .ok()
        .filter(|v: &f32| v.is_finite() && *v > 0.0)
        .ok_or_else(|| "give a number above 0".into())
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::CommandFactory;
    use surgtpgs_core::{export::Format, overlay::OverlayStyle};

    #[test]
    fn the_command_line_is_consistent() {
        Cli::command().debug_assert();
    }

    #[test]
    fn verbs_are_listed_in_the_order_of_the_data_flow() {
        let verbs: Vec<String> = Cli::command().get_subcommands().map(|c| c.get_name().to_owned()).collect();
        assert_eq!(
            verbs,
            [
                "view", "demo", "check", "prepare", "train", "render", "query", "export", "eval", "batch",
                "bench", "convert"
            ]
        );
    }

    #[test]
    fn frame_ranges_are_half_open_and_clipped() {
        let frames =
            |text| FrameRange::frames(Some(frame_range(text).unwrap()), 5).map_err(|e| e.to_string());
        assert_eq!(frames("1..3").unwrap(), [1, 2]);
        assert_eq!(frames("3..").unwrap(), [3, 4]);
        assert_eq!(frames("4").unwrap(), [4]);
        assert_eq!(frames("..99").unwrap().len(), 5);
        assert!(frames("5..9").unwrap_err().contains("counted from 0"));
        assert!(frame_range("a..b").is_err() && frame_range("").is_err() && frame_range("-1").is_err());
    }

    #[test]
    fn every_format_has_a_name_on_the_command_line() {
        for format in Format::ALL {
            let line =
                ["surgtpgs", "export", "s", "--prompt", "liver", "-o", "out", "--format", format.name()];
            let Some(Verb::Export(args)) = Cli::parse_from(line).verb else { panic!("not an export") };
            assert_eq!(args.format, [format]);
        }
        let wrong = ["surgtpgs", "export", "s", "--prompt", "liver", "-o", "out", "--format", "mpeg"];
        assert!(Cli::try_parse_from(wrong).unwrap_err().to_string().contains("sheet"));
    }

    #[test]
    fn every_style_has_a_name_on_the_command_line() {
        for style in OverlayStyle::ALL {
            let line = ["surgtpgs", "export", "s", "--prompt", "liver", "-o", "out", "--style", style.name()];
            let Some(Verb::Export(args)) = Cli::parse_from(line).verb else { panic!("not an export") };
            assert_eq!(args.style, style);
        }
    }

    #[test]
    fn prompts_may_be_given_together_or_apart() {
        let cli =
            Cli::parse_from(["surgtpgs", "query", "s", "--prompt", "liver", "fat", "--prompt", "bile sac"]);
        let Some(Verb::Query(args)) = cli.verb else { panic!("not a query") };
        assert_eq!(args.prompts.prompt, ["liver", "fat", "bile sac"]);
    }

    #[test]
    fn a_prompt_is_compared_with_what_is_said_once() {
        let line = |more: &[&str]| {
            let words = ["surgtpgs", "query", "s", "--prompt", "liver", "fat"];
            let Some(Verb::Query(args)) = Cli::parse_from(words.iter().chain(more)).verb else {
                panic!("not a query")
            };
            args.prompts.questions(&args.relevancy.settings())
        };
        let phrases = |more: &[&str], k: usize| line(more).unwrap().swap_remove(k).negatives.phrases;
        assert_eq!(phrases(&[], 0), RelevancySettings::default().phrases);
        assert_eq!(phrases(&["--negative", "smoke", "Stuff"], 1)[4..], ["smoke"]);
        assert_eq!(phrases(&["--no-canonical", "--negative", "smoke"], 0), ["smoke"]);
        let exception = ["--but-not", "Liver=bile, smoke", "--negative", "smoke"];
        assert_eq!(phrases(&exception, 0)[4..], ["smoke", "bile"]);
        assert_eq!(phrases(&exception, 1)[4..], ["smoke"]);
        assert!(line(&["--but-not", "spleen=fat"]).unwrap_err().to_string().contains("\"spleen\""));
        for wrong in ["liver", "=fat", "liver= ,"] {
            let words = ["surgtpgs", "query", "s", "--prompt", "liver", "--but-not", wrong];
            assert!(Cli::try_parse_from(words).is_err(), "{wrong}");
        }
    }
}
