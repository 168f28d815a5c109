//! The encoder that is built into the program; `examples/train_builtin` makes its files.

/// Model file of the encoder.
pub(crate) const MODEL: &[u8] = include_bytes!("../../../assets/text_encoder/model.onnx");
/// Tokenizer of the encoder.
pub(crate) const TOKENIZER: &[u8] = include_bytes!("../../../assets/text_encoder/tokenizer.json");
/// Settings of the encoder.
pub(crate) const SETTINGS: &str = include_str!("../../../assets/text_encoder/encoder.toml");
