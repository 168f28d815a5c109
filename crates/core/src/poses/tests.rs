//! Paths of generated recordings, whose true poses are known.

use super::{Timeline, Verdict, adjust, estimate};
use crate::{
    demo::{DemoSettings, write},
    progress::unobserved,
    sequence::Sequence,
};
use glam::{DAffine3, DQuat, DVec3, Vec3};

const FRAMES: usize = 24;

/// Writes a rigid demo, and estimates its path from pictures alone; frame 7 is not read.
fn estimated(moving_camera: bool) -> (Sequence, super::ScopePath) {
    let folder = tempfile::tempdir().unwrap();
    let settings = DemoSettings {
        width: 320,
        height: 240,
        frames: FRAMES,
        moving_camera,
        rigid: true,
        ..DemoSettings::default()
    };
    write(&settings, folder.path(), &mut unobserved).unwrap();
    let truth = Sequence::open(folder.path()).unwrap();
    let frames: Vec<usize> = (0..FRAMES).filter(|i| *i != 7).collect();
    let times: Vec<f32> = (0..FRAMES).map(|i| i as f32 / FRAMES as f32).collect();
    let timeline = Timeline { frames: &frames, times: &times };
    let path = estimate(&truth, timeline, 100.0, &mut unobserved).unwrap();
    (truth, path)
}

#[test]
fn a_moving_scope_is_found_between_the_frames_that_are_read_too() {
    let (truth, path) = estimated(true);
    assert_eq!(path.verdict, Verdict::Moves { fov_x_degrees: None }, "the lens is given");
    assert!(path.moving_share > 0.9 && path.points.len() > 100, "{}", path.moving_share);
    // The demo's first camera is the world's axes too, but its scale is not known.
    let places: Vec<Vec3> = path.poses.iter().map(|pose| pose.inverse().translation.into()).collect();
    let true_places: Vec<Vec3> = (0..FRAMES).map(|i| truth.camera(i).position_in_world()).collect();
    let scale = places.iter().zip(&true_places).map(|(a, b)| a.dot(*b)).sum::<f32>()
        / places.iter().map(|a| a.length_squared()).sum::<f32>();
    let length: f32 = true_places.windows(2).map(|pair| pair[0].distance(pair[1])).sum();
    for (i, (found, true_place)) in places.iter().zip(&true_places).enumerate() {
        let error = (*found * scale).distance(*true_place);
        assert!(error < 0.05 * length, "frame {i} is {error} mm from its place on a path of {length} mm");
    }
}

#[test]
fn a_lens_that_is_not_known_is_found_with_the_path() {
    let folder = tempfile::tempdir().unwrap();
    // A wide picture of the same round field: its field of view is 75°, and 60° is assumed.
    let settings = DemoSettings {
        width: 320,
        height: 180,
        frames: FRAMES,
        moving_camera: true,
        rigid: true,
        ..DemoSettings::default()
    };
    write(&settings, folder.path(), &mut unobserved).unwrap();
    let truth = Sequence::open(folder.path()).unwrap().camera(0);
    let pictures = Sequence::open(&folder.path().join("images")).unwrap();
    let frames: Vec<usize> = (0..FRAMES).collect();
    let times: Vec<f32> = frames.iter().map(|i| *i as f32 / FRAMES as f32).collect();
    let timeline = Timeline { frames: &frames, times: &times };
    let path = estimate(&pictures, timeline, 100.0, &mut unobserved).unwrap();
    let Verdict::Moves { fov_x_degrees: Some(fov) } = path.verdict else { panic!("{:?}", path.verdict) };
    let [true_fov, _] = truth.field_of_view_degrees();
    assert!((fov - true_fov).abs() < 4.0, "{fov}° instead of {true_fov}°");
    let focal = path.zoom.unwrap() * pictures.camera(0).fx;
    assert!((focal / truth.fx - 1.0).abs() < 0.07, "{focal} px instead of {} px", truth.fx);
}

#[test]
fn a_scope_that_stands_still_stays_where_it_is() {
    let (_, path) = estimated(false);
    assert_eq!(path.verdict, Verdict::Still);
    assert!(path.poses.is_empty() && path.still_share > 0.9, "{}", path.still_share);
}

#[test]
fn a_pose_is_found_from_points_of_which_a_third_move() {
    let truth = DAffine3::from_rotation_translation(
        DQuat::from_scaled_axis(DVec3::new(0.02, -0.05, 0.03)),
        DVec3::new(0.06, -0.02, 0.04),
    );
    let marks: Vec<adjust::Landmark> = (0..60)
        .map(|k| {
            let place = DVec3::new(
                f64::from(k % 8) / 8.0 - 0.4,
                f64::from(k / 8) / 8.0 - 0.4,
                1.0 + f64::from(k % 5) / 9.0,
            );
            let seen = truth.transform_point3(place) + DVec3::X * if k % 3 == 0 { 0.1 } else { 0.0 };
            let sight = adjust::Sight { frame: 0, at: seen.truncate() / seen.z };
            adjust::Landmark { place: Some(place), sights: vec![sight] }
        })
        .collect();
    let mut found = DAffine3::IDENTITY;
    for cauchy_px in [6.0, 1.0, 0.1] {
        let compare = adjust::Comparison { focal_px: 300.0, cauchy_px };
        found = adjust::pose_of(0, found, &marks, compare, 40);
    }
    assert!(found.abs_diff_eq(truth, 1e-3), "{found:?}");
}
