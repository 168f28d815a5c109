//! Checks that each comparer refuses values just beyond its tolerance: a comparison that cannot fail
//! proves nothing.

use crate::{
    compare::{self, ImageTolerance, SAME_SPLATS, SMOOTH, WHOLE_CHAIN},
    fixture::{Recipe, camera, scene},
};
use surgtpgs_core::{
    deform::deform,
    raster::{CpuRenderer, Images, Renderer, bin::bin, project::project_all},
};

#[test]
fn values_just_over_the_tolerance_are_refused() {
    let expected = [1.0, -2.0];
    let edge = SMOOTH.absolute + 2.0 * SMOOTH.relative;
    assert!(compare::close("x", &[1.0, -2.0 + 0.9 * edge], &expected, SMOOTH).is_ok());
    assert!(compare::close("x", &[1.0, -2.0 + 1.2 * edge], &expected, SMOOTH).is_err());
    assert!(compare::close("x", &[1.0, f32::NAN], &expected, SMOOTH).is_err());
    assert!(compare::close("x", &[1.0], &expected, SMOOTH).is_err());
}

#[test]
fn every_field_of_the_deformed_gaussians_is_looked_at() {
    let scene = scene(Recipe { num_gaussians: 30, ..Default::default() });
    let good = deform(&scene.gaussians, &scene.deformation, 0.4, true);
    assert!(compare::deformed(&good, &good).is_ok());
    let spoil: [fn(&mut surgtpgs_core::deform::Deformed); 6] = [
        |d| d.means[9][2] += 1e-3,
        |d| d.rotations[9][3] += 1e-3,
        |d| d.scales[9][1] *= 1.001,
        |d| d.opacities[9] += 1e-3,
        |d| d.colours[9][0] += 1e-3,
        |d| d.features[20] += 1e-3,
    ];
    for (i, spoil) in spoil.into_iter().enumerate() {
        let mut bad = good.clone();
        spoil(&mut bad);
        assert!(compare::deformed(&bad, &good).is_err(), "field {i}");
    }
}

#[test]
fn every_field_of_the_splats_is_looked_at() {
    let scene = scene(Recipe::default());
    let deformed = deform(&scene.gaussians, &scene.deformation, 0.4, true);
    let good = project_all(&scene.gaussians, &deformed, &camera(64, 48));
    assert!(compare::splats(&good, &good).is_ok());
    let round = |s: &surgtpgs_core::raster::project::Splat<f32>| {
        s.is_visible() && s.conic[1].abs() < 0.1 * s.conic[0]
    };
    let visible = good.iter().position(round).unwrap();
    let spoil: [fn(&mut surgtpgs_core::raster::project::Splat<f32>); 7] = [
        |s| s.depth *= 1.001,
        |s| s.opacity *= 1.001,
        |s| s.colour[2] += 1e-3,
        |s| s.centre[0] += 0.01,
        |s| s.extent[1] *= 1.01,
        |s| s.conic[2] *= 1.001,
        |s| s.extent = [0.0; 2],
    ];
    for (i, spoil) in spoil.into_iter().enumerate() {
        let mut bad = good.clone();
        spoil(&mut bad[visible]);
        assert!(compare::splats(&bad, &good).is_err(), "field {i}");
    }
    assert!(compare::splats(&good[1..], &good).is_err());
}

#[test]
fn a_missing_a_foreign_and_a_swapped_pair_are_refused() {
    let scene = scene(Recipe::default());
    let deformed = deform(&scene.gaussians, &scene.deformation, 0.4, false);
    let splats = project_all(&scene.gaussians, &deformed, &camera(64, 48));
    let good = bin(&splats, 64, 48);
    assert!(compare::bins(&good, &good, &splats).is_ok());
    let range = good.tile(1, 1);
    assert!(range.len() > 8);

    let mut swapped = good.clone();
    swapped.splat[range.clone()].reverse();
    assert!(compare::bins(&swapped, &good, &splats).is_err());

    let mut missing = good.clone();
    missing.splat.remove(range.start + range.len() / 2);
    missing.first.iter_mut().filter(|f| **f > range.start as u32).for_each(|f| *f -= 1);
    let removed_matters = compare::bins(&missing, &good, &splats).is_err();
    assert!(removed_matters);
}

fn one_plane(expected: &Images, tolerance: ImageTolerance) {
    let pixels = expected.width * expected.height;
    assert!(compare::images(expected, expected, tolerance).is_ok());
    for k in 0..expected.planes.len() / pixels {
        let largest = expected.plane(k).iter().fold(1.0f32, |m, v| m.max(v.abs()));
        let edit = |every: usize, by: f32| {
            let mut bad = expected.clone();
            // The errors go to both sides, so that they do not show in the mean.
            for (i, v) in bad.planes[k * pixels..(k + 1) * pixels].iter_mut().enumerate().step_by(every) {
                *v += if (i / every).is_multiple_of(2) { by * largest } else { -by * largest };
            }
            compare::images(&bad, expected, tolerance)
        };
        assert!(edit(pixels, 1.1 * tolerance.boundary).is_err(), "one wild pixel in plane {k}");
        assert!(edit(pixels, 0.9 * tolerance.boundary).is_ok(), "one boundary pixel in plane {k}");
        let dense = (0.5 / tolerance.boundary_fraction) as usize;
        assert!(edit(dense, 3.0 * tolerance.interior).is_err(), "too many boundary pixels in plane {k}");
        let mut shifted = expected.clone();
        shifted.planes[k * pixels..(k + 1) * pixels]
            .iter_mut()
            .for_each(|v| *v += 1.5 * tolerance.interior * largest);
        assert!(compare::images(&shifted, expected, tolerance).is_err(), "shifted plane {k}");
    }
}

#[test]
fn images_with_a_wild_pixel_many_off_pixels_or_a_shift_are_refused() {
    let scene = scene(Recipe::default());
    let images = CpuRenderer::default().render(&scene, &camera(64, 48), 0.3, true).unwrap();
    one_plane(&images, SAME_SPLATS);
    one_plane(&images, WHOLE_CHAIN);
}

#[test]
fn an_image_of_another_size_is_refused() {
    let images = |width, height| Images { width, height, planes: vec![0.0; 5 * 12] };
    assert!(compare::images(&images(4, 3), &images(3, 4), SAME_SPLATS).is_err());
}

#[test]
fn pictures_with_one_pixel_two_levels_off_or_many_one_level_off_are_refused() {
    let good = image::RgbImage::from_pixel(20, 20, image::Rgb([100, 50, 0]));
    let edit = |every: usize, by: u8| {
        let mut bad = good.clone();
        bad.iter_mut().step_by(every).for_each(|v| *v += by);
        compare::pictures(&bad, &good)
    };
    assert!(edit(1200, 1).is_ok());
    assert!(edit(1200, 2).is_err());
    assert!(edit(100, 1).is_err());
    assert!(compare::pictures(&image::RgbImage::new(19, 20), &good).is_err());
}

#[test]
fn a_frame_with_a_moved_border_is_accepted_and_one_with_other_colours_is_not() {
    let expected =
        image::RgbImage::from_fn(100, 50, |x, _| image::Rgb(if x < 40 { [200, 30, 30] } else { [90; 3] }));
    assert!(compare::frames(&expected, &expected).is_ok());
    let mut border = expected.clone();
    (0..40).for_each(|y| border.put_pixel(39, y, image::Rgb([90; 3])));
    assert!(compare::frames(&border, &expected).is_ok());
    (0..40).for_each(|y| border.put_pixel(38, y, image::Rgb([90; 3])));
    assert!(compare::frames(&border, &expected).is_err());
    let mut shifted = expected.clone();
    shifted.pixels_mut().for_each(|pixel| pixel.0[0] += 1);
    assert!(compare::frames(&shifted, &expected).is_err());
    assert!(compare::frames(&image::RgbImage::new(50, 100), &expected).is_err());
}
