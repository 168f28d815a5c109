//! Logistic regression with weights that are not negative.

use crate::real::Real;

/// Pull of the standardised weights towards zero; it only matters where a feature separates the sides.
const RIDGE: f64 = 4e-4;
const MAX_SWEEPS: usize = 2000;
const SMALLEST_CHANGE: f64 = 1e-7;

/// Fits the log odds of `is_true` as a weighted sum of the features. The first feature is the constant 1;
/// only its weight may be negative. Both sides count the same, however many rows they have. All zeros if a
/// side has no row.
pub(super) fn fit<const N: usize>(rows: &[[f64; N]], is_true: &[bool]) -> [f64; N] {
    let positive = is_true.iter().filter(|&&t| t).count();
    let negative = is_true.len() - positive;
    if positive == 0 || negative == 0 || N == 0 {
        return [0.0; N];
    }
    let shares = [0.5 / negative as f64, 0.5 / positive as f64];
    let sides: Vec<(f64, f64)> =
        is_true.iter().map(|&t| (f64::from(u8::from(t)), shares[usize::from(t)])).collect();
    let scale = spread(rows);
    let standardised: Vec<[f64; N]> =
        rows.iter().map(|row| std::array::from_fn(|j| row[j] / scale[j])).collect();
    let weights = descend(&standardised, &sides);
    std::array::from_fn(|j| weights[j] / scale[j])
}

/// Newton steps along one coordinate after the other. A step is at most twice as long as the one before.
fn descend<const N: usize>(rows: &[[f64; N]], sides: &[(f64, f64)]) -> [f64; N] {
    let mut weights = [0.0; N];
    let mut reach = [1.0_f64; N];
    let mut sums = vec![0.0; rows.len()];
    for _ in 0..MAX_SWEEPS {
        let mut change = 0.0_f64;
        for j in 0..N {
            let ridge = if j == 0 { 0.0 } else { RIDGE };
            let (mut slope, mut curvature) = (ridge * weights[j], ridge + 1e-12);
            for ((row, sum), (truth, share)) in rows.iter().zip(&sums).zip(sides) {
                let p = sum.sigmoid();
                slope += share * (p - truth) * row[j];
                curvature += share * p * (1.0 - p) * row[j] * row[j];
            }
            let mut step = (-slope / curvature).clamp(-reach[j], reach[j]);
            if j > 0 {
                step = step.max(-weights[j]);
            }
            weights[j] += step;
            reach[j] = (2.0 * step.abs()).max(0.5 * reach[j]);
            sums.iter_mut().zip(rows).for_each(|(sum, row)| *sum += step * row[j]);
            change = change.max(step.abs());
        }
        if change < SMALLEST_CHANGE {
            break;
        }
    }
    weights
}

/// Standard deviation of each feature; 1 for the constant and for features that are all the same.
fn spread<const N: usize>(rows: &[[f64; N]]) -> [f64; N] {
    std::array::from_fn(|j| {
        let n = rows.len() as f64;
        let mean = rows.iter().map(|row| row[j]).sum::<f64>() / n;
        let variance = rows.iter().map(|row| (row[j] - mean).powi(2)).sum::<f64>() / n;
        if j > 0 && variance > 1e-20 { variance.sqrt() } else { 1.0 }
    })
}

/// Area under the ROC curve: the probability that a value of a true row is above one of a false row, with
/// equal values counted half. 0.5 if a side has no row.
pub(super) fn area_under_curve(values: &[f32], is_true: &[bool]) -> f32 {
    let mut order: Vec<usize> = (0..values.len()).collect();
    order.sort_by(|&a, &b| values[a].total_cmp(&values[b]));
    let (mut below, mut area) = (0.0, 0.0);
    for equal in order.chunk_by(|&a, &b| values[a] == values[b]) {
        let positive = equal.iter().filter(|&&i| is_true[i]).count() as f64;
        let negative = equal.len() as f64 - positive;
        area += positive * (below + 0.5 * negative);
        below += negative;
    }
    let pairs = below * (values.len() as f64 - below);
    if pairs > 0.0 { (area / pairs) as f32 } else { 0.5 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    #[test]
    fn a_known_logistic_is_recovered() {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let known = [-0.5, 2.0, 1.0, 0.0];
        let rows: Vec<[f64; 4]> = (0..20_000)
            .map(|_| std::array::from_fn(|j| if j == 0 { 1.0 } else { rng.random_range(-2.0..2.0) }))
            .collect();
        let odds = |row: &[f64; 4]| row.iter().zip(&known).map(|(x, w)| x * w).sum::<f64>();
        let is_true: Vec<bool> = rows.iter().map(|row| rng.random::<f64>() < odds(row).sigmoid()).collect();
        let positive = is_true.iter().filter(|&&t| t).count() as f64;
        let found = fit(&rows, &is_true);
        // Equal sides shift the constant by the log odds of a row's side.
        let shift = (positive / (20_000.0 - positive)).ln();
        let expected = [known[0] - shift, 2.0, 1.0, 0.0];
        for (found, expected) in found.iter().zip(expected) {
            assert!((found - expected).abs() < 0.1, "{found} {expected}");
        }
    }

    #[test]
    fn weights_are_not_negative_and_one_side_gives_none() {
        let rows: Vec<[f64; 2]> = (0..100).map(|i| [1.0, f64::from(i)]).collect();
        let falling: Vec<bool> = (0..100).map(|i| i < 50).collect();
        let weights = fit(&rows, &falling);
        assert!(weights[0].abs() < 1e-6 && weights[1] == 0.0, "{weights:?}");
        assert_eq!(fit(&rows, &[true; 100]), [0.0; 2]);
        assert_eq!(fit::<2>(&[], &[]), [0.0; 2]);
    }

    #[test]
    fn area_under_curve_counts_ties_half() {
        assert_eq!(area_under_curve(&[1.0, 2.0, 3.0], &[false, true, true]), 1.0);
        assert_eq!(area_under_curve(&[1.0, 1.0], &[false, true]), 0.5);
        assert_eq!(area_under_curve(&[1.0], &[true]), 0.5);
        assert_eq!(area_under_curve(&[], &[]), 0.5);
    }
}
