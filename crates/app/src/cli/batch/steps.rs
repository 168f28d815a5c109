//! Steps of the work on a recording: verbs of the program, in their order.

use crate::cli::{eval::EvalArgs, export::ExportArgs, prepare::PrepareArgs, train::TrainArgs};
use clap::{Parser, Subcommand, ValueEnum};

/// Step of the work on a recording; the steps follow one another.
#[derive(
    Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, ValueEnum, serde::Serialize, serde::Deserialize,
)]
#[serde(rename_all = "snake_case")]
pub(super) enum Step {
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
    pub(super) const ALL: [Self; 4] = [Self::Prepare, Self::Train, Self::Eval, Self::Export];

    /// Returns the name of the verb.
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Prepare => "prepare",
            Self::Train => "train",
            Self::Eval => "eval",
            Self::Export => "export",
        }
    }

    /// Returns the step whose result this one works on.
    pub(super) fn needs(self) -> Option<Self> {
        match self {
            Self::Prepare => None,
            Self::Train => Some(Self::Prepare),
            Self::Eval | Self::Export => Some(Self::Train),
        }
    }
}

/// Command line of a step, as a user would type it, without options of every verb: a batch has one device for
/// all its models.
#[derive(Parser)]
#[command(name = "surgtpgs", disable_help_subcommand = true)]
pub(super) struct StepLine {
    #[command(subcommand)]
    pub(super) verb: StepVerb,
}

/// Verb of a step, with its arguments.
#[derive(Debug, Subcommand)]
pub(super) enum StepVerb {
    Prepare(PrepareArgs),
    Train(TrainArgs),
    Eval(EvalArgs),
    Export(ExportArgs),
}
