//! Motion fitted by basis functions of another kind.

use crate::{
    deform::{Deformation, basis},
    linear::Symmetric,
};
use std::ops::Range;

/// Returns times spread evenly over a recording.
pub(super) fn sample_times(samples: usize) -> Vec<f32> {
    (0..samples).map(|k| k as f32 / samples as f32).collect()
}

/// Adds to the weights of `fitted`, whose bases are shared, those that come nearest to the motion of `n`
/// Gaussians at `times`, in `channels`.
pub(super) fn fit_motion(
    fitted: &mut Deformation,
    motion: &Deformation,
    n: usize,
    times: &[f32],
    channels: Range<usize>,
) {
    let (stride, plane) = (fitted.stride, (n * fitted.stride).max(1));
    for (time, factors) in times.iter().zip(least_squares(fitted, times)) {
        let psi = motion.psi(n, *time);
        for (plane, factor) in fitted.weights.chunks_exact_mut(plane).zip(factors) {
            for (row, psi) in plane.chunks_exact_mut(stride).zip(psi.chunks_exact(motion.stride)) {
                let wanted = row[channels.clone()].iter_mut().zip(&psi[channels.clone()]);
                wanted.for_each(|(weight, psi)| *weight += factor * psi);
            }
        }
    }
}

/// Computes (QᵀQ + λ)⁻¹Qᵀ for the values Q [times][bases] of shared bases, as [times][bases]. The small λ
/// keeps it defined if there are fewer times than bases.
fn least_squares(deformation: &Deformation, times: &[f32]) -> Vec<Vec<f32>> {
    let d = deformation;
    let value = |t: f32, b: usize| f64::from(basis(d.shape, t, d.centres[b], d.widths[b]));
    let q: Vec<Vec<f64>> = times.iter().map(|t| (0..d.num_bases).map(|b| value(*t, b)).collect()).collect();
    let lambda = |a: usize, b: usize| if a == b { 1e-6 * times.len() as f64 } else { 0.0 };
    let gram = |a: usize, b: usize| q.iter().map(|row| row[a] * row[b]).sum::<f64>() + lambda(a, b);
    let mut matrix = Symmetric::from_fn(d.num_bases, gram);
    let is_solved = matrix.factorize();
    let solved = |mut row: Vec<f64>| {
        if !is_solved || !matrix.substitute(&mut row) {
            row.fill(0.0);
        }
        row.into_iter().map(|v| v as f32).collect()
    };
    q.into_iter().map(solved).collect()
}
