//! Tests that the window and the command line export the same files.

use crate::viewer::{
    backend::{
        Backend,
        engine::EngineBackend,
        task::{Task, TaskEvent},
    },
    panels::export::folder_in,
};
use crate::{
    cli,
    engine::{Negatives, Question},
    jobs::{ExportQuestion, ExportRequest},
    settings::PROMPT_COLOURS,
};
use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
};
use surgtpgs_core::{
    export::{ExportOptions, ExportSummary, Format, PictureSource},
    marks::{Canvas, Mark, Marks, Shape},
    mask::CleanUp,
    overlay::{OverlayLook, OverlayStyle},
    palette::Palette,
    relevancy::RelevancySettings,
};

pub(super) fn program(folder: &Path, line: &[&str]) {
    let at = |word: &&str| match word.strip_prefix('@') {
        Some(name) => folder.join(name).display().to_string(),
        None => (*word).to_owned(),
    };
    let words = ["surgtpgs"].iter().chain(line).map(at);
    assert_eq!(cli::run(words), cli::Exit::Done, "{line:?}");
}

fn through_the_window(request: ExportRequest, negatives: Negatives) -> ExportSummary {
    let ctx = egui::Context::default();
    let mut job =
        Task::start("export", &ctx, move |job| EngineBackend::default().export(&request, &negatives, job));
    loop {
        match job.poll() {
            Some(TaskEvent::Done(result)) => return result.unwrap(),
            _ => std::thread::yield_now(),
        }
    }
}

/// Returns names and bytes of everything in a folder.
fn contents(folder: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut found = BTreeMap::new();
    let mut open = vec![folder.to_owned()];
    while let Some(next) = open.pop() {
        for path in std::fs::read_dir(next).unwrap().map(|e| e.unwrap().path()) {
            if path.is_dir() {
                open.push(path);
            } else {
                found.insert(path.strip_prefix(folder).unwrap().to_owned(), std::fs::read(path).unwrap());
            }
        }
    }
    found
}

#[test]
fn the_window_and_the_command_line_write_the_same_bytes() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    program(folder, &["demo", "-o", "@recording", "--width", "64", "--height", "48", "--frames", "4"]);
    program(folder, &["prepare", "@recording", "-o", "@prepared", "--labels"]);
    program(folder, &["train", "@prepared", "-o", "@scene.safetensors", "--iterations", "20"]);
    let names = Format::ALL.map(Format::name).join(",");
    let prompts = ["--prompt", "liver", "bile sac", "--style", "fill", "--opacity", "0.5"];
    let cleaned = ["--smooth", "1", "--fill-holes", "9", "--min-area", "5", "--round", "1", "--grow", "-1"];
    let look = ["--outline-opacity", "0.6", "--palette", "viridis", "--width", "96"];
    let negatives = ["--negative", "smoke", "--but-not", "liver=fat", "--ask-by", "embedding"];
    let export = ["export", "@scene.safetensors", "-o", "@line", "--frames", "1..4", "--format", &names];
    program(folder, &[&export[..], &prompts, &cleaned, &look, &["--above-instruments"], &negatives].concat());

    let standard = RelevancySettings { class_negatives: false, ..Default::default() };
    let negatives = Negatives::of(&standard).with([&"smoke".to_owned()]);
    let own = |text: &str| if text == "liver" { vec!["fat".to_owned()] } else { Vec::new() };
    let prompt = |(text, colour): (&'static str, &[u8; 3])| ExportQuestion {
        question: Question::words(text, negatives.clone().with(&own(text))),
        threshold: RelevancySettings::default().threshold,
        colour: *colour,
        is_instrument: false,
    };
    let request = ExportRequest {
        scene: folder.join("scene.safetensors"),
        folder: folder.join("window"),
        frames: (1..4).collect(),
        questions: ["liver", "bile sac"].into_iter().zip(&PROMPT_COLOURS).map(prompt).collect(),
        marks: Vec::new(),
        options: ExportOptions {
            formats: Format::ALL.into_iter().rev().collect(),
            source: PictureSource::Original,
            look: OverlayLook {
                style: OverlayStyle::Fill,
                opacity: 0.5,
                outline_opacity: 0.6,
                below_instruments: false,
                palette: Palette::Viridis,
                ..OverlayLook::default()
            },
            captions: true,
            width_px: Some(96),
            clean_up: CleanUp {
                smooth_frames: 1,
                fill_holes_px: 9,
                min_area_px: 5,
                round_px: 1,
                grow_px: -1,
            },
            ..ExportOptions::default()
        },
        replace: false,
        completes_same: true,
    };
    let done = through_the_window(request, negatives.clone());
    let record = std::fs::read_to_string(folder.join("window/provenance.json")).unwrap();
    let record: serde_json::Value = serde_json::from_str(&record).unwrap();
    let compared = |k: usize| record["prompts"][k]["negatives"].as_array().unwrap().clone();
    assert_eq!((compared(0), compared(1)), (vec!["smoke".into(), "fat".into()], vec!["smoke".into()]));
    assert_eq!(record["relevancy"]["phrases"][0], "smoke");
    let (line, window) = (contents(&folder.join("line")), contents(&folder.join("window")));
    // The two records, the names of labels, and those for YOLO are not counted.
    assert_eq!(line.len(), done.files + 4);
    assert!(line.keys().eq(window.keys()));
    for (name, bytes) in &line {
        assert!(window[name] == *bytes, "{} differs", name.display());
    }
}

#[test]
fn what_is_marked_is_exported_by_the_window_as_by_the_command_line() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    program(folder, &["demo", "-o", "@recording", "--width", "64", "--height", "48", "--frames", "4"]);
    program(folder, &["train", "@recording", "-o", "@scene.safetensors", "--iterations", "20"]);
    let click = |name: &str, x: f32| {
        let shape = Shape::Click { point_px: [x, 24.0], radius_px: 6.0 };
        Mark::new(1, name, true, shape)
    };
    let canvas = Canvas { width: 64, height: 48, frame_names: Vec::new(), num_frames: 4 };
    let marks = Marks::new(vec![click("grasper", 12.5), click("liver", 50.0)], &canvas).unwrap();
    std::fs::write(folder.join("marks.json"), marks.to_text().unwrap()).unwrap();
    let export = [
        "export",
        "@scene.safetensors",
        "-o",
        "@line",
        "--marks",
        "@marks.json",
        "--format",
        "binary,overlay",
        "--raw",
        "--no-captions",
    ];
    program(folder, &[&export[..], &["--prompt", "grasper", "hepatic tissue"]].concat());

    let standard = RelevancySettings::default();
    let question = |text: &&str| Question::words(*text, Negatives::of(&standard));
    let questions = ["grasper", "hepatic tissue"].iter().map(question).collect();
    let request = ExportRequest {
        scene: folder.join("scene.safetensors"),
        folder: folder.join("window"),
        frames: (0..4).collect(),
        questions: ExportQuestion::with_standard_look(questions, standard.threshold),
        marks: marks.all().to_vec(),
        options: ExportOptions { formats: vec![Format::Binary, Format::Overlay], ..ExportOptions::default() },
        replace: false,
        completes_same: true,
    };
    through_the_window(request, Negatives::of(&standard));
    let (line, window) = (contents(&folder.join("line")), contents(&folder.join("window")));
    assert!(line.len() > 12 && line.keys().eq(window.keys()));
    for (name, bytes) in &line {
        assert!(window[name] == *bytes, "{} differs", name.display());
    }
    let record: serde_json::Value = serde_json::from_slice(&window[Path::new("provenance.json")]).unwrap();
    assert_eq!(record["marks_sha256"], marks.digest());
}

#[test]
fn a_picked_folder_with_something_in_it_gets_a_new_one_inside() {
    let folder = tempfile::tempdir().unwrap();
    assert_eq!(folder_in(folder.path(), "clip"), folder.path());
    std::fs::write(folder.path().join("mine"), "").unwrap();
    assert_eq!(folder_in(folder.path(), "clip"), folder.path().join("clip-export"));
}
