//! Pinhole cameras: OpenCV axes (x right, y down, z forward), pixel centres at +0.5.

use crate::num::finite_percentile;
use glam::{Affine3A, Quat, Vec3};

/// Longest side of an image, in pixels.
pub const MAX_IMAGE_SIDE: usize = 16384;

/// Largest number of pixels of an image: that of eight 4K frames.
pub const MAX_IMAGE_PIXELS: usize = 1 << 26;

/// Returns an error if an image of this size is empty or too large; its text names the size and the limits.
pub fn check_image_size(width: usize, height: usize) -> Result<(), String> {
    let is_side = |n: usize| (1..=MAX_IMAGE_SIDE).contains(&n);
    if is_side(width) && is_side(height) && width * height <= MAX_IMAGE_PIXELS {
        return Ok(());
    }
    let millions = MAX_IMAGE_PIXELS / 1_000_000;
    Err(format!(
        "a picture of {width}×{height} is beyond {MAX_IMAGE_SIDE} pixels along a side, or {millions} million in all"
    ))
}

/// Largest rotation of a view away from the recorded one, in degrees, where the camera never moved. Beyond
/// it, surfaces would show that nobody ever saw.
pub const MAX_STILL_DEGREES: f32 = 15.0;

/// Largest rotation of a view away from the recorded one, in degrees, where the camera moved.
pub const MAX_MOVING_DEGREES: f32 = 40.0;

/// A pinhole camera of known size and pose.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Camera {
    /// Image columns, in pixels.
    pub width: u32,
    /// Image rows, in pixels.
    pub height: u32,
    /// Focal length along x, in pixels.
    pub fx: f32,
    /// Focal length along y, in pixels.
    pub fy: f32,
    /// Principal point x, in pixels; the image centre is `width / 2`.
    pub cx: f32,
    /// Principal point y, in pixels.
    pub cy: f32,
    /// Maps world points into the camera's axes (scene units).
    pub camera_from_world: Affine3A,
}

impl Camera {
    /// A camera at the origin looking along +z with the given horizontal field of view.
    pub fn with_field_of_view(width: u32, height: u32, fov_x_degrees: f32) -> Self {
        let focal = 0.5 * width as f32 / (0.5 * fov_x_degrees.to_radians()).tan();
        Self {
            width,
            height,
            fx: focal,
            fy: focal,
            cx: 0.5 * width as f32,
            cy: 0.5 * height as f32,
            camera_from_world: Affine3A::IDENTITY,
        }
    }

    /// Returns `true` if an image can have this size and lens, and the pose is made of finite numbers.
    pub fn is_usable(&self) -> bool {
        let lens = [self.fx, self.fy, self.cx, self.cy];
        check_image_size(self.width as usize, self.height as usize).is_ok()
            && (self.fx > 0.0 && self.fy > 0.0)
            && lens.iter().all(|v| v.is_finite())
            && self.camera_from_world.is_finite()
    }

    /// Returns the same view at another resolution (the pixel grid is scaled, the field of view kept).
    pub fn resized(&self, width: u32, height: u32) -> Self {
        let (sx, sy) = (width as f32 / self.width as f32, height as f32 / self.height as f32);
        Self {
            width,
            height,
            fx: self.fx * sx,
            fy: self.fy * sy,
            cx: self.cx * sx,
            cy: self.cy * sy,
            ..*self
        }
    }

    /// Returns the same view at half the resolution: each pixel covers 2×2 of the others. The last column or row
    /// of an odd number is left out.
    pub fn halved(&self) -> Self {
        Self {
            width: self.width / 2,
            height: self.height / 2,
            fx: 0.5 * self.fx,
            fy: 0.5 * self.fy,
            cx: 0.5 * self.cx,
            cy: 0.5 * self.cy,
            ..*self
        }
    }

    /// Returns the same view in pictures whose longer side has `longest` pixels at most.
    pub fn shrunk(&self, longest: u32) -> Self {
        let by = self.width.max(self.height).div_ceil(longest).max(1);
        self.resized((self.width / by).max(1), (self.height / by).max(1))
    }

    /// Returns the fields of view, horizontal and vertical, degrees.
    pub fn field_of_view_degrees(&self) -> [f32; 2] {
        [(self.width, self.fx), (self.height, self.fy)]
            .map(|(size, focal)| 2.0 * (0.5 * size as f32 / focal).atan().to_degrees())
    }

    /// Returns the camera with a focal length that is `zoom` times as large.
    pub fn zoomed(&self, zoom: f32) -> Self {
        Self { fx: self.fx * zoom, fy: self.fy * zoom, ..*self }
    }

    /// Returns the world point seen at continuous pixel position (u, v) at depth `z` (scene units). The
    /// centre of pixel (i, j) is (i + 0.5, j + 0.5).
    pub fn unproject(&self, u: f32, v: f32, z: f32) -> Vec3 {
        let in_camera = Vec3::new((u - self.cx) / self.fx * z, (v - self.cy) / self.fy * z, z);
        self.camera_from_world.inverse().transform_point3(in_camera)
    }

    /// Returns the continuous pixel position and depth of a world point; `None` at or behind
    /// the camera plane.
    pub fn project(&self, point_in_world: Vec3) -> Option<(f32, f32, f32)> {
        let p = self.camera_from_world.transform_point3(point_in_world);
        (p.z > 0.0).then(|| (self.fx * p.x / p.z + self.cx, self.fy * p.y / p.z + self.cy, p.z))
    }

    /// Returns the `q`-th percentile of the depths of those points that are before the camera; `None` if none
    /// is.
    pub(crate) fn depth_percentile(&self, points_in_world: &[[f32; 3]], q: f64) -> Option<f32> {
        let depth = |p: &[f32; 3]| self.camera_from_world.transform_point3(Vec3::from(*p)).z;
        finite_percentile(points_in_world.iter().map(depth).filter(|z| *z > 0.0), q)
    }

    /// Returns the position of the camera in the world.
    pub fn position_in_world(&self) -> Vec3 {
        self.camera_from_world.inverse().translation.into()
    }
}

/// A small motion of a camera in its own axes, or a gradient with respect to it. A point p in the camera
/// comes to lie at R(turn) p + shift.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Twist<T> {
    /// Turn about x, y and z, rad.
    pub turn: [T; 3],
    /// Shift along x, y and z, scene units.
    pub shift: [T; 3],
}

impl<T: Copy> Twist<T> {
    /// Turn, then shift.
    pub fn to_array(self) -> [T; 6] {
        let ([a, b, c], [x, y, z]) = (self.turn, self.shift);
        [a, b, c, x, y, z]
    }

    /// The twist of [`Twist::to_array`].
    pub fn of([a, b, c, x, y, z]: [T; 6]) -> Self {
        Self { turn: [a, b, c], shift: [x, y, z] }
    }
}

impl Twist<f32> {
    /// Returns `camera_from_world` of the camera that was moved.
    pub fn moved(&self, camera_from_world: Affine3A) -> Affine3A {
        let turn = Quat::from_scaled_axis(Vec3::from_array(self.turn));
        Affine3A::from_rotation_translation(turn, Vec3::from_array(self.shift)) * camera_from_world
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn images_have_a_largest_size() {
        for (width, height) in [(1, 1), (8192, 8192), (16384, 4096)] {
            assert_eq!(check_image_size(width, height), Ok(()));
        }
        for (width, height) in [(0, 5), (16385, 1), (8192, 8193), (65535, 65535), (usize::MAX, usize::MAX)] {
            let what = check_image_size(width, height).unwrap_err();
            assert!(what.contains(&format!("{width}×{height}")), "{what}");
        }
    }

    #[test]
    fn project_inverts_unproject_for_a_moved_camera() {
        let mut camera = Camera::with_field_of_view(640, 512, 60.0);
        camera.camera_from_world =
            Affine3A::from_rotation_y(0.3) * Affine3A::from_translation(Vec3::new(1.0, -2.0, 0.5));
        let (u, v, z) = camera.project(camera.unproject(12.5, 400.5, 7.0)).unwrap();
        assert!((u - 12.5).abs() < 1e-3 && (v - 400.5).abs() < 1e-3 && (z - 7.0).abs() < 1e-5);
        let behind = camera.unproject(320.0, 256.0, -1.0);
        assert!(camera.project(behind).is_none());
    }

    #[test]
    fn a_point_comes_to_half_its_place_at_half_the_size_even_of_an_odd_one() {
        for (width, height) in [(640, 480), (853, 479), (3, 2)] {
            let camera = Camera::with_field_of_view(width, height, 60.0);
            let half = camera.halved();
            assert_eq!((half.width, half.height), (width / 2, height / 2));
            let (u, v) = (width as f32 - 0.5, 0.75);
            let (found_u, found_v, _) = half.project(camera.unproject(u, v, 5.0)).unwrap();
            assert!((found_u - 0.5 * u).abs() < 1e-3 && (found_v - 0.5 * v).abs() < 1e-3, "{width}×{height}");
        }
    }
}
