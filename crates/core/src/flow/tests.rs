use super::*;
use crate::grid::Mask;
use image::{Rgb, RgbImage};

/// Smooth random texture: waves of 12 to 40 px in all directions, moved by (right, down) px.
fn texture(width: usize, height: usize, [right, down]: Vector) -> Grid<f32> {
    let mut state = 7_u32;
    let mut random = || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 8) as f32 / (1 << 24) as f32
    };
    let turn = std::f32::consts::TAU;
    let waves: Vec<[f32; 3]> = (0..24)
        .map(|_| {
            let (frequency, angle, phase) =
                (turn / (12.0 + 28.0 * random()), turn * random(), turn * random());
            [frequency * angle.cos(), frequency * angle.sin(), phase]
        })
        .collect();
    pyramid::each_pixel(width, height, |x, y| {
        let (x, y) = (x as f32 - right, y as f32 - down);
        128.0 + 10.0 * waves.iter().map(|[a, b, c]| (a * x + b * y + c).sin()).sum::<f32>()
    })
}

fn picture(levels: &Grid<f32>) -> RgbImage {
    RgbImage::from_fn(levels.width as u32, levels.height as u32, |x, y| {
        let level = levels.at(x as usize, y as usize) as u8;
        Rgb([level, level / 2, 255 - level])
    })
}

/// Largest error of a component at least `margin` px from the border.
fn largest_error(flow: &Grid<Vector>, truth: Vector, margin: usize) -> f32 {
    let inner = |size: usize| margin..size - margin;
    inner(flow.height)
        .flat_map(|y| inner(flow.width).map(move |x| flow.at(x, y)))
        .flat_map(|[u, v]| [(u - truth[0]).abs(), (v - truth[1]).abs()])
        .fold(0.0, f32::max)
}

#[test]
fn a_shift_is_found() {
    for shift in [[0.6, -0.3], [2.3, -1.6], [-9.4, 6.7]] {
        let (from, to) = (texture(141, 118, [0.0; 2]), texture(141, 118, shift));
        let flows = [(optical_flow(&from, &to), 0.05), (patch_flow(&from, &to), 0.25)];
        for (flow, most) in flows {
            let error = largest_error(&flow, shift, 40);
            assert!(error < most, "{shift:?} is missed by {error} px");
        }
    }
}

#[test]
fn what_a_way_is_off_is_mended() {
    let (from, to) = (texture(141, 118, [0.0; 2]), texture(141, 118, [5.3, -3.6]));
    let way = Grid::filled(141, 118, [4.0, -2.0]);
    assert!(largest_error(&way, [5.3, -3.6], 40) > 1.0);
    let error = largest_error(&mended(&from, &to, &way), [5.3, -3.6], 40);
    assert!(error < 0.25, "missed by {error} px");
    let tiny = Grid::filled(9, 9, [1.0, 0.0]);
    assert_eq!(mended(&texture(9, 9, [0.0; 2]), &texture(9, 9, [0.0; 2]), &tiny), tiny);
}

#[test]
fn equal_images_do_not_move() {
    let image = texture(60, 44, [0.0; 2]);
    assert_eq!(optical_flow(&image, &image), Grid::filled(60, 44, [0.0; 2]));
}

#[test]
fn a_still_picture_stays() {
    let still = picture(&texture(50, 41, [0.0; 2]));
    let Between { blend, moved } = between(&still, &still, 0.5).unwrap();
    assert!(blend == still && moved == still);
}

#[test]
fn the_picture_between_is_part_of_the_way() {
    let frame = |share: f32| picture(&texture(120, 96, [6.0 * share, -4.0 * share]));
    for share in [0.25, 0.5] {
        let (guess, truth) = (between(&frame(0.0), &frame(1.0), share).unwrap(), frame(share));
        let worst = |picture: &RgbImage| {
            let inner = (24..72).flat_map(|y| (24..96).map(move |x| (x, y)));
            let error = |(x, y)| {
                let (a, b) = (picture.get_pixel(x, y).0, truth.get_pixel(x, y).0);
                (0..3).map(|k| a[k].abs_diff(b[k])).max()
            };
            inner.filter_map(error).max().unwrap()
        };
        let (moved, blend) = (worst(&guess.moved), worst(&guess.blend));
        assert!(moved < 6 && blend > 12, "{share}: {moved} {blend}");
    }
}

#[test]
fn any_size_and_any_value_will_do() {
    for (width, height) in [(0, 0), (0, 5), (1, 1), (1, 40), (7, 9), (15, 16), (16, 16), (17, 33), (64, 18)] {
        let odd = [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, f32::MAX, 3.0];
        let from = pyramid::each_pixel(width, height, |x, y| odd[(x * 7 + y * 3) % 5]);
        let to = pyramid::each_pixel(width, height, |x, y| odd[(x * x + y) % 5]);
        let flow = optical_flow(&from, &to);
        assert_eq!((flow.width, flow.height), (width, height));
        assert!(flow.data.iter().flatten().all(|v| v.is_finite()));
        let black = RgbImage::new(width as u32, height as u32);
        assert_eq!(between(&black, &black, f32::NAN), Some(Between { blend: black.clone(), moved: black }));
    }
    assert_eq!(between(&RgbImage::new(20, 20), &RgbImage::new(20, 21), 0.5), None);
    let (small, large) = (Grid::filled(20, 20, 0.0), Grid::filled(20, 21, 0.0));
    assert_eq!(optical_flow(&small, &large), Grid::filled(20, 20, [0.0; 2]));
}

#[test]
fn the_number_of_threads_changes_nothing() {
    let (from, to) = (texture(150, 203, [0.0; 2]), texture(150, 203, [3.3, 1.2]));
    let with = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| optical_flow(&from, &to))
    };
    assert_eq!(with(1), with(3));
}

/// Centre part of a picture, away from what moves in from outside.
fn inner_error(a: &Grid<Colour>, b: &RgbImage, margin: usize) -> f32 {
    let inner = |size: usize| margin..size - margin;
    inner(a.height)
        .flat_map(|y| inner(a.width).map(move |x| (x, y)))
        .map(|(x, y)| (a.at(x, y)[0] - f32::from(b.get_pixel(x as u32, y as u32)[0])).abs())
        .fold(0.0, f32::max)
}

#[test]
fn what_speeds_up_is_found_where_it_is_between_two_frames() {
    // Place at time t: t²/2 px to the right.
    let at = |t: f32| picture(&texture(150, 120, [0.5 * t * t, 0.0]));
    let frames = [0.0, 1.0, 3.0, 4.0].map(at);
    let [earlier, before, after, later] = [0, 1, 2, 3].map(|k| (&frames[k], [0.0, 1.0, 3.0, 4.0][k]));
    let truth = at(2.0);
    let error = |next| {
        let [back, forth] = ways_around([before, after], next, 2.0);
        let missed = [(&frames[1], back), (&frames[2], forth)]
            .map(|(f, way)| inner_error(&arriving(f, &way), &truth, 45));
        missed[0].max(missed[1])
    };
    let curved = error([Some(earlier), Some(later)]);
    assert!(curved < 4.0, "{curved} levels with four frames");
    assert!(error([Some(earlier), None]) < 4.0 && error([None, Some(later)]) < 4.0, "a parabola needs three");
    let straight = error([None, None]);
    assert!(straight > 2.0 * curved, "two frames tell nothing of speed: {straight} and {curved} levels");
}

#[test]
fn ways_lean_to_no_side() {
    let frames = [[0.0, 0.0], [2.3, -1.1]].map(|place| picture(&texture(120, 96, place)));
    let ways = |frames: &[RgbImage; 2]| ways_around([(&frames[0], 0.0), (&frames[1], 1.0)], [None; 2], 0.5);
    let upright = ways(&frames);
    let turned = ways(&[0, 1].map(|k| image::imageops::rotate180(&frames[k])));
    for (a, b) in upright.iter().zip(&turned) {
        let apart = a.data.iter().zip(b.data.iter().rev());
        let worst = apart.flat_map(|(a, b)| [0, 1].map(|k| (a[k] + b[k]).abs())).fold(0.0, f32::max);
        assert!(worst < 1e-3, "{worst} px");
    }
}

#[test]
fn a_mask_moves_with_its_frame() {
    let mask = Mask::from_vec(5, 1, vec![true, true, false, false, true]);
    let way = |right: f32| Grid::filled(5, 1, [right, 0.0]);
    assert_eq!(arriving_mask(&mask, &way(0.0)), mask);
    assert_eq!(arriving_mask(&mask, &way(-1.0)).data, [true, true, true, false, false]);
    assert_eq!(arriving_mask(&mask, &way(0.5)).data, [true, false, false, false, true]);
}
