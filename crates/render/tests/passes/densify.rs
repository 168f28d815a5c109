//! Both backends make the same decisions from the same numbers.

use crate::{
    fixture::{Recipe, gpu, numbers, scene},
    train::close_as_a_whole,
};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use surgtpgs_core::{
    deform::BasisShape,
    train::{Adam, Context, Densify, Model, Profile, TrainBackend, TrainSettings, densify},
};
use surgtpgs_render::GpuBackend;

/// A model in the middle of training. Moments and statistics are arbitrary. Some Gaussians were never
/// seen, some are pulled equally, some have faded or are not finite.
pub(crate) fn trained(recipe: Recipe) -> Model {
    let rng = &mut ChaCha8Rng::seed_from_u64(5);
    let scene = scene(recipe);
    let mut model = Model::new((*scene.gaussians).clone(), (*scene.deformation).clone());
    let o = &mut model.optimiser;
    let single = [&mut o.rest, &mut o.sh_rest, &mut o.features];
    let all = single.into_iter().chain(&mut o.bases).chain(o.own_bases.iter_mut().flatten());
    for Adam { first, second, .. } in all {
        *first = numbers(rng, first.len(), 0.1);
        *second = (0..second.len()).map(|_| rng.random_range(0.0..0.1)).collect();
    }
    // The last number of a row at rest is padding, on the device as well.
    o.rest.first.chunks_exact_mut(16).for_each(|row| row[14..].fill(0.0));
    o.rest.second.chunks_exact_mut(16).for_each(|row| row[14..].fill(0.0));
    for i in 0..recipe.num_gaussians {
        model.statistics.seen[i] = if i % 13 == 0 { 0 } else { rng.random_range(1..9) };
        let pull: f32 = if i % 7 == 0 { 0.25 } else { rng.random() };
        model.statistics.pull[i] = pull * model.statistics.seen[i] as f32;
    }
    model.gaussians.opacity_logits.iter_mut().step_by(19).for_each(|o| *o = -6.0);
    model.gaussians.means[3][1] = f32::NAN;
    model.gaussians.log_scales[4][2] = f32::INFINITY;
    model.gaussians.opacity_logits[5] = f32::NAN;
    model
}

fn settings_of(profile: Profile) -> TrainSettings {
    let mut settings = TrainSettings::of(profile);
    settings.densify.growth = 0.3;
    // Some of the pulled Gaussians are below this threshold.
    settings.densify.threshold *= 2000.0;
    settings
}

fn on_device(gpu: surgtpgs_render::Gpu, model: &Model, settings: &TrainSettings, how: &Densify) -> Model {
    let mut model = model.clone();
    let context = Context { settings, latents: &[], typical_depth: 3.0, world_per_px: 0.05 };
    let mut backend = GpuBackend::new(gpu).unwrap();
    backend.densify(&mut model, how, &context).unwrap();
    assert!(backend.num_gaussians(&model) > 0);
    backend.finish(&mut model, &context).unwrap();
    model
}

fn compare(found: &Model, expected: &Model) {
    let (g, e) = (&found.gaussians, &expected.gaussians);
    assert_eq!(g.len(), e.len());
    // The copied arrays show which rows are the parents.
    assert!(g.features == e.features && g.sh_rest == e.sh_rest && g.colours == e.colours);
    assert!(g.rotations == e.rotations);
    assert!(found.deformation == expected.deformation);
    assert!(found.optimiser == expected.optimiser);
    assert!(found.statistics == expected.statistics);
    close_as_a_whole("means", g.means.as_flattened(), e.means.as_flattened(), 1e-6);
    close_as_a_whole("log-scales", g.log_scales.as_flattened(), e.log_scales.as_flattened(), 1e-6);
    close_as_a_whole("opacities", &g.opacity_logits, &e.opacity_logits, 1e-5);
}

#[test]
fn the_same_are_kept_and_parted_on_both_backends() {
    let Some(gpu) = gpu() else { return };
    let shared = Recipe { num_gaussians: 1700, sh_degree: 1, ..Recipe::default() };
    let own = Recipe { is_shared: false, shape: BasisShape::Quartic, latent_dim: 7, ..shared };
    for recipe in [shared, Recipe { latent_dim: 0, sh_degree: 0, ..shared }, own] {
        for profile in [Profile::Default, Profile::Paper] {
            let (before, settings) = (trained(recipe), settings_of(profile));
            for budget in [1500, 1650, 5000] {
                let how = Densify::new(&settings, budget, 0.05, 300);
                let mut expected = before.clone();
                densify(&mut expected, &how);
                let n = expected.gaussians.len();
                assert!(n <= budget.max(1700) && n != 1700, "{n}");
                compare(&on_device(gpu.clone(), &before, &settings, &how), &expected);
            }
        }
    }
}

#[test]
fn nothing_is_left_of_faded_gaussians() {
    let Some(gpu) = gpu() else { return };
    let mut before = trained(Recipe { num_gaussians: 300, ..Recipe::default() });
    before.gaussians.opacity_logits.fill(-9.0);
    before.gaussians.opacity_logits[0] = 1.0;
    let settings = settings_of(Profile::Default);
    let how = Densify::new(&settings, 1000, 0.05, 300);
    let mut expected = before.clone();
    densify(&mut expected, &how);
    assert_eq!(expected.gaussians.len(), 1);
    compare(&on_device(gpu, &before, &settings, &how), &expected);
}

#[test]
#[should_panic(expected = "optimiser")]
fn another_decision_is_noticed() {
    let before = trained(Recipe::default());
    let how = Densify::new(&settings_of(Profile::Default), 5000, 0.05, 300);
    let (mut one, mut other) = (before.clone(), before);
    densify(&mut one, &how);
    // One moment is changed that should have started afresh.
    densify(&mut other, &how);
    let last = other.optimiser.rest.first.len() - 16;
    other.optimiser.rest.first[last] = 1e-3;
    compare(&one, &other);
}
