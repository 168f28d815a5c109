//! The text encoder in the form that the rest of the program uses.

use crate::{
    builtin,
    cache::EmbeddingCache,
    contract::Contract,
    model_file::{hex, read, read_beside},
    model_source::ModelSource,
    session::Model,
    settings::{DEFAULT_TEMPLATE, EncoderSettings, read_settings},
    tokenizer::PromptTokenizer,
};
use sha2::{Digest, Sha256};
use std::path::Path;
use surgtpgs_core::{Error, Result, meaning::EncoderIdentity};

/// A loaded text encoder (model, tokenizer and their contract).
pub struct TextEncoder {
    identity: EncoderIdentity,
    tokenizer: PromptTokenizer,
    model: Model,
    cache: EmbeddingCache,
}

/// The files of an encoder.
struct Files {
    model: Vec<u8>,
    tokenizer: Vec<u8>,
    settings: Option<String>,
    source: ModelSource,
}

impl TextEncoder {
    /// Opens the small surgical encoder inside the program. It knows the words of
    /// `assets/text_encoder/lexicon.toml`, and keeps other words away from all of them.
    pub fn builtin() -> Result<Self> {
        let files = Files {
            model: builtin::MODEL.to_vec(),
            tokenizer: builtin::TOKENIZER.to_vec(),
            settings: Some(builtin::SETTINGS.to_owned()),
            source: ModelSource::Memory(builtin::MODEL),
        };
        Self::assemble("builtin", None, files, None)
    }

    /// Opens a folder with `model.onnx`, `tokenizer.json` and optionally `encoder.toml`
    /// ([`EncoderSettings`]). Everything is checked here, with a trial run. Errors say what is wrong with
    /// which file.
    pub fn open(folder: &Path) -> Result<Self> {
        Self::open_with_cache(folder, None)
    }

    /// Opens a folder as [`Self::open`] does, and keeps all embeddings under `cache`, those of the trial
    /// run too. Embeddings found there are not computed again: the model is only loaded for new words.
    pub fn open_with_cache(folder: &Path, cache: Option<&Path>) -> Result<Self> {
        if !folder.is_dir() {
            let hint = "Choose a folder with model.onnx and tokenizer.json.";
            return Err(Error::input_at(folder, "There is no such folder with a text encoder", hint));
        }
        let model_path = folder.join("model.onnx");
        let files = Files {
            model: read_part(&model_path)?,
            tokenizer: read_part(&folder.join("tokenizer.json"))?,
            settings: read_settings(&folder.join("encoder.toml"))?,
            source: ModelSource::File(model_path.clone()),
        };
        let absolute = folder.canonicalize().map_err(|e| Error::io("find the folder", folder, e))?;
        let name =
            absolute.file_name().map_or_else(|| "encoder".into(), |name| name.to_string_lossy().into_owned());
        Self::assemble(&name, Some(&absolute), files, cache)
    }

    fn assemble(name: &str, folder: Option<&Path>, files: Files, cache: Option<&Path>) -> Result<Self> {
        let at = |file: &str| folder.map_or_else(|| Path::new(file).to_owned(), |folder| folder.join(file));
        let (model_path, tokenizer_path) = (at("model.onnx"), at("tokenizer.json"));
        let settings = EncoderSettings::parse(files.settings.as_deref().unwrap_or(""), &at("encoder.toml"))?;
        let tokenizer = PromptTokenizer::parse(&files.tokenizer, &settings, &tokenizer_path)?;

        let mut hash = Sha256::new();
        hash.update(&files.model);
        let contract = Contract::read(files.model.into(), &settings, tokenizer.is_clip(), &model_path)?;
        contract.check_vocabulary(tokenizer.largest_id(), &model_path)?;
        for file in &contract.external_files {
            hash.update(read_beside(file, folder, &model_path)?);
        }
        hash.update(&files.tokenizer);
        hash.update(files.settings.as_deref().unwrap_or(""));

        let context = context_length(&settings, &contract, &tokenizer, &model_path)?;
        let model = Model::new(files.source, contract, tokenizer.pad_id(), context, &model_path);
        let identity = EncoderIdentity {
            name: name.to_owned(),
            sha256: hex(hash),
            dim: 0,
            template: settings.template.unwrap_or_else(|| DEFAULT_TEMPLATE.to_owned()),
            folder: folder.map(Path::to_owned),
        };
        let on_disk = |folder| EmbeddingCache::on_disk(folder, &identity.sha256);
        let cache = cache.map_or_else(EmbeddingCache::default, on_disk);
        let mut encoder = Self { identity, tokenizer, model, cache };
        encoder.identity.dim = encoder.try_out(&model_path)?;
        Ok(encoder)
    }

    /// Encodes two words of different meaning and returns the length of an embedding.
    fn try_out(&mut self, model_path: &Path) -> Result<usize> {
        let pair = self.encode_bare(&["liver", "needle"])?;
        let cosine: f32 = pair[0].iter().zip(&pair[1]).map(|(a, b)| a * b).sum();
        if cosine > 0.99999 {
            let what = "The encoder gives \"liver\" and \"needle\" the same embedding";
            let hint = "Its tokenizer.json or the pooling in encoder.toml does not belong to the model.";
            return Err(Error::input_at(model_path, what, hint));
        }
        Ok(pair[0].len())
    }

    /// Identity of this encoder; recorded in every result.
    pub fn identity(&self) -> &EncoderIdentity {
        &self.identity
    }

    /// Longest prompt in tokens, template and start and end tokens included.
    pub fn context_length(&self) -> usize {
        self.model.context()
    }

    /// Unit embeddings of prompts, each put into the template first. Leading, trailing and doubled spaces
    /// are ignored. An empty prompt, or one longer than the model reads, is an error.
    pub fn encode_prompts(&mut self, prompts: &[&str]) -> Result<Vec<Vec<f32>>> {
        let fill = |prompt: &&str| Ok(self.identity.template.replace("{}", &tidy(prompt)?));
        let texts = prompts.iter().map(fill).collect::<Result<Vec<String>>>()?;
        texts.into_iter().map(|text| self.embedding(text)).collect()
    }

    /// Unit embeddings of phrases without the template (canonical phrases), otherwise as
    /// [`Self::encode_prompts`].
    pub fn encode_bare(&mut self, phrases: &[&str]) -> Result<Vec<Vec<f32>>> {
        phrases.iter().map(|phrase| self.embedding(tidy(phrase)?)).collect()
    }

    fn embedding(&mut self, text: String) -> Result<Vec<f32>> {
        if let Some(known) = self.cache.get(&text) {
            return Ok(known);
        }
        let ids = self.tokenizer.encode(&text, self.model.context())?;
        let embedding = self.model.embed(&ids, &text)?;
        self.cache.put(&text, &embedding);
        Ok(embedding)
    }
}

/// Trims white space and collapses repeated white space.
fn tidy(prompt: &str) -> Result<String> {
    let words: Vec<&str> = prompt.split_whitespace().collect();
    match words.is_empty() {
        true => {
            Err(Error::input("The prompt is empty", "Type what to look for, for example \"gallbladder\"."))
        }
        false => Ok(words.join(" ")),
    }
}

/// Longest text in tokens: from `encoder.toml`, else the model's fixed length, else the tokenizer's default.
fn context_length(
    settings: &EncoderSettings,
    contract: &Contract,
    tokenizer: &PromptTokenizer,
    model_path: &Path,
) -> Result<usize> {
    match (settings.context_length, contract.fixed_length) {
        (Some(stated), Some(fixed)) if stated > fixed => {
            let what = format!("encoder.toml says context_length {stated}; the model reads {fixed} tokens");
            Err(Error::input_at(model_path, what, "Correct or remove context_length in encoder.toml."))
        }
        (stated, fixed) => Ok(stated.or(fixed).unwrap_or_else(|| tokenizer.default_context())),
    }
}

/// Reads a file that every text encoder needs.
fn read_part(path: &Path) -> Result<Vec<u8>> {
    if !path.exists() {
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        let hint = "A text encoder is a folder with model.onnx and tokenizer.json.";
        return Err(Error::input_at(path, format!("The text encoder has no {name}"), hint));
    }
    read(path)
}
