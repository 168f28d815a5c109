//! Views turned a little around what the endoscope saw.

use glam::{Affine3A, Vec3};
use surgtpgs_core::camera::Camera;

/// Rotation of the view away from the endoscope's, radians; (0, 0) is the endoscope's own view.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(default)]
pub(crate) struct Orbit {
    /// Rotation to the side; positive moves the eye to the right.
    pub(crate) yaw: f32,
    /// Rotation up and down; positive moves the eye down.
    pub(crate) pitch: f32,
    /// Point to turn around, in the endoscope's axes and scene units; `None` is the middle of the picture.
    pub(crate) pivot: Option<[f32; 3]>,
}

impl Orbit {
    /// Returns `true` if this is the endoscope's own view.
    pub(crate) fn is_home(&self) -> bool {
        self.yaw == 0.0 && self.pitch == 0.0
    }

    /// Turns the view by a drag of the mouse, and keeps it within `max_degrees` of the endoscope's view.
    pub(crate) fn dragged(self, delta_points: [f32; 2], max_degrees: f32) -> Self {
        const DEGREES_PER_POINT: f32 = 0.12;
        let by = |v: f32| -v * DEGREES_PER_POINT.to_radians();
        let turned =
            Self { yaw: self.yaw + by(delta_points[0]), pitch: self.pitch + by(delta_points[1]), ..self };
        let angle = turned.angle();
        let share = (max_degrees.to_radians() / angle.max(f32::MIN_POSITIVE)).min(1.0);
        Self { yaw: turned.yaw * share, pitch: turned.pitch * share, ..self }
    }

    /// Limits the view to `max_degrees`, because files may hold any values.
    pub(crate) fn mended(self, max_degrees: f32) -> Self {
        let pivot = self.pivot.unwrap_or_default();
        let is_possible =
            self.yaw.is_finite() && self.pitch.is_finite() && pivot.iter().all(|c| c.is_finite());
        if is_possible { self.dragged([0.0; 2], max_degrees) } else { Self::default() }
    }

    /// Returns the total rotation, radians.
    pub(crate) fn angle(&self) -> f32 {
        self.yaw.hypot(self.pitch)
    }

    /// Moves a camera around the pivot. Unless a pivot was chosen, it is the point that the camera looks at,
    /// at distance `pivot_depth` (scene units).
    pub(crate) fn apply(&self, camera: &Camera, pivot_depth: f32) -> Camera {
        let pivot = self.pivot.map_or(Vec3::new(0.0, 0.0, pivot_depth), Vec3::from);
        let pivot = Affine3A::from_translation(pivot);
        let turn = Affine3A::from_rotation_x(-self.pitch) * Affine3A::from_rotation_y(self.yaw);
        let camera_from_world = pivot * turn * pivot.inverse() * camera.camera_from_world;
        Camera { camera_from_world, ..*camera }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_pivot_stays_where_it_is_and_the_distance_is_kept() {
        let camera = Camera::with_field_of_view(320, 240, 60.0);
        let turned = Orbit { yaw: 0.2, pitch: -0.1, pivot: None }.apply(&camera, 50.0);
        let pivot = Vec3::new(0.0, 0.0, 50.0);
        let (u, v, z) = turned.project(pivot).unwrap();
        assert!((u - 160.0).abs() < 1e-3 && (v - 120.0).abs() < 1e-3 && (z - 50.0).abs() < 1e-3);
        assert!((turned.position_in_world().distance(pivot) - 50.0).abs() < 1e-3);
    }

    #[test]
    fn positive_yaw_moves_the_eye_right_and_positive_pitch_moves_it_down() {
        let camera = Camera::with_field_of_view(320, 240, 60.0);
        assert!(Orbit { yaw: 0.2, ..Orbit::default() }.apply(&camera, 50.0).position_in_world().x > 1.0);
        assert!(Orbit { pitch: 0.2, ..Orbit::default() }.apply(&camera, 50.0).position_in_world().y > 1.0);
    }

    #[test]
    fn a_chosen_pivot_stays_where_it_is() {
        let camera = Camera::with_field_of_view(320, 240, 60.0);
        let pivot = Vec3::new(10.0, -5.0, 40.0);
        let turned = Orbit { yaw: 0.2, pitch: -0.1, pivot: Some(pivot.into()) }.apply(&camera, 50.0);
        let (before, after) = (camera.project(pivot).unwrap(), turned.project(pivot).unwrap());
        assert!((before.0 - after.0).abs() < 1e-3 && (before.1 - after.1).abs() < 1e-3);
    }

    #[test]
    fn home_is_the_recorded_camera_exactly() {
        let mut camera = Camera::with_field_of_view(320, 240, 60.0);
        camera.camera_from_world = Affine3A::from_translation(Vec3::new(1.0, 2.0, 3.0));
        assert_eq!(Orbit::default().apply(&camera, 50.0), camera);
    }

    #[test]
    fn no_drag_leads_beyond_the_limit() {
        use surgtpgs_core::camera::MAX_STILL_DEGREES;
        let mut orbit = Orbit::default();
        for _ in 0..1000 {
            orbit = orbit.dragged([30.0, -50.0], MAX_STILL_DEGREES);
        }
        assert!(orbit.angle().to_degrees() <= MAX_STILL_DEGREES + 1e-3);
        assert!(!orbit.is_home());
    }
}
