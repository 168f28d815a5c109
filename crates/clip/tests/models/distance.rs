//! A model of LPIPS' contract.

use surgtpgs_clip::{graph::Graph, onnx::data_type::FLOAT};

/// A stand-in for LPIPS: the sum of the channels' mean differences, of squares of `side` pixels or of any
/// size.
pub fn lpips(side: Option<i64>) -> Graph {
    let axes = [Some(1), Some(3), side, side];
    Graph::default()
        .input("img1", FLOAT, &axes)
        .input("img2", FLOAT, &axes)
        .output("distance", FLOAT, &[Some(1), Some(1), Some(1), Some(1)])
        .ints("channels", &[1], &[1])
        .node("apart", "Sub", &["img1", "img2"])
        .node("differences", "Abs", &["apart"])
        .node("means", "GlobalAveragePool", &["differences"])
        .node_with("distance", "ReduceSum", &["means", "channels"], &[("keepdims", &[1])])
}
