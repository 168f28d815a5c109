//! The folded rung: the exact values with fewer operations, by folding the texts into the last layer.

use super::{
    Points, Query, Relevancy, RelevancySettings, Rivals, decoding::score_by_decoding, query::TextRows,
};
use crate::codec::{Codec, Linear};
use ndarray::{Array1, Array2};

/// Relative strength of a direction of the last layer below which it is rounding, not content.
const RANK_TOLERANCE: f64 = 1e-7;

/// Computes the exact rung's values without ever forming an embedding.
///
/// Let the last layer be y = A x, with x the hidden activations and a 1 for the bias. With A = Q R (Q
/// orthonormal) every cosine is y·t / ‖y‖ = (R x)·(Qᵀ t) / ‖R x‖: R takes the last layer's place and Qᵀ t
/// the text's. R has as many rows as A has rank: never more than hidden units + 1, and no more than there
/// are classes if the codec was trained on class names. (R is equal to the Cholesky factor of the Gram
/// matrix AᵀA, but is computed without squaring its condition.)
pub struct Folded {
    codec: Codec,
    /// Decoder with R as its last layer.
    pub(super) layers: Vec<Linear>,
    /// Q, [dim, rank].
    basis: Array2<f32>,
}

impl Folded {
    /// Folds the last layer of a scene's codec.
    pub fn new(codec: Codec) -> Self {
        let mut layers = codec.decoder.clone();
        let mut basis = Array2::zeros((codec.embedding_dim(), 0));
        if let Some(last) = layers.last_mut() {
            (basis, *last) = orthogonalise(last);
        }
        Self { codec, layers, basis }
    }

    /// Codec of the scene.
    pub(super) fn codec(&self) -> &Codec {
        &self.codec
    }

    /// Numbers per folded embedding.
    pub fn rank(&self) -> usize {
        self.basis.ncols()
    }

    /// Texts of a query as folded rows; `None` if they do not fit.
    pub(super) fn rows(&self, query: &Query, temperature: f32) -> Option<TextRows> {
        query.rows(&self.codec, temperature).map(|texts| texts.in_basis(&self.basis))
    }

    /// Texts of a query without its rivals as folded rows; `None` if any text does not fit.
    pub(super) fn own_rows(&self, query: &Query, temperature: f32) -> Option<TextRows> {
        query.own_rows(&self.codec, temperature).map(|texts| texts.in_basis(&self.basis))
    }

    /// Embeddings of rivals (which fit the codec) as folded rows.
    pub(super) fn rival_rows(&self, rivals: &Rivals) -> Array2<f32> {
        rivals.rows().dot(&self.basis)
    }
}

impl Relevancy for Folded {
    fn name(&self) -> &'static str {
        "folded"
    }

    fn score_points(
        &mut self,
        points: &Points<'_>,
        queries: &[Query],
        settings: &RelevancySettings,
    ) -> Vec<Vec<f32>> {
        let texts: Vec<_> = queries.iter().map(|q| self.rows(q, settings.temperature)).collect();
        score_by_decoding(&self.layers, points, &texts, settings.temperature)
    }
}

/// Factorises [W b] = Q R by Gram–Schmidt with column pivoting in f64: (Q, R as a layer).
fn orthogonalise(layer: &Linear) -> (Array2<f32>, Linear) {
    let (dim, hidden) = layer.weight.dim();
    let widen = |column: ndarray::ArrayView1<'_, f32>| column.mapv(f64::from);
    let mut columns: Vec<Array1<f64>> = layer.weight.columns().into_iter().map(widen).collect();
    columns.push(widen(layer.bias.view()));
    let mut basis: Vec<Array1<f64>> = Vec::new();
    let mut rows: Vec<Vec<f64>> = Vec::new();
    let mut strongest = 0.0;
    while basis.len() < dim.min(hidden + 1) {
        let lengths = columns.iter().map(|c| c.dot(c).sqrt()).enumerate();
        let Some((pivot, length)) = lengths.max_by(|a, b| a.1.total_cmp(&b.1)) else { break };
        strongest = f64::max(strongest, length);
        if length <= RANK_TOLERANCE * strongest {
            break;
        }
        let mut direction = &columns[pivot] / length;
        // A second pass against the earlier directions, which creep back in by rounding.
        for earlier in &basis {
            let along = earlier.dot(&direction);
            direction.scaled_add(-along, earlier);
        }
        direction /= direction.dot(&direction).sqrt();
        let row: Vec<f64> = columns.iter().map(|c| direction.dot(c)).collect();
        columns.iter_mut().zip(&row).for_each(|(c, &along)| c.scaled_add(-along, &direction));
        basis.push(direction);
        rows.push(row);
    }
    if basis.is_empty() {
        // A layer of zeros: texts and points are still compared, by one number without meaning.
        basis.push(Array1::zeros(dim));
        rows.push(vec![0.0; hidden + 1]);
    }
    let rank = basis.len();
    let q = Array2::from_shape_fn((dim, rank), |(i, k)| basis[k][i] as f32);
    let weight = Array2::from_shape_fn((rank, hidden), |(k, j)| rows[k][j] as f32);
    let bias = Array1::from_shape_fn(rank, |k| rows[k][hidden] as f32);
    (q, Linear { weight, bias })
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::arr2;

    #[test]
    fn orthogonal_factors_multiply_back_and_drop_what_is_dependent() {
        // The third column is the sum of the first two, the bias twice the first: rank 2.
        let weight = arr2(&[[1.0, 2.0, 3.0], [0.0, 1.0, 1.0], [4.0, 0.0, 4.0], [1.0, 1.0, 2.0]]);
        let layer = Linear { bias: weight.column(0).to_owned() * 2.0, weight };
        let (q, r) = orthogonalise(&layer);
        assert_eq!((q.dim(), r.weight.dim()), ((4, 2), (2, 3)));
        let difference = q.dot(&r.weight) - &layer.weight;
        assert!(difference.iter().all(|d| d.abs() < 1e-6));
        assert!((q.dot(&r.bias) - &layer.bias).iter().all(|d| d.abs() < 1e-6));
        assert!((q.t().dot(&q) - Array2::<f32>::eye(2)).iter().all(|d| d.abs() < 1e-6));
    }
}
