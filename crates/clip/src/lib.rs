#![doc = include_str!("../README.md")]

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
