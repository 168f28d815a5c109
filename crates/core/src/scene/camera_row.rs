//! Cameras as rows of numbers in files.

use crate::camera::Camera;
use glam::{Affine3A, Mat3, Vec3};

/// Number of values of a camera in a file.
pub(super) const CAMERA_WIDTH: usize = 18;

/// Returns width, height, fx, fy, cx, cy and the rows of camera_from_world, 3×4.
pub(super) fn camera_row(camera: &Camera) -> Vec<f32> {
    let mut row = vec![camera.width as f32, camera.height as f32, camera.fx, camera.fy, camera.cx, camera.cy];
    let (m, t) = (camera.camera_from_world.matrix3, camera.camera_from_world.translation);
    for i in 0..3 {
        row.extend([m.x_axis[i], m.y_axis[i], m.z_axis[i], t[i]]);
    }
    row
}

/// Returns the camera of a row that [`camera_row`] made.
pub(super) fn read_camera(row: &[f32]) -> Camera {
    let at = |r: usize, c: usize| row[6 + 4 * r + c];
    let column = |c: usize| Vec3::new(at(0, c), at(1, c), at(2, c));
    Camera {
        width: row[0] as u32,
        height: row[1] as u32,
        fx: row[2],
        fy: row[3],
        cx: row[4],
        cy: row[5],
        camera_from_world: Affine3A::from_mat3_translation(
            Mat3::from_cols(column(0), column(1), column(2)),
            column(3),
        ),
    }
}
