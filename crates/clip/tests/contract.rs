//! Encoder folders of every kind, good and broken. Their small ONNX files are made here.

#![expect(clippy::unwrap_used, reason = "a test that cannot set itself up should stop")]

use prost::Message;
use std::{fs, path::Path};
use surgtpgs_clip::{
    TextEncoder,
    graph::Graph,
    onnx::{
        ModelProto,
        data_type::{FLOAT, INT32, INT64},
    },
};
use tempfile::TempDir;

const WORDS: [&str; 9] = ["[PAD]", "[UNK]", "a", "photo", "liver", "needle", "of", "in", "scene"];
const END: usize = 9;

/// A tokenizer of whole words with CLIP's end mark as its largest id.
fn tokenizer() -> String {
    let vocabulary: serde_json::Map<String, serde_json::Value> = WORDS
        .iter()
        .chain(&["<|endoftext|>"])
        .zip(0..)
        .map(|(word, id)| ((*word).to_owned(), id.into()))
        .collect();
    serde_json::json!({
        "version": "1.0", "truncation": null, "padding": null, "added_tokens": [],
        "normalizer": null,
        "pre_tokenizer": {"type": "WhitespaceSplit"},
        "post_processor": {
            "type": "TemplateProcessing",
            "single": [{"Sequence": {"id": "A", "type_id": 0}}, {"SpecialToken": {"id": "<|endoftext|>", "type_id": 0}}],
            "pair": [{"Sequence": {"id": "A", "type_id": 0}}, {"Sequence": {"id": "B", "type_id": 0}}],
            "special_tokens": {"<|endoftext|>": {"id": "<|endoftext|>", "ids": [END], "tokens": ["<|endoftext|>"]}}
        },
        "decoder": null,
        "model": {"type": "WordLevel", "vocab": vocabulary, "unk_token": "[UNK]"}
    })
    .to_string()
}

/// A table whose row i points along axis i, with a little of all others.
fn table(rows: usize, dim: usize) -> Vec<f32> {
    (0..rows * dim).map(|i| if i / dim == i % dim { 1.0 } else { 0.1 }).collect()
}

/// A model of CLIP's shape: ids [b,77], pooled inside at the largest id, [b,dim] out.
fn clip_graph(rows: usize, dim: usize) -> Graph {
    Graph::default()
        .input("input_ids", INT64, &[None, Some(77)])
        .output("text_embeds", FLOAT, &[None, Some(dim as i64)])
        .floats("table", &[rows, dim], &table(rows, dim))
        .ints("one", &[1], &[1])
        .node("hidden", "Gather", &["table", "input_ids"])
        .node_with("end", "ArgMax", &["input_ids"], &[("axis", &[1]), ("keepdims", &[1])])
        .node("end_column", "Unsqueeze", &["end", "two"])
        .ints("two", &[1], &[2])
        .ints("width", &[3], &[1, 1, dim as i64])
        .node("where", "Expand", &["end_column", "width"])
        .node_with("at_end", "GatherElements", &["hidden", "where"], &[("axis", &[1])])
        .node("sum", "ReduceSum", &["hidden", "one"])
        .node("both", "Add", &["at_end", "sum"])
        .node("text_embeds", "Squeeze", &["both", "one"])
}

/// A model that gives hidden states [b,s,dim]: each token's row and the sum of all; no pooling.
fn hidden_graph(ids: i32) -> Graph {
    Graph::default()
        .input("input_ids", ids, &[None, None])
        .input("attention_mask", ids, &[None, None])
        .output("last_hidden_state", FLOAT, &[None, None, Some(10)])
        .floats("table", &[10, 10], &table(10, 10))
        .node("rows", "Gather", &["table", "input_ids"])
        .node_with("mask", "Cast", &["attention_mask"], &[("to", &[FLOAT as i64])])
        .ints("two", &[1], &[2])
        .node("mask_column", "Unsqueeze", &["mask", "two"])
        .node("real", "Mul", &["rows", "mask_column"])
        .ints("one", &[1], &[1])
        .node_with("total", "ReduceSum", &["real", "one"], &[("keepdims", &[1])])
        .node("last_hidden_state", "Add", &["real", "total"])
}

fn folder(model: &[u8], tokenizer: &str, settings: Option<&str>) -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("model.onnx"), model).unwrap();
    fs::write(folder.path().join("tokenizer.json"), tokenizer).unwrap();
    if let Some(settings) = settings {
        fs::write(folder.path().join("encoder.toml"), settings).unwrap();
    }
    folder
}

fn open(model: Graph, settings: Option<&str>) -> Result<TextEncoder, String> {
    open_bytes(&model.into_bytes(), &tokenizer(), settings)
}

fn open_bytes(model: &[u8], tokenizer: &str, settings: Option<&str>) -> Result<TextEncoder, String> {
    TextEncoder::open(folder(model, tokenizer, settings).path()).map_err(|e| e.to_string())
}

#[track_caller]
fn assert_error<T>(result: Result<T, String>, parts: &[&str]) {
    let message = result.err().expect("an error");
    for part in parts {
        assert!(message.contains(part), "{part:?} is not in {message:?}");
    }
}

fn normalised(values: &[f32]) -> Vec<f32> {
    let norm = values.iter().map(|v| v * v).sum::<f32>().sqrt();
    values.iter().map(|v| v / norm).collect()
}

#[track_caller]
fn assert_close(a: &[f32], b: &[f32]) {
    assert_eq!(a.len(), b.len());
    assert!(a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-5), "{a:?}\n{b:?}");
}

#[test]
fn clip_shaped_models_work() {
    let mut encoder = open(clip_graph(10, 512), Some("pooling = \"end_of_text\"")).unwrap();
    assert_eq!((encoder.identity().dim, encoder.context_length()), (512, 77));
    let all = encoder.encode_bare(&["liver", "needle"]).unwrap();
    assert!(all.iter().all(|e| (e.iter().map(|v| v * v).sum::<f32>() - 1.0).abs() < 1e-5));
    assert_ne!(all[0], all[1]);
}

#[test]
fn mean_and_end_of_text_pool_over_real_tokens() {
    let rows = table(10, 10);
    for ids in [INT64, INT32] {
        let mut mean = open(hidden_graph(ids), Some("pooling = \"mean\"")).unwrap();
        let expected: Vec<f32> = (0..10).map(|i| rows[40 + i] + rows[10 * END + i]).collect();
        assert_close(&mean.encode_bare(&["liver"]).unwrap()[0], &normalised(&expected));
    }
    // If encoder.toml names no pooling, CLIP's end mark decides.
    for settings in [None, Some("pooling = \"end_of_text\"")] {
        let mut end = open(hidden_graph(INT64), settings).unwrap();
        let expected: Vec<f32> = (0..10).map(|i| rows[40 + i] + 2.0 * rows[10 * END + i]).collect();
        assert_close(&end.encode_bare(&["liver"]).unwrap()[0], &normalised(&expected));
    }
}

#[test]
fn templates_go_around_prompts_only() {
    let mut encoder = open(clip_graph(10, 16), None).unwrap();
    assert_eq!(encoder.identity().template, "A photo of a {} in the scene");
    let templated = encoder.encode_prompts(&["  liver "]).unwrap();
    assert_eq!(templated, encoder.encode_bare(&["A photo of  a liver in the scene"]).unwrap());
    assert_ne!(templated, encoder.encode_bare(&["liver"]).unwrap());
    assert_error(encoder.encode_prompts(&[" \n "]).map_err(|e| e.to_string()), &["The prompt is empty"]);

    let mut own = open(clip_graph(10, 16), Some("template = \"photo of {}\"")).unwrap();
    assert_eq!(own.encode_prompts(&["liver"]).unwrap(), own.encode_bare(&["photo of liver"]).unwrap());
    assert_error(
        open(clip_graph(10, 16), Some("template = \"a\"")).map(drop).map_err(|e| e.to_string()),
        &["{} 0 times"],
    );
}

#[test]
fn lower_case_is_a_setting() {
    let mut as_is = open(clip_graph(10, 16), None).unwrap();
    let mut lowered = open(clip_graph(10, 16), Some("lower_case = true")).unwrap();
    let liver = as_is.encode_bare(&["liver"]).unwrap();
    assert_ne!(as_is.encode_bare(&["LIVER"]).unwrap(), liver);
    assert_eq!(lowered.encode_bare(&["LIVER"]).unwrap(), liver);
}

#[test]
fn long_prompts_are_refused_not_cut() {
    let mut encoder = open(clip_graph(10, 16), None).unwrap();
    assert!(encoder.encode_bare(&["liver ".repeat(76).as_str()]).is_ok());
    let result = encoder.encode_bare(&["liver ".repeat(77).as_str()]).map_err(|e| e.to_string());
    assert_error(result, &["The prompt has 78 tokens; the encoder reads 77", "Shorten it"]);

    let mut short = open(hidden_graph(INT64), Some("context_length = 5")).unwrap();
    assert!(short.encode_bare(&["a photo of liver"]).is_ok());
    assert!(short.encode_bare(&["a photo of a liver"]).is_err());
    assert_error(
        open(clip_graph(10, 16), Some("context_length = 78")),
        &["context_length 78; the model reads 77"],
    );
}

#[test]
fn identity_follows_every_file() {
    let sha = |rows, settings| open(clip_graph(rows, 16), settings).unwrap().identity().sha256.clone();
    let first = sha(10, None);
    assert_eq!(first.len(), 64);
    assert_eq!(first, sha(10, None));
    assert_ne!(first, sha(11, None));
    assert_ne!(first, sha(10, Some("lower_case = false")));
    let other = tokenizer().replace("scene", "skene");
    let with_other = open_bytes(&clip_graph(10, 16).into_bytes(), &other, None).unwrap();
    assert_ne!(first, with_other.identity().sha256);
}

#[test]
fn encoders_can_move_to_another_thread() {
    fn is_send<T: Send>() {}
    is_send::<TextEncoder>();
}

#[test]
fn missing_files_are_named() {
    let empty = tempfile::tempdir().unwrap();
    let open = |path: &Path| TextEncoder::open(path).map_err(|e| e.to_string());
    assert_error(open(&empty.path().join("none")), &["no such folder"]);
    assert_error(open(empty.path()), &["The text encoder has no model.onnx"]);
    fs::write(empty.path().join("model.onnx"), [1]).unwrap();
    assert_error(open(empty.path()), &["The text encoder has no tokenizer.json"]);
}

#[test]
fn damaged_models_are_named() {
    let whole = clip_graph(10, 16).into_bytes();
    let open = |model: &[u8]| open_bytes(model, &tokenizer(), None);
    assert_error(open(&[]), &["it is empty"]);
    assert_error(open(b"PK\x03\x04 some archive"), &["not a readable ONNX model", "first bytes 50 4b 03 04"]);
    assert_error(open(b"version https://git-lfs.github.com/spec/v1"), &["Git LFS pointer", "git lfs pull"]);
    for kept in [whole.len() / 3, whole.len() / 2, whole.len() - 1] {
        assert_error(open(&whole[..kept]), &["not a readable ONNX model", "cut short"]);
    }
    assert_error(open(&Graph::default().into_bytes()), &["it holds no graph"]);
}

#[test]
fn the_image_encoder_is_recognised() {
    let image = || {
        Graph::default()
            .input("pixel_values", FLOAT, &[Some(1), Some(3), Some(224), Some(224)])
            .output("image_embeds", FLOAT, &[Some(1), Some(4)])
            .node("image_embeds", "Flatten", &["pixel_values"])
    };
    let expected =
        "The model wants input `pixel_values` [1,3,224,224]; a text encoder takes token ids [1,77]";
    assert_error(open(image(), None), &[expected, "You may have picked the image encoder."]);
    let both = image().input("input_ids", INT64, &[None, None]);
    assert_error(open(both, None), &["Export the text half alone, without `pixel_values`."]);
}

#[test]
fn inputs_and_outputs_that_do_not_fit_are_named() {
    let audio = Graph::default().input("audio", FLOAT, &[None, None]).output("y", FLOAT, &[None, None]).node(
        "y",
        "Relu",
        &["audio"],
    );
    assert_error(open(audio, None), &["`audio` [batch,sequence]", "input_ids, attention_mask"]);
    let only_mask = Graph::default()
        .input("attention_mask", INT64, &[None, None])
        .output("y", INT64, &[None, None])
        .node("y", "Identity", &["attention_mask"]);
    assert_error(open(only_mask, None), &["no input for token ids"]);
    let ids_out = Graph::default()
        .input("input_ids", INT64, &[None, None])
        .output("y", INT64, &[None, None])
        .node("y", "Identity", &["input_ids"]);
    assert_error(open(ids_out, None), &["The model gives `y` [batch,sequence]", "float embeddings"]);
    let batch = Graph::default()
        .input("input_ids", INT64, &[Some(8), Some(77)])
        .output("y", FLOAT, &[Some(8), Some(77)])
        .node_with("y", "Cast", &["input_ids"], &[("to", &[FLOAT as i64])]);
    assert_error(open(batch, None), &["fixed number of texts at once: `input_ids` [8,77]"]);
    let named = open(clip_graph(10, 16), Some("pooling = \"output:pooled\""));
    assert_error(named, &["asks for the output `pooled`", "`text_embeds` [batch,16]"]);
}

#[test]
fn a_tokenizer_of_another_model_is_recognised() {
    let too_small = open(clip_graph(9, 16), None);
    assert_error(
        too_small,
        &["Largest token id 9 exceeds the model's embedding table (9)", "do not belong together"],
    );
    assert_error(open(clip_graph(40, 16), None), &["has 40 rows but tokenizer.json knows only 10 tokens"]);
    // All unknown words become one token, so that every prompt would be the same.
    let blind = tokenizer().replace("liver", "leber").replace("needle", "nadel");
    let blind = open_bytes(&clip_graph(10, 16).into_bytes(), &blind, None);
    assert_error(blind, &["\"liver\" and \"needle\" the same embedding"]);
}

#[test]
fn bad_tokenizers_are_explained() {
    let model = clip_graph(10, 16).into_bytes();
    let open = |tokenizer: &str| open_bytes(&model, tokenizer, None);
    assert_error(open("{\n\"version\": "), &["tokenizer.json is not a tokenizer file (line 2"]);
    assert_error(open("{}"), &["it has no field \"model\""]);
    let other_model = tokenizer().replace("WordLevel", "Oracle");
    assert_error(open(&other_model), &["incompatible tokenizers version", "(field \"model\")"]);
    let other_splitter = tokenizer().replace("WhitespaceSplit", "Guess");
    assert_error(open(&other_splitter), &["incompatible tokenizers version", "(field \"pre_tokenizer\")"]);
}

#[test]
fn embeddings_without_direction_are_errors() {
    let model = |value: f32| {
        Graph::default()
            .input("input_ids", INT64, &[None, None])
            .output("text_embeds", FLOAT, &[None, None])
            .floats("value", &[1], &[value])
            .node_with("wide", "Cast", &["input_ids"], &[("to", &[FLOAT as i64])])
            .node("text_embeds", "Mul", &["wide", "value"])
    };
    assert_error(open(model(f32::NAN), None), &["The encoder returned not-a-number for \"liver\""]);
    assert_error(open(model(0.0), None), &["an embedding of zeros for \"liver\""]);
}

#[test]
fn panics_inside_of_a_backend_are_errors() {
    // The table is made by an operation, so that only the look-up shows that it has too few rows.
    let short = |rows: usize| {
        Graph::default()
            .input("input_ids", INT64, &[None, None])
            .output("text_embeds", FLOAT, &[None, None, Some(16)])
            .floats("half", &[rows, 16], &table(rows, 16))
            .node("table", "Add", &["half", "half"])
            .node("text_embeds", "Gather", &["table", "input_ids"])
    };
    let settings = Some("pooling = \"mean\"");
    assert!(open(short(10), settings).is_ok());
    for rows in [1, 9] {
        assert_error(
            open(short(rows), settings),
            &["The encoder failed on \"liver\"", "may not belong together", "model.onnx"],
        );
    }
}

#[test]
fn unknown_settings_are_errors() {
    assert_error(open(clip_graph(10, 16), Some("poling = \"mean\"")), &["encoder.toml", "poling"]);
}

#[test]
fn wrong_operator_sets_are_explained() {
    let mut model = ModelProto::decode(&clip_graph(10, 512).into_bytes()[..]).unwrap();
    model.opset_import[0].version = 99;
    let opened = open_bytes(&model.encode_to_vec(), &tokenizer(), None);
    assert_error(opened, &["ONNX operator set 99", "opset_version=17", "model.onnx"]);
    model.opset_import.clear();
    assert_error(
        open_bytes(&model.encode_to_vec(), &tokenizer(), None),
        &["does not say which ONNX operator set"],
    );
}

#[test]
fn embeddings_are_kept_for_the_next_time() {
    let encoder = folder(&clip_graph(10, 512).into_bytes(), &tokenizer(), None);
    let cache = tempfile::tempdir().unwrap();
    let open = || TextEncoder::open_with_cache(encoder.path(), Some(cache.path())).unwrap();
    let first = open().encode_bare(&["liver"]).unwrap();
    assert_eq!(open().encode_bare(&["liver"]).unwrap(), first);
    // The file gets numbers that the model would never give, to show that they are read from it.
    let kept = cache.path().join(&open().identity().sha256);
    let files: Vec<_> = fs::read_dir(kept).unwrap().map(|file| file.unwrap().path()).collect();
    assert_eq!(files.len(), 2, "the words of the trial run, liver among them");
    for (axis, file) in files.iter().enumerate() {
        let unit: Vec<u8> = (0..512).flat_map(|i| f32::from(i == axis).to_le_bytes()).collect();
        fs::write(file, unit).unwrap();
    }
    let again = open().encode_bare(&["liver"]).unwrap().remove(0);
    assert!(again[0] == 1.0 || again[1] == 1.0, "{:?}", &again[..4]);
}
