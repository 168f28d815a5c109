//! Files and folders on their way to their places.

use std::{ffi::OsStr, path::Path};

/// First part of the names of files that are being written.
pub(super) const TEMPORARY: &str = ".part-";

/// Syncs the parent folder: without it, a power cut may undo the renaming.
pub(super) fn sync_parent(path: &Path) {
    let folder = path.parent().filter(|p| p.as_os_str() != OsStr::new("")).unwrap_or(Path::new("."));
    let _ = std::fs::File::open(folder).and_then(|folder| folder.sync_all());
}
