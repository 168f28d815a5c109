//! Rendered images.

use super::MIN_DEPTH_ALPHA;
use crate::grid::Grid;
use rayon::prelude::*;

/// Depth plane of [`Images`]; the colours come before it, the features follow alpha.
pub const DEPTH_PLANE: usize = 3;
/// Plane of the accumulated opacity Σw = 1 − T.
pub const ALPHA_PLANE: usize = 4;
/// First feature plane.
pub const FEATURE_PLANE: usize = 5;

/// Rendered images of one view, plane after plane: r, g, b (0–1, may overshoot), Σ w z, alpha, features.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Images {
    /// Number of columns.
    pub width: usize,
    /// Number of rows.
    pub height: usize,
    /// Values of all planes: `planes[k * width * height + y * width + x]`.
    pub planes: Vec<f32>,
}

impl Images {
    /// Plane `k`, row-major.
    pub fn plane(&self, k: usize) -> &[f32] {
        let n = self.width * self.height;
        &self.planes[k * n..(k + 1) * n]
    }

    /// Number of feature planes.
    pub fn latent_dim(&self) -> usize {
        (self.planes.len() / (self.width * self.height).max(1)).saturating_sub(FEATURE_PLANE)
    }

    /// Converts the colours to an 8-bit sRGB picture.
    pub fn to_rgb(&self) -> image::RgbImage {
        let byte = |v: f32| (v.clamp(0.0, 1.0) * 255.0 + 0.5) as u8;
        let mut picture = image::RgbImage::new(self.width as u32, self.height as u32);
        if !self.planes.is_empty() {
            let (r, g, b) = (self.plane(0), self.plane(1), self.plane(2));
            picture.par_chunks_mut(3).with_min_len(4096).enumerate().for_each(|(i, pixel)| {
                pixel.copy_from_slice(&[byte(r[i]), byte(g[i]), byte(b[i])]);
            });
        }
        picture
    }

    /// Depth divided by accumulated opacity; 0 if alpha is below [`MIN_DEPTH_ALPHA`].
    pub fn normalised_depth(&self) -> Grid<f32> {
        let depth = self.plane(DEPTH_PLANE).iter().zip(self.plane(ALPHA_PLANE));
        Grid::from_vec(
            self.width,
            self.height,
            depth.map(|(d, a)| if *a >= MIN_DEPTH_ALPHA { d / a } else { 0.0 }).collect(),
        )
    }
}
