//! Compares the rungs with each other and with the written formula, on features like those of renderings.

use super::*;
use crate::codec::{CodecKind, CodecSettings, normalise_rows};
use crate::num;
use crate::progress::unobserved;
use crate::raster::{ALPHA_PLANE, FEATURE_PLANE};
use ndarray::{Array2, Axis};
use proptest::prelude::*;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::sync::{Arc, LazyLock};

const DIM: usize = 64;
const CLASSES: usize = 8;

fn normal(rng: &mut ChaCha8Rng) -> f32 {
    (0..12).map(|_| rng.random::<f32>()).sum::<f32>() - 6.0
}

/// Unit rows with cosines near `cosine`.
fn alike_rows(n: usize, cosine: f32, seed: u64) -> Array2<f32> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut unit = |n| normalise_rows(Array2::from_shape_simple_fn((n, DIM), || normal(&mut rng)));
    let shared = unit(1);
    normalise_rows(unit(n) * (1.0 - cosine).sqrt() + shared * cosine.sqrt())
}

type World = (Codec, Array2<f32>, Vec<(String, Vec<f32>)>);

/// A codec trained on class rows, those rows, and phrases of the same "encoder".
static WORLD: LazyLock<World> = LazyLock::new(|| {
    let rows = alike_rows(CLASSES + 4, 0.85, 11);
    let phrases = ["object", "things", "stuff", "texture"].iter().enumerate();
    let phrases = phrases.map(|(i, p)| (p.to_string(), rows.row(CLASSES + i).to_vec())).collect();
    let classes = rows.select(Axis(0), &(0..CLASSES).collect::<Vec<_>>());
    let settings = CodecSettings { kind: CodecKind::Network, latent_dim: 3, steps: 1000, seed: 0 };
    let codec = Codec::train(classes.view(), &[1.0; CLASSES], &settings, &mut unobserved).unwrap();
    (codec, classes, phrases)
});

fn classes() -> Arc<Rivals> {
    static CLASSES: LazyLock<Arc<Rivals>> = LazyLock::new(|| {
        let rows: Vec<(String, Vec<f32>)> =
            WORLD.1.outer_iter().enumerate().map(|(k, row)| (format!("class {k}"), row.to_vec())).collect();
        Rivals::new(rows.iter().map(|(name, row)| (name.as_str(), row.as_slice())))
    });
    CLASSES.clone()
}

/// A prompt against the phrases and all classes but `own`.
fn query(prompt: &str, embedding: Vec<f32>, own: &[usize]) -> Query {
    Query::new(prompt, embedding).but_not(WORLD.2.clone()).among(&classes(), own.to_vec())
}

/// A prompt for class `k`, a little off its embedding.
fn query_for(k: usize) -> Query {
    let off = alike_rows(1, 0.0, 500 + k as u64);
    let row = &WORLD.1.row(k) + &(off.row(0).to_owned() * 0.15);
    query(&format!("class {k}"), num::normalised(&row.to_vec()).unwrap(), &[k])
}

/// Features like those of renderings: soft discs of class latents with noise, varying alpha, and holes.
fn rendered(codec: &Codec, width: usize, height: usize, noise: f32, seed: u64) -> Images {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let latents = codec.encode(WORLD.1.view());
    let dim = codec.latent_dim();
    let discs: Vec<[f32; 4]> = (0..14)
        .map(|i| {
            let (w, h) = (width as f32, height as f32);
            [
                rng.random::<f32>() * w,
                rng.random::<f32>() * h,
                (0.1 + 0.2 * rng.random::<f32>()) * w,
                (i % CLASSES) as f32,
            ]
        })
        .collect();
    let n = width * height;
    let mut planes = vec![0.0; (FEATURE_PLANE + dim) * n];
    for i in 0..n {
        let (x, y) = ((i % width) as f32, (i / width) as f32);
        let mut feature = latents.row(0).to_vec();
        for &[cx, cy, radius, class] in &discs {
            let share = num::sigmoid((radius - (x - cx).hypot(y - cy)) / 1.5);
            for (f, l) in feature.iter_mut().zip(latents.row(class as usize)) {
                *f = *f * (1.0 - share) + l * share;
            }
        }
        let alpha = if x < 6.0 { 0.2 } else { 0.9 + 0.1 * rng.random::<f32>() };
        planes[ALPHA_PLANE * n + i] = alpha;
        for (k, f) in feature.iter().enumerate() {
            planes[(FEATURE_PLANE + k) * n + i] = alpha * (f + noise * normal(&mut rng));
        }
    }
    Images { width, height, planes }
}

fn largest_difference(a: &[Grid<f32>], b: &[Grid<f32>]) -> f32 {
    let pairs = a.iter().zip(b).flat_map(|(a, b)| a.data.iter().zip(&b.data));
    pairs.map(|(a, b)| (a - b).abs()).fold(0.0, |worst, d| if d > worst { d } else { worst })
}

#[test]
fn score_is_the_smallest_pairwise_softmax() {
    let (codec, _, _) = &*WORLD;
    let settings = RelevancySettings::default();
    let images = rendered(codec, 24, 16, 0.05, 1);
    let q = query_for(2);
    let scores = Exact::new(codec.clone()).score(&images, std::slice::from_ref(&q), &settings);
    let points = Points::of_images(&images, settings.min_alpha);
    for i in (6..24 * 16).filter(|i| i % 24 >= 6 && points.push_latent(*i, &mut Vec::new())) {
        let alpha = images.plane(ALPHA_PLANE)[i];
        let latent = Array2::from_shape_fn((1, 3), |(_, k)| images.plane(FEATURE_PLANE + k)[i] / alpha);
        let feature = codec.decode(latent.view()).row(0).to_vec();
        let p = f64::from(num::dot(&feature, &q.meant[0]));
        let softmax = |n: f64| (10.0 * p).exp() / ((10.0 * p).exp() + (10.0 * n).exp());
        let expected = q
            .texts()
            .skip(1)
            .map(|n| softmax(f64::from(num::dot(&feature, n))))
            .fold(f64::INFINITY, f64::min);
        assert!((f64::from(scores[0].data[i]) - expected).abs() < 1e-5);
    }
}

#[test]
fn folding_changes_nothing_and_saves_the_rank() {
    let (codec, _, _) = &*WORLD;
    let settings = RelevancySettings::default();
    let images = rendered(codec, 64, 48, 0.08, 2);
    let queries = [query_for(0), query_for(3)];
    let exact = Exact::new(codec.clone()).score(&images, &queries, &settings);
    let mut folded = Folded::new(codec.clone());
    assert!(folded.rank() <= CLASSES, "rank {}", folded.rank());
    let difference = largest_difference(&exact, &folded.score(&images, &queries, &settings));
    assert!(difference <= 1e-4, "{difference}");
}

#[test]
fn lattice_keeps_its_promise_over_frames_and_prompts() {
    let (codec, _, _) = &*WORLD;
    let settings = RelevancySettings::default();
    let (mut exact, mut lattice) = (Exact::new(codec.clone()), Lattice::new(codec).unwrap());
    for frame in 0..3 {
        let images = rendered(codec, 96, 80, 0.05, 20 + frame);
        let queries = [query_for(frame as usize), query_for(5)];
        let truth = exact.score(&images, &queries, &settings);
        let difference = largest_difference(&truth, &lattice.score(&images, &queries, &settings));
        assert!(difference <= 1.0 / 255.0, "frame {frame}: {difference}, {:?}", lattice.report());
    }
    let report = lattice.report();
    assert!(report.cells > 100 && report.max_midpoint_error <= 0.5 / 255.0, "{report:?}");
    assert!(report.decoded_points < 96 * 80 / 20, "{report:?}");
}

#[test]
fn lattice_tabulates_a_full_rank_autoencoder_too() {
    let rows = alike_rows(90, 0.6, 3);
    let settings = CodecSettings { kind: CodecKind::Network, latent_dim: 3, steps: 60, seed: 0 };
    let codec = Codec::train(rows.view(), &[1.0; 90], &settings, &mut unobserved).unwrap();
    let images = rendered(&codec, 64, 48, 0.02, 4);
    let queries = [query("any", rows.row(17).to_vec(), &[])];
    let settings = RelevancySettings::default();
    let truth = Exact::new(codec.clone()).score(&images, &queries, &settings);
    let mut lattice = Lattice::new(&codec).unwrap();
    let difference = largest_difference(&truth, &lattice.score(&images, &queries, &settings));
    assert!(difference <= 1.0 / 255.0, "{difference} {:?}", lattice.report());
}

/// Checks that the comparison above can fail: a lattice of another codec is far off.
#[test]
fn the_comparison_of_rungs_can_fail() {
    let (codec, _, _) = &*WORLD;
    let settings = RelevancySettings::default();
    let images = rendered(codec, 48, 32, 0.05, 5);
    let mut other = codec.clone();
    other.decoder[6].weight.row_mut(7).mapv_inplace(|w| w * 1.5);
    let queries = [query_for(1)];
    let a = Exact::new(codec.clone()).score(&images, &queries, &settings);
    let b = Lattice::new(&other).unwrap().score(&images, &queries, &settings);
    assert!(largest_difference(&a, &b) > 1.0 / 255.0);
}

fn every_rung() -> Vec<Box<dyn Relevancy>> {
    rungs(&WORLD.0)
}

fn rungs(codec: &Codec) -> Vec<Box<dyn Relevancy>> {
    vec![
        Box::new(Exact::new(codec.clone())),
        Box::new(Folded::new(codec.clone())),
        Box::new(Lattice::new(codec).unwrap()),
    ]
}

#[test]
fn holes_and_broken_features_are_never_found() {
    let mut images = rendered(&WORLD.0, 32, 16, 0.05, 6);
    let n = 32 * 16;
    for (i, bad) in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, 1e30, f32::MAX].into_iter().enumerate() {
        images.planes[FEATURE_PLANE * n + 10 + i] = bad;
        images.planes[ALPHA_PLANE * n + 42 + i] = [f32::NAN, 0.0, -1.0, 0.499, f32::NEG_INFINITY][i];
    }
    for rung in &mut every_rung() {
        let scores = rung.score(&images, &[query_for(0)], &RelevancySettings::default());
        let data = &scores[0].data;
        assert!(data.iter().all(|s| (0.0..=1.0).contains(s)), "{}", rung.name());
        assert!((0..n).filter(|i| i % 32 < 6).all(|i| data[i] == 0.0), "{}: holes", rung.name());
        assert!(
            data[10..13].iter().chain(&data[42..47]).all(|&s| s == 0.0),
            "{}: {:?}",
            rung.name(),
            &data[10..13]
        );
    }
}

#[test]
fn what_learned_no_feature_is_never_found() {
    let class = WORLD.0.encode(WORLD.1.view()).row(0).to_vec();
    let shortened = |share: f32| class.iter().map(move |v| share * Points::MIN_LENGTH * v);
    let latents: Vec<f32> = [0.0, 0.9, 1.1].into_iter().flat_map(shortened).collect();
    let queries: Vec<Query> = (0..CLASSES).map(query_for).collect();
    for rung in &mut every_rung() {
        let points = Points::of_latents(&latents, 3);
        for scores in rung.score_points(&points, &queries, &RelevancySettings::default()) {
            assert!(scores[..2] == [0.0; 2] && scores[2] > 0.0, "{}: {scores:?}", rung.name());
        }
    }
}

#[test]
fn latents_outside_the_cube_are_decoded_exactly() {
    let latents: Vec<f32> = [[2.7, 0.2, 0.1], [-3.0, 2.0, 1.0], [0.3, 0.4, -2.9]].concat();
    let points = Points::of_latents(&latents, 3);
    let settings = RelevancySettings::default();
    let queries = [query_for(4)];
    let truth = Exact::new(WORLD.0.clone()).score_points(&points, &queries, &settings);
    let mut lattice = Lattice::new(&WORLD.0).unwrap();
    let found = lattice.score_points(&points, &queries, &settings);
    assert!(truth[0].iter().zip(&found[0]).all(|(a, b)| (a - b).abs() < 1e-4));
    assert_eq!((lattice.report().decoded_points, lattice.report().cells), (3, 0));
}

#[test]
fn prompts_do_not_depend_on_their_company() {
    let images = rendered(&WORLD.0, 48, 32, 0.05, 7);
    let settings = RelevancySettings::default();
    let queries: Vec<Query> = (0..4).map(query_for).collect();
    for (rung, alone) in every_rung().iter_mut().zip(&mut every_rung()) {
        let together = rung.score(&images, &queries, &settings);
        // The lattice is finer where another prompt required it, within its tolerance.
        let tolerance = if rung.name() == "lattice" { 1.0 / 255.0 } else { 1e-6 };
        let single = alone.score(&images, &queries[2..3], &settings);
        assert!(largest_difference(&together[2..3], &single) <= tolerance, "{}", rung.name());
        let twice = rung.score(&images, &[queries[1].clone(), queries[1].clone()], &settings);
        assert_eq!(twice[0], twice[1]);
        assert!(rung.score(&images, &[], &settings).is_empty());
    }
}

#[test]
fn each_class_is_found_where_it_is_and_an_absent_one_nowhere() {
    let (codec, _, _) = &*WORLD;
    let settings = RelevancySettings::default();
    // Only the classes 0..=4 are in the picture.
    let latents = codec.encode(WORLD.1.view());
    let flat: Vec<f32> = (0..5).flat_map(|k| latents.row(k).to_vec()).collect();
    let points = Points::of_latents(&flat, 3);
    let queries: Vec<Query> = (0..CLASSES).map(|k| query("x", WORLD.1.row(k).to_vec(), &[k])).collect();
    let scores = best(codec.clone()).score_points(&points, &queries, &settings);
    for (k, scores) in scores.iter().enumerate() {
        for (pixel, &score) in scores.iter().enumerate() {
            assert_eq!(score > settings.threshold, pixel == k, "class {k} at {pixel}: {score}");
        }
    }
}

#[test]
fn queries_of_another_encoder_are_refused_and_score_zero() {
    let images = rendered(&WORLD.0, 16, 8, 0.05, 8);
    let mut broken = query_for(0);
    broken.meant[0][3] = f32::NAN;
    let other = Query::new("liver", vec![0.1; 12]);
    assert!(other.check(&WORLD.0).unwrap_err().to_string().contains("12 numbers"));
    assert!(broken.check(&WORLD.0).is_err());
    for rung in &mut every_rung() {
        let scores = rung.score(
            &images,
            &[other.clone(), query_for(1), broken.clone()],
            &RelevancySettings::default(),
        );
        assert!(scores[0].data.iter().chain(&scores[2].data).all(|&s| s == 0.0));
        assert!(scores[1].data.iter().any(|&s| s > 0.0));
    }
}

#[test]
fn images_without_features_find_nothing() {
    let images = Images { width: 4, height: 2, planes: vec![1.0; 5 * 8] };
    for rung in &mut every_rung() {
        assert_eq!(rung.score(&images, &[query_for(0)], &RelevancySettings::default())[0].data, [0.0; 8]);
    }
}

#[test]
fn other_latent_sizes_use_the_folded_decoder() {
    let settings = CodecSettings { kind: CodecKind::Network, latent_dim: 5, steps: 2, seed: 0 };
    let codec = Codec::train(WORLD.1.view(), &[1.0; CLASSES], &settings, &mut unobserved).unwrap();
    assert_eq!(best(codec).name(), "folded");
    assert_eq!(best(WORLD.0.clone()).name(), "lattice");
}

#[test]
fn a_prompt_competes_with_all_rivals_but_its_allies() {
    let q = query("class 3", WORLD.1.row(3).to_vec(), &[3, 5]);
    let names: Vec<&str> = q.compared_with().collect();
    assert_eq!(names[..4], ["object", "things", "stuff", "texture"]);
    assert_eq!(names.len(), 4 + CLASSES - 2);
    assert!(!names.contains(&"class 3") && !names.contains(&"class 5"));
    let other_length: &[f32] = &[1.0];
    let rivals = Rivals::new([("a", &[1.0, 0.0][..]), ("b", other_length), ("c", &[]), ("d", &[0.0, 1.0])]);
    assert_eq!(rivals.len(), 2);
}

/// Rivals enough that only some are kept per vertex, and a prompt that is an ally of the nearest ones.
#[test]
fn hundreds_of_rivals_are_compared_exactly_whoever_is_an_ally() {
    let (codec, rows, _) = &*WORLD;
    let others = alike_rows(300, 0.85, 77);
    let names: Vec<String> = (0..300 + CLASSES).map(|k| k.to_string()).collect();
    let all: Vec<Vec<f32>> = rows.outer_iter().chain(others.outer_iter()).map(|r| r.to_vec()).collect();
    let rivals = Rivals::new(names.iter().map(String::as_str).zip(all.iter().map(Vec::as_slice)));
    let images = rendered(codec, 64, 48, 0.05, 21);
    for allies in
        [vec![2], (0..CLASSES).collect(), (0..CLASSES + 200).collect(), (0..CLASSES + 300).collect()]
    {
        let query = Query::new("class 2", rows.row(2).to_vec()).among(&rivals, allies);
        let [exact, folded, lattice] = &of_every_rung(codec, &images, &query)[..] else { panic!("three") };
        for i in 0..exact.len() {
            assert!((exact[i] - folded[i]).abs() < 1e-4 && (exact[i] - lattice[i]).abs() < 1.0 / 255.0);
        }
        assert!(exact.iter().any(|s| *s > 0.5));
    }
}

#[test]
fn no_score_is_above_the_certainty_and_without_a_meaning_all_are_0() {
    let images = rendered(&WORLD.0, 48, 32, 0.05, 22);
    let full = of_every_rung(&WORLD.0, &images, &query_for(2));
    let certainty = 0.5 * full[0].iter().copied().fold(0.0, f32::max);
    let limited = of_every_rung(&WORLD.0, &images, &Query { certainty, ..query_for(2) });
    for (rung, (full, limited)) in full.iter().zip(&limited).enumerate() {
        assert!(limited.iter().any(|s| *s > certainty - 1e-3), "rung {rung}");
        for (a, b) in full.iter().zip(limited) {
            assert!((a.min(certainty) - b).abs() < 1.0 / 255.0, "rung {rung}: {a} {b}");
        }
    }
    let nothing = Query { meant: Vec::new(), ..query_for(2) };
    assert!(of_every_rung(&WORLD.0, &images, &nothing).iter().flatten().all(|s| *s < 1e-6));
    for certainty in [0.0, -3.0, f32::NAN] {
        let scores = of_every_rung(&WORLD.0, &images, &Query { certainty, ..query_for(2) });
        assert!(scores.iter().flatten().all(|s| *s < 1e-5), "{certainty}");
    }
}

proptest! {
    #[test]
    fn margin_is_prompt_minus_best_negative(values in proptest::collection::vec(-0.5_f32..0.5, 2..9)) {
        let unit = |v: f32| vec![v, (1.0 - v * v).sqrt()];
        let negatives = |rev: bool| -> Vec<(String, Vec<f32>)> {
            let mut all: Vec<_> = values[1..].iter().map(|v| (String::new(), unit(*v))).collect();
            if rev { all.reverse(); }
            all
        };
        let query = Query::new("x", unit(values[0]));
        let before = query.clone().but_not(negatives(false)).margin(&[1.0, 0.0], 1.0);
        prop_assert_eq!(before, query.but_not(negatives(true)).margin(&[1.0, 0.0], 1.0));
        let best = values[1..].iter().copied().fold(-1.0, f32::max);
        prop_assert_eq!(before, values[0] - best);
    }
}

/// Scores of every rung for the same picture and query.
fn of_every_rung(codec: &Codec, images: &Images, query: &Query) -> Vec<Vec<f32>> {
    let settings = RelevancySettings::default();
    let one = |mut rung: Box<dyn Relevancy>| {
        rung.score(images, std::slice::from_ref(query), &settings).remove(0).data
    };
    rungs(codec).into_iter().map(one).collect()
}

#[test]
fn prompts_along_and_against_a_phrase_or_without_direction_score_what_the_formula_says() {
    let (codec, _, phrases) = &*WORLD;
    let images = rendered(codec, 40, 30, 0.05, 9);
    let phrase = &phrases[0].1;
    let against: Vec<f32> = phrase.iter().map(|v| -v).collect();
    let ask = |embedding: Vec<f32>, negative: Vec<f32>| {
        let negatives = vec![("phrase".to_owned(), negative)];
        of_every_rung(codec, &images, &Query::new("odd", embedding).but_not(negatives))
    };
    let zero = vec![0.0; DIM];
    let cases = [
        ("along", ask(phrase.clone(), phrase.clone())),
        ("against", ask(against, phrase.clone())),
        ("a zero prompt", ask(zero.clone(), phrase.clone())),
        ("a zero phrase", ask(phrase.clone(), zero.clone())),
        ("both zero", ask(zero.clone(), zero)),
    ];
    let exact_of = |k: usize, i: usize| cases[k].1[0][i];
    for (name, scores) in &cases {
        let [exact, folded, lattice] = &scores[..] else { panic!("three rungs") };
        for i in 0..exact.len() {
            assert!((0.0..=1.0).contains(&exact[i]), "{name}: {}", exact[i]);
            assert!((exact[i] - folded[i]).abs() < 1e-4, "{name}, folded: {} {}", exact[i], folded[i]);
            assert!((exact[i] - lattice[i]).abs() < 1.0 / 255.0, "{name}: {} {}", exact[i], lattice[i]);
        }
    }
    let points = Points::of_images(&images, 0.5);
    let seen = (0..images.width * images.height).filter(|i| points.push_latent(*i, &mut Vec::new()));
    for i in seen {
        assert!((exact_of(0, i) - 0.5).abs() < 1e-5 && (exact_of(4, i) - 0.5).abs() < 1e-6);
        // sigmoid(-10 n) for no prompt, sigmoid(-20 n) for the opposite of the phrase, sigmoid(10 n) for
        // no phrase.
        let margin = num::logit(exact_of(2, i));
        assert!((num::sigmoid(2.0 * margin) - exact_of(1, i)).abs() < 1e-3);
        assert!((1.0 - exact_of(2, i) - exact_of(3, i)).abs() < 1e-4);
    }
}

#[test]
fn a_feature_that_decodes_to_nothing_prefers_nothing() {
    let (mut codec, ..) = WORLD.clone();
    let last = codec.decoder.last_mut().unwrap();
    last.weight.fill(0.0);
    last.bias.fill(0.0);
    let images = rendered(&WORLD.0, 20, 12, 0.0, 10);
    for (k, scores) in of_every_rung(&codec, &images, &query_for(1)).iter().enumerate() {
        let right = scores.iter().all(|s| *s == 0.0 || (s - 0.5).abs() < 1e-6);
        assert!(right && scores.contains(&0.0), "rung {k}: {scores:?}");
    }
}

#[test]
fn scores_do_not_depend_on_the_order_of_the_prompts() {
    let (codec, ..) = &*WORLD;
    let images = rendered(codec, 24, 16, 0.05, 11);
    let settings = RelevancySettings::default();
    let queries = [0, 1, 2].map(query_for);
    let turned = [2, 0, 1].map(query_for);
    for (mut first, mut second) in rungs(codec).into_iter().zip(rungs(codec)) {
        let scores = first.score(&images, &queries, &settings);
        let again = second.score(&images, &turned, &settings);
        for (k, from) in [2, 0, 1].into_iter().enumerate() {
            assert!(again[k].data == scores[from].data, "{}: prompt {from}", first.name());
        }
    }
}
