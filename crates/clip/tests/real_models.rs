//! Tests with real models, if the research data is at hand.

#![expect(clippy::print_stderr, reason = "a test says so when it has nothing to test on")]

use std::path::PathBuf;
use surgtpgs_clip::{
    TextEncoder,
    graph::Graph,
    onnx::data_type::{FLOAT, INT64},
};

/// Folder of the research data; prints a note and returns `None` if there is none.
fn data() -> Option<PathBuf> {
    let folder = std::env::var_os("SURGTPGS_DATA").map(PathBuf::from).filter(|folder| folder.is_dir());
    if folder.is_none() {
        eprintln!("skipped: no research data here (set SURGTPGS_DATA)");
    }
    folder
}

fn cosine(a: &[f32], b: &[f32]) -> f32 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

#[test]
fn minilm_gives_its_published_cosines() {
    let Some(data) = data() else { return };
    let mut encoder = TextEncoder::open(&data.join("models/minilm_int8")).unwrap();
    eprintln!("backend: {}", surgtpgs_clip::backend_name());
    let e = encoder.encode_bare(&["a cat", "a kitten", "a car"]).unwrap();
    assert_eq!(encoder.identity().dim, 384);
    assert_eq!(encoder.identity().name, "minilm_int8");
    assert_eq!(encoder.context_length(), 128);
    assert!((cosine(&e[0], &e[1]) - 0.764).abs() < 0.01, "cat/kitten {}", cosine(&e[0], &e[1]));
    assert!((cosine(&e[0], &e[2]) - 0.350).abs() < 0.01, "cat/car {}", cosine(&e[0], &e[2]));
}

/// Runs the tokenizer of CLIP with a model of CLIP's contract that shows the ids it gets.
#[test]
fn clip_tokenizer_gives_clip_ids() {
    let Some(data) = data() else { return };
    for file in ["clip_tokenizer.json", "clip_tokenizer_pad77.json"] {
        let model = Graph::default()
            .input("input_ids", INT64, &[None, Some(77)])
            .output("text_embeds", FLOAT, &[None, Some(77)])
            .node_with("text_embeds", "Cast", &["input_ids"], &[("to", &[FLOAT as i64])]);
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("model.onnx"), model.into_bytes()).unwrap();
        std::fs::copy(data.join("models/clip_tokenizer").join(file), folder.path().join("tokenizer.json"))
            .unwrap();
        let mut encoder = TextEncoder::open(folder.path()).unwrap();
        let mut expected = vec![0.0; 77];
        expected[..7].copy_from_slice(&[49406.0, 320.0, 1125.0, 539.0, 320.0, 2368.0, 49407.0]);
        let got = encoder.encode_bare(&["a photo of a cat"]).unwrap().remove(0);
        assert!(
            (cosine(&got, &expected) / expected.iter().map(|v| v * v).sum::<f32>().sqrt() - 1.0).abs() < 1e-5
        );
        assert_eq!(encoder.context_length(), 77);
    }
}

/// Names of everyday things that the built-in encoder was not trained on stay away from every organ.
#[test]
fn builtin_keeps_everyday_things_apart() {
    let Some(data) = data() else { return };
    let names = std::fs::read_to_string(data.join("models/clip_text_tables/lvis_v1_names.json")).unwrap();
    let names: Vec<String> = serde_json::from_str(&names).unwrap();
    let mut encoder = TextEncoder::builtin().unwrap();
    let classes = ["abdominal wall", "liver", "gallbladder", "fat", "grasper"];
    let pixels = encoder.encode_prompts(&classes).unwrap();
    let phrases = encoder.encode_bare(&["object", "things", "stuff", "texture"]).unwrap();
    let mut near = Vec::new();
    for name in &names {
        let prompt = encoder.encode_prompts(&[name.as_str()]).unwrap().remove(0);
        for (class, pixel) in classes.iter().zip(&pixels) {
            let negative = phrases.iter().map(|n| cosine(n, pixel)).fold(f32::MIN, f32::max);
            if cosine(pixel, &prompt) - negative > -0.0405 {
                near.push(format!("{name} / {class}"));
            }
        }
    }
    near.truncate(40);
    eprintln!("{} of {} everyday names found as a class: {near:?}", near.len(), names.len());
    assert!(near.len() * 50 < names.len());
}
