//! Tiny folders of every layout, and the real recordings where they are to be had.

use super::*;
use glam::Vec3;
use image::{GrayImage, Luma, Rgb};
use std::path::PathBuf;

/// A folder of real recordings; `None` (said aloud) where it is absent.
fn real(name: &str) -> Option<PathBuf> {
    let root = std::env::var_os("SURGTPGS_DATA").map(PathBuf::from);
    let root = root.unwrap_or_else(|| Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data"));
    let path = root.join(name);
    if !path.exists() {
        eprintln!("skipped: no {} here (set SURGTPGS_DATA)", path.display());
        return None;
    }
    Some(path)
}

/// A bright asymmetric picture that tells frames, axes and channels apart.
fn picture(width: u32, height: u32, frame: u8) -> RgbImage {
    RgbImage::from_fn(width, height, |x, y| Rgb([100 + 10 * frame, 50 + 2 * x as u8, 60 + 5 * y as u8]))
}

/// Writes `pictures` of 8×6 with the given names below `folder`.
fn write_pictures(folder: &Path, names: &[&str]) {
    std::fs::create_dir_all(folder).unwrap();
    for (i, name) in names.iter().enumerate() {
        picture(8, 6, i as u8).save(folder.join(name)).unwrap();
    }
}

/// Writes an 8×6 grey picture whose left `columns` columns are `value`, the rest 0.
fn write_grey(path: &Path, columns: u32, value: u8) {
    std::fs::create_dir_all(path.parent().unwrap()).unwrap();
    GrayImage::from_fn(8, 6, |x, _| Luma([if x < columns { value } else { 0 }])).save(path).unwrap();
}

fn message(result: Result<Sequence>) -> String {
    result.unwrap_err().to_string()
}

/// Writes rows of `poses_bounds.npy` from camera-to-world columns and (s0, s1, focal).
fn write_poses(folder: &Path, rows: &[[[f64; 3]; 5]], bounds: bool) {
    let columns = if bounds { 17 } else { 15 };
    let mut values = ndarray::Array2::<f64>::zeros((rows.len(), columns));
    for (i, row) in rows.iter().enumerate() {
        for (c, column) in row.iter().enumerate() {
            for (r, v) in column.iter().enumerate() {
                values[(i, 5 * r + c)] = *v;
            }
        }
    }
    ndarray_npy::write_npy(folder.join("poses_bounds.npy"), &values).unwrap();
}

const X: [f64; 3] = [1.0, 0.0, 0.0];
const Y: [f64; 3] = [0.0, 1.0, 0.0];
const Z: [f64; 3] = [0.0, 0.0, 1.0];
const O: [f64; 3] = [0.0, 0.0, 0.0];

#[test]
fn images_sort_by_number_and_time_runs_from_zero() {
    let folder = tempfile::tempdir().unwrap();
    write_pictures(folder.path(), &["f_2.png", "f_10.png", "f_1.png"]);
    std::fs::write(folder.path().join("._f_1.png"), "not a picture").unwrap();
    let sequence = Sequence::open(folder.path()).unwrap();
    assert_eq!(sequence.layout(), Layout::Images);
    let names: Vec<_> = (0..3).map(|i| sequence.frame_name(i)).collect();
    assert_eq!(names, ["f_1", "f_2", "f_10"]);
    assert_eq!(sequence.frame(0).unwrap(), picture(8, 6, 2));
    assert_eq!((sequence.width(), sequence.height(), sequence.num_frames()), (8, 6, 3));
    assert_eq!(sequence.time(2), 2.0 / 3.0);
    assert_eq!(sequence.camera_source(), CameraSource::Assumed(60.0));
    assert!(!sequence.camera_moves() && sequence.classes().is_empty());
    assert_eq!(sequence.mask(1).unwrap().count(), 48);
    assert!(sequence.depth(0).unwrap().is_none() && sequence.labels(0).unwrap().is_none());
}

#[test]
fn a_sequence_is_shared_between_threads() {
    fn shared<T: Send + Sync + Clone>() {}
    shared::<Sequence>();
}

#[test]
fn test_frames_are_1_9_17() {
    let held_out: Vec<_> = (0..20).filter(|&i| Sequence::is_test_frame(i)).collect();
    assert_eq!(held_out, [1, 9, 17]);
}

#[test]
fn what_the_demo_writes_opens_with_depth_labels_and_settings() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    write_pictures(&at("images"), &["000.png", "001.png", "002.png", "003.png"]);
    for i in 0..4_u16 {
        std::fs::create_dir_all(at("depth")).unwrap();
        image::ImageBuffer::<Luma<u16>, _>::from_fn(8, 6, |x, _| Luma([if x == 0 { 0 } else { 1000 + i }]))
            .save(at(&format!("depth/{i:03}.png")))
            .unwrap();
    }
    write_grey(&at("labels/001.png"), 3, 2);
    std::fs::write(
        at("labels.json"),
        r#"[{"id":0,"name":"Liver"},{"id":2,"name":"gall_bladder","colour":[1,2,3]}]"#,
    )
    .unwrap();
    let mut settings = Settings::default();
    settings.camera.fx = Some(10.0);
    settings.depth.scale = Some(0.5);
    settings.time = TimeSettings { frames_per_second: Some(30.0), every: Some(2) };
    settings.frames.first = Some(1);
    settings.write(folder.path()).unwrap();

    let sequence = Sequence::open(folder.path()).unwrap();
    assert_eq!((sequence.num_frames(), sequence.frame_name(1)), (2, "003".to_owned()));
    assert_eq!(sequence.frames_per_second(), Some(15.0));
    let camera = sequence.camera(0);
    assert_eq!((camera.fx, camera.fy, camera.cx, camera.cy), (10.0, 10.0, 4.0, 3.0));
    assert_eq!(sequence.camera_source(), CameraSource::Given);
    let depth = sequence.depth(1).unwrap().unwrap();
    assert_eq!((depth.at(0, 5), depth.at(1, 5)), (0.0, 501.5));
    let labels = sequence.labels(0).unwrap().unwrap();
    assert_eq!((labels.at(2, 4), labels.at(3, 4)), (2, 0));
    assert!(sequence.labels(1).unwrap().is_none());
    assert_eq!(sequence.classes()[1], Class { id: 2, name: "gall bladder".into(), colour: [1, 2, 3] });
}

#[test]
fn endonerf_masks_hide_white_and_settings_flip_them() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    write_pictures(&at("images"), &["a.color.png", "b.color.png"]);
    write_grey(&at("masks/a.mask.png"), 3, 255);
    write_grey(&at("masks/b.mask.png"), 0, 255);
    write_poses(folder.path(), &[[X, Y, Z, O, [6.0, 8.0, 20.0]]; 2], true);
    let sequence = Sequence::open(folder.path()).unwrap();
    assert_eq!((sequence.layout(), sequence.camera_source()), (Layout::EndoNerf, CameraSource::Given));
    let mask = sequence.mask(0).unwrap();
    assert!(!mask.at(2, 5) && mask.at(3, 0) && mask.count() == 30);
    assert_eq!(sequence.mask(1).unwrap().count(), 48);

    std::fs::write(at("sequence.toml"), "[masks]\nkeep = \"white\"\n").unwrap();
    assert_eq!(Sequence::open(folder.path()).unwrap().mask(0).unwrap().count(), 18);
}

#[test]
fn endonerf_poses_are_right_up_backwards() {
    let folder = tempfile::tempdir().unwrap();
    write_pictures(&folder.path().join("images"), &["0.png", "1.png"]);
    let second = [X, Y, Z, [1.0, 2.0, 3.0], [6.0, 8.0, 20.0]];
    write_poses(folder.path(), &[[X, Y, Z, O, [6.0, 8.0, 20.0]], second], true);
    let sequence = Sequence::open(folder.path()).unwrap();
    let camera = sequence.camera(0);
    assert_eq!((camera.fx, camera.cx, camera.cy), (20.0, 4.0, 3.0));
    assert!(sequence.camera_moves());
    // World "up, backwards" are image "down, forwards" negated.
    let seen = camera.camera_from_world.transform_point3(Vec3::new(1.0, 2.0, -5.0));
    assert!(seen.abs_diff_eq(Vec3::new(1.0, -2.0, 5.0), 1e-6));
    assert!(sequence.camera(1).position_in_world().abs_diff_eq(Vec3::new(1.0, 2.0, 3.0), 1e-6));
}

#[test]
fn stereomis_is_told_by_its_numbers() {
    for (bounds, s) in [(false, [2.5, 4.5, 20.0]), (true, [3.2, 4.1, 20.0])] {
        let folder = tempfile::tempdir().unwrap();
        write_pictures(&folder.path().join("images"), &["0.png"]);
        write_grey(&folder.path().join("masks/0.png"), 3, 1);
        // A quarter turn about the viewing axis: image right is world down.
        write_poses(folder.path(), &[[Y, [-1.0, 0.0, 0.0], Z, O, s]], bounds);
        let sequence = Sequence::open(folder.path()).unwrap();
        let camera = sequence.camera(0);
        assert_eq!((camera.cy, camera.cx), (s[0] as f32, s[1] as f32));
        let seen = camera.camera_from_world.transform_point3(Vec3::new(1.0, 2.0, 5.0));
        assert!(seen.abs_diff_eq(Vec3::new(2.0, -1.0, 5.0), 1e-6), "{seen}");
        assert_eq!(sequence.mask(0).unwrap().count(), 18, "white is tissue");
    }
}

#[test]
fn a_smaller_pose_file_scales_the_focal_length() {
    let folder = tempfile::tempdir().unwrap();
    write_pictures(&folder.path().join("images"), &["0.png"]);
    write_poses(folder.path(), &[[X, Y, Z, O, [12.0, 16.0, 20.0]]], true);
    let camera = Sequence::open(folder.path()).unwrap().camera(0);
    assert_eq!((camera.fx, camera.fy, camera.cx), (10.0, 10.0, 4.0));
}

#[test]
fn cholecseg8k_codes_become_classes_and_the_border_is_hidden() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    write_pictures(folder.path(), &["frame_9_endo.png", "frame_10_endo.png"]);
    write_pictures(folder.path(), &["frame_9_endo_mask.png", "frame_9_endo_color_mask.png"]);
    RgbImage::from_fn(8, 6, |x, _| Rgb([[50, 21, 22, 255][x as usize % 4]; 3]))
        .save(at("frame_9_endo_watershed_mask.png"))
        .unwrap();
    let sequence = Sequence::open(folder.path()).unwrap();
    assert_eq!((sequence.layout(), sequence.num_frames()), (Layout::CholecSeg8k, 2));
    assert_eq!(sequence.frame_name(0), "frame_9_endo");
    let labels = sequence.labels(0).unwrap().unwrap();
    assert_eq!(labels.row(2)[..4], [0, 2, 10, NO_LABEL]);
    assert_eq!(sequence.classes()[10].name, "gallbladder");
    assert_eq!(sequence.mask(0).unwrap().row(0)[..4], [false, true, true, true]);
    assert!(sequence.labels(1).unwrap().is_none());
    assert_eq!(sequence.mask(1).unwrap().count(), 48);
}

#[test]
fn wrong_folders_are_named_plainly() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    assert!(message(Sequence::open(folder.path())).contains("holds no frames"));
    assert!(message(Sequence::open(&at("nowhere"))).contains("nowhere"));

    write_pictures(&at("video01"), &["0.png", "1.png"]);
    assert!(message(Sequence::open(folder.path())).contains("\"video01\""));

    picture(9, 6, 0).save(at("video01/2.png")).unwrap();
    let error = message(Sequence::open(&at("video01")));
    assert!(error.contains("frame 2 is 9×6, the first is 8×6") && error.contains("2.png"), "{error}");

    std::fs::write(at("video01/2.png"), "no picture").unwrap();
    let error = message(Sequence::open(&at("video01")));
    assert!(error.contains("cannot be read") && error.contains("2.png"), "{error}");

    let whole = std::fs::read(at("video01/0.png")).unwrap();
    std::fs::write(at("video01/2.png"), &whole[..60]).unwrap();
    let sequence = Sequence::open(&at("video01")).unwrap();
    assert!(sequence.frame(0).is_ok());
    assert!(sequence.frame(2).unwrap_err().to_string().contains("2.png"));
}

#[test]
fn counts_that_differ_are_errors() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    write_pictures(&at("images"), &["0.png", "1.png"]);
    write_poses(folder.path(), &[[X, Y, Z, O, [6.0, 8.0, 20.0]]], true);
    assert!(message(Sequence::open(folder.path())).contains("2 images but 1 poses"));
    write_poses(folder.path(), &[[X, Y, Z, O, [6.0, 8.0, f64::NAN]]; 2], true);
    assert!(message(Sequence::open(folder.path())).contains("poses_bounds.npy"));
    write_poses(folder.path(), &[[X, X, Z, O, [6.0, 8.0, 20.0]]; 2], true);
    assert!(message(Sequence::open(folder.path())).contains("pose 0"));
    write_poses(folder.path(), &[[X, Y, Z, O, [6.0, 8.0, 20.0]]; 2], true);
    write_grey(&at("masks/0.png"), 3, 255);
    assert!(message(Sequence::open(folder.path())).contains("2 images but 1 masks"));
    write_grey(&at("masks/2.png"), 3, 255);
    assert!(message(Sequence::open(folder.path())).contains("masks/2.png"));
}

#[test]
fn labels_without_a_class_list_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    write_pictures(&folder.path().join("images"), &["0.png"]);
    write_grey(&folder.path().join("labels/0.png"), 3, 1);
    assert!(message(Sequence::open(folder.path())).contains("class list"));
    std::fs::write(folder.path().join("labels.json"), r#"[{"id":1,"name":"a"},{"id":1,"name":"b"}]"#)
        .unwrap();
    assert!(message(Sequence::open(folder.path())).contains("labels.json"));
    std::fs::write(folder.path().join("sequence.toml"), "[frames]\nlast = 3\n").unwrap();
    assert!(message(Sequence::open(folder.path())).contains("labels.json"));
    std::fs::remove_file(folder.path().join("labels.json")).unwrap();
    assert!(message(Sequence::open(folder.path())).contains("frames 0 to 3 are asked for"));
}

#[test]
fn real_cholecseg8k_has_its_round_field_of_view() {
    let Some(path) = real("cholecseg8k_raw") else { return };
    let sequence = Sequence::open(&path).unwrap();
    assert_eq!((sequence.num_frames(), sequence.width(), sequence.height()), (48, 854, 480));
    let mut inside_by_label = 0;
    let mut both = 0;
    let mut union = 0;
    for i in (0..48).step_by(6) {
        let labels = sequence.labels(i).unwrap().unwrap();
        for (&label, &inside) in labels.data.iter().zip(&sequence.field_of_view().data) {
            if label != NO_LABEL {
                inside_by_label += usize::from(label != 0);
                both += usize::from(label != 0 && inside);
                union += usize::from(label != 0 || inside);
            }
        }
    }
    let iou = both as f64 / union as f64;
    eprintln!("field of view against labels: IoU {iou:.4}, {inside_by_label} pixels");
    assert!(iou > 0.97, "{iou}");
}

#[test]
fn real_endonerf_opens_whole() {
    let Some(path) = real("endonerf_pulling") else { return };
    let sequence = Sequence::open(&path).unwrap();
    assert_eq!((sequence.layout(), sequence.num_frames()), (Layout::EndoNerf, 63));
    assert!((sequence.camera(0).fx - 569.468).abs() < 1e-2 && !sequence.camera_moves());
    assert_eq!(sequence.field_of_view().count(), 640 * 512);
    let kept = sequence.mask(0).unwrap().count() as f64 / (640.0 * 512.0);
    assert!((0.5..0.99).contains(&kept), "{kept}");
}
