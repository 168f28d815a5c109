//! Models with one wrong number in a constant.

use prost::Message;
use surgtpgs_clip::{graph::Graph, onnx::ModelProto};

/// File of a model, with the first number of a constant replaced by `value`.
pub fn with_constant(model: Graph, name: &str, value: f32) -> Vec<u8> {
    let mut model = ModelProto::decode(&model.into_bytes()[..]).unwrap();
    let constants = &mut model.graph.as_mut().unwrap().initializer;
    let constant = constants.iter_mut().find(|c| c.name == name).unwrap();
    constant.raw_data = [&value.to_le_bytes(), &constant.raw_data[4..]].concat().into();
    model.encode_to_vec()
}
