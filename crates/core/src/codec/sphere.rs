//! Points far apart on the unit sphere (the Tammes problem, approximately).

use super::mlp::{normal, normalise_rows};
use ndarray::{Array2, ArrayView2};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

/// Number of starts; the one with the largest smallest distance is kept.
const STARTS: usize = 12;
/// Relaxation steps per start.
const STEPS: usize = 400;

/// Spreads `n` unit points in `dim` dimensions by repulsion. Its range shrinks, so that at the end only
/// the nearest neighbours push. Points coincide if there are more than fit (dim 1).
pub(super) fn spread_points(n: usize, dim: usize, seed: u64) -> Array2<f32> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut best = (f32::NEG_INFINITY, Array2::zeros((n, dim)));
    for _ in 0..STARTS {
        let start = normalise_rows(Array2::from_shape_simple_fn((n, dim), || normal(&mut rng)));
        let points = relax(start);
        let distance = smallest_distance(points.view());
        if distance > best.0 {
            best = (distance, points);
        }
    }
    best.1
}

fn relax(mut points: Array2<f32>) -> Array2<f32> {
    for step in 0..STEPS {
        let progress = step as f32 / STEPS as f32;
        let power = 2.0 + 38.0 * progress;
        let nearest = smallest_distance(points.view()).max(1e-3);
        let mut forces = Array2::<f32>::zeros(points.raw_dim());
        for i in 0..points.nrows() {
            for j in (0..points.nrows()).filter(|&j| j != i) {
                let apart = &points.row(i) - &points.row(j);
                let distance = apart.dot(&apart).sqrt().max(1e-3);
                forces.row_mut(i).scaled_add((nearest / distance).powf(power) / distance, &apart);
            }
        }
        points = normalise_rows(points + forces * (0.1 * nearest * (1.0 - progress)));
    }
    points
}

/// Smallest distance between two points; infinite for fewer than two.
pub(super) fn smallest_distance(points: ArrayView2<'_, f32>) -> f32 {
    let mut smallest = f32::INFINITY;
    for i in 0..points.nrows() {
        for j in 0..i {
            let apart = &points.row(i) - &points.row(j);
            smallest = smallest.min(apart.dot(&apart).sqrt());
        }
    }
    smallest
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Compares with known optima: 2 antipodes, 4 tetrahedron, 6 octahedron, 12 icosahedron; 13 from
    /// Tammes tables (57.1367°).
    #[test]
    fn spread_reaches_known_optima() {
        let cases = [
            (2, 3, 2.0),
            (4, 3, (8.0_f32 / 3.0).sqrt()),
            (6, 3, 2.0_f32.sqrt()),
            (12, 3, 1.0515),
            (13, 3, 0.9564),
            (5, 2, 1.1756),
            (9, 8, 1.5),
        ];
        for (n, dim, optimum) in cases {
            let found = smallest_distance(spread_points(n, dim, 0).view());
            assert!(
                found > 0.97 * optimum && found < optimum + 1e-3,
                "{n} points in {dim}: {found} of {optimum}"
            );
        }
    }

    #[test]
    fn one_point_and_one_dimension_are_fine() {
        assert_eq!(spread_points(1, 3, 0).nrows(), 1);
        assert!(spread_points(5, 1, 0).iter().all(|v| (v.abs() - 1.0).abs() < 1e-6));
    }
}
