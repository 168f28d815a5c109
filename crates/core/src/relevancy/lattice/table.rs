//! Scores of one prompt in every cell.

use super::{
    super::{Folded, Query, query::TextRows},
    VERTICES_AT_ONCE,
    ranking::Ranking,
    tree::{Tree, midpoint_error, polynomial},
};
use half::{f16, slice::HalfFloatSliceExt};
use ndarray::ArrayView2;
use rayon::prelude::*;

/// Margins of one prompt at one temperature, extended as the tree grows.
pub(super) struct ScoreTable {
    query: Query,
    /// Texts of the query without its rivals, in the form of the tree's embeddings; `None` if they do not fit.
    texts: Option<TextRows>,
    pub(super) temperature: f32,
    /// Margin at each vertex.
    margins: Vec<f32>,
    /// Margin within each leaf, see [`polynomial`]; NaN in a leaf that must not be interpolated.
    pub(super) polynomials: Vec<[f32; 8]>,
    /// Largest score error at the midpoints of the leaves that are interpolated.
    pub(super) max_error: f32,
}

impl ScoreTable {
    pub(super) fn new(query: &Query, folded: &Folded, temperature: f32) -> Self {
        let (query, texts) = (query.clone(), folded.own_rows(query, temperature));
        Self { query, texts, temperature, margins: Vec::new(), polynomials: Vec::new(), max_error: 0.0 }
    }

    pub(super) fn is_for(&self, query: &Query, temperature: f32) -> bool {
        self.temperature == temperature && self.query == *query
    }

    /// Tabulates new cells of the tree and cuts cells whose interpolation is off by more than `tolerance`.
    /// `rankings` are up to date.
    pub(super) fn update(&mut self, tree: &mut Tree, rankings: &[Ranking], tolerance: f32) {
        let ranking = rankings.iter().find(|r| r.is_of(&self.query.rivals));
        let rank = tree.rank().max(1);
        let known = self.margins.len();
        let parts: Vec<Vec<f32>> = tree
            .embeddings_from(known)
            .par_chunks(VERTICES_AT_ONCE * rank)
            .enumerate()
            .map(|(k, part)| self.margins_of(known + k * VERTICES_AT_ONCE, part, rank, ranking))
            .collect();
        self.margins.extend(parts.into_iter().flatten());

        let first = self.polynomials.len();
        let margins = &self.margins;
        let fresh: Vec<([f32; 8], f32)> = tree.leaves()[first..]
            .par_iter()
            .map(|leaf| {
                let corners = leaf.corners.map(|v| margins[v as usize]);
                let midpoints = leaf.midpoints.map(|v| margins[v as usize]);
                (polynomial(&corners), midpoint_error(&corners, &midpoints, self.temperature, tolerance))
            })
            .collect();
        for (i, (polynomial, error)) in fresh.into_iter().enumerate() {
            if error <= tolerance {
                self.polynomials.push(polynomial);
                self.max_error = if error > self.max_error { error } else { self.max_error };
            } else {
                self.polynomials.push([f32::NAN; 8]);
                tree.split(first + i);
            }
        }
    }

    /// Margins of vertices from number `first` on.
    fn margins_of(
        &self,
        first: usize,
        embeddings: &[f16],
        rank: usize,
        ranking: Option<&Ranking>,
    ) -> Vec<f32> {
        let mut wide = vec![0.0; embeddings.len()];
        embeddings.convert_to_f32_slice(&mut wide);
        let Ok(rows) = ArrayView2::from_shape((wide.len() / rank, rank), &wide) else { return Vec::new() };
        let Some(texts) = &self.texts else { return vec![f32::NAN; rows.nrows()] };
        let cosines = rows.dot(&texts.rows.t());
        let margin = |(k, embedding): (usize, &[f32])| {
            let rival = ranking.and_then(|r| r.best(first + k, embedding, &self.query.allies));
            cosines.row(k).to_slice().map_or(f32::NAN, |own| texts.margin(own, rival))
        };
        wide.chunks_exact(rank).enumerate().map(margin).collect()
    }
}
