//! Networks that give maps of whole pictures, depth and features. Their small ONNX files are made here.

#![expect(clippy::unwrap_used, reason = "a test that cannot set itself up should stop")]

#[path = "models/damaged.rs"]
mod damaged;
mod models;

use damaged::with_constant;
use image::{Rgb, RgbImage};
use models::{depth_network, feature_network};
use std::fs;
use surgtpgs_clip::{DepthNetwork, FeatureNetwork, graph::Graph, onnx::data_type::FLOAT};
use surgtpgs_core::{Result, sequence::DepthKind};
use tempfile::TempDir;

fn folder(model: Graph, settings: &str) -> TempDir {
    folder_of(&model.into_bytes(), settings)
}

fn folder_of(model: &[u8], settings: &str) -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("model.onnx"), model).unwrap();
    for name in ["depth.toml", "encoder.toml"] {
        fs::write(folder.path().join(name), settings).unwrap();
    }
    folder
}

fn depth(model: Graph, settings: &str) -> Result<DepthNetwork> {
    DepthNetwork::open(folder(model, settings).path())
}

/// A picture that is dark on the left and bright on the right.
fn picture() -> RgbImage {
    RgbImage::from_fn(64, 48, |x, _| if x < 32 { Rgb([51; 3]) } else { Rgb([204; 3]) })
}

#[track_caller]
fn assert_error<T>(result: Result<T>, parts: &[&str]) {
    let message = result.err().expect("an error").to_string();
    for part in parts {
        assert!(message.contains(part), "{part:?} is not in {message:?}");
    }
}

#[test]
fn a_sigmoid_is_spread_over_its_range() {
    let spread = |settings: &str| {
        let mut network = depth(depth_network("disp", true), settings).unwrap();
        assert_eq!(network.kind(), DepthKind::Disparity);
        let map = network.estimate(&picture()).unwrap();
        assert_eq!((map.width, map.height), (32, 24));
        [map.at(2, 12), map.at(30, 12)]
    };
    let sigmoid = |v: f32| 1.0 / (1.0 + (-4.0 * v).exp());
    for (settings, [near, far]) in [("", [0.1, 150.0]), ("range = [1.0, 20.0]", [1.0, 20.0])] {
        for (found, brightness) in spread(settings).iter().zip([0.2, 0.8]) {
            let expected = 1.0 / far + (1.0 / near - 1.0 / far) * sigmoid(brightness);
            assert!((found - expected).abs() < 1e-3, "{settings}: {found}, expected {expected}");
        }
    }
}

#[test]
fn other_values_are_taken_as_they_are() {
    let mut network = depth(depth_network("predicted", false), "kind = \"depth\"").unwrap();
    assert_eq!(network.kind(), DepthKind::Depth);
    let map = network.estimate(&picture()).unwrap();
    assert!((map.at(2, 12) - 0.8).abs() < 1e-5 && (map.at(30, 12) - 3.2).abs() < 1e-5);
    let file = folder(depth_network("disp", true), "");
    assert!(DepthNetwork::open(&file.path().join("model.onnx")).is_ok(), "the file itself will do");
}

#[test]
fn depth_networks_that_are_none_are_explained() {
    let open = |settings: &str| depth(depth_network("predicted", false), settings);
    assert_error(open(""), &["`predicted` is depth or disparity", "kind = \"depth\"", "model.onnx"]);
    assert_error(open("kind = \"deep\""), &["depth.toml could not be read"]);
    assert_error(open("range = [2.0, 1.0]"), &["[nearest, farthest]"]);
    let picture = [Some(1), Some(3), Some(24), Some(32)];
    let pair = Graph::default()
        .input("left", FLOAT, &picture)
        .input("right", FLOAT, &picture)
        .output("disparity", FLOAT, &picture)
        .node("disparity", "Sub", &["left", "right"]);
    assert_error(
        depth(pair, ""),
        &["`left` [1,3,24,32], `right`", "stereo pairs are unsupported", "`depth/`"],
    );
    let stacked = [Some(1), Some(6), Some(24), Some(32)];
    let stacked = Graph::default().input("pair", FLOAT, &stacked).output("disparity", FLOAT, &stacked).node(
        "disparity",
        "Relu",
        &["pair"],
    );
    assert_error(depth(stacked, ""), &["`pair` [1,6,24,32]", "stereo pairs are unsupported"]);
    let channels = Graph::default().input("image", FLOAT, &picture).output("disp", FLOAT, &picture).node(
        "disp",
        "Relu",
        &["image"],
    );
    assert_error(depth(channels, ""), &["gives the shape [1, 3, 24, 32]", "[1,1,rows,columns]"]);
}

#[test]
fn every_place_of_a_picture_gets_its_features() {
    let plain = "mean = [0.0, 0.0, 0.0]\nstd = [1.0, 1.0, 1.0]\n";
    let matrix = [1.0, 0.0, 0.0, 2.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0];
    let mut network = FeatureNetwork::open(folder(feature_network(&matrix), plain).path()).unwrap();
    assert_eq!(network.dim(), 4);
    let map = network.map(&picture()).unwrap();
    assert_eq!((map.width, map.height, map.dim), (32, 32, 4));
    for (place, shade) in [(16 * 32 + 2, 0.2), (16 * 32 + 30, 0.8)] {
        let found = &map.values[4 * place..][..4];
        let expected = [shade, shade, shade, 2.0 * shade];
        assert!(found.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-5), "{found:?}");
    }
    let flat = models::image_encoder(&matrix, Some(1), &["image_embeds"]);
    let error = FeatureNetwork::open(folder(flat, "").path());
    assert_error(error, &["The model gives `image_embeds` [1,4]", "[1,dim,rows,columns]"]);
}

#[test]
fn depth_may_be_unknown_at_some_places() {
    let axes = |channels: i64| [Some(1), Some(channels), Some(24), Some(32)];
    let root = Graph::default()
        .input("image", FLOAT, &axes(3))
        .output("disp", FLOAT, &axes(1))
        .node_with("grey", "ReduceMean", &["image"], &[("axes", &[1]), ("keepdims", &[1])])
        .node("disp", "Sqrt", &["grey"]);
    let mut network = depth(root, "mean = [0.5, 0.5, 0.5]\nrange = [1.0, 20.0]\n").unwrap();
    let map = network.estimate(&picture()).unwrap();
    assert!(map.at(2, 12).is_nan() && map.at(30, 12).is_finite(), "the dark half has no root");
}

#[test]
fn numbers_that_are_not_finite_are_errors() {
    for value in [f32::NAN, f32::INFINITY] {
        let depth = folder_of(&with_constant(depth_network("disp", false), "four", value), "");
        assert_error(
            DepthNetwork::open(depth.path()),
            &["The depth network returned not-a-number", "float32 export", "model.onnx"],
        );
        let features = folder_of(&with_constant(feature_network(&[1.0; 12]), "weights", value), "");
        assert_error(
            FeatureNetwork::open(features.path()),
            &["The network for feature maps returned not-a-number", "model.onnx"],
        );
    }
}
