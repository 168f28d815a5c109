//! Files of DICOM: recordings, and segmentations as marks.

#[path = "../../../crates/core/src/dicom/elements.rs"]
mod elements;

use crate::{Target, expect_words, recordings};
use elements::element;
use surgtpgs_core::marks::{Canvas, Marks};

pub(crate) const TARGETS: [Target; 2] = [
    Target { name: "dicom", run: recording, seeds: recordings },
    Target { name: "segmentation", run: segmentation, seeds: segmentations },
];

const EXPLICIT: &str = "1.2.840.10008.1.2.1";
const IMAGE: &str = "1.2.840.10008.5.1.4.1.1.77.1.1.1";
const SEGMENTATION: &str = "1.2.840.10008.5.1.4.1.1.66.4";

fn recording(bytes: &[u8]) {
    let folder = recordings::scratch();
    recordings::write(folder.path(), "clip.dcm", bytes);
    recordings::look_at(&folder.path().join("clip.dcm"));
}

fn segmentation(bytes: &[u8]) {
    let folder = recordings::scratch();
    recordings::write(folder.path(), "marks.dcm", bytes);
    let canvas = Canvas { width: 8, height: 6, frame_names: Vec::new(), num_frames: 4 };
    if let Some(marks) = expect_words(Marks::read(&folder.path().join("marks.dcm"), &canvas)) {
        assert!(marks.all().iter().all(|mark| mark.fits(&canvas)), "a mark that does not fit");
    }
}

fn text(tag: (u16, u16), vr: &str, value: &str) -> Vec<u8> {
    let mut bytes = value.as_bytes().to_vec();
    bytes.resize(bytes.len().next_multiple_of(2), if vr == "UI" { 0 } else { b' ' });
    element(tag, vr, &bytes)
}

fn short(tag: (u16, u16), value: u16) -> Vec<u8> {
    element(tag, "US", &value.to_le_bytes())
}

fn item(parts: &[Vec<u8>]) -> Vec<u8> {
    let content = parts.concat();
    [&[0xfe, 0xff, 0x00, 0xe0][..], &(content.len() as u32).to_le_bytes(), &content].concat()
}

fn file(syntax: &str, elements: &[Vec<u8>]) -> Vec<u8> {
    let mut bytes = vec![0; 128];
    bytes.extend(b"DICM");
    bytes.extend(text((0x0002, 0x0010), "UI", syntax));
    bytes.extend(elements.concat());
    bytes
}

fn head(class: &str, frames: usize, (width, height): (u16, u16), bits: u16, photometric: &str) -> Vec<u8> {
    [
        text((0x0008, 0x0016), "UI", class),
        text((0x0010, 0x0010), "PN", "Mustermann"),
        text((0x0018, 0x1063), "DS", "40"),
        text((0x0020, 0x0013), "IS", "1"),
        short((0x0028, 0x0002), if photometric == "RGB" { 3 } else { 1 }),
        text((0x0028, 0x0004), "CS", photometric),
        text((0x0028, 0x0008), "IS", &frames.to_string()),
        short((0x0028, 0x0010), height),
        short((0x0028, 0x0011), width),
        short((0x0028, 0x0100), bits),
    ]
    .concat()
}

fn encapsulated(fragments: &[&[u8]]) -> Vec<u8> {
    let mut bytes = vec![0xe0, 0x7f, 0x10, 0x00, b'O', b'B', 0, 0, 0xff, 0xff, 0xff, 0xff];
    bytes.extend(item(&[]));
    fragments.iter().for_each(|fragment| bytes.extend(item(&[fragment.to_vec()])));
    bytes.extend([0xfe, 0xff, 0xdd, 0xe0, 0, 0, 0, 0]);
    bytes
}

fn recordings() -> Vec<Vec<u8>> {
    let pixels: Vec<u8> = (0..8 * 6 * 3 * 2).map(|i| (i * 7) as u8).collect();
    let plain = |photometric: &str, len: usize| {
        let head = head(IMAGE, 2, (8, 6), 8, photometric);
        file(EXPLICIT, &[head, element((0x7fe0, 0x0010), "OB", &pixels[..len])])
    };
    let video = include_bytes!("../seeds/small.mp4");
    let table: Vec<u8> = [vec![2], vec![3, 1, 2, 3, 4, 0xd5, 9], vec![0x80]].concat();
    let mut packed = vec![0_u8; 64];
    (packed[0], packed[4]) = (1, 64);
    packed.extend(table);
    let video_head = head(IMAGE, 3, (32, 24), 8, "RGB");
    vec![
        plain("RGB", pixels.len()),
        plain("MONOCHROME2", 96),
        file("1.2.840.10008.1.2.4.102", &[video_head, encapsulated(&[&video[..1000], &video[1000..]])]),
        file("1.2.840.10008.1.2.5", &[head(IMAGE, 1, (8, 6), 8, "MONOCHROME2"), encapsulated(&[&packed])]),
        plain("RGB", pixels.len())[132 + 28..].to_vec(),
    ]
}

fn segmentations() -> Vec<Vec<u8>> {
    let groups = |frame: u32, segment: u16| {
        let place = element((0x0020, 0x9128), "UL", &frame.to_le_bytes());
        let content = element((0x0020, 0x9111), "SQ", &item(&[place]));
        let number = short((0x0062, 0x000b), segment);
        item(&[content, element((0x0062, 0x000a), "SQ", &item(&[number]))])
    };
    let segment = |number: u16| {
        item(&[short((0x0062, 0x0004), number), text((0x0062, 0x0005), "LO", &format!("liver {number}"))])
    };
    let whole = |kind: &str, bits: u16, pixels: &[u8]| {
        let segments: Vec<u8> = (1..=2).flat_map(segment).collect();
        let frames: Vec<u8> = [(1, 1), (3, 2)].into_iter().flat_map(|(f, s)| groups(f, s)).collect();
        file(
            EXPLICIT,
            &[
                head(SEGMENTATION, 2, (8, 6), bits, "MONOCHROME2"),
                text((0x0062, 0x0001), "CS", kind),
                element((0x0062, 0x0002), "SQ", &segments),
                element((0x5200, 0x9230), "SQ", &frames),
                element((0x7fe0, 0x0010), "OB", pixels),
            ],
        )
    };
    let labels: Vec<u8> = (0..96).map(|i| i % 3).collect();
    vec![
        whole("BINARY", 1, &[0x5a; 12]),
        whole("FRACTIONAL", 8, &labels.iter().map(|v| v * 100).collect::<Vec<u8>>()),
        whole("LABELMAP", 8, &labels),
    ]
}
