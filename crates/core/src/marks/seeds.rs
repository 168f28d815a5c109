//! Evidence carried to the Gaussians that make the marked pixels: sums that the transposed rasterizer
//! gives, as for features in closed form.

use super::Evidence;
use crate::{
    deform::deform,
    raster::{FEATURE_PLANE, Images, Packed, backward::raster_backward, bin::bin, project::project_all},
    scene::Scene,
};

/// Number of names in one pass: each has two of the sixteen channels.
const NAMES_AT_ONCE: usize = 8;

/// Evidence of marks on Gaussians, summed over frames.
pub(super) struct Seeds {
    /// Σ w over marked pixels, [names][Gaussians].
    pub(super) weights: Vec<Vec<f32>>,
    /// Σ w · share over the same pixels, [names][Gaussians].
    pub(super) shares: Vec<Vec<f32>>,
}

impl Seeds {
    /// Sums the evidence of frames.
    pub(super) fn of<'a>(
        scene: &Scene,
        num_names: usize,
        evidence: impl Iterator<Item = &'a Evidence>,
    ) -> Self {
        let zeros = vec![vec![0.0; scene.gaussians.len()]; num_names];
        let mut seeds = Self { weights: zeros.clone(), shares: zeros };
        evidence.for_each(|evidence| seeds.add(scene, evidence));
        seeds
    }

    /// Adds the evidence of a frame: w is the weight of a Gaussian in a pixel.
    fn add(&mut self, scene: &Scene, evidence: &Evidence) {
        let (camera, time) = (scene.cameras[evidence.frame], scene.time(evidence.frame));
        let (width, height) = (camera.width as usize, camera.height as usize);
        let deformed = deform(&scene.gaussians, &scene.deformation, time, false);
        let splats = project_all(&scene.gaussians, &deformed, &camera);
        let bins = bin(&splats, width, height);
        for first in (0..self.weights.len()).step_by(NAMES_AT_ONCE) {
            let (weights, shares) = evidence.planes(first, NAMES_AT_ONCE);
            let names = weights.len() / (width * height).max(1);
            let dim = 2 * names;
            let packed = Packed::new(&splats, &vec![0.0; splats.len() * dim], dim);
            let zeros = vec![0.0; FEATURE_PLANE * width * height];
            let planes = vec![0.0; (FEATURE_PLANE + dim) * width * height];
            let wanted = [zeros, weights, shares].concat();
            let images = Images { width, height, planes };
            let (_, sums) = raster_backward(&splats, &packed, &bins, &images, &wanted);
            for (i, sums) in sums.chunks_exact(dim.max(1)).enumerate() {
                for k in 0..names {
                    self.weights[first + k][i] += sums[k];
                    self.shares[first + k][i] += sums[names + k];
                }
            }
        }
    }
}
