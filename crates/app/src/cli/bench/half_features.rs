//! Features rendered at half size and enlarged along the edges of the full picture. They are measured to know
//! what rendering features at full size is worth.

use rayon::prelude::*;
use surgtpgs_core::{
    Result,
    camera::Camera,
    raster::{ALPHA_PLANE, CpuRenderer, FEATURE_PLANE, FrameClock, Images, Renderer},
    scene::Scene,
};

/// Colours this far apart (0–1, all three channels together) are taken for different things.
const EDGE: f32 = 0.08;

/// Renders colours at full and features at half size.
#[derive(Default)]
pub(super) struct HalfFeatures {
    full: CpuRenderer,
    half: CpuRenderer,
    small: Images,
}

impl HalfFeatures {
    /// Same as [`Renderer::render_into`] with features.
    pub(super) fn render_into(
        &mut self,
        scene: &Scene,
        camera: &Camera,
        time: f32,
        images: &mut Images,
    ) -> Result<()> {
        let mut clock = FrameClock::default();
        let half = camera.resized(camera.width.div_ceil(2), camera.height.div_ceil(2));
        self.full.render_into(scene, camera, time, false, images, &mut clock)?;
        self.half.render_into(scene, &half, time, true, &mut self.small, &mut clock)?;
        add_features(images, &self.small);
        Ok(())
    }
}

/// Appends the feature planes of `small` to `full`. A full-size pixel mixes the four nearest small
/// pixels; the more alike in colour and the nearer one is, the more it counts (joint bilateral
/// upsampling, Kopf et al. 2007).
fn add_features(full: &mut Images, small: &Images) {
    let (width, n, dim) = (full.width, full.width * full.height, small.latent_dim());
    full.planes.resize((FEATURE_PLANE + dim) * n, 0.0);
    let (known, features) = full.planes.split_at_mut(FEATURE_PLANE * n);
    let known = &*known;
    let mut rows: Vec<Vec<&mut [f32]>> = (0..full.height).map(|_| Vec::with_capacity(dim)).collect();
    for plane in features.chunks_mut(n.max(1)) {
        rows.iter_mut().zip(plane.chunks_mut(width.max(1))).for_each(|(rows, row)| rows.push(row));
    }
    rows.into_par_iter().enumerate().for_each(|(y, mut rows)| {
        for x in 0..width {
            let at = |plane: usize| known[plane * n + y * width + x];
            let latent = latent_near(small, [x, y], [at(0), at(1), at(2)]);
            for (row, value) in rows.iter_mut().zip(latent) {
                row[x] = value * at(ALPHA_PLANE);
            }
        }
    });
}

/// Returns the latent of a full-size pixel of this colour; zeros where nothing is near.
fn latent_near(small: &Images, pixel: [usize; 2], colour: [f32; 3]) -> Vec<f32> {
    let mut sum = vec![0.0; small.latent_dim()];
    let mut total = 0.0;
    // Position of the pixel's centre among the centres of small pixels.
    let [x, y] = pixel.map(|p| (p as f32 + 0.5) / 2.0 - 0.5);
    let inside = |v: f32, size: usize| (v.max(0.0) as usize).min(size - 1);
    for (dx, dy) in [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0)] {
        let (cx, cy) = (x.floor() + dx, y.floor() + dy);
        let at = inside(cy, small.height) * small.width + inside(cx, small.width);
        let alpha = small.plane(ALPHA_PLANE)[at];
        if alpha <= 0.0 {
            continue;
        }
        let apart: f32 = (0..3).map(|c| (small.plane(c)[at] - colour[c]).powi(2)).sum();
        let near = (1.0 - (x - cx).abs()) * (1.0 - (y - cy).abs());
        let weight = near * (-apart / (2.0 * EDGE * EDGE)).exp() + f32::MIN_POSITIVE;
        for (k, sum) in sum.iter_mut().enumerate() {
            *sum += weight * small.plane(FEATURE_PLANE + k)[at] / alpha;
        }
        total += weight;
    }
    if total > 0.0 {
        sum.iter_mut().for_each(|v| *v /= total);
    }
    sum
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two halves, left black with latent 1, right white with latent 5, at any size.
    fn halves(width: usize, height: usize, with_features: bool) -> Images {
        let n = width * height;
        let is_right = |i: usize| (i % width) * 2 >= width;
        let plane = |left: f32, right: f32| (0..n).map(move |i| if is_right(i) { right } else { left });
        let mut planes: Vec<f32> = (0..3).flat_map(|_| plane(0.0, 1.0)).collect();
        planes.extend(plane(2.0, 2.0));
        planes.extend(plane(0.5, 1.0));
        if with_features {
            planes.extend(plane(0.5, 5.0));
        }
        Images { width, height, planes }
    }

    #[test]
    fn features_stay_on_their_side_of_an_edge() {
        for (width, height) in [(16, 6), (15, 5), (4, 1)] {
            let mut full = halves(width, height, false);
            add_features(&mut full, &halves(width.div_ceil(2), height.div_ceil(2), true));
            let expected = halves(width, height, true);
            for (found, expected) in full.plane(FEATURE_PLANE).iter().zip(expected.plane(FEATURE_PLANE)) {
                assert!((found - expected).abs() < 1e-3, "{width}×{height}: {found}, expected {expected}");
            }
        }
    }
}
