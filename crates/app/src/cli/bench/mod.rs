//! `surgtpgs bench`: run time beside quality or error, as CSV and SVG.

mod plot;
mod rows;
mod step;
mod train;

use super::Exit;
use crate::args::{BenchArgs, BenchVerb};
use surgtpgs_core::Result;

pub(super) fn run(args: &BenchArgs) -> Result<Exit> {
    match &args.verb {
        BenchVerb::Train(args) => train::run(args),
        BenchVerb::Step(args) => step::run(args),
    }
}
