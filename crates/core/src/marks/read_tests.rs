//! Files of marks, and what is wrong in them.

use super::{
    tests::{FRAMES, SIZE, canvas, stroke},
    *,
};
use crate::{
    Result,
    grid::Mask,
    mask::{column_runs, compressed},
};
use std::path::Path;

fn read(text: &str) -> Result<Marks> {
    Marks::parse(text.as_bytes(), Path::new("."), &canvas())
}

fn refused(mark: &str) -> String {
    read(&format!(
        r#"{{"marks": [{{"frame": 0, "name": "fat", "kind": "click", "points_px": [[1, 1]]}}, {mark}]}}"#
    ))
    .unwrap_err()
    .to_string()
}

#[test]
fn a_file_of_marks_is_read() {
    let marks = read(
        r#"{"marks": [
            {"frame": 2, "name": "Bile_Duct", "kind": "stroke", "add": false, "points_px": [[1, 2], [3.5, 4]], "radius_px": 2},
            {"frame": 0, "name": "liver", "kind": "click", "points_px": [[64, 48]]},
            {"frame": 0, "name": "liver", "kind": "box", "points_px": [[1, 1], [9, 9]]}]}"#,
    )
    .unwrap();
    assert_eq!((marks.names(), marks.frames()), (vec!["bile duct".into(), "liver".into()], vec![0, 2]));
    assert!(!marks.all()[0].add && marks.all()[1].add);
    assert_eq!(marks.all()[1].shape, Shape::Click { point_px: [64.0, 48.0], radius_px: 6.0 });
}

#[test]
fn marks_are_read_as_they_were_written() {
    let mask = Mask::from_vec(SIZE[0], SIZE[1], (0..SIZE[0] * SIZE[1]).map(|i| i % 7 > 2).collect());
    let marks = [
        Shape::Click { point_px: [1.1, 2.0], radius_px: 0.5 },
        Shape::Stroke { points_px: vec![[1.0 / 3.0, 2.0], [64.0, 48.0]], radius_px: 4.0 },
        Shape::Polygon { points_px: vec![[5.0, 5.0], [60.0, 8.0], [30.0, 44.0]] },
        Shape::Box { corners_px: [[9.0, 9.0], [1.0, 1.0]] },
        Shape::from(&mask),
    ];
    let marks: Vec<Mark> = marks
        .into_iter()
        .enumerate()
        .map(|(i, shape)| Mark::new(i % FRAMES, "bile duct", i % 2 > 0, shape))
        .collect();
    let marks = Marks::new(marks, &canvas()).unwrap();
    assert_eq!(read(&marks.to_text().unwrap()).unwrap(), marks);
    let runs = r#"{"frame": 1, "name": "fat", "kind": "mask", "mask": {"size": [48, 64], "counts": "1"}}"#;
    assert!(refused(runs).contains("the run lengths of its mask do not come to its size"));
}

#[test]
fn a_bad_mark_is_named() {
    for (mark, says) in [
        (r#"{"frame": 9, "name": "liver", "kind": "click", "points_px": [[1, 1]]}"#, "there is no frame 9"),
        (r#"{"frame": 1, "name": " ", "kind": "click", "points_px": [[1, 1]]}"#, "no name"),
        (r#"{"frame": 1, "kind": "click", "points_px": [[1, 1]]}"#, "no name"),
        (r#"{"frame": 1, "name": "*?", "kind": "click", "points_px": [[1, 1]]}"#, "no name"),
        (r#"{"frame": 1, "name": "🙂", "kind": "click", "points_px": [[1, 1]]}"#, "no name"),
        (r#"{"frame": 1.5, "name": "liver", "kind": "click", "points_px": [[1, 1]]}"#, "a whole number"),
        (r#"{"name": "liver", "kind": "click", "points_px": [[1, 1]]}"#, "no frame"),
        (r#"{"frame": 1, "name": "liver", "points_px": [[1, 1]]}"#, "no kind"),
        (r#"{"frame": 1, "name": "liver", "kind": "lasso"}"#, "lasso"),
        (r#"{"frame": 1, "name": "liver", "kind": "click", "points_px": [[NaN, 1]]}"#, "not a number"),
        (r#"{"frame": 1, "name": "liver", "kind": "click", "points_px": [[1, -Infinity]]}"#, "not a number"),
        (r#"{"frame": 1, "name": "liver", "kind": "click", "points_px": [[65, 1]]}"#, "outside"),
        (r#"{"frame": 1, "name": "liver", "kind": "click", "points_px": []}"#, "one point"),
        (
            r#"{"frame": 1, "name": "liver", "kind": "polygon", "points_px": [[1, 1], [2, 2]]}"#,
            "three corners",
        ),
        (r#"{"frame": 1, "name": "liver", "kind": "mask", "mask": "nowhere.png"}"#, "nowhere.png"),
        (r#"{"frame": 1, "name": "liver", "kind": "mask"}"#, "no mask picture"),
        (r#"{"frame": 1, "name": "liver", "kind": "click", "points_px": [[1, 1]], "size": 3}"#, "size"),
        (r#"{"frame": -1, "name": "liver", "kind": "click", "points_px": [[1, 1]]}"#, "marks[1]"),
        ("7", "it must be {"),
        (r#"{"frame": 1, "name": 3, "kind": "click", "points_px": [[1, 1]]}"#, "name must be text, not 3"),
        (r#"{"frame": 1, "name": "liver", "kind": "click", "points_px": [[1, 1, 1]]}"#, "a list of points"),
        (r#"{"frame": 1, "name": "liver", "kind": "click", "points_px": [[1, 1e400]]}"#, "not a number"),
        (
            r#"{"frame": 1, "name": "liver", "kind": "click", "points_px": [[1, 1]], "radius_px": "6"}"#,
            "radius_px must be a number, not \"6\"",
        ),
        (
            r#"{"frame": 1, "name": "liver", "kind": "click", "points_px": [[1, 1]], "radius_px": null}"#,
            "radius_px must be a number",
        ),
        (
            r#"{"frame": 1, "name": "liver", "kind": "click", "points_px": [[1, 1]], "add": null}"#,
            "add must be true or false",
        ),
        (r#"{"frame": 1, "name": "liver", "kind": "mask", "mask": 3}"#, "mask must be the name of a picture"),
        (
            r#"{"frame": 1, "name": "liver", "kind": "click", "points_px": [[1, 1]], "mask": "a.png"}"#,
            "the kind \"mask\" alone",
        ),
        (
            r#"{"frame": 1, "name": "liver", "kind": "mask", "points_px": [[1, 1]], "mask": "a.png"}"#,
            "which a mask does not have",
        ),
        (
            r#"{"frame": 1, "name": "li\u0007ver", "kind": "click", "points_px": [[1, 1]]}"#,
            "control characters",
        ),
    ] {
        let message = refused(mark);
        assert!(message.contains(says) && message.starts_with("marks[1]"), "{mark}: {message}");
    }
    assert!(read("{}").unwrap_err().to_string().contains("no list \"marks\""));
    assert!(read("{").unwrap_err().to_string().contains("no file of marks"));
    assert!(read("[").unwrap_err().to_string().contains("Label Studio"));
    let bare = read(r#"[{"frame": 1, "name": "liver", "kind": "click", "points_px": [[1, 1]]}]"#);
    assert!(bare.unwrap_err().to_string().contains("the list must be in {\"marks\": […]}"));
    let missing = Marks::read(Path::new("nowhere.json"), &canvas()).unwrap_err().to_string();
    assert!(missing.contains("could not read the marks"), "{missing}");
}

#[test]
fn a_name_that_is_too_long_is_refused() {
    let named = |length: usize| {
        let name = "é".repeat(length);
        refused(&format!(r#"{{"frame": 9, "name": "{name}", "kind": "click", "points_px": [[1, 1]]}}"#))
    };
    assert!(named(200).contains("there is no frame 9"));
    let told = named(201);
    assert!(told.contains("its name has 201 characters, more than 200") && told.len() < 300, "{told}");
}

#[test]
fn names_that_hold_what_json_lacks_are_left_alone() {
    let marks = read(
        r#"{"marks": [{"frame": 0, "name": "NaN \" Infinity", "kind": "click", "points_px": [[1, 1]]}]}"#,
    );
    assert_eq!(marks.unwrap().names(), ["na n \" infinity"]);
}

#[test]
fn names_are_words_in_any_script() {
    for name in ["胆のう", "печень", "กระเพาะ", "7", "+ liver"] {
        assert!(
            Mark::new(0, name, true, stroke(0, "fat", true, &[[8.0, 10.0]]).shape).fits(&canvas()),
            "{name}"
        );
    }
}

#[test]
fn coco_annotations_are_marks() {
    let mask = Mask::from_vec(SIZE[0], SIZE[1], (0..SIZE[0] * SIZE[1]).map(|i| i % 64 > 50).collect());
    let runs = serde_json::Value::from(compressed(&column_runs(&mask)));
    let file = |annotation: &str| {
        format!(
            r#"{{"categories": [{{"id": 1, "name": "liver"}}],
                "images": [{{"id": 7, "file_name": "0002.png", "frame": 2}}, {{"id": 8, "file_name": "picture_3.jpg"}}, {{"id": 9}}],
                "annotations": [{annotation}]}}"#
        )
    };
    let text = file(&format!(
        r#"{{"image_id": 7, "category_id": 1, "segmentation": {{"size": [48, 64], "counts": {runs}}}}},
           {{"image_id": 8, "category_id": 1, "segmentation": [[1, 1, 9, 1, 9, 9]]}}"#
    ));
    let marks = read(&text).unwrap();
    assert_eq!((marks.frames(), marks.names()), (vec![2, 3], vec!["liver".to_owned()]));
    assert_eq!(marks.all()[0].shape, Shape::from(&mask));
    for (annotation, says) in [
        (r#"{"image_id": 9, "category_id": 1, "segmentation": [[1, 1, 9, 1, 9, 9]]}"#, "no frame"),
        (r#"{"image_id": 7, "category_id": 2, "segmentation": [[1, 1, 9, 1, 9, 9]]}"#, "no category"),
        (
            r#"{"image_id": 7, "category_id": 1, "segmentation": {"size": [4800, 64], "counts": "0"}}"#,
            "segmentation",
        ),
        (r#"{"image_id": 7, "category_id": 1, "segmentation": [[1, 1, 9]]}"#, "segmentation"),
    ] {
        let message = read(&file(annotation)).unwrap_err().to_string();
        assert!(message.contains(says) && message.contains("annotations[0]"), "{message}");
    }
}

#[test]
fn dicom_segmentations_are_marks_and_labels() {
    let folder = tempfile::tempdir().unwrap();
    let mask = Mask::from_vec(SIZE[0], SIZE[1], (0..SIZE[0] * SIZE[1]).map(|i| i % 64 > 50).collect());
    let file = crate::export::tests::segmentation_of(folder.path(), &mask, 2);
    let marks = Marks::read(&file, &canvas()).unwrap();
    assert_eq!((marks.frames(), marks.names()), (vec![2], vec!["liver".to_owned()]));
    assert_eq!(marks.all()[0].shape, Shape::from(&mask));
    let small = Canvas { width: 8, ..canvas() };
    assert!(Marks::read(&file, &small).unwrap_err().to_string().contains("64×48"));
    let short = Canvas { num_frames: 2, frame_names: Vec::new(), ..canvas() };
    assert!(Marks::read(&file, &short).unwrap_err().to_string().contains("no frame"));

    let recording = folder.path().join("recording");
    std::fs::create_dir(&recording).unwrap();
    for i in 0..4 {
        let picture =
            image::RgbImage::from_pixel(SIZE[0] as u32, SIZE[1] as u32, image::Rgb([90 + i, 80, 70]));
        picture.save(recording.join(format!("{i}.png"))).unwrap();
    }
    let file = file.strip_prefix(folder.path()).unwrap();
    let toml = format!("[labels]\nfile = \"../{}\"\n", file.display());
    std::fs::write(recording.join("sequence.toml"), toml).unwrap();
    let sequence = crate::sequence::Sequence::open(&recording).unwrap();
    assert_eq!((sequence.classes()[0].name.as_str(), sequence.classes()[0].id), ("liver", 1));
    assert_eq!(sequence.labels(1).unwrap(), None);
    assert_eq!(sequence.labels(2).unwrap().unwrap().map(|id| *id == 1), mask);
}
