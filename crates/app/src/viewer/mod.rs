//! The window.

use std::path::PathBuf;
use surgtpgs_core::Result;

/// What the window shows first.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum ViewerInput {
    /// A trained scene.
    Scene(PathBuf),
    /// A recording or prepared folder, to look at and to train.
    Sequence(PathBuf),
    /// The built-in demo: its scene if `work_dir` has one, else it is built there in the background.
    Demo {
        /// Where the demo's files are.
        work_dir: PathBuf,
    },
}

/// Opens the window and returns when it is closed.
pub fn run(open: ViewerInput) -> Result<()> {
    let _ = open;
    todo!()
}
