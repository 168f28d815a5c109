//! Facts that scenes and recordings tell alike.

use std::path::{Path, PathBuf};
use surgtpgs_core::prepare::is_background;

/// Returns the folder that holds `path`, or the user's own folder if that cannot be written to.
pub(super) fn output_folder(path: &Path) -> PathBuf {
    let beside = path.parent().filter(|p| tempfile::tempfile_in(p).is_ok());
    let own = || dirs::document_dir().or_else(dirs::home_dir).unwrap_or_else(std::env::temp_dir);
    beside.map_or_else(own, Path::to_owned)
}

/// Returns class names as example prompts, without those of the background.
pub(super) fn examples<'a>(names: impl Iterator<Item = &'a str>) -> Vec<String> {
    names.filter(|name| !is_background(name)).map(str::to_owned).collect()
}
