//! Paths, and files that have several.

use std::{
    fs::Metadata,
    path::{Path, PathBuf},
};

/// Returns `path` from the root on, so that it means the same wherever a program is started; links stay.
pub fn absolute_path(path: &Path) -> PathBuf {
    std::path::absolute(path).unwrap_or_else(|_| path.to_owned())
}

/// Returns the absolute path with links resolved, if it exists; else as [`absolute_path`].
pub fn full_path(path: &Path) -> PathBuf {
    path.canonicalize().unwrap_or_else(|_| absolute_path(path))
}

/// Returns the absolute path with links of its folders resolved, but not that which it may be itself: what
/// lies beside a link belongs to it.
pub fn located_path(path: &Path) -> PathBuf {
    let (Some(folder), Some(name)) = (path.parent(), path.file_name()) else { return full_path(path) };
    let folder = if folder.as_os_str().is_empty() { Path::new(".") } else { folder };
    full_path(folder).join(name)
}

/// Tells if two files are the same one, by what the system says of them.
#[cfg(unix)]
pub(super) fn is_same_file(a: &Metadata, b: &Metadata) -> bool {
    use std::os::unix::fs::MetadataExt;
    (a.dev(), a.ino()) == (b.dev(), b.ino())
}

#[cfg(not(unix))]
pub(super) fn is_same_file(_: &Metadata, _: &Metadata) -> bool {
    false
}
