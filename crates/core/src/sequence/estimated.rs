//! Depth that a network estimated. It lies in a prepared folder as `depth/frame_000000.npy`, z in scene units
//! at the network's size.

use super::depth::{DepthKind, DepthRule};
use crate::{Error, Result, grid::Grid, hash::require_sha256};
use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
    sync::Arc,
};

/// Subfolder of estimated depth.
pub(crate) const DEPTH: &str = "depth";

/// Source of estimated depth, and findings about it.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct EstimatedDepth {
    /// SHA-256 of the network.
    pub network: String,
    /// Kind of values that it gives.
    pub kind: DepthKind,
    /// Largest scale of a single frame divided by the smallest; 1 if the scales were left as they are.
    pub drift: f32,
    /// Notes for the user.
    pub notes: Vec<String>,
}

/// Place of estimated depth.
#[derive(Clone, Debug)]
pub(super) struct Estimated {
    /// The prepared folder that holds it.
    pub folder: PathBuf,
    pub about: EstimatedDepth,
    /// SHA-256 of files by their path inside the folder, if known.
    pub sha256: Arc<BTreeMap<String, String>>,
}

impl Estimated {
    /// Returns the depth of frame `i` at the given size; `None` if it has none.
    pub(super) fn depth(&self, i: usize, width: usize, height: usize) -> Result<Option<Grid<f32>>> {
        let file = depth_file(&self.folder, i);
        if let Some(sha256) = self.sha256.get(&depth_name(i)) {
            let bytes = std::fs::read(&file).map_err(|e| Error::io("read the depth", &file, e))?;
            require_sha256(&file, &bytes, sha256, "Prepare the recording again.")?;
        } else if !file.is_file() {
            return Ok(None);
        }
        Ok(Some(DepthRule::default().read(&file)?.resized(width, height)))
    }
}

/// Returns the path of the depth file of frame `i` in a prepared folder.
pub(crate) fn depth_file(folder: &Path, i: usize) -> PathBuf {
    folder.join(depth_name(i))
}

/// Returns the path of the depth file of frame `i`, inside the folder.
pub(crate) fn depth_name(i: usize) -> String {
    format!("{DEPTH}/frame_{i:06}.npy")
}
