//! Evidence carried to the Gaussians that make the marked pixels: sums that the transposed rasterizer
//! gives, as for features in closed form.

use super::Evidence;
use crate::{
    camera::Camera,
    deform::deform,
    raster::{FEATURE_PLANE, Images, Packed, backward::raster_backward, bin::bin, project::project_all},
    scene::Scene,
};
use std::ops::Range;

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
    /// Returns seeds without evidence for the Gaussians of a scene.
    pub(super) fn none(scene: &Scene, num_names: usize) -> Self {
        let zeros = vec![vec![0.0; scene.gaussians.len()]; num_names];
        Self { weights: zeros.clone(), shares: zeros }
    }

    /// Adds the evidence of a frame.
    pub(super) fn add(&mut self, scene: &Scene, evidence: &Evidence) {
        let camera = scene.cameras[evidence.frame];
        self.add_pixels(scene, camera, scene.time(evidence.frame), |names| evidence.planes(names));
    }

    /// Adds what is known of the pixels of a view: `planes` gives weights and shares of some names,
    /// [names][pixels] each. A Gaussian gets its part w of each pixel.
    pub(super) fn add_pixels(
        &mut self,
        scene: &Scene,
        camera: Camera,
        time: f32,
        planes: impl Fn(Range<usize>) -> (Vec<f32>, Vec<f32>),
    ) {
        let (width, height) = (camera.width as usize, camera.height as usize);
        let deformed = deform(&scene.gaussians, &scene.deformation, time, false);
        let splats = project_all(&scene.gaussians, &deformed, &camera);
        let bins = bin(&splats, width, height);
        let num_names = self.weights.len();
        for first in (0..num_names).step_by(NAMES_AT_ONCE) {
            let names = first..(first + NAMES_AT_ONCE).min(num_names);
            let dim = 2 * names.len();
            let (weights, shares) = planes(names.clone());
            let packed = Packed::new(&splats, &vec![0.0; splats.len() * dim], dim);
            let zeros = vec![0.0; FEATURE_PLANE * width * height];
            let blank = vec![0.0; (FEATURE_PLANE + dim) * width * height];
            let wanted = [zeros, weights, shares].concat();
            let images = Images { width, height, planes: blank };
            let (_, sums) = raster_backward(&splats, &packed, &bins, &images, &wanted);
            for (i, sums) in sums.chunks_exact(dim.max(1)).enumerate() {
                for (at, k) in names.clone().enumerate() {
                    self.weights[k][i] += sums[at];
                    self.shares[k][i] += sums[names.len() + at];
                }
            }
        }
    }
}
