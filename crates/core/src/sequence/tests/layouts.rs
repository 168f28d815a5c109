//! Tests of every layout, in tiny folders.

use super::*;
use crate::files::{Claim, Inputs, OutputFolder};
use glam::Vec3;

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
    std::fs::write(at("sequence.toml"), toml::to_string(&settings).unwrap()).unwrap();

    let sequence = Sequence::open(folder.path()).unwrap();
    assert_eq!((sequence.num_frames(), sequence.frame_name(1)), (2, "003".to_owned()));
    assert_eq!(sequence.frames_per_second(), Some(15.0));
    let camera = sequence.camera(0);
    assert_eq!((camera.fx, camera.fy, camera.cx, camera.cy), (10.0, 10.0, 4.0, 3.0));
    assert_eq!(sequence.camera_source(), CameraSource::Lens);
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
    // The world's "up, backwards" are the image's "down, forwards" negated.
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

    // Pictures inside a result of this program are no recording.
    let inputs = Inputs::none();
    let result = OutputFolder::claim(&at("result"), Claim::new("preparation", &inputs, false)).unwrap();
    write_pictures(&result.path().join("regions"), &["0.png"]);
    result.finish().unwrap();
    std::fs::write(at("prepared.json"), "{}").unwrap();
    for folder in [folder.path(), &at("result")] {
        let error = message(Sequence::open(folder));
        assert!(error.contains("it is a preparation") && error.contains("Give the recording"), "{error}");
        assert!(!error.contains("video01") && !error.contains("regions"), "{error}");
    }
    std::fs::remove_file(at("prepared.json")).unwrap();

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
fn frames_that_are_there_in_two_kinds_are_refused() {
    let cases: [(&str, &[&str]); 4] =
        [("images", &["poses_bounds.npy"]), ("images", &["disps"]), ("left_frames", &[]), ("", &[])];
    for (name, beside) in cases {
        let folder = tempfile::tempdir().unwrap();
        let pictures = folder.path().join(name);
        write_pictures(&pictures, &["f_9.png", "f_10.png", "f_10.jpg", "f_9.JPG", "f_10.k.png"]);
        beside.iter().for_each(|name| std::fs::create_dir(folder.path().join(name)).unwrap());
        let error = message(Sequence::open(folder.path()));
        assert!(error.contains("\"f_9.JPG\" and \"f_9.png\" would be two frames"), "{name}: {error}");
        assert!(error.contains("move it to another folder"), "{error}");
    }
    // Only the endings may be written in any way.
    let folder = tempfile::tempdir().unwrap();
    write_pictures(folder.path(), &["a.png", "a.left.png", "b.jpg", "c.PNG"]);
    assert_eq!(Sequence::open(folder.path()).unwrap().num_frames(), 4);
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
fn the_references_layout_reads_disparities_and_test_masks() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let names: Vec<_> = (0..10).map(|i| format!("{i}.png")).collect();
    write_pictures(&at("images"), &names.iter().map(String::as_str).collect::<Vec<_>>());
    std::fs::create_dir_all(at("disps")).unwrap();
    for i in 0..10 {
        write_grey(&at(&format!("masks/{i}.png")), 5, 1);
        let disparity = ndarray::Array4::from_elem((1, 1, 3, 4), 2.0 + i as f32);
        ndarray_npy::write_npy(at(&format!("disps/{i}.npy")), &disparity).unwrap();
    }
    // The second held-out frame is frame 9.
    write_grey(&at("test_seg/00001/Liver.png"), 4, 255);
    write_grey(&at("test_seg/00001/L-hook Electrocautery.png"), 1, 255);
    let sequence = Sequence::open(folder.path()).unwrap();
    assert_eq!((sequence.layout(), sequence.camera_source()), (Layout::Reference, CameraSource::Given));
    let camera = sequence.camera(3);
    assert_eq!((camera.fx, camera.cx, camera.cy), (1087.4128, 4.0, 3.0));
    assert!(!sequence.camera_moves());
    assert_eq!(sequence.mask(0).unwrap().row(0), [true, true, true, true, true, false, false, false]);
    let depth = sequence.depth(1).unwrap().unwrap();
    assert_eq!((depth.width, depth.height), (8, 6));
    assert!((depth.at(7, 5) - 1_182.783 / 3.0).abs() < 1e-2, "{}", depth.at(7, 5));
    let names: Vec<_> = sequence.classes().iter().map(|c| c.name.as_str()).collect();
    assert_eq!(names, ["l-hook electrocautery", "liver"]);
    let labels = sequence.labels(9).unwrap().unwrap();
    assert!(labels.row(2)[1..6] == [1, 1, 1, NO_LABEL, NO_LABEL]);
    assert!(sequence.labels(1).unwrap().is_none());
}

#[test]
fn raw_endovis18_has_coloured_labels_and_a_calibration() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join("seq_1").join(name);
    write_pictures(&at("left_frames"), &["frame000.png", "frame001.png"]);
    std::fs::create_dir_all(at("labels")).unwrap();
    RgbImage::from_fn(8, 6, |x, _| Rgb([[0, 0, 0], [255, 55, 0], [9, 9, 9]][x as usize % 3]))
        .save(at("labels/frame001.png"))
        .unwrap();
    std::fs::write(
        folder.path().join("labels.json"),
        r#"[{"name":"background-tissue","color":[0,0,0],"classid":0},
            {"name":"kidney-parenchyma","color":[255,55,0],"classid":4}]"#,
    )
    .unwrap();
    let calibration =
        "Camera-0-F: 1084.2 1084.1   // left camera x,y focal dist in pixels\nCamera-0-C: 5.5 2.5 // c\n";
    std::fs::write(at("camera_calibration.txt"), calibration).unwrap();
    let sequence = Sequence::open(&folder.path().join("seq_1")).unwrap();
    assert_eq!((sequence.layout(), sequence.name()), (Layout::EndoVis18, "seq_1".to_owned()));
    let camera = sequence.camera(1);
    // The calibration is of 1280×1024 pixels, the pictures have 8×6.
    let expected = [1084.2 / 160.0, 1084.1 * 6.0 / 1024.0, 5.5 / 160.0, 2.5 * 6.0 / 1024.0];
    let found = [camera.fx, camera.fy, camera.cx, camera.cy];
    assert!(found.iter().zip(expected).all(|(a, b): (&f32, f32)| (a - b).abs() < 1e-4 * b), "{found:?}");
    assert_eq!(sequence.classes()[1].name, "kidney parenchyma");
    assert!(sequence.labels(0).unwrap().is_none());
    assert_eq!(sequence.labels(1).unwrap().unwrap().row(3)[..3], [0, 4, NO_LABEL]);

    std::fs::write(at("camera_calibration.txt"), "Camera-0-F: 1084.2\n").unwrap();
    assert!(message(Sequence::open(&at(""))).contains("camera_calibration.txt"));
}

/// Two frames out of order; the second camera looks right of the first, from x = 1.
const TRANSFORMS: &str = r#"{"w":16,"h":12,"fl_x":20,"fl_y":22,"cx":7,"cy":5,"k1":0.0,
  "classes":[{"id":1,"name":"liver"}],
  "frames":[
    {"file_path":"images/f10","transform_matrix":[[0,0,-1,1],[0,1,0,0],[1,0,0,0],[0,0,0,1]],"fl_x":40,
     "mask_path":"m.png","depth_file_path":"d.png","label_path":"m.png"},
    {"file_path":"images/f9.png","transform_matrix":[[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]}]}"#;

#[test]
fn transforms_have_opengl_axes_and_intrinsics_per_frame() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    write_pictures(&at("images"), &["f9.png", "f10.png"]);
    write_grey(&at("m.png"), 2, 1);
    image::ImageBuffer::<Luma<u16>, _>::from_pixel(8, 6, Luma([2500_u16])).save(at("d.png")).unwrap();
    std::fs::write(at("transforms.json"), TRANSFORMS).unwrap();
    let sequence = Sequence::open(folder.path()).unwrap();
    assert_eq!((sequence.layout(), sequence.camera_source()), (Layout::Transforms, CameraSource::Given));
    assert!(sequence.camera_moves());
    assert_eq!((sequence.frame_name(0), sequence.frame_name(1)), ("f9".to_owned(), "f10".to_owned()));

    // The file is for 16×12 pixels, the frames have 8×6.
    let (first, second) = (sequence.camera(0), sequence.camera(1));
    assert_eq!((first.fx, first.fy, first.cx, first.cy), (10.0, 11.0, 3.5, 2.5));
    assert_eq!(second.fx, 20.0);
    let note = "transforms.json is for 16×12 pixels, the images are 8×6: the camera was scaled";
    assert_eq!(sequence.inner.recording.notes, [note]);

    // OpenGL looks along −z with y up: a point up and ahead is above the image's centre.
    let up_ahead = first.camera_from_world.transform_point3(Vec3::new(0.5, 1.0, -4.0));
    assert!(up_ahead.abs_diff_eq(Vec3::new(0.5, -1.0, 4.0), 1e-6), "{up_ahead}");
    // The second camera's axes are right = +z, up = +y, backwards = −x: it looks along +x.
    let to_the_right = second.camera_from_world.transform_point3(Vec3::new(4.0, 0.0, 0.5));
    assert!(to_the_right.abs_diff_eq(Vec3::new(0.5, 0.0, 3.0), 1e-6), "{to_the_right}");

    assert_eq!(sequence.mask(1).unwrap().row(0)[..3], [true, true, false]);
    assert_eq!(sequence.mask(0).unwrap().count(), 48);
    assert_eq!(sequence.depth(1).unwrap().unwrap().at(3, 3), 2.5);
    assert!(sequence.depth(0).unwrap().is_none());
    assert_eq!(sequence.labels(1).unwrap().unwrap().row(0)[..3], [1, 1, NO_LABEL]);
}

#[test]
fn one_focal_length_in_transforms_counts_for_both_axes() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    write_pictures(&at("images"), &["f9.png", "f10.png"]);
    for (without, focal) in [("\"fl_x\":20,", [11.0, 11.0]), ("\"fl_y\":22,", [10.0, 10.0])] {
        std::fs::write(at("transforms.json"), TRANSFORMS.replace(without, "")).unwrap();
        let sequence = Sequence::open(folder.path()).unwrap();
        let camera = sequence.camera(0);
        assert_eq!(([camera.fx, camera.fy], [camera.cx, camera.cy]), (focal, [3.5, 2.5]));
        assert_eq!(sequence.camera_source(), CameraSource::Given);
    }
}

#[test]
fn broken_transforms_name_the_frame() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    write_pictures(&at("images"), &["f9.png"]);
    std::fs::write(at("transforms.json"), TRANSFORMS).unwrap();
    assert!(message(Sequence::open(folder.path())).contains("f10"));
    write_pictures(&at("images"), &["f9.png", "f10.png"]);
    std::fs::write(at("transforms.json"), TRANSFORMS.replace("[[1,0,0,0]", "[[0,0,0,0]")).unwrap();
    assert!(message(Sequence::open(folder.path())).contains("images/f9.png"));
    std::fs::write(at("transforms.json"), TRANSFORMS.replace("\"w\":16", "\"w\":12")).unwrap();
    assert!(message(Sequence::open(folder.path())).contains("it is for 12×12 pixels, the images are 8×6"));
    std::fs::write(at("transforms.json"), "{}").unwrap();
    assert!(message(Sequence::open(folder.path())).contains("frames"));
    std::fs::write(at("transforms.json"), "{\"frames\": []}").unwrap();
    assert!(message(Sequence::open(folder.path())).contains("it lists no frame"));
}

#[test]
fn the_references_newer_layout_reads_depth_pictures() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    write_pictures(&at("images"), &["0.png", "1.png"]);
    std::fs::create_dir_all(at("depth_mu")).unwrap();
    for i in 0..2_u16 {
        let depth = image::ImageBuffer::<image::Luma<u16>, _>::from_pixel(4, 3, image::Luma([1000 + i]));
        depth.save(at(&format!("depth_mu/{i}.png"))).unwrap();
    }
    let sequence = Sequence::open(folder.path()).unwrap();
    assert_eq!(sequence.layout(), Layout::Reference);
    let depth = sequence.depth(1).unwrap().unwrap();
    assert_eq!((depth.width, depth.height, depth.at(7, 5)), (8, 6, 1001.0));
}

#[cfg(unix)]
#[test]
fn pipes_are_told_at_once_wherever_a_file_is_read() {
    let pipe = |path: &Path| {
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        assert!(std::process::Command::new("mkfifo").arg(path).status().unwrap().success());
    };
    for name in ["sequence.toml", "labels.json", "poses_bounds.npy", "transforms.json", "images/9.png"] {
        let folder = tempfile::tempdir().unwrap();
        write_pictures(&folder.path().join("images"), &["0.png", "1.png"]);
        write_grey(&folder.path().join("labels/0.png"), 4, 1);
        pipe(&folder.path().join(name));
        let what = message(Sequence::open(folder.path()));
        assert!(what.contains("a pipe") && what.contains(name), "{name}: {what}");
    }
    let folder = tempfile::tempdir().unwrap();
    pipe(&folder.path().join("frame.png"));
    assert!(message(Sequence::open(&folder.path().join("frame.png"))).contains("a pipe, socket or device"));
    let frame = r#"{"file_path":"frame.png","transform_matrix":[[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]}"#;
    let named = folder.path().join("named");
    std::fs::create_dir(&named).unwrap();
    let text = format!(r#"{{"frames":[{}]}}"#, frame.replace("frame.png", "../frame.png"));
    std::fs::write(named.join("transforms.json"), text).unwrap();
    assert!(message(Sequence::open(&named)).contains("a pipe"));
}

#[test]
fn masks_are_white_from_one_on_and_in_jpeg_from_the_middle_on() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    std::fs::create_dir_all(at("images")).unwrap();
    std::fs::create_dir_all(at("masks")).unwrap();
    (0..2).for_each(|i| picture(24, 16, i).save(at(&format!("images/{i}.png"))).unwrap());
    let mask = |value: u8| GrayImage::from_fn(24, 16, |x, y| Luma([if x + y < 13 { value } else { 0 }]));
    mask(10).save(at("masks/0.png")).unwrap();
    // By its content: the name may be wrong.
    mask(255).save_with_format(at("masks/1.png"), image::ImageFormat::Jpeg).unwrap();
    let blurred = read::lightness(&at("masks/1.png")).unwrap();
    assert!(blurred.data.iter().any(|v| (1..20).contains(v)), "no number is left around the border");
    let sequence = Sequence::open(folder.path()).unwrap();
    let kept = [0, 1].map(|i| sequence.recording().file_mask(i).unwrap().unwrap());
    assert_eq!(kept[0], kept[1]);
    assert!((0..16).all(|y| (0..24).all(|x| kept[0].at(x, y) == (x + y >= 13))));
}
