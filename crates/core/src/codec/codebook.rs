//! A codec in closed form for few rows: the latents of a feature are its shares of the rows.

use super::mlp::Linear;
use crate::{Error, Result, linear::Symmetric};
use ndarray::{Array1, Array2, ArrayView2};

/// Added to the diagonal of the Gram matrix, so that rows that are nearly alike can be told apart.
const RIDGE: f64 = 1e-4;

/// Makes a codec whose latent k is the share of row k (`rows` are [n ≤ 16, dim], unit). Returns the layers of
/// encoder and decoder.
///
/// The decoder is Σ_k w_k e_k, so that a pixel on the border of two classes decodes to a blend of the two,
/// never to a third one. The encoder is the least squares solution (E Eᵀ)⁻¹ E.
pub(super) fn codebook(rows: ArrayView2<'_, f32>) -> Result<(Vec<Linear>, Vec<Linear>)> {
    let n = rows.nrows();
    if n > 16 {
        return Err(Error::input(
            format!("a codebook holds up to 16 different features, there are {n}"),
            "Choose the network codec.",
        ));
    }
    let gram = rows.dot(&rows.t());
    let gram = |i: usize, j: usize| f64::from(gram[[i, j]]) + if i == j { RIDGE } else { 0.0 };
    let mut matrix = Symmetric::from_fn(n, gram);
    let is_solved = matrix.factorize();
    let mut encoder = rows.to_owned();
    for mut column in encoder.columns_mut() {
        let mut shares = column.mapv(f64::from).to_vec();
        if !is_solved || !matrix.substitute(&mut shares) {
            return Err(Error::input(
                "the features are too alike for a codebook",
                "Choose the network codec.",
            ));
        }
        column.iter_mut().zip(shares).for_each(|(weight, share)| *weight = share as f32);
    }
    let layer = |weight: Array2<f32>| Linear { bias: Array1::zeros(weight.nrows()), weight };
    Ok((vec![layer(encoder)], vec![layer(rows.t().to_owned())]))
}
