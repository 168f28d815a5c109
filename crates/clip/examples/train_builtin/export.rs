//! The trained network as an ONNX file.

use crate::{
    model::{DIM, HIDDEN_1, HIDDEN_2},
    text::{NUM_CHARS, NUM_CODES},
    train::Trained,
};
use half::f16;
use surgtpgs_clip::{
    graph::Graph,
    onnx::data_type::{FLOAT, FLOAT16, INT8, INT16, INT64},
};

/// Writes the file: `input_ids` and `attention_mask` [batch, letters] to `embedding` [batch, DIM]. The
/// table is stored in 8 bits and the layers in 16. The graph widens both.
pub fn onnx(trained: &Trained) -> Vec<u8> {
    let weights = &trained.weights;
    let of_code = trained.rows.of_code.iter().flat_map(|row| (*row as i16).to_le_bytes()).collect();
    let table = weights.table.chunks_exact(HIDDEN_1);
    let steps =
        table.flat_map(|row| row.iter().zip(&trained.table_scale).map(|(v, s)| (v / s).round() as i8 as u8));
    let halves =
        |values: &[f32]| values.iter().flat_map(|v| f16::from_f32(*v).to_le_bytes()).collect::<Vec<u8>>();
    let graph = Graph::default()
        .input("input_ids", INT64, &[None, None])
        .input("attention_mask", INT64, &[None, None])
        .output("embedding", FLOAT, &[None, Some(DIM as i64)])
        .constant("row_of_code", INT16, &[NUM_CODES], of_code)
        .constant("table", INT8, &[trained.rows.count, HIDDEN_1], steps.collect())
        .floats("table_scale", &[HIDDEN_1], &trained.table_scale)
        .floats("bias_0", &[HIDDEN_1], &weights.bias_0)
        .constant("dense_1", FLOAT16, &[HIDDEN_1, HIDDEN_2], halves(&weights.dense_1))
        .floats("bias_1", &[HIDDEN_2], &weights.bias_1)
        .constant("dense_2", FLOAT16, &[HIDDEN_2, DIM], halves(&weights.dense_2))
        .floats("bias_2", &[DIM], &weights.bias_2);
    network(trigram_rows(graph)).into_bytes()
}

/// Adds the part from letters to rows of the table.
fn trigram_rows(graph: Graph) -> Graph {
    graph
        .ints("base", &[1], &[NUM_CHARS as i64])
        .ints("axis_1", &[1], &[1])
        .ints("at_0", &[1], &[0])
        .ints("at_1", &[1], &[1])
        .ints("at_2", &[1], &[2])
        .ints("before_1", &[1], &[-1])
        .ints("before_2", &[1], &[-2])
        .ints("end", &[1], &[i64::from(i32::MAX)])
        .node("first", "Slice", &["input_ids", "at_0", "before_2", "axis_1"])
        .node("second", "Slice", &["input_ids", "at_1", "before_1", "axis_1"])
        .node("third", "Slice", &["input_ids", "at_2", "end", "axis_1"])
        .node("is_real", "Slice", &["attention_mask", "at_2", "end", "axis_1"])
        .node("first_moved", "Mul", &["first", "base"])
        .node("pair", "Add", &["first_moved", "second"])
        .node("pair_moved", "Mul", &["pair", "base"])
        .node("code", "Add", &["pair_moved", "third"])
        .node_with("short_row", "Gather", &["row_of_code", "code"], &[("axis", &[0])])
        .node_with("row", "Cast", &["short_row"], &[("to", &[i64::from(INT64)])])
}

/// Adds the part from rows of the table to the embedding.
fn network(graph: Graph) -> Graph {
    let to_float: &[(&str, &[i64])] = &[("to", &[FLOAT as i64])];
    graph
        .node_with("steps", "Gather", &["table", "row"], &[("axis", &[0])])
        .node_with("steps_wide", "Cast", &["steps"], to_float)
        .node_with("weight", "Cast", &["is_real"], to_float)
        .node("weight_column", "Unsqueeze", &["weight", "at_2"])
        .node("steps_real", "Mul", &["steps_wide", "weight_column"])
        .node_with("steps_sum", "ReduceSum", &["steps_real", "axis_1"], &[("keepdims", &[0])])
        .node("sum", "Mul", &["steps_sum", "table_scale"])
        .node("sum_moved", "Add", &["sum", "bias_0"])
        .node("hidden_1", "Relu", &["sum_moved"])
        .node_with("dense_1_wide", "Cast", &["dense_1"], to_float)
        .node("product_1", "MatMul", &["hidden_1", "dense_1_wide"])
        .node("product_1_moved", "Add", &["product_1", "bias_1"])
        .node("hidden_2", "Relu", &["product_1_moved"])
        .node_with("dense_2_wide", "Cast", &["dense_2"], to_float)
        .node("product_2", "MatMul", &["hidden_2", "dense_2_wide"])
        .node("raw", "Add", &["product_2", "bias_2"])
        .node_with("norm", "ReduceL2", &["raw"], &[("axes", &[1]), ("keepdims", &[1])])
        .node("embedding", "Div", &["raw", "norm"])
}
