use serde_json::Value;
use surgtpgs_tests::{Flow, flow, run_in};

fn keys(value: &Value) -> Vec<&str> {
    value.as_object().unwrap().keys().map(String::as_str).collect()
}

fn has_keys(value: &Value, expected: &[&str]) {
    let found = keys(value);
    for key in expected {
        assert!(found.contains(key), "{key} is missing in {found:?}");
    }
}

#[test]
fn check_reports_what_the_demo_holds() {
    let report = flow().run(&["check", "recording", "--json"]).ok().json();
    has_keys(
        &report,
        &["ok", "frames", "width", "height", "camera", "depth", "masks", "labels", "warnings", "errors"],
    );
    assert_eq!(report["ok"], true);
    assert_eq!(report["frames"], Flow::FRAMES);
    assert_eq!((report["width"].clone(), report["height"].clone()), (64.into(), 48.into()));
    assert_eq!(report["errors"], Value::Array(vec![]));
}

#[test]
fn the_recording_is_never_modified() {
    let other = tempfile::tempdir().unwrap();
    let demo = ["demo", "-o", "recording", "--width", "64", "--height", "48", "--frames", "10"];
    run_in(other.path(), &demo).ok();
    let listing = |root: &std::path::Path| {
        let mut files = Vec::new();
        let mut folders = vec![root.to_owned()];
        while let Some(folder) = folders.pop() {
            for entry in std::fs::read_dir(folder).unwrap() {
                let path = entry.unwrap().path();
                if path.is_dir() {
                    folders.push(path);
                } else {
                    let name = path.strip_prefix(root).unwrap().to_owned();
                    files.push((name, std::fs::read(path).unwrap()));
                }
            }
        }
        files.sort();
        files
    };
    // The demo is written with the same bytes every time; the flow's copy has been prepared and trained from.
    assert!(listing(&other.path().join("recording")) == listing(&flow().path().join("recording")));
}

#[test]
fn train_reports_its_contract_and_learns() {
    let report = &flow().trained;
    has_keys(
        report,
        &["backend", "seconds", "steps", "steps_per_second", "gaussians", "peak_rss_bytes", "psnr_db"],
    );
    assert_eq!(report["steps"], 400);
    assert_eq!(report["held_out"], true, "a folder prepared with --eval remembers it");
    assert!(report["gaussians"].as_u64().unwrap() > 50);
    assert!(report["psnr_db"].as_f64().unwrap() > 18.0, "{report}");
    if cfg!(target_os = "linux") {
        assert!(report["peak_rss_bytes"].as_u64().unwrap() > 1_000_000);
    }
}

#[test]
fn training_again_writes_the_same_scene_on_the_cpu_and_on_a_gpu() {
    let train = |backend: &str, output: &str| {
        // Too few for Gaussians to come: from then on, the last digit decides which of two is divided.
        let steps = ["--iterations", "9", "--backend", backend, "--json", "--force"];
        let report = flow().run(&[&["train", "prepared", "-o", output][..], &steps].concat()).ok().json();
        assert_eq!(report["backend"].as_str().unwrap().starts_with("CPU"), backend == "cpu", "{report}");
        let report = flow().run(&["eval", output, "recording", "--json"]).ok().json();
        let bytes = std::fs::read(flow().path().join(output)).unwrap();
        (report["psnr_masked_db"].clone(), report["iou"].clone(), bytes)
    };
    let backends = ["cpu", "gpu"].map(|backend| {
        let first = train(backend, "again-1.safetensors");
        assert!(first.0.is_number(), "{:?}", first.0);
        assert!(
            first == train(backend, "again-2.safetensors"),
            "another file for the same seed on {backend}"
        );
        first
    });
    let psnr = backends.map(|(psnr, ..)| psnr.as_f64().unwrap());
    assert!((psnr[0] - psnr[1]).abs() < 0.05, "{psnr:?}");
}

#[test]
fn a_bare_recording_trains_without_features_and_says_so() {
    let flow = flow();
    let run =
        flow.run(&["train", "recording", "-o", "bare.safetensors", "--iterations", "20", "--json"]).ok();
    assert!(run.stderr.contains("without features"));
    assert_eq!(run.json()["held_out"], false);
    let message = flow.run(&["query", "bare.safetensors", "--prompt", "liver"]);
    assert!(message.refused(1).contains("without features"));
    let report = flow.run(&["eval", "bare.safetensors", "recording", "--json"]).ok();
    assert_eq!(report.json()["held_out"], false);
    assert_eq!(report.json()["frames"], Flow::FRAMES);
    assert_eq!(report.json()["iou"], Value::Null);
    assert!(report.stderr.contains("held out"));
}

#[test]
fn query_answers_per_prompt_and_frame() {
    let report = flow()
        .run(&["query", "scene.safetensors", "--prompt", "liver", "--prompt", "spaceship", "--json"])
        .ok()
        .json();
    let prompts = report["prompts"].as_array().unwrap();
    assert_eq!(
        prompts.iter().map(|p| p["text"].as_str().unwrap()).collect::<Vec<_>>(),
        ["liver", "spaceship"]
    );
    for prompt in prompts {
        let frames = prompt["frames"].as_array().unwrap();
        assert_eq!(frames.len(), Flow::FRAMES);
        for (i, frame) in frames.iter().enumerate() {
            has_keys(frame, &["frame", "found", "area_px", "area_fraction", "max_score"]);
            assert_eq!(frame["frame"], i);
            let area = frame["area_px"].as_u64().unwrap();
            assert_eq!(frame["found"], area > 0);
            let fraction = area as f64 / f64::from(Flow::SIZE.0 * Flow::SIZE.1);
            assert!((frame["area_fraction"].as_f64().unwrap() - fraction).abs() < 1e-9);
            assert!((0.0..=1.0).contains(&frame["max_score"].as_f64().unwrap()));
        }
    }
    let found = |p: &Value| p["frames"].as_array().unwrap().iter().filter(|f| f["found"] == true).count();
    assert_eq!(found(&prompts[0]), Flow::FRAMES, "the liver is on every frame: {report}");
    assert_eq!(found(&prompts[1]), 0, "there is no spaceship: {report}");
}

#[test]
fn query_writes_the_gaussians_that_it_found() {
    let asked = ["query", "scene.safetensors", "--prompt", "liver", "--prompt", "spaceship"];
    let flow = flow();
    let report = flow.run(&[&asked[..], &["--gaussians", "objects", "--json"]].concat()).ok().json();
    let found = &report["prompts"][0]["gaussians"];
    let count = found["count"].as_u64().unwrap();
    assert!(count > 10, "{report}");
    let ply = std::fs::read(flow.path().join("objects/liver.ply")).unwrap();
    let end = ply.windows(10).position(|w| w == b"end_header").unwrap();
    let header = String::from_utf8_lossy(&ply[..end]).into_owned();
    assert!(header.contains(&format!("element vertex {count}\n")), "{header}");
    assert_eq!(report["prompts"][1]["gaussians"], Value::Null, "nothing was found, so nothing is written");
    assert!(!flow.path().join("objects/spaceship.ply").exists());
    let table = std::fs::read_to_string(flow.path().join("objects/objects.csv")).unwrap();
    assert_eq!(
        table.lines().count(),
        1 + Flow::FRAMES,
        "what was found is followed over all frames: {table}"
    );
}

#[test]
fn a_frame_is_measured_every_way_there_is() {
    let flow = flow();
    let asked = ["bench", "frame", "scene.safetensors", "--backend", "cpu", "--frames", "2", "-o", "bench"];
    let report =
        flow.run(&[&asked[..], &["--size", "64x48", "--prompt", "liver", "--json"]].concat()).ok().json();
    let rows = report["rows"].as_array().unwrap();
    let lattice =
        rows.iter().find(|r| r["way"].as_str().unwrap().starts_with("lattice: cells known")).unwrap();
    assert!(lattice["max_error"].as_f64().unwrap() <= 1.0 / 255.0, "{lattice}");
    for pass in ["frame", "deform", "project", "bin", "raster", "relevancy", "overlay"] {
        assert!(rows.iter().any(|r| r["pass"] == pass), "{pass}");
    }
    let csv = std::fs::read_to_string(flow.path().join("bench/frame.csv")).unwrap();
    assert_eq!(csv.lines().count(), rows.len() + 2);
    assert!(std::fs::read_to_string(flow.path().join("bench/frame.svg")).unwrap().contains("folded"));
}

#[test]
fn what_breaks_renderers_is_measured() {
    let families = flow().run(&["bench", "stress", "--backend", "cpu", "--json"]).ok().json();
    let families = families.as_array().unwrap();
    assert!(families.len() > 10);
    assert!(families.iter().all(|f| f["not_finite"] == 0), "{families:?}");
}

#[test]
fn query_speaks_csv_and_plain_words() {
    let csv =
        flow().run(&["query", "scene.safetensors", "--prompt", "liver", "--frames", "2..4", "--csv"]).ok();
    let lines: Vec<&str> = csv.stdout.lines().collect();
    let columns =
        "prompt,frame,found,area_px,area_fraction,max_score,source,answer,nearest,needs_mark,not_understood";
    assert_eq!(lines[0], columns);
    assert!(lines.len() == 3 && lines[1].starts_with("\"liver\",2,"), "{lines:?}");
    assert!(lines[1].ends_with(",false,false"), "{lines:?}");
    let text = flow().run(&["query", "scene.safetensors", "--prompt", "spaceship"]).ok();
    assert!(text.stdout.contains("not in this recording"), "{}", text.stdout);
}

#[test]
fn eval_reports_its_contract_on_held_out_frames() {
    let report = flow().run(&["eval", "scene.safetensors", "recording", "--json"]).ok().json();
    has_keys(
        &report,
        &["psnr_db", "psnr_masked_db", "ssim", "depth_rmse", "frames", "gaussians", "iou", "ms", "held_out"],
    );
    has_keys(&report, &["ssim_published", "lpips_published"]);
    let of = |key: &str| report[key].as_f64().unwrap();
    assert!(of("flow_psnr_db") > of("blend_psnr_db") && of("blend_psnr_db") > 20.0, "{report}");
    assert!(of("train_psnr_db") > 20.0);
    // The share is the mean over two frames that differ little.
    let published = of("psnr_masked_db") - 10.0 * of("mask_share").log10();
    assert!((of("psnr_published_db") - published).abs() < 0.05 && of("mask_share") < 1.0, "{report}");
    has_keys(&report["ms"], &["deform", "raster", "relevancy", "frame"]);
    assert_eq!(report["frames"], 2, "frames 1 and 9 of 10 are held out");
    assert_eq!(report["held_out"], true);
    for protocol in ["paper", "strict"] {
        let iou = &report["iou"][protocol];
        has_keys(iou, &["mean", "classes"]);
        assert!((0.0..=1.0).contains(&iou["mean"].as_f64().unwrap()));
        assert!(iou["classes"].as_object().unwrap().contains_key("liver"));
        assert!(iou["classes"].as_object().unwrap().keys().all(|k| !k.contains("background")));
    }
    let mean = |p: &str| report["iou"][p]["mean"].as_f64().unwrap();
    assert!(mean("strict") <= mean("paper") + 1e-12);
}

#[test]
fn a_model_measures_how_different_pictures_look() {
    let flow = flow();
    std::fs::write(flow.path().join("lpips.onnx"), crate::distance::lpips(None).into_bytes()).unwrap();
    let eval = ["eval", "scene.safetensors", "recording", "--backend", "cpu", "--json", "--lpips"];
    let with = |model: &str| flow.run(&[&eval[..], &[model]].concat());
    let lpips = with("lpips.onnx").ok().json()["lpips"].as_f64().unwrap();
    flow.run(&["render", "scene.safetensors", "-o", "seen", "--backend", "cpu"]).ok();
    // The stand-in for LPIPS adds the channels' mean differences of colours from -1 to 1.
    let distance = |frame: usize| {
        let open = |path: String| image::open(flow.at(&path)).unwrap().to_rgb8().into_raw();
        let (one, other) = (
            open(format!("seen/colour/frame_{frame:06}.png")),
            open(format!("recording/images/frame_{frame:06}.png")),
        );
        let apart: f64 = one.iter().zip(&other).map(|(a, b)| f64::from(a.abs_diff(*b)) / 127.5).sum();
        apart / (one.len() as f64 / 3.0)
    };
    let expected = (distance(1) + distance(9)) / 2.0;
    assert!((lpips - expected).abs() < 1e-4 && expected > 0.0, "{lpips} {expected}");
    let other = with("prepared/prepared.json");
    assert!(other.refused(1).contains("not a readable ONNX model"));
}

#[test]
fn render_writes_every_kind() {
    let flow = flow();
    let kinds = "colour,depth,alpha,feature";
    flow.run(&["render", "scene.safetensors", "-o", "rendered", "--frames", "3", "--kind", kinds]).ok();
    let picture = image::open(flow.path().join("rendered/colour/frame_000003.png")).unwrap();
    assert_eq!((picture.width(), picture.height()), Flow::SIZE);
    let depth = image::open(flow.path().join("rendered/depth/frame_000003.png")).unwrap();
    assert_eq!(depth.color(), image::ColorType::L16);
    assert!(flow.path().join("rendered/depth/frame_000003.npy").exists());
    assert!(flow.path().join("rendered/feature/frame_000003.npy").exists());
    assert!(flow.path().join("rendered/alpha/frame_000003.png").exists());
    assert!(!flow.path().join("rendered/colour/frame_000004.png").exists());
    let notes = std::fs::read_to_string(flow.path().join("rendered/render.json")).unwrap();
    assert!(notes.contains("Research use only"));
}

#[test]
fn export_masks_frames_resumes_and_never_overwrites_silently() {
    let flow = flow();
    let export = |extra: &[&str]| {
        let base = ["export", "scene.safetensors", "--prompt", "liver", "-o", "masked", "--json"];
        flow.run(&[&base[..], extra].concat())
    };
    let formats = ["--format", "cutout,overlay,binary,index"];
    let first = export(&[&formats[..], &["--frames", "0..4"]].concat()).ok().json();
    assert_eq!((first["complete"].clone(), first["files"].clone()), (true.into(), 16.into()));

    let mask = image::open(flow.path().join("masked/binary/frame_000002_liver.png")).unwrap().to_luma8();
    assert!(mask.pixels().all(|p| p.0[0] == 0 || p.0[0] == 255));
    assert!(mask.pixels().any(|p| p.0[0] == 255));
    let cut = image::open(flow.path().join("masked/cutout/frame_000002_liver.png")).unwrap().to_rgba8();
    let names: Vec<_> = std::fs::read_dir(flow.path().join("recording/images")).unwrap().collect();
    assert_eq!(names.len(), Flow::FRAMES);
    assert!(cut.pixels().zip(mask.pixels()).all(|(c, m)| c.0[3] == m.0[0]));

    let more = export(&formats).ok().json();
    assert_eq!((more["skipped_frames"].clone(), more["frames"].clone()), (4.into(), Flow::FRAMES.into()));

    let record: Value =
        serde_json::from_slice(&std::fs::read(flow.path().join("masked/provenance.json")).unwrap()).unwrap();
    assert_eq!(record["complete"], true);
    // One file more tells the meaning of the labels.
    assert_eq!(record["files"].as_array().unwrap().len(), 4 * Flow::FRAMES + 1);
    assert!(!record.to_string().contains(&flow.at("")), "no path of this machine is in the record");

    let other = export(&["--format", "binary", "--threshold", "0.6"]);
    assert!(other.refused(1).contains("another export"));
    export(&["--format", "binary", "--threshold", "0.6", "--force"]).ok();
}

#[test]
fn one_export_writes_every_format_and_they_agree() {
    let flow = flow();
    let formats = "cutout,overlay,binary,index,outline,score,npy,video,gif,sheet,csv,json,coco,nrrd,cvat,label-studio,yolo";
    let prompts = ["--prompt", "liver", "grasper", "spaceship", "--json"];
    // Masks as they are: those that `query` counts.
    let export = ["export", "scene.safetensors", "-o", "everything", "--raw", "--format", formats];
    let report = flow.run(&[&export[..], &prompts].concat()).ok().json();
    // Eight formats have a file per frame, four of these a file for each of two prompts; nine have
    // one file for all frames. Nothing is written for what is not there.
    assert_eq!(report["files"], (4 * 2 + 4) * Flow::FRAMES + 9);
    assert_eq!(report["left_out"][0]["text"], "spaceship");
    let series = |name: &str| flow.path().join("everything").join(name);
    let csv = std::fs::read_to_string(series("csv/frames_000000-000009.csv")).unwrap();
    let coco = std::fs::read(series("coco/frames_000000-000009.json")).unwrap();
    let coco: Value = serde_json::from_slice(&coco).unwrap();
    let asked = flow.run(&[&["query", "scene.safetensors"][..], &prompts].concat()).ok().json();
    let annotations = coco["annotations"].as_array().unwrap();
    for frame in 0..Flow::FRAMES {
        let area = asked["prompts"][0]["frames"][frame]["area_px"].as_u64().unwrap();
        let row = csv.lines().nth(1 + 2 * frame).unwrap();
        assert!(
            row.starts_with(&format!("{},", frame + 1)) && row.contains(&format!(",liver,{area},")),
            "{row}"
        );
        assert!(
            annotations.iter().any(|a| a["image_id"] == coco["images"][frame]["id"] && a["area"] == area)
        );
    }
    let video = series("video/frames_000000-000009.mp4").display().to_string();
    assert_eq!(flow.run(&["check", &video, "--json"]).json()["frames"], Flow::FRAMES);
}

#[test]
fn of_what_is_not_there_the_record_is_written_alone() {
    let flow = flow();
    let export = ["export", "scene.safetensors", "--prompt", "spaceship", "-o", "nothing", "--json"];
    let run = flow.run(&export).ok();
    assert!(run.stderr.contains("nothing was written for \"spaceship\""), "{}", run.stderr);
    assert_eq!((run.json()["complete"].clone(), run.json()["files"].clone()), (true.into(), 0.into()));
    let written = std::fs::read_dir(flow.path().join("nothing")).unwrap();
    let mut names: Vec<_> = written.map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    assert_eq!(names, [".surgtpgs", "provenance.json"]);
    flow.run(&export).ok();
}

#[test]
fn reconstruction_stands_in_where_the_recording_is_gone() {
    let elsewhere = tempfile::tempdir().unwrap();
    let scene = flow().at("scene.safetensors");
    let export = |extra: &[&str]| {
        run_in(elsewhere.path(), &[&["export", &scene, "--prompt", "liver", "-o", "out"][..], extra].concat())
    };
    export(&["--source", "reconstruction", "--frames", "0"]).ok();
    assert!(export(&["--sequence", "nowhere"]).refused(1).contains("nowhere"));
}

#[test]
#[cfg(unix)]
fn an_interrupted_training_goes_on_where_it_stopped() {
    let flow = flow();
    let train = ["train", "prepared", "-o", "interrupted.safetensors"];
    let steps = ["--iterations", "4000"];
    // The training is stopped by hand, then by a scheduler.
    // `timeout` sends a signal to the program, and once more to its group.
    for (how, sent) in [(&steps[..], &["-INT"][..]), (&["--resume"][..], &["-TERM", "-TERM"])] {
        let mut child = surgtpgs_tests::start_until_training(flow.path(), &[&train, how].concat(), 1);
        std::thread::sleep(std::time::Duration::from_millis(300));
        sent.iter().for_each(|signal| surgtpgs_tests::signal(&child, signal));
        assert_eq!(child.wait().unwrap().code(), Some(1), "{sent:?}");
        assert!(flow.path().join("interrupted.safetensors").exists(), "what is done is a scene");
        assert!(flow.run(&train).refused(1).contains("--resume"));
    }
    let resumed = flow.run(&[&train[..], &["--resume", "--json"]].concat()).ok();
    assert_eq!(resumed.json()["finished"], true);
    assert!(!flow.path().join("interrupted.unfinished").exists());
    let whole = ["train", "prepared", "-o", "whole.safetensors", "--json", steps[0], steps[1]];
    let whole = flow.run(&whole).ok().json();
    assert_eq!(whole["psnr_db"], resumed.json()["psnr_db"], "the stop left no trace");
    let message = flow.run(&["train", "prepared", "-o", "whole.safetensors", "--resume"]);
    assert!(message.refused(1).contains("no unfinished training"));
}

#[test]
fn fast_features_answer_prompts() {
    let flow = flow();
    flow.run(&["train", "prepared", "-o", "fast.safetensors", "--iterations", "400", "--fast-features"]).ok();
    let report = flow.run(&["eval", "fast.safetensors", "recording", "--json"]).ok().json();
    assert!(report["iou"]["paper"]["classes"]["liver"].as_f64().unwrap() > 0.7, "{report}");
}

#[test]
fn the_benchmark_writes_what_every_row_came_to() {
    let flow = flow();
    let rows = ["--rows", "default,colour still,paper", "--iterations", "60"];
    let bench = [&["bench", "train", "prepared", "-o", "bench-rows", "--json"][..], &rows].concat();
    let report = flow.run(&bench).ok().json();
    assert_eq!(report.as_array().unwrap().len(), 3);
    let csv = std::fs::read_to_string(flow.path().join("bench-rows/train.csv")).unwrap();
    let columns = csv.lines().next().unwrap().split(',').count();
    assert_eq!(csv.lines().count(), 4);
    for (line, row) in csv.lines().skip(1).zip(["default", "colour still", "paper"]) {
        assert!(line.starts_with(row) && line.split(',').count() >= columns, "{line}");
    }
    for plot in ["train_psnr.svg", "train_miou.svg"] {
        let svg = std::fs::read_to_string(flow.path().join("bench-rows").join(plot)).unwrap();
        assert!(svg.contains("paper"), "{plot}");
    }
    let unknown = flow.run(&["bench", "train", "prepared", "-o", "bench-2", "--rows", "magic"]);
    assert!(unknown.refused(1).contains("no row \"magic\""));
}
