//! Long recordings: trained, joined, asked and exported chapter by chapter.

use std::{fs, path::Path, process::Stdio};
use surgtpgs_tests::{command_in, run_in, signal, start_until_training};

const TRAIN: [&str; 8] =
    ["train", "prepared", "--chapter-frames", "8", "--iterations", "40", "--backend", "cpu"];

fn train(folder: &Path, args: &[&str]) -> surgtpgs_tests::Run {
    run_in(folder, &[&TRAIN[..], args].concat())
}

/// A small prepared recording of three chapters.
fn place() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let demo =
        ["demo", "-o", "recording", "--width", "64", "--height", "48", "--frames", "20", "--wandering"];
    run_in(folder.path(), &demo).ok();
    run_in(folder.path(), &["prepare", "recording", "-o", "prepared", "--labels", "--eval"]).ok();
    folder
}

fn names(folder: &Path) -> Vec<String> {
    let entries = fs::read_dir(folder).unwrap();
    let mut names: Vec<String> = entries.map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
    names.retain(|name| !name.starts_with('.'));
    names.sort();
    names
}

#[test]
fn chapters_as_jobs_of_their_own_in_one_process_or_interrupted_come_to_the_same_bytes() {
    let place = place();
    let folder = place.path();
    let report = train(folder, &["-o", "scene.safetensors", "--json"]).ok().json();
    assert_eq!((&report["chapters"], &report["steps"]), (&3.into(), &120.into()));
    assert_eq!(names(folder), ["prepared", "recording", "scene.safetensors"]);
    let scene = fs::read(folder.join("scene.safetensors")).unwrap();
    for chapter in ["2", "0", "1"] {
        train(folder, &["-o", &format!("part{chapter}.safetensors"), "--chapter", chapter]).ok();
    }
    let parts = ["part1.safetensors", "part0.safetensors", "part2.safetensors"];
    run_in(folder, &[&["join", "-o", "joined.safetensors"][..], &parts].concat()).ok();
    assert!(fs::read(folder.join("joined.safetensors")).unwrap() == scene);
    let some = run_in(folder, &["join", "-o", "some.safetensors", parts[0], "--json"]).ok().json();
    assert_eq!((&some["chapters"], &some["missing_frames"]), (&1.into(), &13.into()));
    let not_shown = serde_json::json!([[0, 5], [13, 19]]);
    let asked = ["query", "some.safetensors", "--prompt", "liver", "--backend", "cpu", "--json"];
    let measured = ["eval", "some.safetensors", "recording", "--backend", "cpu", "--json"];
    for line in [&asked[..], &measured] {
        let run = run_in(folder, line).ok();
        assert!(run.stderr.contains("note: 13 frames are shown by no chapter: 0–5, 13–19"), "{}", run.stderr);
        assert_eq!(run.json()["frames_not_shown"], not_shown);
    }
    let export = ["export", "some.safetensors", "--prompt", "liver", "-o", "labels", "--format", "yolo"];
    run_in(folder, &export).ok();
    assert_eq!(names(&folder.join("labels/yolo")).len(), 7 + 1, "labels of frames, and data.yaml");
    let error = train(folder, &["-o", "part3.safetensors", "--chapter", "3"]);
    assert!(error.refused(1).contains("there is no chapter 3; the recording has 3"));
}

#[test]
fn a_training_that_is_refused_takes_nothing_of_an_earlier_one() {
    let place = place();
    let folder = place.path();
    let kept = "scene.chapter-0000.safetensors";
    train(folder, &["-o", kept, "--chapter", "0"]).ok();
    let anew = train(folder, &["-o", "scene.safetensors", "--force", "--chapter", "99"]);
    assert!(anew.refused(1).contains("there is no chapter 99; the recording has 3"));
    assert_eq!(names(folder), ["prepared", "recording", kept]);
    train(folder, &["-o", "scene.safetensors", "--force"]).ok();
    assert_eq!(names(folder), ["prepared", "recording", "scene.safetensors"]);
}

#[test]
fn chapters_as_jobs_of_a_batch_come_to_the_same_bytes_as_the_batch_alone() {
    let place = place();
    let folder = place.path();
    let jobs = "[defaults]\neval = true\nlabels = true\nchapter_frames = 8\niterations = 40\nbackend = \"cpu\"\n\
                [[recording]]\npath = \"recording\"\n";
    for name in ["alone", "apart"] {
        fs::write(folder.join(format!("{name}.toml")), jobs).unwrap();
    }
    let batch = |args: &[&str]| run_in(folder, &[&["batch"], args].concat());
    batch(&["alone.toml", "--step", "prepare,train"]).ok();
    let one = ["apart.toml", "--only", "recording"];
    let of_one = |args: &[&str]| batch(&[&one[..], args].concat());
    let early = of_one(&["--chapter", "0"]);
    assert!(early.refused(1).contains("train needs the result of prepare"));
    of_one(&["--step", "prepare"]).ok();
    let counted = of_one(&["--count-chapters", "--json"]).ok().json();
    assert_eq!(counted["chapters"], 3);
    // A workflow starts them together.
    let start = |chapter: &str| {
        let line = [&["batch"][..], &one, &["--chapter", chapter]].concat();
        command_in(folder).args(line).stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap()
    };
    for mut chapter in ["2", "0"].map(start) {
        assert!(chapter.wait().unwrap().success());
    }
    let again = of_one(&["--chapter", "0"]).ok();
    assert!(again.stderr.contains("chapter 0 is done"), "{}", again.stderr);
    let error = of_one(&["--chapter", "3"]);
    assert!(error.refused(1).contains("there is no chapter 3; the recording has 3"));
    let made = |name: &str| folder.join("apart/recording").join(name).metadata().and_then(|m| m.modified());
    let part = made("scene.chapter-0002.safetensors").unwrap();
    let log = of_one(&["--step", "train"]).ok();
    assert!(!log.stderr.contains("unfinished") && part < made("scene.safetensors").unwrap());
    let scenes =
        ["alone", "apart"].map(|name| fs::read(folder.join(name).join("recording/scene.safetensors")));
    let [alone, apart] = scenes.map(Result::unwrap);
    assert!(alone == apart);
    assert!(!names(&folder.join("apart/recording")).iter().any(|name| name.contains("chapter-")));
}

#[cfg(unix)]
#[test]
fn a_chapter_of_other_settings_that_was_stopped_is_not_gone_on_with() {
    let place = place();
    let folder = place.path();
    let write = |iterations: u32| {
        let defaults = "chapter_frames = 8\nbackend = \"cpu\"";
        let jobs = format!("[[recording]]\npath = \"recording\"\n{defaults}\niterations = {iterations}\n");
        fs::write(folder.join("jobs.toml"), jobs).unwrap();
    };
    let batch = ["batch", "jobs.toml", "--only", "recording"];
    let first = [&batch[..], &["--chapter", "0"]].concat();
    write(5000);
    let mut child = start_until_training(folder, &first, 1);
    signal(&child, "-TERM");
    assert_eq!(child.wait().unwrap().code(), Some(1));
    let made = folder.join("jobs/recording");
    assert!(made.join("scene.chapter-0000.unfinished").exists());

    let part = "jobs/recording/scene.chapter-0000.safetensors";
    let some = run_in(folder, &["join", part, "-o", "some.safetensors", "--json"]).ok();
    assert_eq!(some.json()["unfinished_chapters"], 1);
    assert!(some.stderr.contains("of 5000 steps"), "{}", some.stderr);

    write(6);
    run_in(folder, &first).ok();
    let some = run_in(folder, &["join", part, "-o", "some.safetensors", "--force", "--json"]).ok();
    assert_eq!(some.json()["unfinished_chapters"], 0);
    run_in(folder, &[&batch[..], &["--step", "train"]].concat()).ok();
    assert!(!names(&made).iter().any(|name| name.contains("chapter-")));
    assert!(fs::read_to_string(made.join("steps/train.json")).unwrap().contains("\"steps\": 18"));
}

#[cfg(unix)]
#[test]
fn a_killed_training_goes_on_with_the_chapter_it_was_in() {
    let place = place();
    let folder = place.path();
    // Enough steps that it is not over before it is killed.
    let longer = TRAIN.map(|arg| if arg == "40" { "600" } else { arg });
    run_in(folder, &[&longer[..], &["-o", "scene.safetensors"]].concat()).ok();
    let args = [&longer[..], &["-o", "again.safetensors"]].concat();
    let mut child = start_until_training(folder, &args, 1);
    while !folder.join("again.chapter-0000.safetensors").exists() {
        std::thread::sleep(std::time::Duration::from_millis(10));
    }
    signal(&child, "-KILL");
    child.wait().unwrap();
    assert!(!folder.join("again.safetensors").exists(), "it was over already");
    let error = train(folder, &["-o", "again.safetensors"]);
    assert!(error.refused(1).contains("unfinished"));
    run_in(folder, &["train", "prepared", "-o", "again.safetensors", "--resume", "--backend", "cpu"]).ok();
    let [scene, again] = ["scene", "again"].map(|name| fs::read(folder.join(format!("{name}.safetensors"))));
    assert!(scene.unwrap() == again.unwrap());
    assert_eq!(names(folder), ["again.safetensors", "prepared", "recording", "scene.safetensors"]);
}

#[test]
fn a_scene_in_chapters_is_asked_exported_measured_and_converted_as_any_other() {
    let place = place();
    let folder = place.path();
    train(folder, &["-o", "scene.safetensors"]).ok();
    let scene = "scene.safetensors";
    let found = run_in(folder, &["query", scene, "--prompt", "liver", "--json"]).ok().json();
    assert_eq!(found["prompts"][0]["frames"].as_array().unwrap().len(), 20);
    // One mark is carried through all chapters, and only what is asked is looked at.
    let mark = r#"{"marks": [{"frame": 1, "name": "suture", "kind": "click", "add": true, "points_px": [[20, 20]]}]}"#;
    fs::write(folder.join("marks.json"), mark).unwrap();
    let suture = ["query", scene, "--prompt", "suture", "--marks", "marks.json", "--json", "--frames"];
    for (asked, frames) in [("4..6", 4..6), ("15..18", 15..18)] {
        let found = run_in(folder, &[&suture[..], &[asked]].concat()).ok().json();
        let frame = found["look_here"]["frame"].as_u64().unwrap();
        assert!(frames.contains(&frame), "{found}");
    }
    run_in(folder, &["export", scene, "--prompt", "liver", "-o", "export"]).ok();
    run_in(folder, &["eval", scene, "prepared", "-o", "quality"]).ok();
    run_in(folder, &["convert", scene, "small.safetensors", "--quantize"]).ok();
    run_in(folder, &["convert", scene, "frame.ply", "--frame", "19"]).ok();
    run_in(folder, &["convert", scene, "frames", "--frames", "4..9"]).ok();
    let page = run_in(folder, &["convert", scene, "page.html", "--prompt", "liver"]);
    assert!(page.refused(1).contains("holds one chapter, and the scene has 3"));
    run_in(folder, &["convert", scene, "page.html", "--prompt", "liver", "--chapter", "2"]).ok();
    let sizes = [scene, "small.safetensors"].map(|name| folder.join(name).metadata().unwrap().len());
    assert!(sizes[1] < sizes[0], "{sizes:?}");
    // The same picture of the last chapter in every form.
    for name in [scene, "small.safetensors"] {
        let out = format!("pictures of {name}");
        run_in(folder, &["render", name, "-o", &out, "--frames", "18..20"]).ok();
        assert!(folder.join(out).join("colour/frame_000019.png").is_file());
    }
}
