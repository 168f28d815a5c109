//! nerfstudio's `transforms.json`: one pose per frame, so the camera may move.
//!
//! `transform_matrix` is camera-to-world with OpenGL axes (right, up, backwards). Intrinsics are given once
//! or per frame, in pixels of the `w × h` they name; one focal length counts for both axes. `mask_path` is
//! white where kept; `depth_file_path` counts `depth_unit_scale_factor` scene units (0.001 unless given). Our
//! own additions, which other programs ignore: `label_path` per frame and the top-level list `classes` (as in
//! `labels.json`).

use crate::{
    Error, Result,
    camera::Camera,
    reading::{is_present, read_text},
    sequence::{
        classes::{self, ClassEntry},
        labels::LabelFiles,
        read,
        recording::{CameraSource, MaskRule, Recording},
    },
};
use glam::{DAffine3, DMat3, DVec3};
use serde::Deserialize;
use std::path::{Path, PathBuf};

/// Name of the file that marks this layout.
const TRANSFORMS_FILE: &str = "transforms.json";

#[derive(Deserialize)]
struct Transforms {
    frames: Vec<FrameEntry>,
    #[serde(flatten)]
    shared: Intrinsics,
    depth_unit_scale_factor: Option<f64>,
    #[serde(default)]
    classes: Vec<ClassEntry>,
    #[serde(default)]
    camera_model: String,
}

#[derive(Deserialize)]
struct FrameEntry {
    file_path: String,
    transform_matrix: Vec<Vec<f64>>,
    mask_path: Option<String>,
    depth_file_path: Option<String>,
    label_path: Option<String>,
    #[serde(flatten)]
    intrinsics: Intrinsics,
}

#[derive(Clone, Copy, Deserialize)]
struct Intrinsics {
    w: Option<f64>,
    h: Option<f64>,
    fl_x: Option<f64>,
    fl_y: Option<f64>,
    cx: Option<f64>,
    cy: Option<f64>,
    camera_angle_x: Option<f64>,
    k1: Option<f64>,
    k2: Option<f64>,
    k3: Option<f64>,
    p1: Option<f64>,
    p2: Option<f64>,
}

/// Difference of the scales along both sides, of pictures of another size, up to which they were only scaled.
const UNEVEN: f64 = 0.02;

/// Returns `true` if `folder` has the marks of this layout.
pub(super) fn matches(folder: &Path) -> Result<bool> {
    Ok(is_present(&folder.join(TRANSFORMS_FILE)))
}

pub(super) fn open(folder: &Path) -> Result<Recording> {
    let path = folder.join(TRANSFORMS_FILE);
    let text = read_text(&path).map_err(|e| Error::io("read the cameras", &path, e))?;
    let mut transforms: Transforms = serde_json::from_str(&text).map_err(|e| {
        Error::input_at(
            &path,
            format!("the cameras cannot be read: {e}"),
            "The file should be as nerfstudio writes it.",
        )
    })?;
    if transforms.frames.is_empty() {
        return Err(Error::input_at(
            &path,
            "it lists no frame",
            "The file should be as nerfstudio writes it.",
        ));
    }
    transforms.frames.sort_by(|a, b| read::natural_order(&a.file_path, &b.file_path));
    let images: Vec<_> = transforms.frames.iter().map(|f| picture_path(folder, &f.file_path)).collect();
    let mut recording = Recording::of_pictures(folder, &images)?;
    let size = (recording.width as f64, recording.height as f64);
    let mut known = true;
    for (i, entry) in transforms.frames.iter().enumerate() {
        let intrinsics = entry.intrinsics.or(transforms.shared);
        known &= intrinsics.focal(size.0).is_some();
        let of = known_size(&path, intrinsics, size)?;
        if i == 0 && of != size {
            recording.notes.push(format!(
                "transforms.json is for {}×{} pixels, the images are {}×{}: the camera was scaled",
                of.0, of.1, size.0, size.1
            ));
        }
        recording.cameras[i] = camera_of(&path, entry, intrinsics.camera(size, recording.cameras[i]))?;
        let frame = &mut recording.frames[i];
        let beside = |file: &Option<String>| file.as_ref().map(|f| folder.join(f));
        frame.mask = beside(&entry.mask_path);
        frame.depth = beside(&entry.depth_file_path);
        frame.labels = beside(&entry.label_path).map(LabelFiles::Picture);
    }
    if known {
        recording.camera_source = CameraSource::Given;
    }
    recording.mask_rule = MaskRule::KeepWhite;
    recording.depth_rule.scale = transforms.depth_unit_scale_factor.unwrap_or(1e-3);
    recording.classes = classes::from_entries(&transforms.classes, &path)?;
    if recording.classes.is_empty() && is_present(&folder.join("labels.json")) {
        recording.classes = classes::read_json(&folder.join("labels.json"))?;
    }
    if transforms.frames.iter().any(|f| f.intrinsics.or(transforms.shared).distorted())
        || transforms.camera_model.contains("FISHEYE")
    {
        recording.notes.push(
            "the camera in transforms.json has lens distortion, which is not corrected: undistort the frames first"
                .to_owned(),
        );
    }
    Ok(recording)
}

/// Returns the size of pictures that intrinsics are for. Pictures of `size` must be those, only scaled.
fn known_size(path: &Path, intrinsics: Intrinsics, size: (f64, f64)) -> Result<(f64, f64)> {
    let of = intrinsics.size(size);
    let stretch = size.0 / of.0 / (size.1 / of.1);
    if !((1.0 - UNEVEN..=1.0 + UNEVEN).contains(&stretch)) {
        let what = format!("it is for {}×{} pixels, the images are {}×{}", of.0, of.1, size.0, size.1);
        return Err(Error::input_at(path, what, "Give the w and h of these images, or none."));
    }
    Ok(of)
}

/// Returns `camera` with the pose of a frame.
fn camera_of(path: &Path, entry: &FrameEntry, camera: Camera) -> Result<Camera> {
    let pose = world_from_camera(&entry.transform_matrix).ok_or_else(|| {
        let what = format!("the transform_matrix of {} is not an invertible 4×4 matrix", entry.file_path);
        Error::input_at(path, what, "")
    })?;
    Ok(Camera { camera_from_world: pose.inverse().as_affine3a(), ..camera })
}

/// Returns the path of a picture. Names may lack their ending, as instant-ngp writes them.
fn picture_path(folder: &Path, name: &str) -> PathBuf {
    let plain = folder.join(name);
    if plain.is_file() {
        return plain;
    }
    let with_ending = read::PICTURES.iter().map(|ending| folder.join(format!("{name}.{ending}")));
    with_ending.into_iter().find(|p| p.is_file()).unwrap_or(plain)
}

/// Converts a pose to OpenCV axes; `None` if the matrix has another shape, is not finite or is singular.
fn world_from_camera(rows: &[Vec<f64>]) -> Option<DAffine3> {
    if !(3..=4).contains(&rows.len()) || rows.iter().any(|row| row.len() != 4) {
        return None;
    }
    let column = |c: usize| DVec3::new(rows[0][c], rows[1][c], rows[2][c]);
    let axes = DMat3::from_cols(column(0), -column(1), -column(2));
    let pose = DAffine3 { matrix3: axes, translation: column(3) };
    (pose.is_finite() && axes.determinant().abs() > 1e-9).then_some(pose)
}

impl Intrinsics {
    /// Combines the values of a frame with the shared ones; those of the frame come first.
    fn or(self, shared: Self) -> Self {
        Self {
            w: self.w.or(shared.w),
            h: self.h.or(shared.h),
            fl_x: self.fl_x.or(shared.fl_x),
            fl_y: self.fl_y.or(shared.fl_y),
            cx: self.cx.or(shared.cx),
            cy: self.cy.or(shared.cy),
            camera_angle_x: self.camera_angle_x.or(shared.camera_angle_x),
            k1: self.k1.or(shared.k1),
            k2: self.k2.or(shared.k2),
            k3: self.k3.or(shared.k3),
            p1: self.p1.or(shared.p1),
            p2: self.p2.or(shared.p2),
        }
    }

    /// Returns the focal length along x for pictures `width` columns wide, if it is known. It is that along y
    /// if this alone is given.
    fn focal(&self, width: f64) -> Option<f64> {
        let from_angle = self.camera_angle_x.map(|angle| 0.5 * self.w.unwrap_or(width) / (0.5 * angle).tan());
        self.fl_x.or(from_angle).or(self.fl_y)
    }

    /// Returns columns and rows of the pictures that the numbers are of; `size` if they do not say.
    fn size(&self, size: (f64, f64)) -> (f64, f64) {
        (self.w.unwrap_or(size.0), self.h.unwrap_or(size.1))
    }

    /// Returns the intrinsics for pictures of `size`; unknown values stay as in `assumed`.
    fn camera(&self, size: (f64, f64), assumed: Camera) -> Camera {
        let (w, h) = self.size(size);
        let (sx, sy) = (size.0 / w, size.1 / h);
        let Some(fx) = self.focal(size.0) else { return assumed };
        Camera {
            fx: (fx * sx) as f32,
            fy: (self.fl_y.unwrap_or(fx) * sy) as f32,
            cx: (self.cx.unwrap_or(0.5 * w) * sx) as f32,
            cy: (self.cy.unwrap_or(0.5 * h) * sy) as f32,
            ..assumed
        }
    }

    fn distorted(&self) -> bool {
        [self.k1, self.k2, self.k3, self.p1, self.p2].into_iter().flatten().any(|k| k != 0.0)
    }
}
