//! Gaussians at a single time, taken from a scene, and scenes made of such Gaussians.

use super::{Chapters, Provenance, Scene};
use crate::{
    camera::Camera,
    deform::{Deformation, GATE_SLOPE, deform},
    gaussian::Gaussians,
    grid::Grid,
    meaning::WordFacts,
    num::finite_percentile,
};
use glam::{Affine3A, Vec3};

/// Size and horizontal field of view of the picture of a scene that comes without a camera.
const PICTURE: (u32, u32) = (960, 720);
const FIELD_OF_VIEW_DEGREES: f32 = 50.0;
/// Share of the Gaussians, in percent, that such a camera has in view.
const IN_VIEW: f64 = 98.0;

impl Scene {
    /// Returns the Gaussians `chosen` as they are at `time`, without features.
    pub fn still(&self, time: f32, chosen: &[usize]) -> Gaussians {
        let (rest, row) = (&self.gaussians, self.gaussians.sh_bands() * 3);
        let now = deform(rest, &self.deformation, time, false);
        let pick = |i: &usize| rest.sh_rest[i * row..(i + 1) * row].to_vec();
        Gaussians {
            means: chosen.iter().map(|&i| now.means[i]).collect(),
            rotations: chosen.iter().map(|&i| now.rotations[i]).collect(),
            log_scales: chosen.iter().map(|&i| now.scales[i].map(f32::ln)).collect(),
            opacity_logits: chosen.iter().map(|&i| rest.opacity_logits[i]).collect(),
            colours: chosen.iter().map(|&i| now.colours[i]).collect(),
            sh_rest: chosen.iter().flat_map(pick).collect(),
            sh_degree: rest.sh_degree,
            ..Gaussians::default()
        }
    }

    /// Returns all Gaussians as they are at `time`, without features.
    pub fn all_still(&self, time: f32) -> Gaussians {
        self.still(time, &Vec::from_iter(0..self.gaussians.len()))
    }

    /// Creates a scene of Gaussians that do not move, seen by `camera`.
    pub fn of_still(gaussians: Gaussians, camera: Camera) -> Self {
        let at_rest = Deformation::at_rest(gaussians.len(), gaussians.latent_dim, 1, 1.0, GATE_SLOPE);
        Self::seen_by(camera, gaussians, at_rest)
    }

    /// Creates a scene of one frame, seen by `camera`, without features, text encoder or origin.
    pub fn seen_by(camera: Camera, gaussians: Gaussians, deformation: Deformation) -> Self {
        Self {
            gaussians: gaussians.into(),
            deformation: deformation.into(),
            chapters: Chapters::default(),
            cameras: vec![camera],
            times: Vec::new(),
            field_of_view: Grid::filled(camera.width as usize, camera.height as usize, true),
            codec: None,
            classes: Vec::new(),
            encoder: None,
            words: WordFacts::default(),
            provenance: Provenance::default(),
        }
    }
}

/// Returns a camera in front of the Gaussians (y points down, z away from it) that has most of them in view.
pub(super) fn camera_before(means: &[[f32; 3]]) -> Camera {
    let mut camera = Camera::with_field_of_view(PICTURE.0, PICTURE.1, FIELD_OF_VIEW_DEGREES);
    let end = |axis: usize, percent| finite_percentile(means.iter().map(|m| m[axis]), percent).unwrap_or(0.0);
    let middle = Vec3::from([0, 1, 2].map(|axis| 0.5 * (end(axis, 100.0 - IN_VIEW) + end(axis, IN_VIEW))));
    let radius =
        finite_percentile(means.iter().map(|m| Vec3::from(*m).distance(middle)), IN_VIEW).unwrap_or(1.0);
    // The angle of a ball, so that it fits the shorter side.
    let half_angle = (0.5 * camera.height as f32 / camera.fy).atan();
    let distance = radius.max(1e-3) / half_angle.sin();
    camera.camera_from_world = Affine3A::from_translation(Vec3::new(0.0, 0.0, distance) - middle);
    camera
}

/// Returns a camera at the origin looking along +z that has most of the Gaussians in front of it in view:
/// that of the first frame of a recording whose world has this camera's axes.
pub(super) fn camera_at_origin(means: &[[f32; 3]]) -> Camera {
    let camera = Camera::with_field_of_view(PICTURE.0, PICTURE.1, FIELD_OF_VIEW_DEGREES);
    let aspect = camera.width as f32 / camera.height as f32;
    let slopes =
        means.iter().filter(|m| m[2] > 0.0).map(|[x, y, z]| (x / z).abs().max(aspect * (y / z).abs()));
    match finite_percentile(slopes, IN_VIEW) {
        Some(slope) if slope > 1e-3 => {
            let fov = 2.0 * slope.min(10.0).atan().to_degrees();
            Camera::with_field_of_view(PICTURE.0, PICTURE.1, fov)
        }
        _ => camera_before(means),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::stress;

    #[test]
    fn a_still_scene_looks_as_the_moving_one_does_at_that_time() {
        let scene = stress::ordinary(60);
        let still = Scene::of_still(scene.all_still(0.4), scene.cameras[0]);
        let (now, then) = [(&scene, 0.4), (&still, 0.9)]
            .map(|(s, t)| deform(&s.gaussians, &s.deformation, t, false))
            .into();
        let close = |a: &[f32], b: &[f32]| a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-5);
        assert!(close(now.means.as_flattened(), then.means.as_flattened()));
        assert!(close(now.rotations.as_flattened(), then.rotations.as_flattened()));
        assert!(close(now.scales.as_flattened(), then.scales.as_flattened()));
        assert!(close(now.colours.as_flattened(), then.colours.as_flattened()));
        assert_eq!(now.opacities, then.opacities);
    }

    #[test]
    fn a_camera_that_is_made_up_has_the_gaussians_in_view() {
        let means = stress::ordinary(200).gaussians.means.clone();
        for camera in [camera_before(&means), camera_at_origin(&means)] {
            let is_in_view = |m: &&[f32; 3]| {
                camera.project(Vec3::from(**m)).is_some_and(|(u, v, _)| {
                    (0.0..camera.width as f32).contains(&u) && (0.0..camera.height as f32).contains(&v)
                })
            };
            let seen = means.iter().filter(is_in_view).count();
            assert!(seen >= 180, "{seen} of 200");
        }
        assert!(camera_before(&[]).camera_from_world.is_finite());
        assert!(camera_at_origin(&[[0.0, 0.0, -1.0]]).camera_from_world.is_finite());
    }
}
