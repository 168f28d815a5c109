//! Tests of conversions: forms, frames, options and what is told of them.

use super::*;
use crate::engine::{BackendChoice, asking_tests::engine_on};
use clap::Parser;
use surgtpgs_core::{scene::Chapter, stress::ordinary};

#[derive(Parser)]
struct Line {
    #[command(flatten)]
    args: ConvertArgs,
}

fn args(line: &str) -> ConvertArgs {
    Line::try_parse_from(["convert"].into_iter().chain(line.split_whitespace())).unwrap().args
}

/// A scene of nine frames and two chapters, of which there are these.
fn chapters(indices: &[usize]) -> Scene {
    let of = |index: &usize| {
        let shown = [0..3, 5..9][*index].clone();
        let mut scene = ordinary(6 + index);
        scene.cameras = vec![scene.cameras[0]; 9];
        let chapter = Chapter { index: *index, count: 2, learned: shown.clone(), shown };
        scene.provenance.settings = serde_json::json!({ "chapter": chapter });
        scene.as_chapter()
    };
    indices.iter().map(of).fold(None, |all, part| Some(Scene::joined(all, part))).unwrap()
}

#[test]
fn forms_of_one_chapter_hold_the_only_one_alone() {
    for line in ["scene page.html", "scene point_cloud.ply --reference"] {
        let args = args(line);
        let part = |scene: Scene| part(&args, &target(&args).unwrap(), scene);
        let only = part(chapters(&[1])).unwrap();
        assert_eq!((only.num_frames(), only.chapters.first_frame()), (4, 5), "{line}");
        assert_eq!(part(ordinary(6)).unwrap().num_frames(), 1);
        assert!(part(chapters(&[0, 1])).unwrap_err().to_string().contains("holds one chapter"));
    }
    let asked = args("scene page.html --chapter 0");
    let error = part(&asked, &Target::Page, ordinary(6)).unwrap_err().to_string();
    assert!(error.contains("is one whole") && error.contains("Leave the chapter out"), "{error}");
    let args = args("scene small.safetensors");
    assert_eq!(part(&args, &Target::Scene, chapters(&[1])).unwrap().num_frames(), 9);
}

#[test]
fn options_that_would_change_nothing_are_refused() {
    let refused = |line: &str| target(&args(line)).err().map(|e| e.to_string());
    for line in ["in x.ply --format glb", "in x.safetensors --format ply", "in x.html --format glb"] {
        assert!(refused(line).unwrap().contains("says its form"), "{line}");
    }
    for line in ["in x.glb --format glb", "in folder --format glb", "in folder"] {
        assert_eq!(refused(line), None, "{line}");
    }
    let folder = tempfile::tempdir().unwrap();
    let scene = folder.path().join("scene.safetensors");
    ordinary(6).save(&scene).unwrap();
    let line = format!("{0} out.ply --like {0}", scene.display());
    assert!(open(&args(&line)).err().unwrap().to_string().contains("Leave out --like"));
}

#[test]
fn frames_that_no_chapter_shows_are_not_written() {
    let folder = tempfile::tempdir().unwrap();
    let convert = |line: &str, scene: &Scene| {
        let path = folder.path().join(line.split_whitespace().nth(1).unwrap());
        let args = ConvertArgs { output: path, ..args(line) };
        let mut done = Conversion::of(scene);
        let target = target(&args)?;
        write(&args, &target, scene.clone(), &Inputs::none(), &mut done).map(|()| done)
    };
    let scene = chapters(&[0, 1]);
    for line in ["in one.ply --frame 4", "in one.glb --time 0.5", "in frames --frames 3..5"] {
        let error = convert(line, &scene).err().unwrap().to_string();
        assert!(error.contains("no chapter of the scene shows"), "{line}: {error}");
    }
    assert!(std::fs::read_dir(folder.path()).unwrap().next().is_none(), "nothing was written");
    let of = |line: &str, scene: &Scene| {
        let done = convert(line, scene).unwrap();
        (done.files.len(), done.gaussians, done.lost.len())
    };
    assert_eq!(of("in frames", &scene), (7, 13, 1));
    assert_eq!(of("in some --frames 6..9", &scene), (3, 7, 0));
    assert_eq!(of("in last.ply --frame 8", &scene), (1, 7, 0));
    assert_eq!(of("in first.ply", &chapters(&[1])), (1, 7, 0), "the first that is shown");
    assert_eq!(of("in all.safetensors", &scene), (1, 13, 0));
    assert_eq!(of("in whole", &ordinary(4)), (1, 4, 0));
}

#[test]
fn a_time_has_the_camera_of_the_frame_before() {
    let mut scene = ordinary(4);
    scene.cameras = vec![scene.cameras[0]; 4];
    scene.times = vec![0.0, 0.25, 0.5, 0.75];
    let times = [None, Some(0.0), Some(0.3), Some(0.99)];
    assert_eq!(times.map(|time| frame_at(&scene, time)), [0, 0, 1, 3].map(Some));
}

#[test]
fn a_page_is_asked_with_the_text_encoder_that_is_given() {
    let folder = tempfile::tempdir().unwrap();
    let mut scene = Scene::clone(engine_on(BackendChoice::Cpu, &["liver", "fat"], &[]).scene());
    let gone = folder.path().join("encoder");
    scene.encoder.as_mut().unwrap().folder = Some(gone.clone());
    let page = |name: &str, more: &str| {
        let line = format!("in {} --prompt liver {more}", folder.path().join(name).display());
        let mut done = Conversion::of(&scene);
        write(&args(&line), &Target::Page, scene.clone(), &Inputs::none(), &mut done)
    };
    let error = page("without.html", "").unwrap_err().to_string();
    assert!(error.contains("is not there any more"), "{error}");
    page("with.html", "--text-encoder builtin").unwrap();
    std::fs::create_dir(&gone).unwrap();
    let into = format!("in {0}/page.html --prompt liver --text-encoder {0}", gone.display());
    let inputs = inputs(&args(&into), &ordinary(3));
    assert!(outputs::scene_file(&gone.join("page.html"), &inputs, false).is_err());
    let unasked = ["convert", "in", "page.html", "--text-encoder", "builtin"];
    assert!(Line::try_parse_from(unasked).is_err());
    assert!(Line::try_parse_from(["convert", "in", "page.html", "--prompt", " "]).is_err());
}

#[test]
fn what_is_left_out_is_told_of_the_input_not_of_the_scene_it_is_like() {
    let folder = tempfile::tempdir().unwrap();
    let [ply, like] = ["in.ply", "like.safetensors"].map(|name| folder.path().join(name));
    let mut damaged = ordinary(6).all_still(0.0);
    damaged.means[2] = [f32::NAN; 3];
    std::fs::write(&ply, damaged.to_ply(None)).unwrap();
    ordinary(6).save(&like).unwrap();
    let line = format!("{} out.safetensors --like {}", ply.display(), like.display());
    let done = Conversion::of(&open(&args(&line)).unwrap());
    assert_eq!(done.left_out, 1);
}
