//! `encoder.toml`: settings of a model folder that its other files do not show.

use std::{io::ErrorKind, path::Path};
use surgtpgs_core::{Error, Result, reading::read_text};

/// Prompt template of the paper; `{}` stands for the words.
pub const DEFAULT_TEMPLATE: &str = "A photo of a {} in the scene";

/// Way in which one embedding is taken from the model's output.
#[derive(Clone, Debug, PartialEq, Eq, serde::Deserialize)]
#[serde(try_from = "String")]
pub enum Pooling {
    /// The hidden state of the last real token (CLIP).
    EndOfText,
    /// The mean of the hidden states of the real tokens (sentence encoders).
    Mean,
    /// The named output is the embedding, `[batch, dim]`.
    Output(String),
}

impl TryFrom<String> for Pooling {
    type Error = String;

    fn try_from(text: String) -> Result<Self, String> {
        match text.as_str() {
            "end_of_text" => Ok(Self::EndOfText),
            "mean" => Ok(Self::Mean),
            other => match other.strip_prefix("output:") {
                Some(name) if !name.trim().is_empty() => Ok(Self::Output(name.trim().to_owned())),
                _ => Err(format!(
                    "pooling is \"{other}\"; expected \"end_of_text\", \"mean\" or \"output:NAME\""
                )),
            },
        }
    }
}

/// Contents of `encoder.toml`. Everything is optional; missing values are read from the model.
#[derive(Clone, Debug, Default, PartialEq, serde::Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct EncoderSettings {
    /// Way in which one embedding is taken from the model's output.
    pub pooling: Option<Pooling>,
    /// Longest prompt in tokens, start and end tokens included.
    pub context_length: Option<usize>,
    /// Prompt template with `{}` for the words.
    pub template: Option<String>,
    /// `true` to lower the case of prompts before they reach the tokenizer.
    pub lower_case: bool,
    /// Token that fills short prompts up to the model's length.
    pub pad_id: Option<u32>,
}

impl EncoderSettings {
    /// Parses the text of the file at `path` (which is only named in errors).
    pub fn parse(text: &str, path: &Path) -> Result<Self> {
        let settings: Self = toml::from_str(text).map_err(|e| {
            Error::input_at(
                path,
                format!("encoder.toml could not be read: {}", e.to_string().trim_end().trim_end_matches('.')),
                "Its keys are pooling, context_length, template, lower_case and pad_id.",
            )
        })?;
        if let Some(template) = &settings.template {
            check_template(template).map_err(|what| Error::input_at(path, what, TEMPLATE_HINT))?;
        }
        if settings.context_length.is_some_and(|length| length < 3) {
            return Err(Error::input_at(
                path,
                "context_length is below 3",
                "It counts tokens, with the start and end tokens; CLIP has 77.",
            ));
        }
        Ok(settings)
    }
}

/// Hint for a wrong template.
const TEMPLATE_HINT: &str = "Write {} once where the words belong, as in \"A photo of a {} in the scene\".";

/// Checks that a template holds `{}` exactly once.
fn check_template(template: &str) -> Result<(), String> {
    match template.matches("{}").count() {
        1 => Ok(()),
        n => Err(format!("The prompt template \"{template}\" contains {{}} {n} times")),
    }
}

/// Reads a file of settings; `None` if there is none.
pub(crate) fn read_settings(path: &Path) -> Result<Option<String>> {
    match read_text(path) {
        Ok(text) => Ok(Some(text)),
        Err(e) if e.kind() == ErrorKind::NotFound => Ok(None),
        Err(e) => Err(Error::io("read the encoder's settings", path, e)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse(text: &str) -> Result<EncoderSettings, String> {
        EncoderSettings::parse(text, Path::new("encoder.toml")).map_err(|e| e.to_string())
    }

    #[test]
    fn every_key_is_read() {
        let text = "pooling = \"output:text_embeds\"\ncontext_length = 77\ntemplate = \"a {}\"\nlower_case = true\npad_id = 0";
        let expected = EncoderSettings {
            pooling: Some(Pooling::Output("text_embeds".into())),
            context_length: Some(77),
            template: Some("a {}".into()),
            lower_case: true,
            pad_id: Some(0),
        };
        assert_eq!(parse(text), Ok(expected));
        assert_eq!(parse(""), Ok(EncoderSettings::default()));
    }

    #[test]
    fn mistakes_are_named() {
        assert!(parse("poolling = \"mean\"").unwrap_err().contains("poolling"));
        assert!(
            parse("pooling = \"max\"").unwrap_err().contains("\"end_of_text\", \"mean\" or \"output:NAME\"")
        );
        assert!(parse("pooling = \"output:\"").is_err());
        assert!(parse("template = \"a photo\"").unwrap_err().contains("{} 0 times"));
        assert!(parse("context_length = 1").unwrap_err().contains("below 3"));
    }
}
