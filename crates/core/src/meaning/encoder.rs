//! The identity of text encoders.

use std::path::PathBuf;

/// Identity of the text encoder that made the embeddings; another one of the same width would
/// be silently wrong.
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
    /// Folder that it was loaded from; `None` for the built-in one.
    pub folder: Option<PathBuf>,
}
