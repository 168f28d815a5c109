//! Distances of pictures by a model.

#![expect(clippy::unwrap_used, reason = "a test that cannot set itself up should stop")]

#[path = "models/distance.rs"]
mod distance;

use image::{Rgb, RgbImage};
use std::path::PathBuf;
use surgtpgs_clip::{Lpips, graph::Graph, onnx::data_type::FLOAT};

fn file(name: &str, graph: Graph) -> (tempfile::TempDir, PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join(name);
    std::fs::write(&path, graph.into_bytes()).unwrap();
    (folder, path)
}

#[test]
fn the_model_sees_both_pictures_from_minus_one_to_one() {
    let (_folder, path) = file("lpips.onnx", distance::lpips(None));
    let mut lpips = Lpips::open(&path).unwrap();
    let flat = |colour| RgbImage::from_pixel(20, 10, Rgb(colour));
    assert_eq!(lpips.distance(&flat([7; 3]), &flat([7; 3])).unwrap(), 0.0);
    // The stand-in adds the channels' mean differences.
    let distance = lpips.distance(&flat([0, 255, 0]), &flat([255, 255, 51])).unwrap();
    assert!((distance - 2.4).abs() < 1e-5, "{distance}");
    let sizes = lpips.distance(&flat([0; 3]), &RgbImage::new(10, 20)).unwrap_err();
    assert!(sizes.to_string().contains("20×10 and 10×20"), "{sizes}");
}

#[test]
fn other_models_are_refused() {
    let refused = |graph: Graph| {
        let (_folder, path) = file("other.onnx", graph);
        Lpips::open(&path).err().map(|e| e.to_string()).unwrap_or_default()
    };
    let one = refused(one_picture());
    assert!(one.contains("LPIPS takes two float images"), "{one}");
    let same = refused(constant_distance(1.0));
    assert!(same.contains("distance 3.0000 from itself"), "{same}");
    let nothing = refused(constant_distance(f32::NAN));
    assert!(
        nothing.contains("LPIPS model returned not-a-number") && nothing.contains("other.onnx"),
        "{nothing}"
    );
    let (_folder, path) = file("fixed.onnx", distance::lpips(Some(32)));
    let fixed = Lpips::open(&path).unwrap().distance(&RgbImage::new(20, 10), &RgbImage::new(20, 10));
    assert!(fixed.unwrap_err().to_string().contains("32×32 alone, the frames are 20×10"));
}

/// Takes two pictures as LPIPS does, and gives any two the same distance: three times `one`.
fn constant_distance(one: f32) -> Graph {
    let axes = [Some(1), Some(3), None, None];
    Graph::default()
        .input("img1", FLOAT, &axes)
        .input("img2", FLOAT, &axes)
        .output("distance", FLOAT, &[Some(1), Some(1), Some(1), Some(1)])
        .ints("channels", &[1], &[1])
        .floats("one", &[1], &[one])
        .floats("none", &[1], &[0.0])
        .node("both", "Add", &["img1", "img2"])
        .node("means", "GlobalAveragePool", &["both"])
        .node("zeros", "Mul", &["means", "none"])
        .node("ones", "Add", &["zeros", "one"])
        .node_with("distance", "ReduceSum", &["ones", "channels"], &[("keepdims", &[1])])
}

/// A model that takes one picture.
fn one_picture() -> Graph {
    let axes = [Some(1), Some(3), None, None];
    let graph = Graph::default().input("img1", FLOAT, &axes).output("same", FLOAT, &axes);
    graph.node("same", "Identity", &["img1"])
}
