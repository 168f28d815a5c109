//! Everything that runs through ONNX: text encoders, from words to unit embeddings; Segment Anything, from points to
//! masks ([`SegmentAnything`]); image encoders, from what a mask shows to embeddings ([`ImageEncoder`]); feature maps
//! ([`FeatureNetwork`]) and depth ([`DepthNetwork`]) of whole pictures; how different two pictures look ([`Lpips`]).
//!
//! A folder with `model.onnx` and `tokenizer.json` (or the small encoder inside the program) becomes a
//! [`TextEncoder`]. On the way the model and the tokenizer are checked against each other ([`contract`]), so that a
//! mix-up ends in a sentence that says what to do, not in wrong masks. Models run on ONNX Runtime where its shared
//! library is found and on tract, which is always there, where it is not ([`runtime`]).

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
mod network;
pub mod onnx;
mod operators;
mod picture_model;
mod provider;
pub mod runtime;
mod segment_anything;
mod session;
mod settings;
mod text_encoder;
mod tokenizer;
mod tract;

pub use depth_network::DepthNetwork;
pub use feature_network::FeatureNetwork;
pub use image_encoder::ImageEncoder;
pub use lpips::Lpips;
pub use provider::{Provider, choose_provider};
pub use runtime::{backend_name, backend_notes};
pub use segment_anything::SegmentAnything;
pub use settings::{DEFAULT_TEMPLATE, EncoderSettings, Pooling};
pub use text_encoder::TextEncoder;
