//! Depth maps: values in files → z in scene units, at the size of the frames.

use super::read;
use crate::{
    Error, Result,
    grid::Grid,
    reading::{Values, values},
};
use std::path::Path;

/// Meaning of the values of depth files.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum DepthKind {
    /// z = scale · value.
    Depth,
    /// z = scale / value.
    Disparity,
}

/// Origin of the depth of a recording.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum DepthOrigin {
    /// The recording's own depth maps.
    Recorded,
    /// A network that looked at single pictures.
    Estimated,
    /// There is none: the shape of a scene is what its motion happens to allow.
    Absent,
}

impl DepthOrigin {
    /// Returns `true` if lengths in space mean something.
    pub fn is_measured(self) -> bool {
        self == Self::Recorded
    }
}

/// The rule by which depth files are read.
#[derive(Clone, Copy, Debug)]
pub(super) struct DepthRule {
    pub kind: DepthKind,
    pub scale: f64,
}

impl Default for DepthRule {
    fn default() -> Self {
        Self { kind: DepthKind::Depth, scale: 1.0 }
    }
}

/// Depth below which a value means nothing, scene units: its inverse square is too large for a number.
const SMALLEST: f32 = 1e-6;

/// A depth map as read from its file: 0 where unknown.
pub(super) struct DepthMap {
    /// Depth in scene units.
    pub depth: Grid<f32>,
    /// Number of values that were not finite, or negative.
    pub bad_values: usize,
}

impl DepthRule {
    /// Reads a PNG (grey or in one channel, 8 or 16 bits) or npy map. Values that are not finite or not above
    /// [`SMALLEST`] become 0, "unknown".
    pub(super) fn read(&self, path: &Path) -> Result<DepthMap> {
        let is_npy = path.extension().is_some_and(|e| e.eq_ignore_ascii_case("npy"));
        let values = if is_npy { read::npy_map(path)? } else { picture_map(path)? };
        let bad_values = values.data.iter().filter(|v| !v.is_finite() || **v < 0.0).count();
        let depth = values.map(|&v| {
            let value = f64::from(v);
            let z = match self.kind {
                DepthKind::Depth => self.scale * value,
                DepthKind::Disparity => self.scale / value,
            } as f32;
            if v > 0.0 && z >= SMALLEST && z.is_finite() { z } else { 0.0 }
        });
        Ok(DepthMap { depth, bad_values })
    }
}

/// Reads a picture of a map: the brightest channel.
fn picture_map(path: &Path) -> Result<Grid<f32>> {
    let picture = values(path)?;
    if is_colour_mapped(&picture) {
        let what = "this picture shows depth in the colours of a scale, which are no depths";
        return Err(Error::input_at(
            path,
            what,
            "Save the depth itself, as a grey PNG of 16 bits or as npy.",
        ));
    }
    Ok(read::brightest(picture).map(|&v| f32::from(v)))
}

/// Returns `true` if the channels of a picture are neither the same nor all but one empty.
fn is_colour_mapped(picture: &Values) -> bool {
    /// Difference of channels in 8-bit levels that is none.
    const SAME: u8 = 8;
    /// Share of coloured pixels that may be writing.
    const FEW: f32 = 0.02;
    let colours: Vec<[u8; 3]> = match &picture.palette {
        Some(palette) => {
            let colour = |place: &u8| palette.get(usize::from(*place)).copied().unwrap_or_default();
            picture.image.as_bytes().iter().map(colour).collect()
        }
        None if picture.image.color().has_color() => {
            picture.image.to_rgb8().as_raw().as_chunks::<3>().0.to_vec()
        }
        None => return false,
    };
    let is_used = |channel: &usize| colours.iter().any(|colour| colour[*channel] > SAME);
    let differ = |&&[r, g, b]: &&[u8; 3]| r.max(g).max(b) - r.min(g).min(b) > SAME;
    let share = colours.iter().filter(differ).count() as f32 / colours.len() as f32;
    (0..3).filter(is_used).count() > 1 && share > FEW
}

impl DepthMap {
    /// Resamples the map to another size: bilinear between pixel centres, clamped at the border. The
    /// result is unknown where one of the mixed values is.
    pub(super) fn resized(self, width: usize, height: usize) -> Grid<f32> {
        let from = self.depth;
        if (from.width, from.height) == (width, height) {
            return from;
        }
        let columns: Vec<_> = (0..width).map(|x| Neighbours::of(x, width, from.width)).collect();
        let mut data = Vec::with_capacity(width * height);
        for y in 0..height {
            let rows = Neighbours::of(y, height, from.height);
            data.extend(columns.iter().map(|columns| {
                let (mut z, mut known) = (0.0, true);
                for (y, wy) in rows.0 {
                    for (x, wx) in columns.0 {
                        let value = from.at(x, y);
                        known &= value > 0.0 || wx * wy == 0.0;
                        z += wx * wy * value;
                    }
                }
                if known { z } else { 0.0 }
            }));
        }
        Grid::from_vec(width, height, data)
    }
}

/// The two source positions around a target position, with their weights.
struct Neighbours([(usize, f32); 2]);

impl Neighbours {
    fn of(target: usize, target_len: usize, source_len: usize) -> Self {
        let position = (target as f32 + 0.5) * source_len as f32 / target_len as f32 - 0.5;
        let position = position.clamp(0.0, (source_len - 1) as f32);
        let low = position as usize;
        let weight = position - low as f32;
        Self([(low, 1.0 - weight), ((low + 1).min(source_len - 1), weight)])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn map(width: usize, height: usize, data: &[f32]) -> DepthMap {
        DepthMap { depth: Grid::from_vec(width, height, data.to_vec()), bad_values: 0 }
    }

    #[test]
    fn resizing_interpolates_between_pixel_centres_and_clamps() {
        let wide = map(2, 1, &[1.0, 3.0]).resized(4, 1);
        assert_eq!(wide.data, [1.0, 1.5, 2.5, 3.0]);
        let tall = map(1, 2, &[1.0, 3.0]).resized(1, 4);
        assert_eq!(tall.data, [1.0, 1.5, 2.5, 3.0]);
    }

    #[test]
    fn unknown_depth_never_mixes_with_known() {
        assert_eq!(map(2, 1, &[0.0, 3.0]).resized(4, 1).data, [0.0, 0.0, 0.0, 3.0]);
    }

    #[test]
    fn colours_of_a_scale_are_no_depths() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("d.png");
        let read = |colour: fn(u32) -> [u8; 3]| {
            image::RgbImage::from_fn(64, 4, |x, _| image::Rgb(colour(4 * x))).save(&path).unwrap();
            DepthRule::default().read(&path).map(|map| map.depth.at(30, 0))
        };
        // From blue over green to red, as such scales do.
        let message =
            read(|v| [v as u8, (v.min(255 - v) * 2) as u8, 255 - v as u8]).err().unwrap().to_string();
        assert!(message.contains("d.png") && message.contains("colours of a scale"), "{message}");
        assert_eq!(read(|v| [v as u8; 3]).unwrap(), 120.0);
        assert_eq!(read(|v| [0, v as u8, 0]).unwrap(), 120.0, "in one channel");
        assert_eq!(read(|v| if v == 252 { [255, 0, 0] } else { [v as u8; 3] }).unwrap(), 120.0, "writing");
    }

    #[test]
    fn a_depth_of_next_to_nothing_is_unknown() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("d.npy");
        let values = ndarray::arr2(&[[2.0_f32, 1e-20, 1e-3]]);
        ndarray_npy::write_npy(&path, &values.insert_axis(ndarray::Axis(0))).unwrap();
        assert_eq!(DepthRule::default().read(&path).unwrap().depth.data, [2.0, 0.0, 1e-3]);
    }

    #[test]
    fn disparity_is_inverted_and_bad_values_are_unknown() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("d.npy");
        let values = ndarray::arr2(&[[2.0_f32, 0.0, f32::NAN, -1.0]]);
        ndarray_npy::write_npy(&path, &values.insert_axis(ndarray::Axis(0))).unwrap();
        let map = DepthRule { kind: DepthKind::Disparity, scale: 10.0 }.read(&path).unwrap();
        assert_eq!(map.depth.data, [5.0, 0.0, 0.0, 0.0]);
        assert_eq!(map.bad_values, 2);
    }
}
