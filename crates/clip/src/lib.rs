//! Text encoders: from words to unit embeddings, through ONNX.

use std::path::Path;
use surgtpgs_core::{Result, prepare::EncoderIdentity};

/// A loaded text encoder (model, tokenizer and their contract).
pub struct TextEncoder {}

impl TextEncoder {
    /// The small surgical encoder inside the program.
    pub fn builtin() -> Result<Self> {
        todo!()
    }
    /// A folder with `model.onnx`, `tokenizer.json` and optionally `encoder.toml`.
    pub fn open(folder: &Path) -> Result<Self> {
        let _ = folder;
        todo!()
    }
    /// Which encoder this is; goes into every result.
    pub fn identity(&self) -> &EncoderIdentity {
        todo!()
    }
    /// Unit embeddings of prompts, each put into the template first.
    pub fn encode_prompts(&mut self, prompts: &[&str]) -> Result<Vec<Vec<f32>>> {
        let _ = prompts;
        todo!()
    }
    /// Unit embeddings of phrases as they stand (canonical phrases).
    pub fn encode_bare(&mut self, phrases: &[&str]) -> Result<Vec<Vec<f32>>> {
        let _ = phrases;
        todo!()
    }
}
