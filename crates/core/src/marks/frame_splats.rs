//! Gaussians projected to the picture of a frame, and values of theirs blended there.

use crate::{
    camera::Camera,
    deform::deform,
    raster::{
        ALPHA_PLANE, DEPTH_PLANE, FEATURE_PLANE, Images, Packed,
        bin::{Bins, bin},
        forward::raster,
        project::{Splat, project_all},
    },
    scene::Scene,
};

/// Smallest alpha at which blended values are divided by it.
const MIN_ALPHA: f32 = 1e-3;

/// Splats of the Gaussians of a scene, at a time and from a camera.
pub(super) struct FrameSplats {
    camera: Camera,
    splats: Vec<Splat<f32>>,
    bins: Bins,
}

impl FrameSplats {
    /// Projects the Gaussians to a frame at half size, rounded down.
    pub(super) fn at_half(scene: &Scene, frame: usize) -> Self {
        Self::of(scene, scene.cameras[frame].halved(), scene.time(frame))
    }

    /// Projects the Gaussians to a view.
    pub(super) fn of(scene: &Scene, camera: Camera, time: f32) -> Self {
        let deformed = deform(&scene.gaussians, &scene.deformation, time, false);
        let splats = project_all(&scene.gaussians, &deformed, &camera);
        let bins = bin(&splats, camera.width as usize, camera.height as usize);
        Self { camera, splats, bins }
    }

    /// Returns the depth of every pixel; NaN where there are no Gaussians.
    pub(super) fn depth(&self) -> Vec<f32> {
        let images = self.blend(&[], 0).images;
        let depth = images.plane(DEPTH_PLANE).iter().zip(images.plane(ALPHA_PLANE));
        depth.map(|(d, a)| if *a > MIN_ALPHA { d / a } else { f32::NAN }).collect()
    }

    /// Blends values of Gaussians, [N][dim] with at most 16 of them, and divides by alpha: [dim][pixels].
    pub(super) fn blend(&self, values: &[f32], dim: usize) -> Blended {
        let (width, height) = (self.camera.width as usize, self.camera.height as usize);
        let packed = Packed::new(&self.splats, values, dim);
        let mut images = raster(&packed, &self.bins, width, height);
        let (base, values) = images.planes.split_at_mut(FEATURE_PLANE * width * height);
        let alpha = &base[ALPHA_PLANE * width * height..];
        for plane in values.chunks_exact_mut((width * height).max(1)) {
            plane.iter_mut().zip(alpha).for_each(|(v, a)| *v = if *a > MIN_ALPHA { *v / a } else { 0.0 });
        }
        Blended { images }
    }
}

/// Images whose feature planes were divided by alpha.
pub(super) struct Blended {
    pub(super) images: Images,
}

impl Blended {
    /// Returns the plane of value `k`.
    pub(super) fn value(&self, k: usize) -> &[f32] {
        self.images.plane(FEATURE_PLANE + k)
    }
}
