//! Raw sequences of the 2018 Robotic Scene Segmentation Challenge: `left_frames/`, coloured
//! `labels/`, `labels.json` (here or one folder up), and `camera_calibration.txt`. (Allan et al.
//! 2020, arXiv 2001.11190.)

use crate::{
    Error, Result,
    reading::{is_present, read_text},
    sequence::{
        read,
        recording::{CameraSource, Recording},
    },
};
use std::path::Path;

/// Columns and rows of the challenge's pictures, which its calibration is of.
const SIZE: [f32; 2] = [1280.0, 1024.0];

/// Returns `true` if `folder` has the marks of this layout.
pub(super) fn matches(folder: &Path) -> Result<bool> {
    Ok(read::holds(&folder.join("left_frames"), read::PICTURES))
}

pub(super) fn open(folder: &Path) -> Result<Recording> {
    let images = super::frames_in(&folder.join("left_frames"))?;
    let mut recording = Recording::of_pictures(folder, &images)?;
    let here = folder.join("labels.json");
    let above = folder.join("../labels.json");
    recording.add_labels(&folder.join("labels"), if is_present(&here) { &here } else { &above })?;
    let calibration = folder.join("camera_calibration.txt");
    if is_present(&calibration) {
        let [fx, fy, cx, cy] = read_calibration(&calibration)?;
        let scale = [recording.width as f32 / SIZE[0], recording.height as f32 / SIZE[1]];
        if scale != [1.0; 2] {
            let [width, height] = SIZE;
            recording.notes.push(format!(
                "camera_calibration.txt is for {width}×{height} pixels, the images are {}×{}: it was scaled",
                recording.width, recording.height
            ));
        }
        let ([fx, cx], [fy, cy]) = ([fx, cx].map(|v| v * scale[0]), [fy, cy].map(|v| v * scale[1]));
        for camera in &mut recording.cameras {
            (camera.fx, camera.fy, camera.cx, camera.cy) = (fx, fy, cx, cy);
        }
        recording.camera_source = CameraSource::Lens;
    }
    Ok(recording)
}

/// Reads the focal lengths and principal point of the left camera, from lines such as
/// `Camera-0-F: 1084.21 1084.05 // left camera x,y focal dist in pixels`.
fn read_calibration(path: &Path) -> Result<[f32; 4]> {
    let text = read_text(path).map_err(|e| Error::io("read the calibration", path, e))?;
    let pair = |key: &str| -> Option<[f32; 2]> {
        let line = text.lines().find_map(|line| line.trim().strip_prefix(key))?;
        let mut numbers = line.trim_start_matches([':', ' ']).split_whitespace().map(str::parse);
        Some([numbers.next()?.ok()?, numbers.next()?.ok()?])
    };
    match (pair("Camera-0-F"), pair("Camera-0-C")) {
        (Some([fx, fy]), Some([cx, cy])) => Ok([fx, fy, cx, cy]),
        _ => Err(Error::input_at(
            path,
            "the calibration lacks the left camera's lines Camera-0-F and Camera-0-C with two numbers each",
            "Remove the file to go on with an assumed camera.",
        )),
    }
}
