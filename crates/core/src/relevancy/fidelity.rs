//! Measures the losses of classes in the codec: if a feature is still nearest to its own class, if the
//! others keep their order, and if prompts decide as they would without compression.

use super::{Exact, Points, Query, Relevancy, RelevancySettings, Rivals};
use crate::{
    Result,
    codec::{Codec, normal},
    num,
};
use ndarray::{Array2, ArrayView1, ArrayView2};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

/// Standard deviation of the noise on each latent number, which imitates the effect of rendering on features.
const LATENT_NOISE: f32 = 0.1;
/// Number of noisy copies of each class.
const COPIES: usize = 100;

/// Measures of how well classes survive a codec. Everything but `order` and `score_error` is a share of
/// the classes or of the pairs of (prompt, feature).
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize)]
pub struct Fidelity {
    /// Classes whose decoded feature is nearest to their own embedding.
    pub top: f64,
    /// Classes whose feature, decoded from latents with noise of 0.1, is nearest to their own embedding.
    pub top_noisy: f64,
    /// Mean rank correlation (Spearman) of a decoded feature's cosines with all classes.
    pub order: f64,
    /// Classes whose prompt finds their own feature.
    pub found: f64,
    /// Classes whose prompt does not find any other class's feature.
    pub alone: f64,
    /// Pairs whose decision is the same as without compression.
    pub same: f64,
    /// Largest change of a score.
    pub score_error: f64,
}

/// Sends the classes' embeddings (`rows` [n, dim], unit) through `codec`, and queries each of them by its
/// embedding, against `phrases` and, depending on `settings`, all other classes.
///
/// Fails if the embeddings do not fit the codec.
pub fn fidelity(
    codec: &Codec,
    rows: ArrayView2<'_, f32>,
    phrases: &[(String, Vec<f32>)],
    settings: &RelevancySettings,
) -> Result<Fidelity> {
    let classes: Vec<(String, Vec<f32>)> =
        rows.outer_iter().enumerate().map(|(k, row)| (k.to_string(), row.to_vec())).collect();
    let listed = classes.iter().filter(|_| settings.class_negatives);
    let rivals = Rivals::new(listed.map(|(name, row)| (name.as_str(), row.as_slice())));
    let ask = |(k, (name, row)): (usize, &(String, Vec<f32>))| {
        Query::new(name, row.clone()).but_not(phrases.to_vec()).among(&rivals, vec![k])
    };
    let queries: Vec<Query> = classes.iter().enumerate().map(ask).collect();
    queries.iter().try_for_each(|query| query.check(codec))?;

    let latents = codec.encode(rows);
    let decoded = codec.decode(latents.view());
    let flat: Vec<f32> = latents.iter().copied().collect();
    let points = Points::of_latents(&flat, codec.latent_dim());
    let after = Exact::new(codec.clone()).score_points(&points, &queries, settings);
    let before: Vec<Vec<f32>> = queries.iter().map(|query| scores_of(rows, query, settings)).collect();
    let (found, alone) = decisions(&after, settings.threshold);
    let pairs = || after.iter().flatten().zip(before.iter().flatten());
    let same = pairs().filter(|(a, b)| (**a > settings.threshold) == (**b > settings.threshold));
    Ok(Fidelity {
        top: nearest_to_own(decoded.view(), rows, 1),
        top_noisy: nearest_to_own(codec.decode(noisy(&latents).view()).view(), rows, COPIES),
        order: mean_order(decoded.view(), rows),
        found,
        alone,
        same: same.count() as f64 / pairs().count().max(1) as f64,
        score_error: pairs().map(|(a, b)| f64::from((a - b).abs())).fold(0.0, f64::max),
    })
}

/// Scores of uncompressed features.
fn scores_of(rows: ArrayView2<'_, f32>, query: &Query, settings: &RelevancySettings) -> Vec<f32> {
    let score = |row: ArrayView1<'_, f32>| {
        let row = row.to_vec();
        num::sigmoid(settings.temperature * query.margin(&row, settings.temperature))
    };
    rows.outer_iter().map(score).collect()
}

/// Shares of the prompts that find their own feature, and that find no other, from `scores[prompt][feature]`.
fn decisions(scores: &[Vec<f32>], threshold: f32) -> (f64, f64) {
    let n = scores.len().max(1) as f64;
    let found = scores.iter().enumerate().filter(|(k, row)| row[*k] > threshold).count();
    let finds_another = |k: usize, row: &[f32]| row.iter().enumerate().any(|(j, s)| j != k && *s > threshold);
    let alone = scores.iter().enumerate().filter(|(k, row)| !finds_another(*k, row)).count();
    (found as f64 / n, alone as f64 / n)
}

/// [`COPIES`] noisy copies of each class.
fn noisy(latents: &Array2<f32>) -> Array2<f32> {
    let mut rng = ChaCha8Rng::seed_from_u64(9);
    let (n, dim) = latents.dim();
    Array2::from_shape_fn((n * COPIES, dim), |(i, c)| {
        latents[[i / COPIES, c]] + LATENT_NOISE * normal(&mut rng)
    })
}

/// Share of features whose largest cosine is that with their own class; each class has `copies` features
/// in a row.
fn nearest_to_own(features: ArrayView2<'_, f32>, rows: ArrayView2<'_, f32>, copies: usize) -> f64 {
    let cosines = features.dot(&rows.t());
    let is_nearest = |i: usize, cosines: ArrayView1<'_, f32>| {
        let own = i / copies;
        cosines.iter().enumerate().all(|(j, c)| j == own || *c < cosines[own])
    };
    let right = cosines.outer_iter().enumerate().filter(|(i, row)| is_nearest(*i, row.view())).count();
    right as f64 / features.nrows().max(1) as f64
}

/// Mean rank correlation of the cosines after and before the codec.
fn mean_order(decoded: ArrayView2<'_, f32>, rows: ArrayView2<'_, f32>) -> f64 {
    let (after, before) = (decoded.dot(&rows.t()), rows.dot(&rows.t()));
    let sum: f64 = after.outer_iter().zip(before.outer_iter()).map(|(a, b)| rank_correlation(a, b)).sum();
    sum / rows.nrows().max(1) as f64
}

/// Spearman's ρ; 1 for fewer than two values.
fn rank_correlation(a: ArrayView1<'_, f32>, b: ArrayView1<'_, f32>) -> f64 {
    let n = a.len() as f64;
    if n < 2.0 {
        return 1.0;
    }
    let squares: f64 = ranks(a).iter().zip(ranks(b)).map(|(a, b)| (*a as f64 - b as f64).powi(2)).sum();
    1.0 - 6.0 * squares / (n * (n * n - 1.0))
}

/// Rank of each value in ascending order.
fn ranks(values: ArrayView1<'_, f32>) -> Vec<usize> {
    let mut order: Vec<usize> = (0..values.len()).collect();
    order.sort_by(|&i, &j| values[i].total_cmp(&values[j]));
    let mut ranks = vec![0; order.len()];
    order.iter().enumerate().for_each(|(rank, &i)| ranks[i] = rank);
    ranks
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::codec::{CodecKind, CodecSettings, normalise_rows};
    use crate::progress::unobserved;
    use ndarray::{Axis, arr1};

    /// Rows that resemble text embeddings: a large part shared by all, a smaller one by each of three groups.
    fn clustered(n: usize, dim: usize) -> Array2<f32> {
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let mut directions = |n| normalise_rows(Array2::from_shape_simple_fn((n, dim), || normal(&mut rng)));
        let (shared, groups, own) = (directions(1), directions(3), directions(n));
        let groups = groups.select(Axis(0), &(0..n).map(|i| i % 3).collect::<Vec<_>>());
        normalise_rows(own * 0.45 + groups * 0.4 + shared * 0.8)
    }

    fn trained(rows: &Array2<f32>, latent_dim: usize) -> Codec {
        let settings = CodecSettings { kind: CodecKind::Network, latent_dim, steps: 800, seed: 0 };
        Codec::train(rows.view(), &vec![1.0; rows.nrows()], &settings, &mut unobserved).unwrap()
    }

    #[test]
    fn classes_in_clusters_survive_compression_to_three_numbers() {
        let rows = clustered(12, 64);
        let settings = RelevancySettings::default();
        for latent_dim in [3, 8] {
            let kept = fidelity(&trained(&rows, latent_dim), rows.view(), &[], &settings).unwrap();
            assert_eq!((kept.top, kept.found, kept.alone, kept.same), (1.0, 1.0, 1.0, 1.0), "{kept:?}");
            assert!(kept.top_noisy > 0.98 && kept.order > 0.95 && kept.score_error < 0.1, "{kept:?}");
        }
    }

    #[test]
    fn a_codec_for_other_classes_is_told_apart() {
        let rows = clustered(12, 64);
        let half = rows.select(Axis(0), &[0, 1, 2, 3, 4, 5]);
        let kept = fidelity(&trained(&half, 3), rows.view(), &[], &RelevancySettings::default()).unwrap();
        assert!(kept.top <= 0.75 && kept.same < 1.0, "{kept:?}");
        let short = clustered(4, 32);
        assert!(fidelity(&trained(&short, 3), rows.view(), &[], &RelevancySettings::default()).is_err());
    }

    #[test]
    fn decisions_and_ranks_are_counted_by_hand() {
        let scores = [vec![0.9, 0.1, 0.1], vec![0.5, 0.3, 0.1], vec![0.1, 0.7, 0.8]];
        assert_eq!(decisions(&scores, 0.4), (2.0 / 3.0, 1.0 / 3.0));
        let correlation = |a: [f32; 4], b: [f32; 4]| rank_correlation(arr1(&a).view(), arr1(&b).view());
        assert_eq!(correlation([0.1, 0.2, 0.3, 0.4], [1.0, 2.0, 3.0, 9.0]), 1.0);
        assert_eq!(correlation([0.1, 0.2, 0.3, 0.4], [9.0, 3.0, 2.0, 1.0]), -1.0);
    }
}
