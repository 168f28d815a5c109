//! The exact rung, and its common part with the folded one: decode every point, compare it with every text.

use super::{Points, Query, Relevancy, RelevancySettings, query::TextRows};
use crate::{
    codec::{Codec, Linear, apply, normalise_rows},
    num,
};
use ndarray::{Array2, Axis, concatenate, s};
use rayon::prelude::*;

/// Number of points that one thread decodes at once.
const POINTS_AT_ONCE: usize = 1024;

/// Decodes every pixel; the truth that the other rungs are measured against.
pub struct Exact {
    /// Codec of the scene.
    pub codec: Codec,
}

impl Exact {
    /// Makes the rung for a scene's codec.
    pub fn new(codec: Codec) -> Self {
        Self { codec }
    }
}

impl Relevancy for Exact {
    fn name(&self) -> &'static str {
        "exact"
    }

    fn score_points(
        &mut self,
        points: &Points<'_>,
        queries: &[Query],
        settings: &RelevancySettings,
    ) -> Vec<Vec<f32>> {
        let texts: Vec<_> = queries.iter().map(|q| q.rows(&self.codec, settings.temperature)).collect();
        score_by_decoding(&self.codec.decoder, points, &texts, settings.temperature)
    }
}

/// Scores of every point for each query's texts (`None` scores 0). `layers` turn latents into
/// vectors whose cosines with the texts count.
pub(super) fn score_by_decoding(
    layers: &[Linear],
    points: &Points<'_>,
    texts: &[Option<TextRows>],
    temperature: f32,
) -> Vec<Vec<f32>> {
    let mut scores = vec![vec![0.0; points.len()]; texts.len()];
    let views: Vec<_> = texts.iter().flatten().map(|t| t.rows.view()).collect();
    let latent_dim = layers.first().map_or(0, |l| l.weight.ncols());
    let Ok(rows) = concatenate(Axis(0), &views) else { return scores };
    if points.latent_dim() != latent_dim {
        return scores;
    }
    let chunks: Vec<(Vec<usize>, Array2<f32>)> = (0..points.len().div_ceil(POINTS_AT_ONCE))
        .into_par_iter()
        .map(|chunk| {
            let first = chunk * POINTS_AT_ONCE;
            let numbers = first..(first + POINTS_AT_ONCE).min(points.len());
            let mut latents = Vec::with_capacity(numbers.len() * latent_dim);
            let live: Vec<usize> = numbers.filter(|&i| points.push_latent(i, &mut latents)).collect();
            let latents = Array2::from_shape_vec((live.len(), latent_dim), latents).unwrap_or_default();
            let cosines = normalise_rows(apply(layers, latents.view())).dot(&rows.t());
            (live, cosines)
        })
        .collect();
    for (live, cosines) in chunks {
        let mut column = 0;
        for (text, out) in texts.iter().zip(&mut scores) {
            let Some(text) = text else { continue };
            let own = cosines.slice(s![.., column..column + text.rows.nrows()]);
            column += text.rows.nrows();
            for (&i, row) in live.iter().zip(own.outer_iter()) {
                out[i] = num::sigmoid(temperature * text.margin(&row.to_vec(), None));
            }
        }
    }
    scores
}
