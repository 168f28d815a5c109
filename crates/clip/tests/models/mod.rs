//! Small models of the contracts of Segment Anything, CLIP's image half, feature maps and depth. Masks
//! are pixels of similar colour, embeddings are colours times a matrix, disparity is brightness.

#![allow(dead_code, reason = "not every test needs all of them")]

use surgtpgs_clip::{
    graph::Graph,
    onnx::data_type::{FLOAT, INT64},
};

/// Pixels along each side of the mask models' input.
pub const SIDE: usize = 64;

/// An image encoder whose features, under the names `outputs`, are the picture itself.
pub fn encoder(outputs: &[&str]) -> Graph {
    let side = Some(SIDE as i64);
    let axes = [Some(1), Some(3), side, side];
    let graph = Graph::default().input("image", FLOAT, &axes);
    outputs
        .iter()
        .fold(graph, |graph, name| graph.output(name, FLOAT, &axes).node(name, "Identity", &["image"]))
}

/// Adds the look-up of colours at `point_xy` [n,2], in pixels of the encoder's square: the colours there
/// [n,3,1], and their distances from those of all pixels.
fn colours_at_points(graph: Graph, embedding: &str) -> Graph {
    graph
        .ints("zero", &[], &[0])
        .ints("one", &[], &[1])
        .ints("side", &[], &[SIDE as i64])
        .ints("planes", &[2], &[3, (SIDE * SIDE) as i64])
        .ints("column", &[3], &[-1, 3, 1])
        .ints("channels", &[1], &[1])
        .node("floored", "Floor", &["point_xy"])
        .node_with("cells", "Cast", &["floored"], &[("to", &[INT64 as i64])])
        .node_with("x", "Gather", &["cells", "zero"], &[("axis", &[1])])
        .node_with("y", "Gather", &["cells", "one"], &[("axis", &[1])])
        .node("rows", "Mul", &["y", "side"])
        .node("at", "Add", &["rows", "x"])
        .node("pixels", "Reshape", &[embedding, "planes"])
        .node_with("found", "Gather", &["pixels", "at"], &[("axis", &[1])])
        .node_with("found_rows", "Transpose", &["found"], &[("perm", &[1, 0])])
        .node("asked", "Reshape", &["found_rows", "column"])
        .node("apart", "Sub", &["pixels", "asked"])
        .node("distance", "Abs", &["apart"])
        .node_with("far", "ReduceSum", &["distance", "channels"], &[("keepdims", &[1])])
}

/// Adds ratings, and logits that are positive where the colour is similar to that at the point; `answers`
/// per point.
fn rated(graph: Graph, answers: usize, masks: &str, ratings: &str) -> Graph {
    let reach: Vec<f32> = (0..answers).map(|i| 2.0 + 0.5 * i as f32).collect();
    let rating: Vec<f32> = (0..answers).map(|i| 0.9 + 0.01 * i as f32).collect();
    graph
        .floats("reach", &[1, answers, 1], &reach)
        .floats("rating", &[1, answers], &rating)
        .floats("none", &[1], &[0.0])
        .floats("sharpness", &[1], &[20.0])
        .ints("maps", &[4], &[-1, answers as i64, SIDE as i64, SIDE as i64])
        .node("near", "Sub", &["reach", "far"])
        .node("logits", "Mul", &["near", "sharpness"])
        .node(masks, "Reshape", &["logits", "maps"])
        .node("nothing", "Mul", &["point_xy", "none"])
        .node_with("zeros", "ReduceSum", &["nothing", "channels"], &[("keepdims", &[1])])
        .node(ratings, "Add", &["zeros", "rating"])
}

/// SAM 2 exported with fine features: any number of prompts.
pub fn sam2_decoder() -> Graph {
    let side = Some(SIDE as i64);
    let map = [Some(1), Some(3), side, side];
    let graph = Graph::default()
        .input("image_embed", FLOAT, &map)
        .input("high_res_feats_0", FLOAT, &map)
        .input("point_coords", FLOAT, &[None, None, Some(2)])
        .input("point_labels", FLOAT, &[None, None])
        .input("mask_input", FLOAT, &[None, Some(1), side, side])
        .input("has_mask_input", FLOAT, &[Some(1)])
        .output("masks", FLOAT, &[None, Some(3), side, side])
        .output("iou_predictions", FLOAT, &[None, Some(3)])
        .ints("first", &[], &[0])
        .node_with("point_xy", "Gather", &["point_coords", "first"], &[("axis", &[1])]);
    rated(colours_at_points(graph, "image_embed"), 3, "masks", "iou_predictions")
}

/// A decoder of SAM 2's contract with one answer, which it rates by the largest label of the prompt.
pub fn label_decoder() -> Graph {
    let side = Some(SIDE as i64);
    Graph::default()
        .input("image_embed", FLOAT, &[Some(1), Some(3), side, side])
        .input("high_res_feats_0", FLOAT, &[Some(1), Some(3), side, side])
        .input("point_coords", FLOAT, &[None, None, Some(2)])
        .input("point_labels", FLOAT, &[None, None])
        .output("masks", FLOAT, &[Some(1), Some(1), side, side])
        .output("iou_predictions", FLOAT, &[None, Some(1)])
        .ints("channels", &[1], &[1])
        .node_with("masks", "ReduceSum", &["image_embed", "channels"], &[("keepdims", &[1])])
        .node_with("iou_predictions", "ReduceMax", &["point_labels"], &[("axes", &[1]), ("keepdims", &[1])])
}

/// SAM 1 as `segment_anything` exports it: one prompt, a padding point, the size of the image, and four
/// answers of which the first is for many points.
pub fn sam1_decoder() -> Graph {
    let side = Some(SIDE as i64);
    let graph = Graph::default()
        .input("image_embeddings", FLOAT, &[Some(1), Some(3), side, side])
        .input("point_coords", FLOAT, &[Some(1), None, Some(2)])
        .input("point_labels", FLOAT, &[Some(1), None])
        .input("mask_input", FLOAT, &[Some(1), Some(1), side, side])
        .input("has_mask_input", FLOAT, &[Some(1)])
        .input("orig_im_size", FLOAT, &[Some(2)])
        .output("iou_predictions", FLOAT, &[None, Some(4)])
        .output("low_res_masks", FLOAT, &[None, Some(4), side, side])
        .ints("first", &[], &[0])
        .node_with("point_xy", "Gather", &["point_coords", "first"], &[("axis", &[1])]);
    rated(colours_at_points(graph, "image_embeddings"), 4, "low_res_masks", "iou_predictions")
}

/// An image encoder of CLIP's contract: the mean colour times `matrix` [3, dim].
pub fn image_encoder(matrix: &[f32], batch: Option<i64>, outputs: &[&str]) -> Graph {
    let dim = matrix.len() / 3;
    let graph = Graph::default()
        .input("pixel_values", FLOAT, &[batch, Some(3), Some(32), Some(32)])
        .floats("matrix", &[3, dim], matrix)
        .node("mean", "GlobalAveragePool", &["pixel_values"])
        .node_with("flat", "Flatten", &["mean"], &[("axis", &[1])]);
    outputs.iter().fold(graph, |graph, name| {
        graph.output(name, FLOAT, &[batch, Some(dim as i64)]).node(name, "MatMul", &["flat", "matrix"])
    })
}

/// A network for feature maps: the colour at each of 32 × 32 places times `matrix` [3, dim].
pub fn feature_network(matrix: &[f32]) -> Graph {
    let dim = matrix.len() / 3;
    let weights: Vec<f32> = (0..dim).flat_map(|j| (0..3).map(move |c| matrix[c * dim + j])).collect();
    Graph::default()
        .input("pixel_values", FLOAT, &[Some(1), Some(3), Some(32), Some(32)])
        .output("features", FLOAT, &[Some(1), Some(dim as i64), Some(32), Some(32)])
        .floats("weights", &[dim, 3, 1, 1], &weights)
        .node("features", "Conv", &["pixel_values", "weights"])
}

/// A network whose `output`, a map of the picture's size, is brightness; its values are 0–1 if it ends in
/// a `sigmoid`.
pub fn depth_network(output: &str, sigmoid: bool) -> Graph {
    let axes = |channels: i64| [Some(1), Some(channels), Some(24), Some(32)];
    Graph::default()
        .input("image", FLOAT, &axes(3))
        .output(output, FLOAT, &axes(1))
        .floats("four", &[1], &[4.0])
        .node_with("grey", "ReduceMean", &["image"], &[("axes", &[1]), ("keepdims", &[1])])
        .node("strong", "Mul", &["grey", "four"])
        .node(output, if sigmoid { "Sigmoid" } else { "Identity" }, &["strong"])
}
