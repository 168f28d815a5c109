//! Points that were lost, looked for again. A point leaves the view, or comes to look too different to be
//! followed; what is seen of it later is another point, whose depth is told anew, so that the unit of a path
//! drifts. Once a path is known it tells where every point must be, and how the surface around it looks from
//! there.

use super::{
    adjust::{Landmark, Observation},
    build::Builder,
    judge::is_explained,
    lens::Lens,
    patch::{Patch, View, is_inside},
    tracks::{LEAST_SLOPE, VERY_ALIKE},
};
use glam::{DMat2, DMat3, DVec2, DVec3, Mat2};
use rayon::prelude::*;
use std::ops::Range;

/// Most frames of a path that views are kept of; longer ones are made only where chapters are not wanted.
pub(super) const MOST_VIEWS: usize = 256;
/// Ratios of the depths of a point in two frames, and angle between its two views in radians, at which it
/// still looks alike.
const DEPTH_RATIOS: Range<f64> = 0.6..1.6;
const LARGEST_ANGLE: f64 = 0.6;
/// Smallest depth of a point that is looked for, in units of the typical depth.
const NEAREST: f64 = 0.05;

/// Looks for the points that a path explains in frames that do not see them, and adjusts the path to what is
/// found. `views` are its frames at half the size of those that `lens` shows; without them nothing is found.
pub(super) fn find(builder: &mut Builder, lens: &Lens, views: &[View]) {
    if views.is_empty() {
        return;
    }
    let search = Search { path: builder, lens: lens.halved(), views };
    let again = |mark: &Landmark| match is_explained(mark, search.path, lens) {
        true => search.observations(mark),
        false => Vec::new(),
    };
    let found = search.path.landmarks.par_iter().map(again).collect();
    builder.add(found);
}

/// A path, and the frames that points are looked for in.
struct Search<'a> {
    path: &'a Builder,
    lens: Lens,
    views: &'a [View],
}

impl Search<'_> {
    /// Returns where a point is found again, before it was first seen and after it was last seen.
    fn observations(&self, mark: &Landmark) -> Vec<Observation> {
        let ends = mark.observations.first().zip(mark.observations.last());
        let Some((first, last)) = ends else { return Vec::new() };
        let before = (0..first.frame).filter_map(|frame| self.found(mark, first, frame));
        let after = (last.frame + 1..self.views.len()).filter_map(|frame| self.found(mark, last, frame));
        before.chain(after).collect()
    }

    /// Looks for a point in a frame by what is around it where it is known.
    fn found(&self, mark: &Landmark, known: &Observation, frame: usize) -> Option<Observation> {
        let poses = [known.frame, frame].map(|frame| self.path.poses[frame]);
        let position = mark.position?;
        let [seen, wanted] = poses.map(|pose| pose.transform_point3(position));
        let towards = poses.map(|pose| pose.inverse().translation - position);
        let looks_alike = seen.z.min(wanted.z) > NEAREST
            && DEPTH_RATIOS.contains(&(wanted.z / seen.z))
            && towards[0].angle_between(towards[1]) < LARGEST_ANGLE;
        let at = wanted.truncate() / wanted.z;
        let (view, there) = (&self.views[frame], self.lens.position(at));
        if !looks_alike || !is_inside(view, there) {
            return None;
        }
        let turn = poses[1].matrix3 * poses[0].matrix3.transpose();
        let warp = warp(&turn, seen.z / wanted.z, at);
        let patch = Patch::warped(&self.views[known.frame], self.lens.position(known.at), warp)?;
        if patch.strength < LEAST_SLOPE {
            return None;
        }
        let (here, likeness) = patch.found_around(&view.luma, there)?;
        let is_found = likeness >= VERY_ALIKE && is_inside(view, here);
        is_found.then(|| self.lens.observation(frame, here))
    }
}

/// Returns how offsets in the second of two pictures lead to those in the first, around a point of a surface
/// that faces the first camera. `turn` leads from the axes of the first camera to those of the second,
/// `depths` is the ratio of the first depth to the second, and `at` the point on the second camera's plane at
/// depth 1.
fn warp(turn: &DMat3, depths: f64, at: DVec2) -> Mat2 {
    let moved = |axis: DVec3| (axis.truncate() - at * axis.z) * depths;
    DMat2::from_cols(moved(turn.x_axis), moved(turn.y_axis)).inverse().as_mat2()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{camera::Camera, grid::Grid};
    use glam::{DAffine3, DQuat};

    /// Level of a bumpy plane at depth 1.
    fn level(at: DVec2) -> f32 {
        let wave = |x: f64, y: f64| (x * at.x + y * at.y).sin();
        (120.0
            + 40.0 * wave(31.0, 9.0) * wave(-7.0, 23.0)
            + 35.0 * wave(13.0, -41.0)
            + 20.0 * wave(57.0, 33.0)) as f32
    }

    /// Point of that plane on the ray through a point of the plane at depth 1 of a camera.
    fn on_plane(pose: &DAffine3, at: DVec2) -> DVec3 {
        let world_from_camera = pose.inverse();
        let (from, along) =
            (world_from_camera.translation, world_from_camera.transform_vector3(at.extend(1.0)));
        from + along * ((1.0 - from.z) / along.z)
    }

    fn view(lens: &Lens, pose: &DAffine3) -> View {
        let (width, height) = (lens.camera.width as usize, lens.camera.height as usize);
        let level = |k: usize| {
            let seen = lens.observation(0, [k % width, k / width].map(|v| v as f32)).at;
            level(on_plane(pose, seen).truncate())
        };
        View {
            luma: Grid::from_vec(width, height, (0..width * height).map(level).collect()),
            mask: Grid::filled(width, height, true),
        }
    }

    /// A camera beside, rolled, turned, and closer by `share`.
    fn elsewhere(share: f64) -> DAffine3 {
        let turn = DQuat::from_rotation_z(0.35) * DQuat::from_rotation_y(0.1);
        DAffine3::from_rotation_translation(turn, DVec3::new(0.03, -0.02, -share))
    }

    fn projected(pose: &DAffine3, position: DVec3) -> DVec2 {
        let p = pose.transform_point3(position);
        p.truncate() / p.z
    }

    #[test]
    fn surroundings_are_warped_as_the_other_camera_sees_them() {
        let (from, to) = (DAffine3::IDENTITY, elsewhere(0.2));
        let known = DVec2::new(0.1, -0.2);
        let position = on_plane(&from, known);
        let at = projected(&to, position);
        let warp = warp(&to.matrix3, 1.0 / to.transform_point3(position).z, at);
        for offset in [DVec2::X, DVec2::Y, DVec2::new(-0.6, 0.8)].map(|v| 1e-4 * v) {
            let there = projected(&to, on_plane(&from, known + offset)) - at;
            assert!((warp * there.as_vec2() - offset.as_vec2()).length() < 2e-3 * 1e-4, "{offset}");
        }
    }

    #[test]
    fn a_point_is_found_again_from_elsewhere_and_mends_the_path() {
        let lens = Lens { camera: Camera::with_field_of_view(160, 120, 60.0), shrink: 1.0 };
        let whole = Lens { shrink: 0.5, ..lens };
        let beside = |x: f64| DAffine3::from_translation(DVec3::new(x, 0.0, 0.0));
        let truth = [DAffine3::IDENTITY, beside(0.03), beside(0.06), elsewhere(0.25), elsewhere(0.6)];
        let views: Vec<View> = truth.iter().map(|pose| view(&lens, pose)).collect();
        let mark = |k: usize| {
            let position = on_plane(&truth[0], lens.observation(0, [20, 14].map(|v| v as f32)).at)
                + DVec3::new(0.045 * (k % 18) as f64, 0.045 * (k / 18) as f64, 0.0);
            let seen = |frame| Observation { frame, at: projected(&truth[frame], position), depth: None };
            Landmark {
                position: Some(position),
                observations: (0..3).map(seen).collect(),
                expected_depth: 1.0,
            }
        };
        let mut builder = Builder::new(truth.len(), (0..180).map(mark).collect(), lens.focal_px());
        builder.poses = truth.to_vec();
        // The path is off by three pixels where nothing told.
        let off = DAffine3::from_quat(DQuat::from_rotation_y(3.0 / lens.focal_px()));
        builder.poses[3] = off * truth[3];
        find(&mut builder, &whole, &views);
        let again = |frame: usize| {
            let found = builder.landmarks.iter().filter_map(|mark| {
                let seen = mark.observations.iter().find(|seen| seen.frame == frame)?;
                Some((seen.at - projected(&truth[frame], mark.position?)).length() * lens.focal_px())
            });
            found.collect::<Vec<f64>>()
        };
        let near = again(3).iter().filter(|error| **error < 0.5).count();
        assert!(near > 60 && near as f64 > 0.9 * again(3).len() as f64, "{near} of {}", again(3).len());
        assert!(again(4).is_empty(), "it looks too different from there");
        let left = builder.poses[3] * truth[3].inverse();
        let px = DQuat::from_mat3(&left.matrix3).to_scaled_axis().length() * lens.focal_px();
        assert!(px < 0.3 && left.translation.length() < 0.01, "{px} px, {}", left.translation);
    }

    #[test]
    fn without_views_nothing_is_found() {
        let lens = Lens { camera: Camera::with_field_of_view(160, 120, 60.0), shrink: 1.0 };
        let seen = |frame| Observation { frame, at: DVec2::ZERO, depth: None };
        let mark = Landmark {
            position: Some(DVec3::Z),
            observations: (1..4).map(seen).collect(),
            expected_depth: 1.0,
        };
        let mut builder = Builder::new(5, vec![mark], lens.focal_px());
        find(&mut builder, &lens, &[]);
        assert_eq!(builder.landmarks[0].observations.len(), 3);
    }
}
