//! Compares scores of prompts on the GPU with the exact rung of core.

use crate::{
    compare::{self, Tolerance},
    fixture::{Recipe, camera, gpu, numbers, scene},
};
use ndarray::{Array1, Array2};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use surgtpgs_core::{
    codec::{Codec, Linear},
    raster::{CpuRenderer, Images, Renderer},
    relevancy::{Exact, Points, Query, Relevancy, RelevancySettings, Rivals},
};
use surgtpgs_render::GpuExact;

/// Tolerance for sums of some hundred terms of a few layers; the sigmoid multiplies a margin's error by
/// at most 10 / 4.
const SCORES: Tolerance = Tolerance { absolute: 2e-5, relative: 0.0 };

const DIM: usize = 70;

/// A decoder of odd widths, so that no tile of a layer is full.
pub(crate) fn codec(latent_dim: usize) -> Codec {
    let rng = &mut ChaCha8Rng::seed_from_u64(3);
    let mut layers = |widths: &[usize]| -> Vec<Linear> {
        let layer = |pair: &[usize]| {
            let size = (3.0 / pair[0] as f32).sqrt();
            Linear {
                weight: Array2::from_shape_vec((pair[1], pair[0]), numbers(rng, pair[0] * pair[1], size))
                    .unwrap(),
                bias: Array1::from(numbers(rng, pair[1], 0.2)),
            }
        };
        widths.windows(2).map(layer).collect()
    };
    Codec { encoder: layers(&[DIM, 20, latent_dim]), decoder: layers(&[latent_dim, 17, 130, 64, DIM]) }
}

pub(crate) fn query(prompt: &str, num_negatives: usize) -> Query {
    let rng = &mut ChaCha8Rng::seed_from_u64(prompt.len() as u64);
    let mut text = || surgtpgs_core::num::normalised(&numbers(rng, DIM, 1.0)).unwrap();
    let query = Query::new(prompt, text());
    query.but_not((0..num_negatives).map(|i| (format!("negative {i}"), text())).collect())
}

/// A prompt that means two texts, is not certain, and competes with rivals of which one is an ally.
pub(crate) fn uncertain() -> Query {
    let rng = &mut ChaCha8Rng::seed_from_u64(40);
    let mut text = || surgtpgs_core::num::normalised(&numbers(rng, DIM, 1.0)).unwrap();
    let meant = vec![text(), text()];
    let texts: Vec<Vec<f32>> = (0..9).map(|_| text()).collect();
    let rivals = Rivals::new(texts.iter().map(|text| ("rival", text.as_slice())));
    Query { meant, certainty: 0.4, ..query("tool", 1) }.among(&rivals, vec![3])
}

fn images(latent_dim: usize) -> Images {
    let scene = scene(Recipe { latent_dim, ..Default::default() });
    let mut images = CpuRenderer::default().render(&scene, &camera(120, 90), 0.3, true).unwrap();
    // One pixel has a feature that is not a number.
    let last = images.planes.len() - 45;
    images.planes[last] = f32::NAN;
    images
}

#[test]
fn scores_equal_those_of_the_cpu() {
    let Some(gpu) = gpu() else { return };
    for latent_dim in [3, 8] {
        let (codec, images) = (codec(latent_dim), images(latent_dim));
        let mut misfit = query("of another encoder", 1);
        misfit.meant[0].pop();
        let meaningless = Query { meant: Vec::new(), ..query("nothing", 2) };
        let queries =
            [query("liver", 4), query("grasper", 0), misfit, query("fat", 1), uncertain(), meaningless];
        let settings = RelevancySettings { min_alpha: 0.998, ..Default::default() };
        let expected = Exact::new(codec.clone()).score(&images, &queries, &settings);
        let found = GpuExact::new(&gpu, codec).unwrap().score(&images, &queries, &settings);
        for ((f, e), q) in found.iter().zip(&expected).zip(&queries) {
            compare::close(&q.prompt, &f.data, &e.data, SCORES).unwrap();
        }
        let holes = expected[0].data.iter().filter(|s| **s == 0.0).count();
        assert!(holes > 100 && holes < 120 * 90 - 1000, "{holes} holes");
        assert!(expected[2].data.iter().all(|s| *s == 0.0));
        assert!(expected[4].data.iter().any(|s| *s > 0.3) && expected[4].data.iter().all(|s| *s < 0.401));
        assert!(expected[5].data.iter().all(|s| *s < 1e-6));
    }
}

#[test]
fn more_points_than_fit_at_once_score_like_few() {
    let Some(gpu) = gpu() else { return };
    let rng = &mut ChaCha8Rng::seed_from_u64(5);
    let latents = numbers(rng, 3 * 20_000, 1.0);
    let mut exact = GpuExact::new(&gpu, codec(3)).unwrap();
    let queries = [query("liver", 4), query("fat", 2)];
    let settings = RelevancySettings::default();
    let mut score = |from: usize, to: usize| {
        let points = Points::of_latents(&latents[3 * from..3 * to], 3);
        exact.try_score_points(&points, &queries, &settings).unwrap()
    };
    let all = score(0, 20_000);
    let end = score(19_000, 20_000);
    for q in 0..2 {
        assert_eq!(all[q][19_000..], end[q]);
    }
}

#[test]
fn no_points_and_no_queries_give_no_scores() {
    let Some(gpu) = gpu() else { return };
    let mut exact = GpuExact::new(&gpu, codec(3)).unwrap();
    let settings = RelevancySettings::default();
    let nothing =
        exact.try_score_points(&Points::of_latents(&[], 3), &[query("liver", 1)], &settings).unwrap();
    assert_eq!(nothing, vec![Vec::<f32>::new()]);
    assert!(exact.try_score_points(&Points::of_latents(&[0.1; 3], 3), &[], &settings).unwrap().is_empty());
}

#[test]
fn a_codec_that_does_not_fit_together_is_refused() {
    let Some(gpu) = gpu() else { return };
    let mut broken = codec(3);
    broken.decoder.remove(1);
    assert!(GpuExact::new(&gpu, broken).is_err());
}
