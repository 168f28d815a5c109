use serde_json::Value;
use std::{
    fs,
    path::{Path, PathBuf},
};
use surgtpgs_tests::{Run, flow, run_in};
use tempfile::TempDir;

/// A copy of the tiny demo's recording and all that was made of it.
struct Copied(TempDir);

impl Copied {
    fn new() -> Self {
        let copy = Self(tempfile::tempdir().unwrap());
        for name in ["recording", "prepared", "scene.safetensors"] {
            copy_all(&flow().path().join(name), &copy.0.path().join(name));
        }
        copy
    }

    fn run(&self, args: &[&str]) -> Run {
        run_in(self.0.path(), args)
    }

    fn at(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    /// Returns the errors of all verbs that make something of the recording; checks that they made nothing.
    fn refusals(&self) -> [String; 3] {
        let export = ["export", "scene.safetensors", "--sequence", "recording", "--prompt", "liver", "-o"];
        let runs = [
            self.run(&[
                "train",
                "prepared",
                "-o",
                "new.safetensors",
                "--iterations",
                "5",
                "--backend",
                "cpu",
            ]),
            self.run(&["eval", "scene.safetensors", "recording", "--backend", "cpu"]),
            self.run(&[&export[..], &["masked"], &["--backend", "cpu"]].concat()),
        ];
        assert!(!self.at("new.safetensors").exists() && !self.at("masked").exists());
        runs.map(|run| run.refused(1).to_owned())
    }
}

fn copy_all(from: &Path, to: &Path) {
    if from.is_file() {
        fs::copy(from, to).unwrap();
        return;
    }
    fs::create_dir_all(to).unwrap();
    for entry in fs::read_dir(from).unwrap() {
        let entry = entry.unwrap();
        copy_all(&entry.path(), &to.join(entry.file_name()));
    }
}

#[test]
fn a_renamed_frame_is_refused_by_its_name() {
    let copy = Copied::new();
    for kind in ["images", "masks", "depth", "labels", "motion"] {
        for ending in ["png", "npy"] {
            let name = |i: usize| copy.at("recording").join(kind).join(format!("frame_{i:06}.{ending}"));
            if name(3).exists() {
                fs::rename(name(3), name(30)).unwrap();
            }
        }
    }
    for message in copy.refusals() {
        assert!(message.contains("frame 3 \"frame_000003.png\" is missing"), "{message}");
    }
}

#[test]
fn changed_content_of_equal_size_is_refused_by_name() {
    let copy = Copied::new();
    let file = copy.at("recording/images/frame_000004.png");
    let mut bytes = fs::read(&file).unwrap();
    *bytes.last_mut().unwrap() ^= 1;
    fs::write(&file, bytes).unwrap();
    for message in copy.refusals() {
        assert!(message.contains("frame 4 \"frame_000004.png\" has another content"), "{message}");
    }
}

#[test]
fn another_recording_of_equal_number_and_size_is_refused() {
    let copy = Copied::new();
    fs::remove_dir_all(copy.at("recording")).unwrap();
    let demo =
        ["demo", "-o", "recording", "--seed", "8", "--width", "64", "--height", "48", "--frames", "10"];
    copy.run(&demo).ok();
    for message in copy.refusals() {
        assert!(message.contains("it is another one, no frame is the same"), "{message}");
    }
}

#[test]
fn a_recording_that_moved_is_the_same_and_its_frames_are_named_in_exports() {
    let copy = Copied::new();
    fs::rename(copy.at("recording"), copy.at("moved")).unwrap();
    copy.run(&["eval", "scene.safetensors", "moved", "--backend", "cpu"]).ok();
    let formats = ["--format", "index", "--format", "csv", "--format", "coco", "--backend", "cpu"];
    let export = ["export", "scene.safetensors", "--sequence", "moved", "--prompt", "liver", "-o", "masked"];
    copy.run(&[&export[..], &formats].concat()).ok();
    let json = |name: &str| -> Value { serde_json::from_slice(&fs::read(copy.at(name)).unwrap()).unwrap() };
    let provenance = json("masked/provenance.json");
    assert_eq!(provenance["sequence_frame_names"][3], "frame_000003.png");
    assert_eq!(provenance["sequence_sha256"].as_str().map(str::len), Some(64));
    let files = provenance["files"].as_array().unwrap();
    assert!(files.iter().any(|file| file["name"] == "index/labels.json"));
    assert_eq!(json("masked/coco/frames_000000-000009.json")["images"][3]["source"], "frame_000003.png");
    let csv = fs::read_to_string(copy.at("masked/csv/frames_000000-000009.csv")).unwrap();
    assert!(csv.lines().next().unwrap().ends_with(",source,answer"), "{csv}");
    assert!(csv.lines().nth(4).unwrap().ends_with(",frame_000003.png,found"), "{csv}");
}
