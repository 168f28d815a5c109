//! `surgtpgs view`: the viewer on a scene, a recording or a prepared folder.

use super::verb::{Exit, Run};
use crate::viewer::{self, ViewerInput};
use clap::Args;
use std::path::PathBuf;
use surgtpgs_core::{Error, Result};

/// Open the viewer on a scene, a recording, a prepared folder or a session; `surgtpgs PATH` does the same
#[derive(Debug, Args)]
pub(super) struct ViewArgs {
    /// A scene file, a .ply of Gaussian splats, a recording, a prepared folder or a session
    path: PathBuf,
}

impl Run for ViewArgs {
    fn run(&self) -> Result<Exit> {
        let path = &self.path;
        if !path.exists() {
            return Err(Error::input_at(path, "there is no such file or folder", "Check the path."));
        }
        require_display()?;
        viewer::run(ViewerInput::Path(path.clone()), demo_folder().ok())?;
        Ok(Exit::Done)
    }
}

/// Returns the user's own folder for the demo of the viewer.
pub(super) fn demo_folder() -> Result<PathBuf> {
    let data = dirs::data_local_dir().ok_or_else(|| Error::Missing {
        what: "there is no folder for the user's data".into(),
        hint: "Set HOME.".into(),
    })?;
    Ok(data.join("surgtpgs").join("demo"))
}

fn require_display() -> Result<()> {
    if has_display() {
        return Ok(());
    }
    Err(Error::Missing {
        what: "there is no display to open a window on".into(),
        hint: "Set DISPLAY or WAYLAND_DISPLAY, or use the verbs render, query and export.".into(),
    })
}

/// Returns `true` if a window can be opened. Only Linux and its like can lack a display.
pub(super) fn has_display() -> bool {
    let is_set = |name| std::env::var_os(name).is_some_and(|v| !v.is_empty());
    !cfg!(all(unix, not(target_os = "macos"))) || is_set("DISPLAY") || is_set("WAYLAND_DISPLAY")
}
