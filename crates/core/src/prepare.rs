//! A prepared folder: per-pixel features of a recording, and the codec that compresses them.
//! The recording itself is never modified; the folder points to it.

use crate::{
    Result,
    codec::{Codec, CodecSettings},
    grid::Grid,
    sequence::{Class, Sequence},
};
use std::path::Path;

/// Which text encoder made the embeddings; another one of the same width would be silently wrong.
#[derive(Clone, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub struct EncoderIdentity {
    /// "builtin" or the folder's name.
    pub name: String,
    /// SHA-256 over model and tokenizer files, hexadecimal.
    pub sha256: String,
    /// Length of an embedding.
    pub dim: usize,
    /// Prompt template with `{}` for the words.
    pub template: String,
    /// Folder it was loaded from; `None` for the built-in one.
    pub folder: Option<std::path::PathBuf>,
}

/// Row of the feature table per pixel; [`NO_REGION`] where there is no feature.
pub type RegionMap = Grid<u16>;

/// A pixel without a feature.
pub const NO_REGION: u16 = u16::MAX;

/// An opened prepared folder.
#[derive(Clone, Debug)]
pub struct Prepared {
    /// The recording.
    pub sequence: Sequence,
    /// Whether test frames are held out of everything.
    pub eval: bool,
    /// What made the embeddings.
    pub encoder: EncoderIdentity,
    /// Class names with their embeddings, where features come from labels.
    pub classes: Vec<(Class, Vec<f32>)>,
    /// The trained codec.
    pub codec: Codec,
    /// Latents of the feature table, [rows][D] flat, unit rows.
    pub latents: Vec<f32>,
}

impl Prepared {
    /// Whether `path` is a prepared folder.
    pub fn is_prepared(path: &Path) -> bool {
        let _ = path;
        todo!()
    }
    /// Opens a prepared folder and the recording it points to.
    pub fn open(path: &Path) -> Result<Self> {
        let _ = path;
        todo!()
    }
    /// Feature-table rows per pixel of frame `i`; `None` where that frame has none (or is held out).
    pub fn regions(&self, i: usize) -> Result<Option<RegionMap>> {
        let _ = i;
        todo!()
    }
}

/// Turns label masks into features: every pixel gets the embedding of its class name.
/// `embeddings` has one unit row per class of the sequence. Frames held out by `eval` leave no trace.
pub fn prepare_from_labels(
    sequence: Sequence,
    encoder: EncoderIdentity,
    embeddings: &[Vec<f32>],
    eval: bool,
    settings: &CodecSettings,
    folder: &Path,
    progress: &mut dyn FnMut(&str, usize, usize),
) -> Result<Prepared> {
    let _ = (sequence, encoder, embeddings, eval, settings, folder, progress);
    todo!()
}
