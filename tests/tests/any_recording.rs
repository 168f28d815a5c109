//! A recording without labels: automatic masks, an image encoder, training, a prompt, an export. The models
//! are small ones with the inputs and outputs of real ones, made here; they compute colour.

use crate::models;
use image::{GrayImage, Rgb, RgbImage};
use std::{fs, path::Path};
use surgtpgs_clip::TextEncoder;
use surgtpgs_tests::{Run, run_in};

const CLASSES: [(&str, Rgb<u8>); 3] =
    [("liver", Rgb([150, 30, 30])), ("fat", Rgb([230, 210, 60])), ("grasper", Rgb([110, 130, 170]))];
const SIZE: (u32, u32) = (96, 64);
const FRAMES: u32 = 10;

fn class_at(frame: u32, x: u32, y: u32) -> usize {
    match (x, y) {
        (30..90, y) if (20 + frame / 4..30 + frame / 4).contains(&y) => 2,
        (_, 0..40) => 0,
        _ => 1,
    }
}

fn write_recording(folder: &Path) {
    fs::create_dir_all(folder).unwrap();
    for frame in 0..FRAMES {
        let picture = RgbImage::from_fn(SIZE.0, SIZE.1, |x, y| CLASSES[class_at(frame, x, y)].1);
        picture.save(folder.join(format!("frame_{frame}.png"))).unwrap();
    }
}

/// Returns the matrix that takes the three colours to the embeddings of their names.
fn colours_to_names() -> Vec<f32> {
    let mut encoder = TextEncoder::builtin().unwrap();
    let names = encoder.encode_prompts(&CLASSES.map(|(name, _)| name)).unwrap();
    let dim = names[0].len();
    let c = CLASSES.map(|(_, colour)| colour.0.map(|v| f64::from(v) / 255.0));
    let cross = |a: [f64; 3], b: [f64; 3]| {
        [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
    };
    let dot = |a: [f64; 3], b: [f64; 3]| a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
    let volume = dot(c[0], cross(c[1], c[2]));
    // Column k of the inverse of the matrix whose rows are the colours.
    let inverse = [cross(c[1], c[2]), cross(c[2], c[0]), cross(c[0], c[1])];
    let value = |channel: usize, j: usize| {
        (0..3).map(|k| inverse[k][channel] / volume * f64::from(names[k][j])).sum::<f64>() as f32
    };
    (0..3).flat_map(|channel| (0..dim).map(move |j| (channel, j))).map(|(c, j)| value(c, j)).collect()
}

fn write_models(folder: &Path) {
    let write = |name: &str, bytes: Vec<u8>| {
        let path = folder.join(name);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(path, bytes).unwrap();
    };
    write("sam/encoder.onnx", models::encoder(&["image_embed", "high_res_feats_0"]).into_bytes());
    write("sam/decoder.onnx", models::sam2_decoder().into_bytes());
    write(
        "clip/model.onnx",
        models::image_encoder(&colours_to_names(), None, &["image_embeds"]).into_bytes(),
    );
    write("clip/encoder.toml", b"mean = [0.0, 0.0, 0.0]\nstd = [1.0, 1.0, 1.0]\n".to_vec());
    write("maps/model.onnx", models::feature_network(&colours_to_names()).into_bytes());
    write("maps/encoder.toml", b"mean = [0.0, 0.0, 0.0]\nstd = [1.0, 1.0, 1.0]\n".to_vec());
    write("depth/model.onnx", models::depth_network("disp", true).into_bytes());
    write("other/model.onnx", models::image_encoder(&[0.5; 15], None, &["image_embeds"]).into_bytes());
}

const PREPARE: [&str; 8] =
    ["prepare", "recording", "-o", "prep", "--masks-model", "sam", "--mask-density", "coarse"];

fn iou(exported: &Path, frame: u32, class: usize) -> f64 {
    let mask: GrayImage = image::open(exported).unwrap().into_luma8();
    let (mut both, mut either) = (0, 0);
    for (x, y, pixel) in mask.enumerate_pixels() {
        let (found, is_there) = (pixel[0] > 0, class_at(frame, x, y) == class);
        both += u32::from(found && is_there);
        either += u32::from(found || is_there);
    }
    f64::from(both) / f64::from(either)
}

#[test]
fn a_recording_without_labels_goes_the_whole_way() {
    let place = tempfile::tempdir().unwrap();
    let run = |args: &[&str]| -> Run { run_in(place.path(), args) };
    write_recording(&place.path().join("recording"));
    write_models(place.path());

    let refused = run(&[&PREPARE[..], &["--image-encoder", "other"]].concat());
    let line = refused.refused(1);
    assert!(line.contains("Image embeddings have 5 values; the text encoder \"builtin\" makes"), "{line}");
    let unlabelled = run(&["prepare", "recording", "-o", "prep", "--labels"]);
    assert!(unlabelled.refused(1).contains("--masks-model"));

    let prepared = run(&[&PREPARE[..], &["--image-encoder", "clip"]].concat()).ok();
    assert!(prepared.stderr.contains("prepared 30 regions of 10 frames"), "{}", prepared.stderr);
    let kept = fs::read(place.path().join("prep/masks/frame_000003.json")).unwrap();
    let again = run(&[&PREPARE[..], &["--image-encoder", "clip", "--force", "--eval"]].concat()).ok();
    assert!(again.stderr.contains("test frames held out"), "{}", again.stderr);
    assert_eq!(fs::read(place.path().join("prep/masks/frame_000003.json")).unwrap(), kept);

    train_and_find(place.path());
}

/// Trains on `prep` and exports what the prompts find.
fn train_and_find(place: &Path) {
    let run = |args: &[&str]| -> Run { run_in(place, args) };
    run(&["train", "prep", "-o", "scene.safetensors", "--iterations", "300"]).ok();
    let names = CLASSES.map(|(name, _)| name);
    let prompts = names.iter().flat_map(|name| ["--prompt", name]);
    let export = ["export", "scene.safetensors", "-o", "out", "--format", "binary", "--exclusive"];
    run(&export.into_iter().chain(prompts).collect::<Vec<_>>()).ok();
    for (class, name) in names.iter().enumerate() {
        let found = iou(&place.join(format!("out/binary/frame_000004_{name}.png")), 4, class);
        assert!(found > 0.75, "{name}: {found}");
    }
}

#[test]
fn clicks_become_masks_before_they_are_carried() {
    let place = tempfile::tempdir().unwrap();
    let run = |args: &[&str]| -> Run { run_in(place.path(), args) };
    write_recording(&place.path().join("recording"));
    write_models(place.path());
    run(&["train", "recording", "-o", "scene.safetensors", "--iterations", "300"]).ok();
    // One click per class, 3 px away from all others.
    let is_inside = |class: usize, x: u32, y: u32| {
        x >= 3
            && y >= 3
            && [0, 3, 6]
                .iter()
                .all(|dx| [0, 3, 6].iter().all(|dy| class_at(0, x + dx - 3, y + dy - 3) == class))
    };
    let click = |(class, (name, _)): (usize, &(&str, Rgb<u8>))| {
        let places = (0..200).flat_map(|y| (0..200).map(move |x| (x, y)));
        let (x, y) = places.into_iter().find(|(x, y)| is_inside(class, *x, *y)).unwrap();
        format!(
            "{{\"frame\": 0, \"name\": \"{name}\", \"kind\": \"click\", \"add\": true, \
             \"points_px\": [[{x}.5, {y}.5]], \"radius_px\": 1}}"
        )
    };
    let clicks: Vec<String> = CLASSES.iter().enumerate().map(click).collect();
    fs::write(place.path().join("marks.json"), format!("{{\"marks\": [{}]}}", clicks.join(", "))).unwrap();
    let export = ["export", "scene.safetensors", "-o", "out", "--format", "binary", "--marks", "marks.json"];
    let prompts: Vec<&str> = CLASSES.iter().flat_map(|(name, _)| ["--prompt", name]).collect();
    run(&[&export[..], &["--marks-model", "sam"], &prompts].concat()).ok();
    for (class, (name, _)) in CLASSES.iter().enumerate() {
        for frame in [0, 4] {
            let found =
                iou(&place.path().join(format!("out/binary/frame_00000{frame}_{name}.png")), frame, class);
            assert!(found > 0.75, "{name} on frame {frame}: {found}");
        }
    }
    let refused = run(&[&export[..], &["--marks-model", "clip", "--force"], &prompts].concat());
    assert!(refused.refused(1).contains("two model files"));
}

#[test]
fn feature_maps_and_estimated_depth_go_the_whole_way() {
    let place = tempfile::tempdir().unwrap();
    write_recording(&place.path().join("recording"));
    write_models(place.path());
    let prepare = ["prepare", "recording", "-o", "prep", "--dense-encoder", "maps", "--depth-model", "depth"];
    let prepared = run_in(place.path(), &prepare).ok();
    assert!(prepared.stderr.contains("estimated depth; the scales of single frames"), "{}", prepared.stderr);
    assert!(place.path().join("prep/depth/frame_000003.npy").is_file());
    let refused = run_in(place.path(), &["prepare", "recording", "-o", "p2", "--dense-encoder", "clip"]);
    assert!(refused.refused(1).contains("`image_embeds`"));
    train_and_find(place.path());
}
