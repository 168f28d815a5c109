//! Tests of estimated depth, from a made-up network to the input of training.

use super::*;
use crate::{
    codec::{CodecKind, CodecSettings},
    demo::DemoSettings,
    grid::Grid,
    progress::{Progress, unobserved},
    sequence::{DepthKind, MONOCULAR_BASELINE},
    stress::made_up_encoder,
};
use image::{Rgb, RgbImage};
use std::{
    fs,
    ops::ControlFlow,
    sync::atomic::{AtomicUsize, Ordering},
};

const FRAMES: usize = 10;
/// Scale of each frame's estimate.
const SCALES: [f32; FRAMES] = [1.0, 1.0, 1.3, 0.8, 1.0, 1.1, 0.9, 1.0, 1.0, 1.2];

/// Writes a wall that comes nearer to the right, and a labelled square; the red value encodes the frame.
fn write_clip(folder: &Path) -> Sequence {
    fs::create_dir_all(folder).unwrap();
    for i in 0..FRAMES as u8 {
        RgbImage::from_fn(40, 30, |x, _| Rgb([i, 40 + 3 * x as u8, 90]))
            .save(folder.join(format!("f_{i}.png")))
            .unwrap();
    }
    fs::write(folder.join("sequence.toml"), "[masks]\nfield_of_view = \"whole\"\n").unwrap();
    Sequence::open(folder).unwrap()
}

/// Returns disparity at a quarter of the size, with a different scale for each frame.
fn disparity(image: &RgbImage) -> Result<Grid<f32>> {
    let scale = SCALES[usize::from(image.get_pixel(0, 0)[0])];
    Ok(Grid::from_vec(10, 8, (0..80).map(|i| (1.0 + 0.1 * (i % 10) as f32) / scale).collect()))
}

fn estimate(
    sequence: &Sequence,
    folder: &Path,
    eval: bool,
    network: &mut dyn FnMut(&RgbImage) -> Result<Grid<f32>>,
) -> Result<Sequence> {
    // Each is another network.
    static NUM_NETWORKS: AtomicUsize = AtomicUsize::new(0);
    let name = NUM_NETWORKS.fetch_add(1, Ordering::Relaxed).to_string();
    let estimator = Estimator { network: &name, kind: DepthKind::Disparity, estimate: network };
    estimate_depth(sequence, estimator, eval, folder, &mut unobserved)
}

#[test]
fn depth_has_one_scale_over_time_and_the_authors_unit() {
    let place = tempfile::tempdir().unwrap();
    let sequence = write_clip(&place.path().join("clip"));
    let found = estimate(&sequence, &place.path().join("prep"), false, &mut disparity).unwrap();
    let expected = found.camera(0).fx * MONOCULAR_BASELINE as f32;
    for i in 0..FRAMES {
        let depth = found.depth(i).unwrap().unwrap();
        assert_eq!((depth.width, depth.height), (40, 30));
        let (left, right) = (depth.at(0, 15), depth.at(39, 15));
        assert!((left / expected - 1.0).abs() < 0.01, "frame {i}: {left}, expected {expected}");
        assert!((left / right - 1.9).abs() < 0.02, "frame {i}");
    }
    let about = found.estimated_depth().unwrap();
    assert!((about.drift - 1.3 / 0.8).abs() < 0.02 && about.notes.is_empty(), "{about:?}");
    assert!(!sequence.has_depth(), "the recording itself stays as it was");
}

#[test]
fn prepared_folders_keep_it_and_held_out_frames_have_none() {
    let place = tempfile::tempdir().unwrap();
    let sequence = write_clip(&place.path().join("clip"));
    let folder = place.path().join("prep");
    let prepare = |sequence: &Sequence| {
        let map = RegionMap::filled(40, 30, 0);
        let mut features = |_| Ok(Some(FrameFeatures { regions: map.clone(), rows: vec![vec![1.0, 0.0]] }));
        let encoder = made_up_encoder(2);
        let quick = CodecSettings { kind: CodecKind::Network, latent_dim: 3, steps: 5, seed: 0 };
        let origin = Origin::Dense { network: "00".into() };
        let sequence = sequence.clone();
        prepare_from_features(
            sequence,
            encoder,
            origin,
            &mut features,
            true,
            &quick,
            &folder,
            &mut unobserved,
        )
    };
    let with_depth = estimate(&sequence, &folder, true, &mut disparity).unwrap();
    prepare(&with_depth).unwrap();
    let opened = Prepared::open(&folder).unwrap();
    assert_eq!(opened.sequence.estimated_depth(), with_depth.estimated_depth());
    for i in 0..FRAMES {
        assert_eq!(opened.sequence.depth(i).unwrap().is_none(), Sequence::is_test_frame(i), "frame {i}");
    }
    let file = folder.join("depth/frame_000004.npy");
    let mut bytes = fs::read(&file).unwrap();
    *bytes.last_mut().unwrap() ^= 1;
    fs::write(&file, bytes).unwrap();
    assert!(opened.sequence.depth(4).unwrap_err().to_string().contains("checksum"));
    fs::remove_file(&file).unwrap();
    assert!(opened.sequence.depth(4).is_err(), "a map that was there is missed");
    prepare(&sequence).unwrap();
    assert!(!folder.join("depth").exists() && !Prepared::open(&folder).unwrap().sequence.has_depth());
}

#[test]
fn networks_that_make_no_sense_are_named() {
    let place = tempfile::tempdir().unwrap();
    let sequence = write_clip(&place.path().join("clip"));
    let prep = place.path().join("prep");
    let fail = |value: fn(usize) -> f32| {
        let mut network = |_: &RgbImage| Ok(Grid::from_vec(10, 8, (0..80).map(value).collect()));
        estimate(&sequence, &prep, false, &mut network).unwrap_err().to_string()
    };
    assert!(fail(|_| 0.5).contains("all of frame f_0 the same depth"));
    assert!(fail(|i| if i < 60 { f32::NAN } else { i as f32 }).contains("75 % of frame f_0 no usable value"));
    assert!(fail(|i| 10.0_f32.powi(i as i32 / 8)).contains("span a factor of"));
    let reversed = &mut |image: &RgbImage| Ok(disparity(image)?.map(|d| 1.0 / d));
    let about = estimate(&sequence, &prep, false, reversed).unwrap();
    assert!(about.estimated_depth().unwrap().notes[0].contains("may be disparity"));
    let report = crate::sequence::check(&about, &mut unobserved).unwrap();
    assert!(report.ok && report.depth.starts_with("estimated by a network"), "{}", report.depth);
    assert!(report.warnings.iter().any(|w| w.contains("may be disparity")), "{:?}", report.warnings);
    let again = estimate(&about, &prep, false, &mut disparity).unwrap_err().to_string();
    assert!(again.contains("has depth already"), "{again}");
}

#[test]
fn scales_of_two_shots_are_not_compared() {
    const SHOT: usize = 12;
    let place = tempfile::tempdir().unwrap();
    let clip = place.path().join("clip");
    fs::create_dir_all(&clip).unwrap();
    for i in 0..2 * SHOT {
        let grey = if i < SHOT { 40 } else { 160 };
        let picture = RgbImage::from_fn(40, 30, |x, _| Rgb([3 * i as u8, grey + x as u8, grey]));
        picture.save(clip.join(format!("f_{i:02}.png"))).unwrap();
    }
    fs::write(clip.join("sequence.toml"), "[masks]\nfield_of_view = \"whole\"\n").unwrap();
    let sequence = Sequence::open(&clip).unwrap();
    let scale = |i: usize| if i % 3 == 2 { 1.0 + 0.1 * (i % 5) as f32 } else { 1.0 };
    // The second shot is farther away on one side, and nearer on the other.
    let mut network = |image: &RgbImage| {
        let i = usize::from(image.get_pixel(0, 0)[0]) / 3;
        let shape = |k: usize| if i < SHOT { 1.0 } else { 0.4 + 0.2 * (k % 10) as f32 };
        Ok(Grid::from_vec(10, 8, (0..80).map(|k| (1.0 + 0.01 * k as f32) * shape(k) / scale(i)).collect()))
    };
    let found = estimate(&sequence, &place.path().join("prep"), false, &mut network).unwrap();
    let left = |i: usize| found.depth(i).unwrap().unwrap().at(0, 15);
    for i in 0..2 * SHOT {
        let first = if i < SHOT { 0 } else { SHOT };
        assert!((left(i) / left(first) - 1.0).abs() < 0.01, "frame {i}: {} {}", left(i), left(first));
    }
    assert!((left(SHOT) / left(0) - 2.5).abs() < 0.02, "{} {}", left(SHOT), left(0));
    assert!(found.estimated_depth().unwrap().notes.is_empty());
}

#[test]
fn the_path_of_a_scope_that_comes_nearer_is_no_drift() {
    let place = tempfile::tempdir().unwrap();
    let demo = DemoSettings {
        width: 320,
        height: 240,
        frames: 24,
        moving_camera: true,
        rigid: true,
        ..Default::default()
    };
    crate::demo::write(&demo, place.path(), &mut unobserved).unwrap();
    let truth = Sequence::open(place.path()).unwrap();
    let images = place.path().join("images");
    fs::write(images.join("sequence.toml"), "[camera]\nfov_x_degrees = 60\n").unwrap();
    let sequence = Sequence::open(&images).unwrap();
    let pictures: Vec<RgbImage> = (0..24).map(|i| sequence.frame(i).unwrap()).collect();
    let scale = |i: usize| 1.0 + 0.1 * (i * 7 % 5) as f32;
    let mut network = |image: &RgbImage| {
        let i = pictures.iter().position(|picture| picture == image).unwrap();
        Ok(truth.depth(i)?.unwrap().map(|z| z * scale(i)))
    };
    let estimator = Estimator { network: "00", kind: DepthKind::Depth, estimate: &mut network };
    let prep = place.path().join("prep");
    let found = estimate_depth(&sequence, estimator, false, &prep, &mut unobserved).unwrap();
    let ratios = (0..24).map(|i| {
        let (found, truth) = (found.depth(i).unwrap().unwrap(), truth.depth(i).unwrap().unwrap());
        found.at(160, 120) / truth.at(160, 120)
    });
    let ratios: Vec<f32> = ratios.collect();
    let [low, high] =
        [ratios.iter().copied().fold(f32::MAX, f32::min), ratios.iter().copied().fold(0.0, f32::max)];
    assert!(high / low < 1.02, "{ratios:?}");
    let notes = &found.estimated_depth().unwrap().notes;
    assert!(notes.iter().any(|note| note.starts_with("The scope moves in 24 of 24 frames")), "{notes:?}");
}

#[test]
fn frames_that_a_network_cannot_make_out_have_no_depth() {
    let place = tempfile::tempdir().unwrap();
    let sequence = write_clip(&place.path().join("clip"));
    let folder = place.path().join("prep");
    let number = |image: &RgbImage| image.get_pixel(0, 0)[0];
    let mut network = |image: &RgbImage| match number(image) {
        2 => Ok(Grid::filled(10, 8, 0.5)),
        6 => Ok(disparity(image)?.map(|_| f32::NAN)),
        7 => Ok(Grid { data: [&[f32::NAN], &disparity(image)?.data[1..]].concat(), ..disparity(image)? }),
        _ => disparity(image),
    };
    let found = estimate(&sequence, &folder, false, &mut network).unwrap();
    for i in 0..FRAMES {
        assert_eq!(found.depth(i).unwrap().is_none(), [2, 6].contains(&i), "frame {i}");
    }
    let about = found.estimated_depth().unwrap();
    assert_eq!(about.notes, ["No depth for frames 2, 6: the network gives nothing usable"]);
    assert!((about.drift - 1.2 / 0.8).abs() < 0.02, "{}", about.drift);
    let [hole, known] = [0, 20].map(|x| found.depth(7).unwrap().unwrap().at(x, 0));
    assert!(hole == 0.0 && known > 0.0);
    // Of most frames, nothing is the fault of the network.
    let mut network = |image: &RgbImage| {
        if number(image) % 5 < 3 { Ok(Grid::filled(10, 8, 0.5)) } else { disparity(image) }
    };
    let error = estimate(&sequence, &folder, false, &mut network).unwrap_err().to_string();
    assert!(error.contains("all of frame f_0 the same depth"), "{error}");
    let mut asked = 0;
    let mut broken = |image: &RgbImage| {
        asked += 1;
        if number(image) == 3 { Err(Error::input("The depth network failed", "")) } else { disparity(image) }
    };
    let error = estimate(&sequence, &folder, false, &mut broken).unwrap_err().to_string();
    assert!(error.contains("The depth network failed, on frame f_3"), "{error}");
    assert!(asked < FRAMES);
}

#[test]
fn it_stops_when_asked_to_and_goes_on_where_it_was() {
    let place = tempfile::tempdir().unwrap();
    let sequence = write_clip(&place.path().join("clip"));
    let run = |name: &str, last: usize| {
        let mut asked = 0;
        let mut network = |image: &RgbImage| {
            asked += 1;
            Ok(disparity(image)?.map(|d| if *d > 1.8 { f32::NAN } else { *d }))
        };
        let estimator = Estimator { network: name, kind: DepthKind::Disparity, estimate: &mut network };
        let mut stop = |p: &Progress<'_>| {
            if p.done == last { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
        };
        let found = estimate_depth(&sequence, estimator, false, &place.path().join("prep"), &mut stop);
        (asked, found.and_then(|found| Ok(found.depth(5)?.unwrap())))
    };
    let (asked, stopped) = run("00", 3);
    assert!(asked == 3 && matches!(stopped, Err(Error::Cancelled)));
    let (asked, found) = run("00", usize::MAX);
    let (again, same) = run("00", usize::MAX);
    assert_eq!((asked, again), (FRAMES - 3, 0));
    assert_eq!(found.unwrap(), same.unwrap());
    assert_eq!(run("01", usize::MAX).0, FRAMES, "another network");
    RgbImage::from_pixel(40, 30, Rgb([9; 3])).save(place.path().join("clip/f_4.png")).unwrap();
    assert_eq!(run("01", usize::MAX).0, 1, "another picture");
}
