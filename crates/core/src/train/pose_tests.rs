//! Poses that are learned, and cameras that are fitted, on a rigid demo whose true poses are known.

use super::*;
use crate::{
    camera::Twist,
    demo::{DemoSettings, write},
    progress::{Progress, unobserved},
};
use glam::Affine3A;
use std::ops::ControlFlow;
use tempfile::TempDir;

const FRAMES: usize = 10;
/// Frame whose pose is wrong.
const WRONG: usize = 4;
/// Error of that pose: 2 px.
const TURN: f32 = 2.0 / 110.0;

/// The demo, and the folder that it is read from.
fn demo() -> (Sequence, TempDir) {
    let folder = tempfile::tempdir().unwrap();
    let settings = DemoSettings {
        width: 128,
        height: 96,
        frames: FRAMES,
        moving_camera: true,
        rigid: true,
        ..DemoSettings::default()
    };
    write(&settings, folder.path(), &mut unobserved).unwrap();
    (Sequence::open(folder.path()).unwrap(), folder)
}

/// Trains from start to end.
fn run(sequence: &Sequence, settings: TrainSettings) -> Scene {
    let steps = settings.iterations;
    let mut trainer = Trainer::new(sequence, None, settings).unwrap();
    for _ in 0..steps {
        trainer.step().unwrap();
    }
    trainer.scene().unwrap()
}

fn true_poses(sequence: &Sequence) -> Vec<Affine3A> {
    (0..FRAMES).map(|i| sequence.camera(i).camera_from_world).collect()
}

fn turned(pose: Affine3A) -> Affine3A {
    Twist { turn: [0.0, TURN, 0.0], shift: [0.0; 3] }.moved(pose)
}

/// Trains with a wrong pose of frame [`WRONG`].
fn trained(sequence: &Sequence, refines_poses: bool) -> Scene {
    let mut poses = true_poses(sequence);
    poses[WRONG] = turned(poses[WRONG]);
    let mut settings = TrainSettings { iterations: 300, refines_poses, ..TrainSettings::default() };
    settings.rates.pose = 0.3;
    run(&sequence.clone().with_poses(&poses), settings)
}

/// Distance in px of the picture's middle from where the true pose sees it, beside the mean of the others:
/// together they may lie anywhere.
fn error_px(sequence: &Sequence, cameras: &[crate::camera::Camera]) -> f32 {
    let off = |i: usize| {
        let camera = sequence.camera(i);
        let middle = camera.unproject(camera.cx, camera.cy, 60.0);
        cameras[i].project(middle).map_or(f32::INFINITY, |(u, _, _)| u - camera.cx)
    };
    let others: f32 = (0..FRAMES).filter(|i| *i != WRONG).map(off).sum();
    (off(WRONG) - others / (FRAMES - 1) as f32).abs()
}

#[test]
fn the_search_for_the_path_says_how_far_it_is_and_can_be_stopped() {
    let (_, folder) = demo();
    let pictures = Sequence::open(&folder.path().join("images")).unwrap();
    let settings = TrainSettings::default();
    let mut plan = Plan::whole(&pictures, None, &settings, &mut unobserved).unwrap();
    let mut stages = Vec::new();
    let mut observer = |p: &Progress<'_>| {
        stages.push((p.stage.to_owned(), p.done));
        if stages.len() > 3 { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    };
    let begun = Trainer::planned(&pictures, None, settings, &mut plan, None, &mut observer);
    assert!(matches!(begun.err(), Some(crate::Error::Cancelled)), "{stages:?}");
    assert_eq!(stages, (0..4).map(|i| ("following points".to_owned(), i)).collect::<Vec<_>>());
}

#[test]
fn too_many_frames_for_the_search_of_a_path_are_told() {
    let (with_poses, folder) = demo();
    let pictures = Sequence::open(&folder.path().join("images")).unwrap();
    assert_eq!(crate::poses::too_long(&pictures, 3000), None);
    assert_eq!(crate::poses::too_long(&with_poses, 3001), None, "poses and depth are known");
    let told = crate::poses::too_long(&pictures, 3001).and_then(|verdict| verdict.note()).unwrap();
    assert!(told.contains("3001") && told.contains("taken to stand still"), "{told}");
}

#[test]
fn chapters_of_a_shot_have_one_lens_that_is_looked_for_once() {
    let folder = tempfile::tempdir().unwrap();
    let moving = DemoSettings { moving_camera: true, rigid: true, wanders: true, ..DemoSettings::default() };
    write(&moving, folder.path(), &mut unobserved).unwrap();
    let pictures = Sequence::open(&folder.path().join("images")).unwrap();
    let settings = TrainSettings { chapter_frames: 24, eval: true, ..TrainSettings::default() };
    let mut plan = Plan::of(&pictures, None, &settings, &mut unobserved).unwrap();
    let (mut looked, mut focal_lengths) = (Vec::new(), Vec::new());
    for chapter in plan.chapters.clone().iter().rev() {
        let mut count = 0;
        let mut observer = |p: &Progress<'_>| {
            count += usize::from(p.stage == "looking for the lens" && p.done == 0);
            ControlFlow::Continue(())
        };
        let (settings, chapter) = (settings.clone(), Some(chapter));
        let trainer = Trainer::planned(&pictures, None, settings, &mut plan, chapter, &mut observer);
        focal_lengths.push(trainer.unwrap().scene().unwrap().cameras[0].fx);
        looked.push(count);
    }
    assert_eq!(looked, [1, 0]);
    assert_eq!(focal_lengths[0], focal_lengths[1]);
    let truth = Sequence::open(folder.path()).unwrap().camera(0).fx;
    assert!((focal_lengths[0] / truth).ln().abs() < 0.05, "{} instead of {truth}", focal_lengths[0]);
}

#[test]
fn a_pose_that_is_off_is_corrected_where_that_is_asked_for() {
    let (sequence, _folder) = demo();
    let [kept, refined] = [false, true].map(|refines| trained(&sequence, refines));
    let [before, after] = [&kept, &refined].map(|scene| error_px(&sequence, &scene.cameras));
    assert!(before > 1.5 && after < 0.5 * before, "{before} px, then {after} px");
}

#[test]
fn known_poses_are_kept_where_nothing_is_asked() {
    let (sequence, _folder) = demo();
    let scene = run(&sequence, TrainSettings { iterations: 30, ..Default::default() });
    let found: Vec<Affine3A> = scene.cameras.iter().map(|c| c.camera_from_world).collect();
    assert_eq!(found, true_poses(&sequence));
}

#[test]
fn a_camera_is_fitted_to_a_picture_and_never_to_a_worse_one() {
    let (sequence, _folder) = demo();
    let mut scene = run(&sequence, TrainSettings { iterations: 300, ..Default::default() });
    let likeness = |scene: &Scene| {
        let (picture, mask) = (sequence.frame(WRONG).unwrap(), sequence.mask(WRONG).unwrap());
        metrics::psnr_db(&render_frame(scene, WRONG).to_rgb(), &picture, Some(&mask)).unwrap()
    };
    let from_truth = likeness(&scene);
    scene.cameras[WRONG].camera_from_world = turned(scene.cameras[WRONG].camera_from_world);
    let from_wrong = likeness(&scene);
    scene.cameras[WRONG] = fit_camera(&scene, &sequence, WRONG).unwrap();
    let fitted = likeness(&scene);
    assert!(from_wrong < from_truth - 3.0, "{from_wrong} dB, {from_truth} dB");
    assert!(fitted > from_truth - 0.3, "{fitted} dB instead of {from_truth} dB");
    let again = fit_camera(&scene, &sequence, WRONG).unwrap();
    scene.cameras[WRONG] = again;
    assert!(likeness(&scene) >= fitted);
}
