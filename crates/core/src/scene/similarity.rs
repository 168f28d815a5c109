//! A change of the world's axes, origin and unit.

use crate::{
    camera::Camera,
    deform::{Deformation, MEAN_CHANNEL, ROTATION_CHANNEL},
    gaussian::Gaussians,
};
use glam::{Affine3A, Mat3A, Mat4, Quat, Vec3, Vec3A, Vec4};

/// Moves points of the world: p comes to lie at scale · rotation p + shift. Pictures of a scene stay as they
/// are if Gaussians, motion and cameras are moved alike; depth is `scale` times as large.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Similarity {
    /// Length in the new unit of what has length 1, above 0.
    pub scale: f32,
    /// Rotation of the axes, a unit quaternion.
    pub rotation: Quat,
    /// New place of the old origin.
    pub shift: Vec3,
}

impl Similarity {
    /// Leaves everything where it is.
    pub const IDENTITY: Self = Self { scale: 1.0, rotation: Quat::IDENTITY, shift: Vec3::ZERO };

    /// Returns the new place of a point.
    pub fn moved_point(&self, point: Vec3) -> Vec3 {
        self.scale * (self.rotation * point) + self.shift
    }

    /// Returns a camera that sees the moved world as `camera` sees the world.
    pub fn moved_camera(&self, camera: &Camera) -> Camera {
        let pose = camera.camera_from_world;
        let matrix3 = pose.matrix3 * Mat3A::from_quat(self.rotation.inverse());
        let translation = self.scale * pose.translation - matrix3 * Vec3A::from(self.shift);
        Camera { camera_from_world: Affine3A { matrix3, translation }, ..*camera }
    }

    /// Moves Gaussians at rest, whose spherical harmonics must be of degree 1 at most.
    pub(super) fn move_gaussians(&self, gaussians: &mut Gaussians) {
        let turn = self.turn();
        gaussians.means.iter_mut().for_each(|mean| *mean = self.moved_point((*mean).into()).into());
        gaussians.rotations.iter_mut().for_each(|q| *q = (turn * Vec4::from(*q)).into());
        gaussians.log_scales.as_flattened_mut().iter_mut().for_each(|s| *s += self.scale.ln());
        if gaussians.sh_degree == 1 {
            // The three bands are −y, z and −x of the direction, each in red, green and blue.
            for bands in gaussians.sh_rest.chunks_exact_mut(9) {
                for c in 0..3 {
                    let turned = self.rotation * Vec3::new(-bands[6 + c], -bands[c], bands[3 + c]);
                    (bands[c], bands[3 + c], bands[6 + c]) = (-turned.y, turned.z, -turned.x);
                }
            }
        }
    }

    /// Moves the motion of Gaussians, whose channels must share their basis functions.
    pub(super) fn move_deformation(&self, deformation: &mut Deformation) {
        let turn = self.turn();
        for row in deformation.weights.chunks_exact_mut(deformation.stride) {
            let (mean, rotation) = (MEAN_CHANNEL..MEAN_CHANNEL + 3, ROTATION_CHANNEL..ROTATION_CHANNEL + 4);
            let way = self.scale * (self.rotation * Vec3::from_slice(&row[mean.clone()]));
            row[mean].copy_from_slice(&way.to_array());
            let turned = turn * Vec4::from_slice(&row[rotation.clone()]);
            row[rotation].copy_from_slice(&turned.to_array());
        }
    }

    /// Product with a quaternion (w, x, y, z), of any length, from the left.
    fn turn(&self) -> Mat4 {
        let [x, y, z, w] = self.rotation.to_array();
        Mat4::from_cols_array(&[w, x, y, z, -x, w, z, -y, -y, -z, w, x, -z, y, -x, w])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn turning_is_the_product_of_quaternions() {
        let [a, b] = [[0.3, -0.4, 1.2], [-0.9, 0.2, 0.1]].map(|v| Quat::from_scaled_axis(v.into()));
        let by = Similarity { rotation: a, ..Similarity::IDENTITY };
        let expected = a * b;
        let turned = by.turn() * Vec4::new(b.w, b.x, b.y, b.z);
        assert!(turned.distance(Vec4::new(expected.w, expected.x, expected.y, expected.z)) < 1e-6);
    }

    #[test]
    fn a_moved_camera_sees_a_moved_point_where_it_was() {
        let pose = Affine3A::from_rotation_translation(Quat::from_rotation_y(0.4), Vec3::new(0.1, -0.2, 3.0));
        let camera = Camera { camera_from_world: pose, ..Camera::with_field_of_view(320, 240, 60.0) };
        let by = Similarity {
            scale: 2.5,
            rotation: Quat::from_scaled_axis(Vec3::new(0.3, 1.0, -0.5)),
            shift: Vec3::new(4.0, -1.0, 2.0),
        };
        let point = Vec3::new(0.5, 0.3, 2.0);
        let (u, v, z) = camera.project(point).unwrap();
        let (moved_u, moved_v, moved_z) = by.moved_camera(&camera).project(by.moved_point(point)).unwrap();
        assert!((u - moved_u).abs() < 1e-2 && (v - moved_v).abs() < 1e-2);
        assert!((2.5 * z - moved_z).abs() < 1e-4);
    }
}
