//! Where scores are asked for: rendered pixels or single Gaussians.

use crate::raster::{ALPHA_PLANE, FEATURE_PLANE, Images};
use std::borrow::Cow;

/// Latents of many points, plane after plane, with the opacity they were accumulated with.
#[derive(Clone, Debug)]
pub struct Points<'a> {
    /// One plane per latent number: Σ w f.
    planes: Vec<Cow<'a, [f32]>>,
    /// Σ w of each point.
    alpha: Cow<'a, [f32]>,
    /// Points with less alpha are holes.
    min_alpha: f32,
}

impl<'a> Points<'a> {
    /// With less alpha a point is a hole, whatever the settings: what is next to nothing cannot be divided by.
    pub const MIN_ALPHA: f32 = 1e-6;

    /// The pixels of rendered images: their latent is features / alpha.
    pub fn of_images(images: &'a Images, min_alpha: f32) -> Self {
        let planes = (0..images.latent_dim()).map(|k| Cow::from(images.plane(FEATURE_PLANE + k))).collect();
        let alpha = if images.planes.is_empty() { &[][..] } else { images.plane(ALPHA_PLANE) };
        Self { planes, alpha: alpha.into(), min_alpha }
    }

    /// Single latents, [n][D] flat, for example of the Gaussians themselves.
    pub fn of_latents(latents: &[f32], latent_dim: usize) -> Self {
        let plane = |k: usize| latents.iter().copied().skip(k).step_by(latent_dim.max(1)).collect();
        let count = latents.len() / latent_dim.max(1);
        Self {
            planes: (0..latent_dim).map(|k| Cow::Owned(plane(k))).collect(),
            alpha: vec![1.0; count].into(),
            min_alpha: 0.0,
        }
    }

    /// The points with these numbers, in this order.
    pub(super) fn chosen(&self, numbers: &[usize]) -> Points<'static> {
        let pick = |values: &[f32]| Cow::Owned(numbers.iter().map(|&i| values[i]).collect());
        Points {
            planes: self.planes.iter().map(|p| pick(p)).collect(),
            alpha: pick(&self.alpha),
            min_alpha: self.min_alpha,
        }
    }

    /// How many points.
    pub fn len(&self) -> usize {
        self.alpha.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.alpha.is_empty()
    }

    /// Latent numbers per point.
    pub fn latent_dim(&self) -> usize {
        self.planes.len()
    }

    /// Plane `k`: Σ w f.
    pub(super) fn plane(&self, k: usize) -> &[f32] {
        &self.planes[k]
    }

    /// Σ w of each point.
    pub(super) fn alpha(&self) -> &[f32] {
        &self.alpha
    }

    /// Points with less alpha than this are holes.
    pub(super) fn min_alpha(&self) -> f32 {
        self.min_alpha.max(Self::MIN_ALPHA)
    }

    /// Appends the latent of point `i` to `out` and says so, unless it is in a hole or not finite.
    pub fn push_latent(&self, i: usize, out: &mut Vec<f32>) -> bool {
        let alpha = self.alpha[i];
        // Also where it is not a number.
        if !(alpha >= self.min_alpha()) {
            return false;
        }
        let start = out.len();
        out.extend(self.planes.iter().map(|p| p[i] / alpha));
        let finite = out[start..].iter().all(|v| v.is_finite());
        if !finite {
            out.truncate(start);
        }
        finite
    }
}
