//! Conjugate gradients (Hestenes and Stiefel 1952) with the diagonal as preconditioner, for eight systems at
//! once whose matrices share their links.

use super::links::Links;
use crate::lanes::LANES;
use fearless_simd::{Level, Simd, dispatch};
use fearless_simd_macros::simd;
use rayon::prelude::*;

/// Residual at which the solver stops, relative to the right side. A larger one leaves errors of a half far
/// from all seeds.
const TOLERANCE: f64 = 1e-5;
/// Squared norm of a residual that counts as zero.
const TINY_NORM2: f64 = 1e-20;
/// Largest number of steps.
const MAX_STEPS: usize = 1000;
/// Number of nodes that one thread takes at once.
const NODES_AT_ONCE: usize = 1024;

/// Values of eight systems at a node.
pub(super) type Lanes = [f32; LANES];

/// Equations of eight systems at a node.
pub(super) struct Equation {
    /// Diagonal of the matrix. Its other elements are the negative weights of the links.
    pub(super) diagonal: Lanes,
    /// Right side.
    pub(super) right: Lanes,
    /// Solution so far.
    pub(super) x: Lanes,
}

/// State of the solver at a node.
struct State {
    diagonal: Lanes,
    x: Lanes,
    residual: Lanes,
    /// Matrix · direction.
    a_direction: Lanes,
}

/// Solves eight systems, each with one equation per node.
pub(super) fn solve(links: &Links, equations: Vec<Equation>) -> Vec<Lanes> {
    let level = Level::new();
    let state =
        |e: Equation| State { diagonal: e.diagonal, x: e.x, residual: e.right, a_direction: [0.0; LANES] };
    let mut states: Vec<State> = equations.into_iter().map(state).collect();
    let zero = [0.0; LANES];
    let mut direction: Vec<Lanes> = states.iter().map(|s| s.x).collect();
    let target_norm2 =
        update_residual(level, &mut states, zero).map(|norm2| TOLERANCE * TOLERANCE * norm2 + TINY_NORM2);
    multiply(level, links, &mut states, &direction);
    let mut residual_norm2 = update_residual(level, &mut states, [1.0; LANES]);
    update_direction(level, &mut direction, &mut states, zero, zero);
    for _ in 0..MAX_STEPS {
        if residual_norm2.iter().zip(&target_norm2).all(|(norm2, target)| norm2 <= target) {
            break;
        }
        let curvature = multiply(level, links, &mut states, &direction);
        let alpha: Lanes = std::array::from_fn(|k| {
            let is_open = residual_norm2[k] > target_norm2[k];
            if is_open { (residual_norm2[k] / curvature[k]) as f32 } else { 0.0 }
        });
        let next_norm2 = update_residual(level, &mut states, alpha);
        let beta = std::array::from_fn(|k| (next_norm2[k] / residual_norm2[k].max(TINY_NORM2)) as f32);
        update_direction(level, &mut direction, &mut states, alpha, beta);
        residual_norm2 = next_norm2;
    }
    states.iter().map(|state| state.x).collect()
}

/// Sets `a_direction` to matrix · direction, and returns the curvature: direction · matrix · direction.
fn multiply(level: Level, links: &Links, states: &mut [State], direction: &[Lanes]) -> [f64; LANES] {
    let part = |(k, states): (usize, &mut [State])| {
        let first = k * NODES_AT_ONCE;
        dispatch!(level, simd => multiply_some(simd, links, states, direction, first))
    };
    total(states.par_chunks_mut(NODES_AT_ONCE).enumerate().map(part).collect())
}

#[simd]
fn multiply_some<S: Simd>(
    _: S,
    links: &Links,
    states: &mut [State],
    direction: &[Lanes],
    first: usize,
) -> Lanes {
    let mut curvature = [0.0; LANES];
    for (i, state) in (first..).zip(states) {
        let own = &direction[i];
        let mut a_direction: Lanes = std::array::from_fn(|k| state.diagonal[k] * own[k]);
        for (j, weight) in links.around(i) {
            let other = &direction[j];
            (0..LANES).for_each(|k| a_direction[k] -= weight * other[k]);
        }
        (0..LANES).for_each(|k| curvature[k] += own[k] * a_direction[k]);
        state.a_direction = a_direction;
    }
    curvature
}

/// Subtracts alpha · matrix · direction from the residuals, and returns their squared norms: Σ residual² /
/// diagonal.
fn update_residual(level: Level, states: &mut [State], alpha: Lanes) -> [f64; LANES] {
    let part = |states: &mut [State]| dispatch!(level, simd => update_residual_some(simd, states, alpha));
    total(states.par_chunks_mut(NODES_AT_ONCE).map(part).collect())
}

#[simd]
fn update_residual_some<S: Simd>(_: S, states: &mut [State], alpha: Lanes) -> Lanes {
    let mut norm2 = [0.0; LANES];
    for State { diagonal, residual, a_direction, .. } in states {
        for k in 0..LANES {
            residual[k] -= alpha[k] * a_direction[k];
            norm2[k] += residual[k] * residual[k] / diagonal[k];
        }
    }
    norm2
}

/// Moves the solution by alpha · direction, and sets the direction to the preconditioned residual plus beta ·
/// itself.
fn update_direction(level: Level, direction: &mut [Lanes], states: &mut [State], alpha: Lanes, beta: Lanes) {
    let parts = direction.par_chunks_mut(NODES_AT_ONCE).zip(states.par_chunks_mut(NODES_AT_ONCE));
    parts.for_each(|(direction, states)| {
        dispatch!(level, simd => update_direction_some(simd, direction, states, alpha, beta));
    });
}

#[simd]
fn update_direction_some<S: Simd>(
    _: S,
    direction: &mut [Lanes],
    states: &mut [State],
    alpha: Lanes,
    beta: Lanes,
) {
    for (direction, State { diagonal, x, residual, .. }) in direction.iter_mut().zip(states) {
        for k in 0..LANES {
            x[k] += alpha[k] * direction[k];
            direction[k] = residual[k] / diagonal[k] + beta[k] * direction[k];
        }
    }
}

/// Adds up sums of parts.
fn total(sums: Vec<Lanes>) -> [f64; LANES] {
    std::array::from_fn(|k| sums.iter().map(|part| f64::from(part[k])).sum())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_between_two_seeds_lie_on_a_line() {
        const N: usize = 300;
        let links = Links::new(N, (1..N as u32).map(|i| (i - 1, i, 1.0)));
        // The first system is 1 at the first node and 0 at the last one, the second one the other way round.
        let equation = |i: usize| {
            let seed = if i == 0 || i == N - 1 { 1e3 } else { 0.0 };
            let mut right = [0.0; LANES];
            (right[0], right[1]) = if i == 0 { (seed, 0.0) } else { (0.0, seed) };
            Equation { diagonal: [seed + links.degrees[i]; LANES], right, x: [0.0; LANES] }
        };
        let solved = solve(&links, (0..N).map(equation).collect());
        for (i, values) in solved.iter().enumerate() {
            let part = i as f32 / (N - 1) as f32;
            assert!((values[0] - (1.0 - part)).abs() < 0.01 && (values[1] - part).abs() < 0.01, "{values:?}");
            assert_eq!(values[2..], [0.0; LANES - 2]);
        }
        let start = |i: usize| Equation { x: solved[i], ..equation(i) };
        let again = solve(&links, (0..N).map(start).collect());
        let change = again.iter().flatten().zip(solved.iter().flatten()).map(|(a, b)| (a - b).abs());
        assert!(change.fold(0.0, f32::max) < 1e-3);
    }
}
