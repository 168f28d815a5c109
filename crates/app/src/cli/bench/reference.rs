//! Comparison of a small frame with the f64 twin.

use surgtpgs_core::{
    camera::Camera,
    deform::deform,
    raster::{
        Images, Packed,
        bin::bin,
        forward::raster,
        project::{Splat, project_all},
        reference::ReferenceInput,
    },
    scene::Scene,
};

/// Factor by which the image is reduced on each side for the comparison with the f64 twin.
const REDUCTION: u32 = 8;

/// A frame small enough for the f64 twin.
pub(super) struct Reduced {
    pub(super) splats: Vec<Splat<f32>>,
    features: Vec<f32>,
    latent_dim: usize,
    pub(super) packed: Packed,
    pub(super) images: Images,
}

pub(super) fn reduced(scene: &Scene, camera: &Camera, time: f32) -> Reduced {
    let camera = camera.resized((camera.width / REDUCTION).max(1), (camera.height / REDUCTION).max(1));
    let (width, height) = (camera.width as usize, camera.height as usize);
    let deformed = deform(&scene.gaussians, &scene.deformation, time, true);
    let splats = project_all(&scene.gaussians, &deformed, &camera);
    let latent_dim = scene.gaussians.latent_dim;
    let packed = Packed::new(&splats, &deformed.features, latent_dim);
    let images = raster(&packed, &bin(&splats, width, height), width, height);
    Reduced { splats, features: deformed.features, latent_dim, packed, images }
}

impl Reduced {
    /// Calls `ask` with the f64 twin of the same splats.
    pub(super) fn with_twin<T>(&self, ask: impl FnOnce(&ReferenceInput<'_, f64>) -> T) -> T {
        let wide: Vec<Splat<f64>> = self.splats.iter().map(Splat::widened).collect();
        let features: Vec<f64> = self.features.iter().map(|v| f64::from(*v)).collect();
        let Images { width, height, .. } = self.images;
        let (latent_dim, splats) = (self.latent_dim, &wide[..]);
        ask(&ReferenceInput { splats, features: &features, latent_dim, width, height })
    }

    /// Returns the largest difference of a colour, opacity or feature; depth is left out, since it
    /// has another scale.
    pub(super) fn image_error(&self) -> f64 {
        let pixels = self.images.width * self.images.height;
        let expected = self.with_twin(|twin| twin.forward());
        let differences = self.images.planes.iter().zip(&expected).enumerate();
        differences
            .filter(|(i, _)| !(3 * pixels..4 * pixels).contains(i))
            .map(|(_, (a, b))| (f64::from(*a) - b).abs())
            .fold(0.0, f64::max)
    }
}

/// Returns the largest error of a frame's images against f64.
pub(super) fn reference_error(scene: &Scene, camera: &Camera, time: f32) -> f64 {
    reduced(scene, camera, time).image_error()
}
