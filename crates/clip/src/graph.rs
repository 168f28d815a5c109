//! Builds small ONNX files node by node: the built-in encoder, and models of every contract for tests.

use crate::onnx::{
    AttributeProto, Dim, GraphProto, ModelProto, NodeProto, OperatorSetId, ShapeProto, TensorProto,
    TensorType, TypeProto, ValueInfoProto, data_type,
};

/// A graph under construction.
#[derive(Default)]
pub struct Graph(GraphProto);

impl Graph {
    /// Declares an input; `None` is an axis of any length.
    pub fn input(mut self, name: &str, elem_type: i32, axes: &[Option<i64>]) -> Self {
        self.0.input.push(value_info(name, elem_type, axes));
        self
    }

    /// Declares an output.
    pub fn output(mut self, name: &str, elem_type: i32, axes: &[Option<i64>]) -> Self {
        self.0.output.push(value_info(name, elem_type, axes));
        self
    }

    /// Adds a constant from its little-endian bytes.
    pub fn constant(mut self, name: &str, data_type: i32, dims: &[usize], bytes: Vec<u8>) -> Self {
        let dims = dims.iter().map(|d| *d as i64).collect();
        self.0.initializer.push(TensorProto {
            dims,
            data_type,
            name: name.into(),
            raw_data: bytes.into(),
            ..Default::default()
        });
        self
    }

    /// Adds a constant of integers.
    pub fn ints(self, name: &str, dims: &[usize], values: &[i64]) -> Self {
        let bytes = values.iter().flat_map(|v| v.to_le_bytes()).collect();
        self.constant(name, data_type::INT64, dims, bytes)
    }

    /// Adds a constant of floats.
    pub fn floats(self, name: &str, dims: &[usize], values: &[f32]) -> Self {
        let bytes = values.iter().flat_map(|v| v.to_le_bytes()).collect();
        self.constant(name, data_type::FLOAT, dims, bytes)
    }

    /// Adds an operation with one output, named like the node.
    pub fn node(self, output: &str, op: &str, inputs: &[&str]) -> Self {
        self.node_with(output, op, inputs, &[])
    }

    /// Adds an operation with integer settings; one number is an integer, several are a list.
    pub fn node_with(mut self, output: &str, op: &str, inputs: &[&str], settings: &[(&str, &[i64])]) -> Self {
        let attribute = |(name, values): &(&str, &[i64])| match values {
            // "axes" is a list even if it has only one element.
            [one] if *name != "axes" => {
                AttributeProto { name: (*name).into(), i: *one, ints: vec![], kind: 2 }
            }
            list => AttributeProto { name: (*name).into(), i: 0, ints: list.to_vec(), kind: 7 },
        };
        self.0.node.push(NodeProto {
            input: inputs.iter().map(|name| (*name).to_owned()).collect(),
            output: vec![output.into()],
            name: output.into(),
            op_type: op.into(),
            attribute: settings.iter().map(attribute).collect(),
            domain: String::new(),
        });
        self
    }

    /// Returns the finished file.
    pub fn into_bytes(mut self) -> Vec<u8> {
        self.0.name = "text encoder".into();
        let model = ModelProto {
            ir_version: 8,
            producer_name: "surgtpgs".into(),
            graph: Some(self.0),
            opset_import: vec![OperatorSetId { domain: String::new(), version: 13 }],
        };
        prost::Message::encode_to_vec(&model)
    }
}

fn value_info(name: &str, elem_type: i32, axes: &[Option<i64>]) -> ValueInfoProto {
    let dim = |(i, axis): (usize, &Option<i64>)| Dim {
        value: *axis,
        param: axis.is_none().then(|| ["batch", "sequence", "width", "columns"][i.min(3)].to_owned()),
    };
    let shape = ShapeProto { dim: axes.iter().enumerate().map(dim).collect() };
    let ty = TypeProto { tensor: Some(TensorType { elem_type, shape: Some(shape) }) };
    ValueInfoProto { name: name.into(), ty: Some(ty) }
}
