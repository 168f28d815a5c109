//! Tests with files of DICOM, which are made here element by element.

use super::{videos::write_video, *};
use crate::{
    dicom::elements::element,
    export::tests::segmentation_from,
    marks::Marks,
    sequence::{HiddenRectangle, layouts::Layout},
};
use openh264::{
    OpenH264API,
    encoder::{BitRate, Encoder, EncoderConfig, IntraFramePeriod},
    formats::{RgbSliceU8, YUVBuffer},
};
use std::fs;

const EXPLICIT: &str = "1.2.840.10008.1.2.1";
const H264_HIGH: &str = "1.2.840.10008.1.2.4.102";
const VIDEO_ENDOSCOPIC: &str = "1.2.840.10008.5.1.4.1.1.77.1.1.1";
/// A value that must not be found anywhere.
const SECRET: &str = "Mustermann";

/// Writes an element: tag, type, value.
type Write = fn((u16, u16), &str, &[u8]) -> Vec<u8>;

/// A file that is being made.
#[derive(Clone)]
pub(super) struct File {
    syntax: &'static str,
    /// Elements with their tags, types and values; written in the order of tags.
    elements: Vec<((u16, u16), &'static str, Vec<u8>)>,
    /// Pixel data, head included.
    pixels: Vec<u8>,
}

fn text(value: &str) -> Vec<u8> {
    let mut bytes = value.as_bytes().to_vec();
    if bytes.len() % 2 == 1 {
        bytes.push(b' ');
    }
    bytes
}

fn short(value: u16) -> Vec<u8> {
    value.to_le_bytes().to_vec()
}

fn item(bytes: &[u8]) -> Vec<u8> {
    let mut whole = vec![0xfe, 0xff, 0x00, 0xe0];
    whole.extend((bytes.len() as u32).to_le_bytes());
    whole.extend(bytes);
    whole
}

impl File {
    fn new(syntax: &'static str, (width, height): (u16, u16), frames: usize) -> Self {
        let mut file = Self { syntax, elements: Vec::new(), pixels: Vec::new() };
        file.set((0x0008, 0x0016), "UI", text(VIDEO_ENDOSCOPIC));
        file.set((0x0008, 0x0018), "UI", b"1.2.3.4.5.6\0".to_vec());
        file.set((0x0020, 0x000d), "UI", b"1.2.3.4\0".to_vec());
        file.set((0x0020, 0x000e), "UI", text("1.2.3.4.5\0"));
        file.set((0x0020, 0x0013), "IS", text("1"));
        file.set((0x0028, 0x0002), "US", short(3));
        file.set((0x0028, 0x0004), "CS", text("RGB"));
        file.set((0x0028, 0x0006), "US", short(0));
        file.set((0x0028, 0x0008), "IS", text(&frames.to_string()));
        file.set((0x0028, 0x0010), "US", short(height));
        file.set((0x0028, 0x0011), "US", short(width));
        file.set((0x0028, 0x0100), "US", short(8));
        file.set((0x0028, 0x0101), "US", short(8));
        file.set((0x0028, 0x0102), "US", short(7));
        file.set((0x0028, 0x0103), "US", short(0));
        file
    }

    fn set(&mut self, tag: (u16, u16), vr: &'static str, value: Vec<u8>) -> &mut Self {
        self.elements.retain(|(known, ..)| *known != tag);
        self.elements.push((tag, vr, value));
        self
    }

    fn stored(&mut self, bytes: &[u8]) -> &mut Self {
        self.pixels = element((0x7fe0, 0x0010), "OB", bytes);
        self
    }

    fn fragments(&mut self, offsets: &[u32], fragments: &[&[u8]]) -> &mut Self {
        let mut bytes = vec![0xe0, 0x7f, 0x10, 0x00, b'O', b'B', 0, 0, 0xff, 0xff, 0xff, 0xff];
        bytes.extend(item(&offsets.iter().flat_map(|o| o.to_le_bytes()).collect::<Vec<u8>>()));
        for fragment in fragments {
            let mut even = fragment.to_vec();
            even.resize(even.len().next_multiple_of(2), 0);
            bytes.extend(item(&even));
        }
        bytes.extend([0xfe, 0xff, 0xdd, 0xe0, 0, 0, 0, 0]);
        self.pixels = bytes;
        self
    }

    /// Sets everything that says who it is about.
    fn identifying(&mut self) -> &mut Self {
        for (tag, vr) in [
            ((0x0008, 0x0080), "LO"),
            ((0x0008, 0x0090), "PN"),
            ((0x0008, 0x1030), "LO"),
            ((0x0008, 0x1050), "PN"),
            ((0x0009, 0x0010), "LO"),
            ((0x0009, 0x1001), "LO"),
            ((0x0010, 0x0010), "PN"),
            ((0x0010, 0x0020), "LO"),
            ((0x0010, 0x4000), "LT"),
            ((0x0020, 0x4000), "LT"),
        ] {
            self.set(tag, vr, text(SECRET));
        }
        self.set((0x0010, 0x0030), "DA", text("19610203"))
    }

    pub(super) fn bytes(&self) -> Vec<u8> {
        let mut bytes = vec![0; 128];
        bytes.extend(b"DICM");
        let syntax =
            if self.syntax.len() % 2 == 1 { format!("{}\0", self.syntax) } else { self.syntax.to_owned() };
        bytes.extend(element((0x0002, 0x0010), "UI", syntax.as_bytes()));
        bytes.extend(self.data_set(element));
        bytes
    }

    fn data_set(&self, write: Write) -> Vec<u8> {
        let mut elements = self.elements.clone();
        elements.sort_by_key(|(tag, ..)| *tag);
        let mut bytes: Vec<u8> =
            elements.iter().flat_map(|(tag, vr, value)| write(*tag, vr, value)).collect();
        bytes.extend(&self.pixels);
        bytes
    }

    pub(super) fn open(&self, path: &Path) -> Result<Sequence> {
        fs::write(path, self.bytes()).unwrap();
        Sequence::open(path)
    }
}

fn implicit((group, number): (u16, u16), _: &str, value: &[u8]) -> Vec<u8> {
    let mut bytes = [group.to_le_bytes(), number.to_le_bytes()].concat();
    bytes.extend((value.len() as u32).to_le_bytes());
    bytes.extend(value);
    bytes
}

fn frames(n: usize) -> Vec<RgbImage> {
    (0..n as u8).map(|i| picture(8, 6, i)).collect()
}

fn colours(frames: &[RgbImage]) -> Vec<u8> {
    frames.iter().flat_map(|frame| frame.as_raw().clone()).collect()
}

/// Three frames of 8 × 6 as they are.
pub(super) fn plain() -> File {
    let mut file = File::new(EXPLICIT, (8, 6), 3);
    file.identifying().stored(&colours(&frames(3)));
    file
}

/// The video of the tests.
fn video(folder: &Path) -> File {
    let path = folder.join("clip.mp4");
    write_video(&path);
    of_mp4(&fs::read(path).unwrap(), 25)
}

/// A video of 64 × 48 in two fragments that are cut anywhere. The file says that it has so many frames.
pub(super) fn of_mp4(mp4: &[u8], frames: usize) -> File {
    let mut file = File::new(H264_HIGH, (64, 48), frames);
    file.identifying().set((0x0018, 0x1063), "DS", text("40.0"));
    file.set((0x0028, 0x0004), "CS", text("YBR_PARTIAL_420"));
    let (first, second) = mp4.split_at((mp4.len() / 3) & !1);
    file.fragments(&[], &[first, second]);
    file
}

#[test]
fn a_video_has_the_frames_of_its_mp4_and_the_speed_of_its_attributes() {
    let folder = tempfile::tempdir().unwrap();
    let sequence = video(folder.path()).open(&folder.path().join("Mustermann.dcm")).unwrap();
    let mp4 = Sequence::open(&folder.path().join("clip.mp4")).unwrap();
    assert_eq!((sequence.layout(), sequence.num_frames()), (Layout::Dicom, 25));
    assert_eq!(sequence.frames_per_second(), Some(25.0));
    for i in [0, 24, 3, 11, 10] {
        assert_eq!(sequence.frame(i).unwrap(), mp4.frame(i).unwrap(), "frame {i}");
    }
    assert!(sequence.name().starts_with("dicom-"), "{}", sequence.name());
    let sources = sequence.source_references().unwrap().unwrap();
    assert_eq!((sources.series_uid.as_str(), sources.instances.len()), ("1.2.3.4.5", 1));
    assert_eq!(sources.frames[24].number, Some(25));
}

#[test]
fn a_bare_stream_has_the_frames_that_were_coded() {
    let folder = tempfile::tempdir().unwrap();
    let config = EncoderConfig::new()
        .bitrate(BitRate::from_bps(4_000_000))
        .intra_frame_period(IntraFramePeriod::from_num_frames(4));
    let mut encoder = Encoder::with_api_config(OpenH264API::from_source(), config).unwrap();
    let mut stream = Vec::new();
    let shown: Vec<RgbImage> = (0..10).map(super::videos::blob).collect();
    for frame in &shown {
        let yuv = YUVBuffer::from_rgb8_source(RgbSliceU8::new(frame.as_raw(), (64, 48)));
        stream.extend(encoder.encode(&yuv).unwrap().to_vec());
    }
    let mut file = File::new(H264_HIGH, (64, 48), 10);
    file.fragments(&[], &[&stream]);
    let sequence = file.open(&folder.path().join("stream")).unwrap();
    assert_eq!((sequence.num_frames(), sequence.frames_per_second()), (10, None));
    for i in [9, 0, 5, 4] {
        let found = sequence.frame(i).unwrap();
        assert!(super::videos::psnr(&found, &shown[i]) > 25.0, "frame {i}");
    }
    file.set((0x0028, 0x0008), "IS", text("12"));
    let said = message(file.open(&folder.path().join("stream")));
    assert!(said.contains("it lists 12 frames and holds 10"), "{said}");
}

#[test]
fn plain_pictures_of_every_kind_show_their_colours() {
    let folder = tempfile::tempdir().unwrap();
    let shown = frames(3);
    let check = |file: &File, expected: &[RgbImage], tolerance: u8, what: &str| {
        let sequence = file.open(&folder.path().join("file")).unwrap_or_else(|e| panic!("{what}: {e}"));
        for (i, expected) in expected.iter().enumerate() {
            let found = sequence.frame(i).unwrap();
            let is_near = |(a, b): (&u8, &u8)| a.abs_diff(*b) <= tolerance;
            assert!(found.as_raw().iter().zip(expected.as_raw()).all(is_near), "{what}, frame {i}");
        }
    };
    check(&plain(), &shown, 0, "RGB");
    let planar: Vec<u8> = shown
        .iter()
        .flat_map(|f| (0..3).flat_map(|c| f.as_raw().iter().skip(c).step_by(3).copied()))
        .collect();
    check(plain().set((0x0028, 0x0006), "US", short(1)).stored(&planar), &shown, 0, "planes");
    let ybr = |f: &RgbImage| -> Vec<[u8; 3]> {
        let convert = |p: &Rgb<u8>| {
            let [r, g, b] = p.0.map(f32::from);
            let y = 0.299 * r + 0.587 * g + 0.114 * b;
            [y, 128.0 + (b - y) / 1.772, 128.0 + (r - y) / 1.402].map(|v| v.round().clamp(0.0, 255.0) as u8)
        };
        f.pixels().map(convert).collect()
    };
    let full: Vec<u8> = shown.iter().flat_map(|f| ybr(f).concat()).collect();
    check(plain().set((0x0028, 0x0004), "CS", text("YBR_FULL")).stored(&full), &shown, 2, "YBR");
    let halves: Vec<u8> = shown
        .iter()
        .flat_map(|f| ybr(f).chunks(2).flat_map(|p| [p[0][0], p[1][0], p[0][1], p[0][2]]).collect::<Vec<_>>())
        .collect();
    check(
        plain().set((0x0028, 0x0004), "CS", text("YBR_FULL_422")).stored(&halves),
        &shown,
        6,
        "half colours",
    );
    let grey: Vec<RgbImage> =
        (0..2).map(|i| RgbImage::from_fn(8, 6, |x, y| Rgb([(40 * i + 10 * x + y) as u8; 3]))).collect();
    let deep: Vec<u8> = grey
        .iter()
        .flat_map(|f| f.pixels().flat_map(|p| (u16::from(p[0]) << 4).to_le_bytes()).collect::<Vec<_>>())
        .collect();
    let mut file = File::new(EXPLICIT, (8, 6), 2);
    file.set((0x0028, 0x0002), "US", short(1)).set((0x0028, 0x0004), "CS", text("MONOCHROME2"));
    file.set((0x0028, 0x0100), "US", short(16)).set((0x0028, 0x0101), "US", short(12));
    file.set((0x0028, 0x0102), "US", short(11)).stored(&deep);
    check(&file, &grey, 0, "12 bits");
    let places: Vec<u8> = (0..96).map(|i| i % 4).collect();
    let table = [10, 200, 30, 77];
    let mut file = File::new(EXPLICIT, (8, 6), 2);
    file.set((0x0028, 0x0002), "US", short(1)).set((0x0028, 0x0004), "CS", text("PALETTE COLOR"));
    for channel in 0..3 {
        file.set((0x0028, 0x1101 + channel), "US", [short(4), short(0), short(8)].concat());
        file.set((0x0028, 0x1201 + channel), "OW", table.iter().flat_map(|v| short(*v)).collect());
    }
    file.stored(&places);
    let coloured = RgbImage::from_fn(8, 6, |x, _| Rgb([table[x as usize % 4] as u8; 3]));
    check(&file, &[coloured.clone(), coloured], 0, "palette");
}

#[test]
fn jpeg_and_run_lengths_are_found_by_every_table() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("file");
    let shown = frames(3);
    let coded: Vec<Vec<u8>> = shown
        .iter()
        .map(|frame| {
            let mut bytes = std::io::Cursor::new(Vec::new());
            frame
                .write_with_encoder(image::codecs::jpeg::JpegEncoder::new_with_quality(&mut bytes, 98))
                .unwrap();
            let mut bytes = bytes.into_inner();
            bytes.resize(bytes.len().next_multiple_of(2), 0);
            bytes
        })
        .collect();
    let mut file = File::new("1.2.840.10008.1.2.4.50", (8, 6), 3);
    file.set((0x0028, 0x0004), "CS", text("YBR_FULL_422"));
    let all: Vec<&[u8]> = coded.iter().map(Vec::as_slice).collect();
    file.fragments(&[], &all);
    let whole = file.open(&path).unwrap();
    let (a, b) = coded[1].split_at((coded[1].len() / 2) & !1);
    let lens = [coded[0].len() + 8, coded[1].len() + 16];
    let offsets = [0, lens[0] as u32, (lens[0] + lens[1]) as u32];
    file.fragments(&offsets, &[&coded[0], a, b, &coded[2]]);
    let parted = file.open(&path).unwrap();
    let frames: Vec<RgbImage> = (0..3).map(|i| parted.frame(i).unwrap()).collect();
    file.fragments(&[], &all).open(&path).unwrap();
    for (i, frame) in frames.iter().enumerate() {
        assert!(
            super::videos::psnr(frame, &shown[i]) > 30.0 && *frame == whole.frame(i).unwrap(),
            "frame {i}"
        );
    }
    let packed = |frame: &RgbImage| {
        let mut head = [0_u32; 16];
        let mut body = Vec::new();
        head[0] = 3;
        for channel in 0..3 {
            head[1 + channel] = (64 + body.len()) as u32;
            body.push(47);
            body.extend(frame.as_raw().iter().skip(channel).step_by(3));
            body.push(0x80);
        }
        [head.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>(), body].concat()
    };
    let coded: Vec<Vec<u8>> = shown.iter().map(packed).collect();
    let mut file = File::new("1.2.840.10008.1.2.5", (8, 6), 3);
    file.fragments(&[], &coded.iter().map(Vec::as_slice).collect::<Vec<_>>());
    let sequence = file.open(&path).unwrap();
    (0..3).for_each(|i| assert_eq!(sequence.frame(i).unwrap(), shown[i], "run lengths, frame {i}"));
}

#[test]
fn a_series_comes_in_the_order_of_its_numbers_and_from_a_directory() {
    let folder = tempfile::tempdir().unwrap();
    let files = folder.path().join("disc");
    fs::create_dir(&files).unwrap();
    let shown = frames(3);
    for (i, (name, number)) in [("IM3", 1), ("IM1", 2), ("IM2", 10)].into_iter().enumerate() {
        let mut file = File::new(EXPLICIT, (8, 6), 1);
        file.set((0x0020, 0x0013), "IS", text(&number.to_string())).stored(shown[i].as_raw());
        fs::write(files.join(name), file.bytes()).unwrap();
    }
    let sequence = Sequence::open(&files).unwrap();
    assert_eq!((sequence.layout(), sequence.num_frames()), (Layout::Dicom, 3));
    (0..3).for_each(|i| assert_eq!(sequence.frame(i).unwrap(), shown[i], "frame {i}"));
    assert_eq!(sequence.frame_name(1), "000001");
    let record = |name: &str| {
        let parts = [
            element((0x0004, 0x1430), "CS", &text("IMAGE")),
            element((0x0004, 0x1500), "CS", &text(&format!("DISC\\{name}"))),
        ];
        item(&parts.concat())
    };
    fs::rename(&files, folder.path().join("DISC")).unwrap();
    let directory = |names: &[&str]| {
        let mut file = File { syntax: EXPLICIT, elements: Vec::new(), pixels: Vec::new() };
        let records: Vec<u8> = names.iter().flat_map(|name| record(name)).collect();
        file.set((0x0004, 0x1220), "SQ", records);
        fs::write(folder.path().join("DICOMDIR"), file.bytes()).unwrap();
    };
    directory(&["IM1", "IM2", "IM3"]);
    for path in [folder.path().to_owned(), folder.path().join("DICOMDIR")] {
        let sequence = Sequence::open(&path).unwrap();
        assert_eq!((sequence.num_frames(), sequence.frame(0).unwrap()), (3, shown[0].clone()));
    }
    directory(&["IM1", "..\\IM2"]);
    assert!(message(Sequence::open(folder.path())).contains("not allowed"));
    directory(&["IM9"]);
    assert!(message(Sequence::open(folder.path())).contains("not there"));
}

/// Writes a series of files with equally many frames of 8 × 6.
fn write_series(folder: &Path, num_files: usize, num_frames: usize) {
    fs::create_dir(folder).unwrap();
    for i in 1..=num_files {
        let mut file = File::new(EXPLICIT, (8, 6), num_frames);
        file.set((0x0008, 0x0018), "UI", text(&format!("1.2.3.{i}")));
        file.set((0x0020, 0x0013), "IS", text(&i.to_string())).stored(&colours(&frames(num_frames)));
        fs::write(folder.join(format!("IM{i}")), file.bytes()).unwrap();
    }
}

#[test]
fn marks_are_on_the_frames_of_the_files_that_a_segmentation_refers_to() {
    for (num_files, num_frames) in [(2, 3), (6, 1), (1, 6)] {
        let folder = tempfile::tempdir().unwrap();
        let files = folder.path().join("series");
        write_series(&files, num_files, num_frames);
        let whole = Sequence::open(&files).unwrap();
        fs::write(files.join("sequence.toml"), "[frames]\nfirst = 2\n").unwrap();
        let rest = Sequence::open(&files).unwrap();
        // Each frame has a pixel of its own.
        let pixel = |i: usize| Mask::from_vec(8, 6, (0..48).map(|at| at == i).collect());
        let masks: Vec<Mask> = (0..6).map(pixel).collect();
        let sources = whole.source_references().unwrap().unwrap();
        // The only frame of a file may have a number.
        let mut numbered = sources.clone();
        numbered.frames.iter_mut().for_each(|frame| _ = frame.number.get_or_insert(1));
        for (name, sources) in [("plain", sources), ("numbered", numbered)] {
            let file = segmentation_from(&folder.path().join(name), &masks, 0, Some(sources));
            let marked = |sequence: &Sequence, is_at_hand: bool| {
                let recording = || is_at_hand.then(|| sequence.clone());
                let marks = Marks::read_for(&file, &sequence.canvas(), recording)?;
                let pixel = |mask: &Mask| mask.data.iter().position(|is_in| *is_in).unwrap();
                let marks = marks.all().iter().map(|mark| (mark.frame, pixel(&mark.shape.pixels(8, 6))));
                Ok::<_, Error>(marks.collect::<Vec<_>>())
            };
            let what = format!("{num_files} files, {name}");
            assert_eq!(marked(&whole, true).unwrap(), [0, 1, 2, 3, 4, 5].map(|i| (i, i)), "{what}");
            assert_eq!(marked(&rest, true).unwrap(), [0, 1, 2, 3].map(|i| (i, i + 2)), "{what}");
            match marked(&rest, false) {
                Ok(found) => assert!(num_files == 1 && found == [0, 1, 2, 3].map(|i| (i, i + 2)), "{what}"),
                Err(e) => assert!(num_files > 1 && e.to_string().contains("not at hand"), "{e}"),
            }
        }
    }
}

#[test]
fn a_series_of_single_pictures_in_a_coding_of_videos_is_refused_as_such() {
    let folder = tempfile::tempdir().unwrap();
    let write = |syntax: &'static str| {
        for i in 1..=2 {
            let mut file = File::new(syntax, (8, 6), 1);
            file.set((0x0020, 0x0013), "IS", text(&i.to_string())).fragments(&[], &[b"no picture"]);
            fs::write(folder.path().join(format!("IM{i}")), file.bytes()).unwrap();
        }
        message(Sequence::open(folder.path()))
    };
    for syntax in ["1.2.840.10008.1.2.4.70", "1.2.840.10008.1.2.4.80", "1.2.840.10008.1.2.4.90"] {
        let said = write(syntax);
        assert!(said.contains("single pictures") && said.contains("gdcmconv"), "{said}");
    }
    assert!(write(H264_HIGH).contains("several videos"));
}

#[test]
fn nothing_that_says_who_it_is_about_is_kept_or_said() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("Mustermann 19610203.dcm");
    let sequence = plain().open(&path).unwrap();
    let report = check(&sequence, &mut crate::progress::unobserved).unwrap();
    let said = format!("{report:?} {:?} {}", sequence.identity().unwrap(), sequence.name());
    assert!(
        said.contains("4 about the patient, 2 names of people") && said.contains("2 private attributes"),
        "{said}"
    );
    for secret in [SECRET, "19610203", "1.2.3.4"] {
        assert!(!said.contains(secret), "{secret} in {said}");
    }
}

#[test]
fn plain_data_sets_are_recognised_too() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("file");
    let mut file = plain();
    file.set((0x0008, 0x0005), "CS", text("ISO_IR 100"));
    for (write, what) in [(element as Write, "explicit"), (implicit, "implicit")] {
        let mut bare = file.clone();
        bare.pixels = write((0x7fe0, 0x0010), "OB", &colours(&frames(3)));
        fs::write(&path, bare.data_set(write)).unwrap();
        let sequence = Sequence::open(&path).unwrap_or_else(|e| panic!("{what}: {e}"));
        assert_eq!((sequence.num_frames(), sequence.frame(2).unwrap()), (3, picture(8, 6, 2)), "{what}");
    }
}

/// Changes of good files, each of which makes it unusable.
fn broken(folder: &Path) -> Vec<(String, Vec<u8>)> {
    let mut all = Vec::new();
    for (what, good) in [("plain", plain()), ("video", video(folder))] {
        let bytes = good.bytes();
        for k in 1..8 {
            all.push((format!("{what}, cut to {k} eighths"), bytes[..bytes.len() * k / 8].to_vec()));
        }
        let mut change = |name: &str, change: &dyn Fn(&mut File)| {
            let mut file = good.clone();
            change(&mut file);
            all.push((format!("{what}, {name}"), file.bytes()));
        };
        for n in ["0", "-3", "1e9", "99999999", "2.5", "many", "4294967297", "1000000"] {
            change(&format!("{n} frames"), &|f| {
                f.set((0x0028, 0x0008), "IS", text(n));
            });
        }
        for size in [0, 9, 65535] {
            change(&format!("{size} rows"), &|f| {
                f.set((0x0028, 0x0010), "US", short(size));
            });
        }
        change("no columns", &|f| f.elements.retain(|(tag, ..)| *tag != (0x0028, 0x0011)));
        change("no pixels", &|f| f.pixels.clear());
        change("no fragments", &|f| {
            f.fragments(&[], &[]);
        });
        change("an open sequence", &|f| {
            let head = [0x0c, 0x00, 0x01, 0x00, b'S', b'Q', 0, 0, 0xff, 0xff, 0xff, 0xff];
            f.pixels = [head.as_slice(), &f.pixels].concat();
        });
        change("deep nesting", &|f| {
            let level = [0x28, 0x00, 0x02, 0x99, b'S', b'Q', 0, 0, 0xff, 0xff, 0xff, 0xff];
            let item = [0xfe, 0xff, 0x00, 0xe0, 0xff, 0xff, 0xff, 0xff];
            let deep = [level.as_slice(), &item].concat().repeat(50_000);
            f.pixels = [deep.as_slice(), &f.pixels].concat();
        });
        change("a value longer than the file", &|f| {
            let head = [0x28, 0x00, 0x01, 0x12, b'O', b'W', 0, 0, 0xf0, 0xff, 0xff, 0xff];
            f.pixels = [head.as_slice(), &f.pixels].concat();
        });
        change("a private value longer than the file", &|f| {
            let head = [0x29, 0x00, 0x01, 0x10, b'U', b'N', 0, 0, 0xf0, 0xff, 0xff, 0xff];
            f.pixels = [head.as_slice(), &f.pixels].concat();
        });
        change("a stray end", &|f| {
            f.pixels = [[0xfe, 0xff, 0x0d, 0xe0, 0, 0, 0, 0].as_slice(), &f.pixels].concat();
        });
        change("an element without a type", &|f| {
            f.pixels = [[0x28, 0x00, 0x00, 0x20, 1, 2, 3, 4].as_slice(), &f.pixels].concat();
        });
        change("another syntax", &|f| f.syntax = "1.2.840.10008.1.2.4.999");
        change("high bytes first", &|f| f.syntax = "1.2.840.10008.1.2.2");
        change("deflated", &|f| f.syntax = "1.2.840.10008.1.2.1.99");
        change("JPEG that is none", &|f| f.syntax = "1.2.840.10008.1.2.4.50");
        change("run lengths that are none", &|f| f.syntax = "1.2.840.10008.1.2.5");
    }
    let mut change = |name: &str, change: &dyn Fn(&mut File)| {
        let mut file = plain();
        change(&mut file);
        all.push((name.to_owned(), file.bytes()));
    };
    change("32 bits", &|f| {
        f.set((0x0028, 0x0100), "US", short(32));
    });
    change("more bits than there are", &|f| {
        f.set((0x0028, 0x0101), "US", short(9));
    });
    change("unknown colours", &|f| {
        f.set((0x0028, 0x0004), "CS", text("CMYK"));
    });
    change("a palette without colours", &|f| {
        f.set((0x0028, 0x0004), "CS", text("PALETTE COLOR")).set((0x0028, 0x0002), "US", short(1));
    });
    change("a report", &|f| f.pixels.clear());
    all
}

#[test]
fn broken_files_end_in_one_message_that_says_nothing_about_anybody() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("file.dcm");
    let all = broken(folder.path());
    assert!(all.len() > 40, "{}", all.len());
    for (what, bytes) in all {
        fs::write(&path, bytes).unwrap();
        let said = match Sequence::open(&path) {
            Ok(sequence) => panic!("{what}: {} frames", sequence.num_frames()),
            Err(e) => e.to_string(),
        };
        assert!(said.len() > 20 && !said.contains(SECRET) && !said.contains("19610203"), "{what}: {said}");
    }
}

#[test]
fn what_is_hidden_is_black_not_supervised_and_part_of_the_identity() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("file.dcm");
    let open = plain().open(&path).unwrap();
    let rectangle = HiddenRectangle { x: 2, y: 1, width: 3, height: 2 };
    let toml = "[[hidden]]\nx = 2\ny = 1\nwidth = 3\nheight = 2\n";
    fs::write(folder.path().join("file.dcm.toml"), toml).unwrap();
    let hidden = Sequence::open(&path).unwrap();
    fs::remove_file(folder.path().join("file.dcm.toml")).unwrap();
    let again = Sequence::open_with(&path, None, &[rectangle, rectangle]).unwrap();
    for i in 0..3 {
        let (before, after) = (open.frame(i).unwrap(), hidden.frame(i).unwrap());
        let mask = hidden.mask(i).unwrap();
        for (x, y, pixel) in after.enumerate_pixels() {
            let is_hidden = (2..5).contains(&x) && (1..3).contains(&y);
            let expected = if is_hidden { Rgb([0; 3]) } else { *before.get_pixel(x, y) };
            assert_eq!(*pixel, expected, "{x} {y}");
            assert!(!is_hidden || !mask.at(x as usize, y as usize));
        }
        assert_eq!(again.frame(i).unwrap(), after);
    }
    let (then, now) = (open.identity().unwrap(), hidden.identity().unwrap());
    assert!(now.difference(&then).unwrap().to_string().contains("hidden"));
    assert_eq!(again.identity().unwrap().difference(&now), None);
    assert_ne!(then.digest(), now.digest());
    assert_eq!(hidden.name(), open.name());
    let outside = HiddenRectangle { x: 8, ..rectangle };
    assert!(message(Sequence::open_with(&path, None, &[outside])).contains("hides nothing"));
}
