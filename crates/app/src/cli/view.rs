//! `surgtpgs view`: the viewer on a scene, a recording or a prepared folder.

use super::Exit;
use crate::{
    args::ViewArgs,
    viewer::{self, ViewerInput},
};
use surgtpgs_core::{Error, Result, scene::Scene};

pub(super) fn run(args: &ViewArgs) -> Result<Exit> {
    if !args.path.exists() {
        return Err(Error::input_at(&args.path, "there is no such file or folder", "Check the path."));
    }
    require_display()?;
    let input = if Scene::is_named_like_one(&args.path) {
        ViewerInput::Scene(args.path.clone())
    } else {
        ViewerInput::Sequence(args.path.clone())
    };
    viewer::run(input)?;
    Ok(Exit::Done)
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
