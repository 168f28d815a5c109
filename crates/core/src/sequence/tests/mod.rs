//! Tests with tiny folders of every layout, and with the real recordings if they are available.

use super::*;
use image::{GrayImage, Luma, Rgb};
use std::path::PathBuf;

mod checks;
mod dicom;
mod identity;
mod layouts;
mod real;
mod videos;

/// Makes a bright asymmetric picture in which frames, axes and channels differ.
fn picture(width: u32, height: u32, frame: u8) -> RgbImage {
    RgbImage::from_fn(width, height, |x, y| Rgb([100 + 10 * frame, 50 + 2 * x as u8, 60 + 5 * y as u8]))
}

/// Writes `pictures` of 8×6 with the given names below `folder`.
fn write_pictures(folder: &Path, names: &[&str]) {
    std::fs::create_dir_all(folder).unwrap();
    for (i, name) in names.iter().enumerate() {
        picture(8, 6, i as u8).save(folder.join(name)).unwrap();
    }
}

/// Writes an 8×6 grey picture whose left `columns` columns are `value`, the rest 0.
fn write_grey(path: &Path, columns: u32, value: u8) {
    std::fs::create_dir_all(path.parent().unwrap()).unwrap();
    GrayImage::from_fn(8, 6, |x, _| Luma([if x < columns { value } else { 0 }])).save(path).unwrap();
}

fn message(result: Result<Sequence>) -> String {
    result.unwrap_err().to_string()
}

/// Writes rows of `poses_bounds.npy` from camera-to-world columns and (s0, s1, focal).
fn write_poses(folder: &Path, rows: &[[[f64; 3]; 5]], bounds: bool) {
    let columns = if bounds { 17 } else { 15 };
    let mut values = ndarray::Array2::<f64>::zeros((rows.len(), columns));
    for (i, row) in rows.iter().enumerate() {
        for (c, column) in row.iter().enumerate() {
            for (r, v) in column.iter().enumerate() {
                values[(i, 5 * r + c)] = *v;
            }
        }
    }
    ndarray_npy::write_npy(folder.join("poses_bounds.npy"), &values).unwrap();
}

const X: [f64; 3] = [1.0, 0.0, 0.0];
const Y: [f64; 3] = [0.0, 1.0, 0.0];
const Z: [f64; 3] = [0.0, 0.0, 1.0];
const O: [f64; 3] = [0.0, 0.0, 0.0];
