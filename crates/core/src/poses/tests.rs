//! Paths of generated recordings, whose true poses are known.

use super::{
    BLURRED, ScopePath, ScopeVerdict, Timeline, View, adjust,
    build::Builder,
    estimate, halvings,
    judge::depth_range,
    lens::{Lens, likely_zoom},
    pose_at, sharpness, triangulate_with_known_poses,
};
use crate::{
    Result,
    demo::{DemoSettings, write},
    grid::Grid,
    num::median,
    progress::unobserved,
    sequence::Sequence,
};
use glam::{Affine3A, DAffine3, DQuat, DVec3, Quat, Vec3};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

const FRAMES: usize = 24;

/// Writes a rigid demo of a size.
fn demo([width, height]: [usize; 2], moving_camera: bool) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let frames = FRAMES;
    let settings =
        DemoSettings { width, height, frames, moving_camera, rigid: true, ..DemoSettings::default() };
    write(&settings, folder.path(), &mut unobserved).unwrap();
    folder
}

/// Does `work` with the frames that may be read: all but frame 7.
fn on_frames<T>(work: impl FnOnce(Timeline<'_>) -> Result<T>) -> T {
    let frames: Vec<usize> = (0..FRAMES).filter(|i| *i != 7).collect();
    let times: Vec<f32> = (0..FRAMES).map(|i| i as f32 / FRAMES as f32).collect();
    work(Timeline { frames: &frames, times: &times }).unwrap()
}

fn estimated(sequence: &Sequence) -> ScopePath {
    on_frames(|timeline| estimate(sequence, timeline, 100.0, &mut unobserved))
}

#[test]
fn a_moving_scope_is_found_between_the_frames_that_are_read_too() {
    let folder = demo([320, 240], true);
    let truth = Sequence::open(folder.path()).unwrap();
    let images = folder.path().join("images");
    std::fs::write(images.join("sequence.toml"), "[camera]\nfov_x_degrees = 60\n").unwrap();
    let path = estimated(&Sequence::open(&images).unwrap());
    assert_eq!(
        path.verdict,
        ScopeVerdict::Moves { fov_x_degrees: None, period_frames: None, known: None },
        "the lens is given"
    );
    assert!(path.moving_share > 0.9 && path.points.len() > 100, "{}", path.moving_share);
    // The demo's first camera is the world's axes too.
    let positions = camera_positions(&path.poses);
    let true_positions: Vec<Vec3> = (0..FRAMES).map(|i| truth.camera(i).position_in_world()).collect();
    let scale = positions.iter().zip(&true_positions).map(|(a, b)| a.dot(*b)).sum::<f32>()
        / positions.iter().map(|a| a.length_squared()).sum::<f32>();
    let length: f32 = true_positions.windows(2).map(|pair| pair[0].distance(pair[1])).sum();
    for (i, (found, true_position)) in positions.iter().zip(&true_positions).enumerate() {
        let error = (*found * scale).distance(*true_position);
        assert!(error < 0.05 * length, "frame {i} is {error} mm from its position on a path of {length} mm");
    }
}

#[test]
fn a_damaged_frame_is_passed_over_and_the_longest_part_of_a_broken_path_is_kept() {
    let folder = demo([320, 240], true);
    let images = folder.path().join("images");
    std::fs::write(images.join("sequence.toml"), "[camera]\nfov_x_degrees = 60\n").unwrap();
    let pictures = std::fs::read_dir(&images).unwrap().map(|entry| entry.unwrap().path());
    let mut pictures: Vec<_> =
        pictures.filter(|path| path.extension().is_some_and(|ext| ext == "png")).collect();
    pictures.sort();
    let damage = |i: usize| {
        let noise = |x: u32, y: u32| image::Rgb([((x * 7919 + y * 104_729) % 251) as u8; 3]);
        image::RgbImage::from_fn(320, 240, noise).save(&pictures[i]).unwrap();
    };
    damage(12);
    let path = estimated(&Sequence::open(&images).unwrap());
    assert!(matches!(path.verdict, ScopeVerdict::Moves { known: None, .. }), "{:?}", path.verdict);
    assert_eq!(path.blurred, [12]);
    (19..FRAMES).for_each(damage);
    let path = estimated(&Sequence::open(&images).unwrap());
    let ScopeVerdict::Moves { known: Some([0, last]), .. } = path.verdict else {
        panic!("{:?}", path.verdict)
    };
    assert!((18..=19).contains(&last), "{last}");
    assert_eq!((path.poses.len(), path.poses[last]), (FRAMES, path.poses[23]), "it stands still after that");
    // Both halves are too short.
    (11..14).for_each(damage);
    let path = estimated(&Sequence::open(&images).unwrap());
    assert!(
        !matches!(path.verdict, ScopeVerdict::Moves { .. }) && path.poses.is_empty(),
        "{:?}",
        path.verdict
    );
}

/// Positions of cameras in the world.
fn camera_positions(poses: &[Affine3A]) -> Vec<Vec3> {
    poses.iter().map(|pose| pose.inverse().translation.into()).collect()
}

/// Returns the root mean square distance of positions from true ones, after moving, turning and, if
/// `is_scaled`, scaling them, as a share of the true path's length.
fn path_error(found: &[Vec3], truth: &[Vec3], is_scaled: bool) -> f32 {
    let n = found.len() as f32;
    let centred = |v: &[Vec3]| -> Vec<Vec3> {
        let middle = v.iter().sum::<Vec3>() / n;
        v.iter().map(|p| *p - middle).collect()
    };
    let (a, b) = (centred(found), centred(truth));
    // Small turns, one after the other: the cross products of both point along the turn that is left.
    let mut turned = a;
    for _ in 0..200 {
        let axis: Vec3 = turned.iter().zip(&b).map(|(a, b)| a.cross(*b)).sum();
        let stiffness: f32 = turned.iter().zip(&b).map(|(a, b)| a.dot(*b).abs()).sum();
        let turn = Quat::from_scaled_axis(axis / stiffness.max(1e-9));
        turned.iter_mut().for_each(|p| *p = turn * *p);
    }
    let together: f32 = turned.iter().zip(&b).map(|(a, b)| a.dot(*b)).sum();
    let scale =
        if is_scaled { together / turned.iter().map(|p| p.length_squared()).sum::<f32>() } else { 1.0 };
    let error: f32 = turned.iter().zip(&b).map(|(a, b)| (*a * scale - *b).length_squared()).sum();
    let length: f32 = truth.windows(2).map(|pair| pair[0].distance(pair[1])).sum();
    (error / n).sqrt() / length
}

#[test]
fn a_recorded_depth_gives_the_path_its_scale() {
    let folder = demo([320, 240], true);
    let truth = Sequence::open(folder.path()).unwrap();
    let true_positions: Vec<Vec3> = (0..FRAMES).map(|i| truth.camera(i).position_in_world()).collect();
    let path = estimated(&truth);
    assert!(
        path_error(&camera_positions(&path.poses), &true_positions, false) < 0.01,
        "it is in millimetres"
    );
}

/// Returns a demo of two breaths, and its path.
fn breathing(moving_camera: bool) -> (Sequence, ScopePath) {
    let folder = tempfile::tempdir().unwrap();
    let settings = DemoSettings { width: 240, height: 180, moving_camera, ..DemoSettings::default() };
    write(&settings, folder.path(), &mut unobserved).unwrap();
    let sequence = Sequence::open(folder.path()).unwrap();
    let n = sequence.num_frames();
    let frames: Vec<usize> = (0..n).collect();
    let times: Vec<f32> = (0..n).map(|i| sequence.time(i)).collect();
    let timeline = Timeline { frames: &frames, times: &times };
    let path = estimate(&sequence, timeline, 100.0, &mut unobserved).unwrap();
    (sequence, path)
}

#[test]
fn a_scope_that_stands_still_before_breathing_tissue_is_recognised() {
    let (_, path) = breathing(false);
    assert_eq!((&path.verdict, path.poses.len(), path.swaying.len()), (&ScopeVerdict::Still, 0, 48));
    let displacements = (0..48).map(|i| path.sway(i, Affine3A::IDENTITY).unwrap().translation.length());
    assert!(displacements.fold(0.0, f32::max) > 1.0, "the tissue moves by millimetres");
}

#[test]
fn breath_is_told_from_the_path_of_the_scope() {
    let (truth, path) = breathing(true);
    let n = truth.num_frames();
    let ScopeVerdict::Moves { period_frames: Some(period), .. } = path.verdict else {
        panic!("{:?}", path.verdict)
    };
    assert!((period - 24.0).abs() < 2.0, "a breath of {period} instead of 24 frames");
    let true_positions: Vec<Vec3> = (0..n).map(|i| truth.camera(i).position_in_world()).collect();
    let error = |poses: &[Affine3A]| path_error(&camera_positions(poses), &true_positions, true);
    let (before, after) = (error(&path.swaying), error(&path.poses));
    assert!(
        after < 0.05 && after < 0.8 * before,
        "off by {after} of its length, by {before} with the breath"
    );
    // What was taken out of the path is the motion of the tissue.
    let camera_sees = path.poses[11] * path.sway(11, Affine3A::IDENTITY).unwrap();
    assert!(camera_sees.abs_diff_eq(path.swaying[11], 1e-3));
}

#[test]
fn a_lens_that_is_not_known_is_found_with_the_path() {
    // A wide picture of the same round field: its field of view is 75°, and 60° is assumed.
    let folder = demo([320, 180], true);
    let truth = Sequence::open(folder.path()).unwrap().camera(0);
    let pictures = Sequence::open(&folder.path().join("images")).unwrap();
    let path = estimated(&pictures);
    let ScopeVerdict::Moves { fov_x_degrees: Some(fov), .. } = path.verdict else {
        panic!("{:?}", path.verdict)
    };
    let [true_fov, _] = truth.field_of_view_degrees();
    assert!((fov - true_fov).abs() < 4.0, "{fov}° instead of {true_fov}°");
    let focal = path.zoom.unwrap() * pictures.camera(0).fx;
    assert!((focal / truth.fx - 1.0).abs() < 0.07, "{focal} px instead of {} px", truth.fx);
}

/// Writes two frames that show a bright disc of a radius.
fn disc([width, height]: [u32; 2], radius: f32) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let [middle_x, middle_y] = [width, height].map(|side| side as f32 / 2.0);
    let level = |x: u32, y: u32| {
        let distance = (x as f32 + 0.5 - middle_x).hypot(y as f32 + 0.5 - middle_y);
        image::Rgb([if distance < radius { 150 } else { 0 }; 3])
    };
    let picture = image::RgbImage::from_fn(width, height, level);
    (0..2).for_each(|i| picture.save(folder.path().join(format!("{i}.png"))).unwrap());
    folder
}

#[test]
fn a_black_border_makes_no_picture_coarser() {
    let folder = disc([1000, 400], 150.0);
    assert_eq!(halvings(&Sequence::open(folder.path()).unwrap()), 0);
    let folder = disc([1500, 800], 390.0);
    assert_eq!(halvings(&Sequence::open(folder.path()).unwrap()), 1);
}

#[test]
fn a_round_picture_tells_the_likely_lens() {
    let folder = disc([640, 360], 150.0);
    let sequence = Sequence::open(folder.path()).unwrap();
    let assumed = Lens { camera: sequence.camera(0), shrink: 1.0 };
    let zoom = likely_zoom(&sequence, &[], &assumed, &mut unobserved).unwrap().unwrap();
    let across = 2.0 * (150.0 / assumed.zoomed(zoom).focal_px()).atan().to_degrees();
    assert!((across - 75.0).abs() < 1.0, "{across}° across the disc");
}

#[test]
fn depths_that_nothing_tells_do_not_count() {
    let camera = Lens { camera: crate::camera::Camera::with_field_of_view(320, 240, 60.0), shrink: 1.0 };
    let pose = |frame: usize| DAffine3::from_translation(DVec3::X * (0.02 * frame as f64));
    let mark = |position: DVec3| {
        let observation = |frame: usize| {
            let seen = pose(frame).transform_point3(position);
            adjust::Observation { frame, at: seen.truncate() / seen.z, depth: None }
        };
        adjust::Landmark {
            position: Some(position),
            expected_depth: 1.0,
            observations: (0..5).map(observation).collect(),
        }
    };
    let near =
        (0..60).map(|k| DVec3::new(f64::from(k % 8) / 9.0, f64::from(k / 8) / 9.0, 1.0 + f64::from(k % 3)));
    let far = (0..20).map(|k| DVec3::new(f64::from(k), 0.0, 60.0));
    let mut builder = Builder::new(5, near.clone().chain(far).map(mark).collect(), camera.focal_px());
    builder.poses = (0..5).map(pose).collect();
    assert!((depth_range(&builder, &camera) - 3.0).abs() < 1e-6);
    // Those that are seen from different sides do.
    let deep = near.map(|p| if p.x > 0.7 { p * 20.0 } else { p });
    let mut builder = Builder::new(5, deep.map(mark).collect(), camera.focal_px());
    builder.poses = (0..5).map(|k| DAffine3::from_translation(DVec3::X * (0.5 * k as f64))).collect();
    let poses = builder.poses.clone();
    for mark in &mut builder.landmarks {
        for observation in &mut mark.observations {
            let seen = poses[observation.frame].transform_point3(mark.position.unwrap());
            observation.at = seen.truncate() / seen.z;
        }
    }
    assert!(depth_range(&builder, &camera) > 30.0);
}

#[test]
fn a_point_without_parallax_goes_to_the_depth_of_the_points_around() {
    // A scope that has come near: what is new is seen at half the typical depth.
    let mut poses = [DAffine3::from_translation(DVec3::new(0.0, 0.0, -0.5)); 2];
    let observation = |frame: usize| adjust::Observation { frame, at: glam::DVec2::ZERO, depth: None };
    let mut mark = adjust::Landmark {
        position: Some(DVec3::new(0.0, 0.0, 1.4)),
        expected_depth: 0.5,
        observations: vec![observation(0), observation(1)],
    };
    let residual = adjust::RobustResidual { focal_px: 300.0, cauchy_px: 1.0 };
    let landmarks = vec![&mut mark];
    adjust::Adjustment { poses: &mut poses, landmarks, free: 2..2, residual }.solve(20);
    assert!((mark.position.unwrap().z - 1.0).abs() < 1e-3, "{:?}", mark.position);
}

#[test]
fn a_scope_that_stands_still_stays_where_it_is() {
    let folder = demo([320, 240], false);
    let path = estimated(&Sequence::open(folder.path()).unwrap());
    assert_eq!((path.verdict, path.swaying.len()), (ScopeVerdict::Still, 0));
    assert!(path.poses.is_empty() && path.still_share > 0.9, "{}", path.still_share);
}

#[test]
fn points_are_triangulated_by_known_poses_in_their_units() {
    let folder = demo([320, 240], true);
    let truth = Sequence::open(folder.path()).unwrap();
    let path = on_frames(|timeline| triangulate_with_known_poses(&truth, timeline, &mut unobserved));
    assert!(path.poses.is_empty() && path.points.len() > 100, "{}", path.points.len());
    for frame in [2, 12, 20] {
        let camera = truth.camera(frame);
        let (found, depth) = (path.depth(&camera, frame).unwrap(), truth.depth(frame).unwrap().unwrap());
        let both = found.data.iter().zip(&depth.data).filter(|(_, true_depth)| **true_depth > 0.0);
        let mut errors: Vec<f64> = both.map(|(z, t)| f64::from((z / t - 1.0).abs())).collect();
        let error = median(&mut errors).unwrap();
        assert!(error < 0.02, "the depth of frame {frame} is off by {error}");
    }
    let still = demo([320, 240], false);
    let still = Sequence::open(still.path()).unwrap();
    assert!(
        on_frames(|timeline| triangulate_with_known_poses(&still, timeline, &mut unobserved))
            .points
            .is_empty()
    );
}

#[test]
fn blur_makes_a_frame_less_sharp_and_glare_does_not() {
    const SIDE: usize = 96;
    let picture = |glare: f32| -> Grid<f32> {
        let level = |i: usize| {
            let (x, y) = ((i % SIDE) as f32, (i / SIDE) as f32);
            let waves = [0.2f32, 0.45, 1.1].map(|f| (f * x + 2.0 * f).sin() * (f * y).cos() / f.sqrt());
            let spot = (x % 32.0 - 16.0).hypot(y % 32.0 - 16.0);
            if spot < glare { 255.0 } else { 120.0 + 15.0 * waves.iter().sum::<f32>() }
        };
        Grid::from_vec(SIDE, SIDE, (0..SIDE * SIDE).map(level).collect())
    };
    let blurred = |sharp: &Grid<f32>| -> Grid<f32> {
        let level = |i: usize| {
            let (x, y) = (i % SIDE, i / SIDE);
            (0..5).map(|k| sharp.at((x + k).saturating_sub(2).min(SIDE - 1), y)).sum::<f32>() / 5.0
        };
        Grid::from_vec(SIDE, SIDE, (0..SIDE * SIDE).map(level).collect())
    };
    let sharpness = |luma: Grid<f32>| sharpness(&View { luma, mask: Grid::filled(SIDE, SIDE, true) });
    let usual = sharpness(picture(0.0));
    for glare in [0.0, 5.0, 12.0] {
        let sharp = picture(glare);
        assert!(sharpness(blurred(&sharp)) < BLURRED * usual, "{glare}");
        assert!(sharpness(sharp) > BLURRED * usual, "{glare}");
    }
}

/// Returns how far off the first and the last pose are, if they are not known, over parts of a path of
/// positions: [as estimated, as that of the neighbours].
fn errors_at_the_ends(position: impl Fn(usize) -> DVec3) -> [f64; 2] {
    let pose = |i: usize| {
        let turn = DQuat::from_scaled_axis(0.02 * position(i));
        DAffine3::from_rotation_translation(turn, -(turn * position(i)))
    };
    let known: Vec<(f32, DAffine3)> = (1..63).map(|i| (i as f32 / 64.0, pose(i))).collect();
    let mut sums = [0.0; 2];
    // Paths of all lengths, of which one pose at each end is not known.
    for n in 3..=known.len() {
        let ends = [(&known[..n], n + 1, n - 1), (&known[known.len() - n..], 62 - n, 0)];
        for (part, missing, beside) in ends {
            let (truth, neighbour) = (pose(missing), part[beside].1);
            for (sum, found) in sums.iter_mut().zip([pose_at(part, missing as f32 / 64.0), neighbour]) {
                let turn = DQuat::from_mat3(&(found.matrix3 * truth.matrix3.transpose()));
                let apart = found.inverse().translation - truth.inverse().translation;
                *sum += apart.length_squared() + turn.to_scaled_axis().length_squared();
            }
        }
    }
    sums.map(f64::sqrt)
}

#[test]
fn a_path_goes_on_for_a_frame_beyond_its_ends() {
    let smooth = |i: usize| {
        let phase = i as f64 / 10.0;
        DVec3::new(5.0 * phase.sin(), 2.0 * (0.7 * phase).cos(), 0.1 * i as f64)
    };
    let [found, kept] = errors_at_the_ends(smooth);
    assert!(found < 0.6 * kept, "{found} {kept}");
    let mut rng = ChaCha8Rng::seed_from_u64(0);
    let noise: Vec<DVec3> = (0..64).map(|_| DVec3::from_array(rng.random())).collect();
    let [found, kept] = errors_at_the_ends(|i| noise[i]);
    assert!(found < 1.4 * kept, "{found} {kept}");
    // Farther away, nothing is known of it.
    let known = [3, 4].map(|i| (i as f32, DAffine3::from_translation(smooth(i))));
    for (time, end) in [(1.0, 0), (6.0, 1), (90.0, 1)] {
        assert_eq!(pose_at(&known, time), known[end].1, "{time}");
    }
    assert_eq!(pose_at(&known[..1], 9.0), known[0].1);
}

#[test]
fn a_pose_is_found_from_points_of_which_a_third_move() {
    let truth = DAffine3::from_rotation_translation(
        DQuat::from_scaled_axis(DVec3::new(0.02, -0.05, 0.03)),
        DVec3::new(0.06, -0.02, 0.04),
    );
    let marks: Vec<adjust::Landmark> = (0..60)
        .map(|k| {
            let position = DVec3::new(
                f64::from(k % 8) / 8.0 - 0.4,
                f64::from(k / 8) / 8.0 - 0.4,
                1.0 + f64::from(k % 5) / 9.0,
            );
            let seen = truth.transform_point3(position) + DVec3::X * if k % 3 == 0 { 0.1 } else { 0.0 };
            let observation = adjust::Observation { frame: 0, at: seen.truncate() / seen.z, depth: None };
            adjust::Landmark {
                position: Some(position),
                expected_depth: 1.0,
                observations: vec![observation],
            }
        })
        .collect();
    let mut found = DAffine3::IDENTITY;
    for cauchy_px in [6.0, 1.0, 0.1] {
        let residual = adjust::RobustResidual { focal_px: 300.0, cauchy_px };
        found = adjust::pose_of(0, found, &marks, residual, 40);
    }
    assert!(found.abs_diff_eq(truth, 1e-3), "{found:?}");
}
