//! The interface of a verb.

use std::path::Path;
use surgtpgs_core::Result;

/// Exit code of the program; the numbers are a contract.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Exit {
    /// Everything was done.
    Done = 0,
    /// The input is wrong, or the work was stopped and is kept; a message says what to do.
    WrongInput = 1,
    /// The command line is wrong.
    Usage = 2,
    /// The machine lacks something; a message says how to get it.
    Lacking = 3,
    /// A signal ended the program at once: the first one if no work is being kept, else the second one.
    Ended = 130,
}

impl From<Exit> for std::process::ExitCode {
    fn from(exit: Exit) -> Self {
        Self::from(exit as u8)
    }
}

/// Arguments of a verb, which carry it out.
pub(super) trait Run {
    /// Carries the verb out.
    fn run(&self) -> Result<Exit>;

    /// Returns the output of the verb, if it is one file or folder that the command line names.
    fn output(&self) -> Option<&Path> {
        None
    }
}
