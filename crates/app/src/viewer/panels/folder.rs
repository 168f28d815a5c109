//! Names of folders that do not exist yet.

use std::path::{Path, PathBuf};

/// Returns the path of a folder that does not exist yet.
pub(crate) fn free_folder(parent: &Path, name: &str, what: &str) -> PathBuf {
    let path = |i: usize| {
        let number = if i == 1 { String::new() } else { format!("-{i}") };
        parent.join(format!("{name}-{what}{number}"))
    };
    (1..1000).map(path).find(|p| !p.exists()).unwrap_or_else(|| path(1000))
}
