//! Distances that Gaussians move.

use super::{Deformation, deform};
use crate::{camera::Camera, gaussian::Gaussians};
use glam::Vec3;

/// Largest distance of each Gaussian's centre from its place at the first of `times`, in pixels of
/// `camera`: the distance in the world times focal length by depth. 0 for Gaussians that are not in front
/// of the camera, and if there are no times.
pub fn travel_px(
    gaussians: &Gaussians,
    deformation: &Deformation,
    camera: &Camera,
    times: &[f32],
) -> Vec<f32> {
    let Some((&first, later)) = times.split_first() else { return vec![0.0; gaussians.len()] };
    let start = deform(gaussians, deformation, first, false).means;
    let px_per_unit: Vec<f32> = start
        .iter()
        .map(|mean| {
            camera.project(Vec3::from(*mean)).map_or(0.0, |(.., z)| 0.5 * (camera.fx + camera.fy) / z)
        })
        .collect();
    let mut travel = vec![0.0_f32; gaussians.len()];
    for &time in later {
        let means = deform(gaussians, deformation, time, false).means;
        for ((travel, scale), (from, to)) in travel.iter_mut().zip(&px_per_unit).zip(start.iter().zip(&means))
        {
            let way = Vec3::from(*from).distance(Vec3::from(*to)) * scale;
            // `max` ignores a distance that is not a number.
            *travel = travel.max(way);
        }
    }
    travel
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::deform::{GATE_SLOPE, MEAN_CHANNEL};

    #[test]
    fn only_what_moves_travels_and_by_its_pixels() {
        let gaussians = Gaussians {
            means: vec![[0.0, 0.0, 10.0]; 2],
            rotations: vec![[1.0, 0.0, 0.0, 0.0]; 2],
            log_scales: vec![[0.0; 3]; 2],
            opacity_logits: vec![0.0; 2],
            colours: vec![[0.0; 3]; 2],
            ..Default::default()
        };
        let mut deformation = Deformation::at_rest(2, 0, 5, 0.05, GATE_SLOPE);
        // The last basis moves the second Gaussian to the right.
        let stride = deformation.stride;
        deformation.weights[(4 * 2 + 1) * stride + MEAN_CHANNEL] = 2.0;
        let camera = Camera::with_field_of_view(100, 100, 90.0);
        let peak = deformation.centres[4];
        let travel = travel_px(&gaussians, &deformation, &camera, &[0.0, 0.5 * peak, peak]);
        // 2 units at depth 10 with a focal length of 50 px; the basis is 1 at its centre.
        assert!(travel[0] == 0.0 && (travel[1] - 10.0).abs() < 1e-3, "{travel:?}");
        assert_eq!(travel_px(&gaussians, &deformation, &camera, &[]), [0.0; 2]);
    }
}
