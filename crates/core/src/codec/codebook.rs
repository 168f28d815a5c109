//! A codec in closed form for few rows: the latents of a feature are its shares of the rows.

use super::mlp::Linear;
use crate::{Error, Result};
use ndarray::{Array1, Array2, ArrayView2};

/// Added to the diagonal of the Gram matrix, so that rows that are nearly alike can be told apart.
const RIDGE: f32 = 1e-4;

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
    let gram = rows.dot(&rows.t()) + Array2::<f32>::eye(n) * RIDGE;
    let layer = |weight: Array2<f32>| Linear { bias: Array1::zeros(weight.nrows()), weight };
    Ok((vec![layer(solve(gram, rows.to_owned()))], vec![layer(rows.t().to_owned())]))
}

/// Solves A X = B for a symmetric positive definite A by elimination.
fn solve(mut a: Array2<f32>, mut b: Array2<f32>) -> Array2<f32> {
    let n = a.nrows();
    for k in 0..n {
        let pivot = a[[k, k]];
        a.row_mut(k).mapv_inplace(|v| v / pivot);
        b.row_mut(k).mapv_inplace(|v| v / pivot);
        let (own_a, own_b) = (a.row(k).to_owned(), b.row(k).to_owned());
        for i in (0..n).filter(|&i| i != k) {
            let factor = a[[i, k]];
            a.row_mut(i).scaled_add(-factor, &own_a);
            b.row_mut(i).scaled_add(-factor, &own_b);
        }
    }
    b
}
