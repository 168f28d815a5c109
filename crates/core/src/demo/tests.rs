//! Tests of the clip: the same bytes each time, and ground truth that is consistent with itself.

use super::*;
use crate::progress::{Progress, unobserved};
use image::GenericImageView;
use std::path::Path;

fn settings(moving_camera: bool) -> DemoSettings {
    DemoSettings { width: 96, height: 72, frames: 3, moving_camera, ..Default::default() }
}

fn demo(moving_camera: bool) -> Demo {
    Demo::new(&settings(moving_camera)).unwrap()
}

/// Returns the centre of pixel `k` of a grid.
fn centre(width: usize, k: usize) -> Vec2 {
    Vec2::new((k % width) as f32 + 0.5, (k / width) as f32 + 0.5)
}

/// Returns the value of the pixel that a position lies in.
fn under<T: Copy>(grid: &Grid<T>, position: Vec2) -> Option<T> {
    let inside =
        position.min_element() >= 0.0 && position.x < grid.width as f32 && position.y < grid.height as f32;
    inside.then(|| grid.at(position.x as usize, position.y as usize))
}

#[test]
fn the_same_bytes_on_any_number_of_threads() {
    let with_threads = |n| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(n).build().unwrap();
        pool.install(|| render_frame(&settings(true), 20).unwrap())
    };
    let (one, four) = (with_threads(1), with_threads(4));
    assert_eq!(one.colour, four.colour);
    assert_eq!(one.depth, four.depth);
    assert_eq!(one.labels, four.labels);
    assert_eq!(one.motion, four.motion);
    let other = render_frame(&DemoSettings { seed: 8, ..settings(true) }, 20).unwrap();
    assert_ne!(one.colour, other.colour, "another seed, another picture");
}

#[test]
fn everything_is_known_inside_the_field_of_view_and_nothing_outside() {
    let demo = demo(false);
    let (inside, frame) = (demo.field_of_view(), demo.frame(5));
    assert!((0.55..0.8).contains(&(inside.count() as f32 / inside.data.len() as f32)));
    for (k, &inside) in inside.data.iter().enumerate() {
        let (z, label, motion) = (frame.depth.data[k], frame.labels.data[k], frame.motion.data[k]);
        if inside {
            assert!((55.0..150.0).contains(&z) && usize::from(label) < CLASSES.len(), "{k}: {z} {label}");
            assert!(Vec2::from(motion).length() < 4.0, "{k}: {motion:?}");
        } else {
            assert_eq!((z, label, motion), (0.0, NO_LABEL, [0.0; 2]));
        }
    }
    assert_eq!(frame.colour.get_pixel(0, 0).0.map(|c| c < 2), [true; 3]);
}

#[test]
fn every_class_is_in_view_all_the_time() {
    let demo = demo(false);
    for i in (0..48).step_by(5) {
        let labels = demo.frame(i).labels;
        for (id, (name, _)) in CLASSES.iter().enumerate() {
            let area = labels.data.iter().filter(|&&l| usize::from(l) == id).count();
            let least = if id < 2 || id == 3 { 0.1 } else { 0.015 };
            assert!(area as f32 > least * labels.data.len() as f32, "frame {i}: {name} has {area}");
        }
    }
}

/// Returns red at a position between pixel centres, 0–255.
fn red(picture: &RgbImage, p: Vec2) -> f32 {
    let p = (p - 0.5).clamp(Vec2::ZERO, Vec2::new(picture.width() as f32, picture.height() as f32) - 1.001);
    let (corner, f) = (p.floor(), p.fract());
    let at = |i: u32, j: u32| f32::from(picture.get_pixel(corner.x as u32 + i, corner.y as u32 + j).0[0]);
    let row = |j| at(0, j) * (1.0 - f.x) + at(1, j) * f.x;
    row(0) * (1.0 - f.y) + row(1) * f.y
}

#[test]
fn following_the_motion_finds_the_same_tissue_in_the_next_frame() {
    for moving in [false, true] {
        let demo =
            Demo::new(&DemoSettings { width: 240, height: 180, moving_camera: moving, ..Default::default() })
                .unwrap();
        for i in [6, 17, 30] {
            let (now, next) = (demo.frame(i), demo.frame(i + 1));
            let (mut seen, mut same, mut followed, mut stayed) = (0, 0, 0.0, 0.0);
            for (k, &label) in now.labels.data.iter().enumerate().filter(|(_, l)| **l != NO_LABEL) {
                let from = centre(now.labels.width, k);
                let arrival = from + Vec2::from(now.motion.data[k]);
                let Some(there) = under(&next.labels, arrival).filter(|&l| l != NO_LABEL) else { continue };
                seen += 1;
                same += usize::from(there == label);
                followed += (red(&now.colour, from) - red(&next.colour, arrival)).abs();
                stayed += (red(&now.colour, from) - red(&next.colour, from)).abs();
            }
            assert!(same as f32 > 0.985 * seen as f32, "frame {i}: {same} of {seen}");
            assert!(followed < 0.6 * stayed, "frame {i}: {followed} followed, {stayed} stayed");
        }
    }
}

#[test]
fn motion_is_the_derivative_of_the_moving_points() {
    // Two half steps and one whole step agree: the ground truth is smooth in time.
    for (i, &part) in
        [shape::ScenePart::Liver, shape::ScenePart::Gallbladder, shape::ScenePart::Omentum].iter().enumerate()
    {
        let p = Vec3::new(5.0 * i as f32, 9.0, 92.0);
        for (f, wanders) in (0..96).flat_map(|f| [(f, false), (f, true)]) {
            let at = |shift: f32| Moment::at(f as f32 + shift, wanders).place(part, p);
            let bend = at(1.0) - 2.0 * at(0.5) + at(0.0);
            assert!(bend.length() < 0.12, "frame {f}, {wanders}: {bend}");
            assert!(at(1.0).distance(at(0.0)) < 2.0);
        }
    }
}

#[test]
fn the_clip_repeats_after_48_frames() {
    let demo = demo(true);
    let (first, again) = (demo.frame(0), demo.frame(48));
    let differ = first.labels.data.iter().zip(&again.labels.data).filter(|(a, b)| a != b).count();
    assert!(differ < 20, "{differ} labels differ");
}

#[test]
fn motion_that_wanders_does_not_come_back() {
    let settings =
        DemoSettings { width: 32, height: 24, moving_camera: true, wanders: true, ..Default::default() };
    let demo = Demo::new(&settings).unwrap();
    let place =
        |f: usize| Moment::at(f as f32, true).place(shape::ScenePart::Liver, Vec3::new(0.0, 9.0, 92.0));
    for f in (48..960).step_by(48) {
        assert!(place(f).distance(place(0)) > 0.3, "frame {f}");
        assert_ne!(demo.camera(f), demo.camera(0));
    }
}

#[test]
fn two_cameras_see_the_same_surface() {
    let (still, moving) = (demo(false), demo(true));
    assert_eq!(still.camera(13), still.camera(0));
    for i in [9, 24] {
        let (a, b) = (still.frame(i), moving.frame(i));
        assert!(b.camera.position_in_world().length() > 3.0);
        let (mut seen, mut same) = (0, 0);
        for (k, &z) in b.depth.data.iter().enumerate().filter(|(_, z)| **z > 0.0) {
            let p = centre(b.depth.width, k);
            let (u, v, expected) = a.camera.project(b.camera.unproject(p.x, p.y, z)).unwrap();
            let Some(found) = under(&a.depth, Vec2::new(u, v)).filter(|&z| z > 0.0) else { continue };
            seen += 1;
            same += usize::from((found - expected).abs() < 2.0);
        }
        assert!(seen > 2000 && same as f32 > 0.93 * seen as f32, "frame {i}: {same} of {seen}");
    }
}

#[test]
fn impossible_settings_are_refused() {
    let bad = [(15, 72, 3), (96, 5000, 3), (96, 72, 0)];
    for (width, height, frames) in bad {
        let settings = DemoSettings::of_size(width, height, frames);
        assert!(render_frame(&settings, 0).unwrap_err().to_string().contains("16 to 4096"));
    }
}

fn files_in(folder: &Path) -> usize {
    std::fs::read_dir(folder).unwrap().count()
}

#[test]
fn the_folder_holds_what_was_rendered() {
    let folder = tempfile::tempdir().unwrap();
    let (path, settings, mut heard) = (folder.path(), settings(false), Vec::new());
    let mut hear = |p: &Progress<'_>| {
        heard.push((p.done, p.total));
        unobserved(p)
    };
    write(&settings, path, &mut hear).unwrap();
    assert_eq!(heard, [(0, 3), (1, 3), (2, 3), (3, 3)]);
    for kind in ["images", "depth", "labels", "masks", "motion"] {
        assert_eq!(files_in(&path.join(kind)), 3, "{kind}");
    }
    assert!(!path.join("transforms.json").exists());
    let frame = render_frame(&settings, 2).unwrap();
    let open = |kind: &str| image::open(path.join(kind).join("frame_000002.png")).unwrap();
    assert_eq!(open("images").into_rgb8(), frame.colour);
    assert_eq!(open("labels").into_luma8().into_raw(), frame.labels.data);
    assert_eq!(open("masks").dimensions(), (96, 72));
    let told: toml::Table = std::fs::read_to_string(path.join("sequence.toml")).unwrap().parse().unwrap();
    let scale = told["depth"]["scale"].as_float().unwrap() as f32;
    for (count, z) in open("depth").into_luma16().into_raw().iter().zip(&frame.depth.data) {
        assert!((f32::from(*count) * scale - z).abs() < 0.003);
    }
    assert_eq!(told["camera"]["fx"].as_float().unwrap() as f32, frame.camera.fx);
    let motion: ndarray::Array3<f32> = ndarray_npy::read_npy(path.join("motion/frame_000002.npy")).unwrap();
    assert_eq!(motion.shape(), [72, 96, 2]);
    assert_eq!([motion[[30, 50, 0]], motion[[30, 50, 1]]], frame.motion.at(50, 30));
    let classes: Vec<Class> =
        serde_json::from_slice(&std::fs::read(path.join("labels.json")).unwrap()).unwrap();
    assert_eq!(classes[2].name, "gallbladder");
}

#[test]
fn a_clip_is_written_again_but_over_nothing_else() {
    let folder = tempfile::tempdir().unwrap();
    let one = DemoSettings { frames: 1, ..settings(false) };
    write(&one, folder.path(), &mut unobserved).unwrap();
    let [labels, picture] = ["labels.json", "images/frame_000000.png"].map(|name| folder.path().join(name));
    std::fs::write(&labels, "[]").unwrap();
    std::fs::remove_file(&picture).unwrap();
    write(&one, folder.path(), &mut unobserved).unwrap();
    assert!(std::fs::read(&labels).unwrap() == b"[]" && picture.exists(), "what was changed stays");
    let refused = write(&settings(false), folder.path(), &mut unobserved).unwrap_err();
    assert!(refused.to_string().contains("does not hold this demo"), "{refused}");
    assert_eq!(files_in(&folder.path().join("images")), 1);
}

#[test]
fn a_moving_camera_is_described_in_opengl_axes() {
    let folder = tempfile::tempdir().unwrap();
    write(&settings(true), folder.path(), &mut unobserved).unwrap();
    let text = std::fs::read(folder.path().join("transforms.json")).unwrap();
    let told: serde_json::Value = serde_json::from_slice(&text).unwrap();
    assert_eq!(told["frames"].as_array().unwrap().len(), 3);
    let number = |r: usize, c: usize| told["frames"][2]["transform_matrix"][r][c].as_f64().unwrap() as f32;
    let column = |c| Vec3::new(number(0, c), number(1, c), number(2, c));
    let camera = demo(true).camera(2);
    assert!(column(3).distance(camera.position_in_world()) < 1e-4);
    // OpenGL looks along −z, with y up; the demo's camera looks roughly along +z with y down.
    assert!(column(2).z < -0.9 && column(1).y < -0.9 && column(0).x > 0.9);
    assert!(column(0).cross(column(1)).distance(column(2)) < 1e-4);
    for key in ["file_path", "depth_file_path", "label_path", "mask_path"] {
        assert!(folder.path().join(told["frames"][2][key].as_str().unwrap()).is_file(), "{key}");
    }
}
