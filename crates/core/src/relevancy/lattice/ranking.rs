//! The best rivals at every vertex, for all prompts of a scene at once.

use super::{
    super::{Folded, Rivals},
    VERTICES_AT_ONCE,
    tree::Tree,
};
use crate::num;
use half::{f16, slice::HalfFloatSliceExt};
use ndarray::{Array2, ArrayView2};
use rayon::prelude::*;
use std::sync::Arc;

/// Number of rivals that are kept per vertex. A prompt that is an ally of all of them needs one more
/// comparison with every rival there.
const KEPT: usize = 4;

/// A rival and its cosine with a vertex.
type Ranked = (u16, f32);

/// The nearest rivals of each vertex, which grow with the tree.
pub(super) struct Ranking {
    rivals: Arc<Rivals>,
    /// Embeddings in the form of the tree's, [rivals, rank].
    rows: Array2<f32>,
    /// [vertices][`kept`], the best first.
    best: Vec<Ranked>,
    /// Number of rivals per vertex.
    kept: usize,
}

impl Ranking {
    pub(super) fn new(rivals: &Arc<Rivals>, folded: &Folded) -> Self {
        let kept = rivals.len().min(KEPT);
        Self { rivals: rivals.clone(), rows: folded.rival_rows(rivals), best: Vec::new(), kept }
    }

    pub(super) fn is_of(&self, rivals: &Arc<Rivals>) -> bool {
        Arc::ptr_eq(&self.rivals, rivals) || self.rivals == *rivals
    }

    /// Ranks the rivals at new vertices of the tree.
    pub(super) fn update(&mut self, tree: &Tree) {
        let (rank, kept) = (tree.rank().max(1), self.kept.max(1));
        let parts: Vec<Vec<Ranked>> = tree
            .embeddings_from(self.best.len() / kept)
            .par_chunks(VERTICES_AT_ONCE * rank)
            .map(|part| self.ranked(part, rank))
            .collect();
        self.best.extend(parts.into_iter().flatten());
    }

    /// The `kept` nearest rivals of each vertex.
    fn ranked(&self, embeddings: &[f16], rank: usize) -> Vec<Ranked> {
        let mut wide = vec![0.0; embeddings.len()];
        embeddings.convert_to_f32_slice(&mut wide);
        let Ok(vertices) = ArrayView2::from_shape((wide.len() / rank, rank), &wide) else {
            return Vec::new();
        };
        let mut ranked = Vec::with_capacity(vertices.nrows() * self.kept);
        for cosines in vertices.dot(&self.rows.t()).outer_iter() {
            let start = ranked.len();
            for (k, &cosine) in cosines.iter().enumerate() {
                let last = ranked.len() - start == self.kept;
                if last && ranked.last().is_some_and(|worst: &Ranked| cosine <= worst.1) {
                    continue;
                }
                let place = ranked[start..].partition_point(|other: &Ranked| other.1 >= cosine);
                if last {
                    ranked.pop();
                }
                ranked.insert(start + place, (k as u16, cosine));
            }
        }
        ranked
    }

    /// Largest cosine of a vertex (its number and its embedding) with a rival that is not among `allies`.
    pub(super) fn best(&self, vertex: usize, embedding: &[f32], allies: &[usize]) -> Option<f32> {
        let ranked = &self.best[vertex * self.kept..(vertex + 1) * self.kept];
        let known = ranked.iter().find(|(k, _)| !allies.contains(&usize::from(*k)));
        known.map(|(_, cosine)| *cosine).or_else(|| {
            let others =
                (0..self.rows.nrows()).filter(|k| !allies.contains(k) && self.kept < self.rivals.len());
            let cosine = |k: usize| self.rows.row(k).to_slice().map(|row| num::dot(row, embedding));
            others.filter_map(cosine).reduce(f32::max)
        })
    }
}
