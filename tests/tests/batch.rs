use serde_json::Value;
use std::{
    fs,
    path::Path,
    process::Child,
    time::{Duration, SystemTime},
};
use surgtpgs_tests::{Run, run_in, signal, start_until_training};
use tempfile::TempDir;

const HOSTILE: &str = "<script>alert(1)</script> | *x*";

/// A folder with a tiny recording and a jobs file.
struct Batch(TempDir);

impl Batch {
    fn new(jobs: &str) -> Self {
        let batch = Self(tempfile::tempdir().unwrap());
        let demo = ["demo", "-o", "good", "--width", "48", "--height", "32", "--frames", "9"];
        run_in(batch.path(), &demo).ok();
        batch.write(jobs);
        batch
    }

    fn path(&self) -> &Path {
        self.0.path()
    }

    fn write(&self, jobs: &str) {
        let defaults = "[defaults]\neval = true\nbackend = \"cpu\"\n";
        std::fs::write(self.path().join("jobs.toml"), format!("{defaults}{jobs}")).unwrap();
    }

    fn run(&self, args: &[&str]) -> Run {
        run_in(self.path(), &[&["batch", "jobs.toml"][..], args].concat())
    }

    fn read(&self, name: &str) -> String {
        std::fs::read_to_string(self.path().join("jobs").join(name)).unwrap()
    }

    fn made(&self, name: &str) -> SystemTime {
        std::fs::metadata(self.path().join("jobs").join(name)).unwrap().modified().unwrap()
    }

    /// Starts a batch and waits until it trains for the n-th time.
    fn start_until_training(&self, n: usize) -> Child {
        start_until_training(self.path(), &["batch", "jobs.toml"], n)
    }
}

/// Returns the steps of `batch --dry-run --json` as (recording, step, state).
fn states(run: &Run) -> Vec<(String, String, String)> {
    let text = |step: &Value, key: &str| step[key].as_str().unwrap().to_owned();
    let json = run.json();
    let steps = json["steps"].as_array().unwrap();
    steps.iter().map(|s| (text(s, "name"), text(s, "step"), text(s, "state"))).collect()
}

#[test]
fn a_bad_recording_stops_no_other_and_a_second_run_does_what_changed() {
    let jobs = |iterations: u32| {
        format!(
            "iterations = 40\nlabels = true\nprompts = [\"liver\", \"spaceship\"]\nformats = [\"index\"]\n\
             [[recording]]\npath = \"good\"\nname = '{HOSTILE}'\n\
             [[recording]]\npath = \"bad\"\n[[recording]]\npath = \"missing\"\n\
             [[recording]]\npath = \"good\"\nlabels = false\niterations = {iterations}\n"
        )
    };
    let batch = Batch::new(&jobs(40));
    std::fs::create_dir(batch.path().join("bad")).unwrap();
    let listed = states(&batch.run(&["--dry-run", "--json"]).ok());
    assert_eq!(listed.len(), 4 + 4 + 4 + 2);
    assert!(listed.iter().all(|(_, _, state)| state == "new") && !batch.path().join("jobs").exists());

    let first = batch.run(&["--json"]);
    assert_eq!(first.code, 1, "{first:#?}");
    let report = first.json();
    let recordings = report["recordings"].as_array().unwrap();
    let of = |key: &str| recordings.iter().map(|r| r[key].as_str().unwrap_or("")).collect::<Vec<_>>();
    assert_eq!(of("state"), ["done", "failed", "failed", "done"]);
    assert!(of("error")[1].starts_with("prepare failed: ") && of("error")[2].contains("no recording here"));
    assert!(first.stderr.contains("2 of 4, bad: prepare failed: "), "{}", first.stderr);

    // The batch reports the same as the verbs do of the same scene.
    let eval = &recordings[0]["steps"][2]["report"];
    let folder = recordings[0]["folder"].as_str().unwrap();
    let scene = format!("{folder}/scene.safetensors");
    let alone = run_in(batch.path(), &["eval", &scene, "good", "--backend", "cpu", "--json"]).ok().json();
    for key in ["psnr_masked_db", "ssim", "gaussians", "iou"] {
        assert_eq!(eval[key], alone[key], "{key}");
    }
    let row = [
        format!("{:.2}", alone["psnr_masked_db"].as_f64().unwrap()),
        format!("{:.3}", alone["ssim"].as_f64().unwrap()),
        format!("{:.3}", alone["iou"]["paper"]["mean"].as_f64().unwrap()),
    ];
    let (markdown, html) = (batch.read("report.md"), batch.read("report.html"));
    assert!(markdown.contains(&format!("| done | {} |", row.join(" | "))), "{markdown}");
    assert!(html.contains(&format!("<td>{}</td>", row.join("</td><td>"))), "{html}");
    assert!(html.contains("&lt;script&gt;alert(1)&lt;/script&gt; | *x*") && !html.contains("<script"));
    assert_eq!(
        html.matches("<img src=\"data:image/jpeg;base64,").count(),
        3,
        "two reconstructions, one answer"
    );
    assert_eq!(html.matches("Failed.").count(), 2);
    assert!(!html.contains("src=\"s"), "nothing is beside the page");
    assert!(folder.ends_with("script-alert-1-script-x"));

    let scenes = ["script-alert-1-script-x/scene.safetensors", "good/scene.safetensors"];
    let before = scenes.map(|s| batch.made(s));
    let second = batch.run(&[]);
    assert_eq!(second.code, 1);
    assert_eq!(second.stderr.matches(" is done\n").count(), 4 + 2, "{}", second.stderr);
    assert_eq!(scenes.map(|s| batch.made(s)), before);

    batch.write(&jobs(50));
    batch.run(&["--only", "good"]).ok();
    assert_eq!(batch.made(scenes[0]), before[0]);
    assert_ne!(batch.made(scenes[1]), before[1], "another number of steps");
    assert!(batch.read("good/steps/train.json").contains("\"steps\": 50"));

    std::fs::remove_file(batch.path().join("jobs/good/eval/eval.json")).unwrap();
    let again = batch.run(&["--only", "good", "--only", HOSTILE]).ok();
    assert_eq!(
        again.stderr.matches(" is done\n").count(),
        5,
        "only the evaluation is gone: {}",
        again.stderr
    );
}

#[test]
fn a_recording_without_what_is_asked_for_is_done() {
    let batch = Batch::new(
        "[[recording]]\npath = \"good\"\niterations = 10\nlabels = true\nprompts = [\"spaceship\"]\n\
         frames = \"2..4\"\n",
    );
    let report = batch.run(&["--json"]).ok().json();
    let exported = &report["recordings"][0]["steps"][3]["report"];
    assert_eq!(exported["export"]["left_out"][0]["text"], "spaceship");
    let asked = exported["query"]["prompts"][0]["frames"].as_array().unwrap();
    assert!(asked.iter().all(|f| f["answer"] == "absent"));
    assert!(asked.iter().map(|f| &f["frame"]).eq([2, 3]), "{asked:?}");
    assert!(batch.read("report.md").contains("not in this recording"));
}

#[test]
#[cfg(unix)]
fn a_training_that_was_stopped_or_killed_is_gone_on_with() {
    let batch = Batch::new(
        "[[recording]]\npath = \"good\"\nname = \"short\"\niterations = 10\n\
         [[recording]]\npath = \"good\"\nname = \"long\"\niterations = 1500\n",
    );
    let mut child = batch.start_until_training(2);
    child.kill().unwrap();
    child.wait().unwrap();
    let state = |of: &str, step: &str| {
        let listed = states(&batch.run(&["--dry-run", "--json"]).ok());
        listed.into_iter().find(|(name, s, _)| name == of && s == step).unwrap().2
    };
    assert_eq!((state("short", "eval"), state("long", "train")), ("done".into(), "unfinished".into()));

    let mut child = batch.start_until_training(1);
    std::thread::sleep(Duration::from_millis(200));
    signal(&child, "-INT");
    assert_eq!(child.wait().unwrap().code(), Some(1));
    assert_eq!((state("short", "train"), state("long", "train")), ("done".into(), "unfinished".into()));
    assert!(batch.path().join("jobs/long/scene.unfinished").exists());
    assert!(batch.read("report.md").contains("| long | unfinished |"));

    let last = batch.run(&[]).ok();
    assert!(last.stdout.contains("2 recordings: 2 done"), "{last:#?}");
    assert!(!batch.path().join("jobs/long/scene.unfinished").exists());
    // The training went on from the checkpoint: the result is the same as in one go.
    let whole =
        ["train", "good", "-o", "whole", "--eval", "--backend", "cpu", "--iterations", "1500", "--json"];
    let whole = run_in(batch.path(), &whole).ok().json();
    let resumed: Value = serde_json::from_str(&batch.read("long/steps/train.json")).unwrap();
    assert_eq!(resumed["report"]["psnr_db"], whole["psnr_db"]);

    // With other settings, a training that is stopped leaves the scene that is there.
    let scene = || fs::read(batch.path().join("jobs/short/scene.safetensors")).unwrap();
    let before = scene();
    batch.write("[[recording]]\npath = \"good\"\nname = \"short\"\niterations = 1000000\n");
    let mut child = batch.start_until_training(1);
    signal(&child, "-TERM");
    assert_eq!(child.wait().unwrap().code(), Some(1));
    assert!(scene() == before && batch.path().join("jobs/short/scene.unfinished").exists());
    assert_eq!(state("short", "train"), "unfinished");
}

#[test]
#[cfg(unix)]
fn a_training_of_which_what_was_kept_is_damaged_begins_anew_and_says_so() {
    let batch = Batch::new("[[recording]]\npath = \"good\"\niterations = 1500\n");
    let mut child = batch.start_until_training(1);
    signal(&child, "-TERM");
    assert_eq!(child.wait().unwrap().code(), Some(1));
    let kept = batch.path().join("jobs/good/scene.unfinished");
    let mut bytes = fs::read(&kept).unwrap();
    *bytes.last_mut().unwrap() ^= 1;
    fs::write(&kept, bytes).unwrap();

    let again = batch.run(&[]).ok();
    let note = "scene.unfinished: what was kept of it is damaged, or of another version: it is begun anew";
    assert_eq!(again.stderr.matches(note).count(), 1, "{}", again.stderr);
    assert!(!kept.exists());
    let whole =
        ["train", "good", "-o", "whole", "--eval", "--backend", "cpu", "--iterations", "1500", "--json"];
    let whole = run_in(batch.path(), &whole).ok().json();
    let anew: Value = serde_json::from_str(&batch.read("good/steps/train.json")).unwrap();
    for key in ["steps", "psnr_db", "gaussians"] {
        assert_eq!(anew["report"][key], whole[key], "{key}");
    }
}

#[test]
fn what_is_wrong_or_not_ours_is_refused_before_anything_is_done() {
    let good = "[[recording]]\npath = \"good\"\niterations = 5\n";
    let batch = Batch::new(&format!("{good}prompt_words = [\"liver\"]\n"));
    let refused = batch.run(&[]);
    let message = refused.refused(1);
    assert!(message.contains("unknown key \"prompt_words\"") && message.contains("jobs.toml)"), "{message}");
    assert!(!batch.path().join("jobs").exists());

    batch.write(good);
    assert!(batch.run(&["--only", "other"]).refused(1).contains("There are: good."));
    let early = batch.run(&["--step", "eval"]);
    assert_eq!(early.code, 1);
    assert!(early.stdout.contains("eval needs the result of train"), "{early:#?}");

    let job = batch.path().join("jobs/good");
    std::fs::write(job.join("scene.unfinished"), b"precious").unwrap();
    assert!(batch.run(&[]).stdout.contains("was not made by a batch"));
    assert_eq!(batch.read("good/scene.unfinished"), "precious");
    std::fs::remove_file(job.join("scene.unfinished")).unwrap();

    #[cfg(unix)]
    {
        let frame = batch.path().join("good/images/frame_000000.png");
        let before = std::fs::read(&frame).unwrap();
        std::os::unix::fs::symlink(&frame, job.join("steps/train.lock")).unwrap();
        assert_eq!(batch.run(&[]).code, 1);
        assert!(std::fs::read(&frame).unwrap() == before, "a link is not written through");
        std::fs::remove_file(job.join("steps/train.lock")).unwrap();
    }

    std::fs::write(job.join("scene.safetensors"), b"precious").unwrap();
    let kept = batch.run(&[]);
    assert!(kept.code == 1 && kept.stdout.contains("was not made by a batch"), "{kept:#?}");
    assert_eq!(batch.read("good/scene.safetensors"), "precious");
}

#[test]
fn results_outlive_a_recording_that_is_away_for_a_while() {
    let batch = Batch::new("[[recording]]\npath = \"good\"\niterations = 5\n");
    batch.run(&[]).ok();
    let made = batch.made("good/scene.safetensors");
    let (here, away) = (batch.path().join("good"), batch.path().join("away"));
    std::fs::rename(&here, &away).unwrap();
    assert_eq!(batch.run(&[]).code, 1);
    assert_eq!(batch.run(&["--report-only"]).code, 1);
    assert!(batch.read("report.html").contains("no recording here"));
    std::fs::rename(&away, &here).unwrap();
    assert!(batch.run(&[]).ok().stderr.contains("eval is done"));
    assert_eq!(batch.made("good/scene.safetensors"), made);
}

/// Recordings by names in several scripts, each with the folder of its results.
const PATIENTS: [(&str, &str); 8] = [
    ("Müller Ö, 2", "müller-ö-2"),
    ("Pacient nº 1", "pacient-nº-1"),
    ("Пациент 7", "пациент-7"),
    ("患者七", "患者七"),
    ("患者八", "患者八"),
    ("مريض", "مريض"),
    ("מטופל", "מטופל"),
    ("रोगी", "रोगी"),
];

/// Returns a jobs file with the recordings in this order, each under its own name.
fn jobs_of(order: &[usize]) -> String {
    let one =
        |&i: &usize| format!("[[recording]]\npath = \"r{i}\"\nname = '{}'\niterations = 2\n", PATIENTS[i].0);
    order.iter().map(one).collect()
}

#[test]
fn the_order_of_recordings_changes_nothing_in_any_script() {
    let batch = Batch(tempfile::tempdir().unwrap());
    for i in 0..PATIENTS.len() {
        let (folder, seed) = (format!("r{i}"), format!("{i}"));
        let size = ["--width", "32", "--height", "24", "--frames", "4", "--seed", &seed];
        run_in(batch.path(), &[&["demo", "-o", &folder][..], &size].concat()).ok();
    }
    let mut order: Vec<usize> = (0..PATIENTS.len()).collect();
    batch.write(&jobs_of(&order));
    batch.run(&[]).ok();
    let scenes = || {
        PATIENTS.map(|(_, folder)| {
            fs::read(batch.path().join("jobs").join(folder).join("scene.safetensors")).unwrap()
        })
    };
    let (first, mut state) = (scenes(), 12345_u32);
    for round in 0..5 {
        for i in (1..order.len()).rev() {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            order.swap(i, (state >> 16) as usize % (i + 1));
        }
        batch.write(&jobs_of(&order));
        let run = batch.run(&[]).ok();
        assert_eq!(run.stderr.matches(" is done\n").count(), 2 * PATIENTS.len(), "{}", run.stderr);
        assert!(scenes() == first, "round {round}");
    }
    let folders =
        fs::read_dir(batch.path().join("jobs")).unwrap().filter(|e| e.as_ref().unwrap().path().is_dir());
    assert_eq!(folders.count(), PATIENTS.len());

    // The paths of two patients are swapped: neither gets the other's scene, and the other recordings go on.
    batch.write(
        &jobs_of(&order).replace("\"r3\"", "\"?\"").replace("\"r4\"", "\"r3\"").replace("\"?\"", "\"r4\""),
    );
    let swapped = batch.run(&[]);
    assert_eq!(swapped.code, 1);
    assert_eq!(
        swapped.stderr.matches("holds the results of another recording").count(),
        2,
        "{}",
        swapped.stderr
    );
    assert_eq!(swapped.stderr.matches(" is done\n").count(), 2 * (PATIENTS.len() - 2));
    assert!(scenes() == first);

    // A recording that moved is the same; one that changed a little is done again.
    fs::rename(batch.path().join("r0"), batch.path().join("elsewhere")).unwrap();
    fs::copy(
        batch.path().join("r2/images/frame_000000.png"),
        batch.path().join("r2/images/frame_000001.png"),
    )
    .unwrap();
    batch.write(&jobs_of(&order).replace("\"r0\"", "\"elsewhere\""));
    let moved = batch.run(&[]).ok();
    assert_eq!(moved.stderr.matches(" is done\n").count(), 2 * (PATIENTS.len() - 1), "{}", moved.stderr);
    let now = scenes();
    let changed: Vec<usize> = (0..PATIENTS.len()).filter(|&i| now[i] != first[i]).collect();
    assert_eq!(changed, [2]);
}

#[test]
fn what_was_prepared_is_used_where_the_recording_is_now() {
    let jobs = |path: &str, iterations: u32| {
        format!(
            "[[recording]]\npath = \"{path}\"\nname = \"clip\"\nlabels = true\nprompts = [\"liver\"]\n\
                 formats = [\"index\"]\niterations = {iterations}\n"
        )
    };
    let batch = Batch::new(&jobs("good", 5));
    batch.run(&[]).ok();
    fs::rename(batch.path().join("good"), batch.path().join("a longer name")).unwrap();
    batch.write(&jobs("a longer name", 5));
    let run = batch.run(&[]).ok();
    assert_eq!(run.stderr.matches(" is done\n").count(), 4, "{}", run.stderr);
    // With its results, too, as on another machine.
    let elsewhere = batch.path().with_extension("moved");
    fs::rename(batch.path(), &elsewhere).unwrap();
    let run = run_in(&elsewhere, &["batch", "jobs.toml"]);
    fs::rename(&elsewhere, batch.path()).unwrap();
    assert_eq!(run.stderr.matches(" is done\n").count(), 4, "{}", run.stderr);
    batch.write(&jobs("a longer name", 6));
    let run = batch.run(&[]).ok();
    assert!(
        run.stderr.contains("prepare is done") && !run.stderr.contains("train is done"),
        "{}",
        run.stderr
    );
}
