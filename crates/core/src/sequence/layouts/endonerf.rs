//! EndoNeRF folders: `images/ masks/ [depth/] poses_bounds.npy` (Wang et al., EndoNeRF, 2022), and
//! StereoMIS in the same layout.
//!
//! A row of `poses_bounds.npy` is a row-major 3×5 matrix `[c0 c1 c2 t s]` with camera-to-world axes and
//! position, then (in EndoNeRF) near and far. The two data sets differ:
//!
//! | | `s` | axes `c0 c1 c2` | masks |
//! |---|---|---|---|
//! | EndoNeRF | rows, columns, focal length | right, up, backwards | white = tool |
//! | StereoMIS | cy, cx, focal length | right, down, forwards | white = tissue |
//!
//! StereoMIS is recognised by its missing near and far (15 numbers) or by `s` naming the image's centre.

use crate::{
    Error, Result,
    camera::Camera,
    reading::{is_present, npy},
    sequence::{
        read,
        recording::{CameraSource, MaskRule, Recording},
    },
};
use glam::{Affine3A, DAffine3, DMat3, DVec3};
use std::path::Path;

/// Returns `true` if `folder` has the marks of this layout.
pub(super) fn matches(folder: &Path) -> Result<bool> {
    Ok(read::holds(&folder.join("images"), read::PICTURES) && is_present(&folder.join("poses_bounds.npy")))
}

pub(super) fn open(folder: &Path) -> Result<Recording> {
    let images = super::frames_in(&folder.join("images"))?;
    let mut recording = Recording::of_pictures(folder, &images)?;
    let poses = Poses::read(&folder.join("poses_bounds.npy"), &recording)?;
    recording.cameras = poses.cameras;
    recording.camera_source = CameraSource::Given;
    recording.add_masks(&folder.join("masks"))?;
    recording.add_depth(&folder.join("depth"))?;
    recording.add_labels(&folder.join("labels"), &folder.join("labels.json"))?;
    recording.mask_rule = MaskRule::KeepBlack;
    if poses.stereo_mis {
        recording.mask_rule = MaskRule::KeepWhite;
        recording.notes.push(
            "poses_bounds.npy follows StereoMIS: camera axes are right, down, forwards, and white in masks is tissue"
                .to_owned(),
        );
    }
    recording.notes.extend(poses.note);
    Ok(recording)
}

struct Poses {
    cameras: Vec<Camera>,
    stereo_mis: bool,
    note: Option<String>,
}

impl Poses {
    fn read(path: &Path, recording: &Recording) -> Result<Self> {
        let (shape, values) = npy(path)?;
        let (rows, columns) = match shape.as_slice() {
            &[rows, columns @ (15 | 17)] if rows > 0 => (rows, columns),
            _ => {
                return Err(Error::input_at(
                    path,
                    format!("expected an array [frames, 17] or [frames, 15], found the shape {shape:?}"),
                    "",
                ));
            }
        };
        if rows != recording.frames.len() {
            return Err(Error::input_at(
                path,
                format!("{} images but {rows} poses in poses_bounds.npy", recording.frames.len()),
                "There must be one pose per image.",
            ));
        }
        Self::from_rows(&values, columns, (recording.width as f64, recording.height as f64))
            .map_err(|what| Error::input_at(path, what, "The file may be damaged or of another kind."))
    }

    fn from_rows(values: &[f64], columns: usize, (width, height): (f64, f64)) -> Result<Self, String> {
        // As in the reference, the intrinsics are those of the first row.
        let (s0, s1, focal) = (values[4], values[9], values[14]);
        if !(focal.is_finite() && focal > 0.0 && s0 > 0.0 && s1 > 0.0) {
            return Err(format!("the first pose has rows {s0}, columns {s1}, focal length {focal}"));
        }
        let near = |a: f64, b: f64| (a / b - 1.0).abs() < 0.25;
        let stereo_mis = columns == 15 || (near(2.0 * s0, height) && near(2.0 * s1, width));
        let mut camera = Camera::with_field_of_view(width as u32, height as u32, 60.0);
        // Columns and rows that the numbers are of. StereoMIS gives the principal point, near the middle.
        let of = match stereo_mis {
            true if near(2.0 * s0, height) && near(2.0 * s1, width) => (width, height),
            true => (2.0 * s1, 2.0 * s0),
            false => (s1, s0),
        };
        let (sx, sy) = (width / of.0, height / of.1);
        (camera.fx, camera.fy) = ((focal * sx) as f32, (focal * sy) as f32);
        if stereo_mis {
            (camera.cy, camera.cx) = ((s0 * sy) as f32, (s1 * sx) as f32);
        }
        let note = ((sx - 1.0).abs() > 1e-6 || (sy - 1.0).abs() > 1e-6).then(|| {
            format!(
                "poses_bounds.npy is for {:.0}×{:.0} pixels, the images are {width}×{height}: the camera was scaled",
                of.0, of.1
            )
        });
        let cameras = values.chunks_exact(columns).enumerate().map(|(i, row)| {
            let camera_from_world = camera_from_world(row, stereo_mis)
                .ok_or_else(|| format!("pose {i} is not a number or cannot be inverted"))?;
            Ok(Camera { camera_from_world, ..camera })
        });
        Ok(Self { cameras: cameras.collect::<Result<_, String>>()?, stereo_mis, note })
    }
}

/// Returns the camera's pose; `None` if it is not finite or singular.
fn camera_from_world(row: &[f64], stereo_mis: bool) -> Option<Affine3A> {
    let column = |c: usize| DVec3::new(row[c], row[5 + c], row[10 + c]);
    let flip = if stereo_mis { 1.0 } else { -1.0 };
    let axes = DMat3::from_cols(column(0), flip * column(1), flip * column(2));
    let world_from_camera = DAffine3 { matrix3: axes, translation: column(3) };
    let usable = world_from_camera.is_finite() && axes.determinant().abs() > 1e-9;
    usable.then(|| world_from_camera.inverse().as_affine3a())
}
