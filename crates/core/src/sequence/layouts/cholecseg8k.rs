//! Raw CholecSeg8K clips: `frame_K_endo.png` and beside it `frame_K_endo_watershed_mask.png`, whose grey
//! value names the class. No poses, no depth. (Hong et al., CholecSeg8k, 2020, arXiv 2012.12453.)

use crate::{
    Result,
    reading::is_present,
    sequence::{
        classes::Class,
        labels::{LabelCoding, LabelFiles},
        read,
        recording::{FrameFiles, MaskRule, Recording},
    },
};
use std::path::{Path, PathBuf};

/// Watershed code of the black border around the round picture.
const BLACK_BACKGROUND: u8 = 50;

/// (watershed code, class id), in the order of the data set's own table.
const CODES: &[(u8, u8)] = &[
    (BLACK_BACKGROUND, 0),
    (11, 1),
    (21, 2),
    (13, 3),
    (12, 4),
    (31, 5),
    (23, 6),
    (24, 7),
    (25, 8),
    (32, 9),
    (22, 10),
    (33, 11),
    (5, 12),
];

/// Names and colours (those of the data set's `_color_mask` pictures) of class ids 0, 1, 2…
const CLASSES: [(&str, [u8; 3]); 13] = [
    ("black background", [127, 127, 127]),
    ("abdominal wall", [210, 140, 140]),
    ("liver", [255, 114, 114]),
    ("gastrointestinal tract", [231, 70, 156]),
    ("fat", [186, 183, 75]),
    ("grasper", [170, 255, 0]),
    ("connective tissue", [255, 85, 0]),
    ("blood", [255, 0, 0]),
    ("cystic duct", [255, 255, 0]),
    ("l-hook electrocautery", [169, 255, 184]),
    ("gallbladder", [255, 160, 165]),
    ("hepatic vein", [0, 50, 128]),
    ("liver ligament", [111, 74, 0]),
];

/// Returns the frames of a raw CholecSeg8K folder; empty if the folder is none.
fn frames(folder: &Path) -> Result<Vec<PathBuf>> {
    let mut files = read::list(folder, &["png"])?;
    files.retain(|path| {
        let name = read::file_name(path);
        let number = name.strip_prefix("frame_").and_then(|n| n.strip_suffix("_endo.png"));
        number.is_some_and(|n| !n.is_empty() && n.bytes().all(|b| b.is_ascii_digit()))
    });
    Ok(files)
}

/// Returns `true` if `folder` has the marks of this layout.
pub(super) fn matches(folder: &Path) -> Result<bool> {
    Ok(!frames(folder)?.is_empty())
}

pub(super) fn open(folder: &Path) -> Result<Recording> {
    let images = frames(folder)?;
    let mut recording = Recording::of_pictures(folder, &images)?;
    for (frame, image) in recording.frames.iter_mut().zip(&images) {
        let watershed = image.with_file_name(format!("{}_watershed_mask.png", read::stem(image)));
        if is_present(&watershed) {
            add_labels(frame, watershed);
        }
    }
    recording.mask_rule = MaskRule::DropCode(BLACK_BACKGROUND);
    recording.coding = LabelCoding::Codes(CODES);
    if recording.frames.iter().any(|f| f.labels.is_some()) {
        let class = |(i, (name, colour)): (usize, &(&str, [u8; 3]))| Class {
            id: i as u8,
            name: (*name).to_owned(),
            colour: *colour,
        };
        recording.classes = CLASSES.iter().enumerate().map(class).collect();
    }
    Ok(recording)
}

fn add_labels(frame: &mut FrameFiles, watershed: PathBuf) {
    frame.mask = Some(watershed.clone());
    frame.labels = Some(LabelFiles::Picture(watershed));
}
