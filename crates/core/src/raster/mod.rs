//! From Gaussians at time t to images: project → bin → raster, with the gradients of all three.

pub mod backward;
pub mod bin;
pub mod forward;
mod images;
pub mod project;
pub mod reference;
mod renderer;
pub mod sh;
mod tile;

pub use crate::raster_limits::{
    DILATION, FRUSTUM_GUARD, MAX_ALPHA, MIN_ALPHA, MIN_DEPTH_ALPHA, MIN_EXTENT, MIN_TRANSMITTANCE, NEAR,
    TILE, jacobian_guard,
};
pub use images::{ALPHA_PLANE, DEPTH_PLANE, FEATURE_PLANE, Images};
pub use renderer::{CpuRenderer, FrameClock, FramePass, Renderer};
pub use tile::Packed;

use crate::{
    camera::Camera,
    deform::{Deformed, deform},
    gaussian::Gaussians,
    scene::Scene,
};

/// Runs project → bin → raster for Gaussians already at time t; renders features if `deformed` has them.
pub fn render_deformed(gaussians: &Gaussians, deformed: &Deformed, camera: &Camera) -> Images {
    let (width, height) = (camera.width as usize, camera.height as usize);
    let splats = project::project_all(gaussians, deformed, camera);
    let bins = bin::bin(&splats, width, height);
    let with_features = deformed.features.len() == gaussians.features.len();
    let latent_dim = if with_features { gaussians.latent_dim } else { 0 };
    forward::raster(&Packed::new(&splats, &deformed.features, latent_dim), &bins, width, height)
}

/// Renders a recorded frame of a scene without features, by the Gaussians that the scene holds.
pub fn render_frame(scene: &Scene, frame: usize) -> Images {
    let deformed = deform(&scene.gaussians, &scene.deformation, scene.time(frame), false);
    render_deformed(&scene.gaussians, &deformed, &scene.cameras[frame])
}

#[cfg(test)]
mod tests;
