//! Tests of the renderer as a whole.

use crate::{
    compare::{self, WHOLE_CHAIN},
    fixture::{Recipe, camera, gpu, moved_camera, scene},
};
use std::time::Duration;
use surgtpgs_core::{
    Remedy,
    raster::{CpuRenderer, Renderer},
    stress,
};
use surgtpgs_render::{AdapterChoice, Gpu, GpuRenderer};

fn renderer() -> Option<GpuRenderer> {
    gpu().map(|gpu| GpuRenderer::new(gpu).unwrap())
}

#[test]
fn pictures_equal_those_of_the_cpu() {
    let Some(mut renderer) = renderer() else { return };
    for (latent_dim, sh_degree, is_shared) in [(3, 3, true), (0, 0, false), (8, 1, true)] {
        let scene = scene(Recipe { latent_dim, sh_degree, is_shared, ..Default::default() });
        for camera in [camera(160, 128), moved_camera(121, 77)] {
            for (time, features) in [(0.0, false), (0.61, true)] {
                let expected = CpuRenderer::default().render(&scene, &camera, time, features).unwrap();
                let found = renderer.render(&scene, &camera, time, features).unwrap();
                compare::images(&found, &expected, WHOLE_CHAIN).unwrap();
            }
        }
    }
}

#[test]
fn what_breaks_renderers_renders_like_the_f64_twin() {
    let Some(mut renderer) = renderer() else { return };
    let mut wrong = Vec::new();
    for (k, case) in stress::cases().iter().enumerate() {
        let images = renderer.render(&case.scene, &case.camera, case.time, true).unwrap();
        let found = stress::compare(&images, case);
        if found.not_finite > 0 || found.beyond > stress::MAX_BEYOND {
            wrong.push(format!("case {k}, {}: {found:?}", case.family));
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn few_gaussians_render_like_on_the_cpu() {
    let Some(mut renderer) = renderer() else { return };
    // 1500 comes first, so that stale buffers would show.
    for num_gaussians in [1500, 1, 0, 12] {
        let mut scene = scene(Recipe { num_gaussians, ..Default::default() });
        if num_gaussians == 1 {
            (scene.gaussians.means[0], scene.gaussians.log_scales[0]) = ([0.1, -0.1, 2.0], [-1.5; 3]);
        }
        let expected = CpuRenderer::default().render(&scene, &camera(100, 60), 0.2, true).unwrap();
        let found = renderer.render(&scene, &camera(100, 60), 0.2, true).unwrap();
        compare::images(&found, &expected, WHOLE_CHAIN).unwrap();
        assert_eq!(found.planes.iter().any(|v| *v != 0.0), num_gaussians > 0);
    }
}

#[test]
fn two_runs_give_the_same_bytes_whatever_the_room_for_pairs() {
    let Some(mut renderer) = renderer() else { return };
    let scene = scene(Recipe { sh_degree: 2, ..Default::default() });
    let mut bytes = || renderer.render(&scene, &moved_camera(96, 80), 0.4, true).unwrap().planes;
    let first = bytes();
    assert_eq!(first, bytes());
    let Some(mut fresh) = self::renderer() else { return };
    fresh.set_pair_capacity(3).unwrap();
    assert_eq!(first, fresh.render(&scene, &moved_camera(96, 80), 0.4, true).unwrap().planes);
}

#[test]
fn a_changed_scene_is_noticed() {
    let Some(mut renderer) = renderer() else { return };
    let mut scene = scene(Recipe::default());
    let camera = camera(64, 48);
    let before = renderer.render(&scene, &camera, 0.4, false).unwrap();
    scene.gaussians.colours.iter_mut().for_each(|c| c[0] += 0.5);
    let after = renderer.render(&scene, &camera, 0.4, false).unwrap();
    assert_ne!(before, after);
    compare::images(
        &after,
        &CpuRenderer::default().render(&scene, &camera, 0.4, false).unwrap(),
        WHOLE_CHAIN,
    )
    .unwrap();
}

#[test]
fn a_damaged_scene_is_refused_and_the_next_one_renders() {
    let Some(mut renderer) = renderer() else { return };
    let good = scene(Recipe::default());
    let mut bad = good.clone();
    bad.deformation.weights.truncate(5);
    let message = renderer.render(&bad, &camera(64, 48), 0.4, true).unwrap_err().to_string();
    assert!(message.contains("deformation weights"), "{message}");
    renderer.render(&good, &camera(64, 48), 0.4, true).unwrap();
}

#[test]
fn an_image_too_large_for_the_adapter_is_refused_in_plain_words() {
    let Some(mut renderer) = renderer() else { return };
    let scene = scene(Recipe { num_gaussians: 1, ..Default::default() });
    let limit = renderer.gpu().device().limits().max_storage_buffer_binding_size;
    let side = ((limit / 16) as f64).sqrt() as u32 + 64;
    let error = renderer.render(&scene, &camera(side, side), 0.4, true).unwrap_err();
    assert!(error.to_string().contains("image planes") && error.remedy() == Some(Remedy::UseCpu), "{error}");
    assert_eq!(renderer.render(&scene, &camera(0, 5), 0.4, true).unwrap().planes, Vec::<f32>::new());
}

#[test]
fn a_lost_device_is_reported_again_and_again() {
    if gpu().is_none() {
        return;
    }
    // The test has a device of its own, because those of other tests must stay alive.
    let own = Gpu::open(AdapterChoice::Any).unwrap();
    let mut renderer = GpuRenderer::new(own.clone()).unwrap();
    let scene = scene(Recipe { num_gaussians: 50, ..Default::default() });
    renderer.render(&scene, &camera(32, 32), 0.4, false).unwrap();
    own.device().destroy();
    for _ in 0..2 {
        let error = renderer.render(&scene, &camera(32, 32), 0.4, false).unwrap_err();
        assert!(error.to_string().contains("lost") && error.remedy() == Some(Remedy::UseCpu), "{error}");
    }
}

#[test]
fn a_device_that_does_not_answer_is_lost() {
    if gpu().is_none() {
        return;
    }
    let mut own = Gpu::open(AdapterChoice::Any).unwrap();
    let scene = scene(Recipe::default());
    // No device can answer in zero time.
    own.set_patience(Duration::ZERO);
    let mut renderer = GpuRenderer::new(own.clone()).unwrap();
    for _ in 0..2 {
        let error = renderer.render(&scene, &camera(1600, 1200), 0.4, true).unwrap_err();
        assert!(
            error.to_string().contains("did not answer") && error.remedy() == Some(Remedy::UseCpu),
            "{error}"
        );
    }
    assert!(own.loss().unwrap().hangs);
}

#[test]
fn a_million_gaussians_render_like_the_f64_twin() {
    let Some(mut renderer) = renderer() else { return };
    let case = stress::a_million();
    let images = renderer.render(&case.scene, &case.camera, case.time, true).unwrap();
    let found = stress::compare(&images, &case);
    assert!(found.not_finite == 0 && found.beyond <= stress::MAX_BEYOND, "{found:?}");
}
