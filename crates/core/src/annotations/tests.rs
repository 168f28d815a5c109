use super::*;
use crate::{
    export::{Export, ExportOptions, ExportPrompt, Format, Provenance, tests::segmentation_of},
    grid::{Grid, Mask},
    sequence::Sequence,
};
use proptest::prelude::*;
use std::path::{Path, PathBuf};

const SIZE: [usize; 2] = [37, 23];
const FRAMES: usize = 5;
/// The frames that are exported.
const EXPORTED: std::ops::Range<usize> = 1..4;
/// A name with everything that XML, JSON and the header of a volume have to escape.
const NAMES: [&str; 2] = ["gall \"<&\\ 胆囊", "liver"];

fn canvas() -> Canvas {
    let frame_names = (0..FRAMES).map(|i| format!("shot {i}")).collect();
    Canvas { width: SIZE[0], height: SIZE[1], frame_names, num_frames: FRAMES }
}

/// Returns the mask of a prompt on a frame: specks and blocks that reach the borders; one is empty.
fn mask(frame: usize, prompt: usize, seed: u64) -> Mask {
    let is_set = |i: usize| {
        let (x, y) = (i % SIZE[0], i / SIZE[0]);
        let speck = (seed | 1).wrapping_mul((i + 7 * frame + 1) as u64).rotate_left(23).is_multiple_of(7);
        let block = if prompt == 0 { x < 9 + frame && y > 3 } else { x + y > 30 || x > 33 };
        (frame, prompt) != (2, 1) && (speck && y % 3 == 0) != block
    };
    Mask::from_vec(SIZE[0], SIZE[1], (0..SIZE[0] * SIZE[1]).map(is_set).collect())
}

/// Exports the masks in one format and returns the bytes of its file.
fn exported(format: Format, exclusive: bool, seed: u64) -> Vec<u8> {
    let prompt = |text: &&str| ExportPrompt {
        text: (*text).into(),
        threshold: 0.5,
        colour: [200, 20, 100],
        negatives: Vec::new(),
        is_instrument: false,
        certainty: None,
        stands_for: None,
    };
    let provenance = Provenance {
        prompts: NAMES.iter().map(prompt).collect(),
        sequence_frames: FRAMES,
        sequence_frame_names: (0..FRAMES).map(|i| format!("shot {i}.png")).collect(),
        options: ExportOptions { formats: vec![format], exclusive, ..Default::default() },
        ..crate::export::tests::plain_provenance()
    };
    let folder = tempfile::tempdir().unwrap();
    let mut export = Export::begin(folder.path(), EXPORTED.collect(), provenance).unwrap();
    let picture = image::RgbImage::new(SIZE[0] as u32, SIZE[1] as u32);
    while let Some(frame) = export.next_frame() {
        // The first prompt wins where both are.
        let scores = [0.9, 0.8].into_iter().enumerate();
        let scores: Vec<Grid<f32>> =
            scores.map(|(k, score)| mask(frame, k, seed).map(|set| if *set { score } else { 0.1 })).collect();
        export.write(&picture, &scores, None).unwrap();
    }
    export.finish().unwrap();
    let name = format!("{}/frames_000001-000003.{}", format.name(), format.extension());
    std::fs::read(folder.path().join(name)).unwrap()
}

/// Returns frame, name and mask of all annotations, sorted.
fn masks_in(bytes: &[u8]) -> Vec<(usize, String, Mask)> {
    let found = checked(parse(bytes, &canvas()).unwrap().unwrap(), &canvas()).unwrap();
    let pixels = |a: Annotation| (a.frame, a.name, a.shape.pixels(SIZE[0], SIZE[1]));
    let mut found: Vec<_> = found.into_iter().map(pixels).collect();
    found.sort_by(|a, b| (a.0, &a.1).cmp(&(b.0, &b.1)));
    found
}

fn expected(exclusive: bool, seed: u64) -> Vec<(usize, String, Mask)> {
    let mut masks = Vec::new();
    for frame in EXPORTED {
        let first = mask(frame, 0, seed);
        let mut second = mask(frame, 1, seed);
        if exclusive {
            second.data.iter_mut().zip(&first.data).for_each(|(b, a)| *b &= !a);
        }
        masks.extend([(frame, NAMES[0].into(), first), (frame, NAMES[1].into(), second)]);
    }
    masks.retain(|(_, _, mask): &(_, String, Mask)| mask.count() > 0);
    masks
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(16))]
    #[test]
    fn every_format_gives_the_same_masks_back(seed in any::<u64>(), exclusive in any::<bool>()) {
        for format in [Format::Coco, Format::Cvat, Format::LabelStudio, Format::Nrrd] {
            let found = masks_in(&exported(format, exclusive, seed));
            prop_assert_eq!(found, expected(exclusive, seed), "{}", format.name());
        }
    }

    #[test]
    fn damaged_files_are_refused_or_understood(
        which in 0..4_usize, at in any::<prop::sample::Index>(), byte in any::<u8>(), cuts in any::<bool>()
    ) {
        let format = [Format::Coco, Format::Cvat, Format::LabelStudio, Format::Nrrd][which];
        let mut bytes = exported(format, false, 3);
        let at = at.index(bytes.len());
        if cuts { bytes.truncate(at) } else { bytes[at] = byte }
        let understood = |found: Option<_>| checked(found.unwrap_or_default(), &canvas());
        if let Ok(found) = parse(&bytes, &canvas()).and_then(understood) {
            prop_assert!(found.iter().all(|a| a.frame < FRAMES));
        }
    }
}

/// Wraps elements as CVAT does.
fn cvat(inner: &str) -> String {
    format!("<?xml version=\"1.0\"?>\n<annotations><version>1.1</version>{inner}</annotations>")
}

fn shapes_of(text: &str) -> Vec<(usize, String, usize)> {
    masks_in(text.as_bytes()).into_iter().map(|(frame, name, mask)| (frame, name, mask.count())).collect()
}

#[test]
fn polygons_and_boxes_of_cvat_are_read() {
    let images = cvat(
        r#"<image id="7" name="deep/shot 3.jpg" width="37" height="23">
            <box label="fat" xtl="1.0" ytl="1.0" xbr="5.0" ybr="4.0"/>
            <box label="fat" xtl="10" ytl="10" xbr="14" ybr="18" rotation="90"/>
            <polygon label="liver" points="20.0,0.0;30.0,0.0;30.0,10.0;20.0,10.0"><attribute name="a">b</attribute></polygon>
            </image>"#,
    );
    let expected = [(3, "fat".to_owned(), 12), (3, "fat".into(), 32), (3, "liver".into(), 100)];
    assert_eq!(shapes_of(&images), expected);
    let track = cvat(
        r#"<track id="0" label="fat"><box frame="2" outside="0" xtl="0" ytl="0" xbr="2" ybr="2"/>
            <box frame="3" outside="1" xtl="0" ytl="0" xbr="2" ybr="2"/></track>"#,
    );
    assert_eq!(shapes_of(&track), [(2, "fat".into(), 4)]);
}

#[test]
fn what_cvat_files_lack_is_named() {
    let mask = |attributes: &str| cvat(&format!("<track label=\"fat\"><mask {attributes}/></track>"));
    for (text, says) in [
        ("<html></html>".to_owned(), "no element \"annotations\""),
        ("<annotations".to_owned(), "no XML file of CVAT"),
        (mask("frame=\"9\" rle=\"1\" left=\"0\" top=\"0\" width=\"1\" height=\"1\""), "no such frame"),
        (mask("frame=\"1\" rle=\"2\" left=\"0\" top=\"0\" width=\"1\" height=\"1\""), "run lengths"),
        (mask("frame=\"1\" rle=\"1,99\" left=\"30\" top=\"0\" width=\"10\" height=\"10\""), "run lengths"),
        (mask("frame=\"1\" rle=\"1\" left=\"0\" top=\"0\" width=\"1\""), "a mask has no height"),
        (mask("frame=\"1\" rle=\"1\" left=\"99999999999999999999\" top=\"0\""), "left is"),
        (mask("rle=\"1\""), "a mask has no frame"),
        (cvat("<mask frame=\"1\"/>"), "a mask has no label"),
        (cvat("<track label=\"fat\"><ellipse frame=\"1\"/></track>"), "ellipse"),
        (cvat("<image name=\"other.png\"/>"), "\"other.png\" is no frame"),
        (cvat("<image name=\"shot 1.png\" width=\"9\" height=\"9\"/>"), "pictures of 9×9"),
        (cvat("<image name=\"shot 1.png\"><polygon label=\"x\" points=\"1,a\"/></image>"), "points"),
    ] {
        let message = parse(text.as_bytes(), &canvas()).unwrap_err().to_string();
        assert!(message.contains(says), "{text}: {message}");
    }
}

#[test]
fn corrected_regions_of_label_studio_count() {
    let region = |kind: &str, value: &str| {
        format!(
            r#"{{"type": "{kind}", "original_width": 37, "original_height": 23, "value": {{{value}, "{kind}": ["fat"]}}}}"#
        )
    };
    let square = region("rectanglelabels", r#""x": 0, "y": 0, "width": 50, "height": 100, "rotation": 0"#);
    let polygon = region("polygonlabels", r#""points": [[0, 0], [100, 0], [100, 100], [0, 100]]"#);
    let task = |image: &str, predicted: &str, corrected: &str| {
        format!(
            r#"[{{"data": {{"image": "{image}"}}, "predictions": [{{"result": [{predicted}]}}], "annotations": [{corrected}]}}]"#
        )
    };
    let corrected = format!(
        r#"{{"was_cancelled": true, "result": []}}, {{"result": [{polygon}, {{"type": "choices", "value": {{"choices": ["x"]}}}}]}}"#
    );
    let text = task("/data/upload/3/1a2b3c4d-shot 4.png", &square, &corrected);
    assert_eq!(shapes_of(&text), [(4, "fat".into(), 37 * 23)]);
    let predicted = task("/data/local-files/?d=a/shot 2.png", &square, "");
    // The middle of the picture is the middle of a column, which counts to the right.
    assert_eq!(shapes_of(&predicted), [(2, "fat".into(), 18 * 23)]);
    for (text, says) in [
        (task("nowhere.png", &square, ""), "no frame of the recording"),
        (task("shot 1.png", &region("ellipselabels", "\"x\": 1"), ""), "no area"),
        (task("shot 1.png", &region("brushlabels", "\"rle\": [0, 1, 2]"), ""), "its mask is none"),
        (task("shot 1.png", &region("brushlabels", "\"rle\": [300]"), ""), "no file of Label Studio"),
        (task("shot 1.png", &square.replace("37", "38"), ""), "pictures of 38×23"),
        (task("shot 1.png", &square.replace("\"fat\"", ""), ""), "no label"),
        ("[{]".into(), "no file of Label Studio"),
    ] {
        let message = parse(text.as_bytes(), &canvas()).unwrap_err().to_string();
        assert!(message.contains(says), "{text}: {message}");
    }
}

#[test]
fn images_of_tasks_tell_more_than_other_words() {
    let frame_names = (0..9).map(|i| format!("{i}.png")).collect();
    let canvas = Canvas { frame_names, num_frames: 9, ..canvas() };
    let value = r#"{"x": 0, "y": 0, "width": 9, "height": 9, "rectanglelabels": ["fat"]}"#;
    let result = format!(r#"[{{"type": "rectanglelabels", "value": {value}}}]"#);
    let frame = |data: &str| {
        let text = format!(r#"[{{"data": {{{data}}}, "annotations": [{{"result": {result}}}]}}]"#);
        Ok::<_, Error>(parse(text.as_bytes(), &canvas)?.unwrap()[0].frame)
    };
    for (data, expected) in [
        (r#""case": "3", "image": "/data/upload/7.png""#, 7),
        (r#""case": "3", "url": "https://host/7.png?key=2", "frame": 1"#, 7),
        (r#""case": "3", "image": "0007.png", "frame": 5"#, 5),
        (r#""case": "3", "frame": 5"#, 5),
        (r#""picture": "3""#, 3),
        (r#""url": "https://host/7", "frame": 1"#, 7),
        (r#""video": "https://host/clip.mp4", "frame": 4"#, 4),
        (r#""video": "/data/upload/1/clip.mp4", "frame": 4"#, 4),
        (r#""image": "a/other.png", "url": "/data/local-files/?d=a/6.png", "frame": 5"#, 6),
        (r#""page": "https://host/view.html?x=1", "site": "https://host/", "frame": 4"#, 4),
    ] {
        assert_eq!(frame(data).unwrap(), expected, "{data}");
    }
    for data in [
        r#""case": "3", "image": "a/other.png""#,
        r#""case": "3", "image": "other", "frame": 3"#,
        r#""url": "https://host/other", "frame": 3"#,
        r#""image": "a/other.png", "issue": "https://tracker/issues/8812", "frame": 5"#,
        r#""image": "a/other.png", "small": "https://host/0007.png", "frame": 5"#,
    ] {
        let message = frame(data).unwrap_err().to_string();
        assert!(message.contains("is no frame of the recording, and neither"), "{data}: {message}");
    }
}

/// Returns bytes in which `to` is everywhere in the place of `from`, which is as long.
fn replaced(bytes: &[u8], from: &[u8], to: &[u8]) -> Vec<u8> {
    let mut out = bytes.to_vec();
    let places = (0..=bytes.len() - from.len()).filter(|&at| bytes[at..].starts_with(from));
    places.for_each(|at| out[at..at + from.len()].copy_from_slice(to));
    out
}

#[test]
fn names_of_segments_are_read_in_their_character_set() {
    let folder = tempfile::tempdir().unwrap();
    let file = segmentation_of(folder.path(), &mask(1, 0, 3), 1);
    let bytes = std::fs::read(&file).unwrap();
    let name_in = |character_set: &[u8], name: &[u8]| {
        let changed = replaced(&replaced(&bytes, b"ISO_IR 192", character_set), b"liver ", name);
        std::fs::write(&file, changed).unwrap();
        read(&file, &canvas()).map(|found| found[0].name.clone())
    };
    assert_eq!(name_in(b"ISO_IR 192", b"liver ").unwrap(), "liver");
    assert_eq!(name_in(b"ISO_IR 192", b"v\xc3\xa9in ").unwrap(), "véin");
    assert_eq!(name_in(b"ISO_IR 100", b"v\xe9ine ").unwrap(), "véine");
    for (character_set, name) in [(b"GB18030   ", b"\xb8\xce\xd4\xe0  "), (b"ISO_IR 13 ", b"\x1b$B12 ")] {
        let message = name_in(character_set, name).unwrap_err().to_string();
        assert!(message.contains("character set"), "{message}");
    }
}

#[test]
fn cropped_volumes_of_slicer_are_placed() {
    let header = "NRRD0004\n# Slicer\ntype: unsigned char\ndimension: 3\nsizes: 3 2 2\nencoding: raw\nendian: little\n\
                  Segmentation_ReferenceImageExtentOffset:=30 20 2\nSegment0_Name:=fat\nSegment0_LabelValue:=4\n\
                  Segment1_Name:=liver\nSegment1_LabelValue:=9\n\n";
    let voxels = [4, 0, 9, 9, 9, 0, 0, 0, 0, 0, 0, 4];
    let volume = |header: &str| [header.as_bytes(), &voxels].concat();
    let found = masks_in(&volume(header));
    let places: Vec<_> =
        found.iter().map(|(frame, name, mask)| (*frame, name.as_str(), mask.count())).collect();
    assert_eq!(places, [(2, "fat", 1), (2, "liver", 3), (3, "fat", 1)]);
    assert!(found[0].2.at(30, 20) && found[1].2.at(32, 20) && found[2].2.at(32, 21));
    for (from, to, says) in [
        ("raw", "bzip2", "encoding"),
        ("unsigned char", "float", "of the type"),
        ("3 2 2", "3 2 3000000000", "do not fit"),
        ("3 2 2", "300 2 2 2", "do not fit"),
        ("3 2 2", "3 2 3", "voxels cannot be read"),
        ("30 20 2", "35 20 2", "do not fit"),
        ("Segment0_Name", "Segment2_Name", "names no segment"),
        ("LabelValue:=4", "LabelValue:=0", "no label"),
    ] {
        let message = parse(&volume(&header.replace(from, to)), &canvas()).unwrap_err().to_string();
        assert!(message.contains(says), "{to}: {message}");
    }
}

/// Writes a recording into a folder of `folder`.
fn recording_in(folder: &Path) -> PathBuf {
    let rec = folder.join("rec");
    std::fs::create_dir(&rec).unwrap();
    for i in 0..FRAMES {
        image::RgbImage::new(SIZE[0] as u32, SIZE[1] as u32).save(rec.join(format!("shot {i}.png"))).unwrap();
    }
    rec
}

/// Returns a COCO file with a triangle on each of the images.
fn coco(images: &[&str]) -> String {
    let images: Vec<String> =
        images.iter().enumerate().map(|(i, rest)| format!(r#"{{"id": {i}, {rest}}}"#)).collect();
    let triangle =
        |i| format!(r#"{{"image_id": {i}, "category_id": 1, "segmentation": [[0, 0, 20, 0, 20, 20]]}}"#);
    let triangles: Vec<String> = (0..images.len()).map(triangle).collect();
    format!(
        r#"{{"categories": [{{"id": 1, "name": "fat"}}], "images": [{}], "annotations": [{}]}}"#,
        images.join(", "),
        triangles.join(", ")
    )
}

#[test]
fn frames_beyond_the_recording_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let (rec, file) = (recording_in(folder.path()), folder.path().join("coco.json"));
    std::fs::write(&file, coco(&[r#""frame": 1"#, r#""frame": 4"#])).unwrap();
    assert!(Sequence::open_with(&rec, Some(&file), &[]).is_ok());
    std::fs::write(rec.join("sequence.toml"), "[frames]\nlast = 3\n").unwrap();
    let message = Sequence::open_with(&rec, Some(&file), &[]).unwrap_err().to_string();
    let says = "\"fat\" on frame 4 cannot be used: the recording has frames 0 to 3";
    assert!(message.contains(says) && message.contains("coco.json"), "{message}");
}

#[test]
fn sources_tell_more_than_numbers_and_those_of_left_out_frames_do_not_count() {
    let masks =
        |images: &[&str]| shapes_of(&coco(images)).into_iter().map(|(frame, ..)| frame).collect::<Vec<_>>();
    let source = |name: &str, frame: usize| format!(r#""source": "{name}", "frame": {frame}"#);
    let (cut, shown) = (source("shot 7.png", 2), source("shot 3.png", 0));
    assert_eq!(masks(&[&cut, &shown]), [3]);
    assert_eq!(masks(&[&source("000007", 2), &source("000008", 3)]), [2, 3], "numbers alone name no picture");
    let own = format!("{}, \"file_name\": \"shot 1.png\"", r#""frame": 4, "source": null"#);
    assert_eq!(masks(&[&own]), [1], "a file that is named like a frame is that frame");
    assert_eq!(
        masks(&[&own.replace("shot 1", "a/frame_000004")]),
        [4],
        "our own files count exported frames"
    );
    assert_eq!(
        masks(&[&own.replace("shot 1", "patient99_000004"), &shown]),
        [3],
        "another picture is left out"
    );
    let task = |frame: usize, image: &str| label_studio(&[(image.to_owned(), frame)]);
    assert_eq!(shapes_of(&task(1, "/data/local-files/?d=a/shot 3.png"))[0].0, 3);
    assert_eq!(shapes_of(&task(1, "/data/upload/1.png"))[0].0, 1);
}

/// Returns a file of Label Studio with a box on each of the images.
fn label_studio(images: &[(String, usize)]) -> String {
    let value = r#""value": {"x": 0, "y": 0, "width": 9, "height": 9, "rectanglelabels": ["fat"]}"#;
    let result = format!(r#"[{{"type": "rectanglelabels", {value}}}]"#);
    let task = |(image, frame): &(String, usize)| {
        format!(
            r#"{{"data": {{"image": "{image}", "frame": {frame}}}, "annotations": [{{"result": {result}}}]}}"#
        )
    };
    format!("[{}]", images.iter().map(task).collect::<Vec<_>>().join(", "))
}

/// Returns the frames that a COCO file and one of Label Studio mark, or their errors. Both are about `frames`
/// of a recording whose names `name` tells, as they are exported, and are read for one with `frame_names`.
fn frames_marked(
    frame_names: Vec<String>,
    frames: std::ops::Range<usize>,
    name: impl Fn(usize) -> String,
) -> [Result<Vec<usize>, String>; 2] {
    let canvas = Canvas { num_frames: frame_names.len(), frame_names, ..canvas() };
    let entry =
        |i: usize| format!(r#""source": "{}", "frame": {i}, "file_name": "frame_{i:06}.png""#, name(i));
    let entries: Vec<String> = frames.clone().map(entry).collect();
    let images: Vec<(String, usize)> =
        frames.map(|i| (format!("/data/local-files/?d={}", name(i)), i)).collect();
    let texts = [coco(&entries.iter().map(String::as_str).collect::<Vec<_>>()), label_studio(&images)];
    texts.map(|text| match parse(text.as_bytes(), &canvas) {
        Ok(found) => Ok(found.unwrap_or_default().iter().map(|a| a.frame).collect()),
        Err(error) => Err(error.to_string()),
    })
}

#[test]
fn names_tell_frames_after_others_were_left_out() {
    let picture = |i: usize| format!("frame_{i:06}.png");
    let video = |i: usize| format!("{i:06}");
    let plain = |i: usize| format!("{i}.png");
    let namings: [&dyn Fn(usize) -> String; 3] = [&picture, &video, &plain];
    for name in namings {
        // The recording is used from its fifth frame on, the files are about all of it.
        let names = || (4..12).map(name).collect::<Vec<_>>();
        for found in frames_marked(names(), 0..12, name) {
            assert_eq!(found.unwrap(), (0..8).collect::<Vec<usize>>(), "{}", name(4));
        }
        for found in frames_marked(names(), 2..6, name) {
            assert_eq!(found.unwrap(), [0, 1], "{}", name(4));
        }
        for found in frames_marked(names(), 0..3, name) {
            let message = found.unwrap_err();
            assert!(message.contains(&name(0)) && message.contains("and neither is any other"), "{message}");
            assert!(message.contains(&format!("called \"{}\" to \"{}\"", name(4), name(11))), "{message}");
        }
    }
}

#[test]
fn pictures_of_another_recording_are_refused_whatever_their_numbers_are() {
    let names = || (0..5).map(|i| format!("shot {i}")).collect::<Vec<_>>();
    let other = |i: usize| format!("patient-99/other_{i:06}.png");
    for found in frames_marked(names(), 0..3, other) {
        let message = found.unwrap_err();
        assert!(message.contains("patient-99/other_000000.png\" is no frame of the recording"), "{message}");
    }
    let named = |name: &str| coco(&[&format!(r#""frame": 2, "file_name": "{name}""#)]);
    let message = parse(named("patient99_000002.png").as_bytes(), &canvas()).unwrap_err().to_string();
    assert!(message.contains("\"patient99_000002.png\" is no frame of the recording"), "{message}");
    for name in ["000002.png", "masks/frame_000002.png"] {
        assert_eq!(shapes_of(&named(name))[0].0, 2, "{name} is a number");
    }
    // Of a video, pictures may be numbered in another way.
    let video = || (0..5).map(|i| format!("{i:06}")).collect::<Vec<_>>();
    for found in frames_marked(video(), 1..4, |i| format!("{:04}.png", i + 1)) {
        assert_eq!(found.unwrap(), [1, 2, 3]);
    }
    let of_video = Canvas { frame_names: video(), ..canvas() };
    let numbered = |text: &str| parse(text.as_bytes(), &of_video).map(|found| found.unwrap()[0].frame);
    assert_eq!(numbered(&coco(&[r#""frame": 2, "file_name": "img_000003.png""#])).unwrap(), 2);
    assert_eq!(numbered(&label_studio(&[("frame_000003.png".to_owned(), 2)])).unwrap(), 2);
    assert!(numbered(&coco(&[r#""frame": 2, "source": "img_000003.png""#])).is_err());
    for found in frames_marked(names(), 0..0, other) {
        assert!(found.unwrap().is_empty());
    }
    // Where names of frames are not known, numbers count.
    let unknown = Canvas { frame_names: Vec::new(), ..canvas() };
    let text = label_studio(&[(other(2), 2)]);
    assert_eq!(parse(text.as_bytes(), &unknown).unwrap().unwrap()[0].frame, 2);
}

#[test]
fn what_annotations_of_coco_lack_is_told_with_what_to_do() {
    let file = |image: &str, annotation: &str| {
        format!(
            r#"{{"categories": [{{"id": 1, "name": "fat"}}], "images": [{{"id": 7{image}}}],
                "annotations": [{{"image_id": 7, {annotation}}}]}}"#
        )
    };
    let frame = r#", "frame": 2"#;
    let triangle = r#""segmentation": [[1, 1, 9, 1, 9, 9]]"#;
    let with = |segmentation: &str| format!(r#""category_id": 1, "segmentation": {segmentation}"#);
    for (image, annotation, says, advice) in [
        (frame, r#""category_id": 1, "bbox": [1, 1, 8, 8]"#.to_owned(), "no segmentation", "A box alone"),
        (frame, with("[]"), "no segmentation", "A box alone"),
        (frame, with("null"), "no segmentation", "A box alone"),
        (frame, with("[[1, 1, 9, 1, 9]]"), "an odd number of coordinates", "two for each corner"),
        (frame, with("[1, 1, 9, 1, 9, 9]"), "neither polygons nor run lengths", "a list of lists"),
        (frame, with(r#"{"size": [23, 37], "counts": [3, 4]}"#), "come to its size", "[height, width]"),
        (frame, triangle.to_owned(), "no category", "\"category_id\""),
        (frame, format!(r#""category_id": 2, {triangle}"#), "no category", "\"category_id\""),
        ("", format!(r#""category_id": 1, {triangle}"#), "no frame of the recording", "Frames are found by"),
    ] {
        let message = parse(file(image, &annotation).as_bytes(), &canvas()).unwrap_err().to_string();
        assert!(message.starts_with("annotations[0] cannot be used: "), "{message}");
        assert!(message.contains(says) && message.contains(advice), "{annotation}: {message}");
        assert_eq!(message.contains("Frames are found"), image.is_empty(), "{message}");
    }
    let other = file(frame, triangle).replace("\"image_id\": 7", "\"image_id\": 8");
    let message = parse(other.as_bytes(), &canvas()).unwrap_err().to_string();
    assert!(message.contains("it has no image") && message.contains("\"image_id\""), "{message}");
}

#[test]
fn annotations_of_other_recordings_are_refused() {
    let refused = |text: &str| parse(text.as_bytes(), &canvas()).unwrap_err().to_string();
    let two = coco(&[r#""file_name": "video01/shot 1.jpg""#, r#""file_name": "video02/shot 1.jpg""#]);
    assert!(refused(&two).contains("\"video02/shot 1.jpg\" would both be frame 1"), "{}", refused(&two));
    let twice = coco(&[r#""file_name": "a/shot 1.jpg""#; 2]);
    assert_eq!(shapes_of(&twice).len(), 2, "an image may be listed twice");
    let images = [1, 2].map(|frame| format!(r#"{{"id": 0, "frame": {frame}}}"#)).join(", ");
    let put_together = format!(r#"{{"categories": [], "images": [{images}], "annotations": []}}"#);
    assert!(refused(&put_together).contains("two images have the id 0"), "{}", refused(&put_together));
    let both = coco(&[r#""frame": 1"#, r#""file_name": "shot 1.png""#]);
    assert!(refused(&both).starts_with("an image without a name and \"shot 1.png\" would both be frame 1"));
    for rest in ["", r#", "source": "shot 2.png""#] {
        let own = |folder: &str| format!(r#""frame": 2, "file_name": "{folder}/frame_000002.png"{rest}"#);
        let says = "\"a/frame_000002.png\" and \"b/frame_000002.png\" would both be frame 2";
        let message = refused(&coco(&[&own("a"), &own("b")]));
        assert!(message.contains(says), "{message}");
    }
    let image = |folder: &str| format!("<image name=\"{folder}/shot 2.png\"></image>");
    assert!(refused(&cvat(&(image("a") + &image("b")))).contains("would both be frame 2"));
    let tasks = |folder: &str| format!(r#"{{"data": {{"image": "{folder}/shot 2.png"}}}}"#);
    assert!(refused(&format!("[{}, {}]", tasks("a"), tasks("b"))).contains("would both be frame 2"));

    let sized = |width: usize| coco(&[&format!(r#""frame": 1, "width": {width}.0, "height": 23"#)]);
    assert_eq!(shapes_of(&sized(37)).len(), 1);
    assert!(refused(&sized(25)).contains("pictures of 25×23 pixels"));
    let track = |width: usize| {
        let size = format!("<original_size>\n<width>{width}</width>\n<height>23</height>\n</original_size>");
        let square = r#"<box frame="2" xtl="0" ytl="0" xbr="2" ybr="2"/>"#;
        cvat(&format!("<meta><task>{size}</task></meta><track label=\"fat\">{square}</track>"))
    };
    assert_eq!(shapes_of(&track(37)).len(), 1);
    assert!(refused(&track(25)).contains("pictures of 25×23 pixels"));
}

#[test]
fn labels_of_a_recording_come_from_annotations() {
    let folder = tempfile::tempdir().unwrap();
    let rec = recording_in(folder.path());
    let file = folder.path().join("annotations.xml");
    std::fs::write(&file, exported(Format::Cvat, true, 5)).unwrap();
    let sequence = Sequence::open_with(&rec, Some(&file), &[]).unwrap();
    let names: Vec<&str> = sequence.classes().iter().map(|class| class.name.as_str()).collect();
    assert_eq!(names, ["gall \"<&\\ 胆囊", "liver"]);
    assert!(sequence.labels(0).unwrap().is_none());
    let labels = sequence.labels(1).unwrap().unwrap();
    for (k, class) in sequence.classes().iter().enumerate() {
        let wanted = &expected(true, 5)[k].2;
        assert_eq!(&labels.map(|id| *id == class.id), wanted, "{}", class.name);
    }
    std::fs::write(rec.join("sequence.toml"), "[labels]\nfile = \"../annotations.xml\"\n").unwrap();
    assert_eq!(Sequence::open(&rec).unwrap().labels(1).unwrap(), Some(labels));
    std::fs::write(&file, "nothing").unwrap();
    assert!(Sequence::open(&rec).unwrap_err().to_string().contains("no file of annotations"));
}
