use std::{fs, path::Path};
use surgtpgs_tests::{Run, flow, run_in};

fn picture(path: &Path, width: u32, height: u32) {
    let image = image::RgbImage::from_fn(width, height, |x, y| image::Rgb([100 + x as u8, 60 + y as u8, 50]));
    image.save(path).unwrap();
}

/// Creates a folder of `n` pictures in which one thing is then broken.
fn pictures(n: usize) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    for i in 0..n {
        picture(&folder.path().join(format!("frame_{i:03}.png")), 64, 48);
    }
    folder
}

fn train(folder: &Path) -> Run {
    let out = tempfile::tempdir().unwrap();
    let scene = out.path().join("scene.safetensors").display().to_string();
    run_in(folder, &["train", ".", "-o", &scene, "--iterations", "10"])
}

#[test]
fn a_missing_path_is_named() {
    let folder = tempfile::tempdir().unwrap();
    for args in [
        &["check", "gone"][..],
        &["train", "gone", "-o", "s.safetensors"],
        &["prepare", "gone", "-o", "p", "--labels"],
        &["query", "gone", "--prompt", "liver"],
        &["render", "gone", "-o", "r"],
        &["export", "gone", "--prompt", "liver", "-o", "e"],
        &["eval", "gone", "gone"],
        &["view", "gone"],
    ] {
        assert!(run_in(folder.path(), args).refused(1).contains("gone"), "{args:?}");
    }
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0, "nothing is left behind");
}

#[test]
fn an_empty_folder_is_no_recording() {
    let folder = tempfile::tempdir().unwrap();
    run_in(folder.path(), &["check", "."]).refused(1);
    train(folder.path()).refused(1);
    let json = run_in(folder.path(), &["check", ".", "--json"]);
    assert_eq!((json.code, json.json()["ok"].clone()), (1, false.into()));
    assert_eq!(json.json()["errors"].as_array().unwrap().len(), 1);
}

#[test]
fn frames_of_mixed_sizes_are_refused_by_name() {
    let folder = pictures(5);
    picture(&folder.path().join("frame_003.png"), 32, 48);
    assert!(train(folder.path()).refused(1).contains("32"));
    assert_eq!(run_in(folder.path(), &["check", "."]).code, 1);
}

#[test]
fn an_unreadable_picture_is_refused_by_name() {
    let folder = pictures(5);
    fs::write(folder.path().join("frame_003.png"), b"not a picture").unwrap();
    assert!(train(folder.path()).refused(1).contains("frame_003"));
    let report = run_in(folder.path(), &["check", ".", "--json"]);
    assert_eq!(report.code, 1);
    assert!(report.stdout.contains("frame_003"), "{report:#?}");
}

#[test]
fn a_truncated_picture_is_refused_by_name() {
    let folder = pictures(5);
    let path = folder.path().join("frame_003.png");
    let bytes = fs::read(&path).unwrap();
    fs::write(&path, &bytes[..bytes.len() / 2]).unwrap();
    assert!(train(folder.path()).refused(1).contains("frame_003"));
}

#[test]
fn a_picture_that_says_it_is_huge_is_refused_before_anything_is_made_for_it() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("frame_000.jpg");
    picture(&path, 64, 48);
    let mut bytes = fs::read(&path).unwrap();
    // Start of frame: marker, length, precision, then rows and columns.
    let frame = bytes.windows(2).position(|marker| marker == [0xff, 0xc0]).unwrap();
    bytes[frame + 5..frame + 9].fill(0xff);
    fs::write(&path, bytes).unwrap();
    assert!(train(folder.path()).refused(1).contains("65535×65535"));
    assert_eq!(run_in(folder.path(), &["check", "."]).code, 1);
}

/// Runs the program with at most this many bytes of memory (address space).
#[cfg(target_os = "linux")]
fn within(bytes: u64, folder: &Path, args: &[&str]) -> Run {
    let mut limited = std::process::Command::new("prlimit");
    limited.arg(format!("--as={bytes}")).arg("--").arg(surgtpgs_tests::binary()).args(args);
    let output = limited.current_dir(folder).env_remove("DISPLAY").output().unwrap();
    output.into()
}

#[cfg(target_os = "linux")]
#[test]
fn what_does_not_fit_into_memory_is_refused_before_the_work() {
    let folder = tempfile::tempdir().unwrap();
    let recording = folder.path().join("large");
    fs::create_dir(&recording).unwrap();
    image::RgbImage::new(4096, 4096).save(recording.join("frame_000.png")).unwrap();
    let two_gb = 2_000_000_000;
    let train = ["train", "large", "-o", "s.safetensors", "--iterations", "1"];
    assert!(within(two_gb, folder.path(), &train).refused(3).contains("training on 4096×4096 pixels takes"));
    let scene = flow().at("scene.safetensors");
    let render = |width| within(two_gb, folder.path(), &["render", &scene, "-o", "r", "--width", width]);
    assert!(render("8192").refused(3).contains("MB of memory"));
    assert!(!folder.path().join("r").exists());
    render("128").ok();
}

#[cfg(target_os = "linux")]
#[test]
fn no_limit_on_memory_ends_in_a_crash() {
    let folder = tempfile::tempdir().unwrap();
    let [scene, recording, prepared] =
        ["scene.safetensors", "recording", "prepared"].map(|name| flow().at(name));
    let verbs: [&[&str]; 7] = [
        &["check", &recording],
        &["prepare", &recording, "-o", "prep", "--labels", "--force"],
        &["train", &prepared, "-o", "s.safetensors", "--iterations", "3", "--backend", "cpu"],
        &["query", &scene, "--prompt", "liver"],
        &["export", &scene, "--prompt", "liver", "-o", "out", "--force"],
        &["convert", &scene, "out.ply", "--force"],
        &["render", &scene, "-o", "pictures", "--force"],
    ];
    for kib in [200_000, 280_000, 327_680, 400_000, 600_000, 1_000_000, 2_000_000] {
        for verb in verbs {
            let _ = fs::remove_file(folder.path().join("s.safetensors"));
            let run = within(kib * 1024, folder.path(), verb);
            let is_told = run.code == 3 && run.stderr.contains("memory");
            assert!(run.code == 0 || is_told, "{verb:?} within {kib} KiB: {run:#?}");
        }
    }
}

#[cfg(unix)]
#[test]
fn a_name_that_leaves_no_room_for_the_work_beside_it_is_refused_before() {
    let (folder, prepared) = (tempfile::tempdir().unwrap(), flow().at("prepared"));
    let train = |name: &str| {
        let args = ["train", &prepared, "-o", name, "--iterations", "3", "--backend", "cpu"];
        run_in(folder.path(), &args)
    };
    let run = train(&"n".repeat(250));
    assert!(run.refused(1).contains("too long") && !run.stderr.contains("training"), "{run:#?}");
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0);
    train(&format!("{}.safetensors", "n".repeat(243))).ok();
}

#[cfg(unix)]
#[test]
fn names_that_turn_text_round_are_shown_as_they_are() {
    let folder = tempfile::tempdir().unwrap();
    let name = "clip\u{202e}gpj.exe";
    let run = run_in(folder.path(), &["check", name]);
    assert!(run.refused(1).contains(r"clip\u{202e}gpj.exe") && !run.stderr.contains('\u{202e}'), "{run:#?}");
    let run = run_in(folder.path(), &["check", name, "--json"]);
    assert!(run.stdout.contains(r"\u202e") && !run.stdout.contains('\u{202e}'), "{run:#?}");
}

#[test]
fn a_scene_cut_short_is_refused_at_any_length() {
    let folder = tempfile::tempdir().unwrap();
    let whole = fs::read(flow().at("scene.safetensors")).unwrap();
    for length in [0, 1, 7, 8, 9, 100, whole.len() / 2, whole.len() - 1] {
        fs::write(folder.path().join("cut.safetensors"), &whole[..length]).unwrap();
        let run = run_in(folder.path(), &["query", "cut.safetensors", "--prompt", "liver"]);
        assert!(run.refused(1).contains("cut.safetensors"), "{length} bytes");
    }
    fs::write(folder.path().join("text.safetensors"), b"{\"hello\": 1}").unwrap();
    run_in(folder.path(), &["render", "text.safetensors", "-o", "r"]).refused(1);
}

#[test]
fn bad_text_encoders_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let scene = flow().at("scene.safetensors");
    let encoder = folder.path().join("encoder");
    let query =
        || run_in(folder.path(), &["query", &scene, "--prompt", "liver", "--text-encoder", "encoder"]);
    query().refused(1);
    fs::create_dir(&encoder).unwrap();
    query().refused(1);
    fs::write(encoder.join("model.onnx"), b"\x08\x08\x12\x07pytorch\x1a").unwrap();
    query().refused(1);
    fs::write(encoder.join("tokenizer.json"), b"{\"version\": \"1.0\", \"model\": 7}").unwrap();
    query().refused(1);
    let prepare = ["prepare", &flow().at("recording"), "-o", "p", "--labels", "--text-encoder", "encoder"];
    run_in(folder.path(), &prepare).refused(1);
    assert!(!folder.path().join("p").exists(), "nothing half-made is left");
}

#[test]
fn prompts_must_have_words() {
    flow().run(&["query", "scene.safetensors", "--prompt", "  "]).refused(2);
}

#[test]
fn another_recording_is_not_the_scenes() {
    let folder = pictures(5);
    let run = run_in(folder.path(), &["eval", &flow().at("scene.safetensors"), "."]);
    assert!(run.refused(1).contains("not the scene's recording"));
}

#[test]
fn a_recording_that_is_not_there_is_said_to_be_missing() {
    for args in [
        &["query", "scene.safetensors", "--prompt", "liver", "--sequence", "gone"][..],
        &["export", "scene.safetensors", "--prompt", "liver", "-o", "never", "--sequence", "gone"],
        &["eval", "scene.safetensors", "gone"],
    ] {
        let run = flow().run(args);
        let message = run.refused(1);
        assert!(message.contains("there is no such recording") && message.contains("gone"), "{message}");
    }
}

#[test]
fn a_recording_without_labels_cannot_be_prepared_from_labels() {
    let folder = pictures(5);
    let run = run_in(folder.path(), &["prepare", ".", "-o", "../never-written", "--labels"]);
    assert!(run.refused(1).contains("label"));
}

#[test]
fn folders_with_other_content_are_not_written_into() {
    let flow = flow();
    assert!(flow.run(&["demo", "-o", "recording"]).refused(1).contains("another demo recording"));
    let into = flow.run(&["prepare", "recording", "-o", "recording", "--labels"]);
    assert!(into.refused(1).contains("inputs are never written to"));
    assert!(flow.run(&["prepare", "recording", "-o", "prepared", "--labels"]).refused(1).contains("--force"));
}

#[cfg(unix)]
#[test]
fn a_place_that_cannot_be_written_is_refused_before_the_work() {
    // A file where a folder is needed: unlike permissions, this stops the superuser too.
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("file"), b"").unwrap();
    let at = |name: &str| folder.path().join("file").join(name).display().to_string();
    let flow = flow();
    let (scene, output) = (flow.at("scene.safetensors"), at("x"));
    let run = flow.run(&["train", "prepared", "-o", &output]);
    assert!(!run.stderr.contains("training"), "{run:#?}");
    run.refused(1);
    flow.run(&["render", &scene, "-o", &output]).refused(1);
    flow.run(&["export", &scene, "--prompt", "liver", "-o", &output]).refused(1);
    flow.run(&["demo", "-o", &output]).refused(1);
    flow.run(&["prepare", "recording", "-o", &output, "--labels"]).refused(1);
}

#[cfg(target_os = "linux")]
#[test]
fn a_full_disk_is_one_plain_message() {
    let flow = flow();
    // A limit on the size of files stands in for a disk that fills up.
    let script = "ulimit -f 4; exec \"$0\" \"$@\"";
    let output = std::process::Command::new("bash")
        .args(["-c", script])
        .arg(surgtpgs_tests::binary())
        .args(["render", "scene.safetensors", "-o", "full", "--kind", "depth"])
        .current_dir(flow.path())
        .output()
        .unwrap();
    let stderr = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(1), "{stderr}");
    assert!(stderr.contains("could not write the file") && !stderr.contains("panicked"), "{stderr}");
}

#[test]
fn usage_errors_are_code_2_and_help_is_not_an_error() {
    let here = tempfile::tempdir().unwrap();
    for args in [
        &["fly"][..],
        &["query", "s"],
        &["train", "s"],
        &["export", "s", "--prompt", "x", "-o", "o", "--format", "mpeg"],
        &["query", "s", "--prompt", "x", "--threshold", "7"],
        &["render", "s", "-o", "o", "--frames", "a..b"],
    ] {
        assert_eq!(run_in(here.path(), args).code, 2, "{args:?}");
    }
    for args in [&["--help"][..], &["--version"], &["export", "--help"]] {
        let run = run_in(here.path(), args).ok();
        assert!(!run.stdout.is_empty() && run.stderr.is_empty(), "{args:?}");
    }
}

#[cfg(target_os = "linux")]
#[test]
fn a_window_without_a_display_is_code_3() {
    let run = flow().run(&["view", "scene.safetensors"]);
    assert!(run.refused(3).contains("display"));
}
