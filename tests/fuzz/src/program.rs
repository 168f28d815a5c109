//! Targets that need the whole program: the command line, prompts, folders of encoders, jobs of a
//! batch, and the window's files.

use crate::{Target, expect_words};
use clap::Parser;
use std::{fs, path::Path};
use surgtpgs::{
    cli::{self, Cli},
    viewer::readers,
};
use surgtpgs_clip::TextEncoder;

pub(crate) const TARGETS: [Target; 9] = [
    Target { name: "arguments", run: arguments, seeds: command_lines },
    Target { name: "prompt", run: prompt, seeds: prompts },
    Target { name: "model", run: |bytes| encoder("model.onnx", bytes), seeds: models },
    Target { name: "tokenizer", run: |bytes| encoder("tokenizer.json", bytes), seeds: tokenizers },
    Target { name: "encoder_settings", run: |bytes| encoder("encoder.toml", bytes), seeds: encoder_settings },
    Target { name: "jobs_file", run: |bytes| in_file(bytes, cli::check_jobs_file), seeds: jobs_files },
    Target { name: "session", run: |bytes| in_file(bytes, readers::session), seeds: sessions },
    Target { name: "phases", run: |bytes| readers::phases(&String::from_utf8_lossy(bytes)), seeds: phases },
    Target { name: "preferences", run: |bytes| in_file(bytes, read_preferences), seeds: preferences },
];

const MODEL: &[u8] = include_bytes!("../../../assets/text_encoder/model.onnx");
const TOKENIZER: &[u8] = include_bytes!("../../../assets/text_encoder/tokenizer.json");
const SETTINGS: &[u8] = include_bytes!("../../../assets/text_encoder/encoder.toml");

/// Parses a command line; each line of the bytes is an argument.
fn arguments(bytes: &[u8]) {
    let text = String::from_utf8_lossy(bytes);
    let _ = Cli::try_parse_from(std::iter::once("surgtpgs").chain(text.split('\n')));
}

fn command_lines() -> Vec<Vec<u8>> {
    [
        "train\nrecording\n-o\ns.safetensors\n--iterations\n100\n--seed\n7\n--backend\ncpu",
        "prepare\nrecording\n-o\np\n--labels\n--text-encoder\nfolder\n--eval",
        "query\ns.safetensors\n--prompt\nliver\n--threshold\n0.5\n--frames\n3\n--json",
        "export\ns.safetensors\n--prompt\nliver\n-o\nout\n--format\ncoco",
        "bench\nframe\ns.safetensors\n--frames\n2",
    ]
    .map(|line| line.as_bytes().to_vec())
    .to_vec()
}

/// Encodes a prompt. A prompt is words; whatever it is, its embedding is of unit length.
fn prompt(bytes: &[u8]) {
    thread_local!(static ENCODER: std::cell::RefCell<Option<TextEncoder>> = std::cell::RefCell::new(TextEncoder::builtin().ok()));
    let text = String::from_utf8_lossy(bytes);
    ENCODER.with_borrow_mut(|encoder| {
        let Some(encoder) = encoder else { panic!("the built-in text encoder does not load") };
        if let Some(rows) = expect_words(encoder.encode_prompts(&[&text])) {
            let length = rows[0].iter().map(|v| v * v).sum::<f32>();
            assert!((length - 1.0).abs() < 1e-3, "an embedding of squared length {length}");
        }
    });
}

fn prompts() -> Vec<Vec<u8>> {
    ["gallbladder", "a photo of the liver, please", "", "été 肝臓 🫀\u{202e}\u{0}\u{7f}", "({[<&\"'%s\\"]
        .map(|text| text.as_bytes().to_vec())
        .to_vec()
}

/// Opens the built-in encoder's folder with one of its files replaced, and asks it.
fn encoder(file: &str, bytes: &[u8]) {
    let folder = crate::recordings::scratch();
    for (name, good) in [("model.onnx", MODEL), ("tokenizer.json", TOKENIZER), ("encoder.toml", SETTINGS)] {
        write(&folder.path().join(name), if name == file { bytes } else { good });
    }
    let Some(mut encoder) = expect_words(TextEncoder::open(folder.path())) else { return };
    if let Some(rows) = expect_words(encoder.encode_prompts(&["liver"])) {
        assert!(rows[0].iter().all(|v| v.is_finite()), "an embedding that is not finite");
    }
}

fn write(path: &Path, bytes: &[u8]) {
    let written = fs::write(path, bytes);
    assert!(written.is_ok(), "{}: {written:?}", path.display());
}

fn models() -> Vec<Vec<u8>> {
    vec![MODEL.to_vec()]
}

fn tokenizers() -> Vec<Vec<u8>> {
    vec![TOKENIZER.to_vec()]
}

fn encoder_settings() -> Vec<Vec<u8>> {
    vec![
        SETTINGS.to_vec(),
        b"template = \"a photo of {}\"\ncontext_length = 16\npooling = \"mean\"\n".to_vec(),
    ]
}

/// Lets `read` read a file of these bytes.
fn in_file(bytes: &[u8], read: fn(&Path) -> surgtpgs_core::Result<()>) {
    let folder = crate::recordings::scratch();
    let file = folder.path().join("file");
    write(&file, bytes);
    expect_words(read(&file));
}

fn read_preferences(file: &Path) -> surgtpgs_core::Result<()> {
    readers::preferences(file);
    Ok(())
}

fn jobs_files() -> Vec<Vec<u8>> {
    vec![
        include_bytes!("../../../assets/batch/jobs.toml").to_vec(),
        b"output = \"out\"\n[defaults]\nlabels = true\nprompt = [\"liver\"]\n[[recording]]\npath = \"a\"\n\
          iterations = 100\n[[recording]]\nname = \"b\"\npath = \"../b\"\n"
            .to_vec(),
    ]
}

fn sessions() -> Vec<Vec<u8>> {
    let small = r#"{"version": 1, "opened": "scene.safetensors"}"#;
    let large = r#"{"version": 1, "opened": "/a/scene.safetensors", "content": {"prompts": [{"text": "liver",
        "colour": [1, 2, 3], "is_visible": false, "threshold": 0.45, "synonyms": ["hepar"]}], "bookmarks":
        [{"frame": 7, "note": "clip"}], "range": [2, 9]}, "display": {"opacity": 0.5, "wipe": 0.25, "look": {}},
        "time": {"frame": 3, "speed": -2.0, "repeats": false}, "earlier_prompts": ["fat"], "reviewed_by": "two"}"#;
    [small, large].map(|text| text.as_bytes().to_vec()).to_vec()
}

fn phases() -> Vec<Vec<u8>> {
    let lines = "Frame\tPhase\n0\tPreparation\n1\tPreparation\n2\tClippingCutting\n";
    let table =
        "phase,first_frame_from_1,last_frame_from_1,start_s,end_s\n\"a, b\",1,20,0.0,0.8\nc,21,30,0.8,1.2\n";
    [lines, table].map(|text| text.as_bytes().to_vec()).to_vec()
}

fn preferences() -> Vec<Vec<u8>> {
    let text = r#"{"is_acknowledged": true, "opacity": 0.5, "scale_percent": 120, "recent": ["/a/b"],
        "remembers_files": true, "keys": {"PlayPause": "Ctrl+Shift+V", "Bookmark": "F1"}}"#;
    vec![text.as_bytes().to_vec(), b"{}".to_vec()]
}
