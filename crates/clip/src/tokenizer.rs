//! From words to token ids. Every way in which a tokenizer file can be wrong gives an error in plain words.

use crate::{caught::caught, settings::EncoderSettings};
use std::path::Path;
use surgtpgs_core::{Error, Result};
use tokenizers::Tokenizer;

/// Longest prompt, if neither the model nor the tokenizer nor `encoder.toml` says.
const DEFAULT_CONTEXT: usize = 256;
/// Longest prompt of CLIP.
const CLIP_CONTEXT: usize = 77;

/// A loaded `tokenizer.json`; never truncates and never pads by itself.
pub(crate) struct PromptTokenizer {
    tokenizer: Tokenizer,
    lower_case: bool,
    /// Longest text it was made for, if it says.
    stated_length: Option<usize>,
    pad_id: u32,
}

impl PromptTokenizer {
    /// Parses the bytes of the file at `path` (which is only named in errors).
    pub(crate) fn parse(bytes: &[u8], settings: &EncoderSettings, path: &Path) -> Result<Self> {
        let mut tokenizer = load(bytes, path)?;
        let padding = tokenizer.get_padding().cloned();
        let stated_length = tokenizer.get_truncation().map(|t| t.max_length);
        let is_broken = tokenizer.with_truncation(None).is_err();
        tokenizer.with_padding(None);
        if is_broken || tokenizer.get_vocab_size(true) == 0 {
            return Err(Error::input_at(path, "tokenizer.json has no vocabulary", SAME_EXPORT));
        }
        let pad_id = settings.pad_id.or(padding.map(|p| p.pad_id)).unwrap_or(0);
        Ok(Self { tokenizer, lower_case: settings.lower_case, stated_length, pad_id })
    }

    /// Returns `true` if the end of the text is marked as in CLIP.
    pub(crate) fn is_clip(&self) -> bool {
        self.tokenizer.token_to_id("<|endoftext|>").is_some()
    }

    /// Largest token id it can return, padding included.
    pub(crate) fn largest_id(&self) -> u32 {
        self.tokenizer.get_vocab(true).into_values().max().unwrap_or(0).max(self.pad_id)
    }

    /// Token that fills up short texts.
    pub(crate) fn pad_id(&self) -> u32 {
        self.pad_id
    }

    /// Longest text in tokens, if neither the model nor `encoder.toml` says.
    pub(crate) fn default_context(&self) -> usize {
        self.stated_length.unwrap_or(if self.is_clip() { CLIP_CONTEXT } else { DEFAULT_CONTEXT })
    }

    /// Token ids of a text, start and end tokens included. Fails if there are none or more than `context`.
    pub(crate) fn encode(&self, text: &str, context: usize) -> Result<Vec<u32>> {
        let lowered = self.lower_case.then(|| text.to_lowercase());
        let input = lowered.as_deref().unwrap_or(text);
        let unreadable =
            || Error::input(format!("The tokenizer could not read \"{text}\""), "Use other words.");
        let encoding = caught(|| self.tokenizer.encode(input, true));
        let ids = encoding.map_err(|_| unreadable())?.map_err(|_| unreadable())?.get_ids().to_vec();
        if ids.is_empty() {
            return Err(unreadable());
        }
        if ids.len() > context {
            let what = format!("The prompt has {} tokens; the encoder reads {context}", ids.len());
            return Err(Error::input(what, "Shorten it; nothing is cut off silently."));
        }
        Ok(ids)
    }
}

const SAME_EXPORT: &str = "Take tokenizer.json from the same export as the model.";

/// Parses the file. The library panics on some files (tokenizers#1645), and its own message for a wrong
/// one ("did not match any variant of untagged enum") helps nobody.
fn load(bytes: &[u8], path: &Path) -> Result<Tokenizer> {
    let json: serde_json::Value = serde_json::from_slice(bytes).map_err(|e| {
        let what =
            format!("tokenizer.json is not a tokenizer file (line {}, column {})", e.line(), e.column());
        Error::input_at(path, what, SAME_EXPORT)
    })?;
    if let Some(missing) = ["model", "added_tokens"].iter().find(|field| json.get(field).is_none()) {
        let what = format!("tokenizer.json is not a tokenizer file: it has no field \"{missing}\"");
        return Err(Error::input_at(path, what, SAME_EXPORT));
    }
    let parsed = caught(|| Tokenizer::from_bytes(bytes));
    match parsed {
        Ok(Ok(tokenizer)) => Ok(tokenizer),
        Ok(Err(_)) | Err(_) => {
            let what = format!(
                "tokenizer.json is from an incompatible tokenizers version or is not a tokenizer file{}",
                suspect(&json).map(|field| format!(" (field \"{field}\")")).unwrap_or_default()
            );
            Err(Error::input_at(path, what, SAME_EXPORT))
        }
    }
}

/// Name of the part of the file that cannot be parsed by itself.
fn suspect(json: &serde_json::Value) -> Option<&'static str> {
    fn reads<T: serde::de::DeserializeOwned>(json: &serde_json::Value, field: &str) -> bool {
        let part = json.get(field).cloned().unwrap_or_default();
        part.is_null() || matches!(caught(|| serde_json::from_value::<T>(part)), Ok(Ok(_)))
    }
    let checks = [
        ("model", reads::<tokenizers::ModelWrapper>(json, "model")),
        ("normalizer", reads::<tokenizers::NormalizerWrapper>(json, "normalizer")),
        ("pre_tokenizer", reads::<tokenizers::PreTokenizerWrapper>(json, "pre_tokenizer")),
        ("post_processor", reads::<tokenizers::PostProcessorWrapper>(json, "post_processor")),
    ];
    checks.into_iter().find(|(_, is_readable)| !is_readable).map(|(field, _)| field)
}
