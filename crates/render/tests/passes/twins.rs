//! Tests each pass on values that the CPU computed before it, so that a failure names the pass.

use crate::{
    compare::{self, SAME_SPLATS},
    fixture::{Recipe, camera, gpu, moved_camera, scene},
};
use surgtpgs_core::{
    camera::Camera,
    deform::{BasisShape, SCALE_CHANNEL, deform},
    raster::{Images, Packed, bin::bin, forward::raster, project::project_all, reference::ReferenceInput},
    scene::Scene,
};
use surgtpgs_render::PlanePasses;

fn passes() -> Option<PlanePasses> {
    gpu().map(|gpu| PlanePasses::new(&gpu).unwrap())
}

#[test]
fn deform_equals_its_twin() {
    let Some(mut passes) = passes() else { return };
    for latent_dim in [0, 3, 8] {
        for shape in [BasisShape::Gaussian, BasisShape::Quartic, BasisShape::Spline] {
            for is_shared in [true, false] {
                let recipe =
                    Recipe { num_gaussians: 300, latent_dim, shape, is_shared, ..Default::default() };
                let mut scene = scene(recipe);
                if shape == BasisShape::Quartic && latent_dim == 3 {
                    // The gate channel of the released code.
                    scene.deformation.gate_channel = SCALE_CHANNEL;
                }
                for (time, features) in [(0.0, true), (0.37, true), (0.37, false), (79.0 / 80.0, true)] {
                    let expected = deform(&scene.gaussians, &scene.deformation, time, features);
                    let found = passes
                        .deform(&scene.gaussians, &scene.deformation, time, features, usize::MAX)
                        .unwrap();
                    compare::deformed(&found, &expected).unwrap();
                }
            }
        }
    }
}

#[test]
fn deform_does_not_depend_on_how_the_scene_is_cut_into_parts() {
    let Some(mut passes) = passes() else { return };
    for is_shared in [true, false] {
        let scene = scene(Recipe { num_gaussians: 700, is_shared, ..Default::default() });
        let mut run = |rows| passes.deform(&scene.gaussians, &scene.deformation, 0.37, true, rows).unwrap();
        let whole = run(700);
        assert_eq!(whole, run(256));
        assert_eq!(whole, run(97));
    }
}

#[test]
fn project_equals_its_twin() {
    let Some(mut passes) = passes() else { return };
    for sh_degree in 0..=3 {
        let scene = scene(Recipe { sh_degree, ..Default::default() });
        for camera in [camera(150, 100), moved_camera(150, 100)] {
            let deformed = deform(&scene.gaussians, &scene.deformation, 0.37, false);
            let expected = project_all(&scene.gaussians, &deformed, &camera);
            assert!(expected.iter().any(|s| s.is_visible()) && !expected.iter().all(|s| s.is_visible()));
            let found = passes.project(&scene.gaussians, &deformed, &camera).unwrap();
            compare::splats(&found, &expected).unwrap();
        }
    }
}

#[test]
fn project_culls_what_is_not_finite() {
    let Some(mut passes) = passes() else { return };
    let scene = scene(Recipe { num_gaussians: 60, ..Default::default() });
    let mut deformed = deform(&scene.gaussians, &scene.deformation, 0.37, false);
    for (i, bad) in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY].into_iter().enumerate() {
        deformed.means[20 + i][0] = bad;
        deformed.means[23 + i][2] = bad;
        deformed.scales[26 + i][1] = bad;
        deformed.rotations[29 + i][2] = bad;
        deformed.opacities[32 + i] = if bad == f32::INFINITY { 0.0 } else { bad };
    }
    let splats = passes.project(&scene.gaussians, &deformed, &camera(64, 48)).unwrap();
    let expected = project_all(&scene.gaussians, &deformed, &camera(64, 48));
    for i in 20..35 {
        assert!(!splats[i].is_visible() && !expected[i].is_visible(), "{i}: {:?}", splats[i]);
    }
}

#[test]
fn bin_equals_its_twin() {
    let Some(mut passes) = passes() else { return };
    let scene = scene(Recipe::default());
    let deformed = deform(&scene.gaussians, &scene.deformation, 0.37, false);
    for camera in [camera(150, 100), moved_camera(128, 96), camera(1, 1), camera(160, 17)] {
        let splats = project_all(&scene.gaussians, &deformed, &camera);
        let expected = bin(&splats, camera.width as usize, camera.height as usize);
        // With far too little room at first, the pass must notice and repeat.
        for capacity in [100_000, 1, 1000] {
            let found = passes.bin(&splats, &camera, capacity).unwrap();
            compare::bins(&found, &expected, &splats).unwrap();
        }
        assert!(expected.splat.len() > 100 || camera.width == 1, "{} pairs", expected.splat.len());
    }
}

#[test]
fn bin_sorts_many_splats_stably() {
    let Some(mut passes) = passes() else { return };
    // The pairs fill more than one block of the scan and of the sort, with many ties in depth.
    let scene = scene(Recipe { num_gaussians: 5000, ..Default::default() });
    let deformed = deform(&scene.gaussians, &scene.deformation, 0.5, false);
    let camera = camera(64, 48);
    let mut splats = project_all(&scene.gaussians, &deformed, &camera);
    for (i, s) in splats.iter_mut().enumerate() {
        s.depth = 1.0 + (i % 7) as f32;
    }
    let expected = bin(&splats, 64, 48);
    compare::bins(&passes.bin(&splats, &camera, 10).unwrap(), &expected, &splats).unwrap();
}

#[test]
fn bin_of_no_and_of_invisible_splats_is_empty_even_after_a_full_frame() {
    let Some(mut passes) = passes() else { return };
    let scene = scene(Recipe::default());
    let camera = camera(64, 48);
    let deformed = deform(&scene.gaussians, &scene.deformation, 0.5, false);
    let mut splats = project_all(&scene.gaussians, &deformed, &camera);
    assert!(!passes.bin(&splats, &camera, 1000).unwrap().splat.is_empty());
    assert_eq!(passes.bin(&[], &camera, 1000).unwrap(), bin(&[], 64, 48));
    splats.iter_mut().for_each(|s| s.extent = [0.0; 2]);
    assert_eq!(passes.bin(&splats, &camera, 1000).unwrap(), bin(&[], 64, 48));
}

/// Rasters the splats, features and bins of the CPU; returns the device's image and the CPU's.
fn rastered(passes: &mut PlanePasses, scene: &Scene, camera: &Camera, features: bool) -> (Images, Images) {
    let deformed = deform(&scene.gaussians, &scene.deformation, 0.37, features);
    let splats = project_all(&scene.gaussians, &deformed, camera);
    let (width, height) = (camera.width as usize, camera.height as usize);
    let bins = bin(&splats, width, height);
    let dim = if features { scene.gaussians.latent_dim } else { 0 };
    let expected = raster(&Packed::new(&splats, &deformed.features, dim), &bins, width, height);
    (passes.raster(&splats, &deformed.features, dim, &bins, camera).unwrap(), expected)
}

#[test]
fn raster_equals_its_twin() {
    let Some(mut passes) = passes() else { return };
    for latent_dim in [0, 3, 8, 16] {
        let scene = scene(Recipe { latent_dim, ..Default::default() });
        for camera in [camera(160, 128), moved_camera(75, 50), camera(16, 16), camera(1, 1)] {
            for features in [true, false] {
                let (found, expected) = rastered(&mut passes, &scene, &camera, features);
                compare::images(&found, &expected, SAME_SPLATS).unwrap();
            }
        }
    }
}

#[test]
fn raster_equals_the_f64_reference() {
    let Some(mut passes) = passes() else { return };
    let scene = scene(Recipe { num_gaussians: 300, ..Default::default() });
    let camera = camera(50, 40);
    let deformed = deform(&scene.gaussians, &scene.deformation, 0.37, true);
    let splats = project_all(&scene.gaussians, &deformed, &camera);
    let bins = bin(&splats, 50, 40);
    let found = passes.raster(&splats, &deformed.features, 3, &bins, &camera).unwrap();
    let wide = |v: f32| f64::from(v);
    let splats: Vec<_> = splats
        .iter()
        .map(|s| surgtpgs_core::raster::project::Splat {
            centre: s.centre.map(wide),
            conic: s.conic.map(wide),
            depth: wide(s.depth),
            opacity: wide(s.opacity),
            colour: s.colour.map(wide),
            extent: s.extent.map(wide),
        })
        .collect();
    let features: Vec<f64> = deformed.features.iter().map(|&v| wide(v)).collect();
    let reference =
        ReferenceInput { splats: &splats, features: &features, latent_dim: 3, width: 50, height: 40 };
    let planes = reference.forward().into_iter().map(|v| v as f32).collect();
    compare::images(&found, &Images { width: 50, height: 40, planes }, SAME_SPLATS).unwrap();
}
