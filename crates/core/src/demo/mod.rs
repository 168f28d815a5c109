//! A synthetic laparoscopic clip with all its ground truth, rendered here, the same bytes every time.

use crate::Result;
use std::path::Path;

/// What to render.
#[derive(Clone, Debug)]
pub struct DemoSettings {
    /// Image columns.
    pub width: usize,
    /// Image rows.
    pub height: usize,
    /// Number of frames.
    pub frames: usize,
    /// Whether the endoscope moves (then the cameras are in `transforms.json`).
    pub moving_camera: bool,
    /// Seed of textures and noise.
    pub seed: u64,
}

impl Default for DemoSettings {
    fn default() -> Self {
        Self { width: 320, height: 240, frames: 48, moving_camera: false, seed: 7 }
    }
}

/// Writes the clip into `folder` as an ordinary sequence folder.
pub fn write(settings: &DemoSettings, folder: &Path, progress: &mut dyn FnMut(usize, usize)) -> Result<()> {
    let _ = (settings, folder, progress);
    todo!()
}
