//! The encoder inside the program; `examples/train_builtin` makes these files.

/// The model.
pub(crate) const MODEL: &[u8] = include_bytes!("../../../assets/text_encoder/model.onnx");
/// Its tokenizer.
pub(crate) const TOKENIZER: &[u8] = include_bytes!("../../../assets/text_encoder/tokenizer.json");
/// Its settings.
pub(crate) const SETTINGS: &str = include_str!("../../../assets/text_encoder/encoder.toml");
