use serde_json::{Value, json};
use surgtpgs_tests::{Flow, flow, run_in};

/// Writes marks into the flow's folder and returns the file's name.
fn file(name: &str, marks: &Value) -> String {
    std::fs::write(flow().path().join(name), json!({ "marks": marks }).to_string()).unwrap();
    name.to_owned()
}

/// Trains a scene without features, once.
fn bare() -> &'static str {
    static BARE: std::sync::Once = std::sync::Once::new();
    BARE.call_once(|| {
        flow().run(&["train", "recording", "-o", "marked.safetensors", "--iterations", "200"]).ok();
    });
    "marked.safetensors"
}

/// Returns marks of every class on frame 5: mask pictures made from its labels, beside the marks. They are
/// written once, since tests run beside each other.
fn masks() -> &'static Value {
    static MASKS: std::sync::OnceLock<Value> = std::sync::OnceLock::new();
    MASKS.get_or_init(write_masks)
}

fn write_masks() -> Value {
    let flow = flow();
    let read = |name: &str| std::fs::read_to_string(flow.path().join(name)).unwrap();
    let classes: Value = serde_json::from_str(&read("recording/labels.json")).unwrap();
    let mut labels: Vec<_> = std::fs::read_dir(flow.path().join("recording/labels"))
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .collect();
    labels.sort();
    let labels = image::open(&labels[5]).unwrap().into_luma8();
    let mark = |class: &Value| {
        let (id, name) = (class["id"].as_u64().unwrap() as u8, class["name"].as_str().unwrap());
        let mask = image::GrayImage::from_fn(labels.width(), labels.height(), |x, y| {
            image::Luma([if labels.get_pixel(x, y)[0] == id { 255 } else { 0 }])
        });
        let file = format!("{}.png", name.replace(' ', "-"));
        mask.save(flow.path().join(&file)).unwrap();
        json!({ "frame": 5, "name": name, "kind": "mask", "mask": file })
    };
    classes.as_array().unwrap().iter().map(mark).collect()
}

#[test]
fn marks_of_one_frame_are_found_on_all_and_scored() {
    let (scene, marks) = (bare(), file("eval-marks.json", masks()));
    let run = flow().run(&["eval", scene, "recording", "--marks", &marks, "--json"]).ok();
    let report = run.json();
    assert_eq!(report["frames"], Flow::FRAMES - 1, "{report}");
    for name in ["liver", "gallbladder"] {
        let iou = report["iou"]["paper"]["classes"][name].as_f64().unwrap();
        assert!(iou > 0.7, "{name}: {report}");
    }
}

#[test]
fn classes_that_nobody_marked_are_named_beside_their_scores() {
    let liver: Value =
        masks().as_array().unwrap().iter().filter(|mark| mark["name"] == "liver").cloned().collect();
    let (scene, marks) = (bare(), file("liver-alone.json", &liver));
    let run = flow().run(&["eval", scene, "recording", "--marks", &marks, "--json"]).ok();
    let report = run.json();
    let unmarked: Vec<&str> = report["classes_without_masks"]
        .as_array()
        .unwrap()
        .iter()
        .map(|name| name.as_str().unwrap())
        .collect();
    assert!(unmarked.contains(&"gallbladder") && !unmarked.contains(&"liver"), "{report}");
    assert!(run.stderr.contains(&format!("note: no marks of {}: ", unmarked.join(", "))), "{}", run.stderr);
}

#[test]
fn with_marks_held_out_frames_alone_are_measured() {
    let marks = file("held-out-marks.json", masks());
    let line = ["eval", "scene.safetensors", "recording", "--marks", &marks];
    let report = flow().run(&[&line[..], &["--json"]].concat()).ok().json();
    assert_eq!((&report["frames"], &report["held_out"]), (&json!(2), &json!(true)), "{report}");
    assert_eq!(report["classes_without_masks"], json!([]), "the scene knows its classes by itself");
    assert!(flow().run(&line).ok().stdout.starts_with("2 held-out frames"));
}

#[test]
fn words_find_what_was_marked_and_nothing_else() {
    let (scene, marks) = (bare(), file("query-marks.json", masks()));
    let line = ["query", scene, "--marks", &marks, "--prompt", "liver", "hepar", "spaceship", "--json"];
    let report = flow().run(&line).ok().json();
    let found = |k: usize| {
        let frames = report["prompts"][k]["frames"].as_array().unwrap();
        frames.iter().filter(|f| f["found"] == true).count()
    };
    assert_eq!([found(0), found(1), found(2)], [Flow::FRAMES, Flow::FRAMES, 0], "{report}");
    assert_ne!(report["look_here"]["frame"], 5, "{report}");
    assert_eq!(
        [0, 1, 2].map(|k| report["prompts"][k]["needs_mark"] == true),
        [false, false, true],
        "{report}"
    );
    let asked = ["query", scene, "--marks", &marks, "--prompt", "liver", "spaceship"];
    let csv = flow().run(&[&asked[..], &["--frames", "3", "--csv"]].concat()).ok().stdout;
    let ends: Vec<Vec<&str>> =
        csv.lines().skip(1).map(|line| line.rsplitn(3, ',').take(2).collect()).collect();
    assert_eq!(ends, [["false", "false"], ["false", "true"]], "not understood, needs a mark: {csv}");
    let text = flow().run(&asked).ok().stdout;
    assert!(text.contains("look here") && text.contains("cannot be looked for: mark it by hand"), "{text}");
}

#[test]
fn marks_correct_the_prompt_of_a_scene_and_no_other() {
    let everything = json!([{ "frame": 5, "name": "liver", "kind": "box", "add": false, "points_px": [[0, 0], [64, 48]] }]);
    let marks = file("corrections.json", &everything);
    let areas = |more: &[&str]| {
        let line = ["query", "scene.safetensors", "--prompt", "liver", "fat", "--json"];
        let report = flow().run(&[&line[..], more].concat()).ok().json();
        [0, 1].map(|k| {
            let frames = report["prompts"][k]["frames"].as_array().unwrap();
            frames.iter().map(|f| f["area_px"].as_u64().unwrap()).collect::<Vec<_>>()
        })
    };
    let ([liver, fat], [corrected, untouched]) = (areas(&[]), areas(&["--marks", &marks]));
    assert!(liver.iter().all(|px| *px > 0) && fat == untouched, "{fat:?} {untouched:?}");
    assert_eq!(corrected[5], 0, "{corrected:?}");
    assert!(corrected.iter().sum::<u64>() * 2 < liver.iter().sum(), "{liver:?} {corrected:?}");
}

#[test]
fn exports_are_marks_again() {
    let (scene, marks) = (bare(), file("export-marks.json", masks()));
    let line =
        ["export", scene, "--marks", &marks, "--prompt", "liver", "-o", "marked", "--format", "coco,binary"];
    flow().run(&line).ok();
    let record = std::fs::read_to_string(flow().path().join("marked/provenance.json")).unwrap();
    let record: Value = serde_json::from_str(&record).unwrap();
    assert_eq!(record["marks_sha256"].as_str().map(str::len), Some(64), "{record}");
    let coco = flow().at("marked/coco/frames_000000-000009.json");
    let report = flow().run(&["query", scene, "--marks", &coco, "--prompt", "liver", "--json"]).ok().json();
    let found = report["prompts"][0]["frames"].as_array().unwrap().iter().filter(|f| f["found"] == true);
    assert_eq!(found.count(), Flow::FRAMES, "{report}");
}

#[test]
fn a_recording_is_prepared_from_marks_alone() {
    let marks = file("prepare-marks.json", masks());
    flow().run(&["prepare", "recording", "-o", "prepared-marks", "--marks", &marks]).ok();
    let train = ["train", "prepared-marks", "-o", "by-marks.safetensors", "--iterations", "200"];
    flow().run(&train).ok();
    let ask = ["query", "by-marks.safetensors", "--prompt", "liver", "spaceship"];
    let report = flow().run(&[&ask[..], &["--json"]].concat()).ok().json();
    let found = report["prompts"][0]["frames"].as_array().unwrap().iter().filter(|f| f["found"] == true);
    assert_eq!(found.count(), Flow::FRAMES, "{report}");
    let needs_mark = [0, 1].map(|k| report["prompts"][k]["needs_mark"] == true);
    assert_eq!(needs_mark, [false, true], "what was marked is no list of all that there is: {report}");
    let text = flow().run(&ask).ok().stdout;
    assert!(text.contains("cannot be looked for: mark it by hand"), "{text}");
}

#[test]
fn a_bad_mark_is_refused_by_its_name() {
    let scene = bare();
    let marks = json!([
        { "frame": 0, "name": "liver", "kind": "click", "points_px": [[3, 3]] },
        { "frame": 77, "name": "fat", "kind": "click", "points_px": [[3, 3]] },
    ]);
    let marks = file("bad-marks.json", &marks);
    for line in [
        vec!["query", scene, "--prompt", "liver", "--marks", &marks],
        vec!["eval", scene, "recording", "--marks", &marks],
        vec!["export", scene, "--prompt", "liver", "-o", "refused", "--marks", &marks],
        vec!["prepare", "recording", "-o", "refused", "--marks", &marks],
    ] {
        let run = run_in(flow().path(), &line);
        let message = run.refused(1);
        assert!(message.contains("marks[1] (\"fat\" on frame 77)"), "{message}");
        assert!(message.contains("bad-marks.json"), "{message}");
    }
    assert!(!flow().path().join("refused").exists());
}
