//! Scores of one prompt in every cell.

use super::{
    super::{Query, margin},
    tree::{Tree, midpoint_error, polynomial},
};
use half::{f16, slice::HalfFloatSliceExt};
use ndarray::{Array2, ArrayView2};
use rayon::prelude::*;

/// Number of vertices that one thread compares with the texts at once.
const VERTICES_AT_ONCE: usize = 512;

/// Margins of one prompt at one temperature, extended as the tree grows.
pub(super) struct ScoreTable {
    query: Query,
    /// Texts of the query in the form of the tree's embeddings, the prompt first: [texts, rank].
    texts: Array2<f32>,
    pub(super) temperature: f32,
    /// Margin at each vertex.
    margins: Vec<f32>,
    /// Margin within each leaf, see [`polynomial`]; NaN in a leaf that must not be interpolated.
    pub(super) polynomials: Vec<[f32; 8]>,
    /// Largest score error at the midpoints of the leaves that are interpolated.
    pub(super) max_error: f32,
}

impl ScoreTable {
    pub(super) fn new(query: &Query, texts: Array2<f32>, temperature: f32) -> Self {
        let query = query.clone();
        Self { query, texts, temperature, margins: Vec::new(), polynomials: Vec::new(), max_error: 0.0 }
    }

    pub(super) fn is_for(&self, query: &Query, temperature: f32) -> bool {
        self.temperature == temperature && self.query == *query
    }

    /// Tabulates new cells of the tree and cuts cells whose interpolation is off by more than `tolerance`.
    pub(super) fn update(&mut self, tree: &mut Tree, tolerance: f32) {
        let rank = tree.rank().max(1);
        let parts: Vec<Vec<f32>> = tree
            .embeddings_from(self.margins.len())
            .par_chunks(VERTICES_AT_ONCE * rank)
            .map(|part| self.margins_of(part, rank))
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

    fn margins_of(&self, embeddings: &[f16], rank: usize) -> Vec<f32> {
        let mut wide = vec![0.0; embeddings.len()];
        embeddings.convert_to_f32_slice(&mut wide);
        let Ok(rows) = ArrayView2::from_shape((wide.len() / rank, rank), &wide) else { return Vec::new() };
        let cosines = rows.dot(&self.texts.t());
        cosines.outer_iter().map(|row| row.as_slice().map_or(f32::NAN, margin)).collect()
    }
}
