use std::fs;
use surgtpgs_tests::{flow, run_in};

fn picture(path: &std::path::Path) -> image::RgbImage {
    image::open(path).unwrap().into_rgb8()
}

/// Returns the PSNR in dB.
fn likeness(a: &image::RgbImage, b: &image::RgbImage) -> f64 {
    assert_eq!(a.dimensions(), b.dimensions());
    let squares = a.as_raw().iter().zip(b.as_raw()).map(|(a, b)| f64::from(a.abs_diff(*b)).powi(2));
    let mean = squares.sum::<f64>() / a.as_raw().len() as f64;
    10.0 * (255.0 * 255.0 / mean.max(1e-9)).log10()
}

#[test]
fn a_frame_as_ordinary_splats_looks_the_same() {
    let (flow, elsewhere) = (flow(), tempfile::tempdir().unwrap());
    let folder = elsewhere.path();
    let scene = flow.at("scene.safetensors");
    let report = run_in(folder, &["convert", &scene, "frame.ply", "--frame", "6", "--json"]).ok().json();
    assert_eq!((report["files"][0].as_str(), report["left_out"].as_u64()), (Some("frame.ply"), Some(0)));
    run_in(folder, &["render", &scene, "-o", "moving", "--frames", "6"]).ok();
    run_in(folder, &["render", "frame.ply", "-o", "still"]).ok();
    // An imported .ply is a scene like any other. With the field of view, which a .ply does not
    // hold, it looks the same.
    run_in(folder, &["convert", "frame.ply", "still.safetensors", "--like", &scene]).ok();
    run_in(folder, &["render", "still.safetensors", "-o", "like", "--frames", "6"]).ok();
    let [moving, still, like] =
        ["moving/colour/frame_000006.png", "still/colour/frame_000000.png", "like/colour/frame_000006.png"]
            .map(|name| picture(&folder.join(name)));
    assert!(likeness(&moving, &like) > 45.0, "{}", likeness(&moving, &like));
    assert_eq!(moving.dimensions(), still.dimensions(), "the camera is noted in the file");
    let again = run_in(folder, &["convert", "frame.ply", "still.safetensors"]);
    assert!(again.refused(1).contains("--force"));
}

#[test]
fn a_folder_holds_a_file_per_frame() {
    let (flow, elsewhere) = (flow(), tempfile::tempdir().unwrap());
    let scene = flow.at("scene.safetensors");
    run_in(elsewhere.path(), &["convert", &scene, "frames", "--frames", "2..5"]).ok();
    let names = |folder: &str| {
        let mut names: Vec<String> = fs::read_dir(elsewhere.path().join(folder))
            .unwrap()
            .map(|e| e.unwrap().file_name().into_string().unwrap())
            .collect();
        names.sort();
        names
    };
    assert_eq!(names("frames"), [".surgtpgs", "frame0002.ply", "frame0003.ply", "frame0004.ply"]);
    run_in(elsewhere.path(), &["convert", &scene, "meshes", "--frames", "9", "--format", "glb"]).ok();
    assert_eq!(names("meshes"), [".surgtpgs", "frame0009.glb"]);
    let glb = fs::read(elsewhere.path().join("meshes/frame0009.glb")).unwrap();
    assert!(glb.starts_with(b"glTF\x02\0\0\0"));
}

/// Returns the bytes that the vocabulary's vectors take in a scene file.
fn size_of_words(scene: &[u8]) -> u64 {
    let length = u64::from_le_bytes(scene[..8].try_into().unwrap());
    let header: serde_json::Value = serde_json::from_slice(&scene[8..][..length as usize]).unwrap();
    let place = |end: usize| header["vocabulary"]["data_offsets"][end].as_u64().unwrap();
    place(1) - place(0)
}

#[test]
fn a_quantised_scene_is_small_and_answers_the_same() {
    let flow = flow();
    flow.run(&["convert", "scene.safetensors", "small.safetensors", "--quantize"]).ok();
    // The words' vectors, most of a tiny scene, stay as they are.
    let size = |name: &str| {
        let bytes = fs::read(flow.path().join(name)).unwrap();
        bytes.len() as u64 - size_of_words(&bytes)
    };
    assert!(size("small.safetensors") * 2 < size("scene.safetensors"));
    let [whole, small] = ["scene.safetensors", "small.safetensors"]
        .map(|scene| flow.run(&["eval", scene, "recording", "--json"]).ok().json());
    let lost = |path: &str| {
        let value = |v: &serde_json::Value| v.pointer(path).unwrap().as_f64().unwrap();
        value(&whole) - value(&small)
    };
    assert!(lost("/psnr_masked_db") < 0.1 && lost("/iou/paper/mean") < 0.005, "{whole}\n{small}");
}

#[test]
fn the_released_codes_files_go_both_ways() {
    let (flow, elsewhere) = (flow(), tempfile::tempdir().unwrap());
    let (folder, scene) = (elsewhere.path(), flow.at("scene.safetensors"));
    let written = run_in(folder, &["convert", &scene, "point_cloud.ply", "--reference", "--json"]).ok();
    assert_eq!(written.json()["files"].as_array().unwrap().len(), 2, "the feature network is beside it");
    assert!(written.stderr.contains("fitted"), "{written:?}");
    run_in(folder, &["convert", "point_cloud.ply", "back.safetensors", "--like", &scene]).ok();
    let query = ["query", "back.safetensors", "--prompt", "liver", "--json"];
    let found = run_in(folder, &query).ok().json();
    assert!(found["prompts"][0]["frames"].as_array().unwrap().iter().all(|f| f["found"] == true), "{found}");
    let db = |scene: &str| {
        let measured = run_in(folder, &["eval", scene, &flow.at("recording"), "--json"]).ok().json();
        measured["psnr_masked_db"].as_f64().unwrap()
    };
    let lost = db(&scene) - db("back.safetensors");
    assert!(lost < 0.5, "{lost} dB");
    // The scene that came back has the released code's motion: the second conversion loses nothing.
    let again =
        run_in(folder, &["convert", "back.safetensors", "again.ply", "--reference", "--json", "--force"])
            .ok();
    assert_eq!(again.json()["lost"].as_array().unwrap().len(), 0, "{again:?}");
    let bytes = |name: &str| fs::read(folder.join(name)).unwrap();
    assert!(bytes("again.ply") == bytes("point_cloud.ply"));
}

#[test]
fn a_page_is_whole_and_asks_for_nothing() {
    let (flow, elsewhere) = (flow(), tempfile::tempdir().unwrap());
    let (folder, scene) = (elsewhere.path(), flow.at("scene.safetensors"));
    let convert =
        |name: &str| run_in(folder, &["convert", &scene, name, "--prompt", "liver", "--prompt", "spaceship"]);
    convert("page.html").ok();
    convert("again.html").ok();
    let page = fs::read_to_string(folder.join("page.html")).unwrap();
    assert!(page == fs::read_to_string(folder.join("again.html")).unwrap(), "equal scenes give equal pages");
    assert!(page.starts_with("<!doctype html>") && page.trim_end().ends_with("</html>"));
    assert!(page.len() < 1_000_000, "{}", page.len());
    assert!(page.contains("default-src 'none'") && !page.contains("://") && !page.contains("@import"));
    assert!(!page.contains(&flow.at("")) && !page.contains("sequence_path"));
    assert!(page.contains("Research use only. Not for diagnostic or intra-operative use.</footer>"));
    let header = page.split_once(r#"id="scene">"#).unwrap().1.split_once("</script>").unwrap().0;
    let header: serde_json::Value = serde_json::from_str(header).unwrap();
    assert_eq!(header["frames"].as_array().unwrap().len(), surgtpgs_tests::Flow::FRAMES);
    let [liver, spaceship] = [0, 1].map(|k| &header["prompts"][k]);
    assert!(liver["frames"].as_array().unwrap().iter().all(|is| is == "found") && liver["note"] == "");
    assert!(spaceship["note"].as_str().unwrap().starts_with("not in this recording"), "{spaceship}");
    assert!(convert("page.html").refused(1).contains("--force"));
    run_in(folder, &["convert", &scene, "page.html", "--force"]).ok();
}

#[test]
fn an_spz_looks_nearly_the_same() {
    let (flow, elsewhere) = (flow(), tempfile::tempdir().unwrap());
    let (folder, scene) = (elsewhere.path(), flow.at("scene.safetensors"));
    for name in ["frame.spz", "frame.ply"] {
        run_in(folder, &["convert", &scene, name, "--frame", "6"]).ok();
    }
    let size = |name: &str| fs::metadata(folder.join(name)).unwrap().len();
    assert!(size("frame.spz") * 3 < size("frame.ply"));
    run_in(folder, &["convert", "frame.spz", "still.safetensors", "--like", &scene]).ok();
    run_in(folder, &["render", &scene, "-o", "moving", "--frames", "6"]).ok();
    run_in(folder, &["render", "still.safetensors", "-o", "still", "--frames", "6"]).ok();
    let [moving, still] =
        ["moving", "still"].map(|name| picture(&folder.join(name).join("colour/frame_000006.png")));
    assert!(likeness(&moving, &still) > 30.0, "{}", likeness(&moving, &still));
    let whole = fs::read(folder.join("frame.spz")).unwrap();
    fs::write(folder.join("cut.spz"), &whole[..whole.len() / 2]).unwrap();
    assert!(run_in(folder, &["convert", "cut.spz", "x.safetensors"]).refused(1).contains("cut.spz"));
}

#[test]
fn conversions_that_make_no_sense_are_refused() {
    let flow = flow();
    let refused = |args: &[&str]| {
        flow.run(&[&["convert", "scene.safetensors"][..], args].concat()).refused(1).to_owned()
    };
    assert!(refused(&["x.obj"]).contains(".glb"));
    assert!(refused(&["x.ply", "--frame", "99"]).contains("no frame 99"));
    assert!(refused(&["x.safetensors", "--frame", "1"]).contains("all times"));
    assert!(refused(&["x.glb", "--reference"]).contains(".ply"));
    assert!(refused(&["x.ply", "--quantize"]).contains("quantised"));
    assert!(refused(&["x.html", "--frame", "1"]).contains("all frames"));
    assert!(refused(&["x.ply", "--prompt", "liver"]).contains("only pages"));
    assert!(refused(&["x.ply", "--frames", "1..3"]).contains("one frame"));
    let folder = tempfile::tempdir().unwrap();
    let ply = fs::read(flow.at("scene.safetensors")).unwrap();
    fs::write(folder.path().join("cut.ply"), [b"ply\n", &ply[..200]].concat()).unwrap();
    assert!(run_in(folder.path(), &["convert", "cut.ply", "x.safetensors"]).refused(1).contains("cut.ply"));
    assert!(!folder.path().join("x.safetensors").exists());
}
