//! `surgtpgs bench`: run time beside quality or error, as CSV and SVG.
//!
//! A measurement's file holds its arguments and makes it. The table of measurements is here.

mod codec;
mod frame;
mod gpu;
mod long;
mod marks;
mod masks;
mod measure;
mod plot;
mod reference;
mod rows;
mod shown;
mod step;
mod stress;
mod timing;
mod train;
mod words;

use super::verb::{Exit, Run};
use clap::{Args, Subcommand};
use measure::Measure;
use surgtpgs_core::Result;

/// Measure run time beside quality for every setting; writes CSV and SVG
#[derive(Debug, Args)]
pub(super) struct BenchArgs {
    /// Measurement to make
    #[command(subcommand)]
    measurement: Measurement,
    /// Replace an earlier benchmark in the folder, once the new one is whole
    #[arg(long, global = true)]
    force: bool,
}

/// Measurement of `surgtpgs bench`, with its arguments.
#[derive(Debug, Subcommand)]
enum Measurement {
    Train(train::BenchTrainArgs),
    Step(step::BenchStepArgs),
    Frame(frame::BenchFrameArgs),
    Gpu(gpu::BenchGpuArgs),
    Stress(stress::BenchStressArgs),
    Masks(masks::BenchMasksArgs),
    Marks(marks::BenchMarksArgs),
    Long(long::BenchLongArgs),
    Codec(codec::BenchCodecArgs),
    Words(words::BenchWordsArgs),
}

impl Measurement {
    /// Returns the arguments.
    fn args(&self) -> &dyn Measure {
        match self {
            Self::Train(args) => args,
            Self::Step(args) => args,
            Self::Frame(args) => args,
            Self::Gpu(args) => args,
            Self::Stress(args) => args,
            Self::Masks(args) => args,
            Self::Marks(args) => args,
            Self::Long(args) => args,
            Self::Codec(args) => args,
            Self::Words(args) => args,
        }
    }
}

impl Run for BenchArgs {
    fn run(&self) -> Result<Exit> {
        self.measurement.args().run(self.force)
    }
}
