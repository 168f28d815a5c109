//! Files of recordings: pictures, arrays, lists, videos, prepared folders, masks and unfinished training.

use crate::{Target, expect_words};
use image::{DynamicImage, GrayImage, ImageFormat, Luma, Rgb, RgbImage, RgbaImage};
use ndarray::{Array, Array2, Array3, ArrayD};
use ndarray_npy::{WritableElement, WriteNpyExt};
use std::{
    cell::OnceCell,
    fs,
    io::Cursor,
    path::{Path, PathBuf},
};
use surgtpgs_core::{
    prepare::{Prepared, read_langsplat},
    progress::unobserved,
    segment::{FrameMasks, Level},
    sequence::{self, Sequence},
    stress::small_clip,
    train::{TrainSettings, Trainer},
};
use tempfile::TempDir;

pub(crate) const TARGETS: [Target; 13] = [
    Target { name: "picture", run: |bytes| replaced("images/0.png", bytes), seeds: pictures },
    Target { name: "mask", run: |bytes| replaced("masks/0.png", bytes), seeds: pictures },
    Target { name: "label_picture", run: |bytes| replaced("labels/0.png", bytes), seeds: pictures },
    Target { name: "label_list", run: |bytes| replaced("labels.json", bytes), seeds: label_lists },
    Target { name: "depth", run: |bytes| replaced("depth/0.npy", bytes), seeds: arrays },
    Target { name: "settings", run: |bytes| replaced("sequence.toml", bytes), seeds: settings },
    Target { name: "poses_bounds", run: poses_bounds, seeds: poses },
    Target { name: "transforms", run: |bytes| replaced("transforms.json", bytes), seeds: transforms },
    Target { name: "video", run: video, seeds: videos },
    Target { name: "prepared", run: prepared, seeds: manifests },
    Target { name: "langsplat", run: langsplat, seeds: langsplats },
    Target { name: "frame_masks", run: frame_masks, seeds: stored_masks },
    Target { name: "checkpoint", run: checkpoint, seeds: checkpoints },
];

/// Columns and rows of the recording that targets break.
pub(crate) const SIZE: (u32, u32) = (8, 6);

/// Creates an empty folder.
pub(crate) fn scratch() -> TempDir {
    match tempfile::tempdir() {
        Ok(folder) => folder,
        Err(e) => panic!("no temporary folder: {e}"),
    }
}

/// A small recording with one of its files replaced or added.
pub(crate) fn replaced(file: &str, bytes: &[u8]) {
    let folder = scratch();
    write_recording(folder.path());
    write(folder.path(), file, bytes);
    look_at(folder.path());
}

/// Opens a recording, checks it and reads its first frames whole.
pub(crate) fn look_at(path: &Path) {
    let Some(sequence) = expect_words(Sequence::open(path)) else { return };
    let size = (sequence.width(), sequence.height());
    for i in 0..sequence.num_frames().min(3) {
        if let Some(frame) = expect_words(sequence.frame(i)) {
            assert_eq!((frame.width() as usize, frame.height() as usize), size);
        }
        if let Some(mask) = expect_words(sequence.mask(i)) {
            assert_eq!((mask.width, mask.height), size);
        }
        if let Some(Some(depth)) = expect_words(sequence.depth(i)) {
            assert_eq!((depth.width, depth.height), size);
            assert!(depth.data.iter().all(|z| z.is_finite() && *z >= 0.0), "a depth that is none");
        }
        if let Some(Some(labels)) = expect_words(sequence.labels(i)) {
            assert_eq!((labels.width, labels.height), size);
        }
        expect_words(sequence.instruments(i));
    }
    sequence::check(&sequence, &mut unobserved).expect("nobody stops it");
}

pub(crate) fn write(folder: &Path, file: &str, bytes: &[u8]) {
    let path = folder.join(file);
    let written = path.parent().map_or(Ok(()), fs::create_dir_all).and_then(|()| fs::write(&path, bytes));
    assert!(written.is_ok(), "{}: {written:?}", path.display());
}

fn write_recording(folder: &Path) {
    let frame = png(RgbImage::from_fn(SIZE.0, SIZE.1, |x, y| Rgb([90 + x as u8, 60 + y as u8, 50])));
    for i in 0..2 {
        write(folder, &format!("images/{i}.png"), &frame);
        write(folder, &format!("labels/{i}.png"), &png(GrayImage::from_pixel(SIZE.0, SIZE.1, Luma([1]))));
    }
    write(folder, "labels.json", &label_lists()[0]);
}

pub(crate) fn png(picture: impl Into<DynamicImage>) -> Vec<u8> {
    encoded(&picture.into(), ImageFormat::Png)
}

fn encoded(picture: &DynamicImage, format: ImageFormat) -> Vec<u8> {
    let mut bytes = Cursor::new(Vec::new());
    let written = picture.write_to(&mut bytes, format);
    assert!(written.is_ok(), "{written:?}");
    bytes.into_inner()
}

fn npy<T: WritableElement + Clone>(array: ArrayD<T>) -> Vec<u8> {
    let mut bytes = Vec::new();
    let written = array.write_npy(&mut bytes);
    assert!(written.is_ok(), "{written:?}");
    bytes
}

fn pictures() -> Vec<Vec<u8>> {
    let rgb = DynamicImage::from(RgbImage::from_fn(SIZE.0, SIZE.1, |x, y| Rgb([x as u8, y as u8, 9])));
    vec![
        png(rgb.clone()),
        encoded(&rgb, ImageFormat::Jpeg),
        png(rgb.to_luma16()),
        png(GrayImage::new(SIZE.0, SIZE.1)),
        png(RgbaImage::new(SIZE.0, SIZE.1)),
    ]
}

fn label_lists() -> Vec<Vec<u8>> {
    vec![
        br#"[{"id": 1, "name": "liver", "colour": [1, 2, 3]}, {"id": 2, "name": "fat"}]"#.to_vec(),
        br#"[{"name": "background-tissue", "color": [0, 0, 0], "classid": 0}, {"name": "kidney", "color": [1, 1, 1], "classid": 1}]"#.to_vec(),
    ]
}

fn arrays() -> Vec<Vec<u8>> {
    let (w, h) = (SIZE.0 as usize, SIZE.1 as usize);
    let values = Array::from_shape_fn((h, w), |(y, x)| 1.0 + (x + y) as f32);
    vec![
        npy(values.clone().into_dyn()),
        npy(values.mapv(f64::from).insert_axis(ndarray::Axis(0)).into_dyn()),
        npy(values.mapv(|v| v as u16).into_dyn()),
        npy(values.mapv(|v| v as i64).into_dyn()),
    ]
}

fn settings() -> Vec<Vec<u8>> {
    vec![
        b"[camera]\nfx = 569.5\nfy = 1.0\ncx = 3\ncy = 2\n[depth]\nkind = \"disparity\"\nscale = 0.001\n[masks]\nkeep = \"white\"\n".to_vec(),
        b"[camera]\nfov_x_degrees = 60.0\n[masks]\nfield_of_view = \"whole\"\n[time]\nframes_per_second = 25.0\nevery = 2\n[frames]\nfirst = 0\nlast = 1\n[[classes]]\nid = 1\nname = \"liver\"\ncolour = [255, 114, 114]\n".to_vec(),
    ]
}

fn transforms() -> Vec<Vec<u8>> {
    let frame = |i: usize| {
        format!(
            r#"{{"file_path": "images/{i}.png", "label_path": "labels/{i}.png", "transform_matrix": [[1, 0, 0, {i}], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]}}"#
        )
    };
    let whole =
        |camera: &str| format!(r#"{{{camera}, "frames": [{}, {}]}}"#, frame(0), frame(1)).into_bytes();
    vec![
        whole(
            r#""w": 8, "h": 6, "fl_x": 7.5, "fl_y": 7.5, "cx": 4, "cy": 3, "classes": [{"id": 1, "name": "liver"}]"#,
        ),
        whole(
            r#""camera_angle_x": 0.8, "k1": 0.0, "depth_unit_scale_factor": 0.01, "camera_model": "PINHOLE""#,
        ),
    ]
}

fn poses_bounds(bytes: &[u8]) {
    let folder = scratch();
    write_recording(folder.path());
    let black = png(GrayImage::new(SIZE.0, SIZE.1));
    (0..2).for_each(|i| write(folder.path(), &format!("masks/{i}.png"), &black));
    write(folder.path(), "poses_bounds.npy", bytes);
    look_at(folder.path());
}

fn poses() -> Vec<Vec<u8>> {
    let row = [1.0, 0.0, 0.0, 0.0, 6.0, 0.0, 1.0, 0.0, 0.0, 8.0, 0.0, 0.0, 1.0, 0.0, 9.5, 1.0, 20.0];
    let poses = Array2::from_shape_fn((2, 17), |(_, c)| row[c]);
    vec![npy(poses.clone().into_dyn()), npy(poses.mapv(|v| v as f32).into_dyn())]
}

fn video(bytes: &[u8]) {
    let folder = scratch();
    write(folder.path(), "clip.mp4", bytes);
    look_at(&folder.path().join("clip.mp4"));
}

fn videos() -> Vec<Vec<u8>> {
    vec![include_bytes!("../seeds/small.mp4").to_vec()]
}

/// Recording that was prepared and trained a little, made once per thread.
struct Trained {
    folder: TempDir,
    manifest: Vec<u8>,
    checkpoint: Vec<u8>,
}

impl Trained {
    fn with<T>(look: impl FnOnce(&Self) -> T) -> T {
        thread_local!(static TRAINED: OnceCell<Trained> = const { OnceCell::new() });
        TRAINED.with(|trained| look(trained.get_or_init(Self::new)))
    }

    fn new() -> Self {
        match Self::try_new() {
            Ok(trained) => trained,
            Err(e) => panic!("the recording to be broken cannot be made: {e}"),
        }
    }

    fn try_new() -> surgtpgs_core::Result<Self> {
        let folder = scratch();
        let prepared = small_clip(folder.path(), 2)?;
        let train = TrainSettings { iterations: 3, ..TrainSettings::default() };
        let mut trainer = Trainer::new(&prepared.sequence, Some(&prepared), train)?;
        trainer.step()?;
        let path = folder.path().join("unfinished");
        trainer.save_checkpoint(&path)?;
        let read = |path: PathBuf| fs::read(&path).map_err(|e| surgtpgs_core::Error::io("read", &path, e));
        Ok(Self { manifest: read(prepared.folder.join("prepared.json"))?, checkpoint: read(path)?, folder })
    }

    fn prepared(&self) -> PathBuf {
        self.folder.path().join("prepared")
    }
}

fn prepared(bytes: &[u8]) {
    Trained::with(|trained| {
        let manifest = trained.prepared().join("prepared.json");
        assert!(fs::write(&manifest, bytes).is_ok());
        if let Some(prepared) = expect_words(Prepared::open(&trained.prepared())) {
            for i in 0..prepared.sequence.num_frames() {
                if let Some(Some(regions)) = expect_words(prepared.regions(i)) {
                    let rows = prepared.num_rows();
                    assert!(regions.data.iter().all(|r| *r == u16::MAX || usize::from(*r) < rows));
                }
            }
        }
        assert!(fs::write(&manifest, &trained.manifest).is_ok());
    });
}

fn manifests() -> Vec<Vec<u8>> {
    vec![Trained::with(|trained| trained.manifest.clone())]
}

/// Reads LangSplat's files: the bytes are those of the embeddings, then of the maps.
fn langsplat(bytes: &[u8]) {
    let folder = scratch();
    write_recording(folder.path());
    let cut = bytes.windows(6).rposition(|w| w == b"\x93NUMPY").unwrap_or(bytes.len() / 2);
    write(folder.path(), "features/0_f.npy", &bytes[..cut]);
    write(folder.path(), "features/0_s.npy", &bytes[cut..]);
    let Some(sequence) = expect_words(Sequence::open(folder.path())) else { return };
    let read = expect_words(read_langsplat(&folder.path().join("features"), &sequence, 0, Level::Default));
    if let Some(Some(features)) = read {
        let n = features.rows.len();
        assert!(features.regions.data.iter().all(|r| *r == u16::MAX || usize::from(*r) < n));
    }
}

fn langsplats() -> Vec<Vec<u8>> {
    let embeddings = Array2::from_shape_fn((3, 5), |(r, c)| (r * 5 + c) as f32);
    let maps = Array3::from_shape_fn((4, 6, 8), |(_, y, x)| ((x + y) % 4) as f32 - 1.0);
    vec![[npy(embeddings.into_dyn()), npy(maps.into_dyn())].concat()]
}

fn frame_masks(bytes: &[u8]) {
    let folder = scratch();
    let path = folder.path().join("masks.json");
    write(folder.path(), "masks.json", bytes);
    if let Some(Some(masks)) = expect_words(FrameMasks::load(&path, "key")) {
        let painted = masks.painted(Level::Default);
        assert_eq!((painted.width, painted.height), (masks.width, masks.height));
    }
}

fn stored_masks() -> Vec<Vec<u8>> {
    let entry = r#"{"segmentation": {"size": [6, 8], "counts": "061O"}, "predicted_iou": 0.9, "stability_score": 0.95}"#;
    let text = format!(
        r#"{{"key": "key", "width": 8, "height": 6, "default": [{entry}], "small": [], "medium": [], "large": [{entry}]}}"#
    );
    vec![text.into_bytes()]
}

fn checkpoint(bytes: &[u8]) {
    Trained::with(|trained| {
        let path = trained.folder.path().join("broken");
        assert!(fs::write(&path, bytes).is_ok());
        let Some(prepared) = expect_words(Prepared::open(&trained.prepared())) else { return };
        if let Some(mut trainer) = expect_words(Trainer::resume(&prepared.sequence, Some(&prepared), &path)) {
            expect_words(trainer.step());
        }
    });
}

fn checkpoints() -> Vec<Vec<u8>> {
    vec![Trained::with(|trained| trained.checkpoint.clone())]
}
