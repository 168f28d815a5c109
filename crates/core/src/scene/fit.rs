//! Motion fitted by basis functions of another kind.

use crate::deform::{Deformation, basis};
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
    let gram = |a: usize, b: usize| q.iter().map(|row| row[a] * row[b]).sum::<f64>();
    let mut gram: Vec<Vec<f64>> =
        (0..d.num_bases).map(|a| (0..d.num_bases).map(|b| gram(a, b)).collect()).collect();
    (0..d.num_bases).for_each(|b| gram[b][b] += 1e-6 * times.len() as f64);
    let rows = q.iter().map(|row| solved(gram.clone(), row.clone()));
    rows.map(|row| row.into_iter().map(|v| v as f32).collect()).collect()
}

/// Solves Ax = b for x by elimination, for positive definite A.
fn solved(mut a: Vec<Vec<f64>>, mut b: Vec<f64>) -> Vec<f64> {
    let n = b.len();
    for k in 0..n {
        let (above, below) = a.split_at_mut(k + 1);
        for (row, i) in below.iter_mut().zip(k + 1..) {
            let factor = row[k] / above[k][k];
            row.iter_mut().zip(&above[k]).skip(k).for_each(|(v, pivot)| *v -= factor * pivot);
            b[i] -= factor * b[k];
        }
    }
    for k in (0..n).rev() {
        let known: f64 = (k + 1..n).map(|j| a[k][j] * b[j]).sum();
        b[k] = (b[k] - known) / a[k][k];
    }
    b
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_system_of_equations_is_solved() {
        let x =
            solved(vec![vec![4.0, 1.0, 0.5], vec![1.0, 3.0, 0.2], vec![0.5, 0.2, 2.0]], vec![7.5, 7.6, 6.9]);
        assert!(x.iter().zip([1.0, 2.0, 3.0]).all(|(a, b)| (a - b).abs() < 1e-12), "{x:?}");
    }
}
