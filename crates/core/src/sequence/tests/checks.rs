//! Tests of the import report.

use super::*;
use crate::progress::{Progress, unobserved};

fn report(folder: &Path) -> CheckReport {
    let mut seen = Vec::new();
    let mut see = |p: &Progress<'_>| {
        seen.push((p.done, p.total));
        unobserved(p)
    };
    let report = check(&Sequence::open(folder).unwrap(), &mut see).unwrap();
    assert_eq!(seen.first(), Some(&(0, report.frames)));
    assert_eq!(seen.last(), Some(&(report.frames, report.frames)));
    report
}

fn any(messages: &[String], part: &str) -> bool {
    messages.iter().any(|m| m.contains(part))
}

#[test]
fn a_path_that_leads_nowhere_is_said_so() {
    let folder = tempfile::tempdir().unwrap();
    let error = Sequence::open(&folder.path().join("clip.mp4")).unwrap_err();
    assert!(error.to_string().contains("there is no such file or folder"), "{error}");
}

#[test]
fn a_sound_recording_passes() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    write_pictures(&at("images"), &["0.png", "1.png"]);
    for i in 0..2 {
        write_grey(&at(&format!("masks/{i}.png")), 2, 255);
        write_grey(&at(&format!("depth/{i}.png")), 7, 100);
        write_grey(&at(&format!("labels/{i}.png")), 4, 1 - i);
    }
    std::fs::write(at("labels.json"), r#"[{"id":0,"name":"liver"},{"id":1,"name":"fat"}]"#).unwrap();
    write_poses(folder.path(), &[[X, Y, Z, O, [6.0, 8.0, 20.0]]; 2], true);
    let report = report(folder.path());
    assert!(report.ok && report.errors.is_empty() && report.warnings.is_empty(), "{report:?}");
    assert!(report.camera.starts_with("given, still"), "{}", report.camera);
    assert!(
        report.depth.contains("100.0000 to 100.0000") && report.depth.contains("87.5 %"),
        "{}",
        report.depth
    );
    assert!(report.masks.contains("black is kept, 25.0 % hidden"), "{}", report.masks);
    assert!(report.masks.contains("75.0 % of the pixels are used"), "{}", report.masks);
    assert!(report.labels.contains("liver (2), fat (1)"), "{}", report.labels);
}

#[test]
fn masks_that_hide_nearly_everything_are_called_inverted() {
    let folder = tempfile::tempdir().unwrap();
    let recording = folder.path().join("clip");
    let at = |name: &str| recording.join(name);
    write_pictures(&at("images"), &["0.png", "1.png"]);
    write_grey(&at("masks/0.png"), 7, 255);
    write_grey(&at("masks/1.png"), 8, 255);
    let found = report(&recording);
    assert!(any(&found.warnings, "Masks hide 94 %") && any(&found.warnings, "keep = \"white\""), "{found:?}");
    assert!(!found.ok && any(&found.errors, "Nothing of frame 1 is left"), "{found:?}");
    // The warning is gone after its advice was followed.
    let sequence = Sequence::open(&recording).unwrap();
    let decided = sequence.flip_masks().unwrap();
    assert_eq!(decided, folder.path().canonicalize().unwrap().join("clip.surgtpgs.toml"));
    assert!(std::fs::read_to_string(&decided).unwrap().ends_with("keep_masks = \"white\"\n"));
    assert_eq!(std::fs::read_dir(&recording).unwrap().count(), 2, "nothing is written into the recording");
    let found = report(&recording);
    assert!(found.ok && !any(&found.warnings, "inverted"), "{found:?}");
}

#[test]
fn masks_are_flipped_back_and_other_settings_stay() {
    let folder = tempfile::tempdir().unwrap();
    let recording = folder.path().join("clip");
    let at = |name: &str| recording.join(name);
    write_pictures(&at("images"), &["0.png"]);
    assert!(Sequence::open(&recording).unwrap().flip_masks().is_err(), "there are no masks");
    write_grey(&at("masks/0.png"), 2, 255);
    std::fs::write(at("sequence.toml"), "[time]\nframes_per_second = 25.0\n").unwrap();
    let kept = || Sequence::open(&recording).unwrap().mask(0).unwrap().count();
    let before = kept();
    Sequence::open(&recording).unwrap().flip_masks().unwrap();
    assert_eq!(kept(), 48 - before);
    Sequence::open(&recording).unwrap().flip_masks().unwrap();
    let sequence = Sequence::open(&recording).unwrap();
    assert_eq!((kept(), sequence.frames_per_second()), (before, Some(25.0)));
    Sequence::open(&recording).unwrap().flip_masks().unwrap();
    write_pictures(&at("images"), &["1.png"]);
    write_grey(&at("masks/1.png"), 2, 255);
    let sequence = Sequence::open(&recording).unwrap();
    assert_eq!(sequence.mask(0).unwrap().count(), before, "it is another recording now");
    assert!(any(&report(&recording).warnings, "about other frames"));
    std::fs::write(folder.path().join("clip.surgtpgs.toml"), "keep_masks = \"white\"\n").unwrap();
    assert!(sequence.flip_masks().unwrap_err().to_string().contains("did not write"), "somebody else's file");
}

#[test]
fn damaged_files_become_errors_and_the_rest_is_still_read() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    write_pictures(&at("images"), &["0.png", "1.png", "2.png"]);
    for i in 0..3 {
        write_grey(&at(&format!("masks/{i}.png")), 2, 255);
    }
    let whole = std::fs::read(at("images/1.png")).unwrap();
    std::fs::write(at("images/1.png"), &whole[..80]).unwrap();
    picture(4, 6, 0).save(at("masks/2.png")).unwrap();
    let found = report(folder.path());
    assert!(!found.ok && found.errors.len() == 2, "{found:?}");
    assert!(any(&found.errors, "images/1.png") && any(&found.errors, "masks/2.png"), "{found:?}");
    assert!(any(&found.errors, "4×6"), "{found:?}");
    assert!(found.masks.contains("in 2 of 3 frames"), "{}", found.masks);
}

#[test]
fn depth_gaps_and_values_that_are_no_numbers_are_told() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    write_pictures(&at("images"), &["0.png", "1.png", "2.png"]);
    write_grey(&at("depth/0.png"), 4, 9);
    write_grey(&at("depth/1.png"), 0, 9);
    let mut values = ndarray::Array2::from_elem((3, 4), 7.0_f32);
    values[(0, 1)] = f32::NAN;
    ndarray_npy::write_npy(at("depth/2.npy"), &values).unwrap();
    let found = report(folder.path());
    assert!(any(&found.warnings, "Depth map 0 has 50 % zeros; training will ignore them"), "{found:?}");
    assert!(any(&found.errors, "Depth map 1 has no valid value"), "{found:?}");
    assert!(any(&found.warnings, "The depth maps of frame 2 hold 1 values"), "{found:?}");
    assert!(any(&found.warnings, "frame 2 are not of the frames' size (4×3)"), "{found:?}");
    assert!(any(&found.warnings, "field of view of 60°"), "{found:?}");
}

#[test]
fn cameras_that_cannot_be_are_refused_and_unlikely_ones_told() {
    let folder = tempfile::tempdir().unwrap();
    write_pictures(folder.path(), &["0.png", "1.png"]);
    let set = |camera: &str| {
        std::fs::write(folder.path().join("sequence.toml"), format!("[camera]\n{camera}\n")).unwrap();
    };
    for wrong in ["fx = 1e30", "fx = 1e-30", "fx = 8.0\ncx = -1e9", "fov_x_degrees = 0.0001"] {
        set(wrong);
        let text = message(Sequence::open(folder.path()));
        assert!(
            text.contains("[camera] cannot be right") && text.contains("sequence.toml"),
            "{wrong}: {text}"
        );
    }
    for (strange, told) in [
        ("fov_x_degrees = 5.0", "field of view of 5.0°"),
        ("fx = 8.0\ncx = 9.0", "principal point at 9.0, 3.0 is outside of the pictures"),
    ] {
        set(strange);
        let found = report(folder.path());
        assert!(found.ok && any(&found.warnings, told), "{found:?}");
    }
    set("fx = 8.0");
    assert!(!any(&report(folder.path()).warnings, "[camera]"));
}

#[test]
fn mirrored_poses_and_repeated_frames_are_told() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    write_pictures(&at("images"), &["0.png", "1.png"]);
    std::fs::copy(at("images/0.png"), at("images/1.png")).unwrap();
    let mirrored = [X, Y, [0.0, 0.0, -1.0], O, [6.0, 8.0, 20.0]];
    write_poses(folder.path(), &[[X, Y, Z, O, [6.0, 8.0, 20.0]], mirrored], true);
    let found = report(folder.path());
    assert!(any(&found.errors, "Pose 1 is not a rotation (determinant -1.000): mirrored axes?"), "{found:?}");
    assert!(any(&found.warnings, "Frame 1 is the same picture as frame 0"), "{found:?}");
    assert!(any(&found.warnings, "There is no depth"), "{found:?}");
}

#[test]
fn frames_that_a_change_of_the_frame_rate_repeats_are_told() {
    let folder = tempfile::tempdir().unwrap();
    for i in 0..12_u32 {
        // Frames 3, 7 and 11 are the ones before, compressed a second time.
        let (shown, error) = if i % 4 == 3 { (i - 1, u32::from(i == 7)) } else { (i, 0) };
        let level = |x: u32, y: u32| ((x + shown) * 13 % 200 + y + error * u32::from(x == y)) as u8;
        let picture = image::RgbImage::from_fn(40, 30, |x, y| image::Rgb([level(x, y); 3]));
        std::fs::create_dir_all(folder.path().join("images")).unwrap();
        picture.save(folder.path().join(format!("images/{i:02}.png"))).unwrap();
    }
    let found = report(folder.path());
    assert!(any(&found.warnings, "as a changed frame rate leaves them: frames 3, 7, 11."), "{found:?}");
    assert!(!any(&found.warnings, "same picture"), "{found:?}");
}

#[test]
fn labels_that_name_no_class_or_are_read_in_another_way_are_told() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    write_pictures(&at("images"), &["0.png", "1.png"]);
    std::fs::create_dir_all(at("labels")).unwrap();
    std::fs::write(at("labels.json"), r#"[{"id":0,"name":"liver"},{"id":1,"name":"fat"}]"#).unwrap();
    let picture = image::GrayImage::from_fn(8, 6, |x, _| Luma([if x < 4 { 1 } else { 77 }]));
    picture.save(at("labels/0.png")).unwrap();
    image::RgbImage::from_pixel(8, 6, image::Rgb([1; 3])).save(at("labels/1.png")).unwrap();
    let found = report(folder.path());
    assert!(any(&found.warnings, "25.0 % of the labelled frames' pixels have a value"), "{found:?}");
    assert!(any(&found.warnings, "names no class (77), in frame 0"), "{found:?}");
    assert!(any(&found.warnings, "frame 1 are grey pictures saved in colour"), "{found:?}");
    assert!(found.labels.contains("fat (2)"), "{}", found.labels);
}

#[test]
fn missing_pictures_are_told_and_their_times_pass() {
    let folder = tempfile::tempdir().unwrap();
    write_pictures(folder.path(), &["1.png", "2.png", "3.png", "7.png", "8.png"]);
    let found = report(folder.path());
    assert!(any(&found.warnings, "missing between 3 and 7; no time passes there"), "{found:?}");
    let opened = |settings: &str| {
        std::fs::write(folder.path().join("sequence.toml"), settings).unwrap();
        Sequence::open(folder.path()).unwrap()
    };
    assert_eq!(opened("").frame_seconds(), [0.0; 0]);
    let known = opened("[time]\nframes_per_second = 10.0\n");
    assert_eq!(known.frame_seconds(), [0.0, 0.1, 0.2, 0.6, 0.7]);
    assert!((known.time(3) - 6.0 / 8.0).abs() < 1e-6, "the tissue moves meanwhile");
    assert!(any(&report(folder.path()).warnings, "between 3 and 7; times follow the numbers"));
    let before = opened("[time]\nframes_per_second = 10.0\n[frames]\nlast = 2\n");
    assert_eq!(before.frame_seconds(), [0.0; 0], "what is left has no gap");
    assert!(!any(&report(folder.path()).warnings, "missing"));
}
