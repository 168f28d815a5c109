//! Source of a model: a file, or bytes inside the program.

use std::path::PathBuf;

/// Source of a model.
#[derive(Clone, Debug)]
pub(crate) enum ModelSource {
    File(PathBuf),
    Memory(&'static [u8]),
}
