//! Measures of a found object in space: position, extent and visible area.

use crate::{
    camera::Camera,
    deform::Deformed,
    grid::{Grid, Mask},
};
use glam::{DMat3, DVec3};

/// A set of Gaussians at one time, treated as one body.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Body {
    /// Mean position, scene units.
    pub centroid: [f64; 3],
    /// Root mean square distance from the centroid, scene units.
    pub spread: f64,
    /// Volume, scene units³, of the uniform ellipsoid with the same covariance. It is a proxy, since
    /// Gaussians lie on visible surfaces only.
    pub volume: f64,
}

impl Body {
    /// Measures the Gaussians `chosen`. Each weighs its opacity times the product of its two larger
    /// scales. `None` if there are no Gaussians or nothing has weight.
    pub fn of(deformed: &Deformed, chosen: &[usize]) -> Option<Self> {
        let place = |i: usize| DVec3::from(deformed.means[i].map(f64::from));
        let weight = |i: usize| {
            let [a, b, c] = deformed.scales[i].map(f64::from);
            f64::from(deformed.opacities[i]) * a * b * c / a.min(b).min(c)
        };
        let total: f64 = chosen.iter().map(|&i| weight(i)).sum();
        let middle = chosen.iter().map(|&i| weight(i) * place(i)).sum::<DVec3>() / total;
        let covariance = chosen.iter().fold(DMat3::ZERO, |sum, &i| {
            let d = place(i) - middle;
            sum + DMat3::from_cols(d * d.x, d * d.y, d * d.z) * (weight(i) / total)
        });
        let spread = (covariance.x_axis.x + covariance.y_axis.y + covariance.z_axis.z).sqrt();
        // A uniform ball of radius r has a variance of r² / 5 along each axis.
        let volume = 4.0 / 3.0 * std::f64::consts::PI * (125.0 * covariance.determinant().max(0.0)).sqrt();
        (total > 0.0 && middle.is_finite()).then(|| Self { centroid: middle.to_array(), spread, volume })
    }
}

/// Area of the found pixels at their depth, as if they faced the camera, in scene units². Pixels without
/// depth do not count. 0 if sizes differ.
pub fn seen_area(found: &Mask, depth: &Grid<f32>, camera: &Camera) -> f64 {
    if found.data.len() != depth.data.len() {
        return 0.0;
    }
    let squared = |z: &f32| if z.is_finite() { f64::from(*z).powi(2) } else { 0.0 };
    let squares = found.data.iter().zip(&depth.data).filter(|(f, _)| **f).map(|(_, z)| squared(z));
    // The sum of nothing is -0.
    let sum = squares.fold(0.0, |sum, z| sum + z);
    sum / (f64::from(camera.fx) * f64::from(camera.fy))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn deformed(means: Vec<[f32; 3]>) -> Deformed {
        let n = means.len();
        Deformed { means, scales: vec![[0.1, 0.2, 0.05]; n], opacities: vec![0.5; n], ..Deformed::default() }
    }

    #[test]
    fn a_ball_has_its_volume() {
        // All points of a lattice inside a ball of radius 2 around (1, 2, 3).
        let steps = || (-20..=20).map(|i| i as f32 * 0.1);
        let points: Vec<[f32; 3]> = steps()
            .flat_map(|x| steps().flat_map(move |y| steps().map(move |z| [x, y, z])))
            .filter(|[x, y, z]| x * x + y * y + z * z <= 4.0)
            .map(|[x, y, z]| [x + 1.0, y + 2.0, z + 3.0])
            .collect();
        let all: Vec<usize> = (0..points.len()).collect();
        let body = Body::of(&deformed(points), &all).unwrap();
        assert!(body.centroid.iter().zip([1.0, 2.0, 3.0]).all(|(a, b)| (a - b).abs() < 1e-3));
        let volume = 4.0 / 3.0 * std::f64::consts::PI * 8.0;
        assert!((body.volume / volume - 1.0).abs() < 0.02, "{}", body.volume);
        assert!((body.spread - (0.6_f64 * 4.0).sqrt()).abs() < 0.02);
    }

    #[test]
    fn what_weighs_more_draws_the_middle() {
        let mut two = deformed(vec![[0.0; 3], [4.0, 0.0, 0.0]]);
        two.opacities[1] = 0.25;
        two.scales[1] = [0.4, 0.2, 0.05];
        assert!((Body::of(&two, &[0, 1]).unwrap().centroid[0] - 8.0 / 3.0).abs() < 1e-5);
        assert_eq!(Body::of(&two, &[1]).unwrap().volume, 0.0);
        assert_eq!(Body::of(&two, &[]), None);
    }

    #[test]
    fn a_square_before_the_camera_has_its_area() {
        let camera = Camera::with_field_of_view(64, 48, 60.0);
        let found = Mask::from_vec(64, 48, (0..64 * 48).map(|i| i % 64 < 10 && i / 64 < 10).collect());
        let area = seen_area(&found, &Grid::filled(64, 48, 5.0), &camera);
        let side = 10.0 * 5.0 / f64::from(camera.fx);
        assert!((area - side * side).abs() < 1e-9);
        assert_eq!(seen_area(&found, &Grid::filled(64, 48, f32::NAN), &camera), 0.0);
        assert_eq!(seen_area(&found, &Grid::filled(2, 2, 1.0), &camera), 0.0);
        let nothing = seen_area(&Mask::filled(64, 48, false), &Grid::filled(64, 48, 5.0), &camera);
        assert!(nothing == 0.0 && nothing.is_sign_positive());
    }
}
