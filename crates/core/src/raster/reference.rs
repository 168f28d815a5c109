//! The raster pass and its gradient written plainly, pixel by pixel, over any [`Real`]: the truth in f64
//! that the vectorised kernels and the shaders are measured against.

use super::{
    FEATURE_PLANE, MAX_ALPHA, MIN_ALPHA, MIN_TRANSMITTANCE,
    project::{Splat, SplatGradient},
};
use crate::real::Real;

/// Splats in depth order with their features, as the reference reads them.
#[derive(Clone, Debug)]
pub struct ReferenceInput<'a, T> {
    /// All splats.
    pub splats: &'a [Splat<T>],
    /// [N][D].
    pub features: &'a [T],
    /// D.
    pub latent_dim: usize,
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
}

/// One splat's part in one pixel.
struct Contribution<T> {
    splat: usize,
    alpha: T,
    weight: T,
    transmittance: T,
    offset: [T; 2],
    clamped: bool,
}

impl<T: Real> ReferenceInput<'_, T> {
    /// Visible splats front to back, ties by index.
    fn order(&self) -> Vec<usize> {
        let mut order: Vec<usize> = (0..self.splats.len()).filter(|&i| self.splats[i].is_visible()).collect();
        order.sort_by(|&i, &j| {
            let (a, b) = (self.splats[i].depth, self.splats[j].depth);
            a.partial_cmp(&b).unwrap_or(std::cmp::Ordering::Equal)
        });
        order
    }

    fn contributions(&self, order: &[usize], x: usize, y: usize) -> Vec<Contribution<T>> {
        let mut transmittance = T::one();
        let mut all = Vec::new();
        for &i in order {
            let s = &self.splats[i];
            let d = [T::of(x as f64 + 0.5) - s.centre[0], T::of(y as f64 + 0.5) - s.centre[1]];
            let q =
                s.conic[0] * d[0] * d[0] + T::of(2.0) * s.conic[1] * d[0] * d[1] + s.conic[2] * d[1] * d[1];
            let raw = s.opacity * (T::of(-0.5) * q).exp();
            if raw < T::from_f32(MIN_ALPHA) {
                continue;
            }
            let clamped = raw > T::from_f32(MAX_ALPHA);
            let alpha = raw.min(T::from_f32(MAX_ALPHA));
            let next = transmittance * (T::one() - alpha);
            if next < T::from_f32(MIN_TRANSMITTANCE) {
                break;
            }
            all.push(Contribution {
                splat: i,
                alpha,
                weight: alpha * transmittance,
                transmittance,
                offset: d,
                clamped,
            });
            transmittance = next;
        }
        all
    }

    /// What splat `i` adds to each plane per unit weight.
    fn channels(&self, i: usize) -> Vec<T> {
        let s = &self.splats[i];
        let mut channels = vec![s.colour[0], s.colour[1], s.colour[2], s.depth, T::one()];
        channels.extend_from_slice(&self.features[i * self.latent_dim..(i + 1) * self.latent_dim]);
        channels
    }

    /// Planes as in [`super::Images`].
    pub fn forward(&self) -> Vec<T> {
        let (n, order) = (self.width * self.height, self.order());
        let mut planes = vec![T::zero(); (FEATURE_PLANE + self.latent_dim) * n];
        for pixel in 0..n {
            for c in self.contributions(&order, pixel % self.width, pixel / self.width) {
                for (k, value) in self.channels(c.splat).into_iter().enumerate() {
                    planes[k * n + pixel] += c.weight * value;
                }
            }
        }
        planes
    }

    /// Gradients of splats and features, given one per plane value.
    pub fn backward(&self, g_planes: &[T]) -> (Vec<SplatGradient<T>>, Vec<T>) {
        let (n, order) = (self.width * self.height, self.order());
        let mut g_splats = vec![SplatGradient::default(); self.splats.len()];
        let mut g_features = vec![T::zero(); self.features.len()];
        for pixel in 0..n {
            let contributions = self.contributions(&order, pixel % self.width, pixel / self.width);
            // Σ over the splats behind of weight · (channels · gradient).
            let mut behind = T::zero();
            for c in contributions.iter().rev() {
                let channels = self.channels(c.splat);
                let g: Vec<T> = (0..channels.len()).map(|k| g_planes[k * n + pixel]).collect();
                let value: T = channels.iter().zip(&g).map(|(a, b)| *a * *b).sum();
                let g_alpha = c.transmittance * value - behind / (T::one() - c.alpha);
                behind += c.weight * value;
                self.accumulate(c, g_alpha, &g, &mut g_splats[c.splat], &mut g_features);
            }
        }
        (g_splats, g_features)
    }

    fn accumulate(
        &self,
        c: &Contribution<T>,
        g_alpha: T,
        g: &[T],
        out: &mut SplatGradient<T>,
        g_features: &mut [T],
    ) {
        let s = &self.splats[c.splat];
        for (out, g) in out.colour.iter_mut().zip(g) {
            *out += c.weight * *g;
        }
        out.depth += c.weight * g[3];
        for d in 0..self.latent_dim {
            g_features[c.splat * self.latent_dim + d] += c.weight * g[FEATURE_PLANE + d];
        }
        if c.clamped {
            return;
        }
        let g_power = g_alpha * c.alpha;
        let [dx, dy] = c.offset;
        out.opacity += g_power / s.opacity;
        out.conic[0] -= T::of(0.5) * g_power * dx * dx;
        out.conic[1] -= g_power * dx * dy;
        out.conic[2] -= T::of(0.5) * g_power * dy * dy;
        out.centre[0] += g_power * (s.conic[0] * dx + s.conic[1] * dy);
        out.centre[1] += g_power * (s.conic[1] * dx + s.conic[2] * dy);
    }
}
