//! Kinds of results that this program writes, and the ways it recognises files of its own.

use std::path::Path;
use surgtpgs_core::{
    Result,
    files::{Claim, FileClaim, Inputs, OutputFile, OutputFolder},
    scene::Scene,
    train::is_checkpoint,
};

/// Kinds of folders; the names stand in their records and in messages.
pub(crate) const DEMO_RECORDING: &str = "demo recording";
pub(crate) const PREPARATION: &str = "preparation";
pub(crate) const LANGSPLAT: &str = "set of LangSplat features";
pub(crate) const RENDERING: &str = "rendering";
pub(crate) const OBJECTS: &str = "set of objects";
pub(crate) const EXPORT: &str = "export";
pub(crate) const EVALUATION: &str = "evaluation";
pub(crate) const BENCHMARK: &str = "benchmark";
pub(crate) const CONVERSION: &str = "conversion";
/// Kinds of folders that hold several outputs.
pub(crate) const DEMO: &str = "demo";
pub(crate) const BATCH: &str = "batch";

/// Takes a folder for a result that is written in one go.
pub(crate) fn folder(path: &Path, kind: &str, inputs: &Inputs, replace: bool) -> Result<OutputFolder> {
    OutputFolder::claim(path, Claim::new(kind, inputs, replace))
}

/// Takes a file for a scene, or for the file that a scene is converted to.
pub(crate) fn scene_file(path: &Path, inputs: &Inputs, replace: bool) -> Result<OutputFile> {
    OutputFile::claim(path, FileClaim { kind: "scene", inputs, replace, is_ours: Scene::is_own_file })
}

/// Takes the file beside a scene that keeps unfinished training.
pub(crate) fn checkpoint_file(path: &Path, inputs: &Inputs) -> Result<OutputFile> {
    let claim = FileClaim { kind: "unfinished training", inputs, replace: true, is_ours: is_checkpoint };
    OutputFile::claim(path, claim)
}
