//! Points whose scores are computed: rendered pixels or single Gaussians.

use crate::raster::{ALPHA_PLANE, FEATURE_PLANE, Images};
use std::borrow::Cow;

/// Latents of many points, plane after plane, with the opacity they were accumulated with.
#[derive(Clone, Debug)]
pub struct Points<'a> {
    /// One plane per latent number: Σ w f.
    planes: Vec<Cow<'a, [f32]>>,
    /// Σ w of each point.
    alpha: Cow<'a, [f32]>,
    /// Smallest alpha of a point that is not a hole.
    min_alpha: f32,
}

impl<'a> Points<'a> {
    /// Smallest alpha of a point that is not a hole, for any settings: a division by less is unsafe.
    pub const MIN_ALPHA: f32 = 1e-6;
    /// Smallest length of a latent that shows anything. Those of features have length 1. What learned no feature
    /// has latents of length 0, which a decoder with biases would take for one.
    pub const MIN_LENGTH: f32 = 0.05;

    /// Pixels of rendered images, whose latent is features / alpha.
    pub fn of_images(images: &'a Images, min_alpha: f32) -> Self {
        let planes = (0..images.latent_dim()).map(|k| Cow::from(images.plane(FEATURE_PLANE + k))).collect();
        let alpha = if images.planes.is_empty() { &[][..] } else { images.plane(ALPHA_PLANE) };
        Self { planes, alpha: alpha.into(), min_alpha }
    }

    /// Single latents, [n][D] flat, for example those of the Gaussians themselves.
    pub fn of_latents(latents: &[f32], latent_dim: usize) -> Self {
        let plane = |k: usize| latents.iter().copied().skip(k).step_by(latent_dim.max(1)).collect();
        let count = latents.len() / latent_dim.max(1);
        Self {
            planes: (0..latent_dim).map(|k| Cow::Owned(plane(k))).collect(),
            alpha: vec![1.0; count].into(),
            min_alpha: 0.0,
        }
    }

    /// Points with these indices, in this order.
    pub(super) fn chosen(&self, numbers: &[usize]) -> Points<'static> {
        let pick = |values: &[f32]| Cow::Owned(numbers.iter().map(|&i| values[i]).collect());
        Points {
            planes: self.planes.iter().map(|p| pick(p)).collect(),
            alpha: pick(&self.alpha),
            min_alpha: self.min_alpha,
        }
    }

    /// Returns the number of points.
    pub fn len(&self) -> usize {
        self.alpha.len()
    }

    /// Returns `true` if there are no points.
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

    /// Smallest alpha of a point that is not a hole.
    pub(super) fn min_alpha(&self) -> f32 {
        self.min_alpha.max(Self::MIN_ALPHA)
    }

    /// Appends the latent of point `i` to `out` and returns `true`, unless it is in a hole, shorter than
    /// [`Self::MIN_LENGTH`], or not finite.
    pub fn push_latent(&self, i: usize, out: &mut Vec<f32>) -> bool {
        let alpha = self.alpha[i];
        // Also true for NaN.
        if !(alpha >= self.min_alpha()) {
            return false;
        }
        let shortest = Self::MIN_LENGTH * alpha;
        if self.planes.iter().map(|p| p[i] * p[i]).sum::<f32>() < shortest * shortest {
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
