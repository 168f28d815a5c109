//! Everything that runs through ONNX:
//!
//! - text encoders, from words to unit embeddings ([`TextEncoder`])
//! - Segment Anything, from points to masks ([`SegmentAnything`])
//! - image encoders, from masked parts of pictures to embeddings ([`ImageEncoder`])
//! - feature maps ([`FeatureNetwork`]) and depth ([`DepthNetwork`]) of whole pictures
//! - the perceptual distance of two pictures ([`Lpips`])
//!
//! A folder with `model.onnx` and `tokenizer.json` (or the small encoder inside the program) becomes a
//! [`TextEncoder`]. The model and the tokenizer are checked against each other ([`contract`]). A mix-up
//! gives an error that says what to do, instead of wrong masks. Models run on ONNX Runtime if its shared
//! library is found, else on tract, which is always there ([`runtime`]).

mod builtin;
mod cache;
mod caught;
pub mod contract;
mod depth_network;
mod feature_network;
pub mod graph;
mod image_encoder;
mod library;
mod lpips;
mod model_file;
mod model_source;
mod network;
pub mod onnx;
mod operators;
mod picture_model;
mod provider;
pub mod runtime;
mod segment_anything;
mod session;
mod settings;
mod tensor;
mod text_encoder;
mod tokenizer;
mod tract;

pub use depth_network::DepthNetwork;
pub use feature_network::FeatureNetwork;
pub use image_encoder::ImageEncoder;
pub use lpips::Lpips;
pub use provider::Provider;
pub use runtime::{backend_name, backend_notes, choose_provider};
pub use segment_anything::SegmentAnything;
pub use settings::{DEFAULT_TEMPLATE, EncoderSettings, Pooling};
pub use text_encoder::TextEncoder;
