//! Mask models and image encoders of every contract, good and broken. Their small ONNX files are made here.

#![expect(clippy::unwrap_used, reason = "a test that cannot set itself up should stop")]

#[path = "models/damaged.rs"]
mod damaged;
mod models;

use damaged::with_constant;
use image::{Rgb, RgbImage};
use models::{SIDE, encoder, image_encoder, label_decoder, sam1_decoder, sam2_decoder};
use std::{fs, path::Path};
use surgtpgs_clip::{
    ImageEncoder, SegmentAnything,
    graph::Graph,
    onnx::data_type::{FLOAT, INT64},
};
use surgtpgs_core::{
    grid::{Grid, Mask},
    mask,
    progress::unobserved,
    segment::{
        BitMask, FrameMasks, Level, MaskSettings, PointSegmenter, Pointed, automatic_masks, pointed_mask,
    },
};
use tempfile::TempDir;

fn folder(files: &[(&str, Vec<u8>)]) -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    files.iter().for_each(|(name, bytes)| fs::write(folder.path().join(name), bytes).unwrap());
    folder
}

fn sam2() -> TempDir {
    let encoder = encoder(&["image_embed", "high_res_feats_0"]);
    folder(&[("b.onnx", encoder.into_bytes()), ("a.onnx", sam2_decoder().into_bytes())])
}

const LIVER: Rgb<u8> = Rgb([150, 30, 30]);
const FAT: Rgb<u8> = Rgb([230, 220, 60]);
const TOOL: Rgb<u8> = Rgb([120, 130, 150]);

/// A picture wider than high: fat below, liver above, and a tool across.
fn picture() -> RgbImage {
    RgbImage::from_fn(96, 64, |x, y| match (x, y) {
        (30..90, 20..30) => TOOL,
        (_, 0..40) => LIVER,
        _ => FAT,
    })
}

fn pixels_of(colour: Rgb<u8>) -> Mask {
    Grid::from_vec(96, 64, picture().pixels().map(|p| *p == colour).collect())
}

fn masks_of(model: &mut SegmentAnything, settings: &MaskSettings) -> FrameMasks {
    let keep = Grid::filled(96, 64, true);
    automatic_masks(model, &picture(), &keep, settings, &mut unobserved).unwrap()
}

#[track_caller]
fn assert_everything_is_found(masks: &FrameMasks) {
    for colour in [LIVER, FAT, TOOL] {
        let truth = pixels_of(colour);
        let ious = masks.level(Level::Default).iter().filter_map(|f| mask::iou(&f.mask.to_mask(), &truth));
        let best = ious.fold(0.0, f64::max);
        // The tool is 10 pixels high and a value of the network's map covers 1.5 pixels. Pixels at its
        // border are of mixed colours.
        assert!(best > if colour == TOOL { 0.75 } else { 0.9 }, "{colour:?} {best}");
    }
}

#[test]
fn sam2_is_recognised_and_finds_what_is_there() {
    let folder = sam2();
    let mut model = SegmentAnything::open(folder.path()).unwrap();
    assert_eq!((model.generation(), model.batch() > 1), ("SAM 2", true));
    assert_eq!(model.earlier_size(), Some([SIDE; 2]));
    assert_eq!(model.features(), None, "there is no picture yet");
    let masks = masks_of(&mut model, &MaskSettings { min_region_px: 10, ..MaskSettings::of_grid(8) });
    assert_everything_is_found(&masks);
    assert!(model.network_time().iter().all(|t| !t.is_zero()));
}

#[test]
fn sam1_is_recognised_and_finds_what_is_there() {
    let folder = folder(&[
        ("encoder.onnx", encoder(&["image_embeddings"]).into_bytes()),
        ("decoder.onnx", sam1_decoder().into_bytes()),
    ]);
    let mut model = SegmentAnything::open(folder.path()).unwrap();
    assert_eq!((model.generation(), model.batch()), ("SAM 1", 1));
    let prediction = {
        model.set_image(&picture()).unwrap();
        model.predict(&[vec![[45.0, 25.0]]], None).unwrap()
    };
    assert_eq!((prediction.masks_per_prompt, prediction.size), (3, [SIDE; 2]));
    assert!(prediction.extent[0] == 1.0 && (prediction.extent[1] - 64.0 / 96.0).abs() < 1e-6, "padded below");
    assert!((prediction.predicted_iou[0] - 0.91).abs() < 1e-5, "the answer for many points is left out");
    let earlier = vec![1.0; SIDE * SIDE];
    let again = model.predict(&[vec![[45.0, 25.0]]], Some(&earlier)).unwrap();
    assert_eq!(again.logits, prediction.logits, "this one makes nothing of it");
    let features = model.features().unwrap();
    let rows = (SIDE * 64).div_ceil(96);
    assert_eq!((features.width, features.height, features.dim), (SIDE, rows, 3), "without the padding");
    assert_everything_is_found(&masks_of(
        &mut model,
        &MaskSettings { min_region_px: 10, ..MaskSettings::of_grid(8) },
    ));
}

#[test]
fn one_object_is_found_at_a_point_and_in_a_box() {
    let folder = sam2();
    let mut model = SegmentAnything::open(folder.path()).unwrap();
    model.set_image(&picture()).unwrap();
    for place in [Pointed::Point([50.0, 25.0]), Pointed::Box([[88.0, 29.0], [31.0, 21.0]])] {
        let found = pointed_mask(&mut model, [96, 64], place).unwrap().unwrap();
        let iou = mask::iou(&found.to_mask(), &pixels_of(TOOL)).unwrap();
        assert!(iou > 0.75, "{place:?}: {iou}");
    }
}

#[test]
fn corners_of_a_box_are_told_from_points_on_an_object() {
    let encoder = encoder(&["image_embed", "high_res_feats_0"]).into_bytes();
    let folder = folder(&[("a.onnx", encoder), ("b.onnx", label_decoder().into_bytes())]);
    let mut model = SegmentAnything::open(folder.path()).unwrap();
    model.set_image(&picture()).unwrap();
    let several = vec![[3.0, 4.0], [5.0, 6.0], [7.0, 8.0]];
    assert_eq!(model.predict(&[several], None).unwrap().predicted_iou, [1.0]);
    assert_eq!(model.predict_box([[3.0, 4.0], [50.0, 60.0]]).unwrap().predicted_iou, [3.0]);
}

#[test]
fn questions_need_an_image() {
    let folder = sam2();
    let mut model = SegmentAnything::open(folder.path()).unwrap();
    assert!(
        model.predict(&[vec![[1.0, 1.0]]], None).unwrap_err().to_string().contains("before it had an image")
    );
}

#[test]
fn numbers_that_are_not_finite_are_errors() {
    for constant in ["reach", "rating"] {
        let encoder = encoder(&["image_embed", "high_res_feats_0"]).into_bytes();
        let folder =
            folder(&[("a.onnx", encoder), ("b.onnx", with_constant(sam2_decoder(), constant, f32::NAN))]);
        let mut model = SegmentAnything::open(folder.path()).unwrap();
        model.set_image(&picture()).unwrap();
        let expected =
            ["The mask decoder returned not-a-number", folder.path().file_name().unwrap().to_str().unwrap()];
        assert_error(model.predict(&[vec![[1.0, 1.0]]], None), &expected);
    }
    let image = with_constant(image_encoder(&MATRIX, None, &["image_embeds"]), "matrix", f32::NAN);
    let image = folder(&[("model.onnx", image)]);
    assert_error(
        ImageEncoder::open(image.path()),
        &["The image encoder returned not-a-number", "model.onnx"],
    );
}

#[track_caller]
fn assert_error<T>(result: surgtpgs_core::Result<T>, parts: &[&str]) {
    let message = result.err().expect("an error").to_string();
    for part in parts {
        assert!(message.contains(part), "{part:?} is not in {message:?}");
    }
}

#[test]
fn mask_folders_that_are_none_are_explained() {
    let open = |files: &[(&str, Vec<u8>)]| SegmentAnything::open(folder(files).path());
    let (encoder_a, decoder) = (|| encoder(&["image_embed"]).into_bytes(), || sam2_decoder().into_bytes());
    assert_error(SegmentAnything::open(Path::new("/nowhere/sam")), &["no such folder with models for masks"]);
    assert_error(open(&[("only.onnx", encoder_a())]), &["two model files, an encoder and a decoder, not 1"]);
    assert_error(
        open(&[("a.onnx", encoder_a()), ("b.onnx", encoder_a())]),
        &["Both models read images", "`image` [1,3,64,64]"],
    );
    assert_error(open(&[("a.onnx", decoder()), ("b.onnx", decoder())]), &["Neither model reads images"]);
    assert_error(
        open(&[("a.onnx", encoder_a()), ("b.onnx", decoder())]),
        &["nothing the encoder makes", "`high_res_feats_0`"],
    );
    let cut = |mut bytes: Vec<u8>| {
        bytes.truncate(bytes.len() - 9);
        bytes
    };
    assert_error(open(&[("a.onnx", encoder_a()), ("b.onnx", cut(decoder()))]), &["cut short", "b.onnx"]);
    let not_points = Graph::default()
        .input("image_embed", FLOAT, &[Some(1), Some(3), Some(64), Some(64)])
        .output("depth", FLOAT, &[Some(1), Some(3), Some(64), Some(64)])
        .node("depth", "Identity", &["image_embed"]);
    assert_error(
        open(&[("a.onnx", encoder(&["image_embed", "b"]).into_bytes()), ("b.onnx", not_points.into_bytes())]),
        &["Both models read images"],
    );
}

#[test]
fn the_format_of_onnx_runtime_needs_its_library() {
    let ort = [&[0x14, 0, 0, 0][..], b"ORTM", &[0; 40]].concat();
    let result = SegmentAnything::open(folder(&[("a.ort", ort.clone()), ("b.ort", ort)]).path());
    let message = result.err().expect("an error").to_string();
    let expected =
        if surgtpgs_clip::backend_name().starts_with("tract") { "ORT_DYLIB_PATH" } else { "could not load" };
    assert!(message.contains(expected), "{message}");
}

/// Matrix that makes four numbers from red, green and blue.
const MATRIX: [f32; 12] = [1.0, 0.0, 0.0, 0.5, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0];
/// Settings that do not change colours, so that black adds nothing.
const PLAIN: &str = "mean = [0.0, 0.0, 0.0]\nstd = [1.0, 1.0, 1.0]\n";

fn open_image(model: Graph, settings: &str) -> surgtpgs_core::Result<ImageEncoder> {
    ImageEncoder::open(
        folder(&[("model.onnx", model.into_bytes()), ("encoder.toml", settings.as_bytes().to_vec())]).path(),
    )
}

fn expected(colour: Rgb<u8>) -> Vec<f32> {
    let [r, g, b] = colour.0.map(f32::from);
    let row = [r, g, b, 0.5 * r];
    let norm = row.iter().map(|v| v * v).sum::<f32>().sqrt();
    row.iter().map(|v| v / norm).collect()
}

#[test]
fn only_what_the_mask_shows_is_encoded() {
    let colours = [LIVER, FAT, TOOL];
    let masks: Vec<BitMask> = colours.iter().map(|c| BitMask::of(&pixels_of(*c)).unwrap()).collect();
    let masks: Vec<&BitMask> = masks.iter().collect();
    for batch in [None, Some(1), Some(2)] {
        let mut encoder = open_image(image_encoder(&MATRIX, batch, &["image_embeds"]), PLAIN).unwrap();
        assert_eq!(encoder.dim(), 4);
        let rows = encoder.embed(&picture(), &masks).unwrap();
        for (row, colour) in rows.iter().zip(colours) {
            let apart = row.iter().zip(expected(colour)).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
            assert!(apart < 1e-4, "{batch:?} {colour:?}: {row:?}");
        }
    }
}

#[test]
fn cut_outs_are_centred_in_a_black_square() {
    // One output per pixel of the 32 × 32 image: the sum over channels.
    let model = Graph::default()
        .input("pixel_values", FLOAT, &[None, Some(3), Some(32), Some(32)])
        .output("image_embeds", FLOAT, &[None, Some(1024)])
        .ints("channels", &[1], &[1])
        .node_with("grey", "ReduceSum", &["pixel_values", "channels"], &[("keepdims", &[1])])
        .node_with("image_embeds", "Flatten", &["grey"], &[("axis", &[1])]);
    let mut encoder = open_image(model, PLAIN).unwrap();
    let tool = BitMask::of(&pixels_of(TOOL)).unwrap();
    let row = encoder.embed(&picture(), &[&tool]).unwrap().remove(0);
    // 60 × 10 pixels in a square of 60: rows 25 to 34 of 60 are lit, which is 13.3 to 18.7 of 32.
    for y in 0..32 {
        let lit = row[y * 32..(y + 1) * 32].iter().all(|v| *v > 0.0);
        assert_eq!(lit, (13..19).contains(&y), "row {y}");
    }
}

#[test]
fn image_encoders_that_are_none_are_explained() {
    let text = Graph::default()
        .input("input_ids", INT64, &[None, Some(77)])
        .output("text_embeds", FLOAT, &[None, Some(77)])
        .node_with("text_embeds", "Cast", &["input_ids"], &[("to", &[FLOAT as i64])]);
    assert_error(open_image(text, ""), &["`input_ids` [?,77]", "You may have picked the text encoder."]);
    let maps = Graph::default()
        .input("pixel_values", FLOAT, &[None, Some(3), Some(32), Some(32)])
        .output("maps", FLOAT, &[None, Some(3), Some(32), Some(32)])
        .node("maps", "Relu", &["pixel_values"]);
    assert_error(open_image(maps, ""), &["The model gives `maps` [?,3,32,32]", "[batch,dim]"]);
    let open = |settings: &str| open_image(image_encoder(&MATRIX, None, &["a", "b"]), settings);
    assert!(open("output = \"b\"").is_ok());
    assert_error(open("output = \"c\""), &["asks for the output `c`", "`a` [?,4]"]);
    assert_error(open("std = [1.0, 0.0, 1.0]"), &["not a usable number"]);
    assert_error(open("sise = 3"), &["encoder.toml could not be read", "sise"]);
    assert_error(ImageEncoder::open(sam2().path()), &["one model file, an image encoder, not 2"]);
    let unknown = Graph::default()
        .input("pixel_values", FLOAT, &[None, Some(3), Some(32), Some(32)])
        .output("image_embeds", FLOAT, &[None, Some(3)])
        .node("mean", "FancyPool", &["pixel_values"])
        .node_with("image_embeds", "Flatten", &["mean"], &[("axis", &[1])]);
    assert_error(
        open_image(unknown, ""),
        &["uses the operator FancyPool (operator set 13), which", "model.onnx"],
    );
    let blind = Graph::default()
        .input("pixel_values", FLOAT, &[None, Some(3), Some(32), Some(32)])
        .output("image_embeds", FLOAT, &[None, Some(3)])
        .floats("zero", &[1], &[0.0])
        .floats("one", &[3], &[1.0, 1.0, 1.0])
        .node("mean", "GlobalAveragePool", &["pixel_values"])
        .node_with("flat", "Flatten", &["mean"], &[("axis", &[1])])
        .node("nothing", "Mul", &["flat", "zero"])
        .node("image_embeds", "Add", &["nothing", "one"]);
    assert_error(open_image(blind, ""), &["a red and a blue picture the same embedding"]);
}
