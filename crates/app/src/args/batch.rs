//! `surgtpgs batch`

use clap::{Args, ValueEnum};
use std::path::PathBuf;

/// `surgtpgs batch`
#[derive(Debug, Args)]
pub struct BatchArgs {
    /// Recordings and their settings: a TOML file with [defaults] and a [[recording]] for each; its keys are
    /// the options of prepare, train, eval and export, with _ for -
    #[arg(value_name = "JOBS.toml")]
    pub jobs: PathBuf,
    /// Folder to write, instead of the one that the file names (default: beside the file, with its name)
    #[arg(short, long, value_name = "DIR")]
    pub output: Option<PathBuf>,
    /// Only this recording; may be given several times
    #[arg(long, value_name = "NAME")]
    pub only: Vec<String>,
    /// Only these steps
    #[arg(long, value_enum, value_delimiter = ',', value_name = "STEP")]
    pub step: Vec<Step>,
    /// List the steps that would be run, and run nothing
    #[arg(long)]
    pub dry_run: bool,
    /// Run nothing, write the report of the results that are there
    #[arg(long, conflicts_with_all = ["dry_run", "only", "step"])]
    pub report_only: bool,
    /// Report as JSON
    #[arg(long)]
    pub json: bool,
}

/// Step of the work on a recording; the steps follow one another.
#[derive(
    Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, ValueEnum, serde::Serialize, serde::Deserialize,
)]
#[serde(rename_all = "snake_case")]
pub enum Step {
    /// Features and codec
    Prepare,
    /// The scene
    Train,
    /// Measures
    Eval,
    /// Masked frames
    Export,
}

impl Step {
    /// All steps, in their order.
    pub const ALL: [Self; 4] = [Self::Prepare, Self::Train, Self::Eval, Self::Export];

    /// Name of the verb.
    pub fn name(self) -> &'static str {
        match self {
            Self::Prepare => "prepare",
            Self::Train => "train",
            Self::Eval => "eval",
            Self::Export => "export",
        }
    }

    /// The step whose result this one works on.
    pub fn needs(self) -> Option<Self> {
        match self {
            Self::Prepare => None,
            Self::Train => Some(Self::Prepare),
            Self::Eval | Self::Export => Some(Self::Train),
        }
    }
}
