//! Training in chapters: begun, interrupted, damaged, joined.

use super::*;
use crate::jobs::TRAINING;
use glam::Vec3;
use std::ops::ControlFlow;
use surgtpgs_core::{
    demo::{self, DemoSettings},
    progress::unobserved,
};

const STEPS: usize = 6;

struct Place {
    folder: tempfile::TempDir,
    material: Material,
}

impl Place {
    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let small = DemoSettings { width: 48, height: 32, frames: 20, ..DemoSettings::default() };
        let recording = folder.path().join("recording");
        demo::write(&small, &recording, &mut unobserved).unwrap();
        Self { material: Material::open(&recording).unwrap(), folder }
    }

    fn course<'a>(&'a self, scene: &'a Path, keeps_unfinished: bool) -> Course<'a> {
        let settings =
            TrainSettings { iterations: STEPS, chapter_frames: 8, eval: true, ..TrainSettings::default() };
        Course {
            material: &self.material,
            settings,
            backend: BackendChoice::Cpu,
            scene,
            keeps_unfinished,
            replaces: false,
            look_at: None,
        }
    }

    /// Returns `true` if a chapter is done, `None` if it is damaged.
    fn is_finished(&self, path: &Path, course: &Course<'_>) -> Result<Option<bool>> {
        is_finished_chapter(path, &self.material, &course.settings).map(|kept| kept.usable().ok())
    }

    fn bytes(&self, scene: &Scene) -> Vec<u8> {
        let path = self.folder.path().join("bytes.safetensors");
        scene.save(&path).unwrap();
        std::fs::read(path).unwrap()
    }
}

#[test]
fn chapters_in_one_go_alone_or_with_an_interruption_give_the_same_bytes() {
    let here = Place::new();
    let [whole, stopped] = ["a", "b"].map(|name| here.folder.path().join(name).with_extension("safetensors"));
    let checkpoint = here.folder.path().join("b.chapter-0001.unfinished");
    let course = here.course(&whole, false);
    let trained = course.train(&mut unobserved, &mut |_, _| {}).unwrap();
    assert_eq!((trained.steps, trained.scene.chapters.iter().len()), (3 * STEPS, 3));
    let bytes = here.bytes(&trained.scene);
    course.clear(&trained).unwrap();
    assert!(!chapter_path(&whole, 0).exists());

    // Stopped in the second chapter.
    let course = here.course(&stopped, true);
    let mut stop = |p: &Progress<'_>| match (p.stage == TRAINING, p.done) {
        (true, 9) => ControlFlow::Break(()),
        _ => ControlFlow::Continue(()),
    };
    let part = course.train(&mut stop, &mut |_, _| {}).unwrap();
    assert_eq!((part.steps, part.scene.provenance.steps), (9, 3));
    assert!(!part.scene.chapters.gaps(20).is_empty() && checkpoint.exists());
    let missing = part.scene.at(part.scene.time(19)).unwrap();
    assert!(missing.gaussians.is_empty());
    let settings = settings_of_chapters(&stopped, &here.material).unwrap().unwrap();
    assert_eq!(settings, course.settings, "the first chapter decides nothing for the others");
    let course = Course { settings, ..course };
    let mut first = None;
    let resumed = course.train(&mut unobserved, &mut |watched, report| {
        let seen = watched.scene().map(|scene| scene.chapters.iter().len());
        first.get_or_insert((report.step, seen.unwrap()));
    });
    assert_eq!(first, Some((4, 2)), "the second chapter goes on, and the first is shown with it");
    assert!(here.bytes(&resumed.unwrap().scene) == bytes);

    // One after the other, as jobs of their own.
    let (sequence, settings) = (here.material.sequence(), &course.settings);
    let mut plan = Plan::of(sequence, None, settings, &mut unobserved).unwrap();
    let mut paths = Vec::new();
    for chapter in plan.chapters.clone().iter().rev() {
        let mut trainer =
            Trainer::planned(sequence, None, settings.clone(), &mut plan, Some(chapter), &mut unobserved)
                .unwrap();
        let alone = go_on(&mut trainer, None, &mut unobserved, &mut |_, _| {}).unwrap();
        paths.push(here.folder.path().join(format!("part{}.safetensors", chapter.index)));
        alone.scene.save(&paths[paths.len() - 1]).unwrap();
    }
    assert!(here.bytes(&join(&paths).unwrap()) == bytes);
}

#[test]
fn chapters_of_a_moving_scope_lie_in_one_world() {
    let mut here = Place::new();
    let folder = here.folder.path().join("moving");
    let moving = DemoSettings { moving_camera: true, rigid: true, wanders: true, ..Default::default() };
    demo::write(&moving, &folder, &mut unobserved).unwrap();
    let truth = Material::open(&folder).unwrap();
    // The pictures alone.
    let pictures = folder.join("images");
    std::fs::write(pictures.join("sequence.toml"), "[camera]\nfov_x_degrees = 60\n").unwrap();
    here.material = Material::open(&pictures).unwrap();
    let scene = here.folder.path().join("a.safetensors");
    let mut course = here.course(&scene, false);
    course.settings.chapter_frames = 24;
    let trained = course.train(&mut unobserved, &mut |_, _| {}).unwrap();
    assert!(trained.notes[1].starts_with("Chapter 2 of 2: The scope moves"), "{:?}", trained.notes);
    // The first camera is the world of both, but units differ.
    let places = |i: usize| {
        let found = trained.scene.cameras[i].position_in_world();
        (found, truth.sequence().camera(i).position_in_world())
    };
    let places: Vec<_> = (0..48).map(places).collect();
    let sum = |of: &dyn Fn(&(Vec3, Vec3)) -> f32| places.iter().map(of).sum::<f32>();
    let unit = sum(&|(a, b)| a.dot(*b)) / sum(&|(a, _)| a.length_squared());
    let left = sum(&|(a, b)| (unit * *a - *b).length_squared()) / sum(&|(_, b)| b.length_squared());
    assert!(left.sqrt() < 0.05, "{}", left.sqrt());
}

#[test]
fn a_stop_before_a_chapter_begins_and_damage_to_one_cost_no_other() {
    let mut here = Place::new();
    let pictures = here.folder.path().join("recording/images");
    here.material = Material::open(&pictures).unwrap();
    let scene = here.folder.path().join("a.safetensors");
    let course = here.course(&scene, true);
    let mut has_trained = false;
    let mut stop = |p: &Progress<'_>| {
        has_trained |= p.stage == TRAINING;
        let is_second = has_trained && p.stage == "following points";
        if is_second { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    };
    let part = course.train(&mut stop, &mut |_, _| {}).unwrap();
    assert_eq!((part.steps, part.scene.chapters.iter().len()), (STEPS, 1));
    let checkpoint = here.folder.path().join("a.chapter-0001.unfinished");
    std::fs::write(&checkpoint, "somebody's notes").unwrap();
    let refused = course.train(&mut unobserved, &mut |_, _| {}).err().unwrap().to_string();
    assert!(refused.contains("a.chapter-0001.unfinished"), "{refused}");
    assert_eq!(std::fs::read_to_string(&checkpoint).unwrap(), "somebody's notes");
    std::fs::write(&checkpoint, b"SurgTPGS train A, and so on").unwrap();
    let whole = course.train(&mut unobserved, &mut |_, _| {}).unwrap();
    assert_eq!((whole.steps, whole.steps_kept), (3 * STEPS, STEPS));
    let says =
        whole.notes.iter().any(|note| note.starts_with("Chapter 2 of 3: what was kept of it is damaged"));
    assert!(says, "{:?}", whole.notes);
}

#[test]
fn a_chapter_that_was_done_and_is_damaged_is_trained_again_and_no_other() {
    let here = Place::new();
    let scene = here.folder.path().join("a.safetensors");
    let course = here.course(&scene, true);
    let bytes = here.bytes(&course.train(&mut unobserved, &mut |_, _| {}).unwrap().scene);
    let first = chapter_path(&scene, 0);
    let is_finished = |path: &Path| here.is_finished(path, &course);
    assert_eq!(is_finished(&first).unwrap(), Some(true));
    let kept = std::fs::read(&first).unwrap();
    std::fs::write(&first, &kept[..kept.len() - 1]).unwrap();
    assert_eq!(is_finished(&first).unwrap(), None);
    assert_eq!(settings_of_chapters(&scene, &here.material).unwrap().unwrap(), course.settings);
    let again = course.train(&mut unobserved, &mut |_, _| {}).unwrap();
    assert_eq!((again.steps, again.steps_kept), (3 * STEPS, 2 * STEPS));
    let note = format!("Chapter 1 of 3: {DAMAGED}");
    assert!(again.notes.contains(&note), "{:?}", again.notes);
    assert!(here.bytes(&again.scene) == bytes);

    for index in 0..3 {
        let path = chapter_path(&scene, index);
        let kept = std::fs::read(&path).unwrap();
        std::fs::write(&path, &kept[..kept.len() - 1]).unwrap();
    }
    let error = settings_of_chapters(&scene, &here.material).unwrap_err().to_string();
    assert!(error.contains("a.chapter-0000.safetensors"), "{error}");
    std::fs::write(&first, "somebody's notes").unwrap();
    assert!(is_finished(&first).is_err() && course.train(&mut unobserved, &mut |_, _| {}).is_err());
    assert_eq!(std::fs::read_to_string(&first).unwrap(), "somebody's notes");
}

#[test]
fn chapters_that_learned_from_other_depth_are_neither_kept_nor_joined() {
    let mut here = Place::new();
    let scene = here.folder.path().join("a.safetensors");
    here.course(&scene, true).train(&mut unobserved, &mut |_, _| {}).unwrap();
    let paths = [0, 1].map(|index| chapter_path(&scene, index));
    let earlier = here.folder.path().join("earlier.safetensors");
    std::fs::copy(&paths[1], &earlier).unwrap();
    let recording = here.folder.path().join("recording");
    let toml = recording.join("sequence.toml");
    let text = std::fs::read_to_string(&toml).unwrap();
    std::fs::write(&toml, text.replace("scale = 0.005", "scale = 0.01")).unwrap();
    here.material = Material::open(&recording).unwrap();
    let mut course = here.course(&scene, true);
    assert_eq!(here.is_finished(&paths[0], &course).unwrap(), Some(false));
    let error = course.train(&mut unobserved, &mut |_, _| {}).err().unwrap().to_string();
    assert!(error.contains("in another way"), "{error}");
    course.replaces = true;
    let all = course.train(&mut unobserved, &mut |_, _| {}).unwrap();
    assert_eq!((all.steps, all.steps_kept), (3 * STEPS, 0));
    assert!(join(&[paths[0].clone(), earlier]).unwrap_err().to_string().contains("another training"));
    assert_eq!(here.is_finished(&paths[0], &course).unwrap(), Some(true));
}

#[test]
fn a_chapter_of_another_recording_is_not_called_done() {
    let here = Place::new();
    let scene = here.folder.path().join("a.safetensors");
    let course = here.course(&scene, true);
    course.train(&mut unobserved, &mut |_, _| {}).unwrap();
    let first = chapter_path(&scene, 0);
    assert_eq!(here.is_finished(&first, &course).unwrap(), Some(true));
    let mut part = Scene::load(&first).unwrap();
    part.provenance.identity = None;
    part.save(&first).unwrap();
    assert_eq!(here.is_finished(&first, &course).unwrap(), Some(false));
    let error = course.train(&mut unobserved, &mut |_, _| {}).err().unwrap().to_string();
    assert!(error.contains("in another way"), "{error}");
}

#[test]
fn chapters_of_another_training_are_not_joined() {
    let here = Place::new();
    let scene = here.folder.path().join("a.safetensors");
    let mut course = here.course(&scene, false);
    course.train(&mut unobserved, &mut |_, _| {}).unwrap();
    let paths = [0, 1].map(|index| chapter_path(&scene, index));
    std::fs::rename(&paths[0], here.folder.path().join("first.safetensors")).unwrap();
    course.settings.seed = 1;
    let error = course.train(&mut unobserved, &mut |_, _| {}).err().unwrap().to_string();
    assert!(error.contains("in another way"), "{error}");
    assert_eq!(chapters_beside(&scene).len(), 3);
    // The first chapter was there to be trained, with the other seed.
    let mixed = [paths[0].clone(), paths[1].clone()];
    assert!(join(&mixed).unwrap_err().to_string().contains("another training"));
    let twin = here.folder.path().join("twin.safetensors");
    std::fs::copy(&paths[0], &twin).unwrap();
    let error = join(&[twin, paths[0].clone()]).unwrap_err().to_string();
    assert!(error.contains("same chapter as") && error.contains("twin.safetensors"), "{error}");
    course.replaces = true;
    let all = course.train(&mut unobserved, &mut |_, _| {}).unwrap();
    assert_eq!((all.steps, settings(&all.scene).unwrap().seed), (3 * STEPS, 1));
    // Those of a window that began in the middle are known, too.
    std::fs::remove_file(&paths[0]).unwrap();
    assert_eq!(settings_of_chapters(&scene, &here.material).unwrap().unwrap().seed, 1);
    let unfinished = checkpoint_path(&paths[0]);
    std::fs::write(&unfinished, b"SurgTPGS train A, and so on").unwrap();
    let theirs = ["a.chapter-0001.unfinished", "a.chapter-best.safetensors"];
    let theirs = theirs.map(|name| here.folder.path().join(name));
    std::fs::write(&theirs[0], "notes").unwrap();
    std::fs::copy(&paths[1], &theirs[1]).unwrap();
    remove_chapters(&scene).unwrap();
    assert!(chapters_beside(&scene).is_empty() && !unfinished.exists());
    assert!(theirs.iter().all(|path| path.exists()), "no files of ours");
}

#[test]
fn a_scene_is_whole_unless_its_training_was_stopped() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.safetensors");
    assert!(!is_whole_scene(&path), "there is none");
    let mut scene = surgtpgs_core::stress::ordinary(4);
    scene.save(&path).unwrap();
    assert!(is_whole_scene(&path), "nothing is known");
    scene.provenance.settings = serde_json::json!(TrainSettings { iterations: 9, ..Default::default() });
    for (steps, stopped) in [(8, Some(Stopped { steps: 8, of: 9 })), (9, None)] {
        scene.provenance.steps = steps;
        scene.save(&path).unwrap();
        assert_eq!((stopped_at(&path), is_whole_scene(&path)), (stopped, stopped.is_none()));
    }
}
