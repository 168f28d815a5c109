//! A plain version of the raster pass and its gradient, pixel by pixel, over any [`Real`]. In f64 it is
//! the truth that the vectorised kernels and the shaders are measured against.

use super::{
    FEATURE_PLANE, MAX_ALPHA, MIN_ALPHA, MIN_TRANSMITTANCE,
    project::{CameraView, Splat, SplatGradient, project, view_colour},
};
use crate::{
    camera::Camera,
    deform::{COLOUR_CHANNEL, Deformation, FeatureNet, LIVE_BASIS, basis, gate_feature, move_geometry},
    real::Real,
    scene::Scene,
};

/// Input of the reference: splats with their features.
#[derive(Clone, Debug)]
pub struct ReferenceInput<'a, T> {
    /// All splats.
    pub splats: &'a [Splat<T>],
    /// Features, [N][D].
    pub features: &'a [T],
    /// Latent numbers per splat, D.
    pub latent_dim: usize,
    /// Number of columns.
    pub width: usize,
    /// Number of rows.
    pub height: usize,
}

/// Planes of a whole frame, features included, computed in f64 throughout: deform, project, blend. Twin
/// of [`super::Renderer::render`]; simple and slow.
pub fn reference_frame(scene: &Scene, camera: &Camera, time: f32) -> Vec<f64> {
    let (gaussians, deformation) = (&scene.gaussians, &scene.deformation);
    let wide = |v: &[f32]| v.iter().map(|x| f64::from(*x)).collect::<Vec<f64>>();
    let (n, dim, stride) = (gaussians.len(), gaussians.latent_dim, deformation.stride);
    let (view, bands, time) = (CameraView::new(camera), gaussians.sh_bands() * 3, f64::from(time));
    let (weight, bias) = (wide(&deformation.feature_weight), wide(&deformation.feature_bias));
    let net = FeatureNet { weight: &weight, bias: &bias, slope: f64::from(deformation.gate_slope) };
    let mut features = vec![0.0; n * dim];
    let mut splats = Vec::with_capacity(n);
    for i in 0..n {
        let psi: Vec<f64> =
            (0..stride).map(|c| reference_psi(deformation, n, i * stride + c, time)).collect();
        let moved = move_geometry(
            gaussians.means[i].map(f64::from),
            gaussians.rotations[i].map(f64::from),
            gaussians.log_scales[i].map(f64::from),
            &psi,
        );
        let band0 = std::array::from_fn(|c| f64::from(gaussians.colours[i][c]) + psi[COLOUR_CHANNEL + c]);
        let rest = wide(&gaussians.sh_rest[i * bands..(i + 1) * bands]);
        let colour = view_colour(&view, moved.geometry.mean, band0, gaussians.sh_degree, &rest);
        let opacity = f64::from(gaussians.opacity_logits[i]).sigmoid();
        splats.push(project(&view, &moved.geometry, opacity, colour));
        let gate = &psi[deformation.gate_channel..deformation.gate_channel + dim];
        let feature = wide(&gaussians.features[i * dim..(i + 1) * dim]);
        gate_feature(&net, &feature, gate, time, &mut features[i * dim..(i + 1) * dim]);
    }
    let (width, height) = (camera.width as usize, camera.height as usize);
    ReferenceInput { splats: &splats, features: &features, latent_dim: dim, width, height }.forward()
}

/// ψ(t) at one place of [N][stride].
fn reference_psi(deformation: &Deformation, n: usize, place: usize, time: f64) -> f64 {
    let of = |b: usize| {
        let at = b * n * deformation.stride + place;
        let own = if deformation.is_shared() { b } else { at };
        let (centre, width) = (f64::from(deformation.centres[own]), f64::from(deformation.widths[own]));
        let value = basis(deformation.shape, time, centre, width);
        // The weight of a basis that is not live may be anything.
        if value > f64::from(LIVE_BASIS) { value * f64::from(deformation.weights[at]) } else { 0.0 }
    };
    (0..deformation.num_bases).map(of).sum()
}

/// Ways to cut off contributions.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Cut {
    /// Cuts off as the renderer does: at [`MIN_ALPHA`], [`MAX_ALPHA`] and [`MIN_TRANSMITTANCE`].
    Hard,
    /// Cuts off smoothly, so that the image has a continuous gradient everywhere; for tests of the
    /// formulas across the cuts.
    Smooth,
}

/// Half the width of the range in which a smooth cut approaches [`MAX_ALPHA`].
const SMOOTH_RANGE: f64 = 0.02;

impl Cut {
    /// Alpha and its derivative with respect to opacity · exp(−q/2); `None` if nothing is left.
    fn alpha<T: Real>(self, raw: T) -> Option<(T, T)> {
        let (low, high) = (T::from_f32(MIN_ALPHA), T::from_f32(MAX_ALPHA));
        if raw < low {
            return None;
        }
        match self {
            Self::Hard => Some(if raw > high { (high, T::zero()) } else { (raw, T::one()) }),
            Self::Smooth => {
                let (one, two, range) = (T::one(), T::of(2.0), T::of(SMOOTH_RANGE));
                // The share rises from 0 at MIN_ALPHA to 1 at twice that.
                let s = ((raw - low) / low).min(one);
                let (share, slope) = (s * s * (T::of(3.0) - two * s), T::of(6.0) * s * (one - s) / low);
                let (alpha, slope) = (raw * share, share + raw * slope);
                let t = ((alpha - high + range) / (two * range)).max(T::zero()).min(one);
                let bent = alpha.min(high - range) + two * range * (t - t * t / two);
                Some((bent, slope * (one - t)))
            }
        }
    }
}

/// Contribution of one splat to one pixel.
struct Contribution<T> {
    splat: usize,
    alpha: T,
    /// ∂alpha/∂raw · raw, the derivative of alpha with respect to the exponent.
    follows: T,
    weight: T,
    transmittance: T,
    offset: [T; 2],
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

    fn contributions(&self, cut: Cut, order: &[usize], x: usize, y: usize) -> Vec<Contribution<T>> {
        let mut transmittance = T::one();
        let mut all = Vec::new();
        for &i in order {
            let (offset, raw) = self.splats[i].at_pixel(x, y);
            let Some((alpha, slope)) = cut.alpha(raw) else { continue };
            let next = transmittance * (T::one() - alpha);
            if cut == Cut::Hard && next < T::from_f32(MIN_TRANSMITTANCE) {
                break;
            }
            let (follows, weight) = (slope * raw, alpha * transmittance);
            all.push(Contribution { splat: i, alpha, follows, weight, transmittance, offset });
            transmittance = next;
        }
        all
    }

    /// Contribution of splat `i` to each plane per unit weight.
    fn channels(&self, i: usize) -> Vec<T> {
        let s = &self.splats[i];
        let mut channels = vec![s.colour[0], s.colour[1], s.colour[2], s.depth, T::one()];
        channels.extend_from_slice(&self.features[i * self.latent_dim..(i + 1) * self.latent_dim]);
        channels
    }

    /// Planes as in [`super::Images`].
    pub fn forward(&self) -> Vec<T> {
        self.forward_with(Cut::Hard)
    }

    /// Planes as by [`ReferenceInput::forward`], with the given cut.
    pub fn forward_with(&self, cut: Cut) -> Vec<T> {
        let (n, order) = (self.width * self.height, self.order());
        let mut planes = vec![T::zero(); (FEATURE_PLANE + self.latent_dim) * n];
        for pixel in 0..n {
            for c in self.contributions(cut, &order, pixel % self.width, pixel / self.width) {
                for (k, value) in self.channels(c.splat).into_iter().enumerate() {
                    planes[k * n + pixel] += c.weight * value;
                }
            }
        }
        planes
    }

    /// Gradients of splats and features, given one gradient per value of the planes.
    pub fn backward(&self, g_planes: &[T]) -> (Vec<SplatGradient<T>>, Vec<T>) {
        self.backward_with(Cut::Hard, g_planes)
    }

    /// Gradients as by [`ReferenceInput::backward`], with the given cut.
    pub fn backward_with(&self, cut: Cut, g_planes: &[T]) -> (Vec<SplatGradient<T>>, Vec<T>) {
        let (n, order) = (self.width * self.height, self.order());
        let mut g_splats = vec![SplatGradient::default(); self.splats.len()];
        let mut g_features = vec![T::zero(); self.features.len()];
        for pixel in 0..n {
            let contributions = self.contributions(cut, &order, pixel % self.width, pixel / self.width);
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
        let g_power = g_alpha * c.follows;
        let [dx, dy] = c.offset;
        out.opacity += g_power / s.opacity;
        out.conic[0] -= T::of(0.5) * g_power * dx * dx;
        out.conic[1] -= g_power * dx * dy;
        out.conic[2] -= T::of(0.5) * g_power * dy * dy;
        out.centre[0] += g_power * (s.conic[0] * dx + s.conic[1] * dy);
        out.centre[1] += g_power * (s.conic[1] * dx + s.conic[2] * dy);
    }
}
