//! `surgtpgs eval`

use super::{RelevancyArgs, SceneArgs};
use crate::engine::Backend;
use clap::Args;
use std::path::{Path, PathBuf};

/// `surgtpgs eval`
#[derive(Debug, Args)]
pub struct EvalArgs {
    /// A scene and the recording it was trained on; with --masks the recording alone
    #[arg(value_name = "[SCENE] SEQ", num_args = 1..=2, required = true)]
    pub paths: Vec<PathBuf>,
    /// Score the masks in this folder instead of a scene: FRAME_CLASS.png or CLASS/FRAME.png (white =
    /// found), FRAME.png (class ids), or K/CLASS.png for the K-th held-out frame; a frame with no
    /// mask at all is not looked at
    #[arg(long, value_name = "DIR")]
    pub masks: Option<PathBuf>,
    /// Also write tables, the report with every frame and class, and pictures of errors into this folder
    #[arg(short, long, value_name = "DIR")]
    pub output: Option<PathBuf>,
    /// Replace an earlier evaluation in that folder, once the new one is whole
    #[arg(long, requires = "output")]
    pub force: bool,
    /// Also measure LPIPS with this model: two float images [1,3,height,width] of -1 to 1 in, one number out
    #[arg(long, value_name = "MODEL.onnx", conflicts_with = "masks")]
    pub lpips: Option<PathBuf>,
    /// Device to render on
    #[arg(long, value_enum, default_value_t = Backend::Auto)]
    pub backend: Backend,
    /// Options for asking class names
    #[command(flatten)]
    pub relevancy: RelevancyArgs,
    /// Report as JSON
    #[arg(long)]
    pub json: bool,
}

impl EvalArgs {
    /// Returns the options to open the scene with.
    pub fn scene(&self, path: &Path) -> SceneArgs {
        SceneArgs { scene: path.to_owned(), backend: self.backend }
    }
}
