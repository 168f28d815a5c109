//! Recordings in DICOM: who they are about is in nothing that is made of them.

#[path = "../../crates/core/src/dicom/elements.rs"]
mod elements;

use elements::element;
use image::RgbImage;
use std::{fs, path::Path};
use surgtpgs_tests::{Flow, flow, run_in};

/// Values of identifying attributes. None may be found in anything that the program writes or says.
const SECRETS: [&str; 7] =
    ["Mustermann", "Erika", "K4711-0815", "19610203", "Musterklinik", "Chefarzt", "Geheimfach"];
/// Identifiers, which may be in a segmentation alone.
const IDENTIFIERS: [&str; 4] = ["1.2.276.99.1", "1.2.276.99.2", "1.2.276.99.3", "1.2.276.99.4"];

/// Returns a data element whose value is filled up to an even length.
fn filled(tag: (u16, u16), vr: &str, value: &[u8]) -> Vec<u8> {
    let mut value = value.to_vec();
    value.resize(value.len().next_multiple_of(2), if vr == "UI" { 0 } else { b' ' });
    element(tag, vr, &value)
}

/// Writes the demo's frames as one DICOM file with every identifying attribute set.
fn write_recording(path: &Path) {
    let mut frames: Vec<_> =
        fs::read_dir(flow().path().join("recording/images")).unwrap().map(|e| e.unwrap().path()).collect();
    frames.sort();
    let frames: Vec<RgbImage> = frames.iter().map(|path| image::open(path).unwrap().into_rgb8()).collect();
    let (width, height) = Flow::SIZE;
    let text = |tag, vr, value: &str| filled(tag, vr, value.as_bytes());
    let short = |tag, value: u16| filled(tag, "US", &value.to_le_bytes());
    let nested =
        [vec![0xfe, 0xff, 0x00, 0xe0, 22, 0, 0, 0], text((0x0010, 0x0010), "PN", "Mustermann^E^")].concat();
    let parts = [
        text((0x0002, 0x0010), "UI", "1.2.840.10008.1.2.1"),
        text((0x0008, 0x0012), "DA", "19610203"),
        text((0x0008, 0x0016), "UI", "1.2.840.10008.5.1.4.1.1.77.1.1.1"),
        text((0x0008, 0x0018), "UI", IDENTIFIERS[0]),
        text((0x0008, 0x0020), "DA", "19610203"),
        text((0x0008, 0x002a), "DT", "19610203101112.5"),
        text((0x0008, 0x0050), "SH", "K4711-0815"),
        text((0x0008, 0x0080), "LO", "Musterklinik"),
        text((0x0008, 0x0090), "PN", "Chefarzt^Hans"),
        text((0x0008, 0x1010), "SH", "Musterklinik OP"),
        text((0x0008, 0x1030), "LO", "Mustermann gallbladder"),
        text((0x0008, 0x103e), "LO", "Mustermann 1"),
        text((0x0008, 0x1050), "PN", "Chefarzt^Hans"),
        filled((0x0008, 0x1110), "SQ", &nested),
        text((0x0009, 0x0010), "LO", "Geheimfach"),
        text((0x0009, 0x1001), "LO", "Geheimfach 19610203"),
        text((0x0010, 0x0010), "PN", "Mustermann^Erika"),
        text((0x0010, 0x0020), "LO", "K4711-0815"),
        text((0x0010, 0x0030), "DA", "19610203"),
        text((0x0010, 0x1040), "LO", "Musterklinik 5"),
        text((0x0010, 0x4000), "LT", "Erika Mustermann"),
        text((0x0018, 0x1000), "LO", "Musterklinik 77"),
        text((0x0018, 0x1063), "DS", "40"),
        text((0x0020, 0x000d), "UI", IDENTIFIERS[1]),
        text((0x0020, 0x000e), "UI", IDENTIFIERS[2]),
        text((0x0020, 0x0013), "IS", "1"),
        text((0x0020, 0x0052), "UI", IDENTIFIERS[3]),
        text((0x0020, 0x4000), "LT", "Erika Mustermann, 19610203"),
        short((0x0028, 0x0002), 3),
        text((0x0028, 0x0004), "CS", "RGB"),
        short((0x0028, 0x0006), 0),
        text((0x0028, 0x0008), "IS", &frames.len().to_string()),
        short((0x0028, 0x0010), height as u16),
        short((0x0028, 0x0011), width as u16),
        short((0x0028, 0x0100), 8),
        text((0x0040, 0xa123), "PN", "Chefarzt^Hans"),
        filled((0x7fe0, 0x0010), "OB", &frames.iter().flat_map(|f| f.as_raw().clone()).collect::<Vec<_>>()),
    ];
    let file = [vec![0; 128], b"DICM".to_vec(), parts.concat()].concat();
    fs::write(path, file).unwrap();
}

/// Returns all files below `folder`.
fn files(folder: &Path) -> Vec<std::path::PathBuf> {
    let entries = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    entries.flat_map(|path| if path.is_dir() { files(&path) } else { vec![path] }).collect()
}

fn holds(bytes: &[u8], text: &str) -> bool {
    bytes.windows(text.len()).any(|window| window == text.as_bytes())
}

#[test]
fn who_a_recording_is_about_is_in_nothing_that_is_made_of_it() {
    let folder = tempfile::tempdir().unwrap();
    let inputs = tempfile::tempdir().unwrap();
    let recording = inputs.path().join("clip.dcm");
    write_recording(&recording);
    let sequence = recording.to_str().unwrap();
    let marks = folder.path().join("marks.json");
    let click = r#"{"frame": 2, "name": "liver", "kind": "stroke", "points_px": [[20, 20], [40, 30]]}"#;
    fs::write(&marks, format!(r#"{{"marks": [{click}]}}"#)).unwrap();
    let mut said = String::new();
    let mut run = |args: &[&str]| {
        let run = run_in(folder.path(), args).ok();
        said += &(run.stdout + &run.stderr);
    };
    run(&["check", sequence, "--json"]);
    run(&["check", sequence]);
    run(&["prepare", sequence, "-o", "prep", "--marks", "marks.json", "--hide", "0,0,9,5"]);
    run(&["train", sequence, "-o", "scene.safetensors", "--iterations", "30", "--hide", "0,0,9,5"]);
    run(&["query", "scene.safetensors", "--marks", "marks.json", "--prompt", "liver", "--json"]);
    run(&["render", "scene.safetensors", "-o", "rendered", "--frames", "0..2"]);
    let formats =
        "cutout,overlay,binary,index,outline,score,npy,video,gif,sheet,csv,json,coco,nrrd,dicom-seg";
    let export = ["export", "scene.safetensors", "--marks", "marks.json", "--prompt", "liver", "--raw"];
    for kind in ["binary", "fractional", "labelmap"] {
        run(&[&export[..], &["-o", kind, "--format", formats, "--seg-type", kind]].concat());
    }
    for secret in SECRETS.iter().chain(&IDENTIFIERS) {
        assert!(!holds(said.as_bytes(), secret), "{secret} was said:\n{said}");
    }
    let written = files(folder.path());
    assert!(written.len() > 100, "{}", written.len());
    let mut segmentations = 0;
    for path in written {
        let bytes = fs::read(&path).unwrap();
        let is_segmentation = path.extension().is_some_and(|e| e == "dcm");
        segmentations += usize::from(is_segmentation);
        let identifiers = if is_segmentation { &[][..] } else { &IDENTIFIERS[..] };
        for secret in SECRETS.iter().chain(identifiers) {
            assert!(!holds(&bytes, secret), "{secret} in {}", path.display());
        }
        if is_segmentation {
            assert!(holds(&bytes, IDENTIFIERS[0]) && holds(&bytes, IDENTIFIERS[1]), "{}", path.display());
            assert!(!holds(&bytes, IDENTIFIERS[3]), "{}", path.display());
        }
    }
    assert_eq!(segmentations, 3);
    let overlay = image::open(folder.path().join("binary/overlay/frame_000002.png")).unwrap().into_rgb8();
    let cut = image::open(folder.path().join("binary/binary/frame_000002_liver.png")).unwrap().into_luma8();
    assert!((0..5).all(|y| (0..9).all(|x| cut.get_pixel(x, y)[0] == 0)));
    assert_eq!(overlay.dimensions(), Flow::SIZE);
    let picture =
        image::open(folder.path().join("binary/cutout/frame_000002_liver.png")).unwrap().into_rgba8();
    assert_eq!(picture.get_pixel(4, 2).0, [0; 4]);
    let record = fs::read_to_string(folder.path().join("binary/provenance.json")).unwrap();
    let record: serde_json::Value = serde_json::from_str(&record).unwrap();
    assert_eq!(record["hidden"], serde_json::json!([{ "x": 0, "y": 0, "width": 9, "height": 5 }]));
}
