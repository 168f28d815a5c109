//! Conjugate gradients (Hestenes and Stiefel 1952) with the diagonal as preconditioner, for eight systems at
//! once whose matrices share their links.

use super::links::Links;
use crate::lanes::LANES;
use fearless_simd::{Level, Simd, dispatch};
use fearless_simd_macros::simd;
use rayon::prelude::*;

/// Residual at which a solution is good, relative to the right side: a larger one leaves errors of a half far
/// from all seeds.
const TOLERANCE: f64 = 1e-5;
/// Squared residual that is as good as none.
const NO_SIZE: f64 = 1e-20;
/// Largest number of steps.
const MOST_STEPS: usize = 1000;
/// Things that one thread takes at once.
const AT_ONCE: usize = 1024;

/// Values of eight systems at a thing.
pub(super) type Lanes = [f32; LANES];

/// Eight systems at a thing.
pub(super) struct Equation {
    /// Diagonal of the matrix; the weights of the links are subtracted beside it.
    pub(super) diagonal: Lanes,
    /// Right side.
    pub(super) right: Lanes,
    /// Solution so far.
    pub(super) x: Lanes,
}

/// The solver at a thing.
struct State {
    diagonal: Lanes,
    x: Lanes,
    rest: Lanes,
    product: Lanes,
}

/// Solves the systems of all things.
pub(super) fn solve(links: &Links, equations: Vec<Equation>) -> Vec<Lanes> {
    let level = Level::new();
    let state = |e: Equation| State { diagonal: e.diagonal, x: e.x, rest: e.right, product: [0.0; LANES] };
    let mut states: Vec<State> = equations.into_iter().map(state).collect();
    let still = [0.0; LANES];
    let mut way: Vec<Lanes> = states.iter().map(|s| s.x).collect();
    let goal = go(level, &mut states, still).map(|size| TOLERANCE * TOLERANCE * size + NO_SIZE);
    multiply(level, links, &mut states, &way);
    let mut size = go(level, &mut states, [1.0; LANES]);
    turn(level, &mut way, &mut states, still, still);
    for _ in 0..MOST_STEPS {
        if size.iter().zip(&goal).all(|(size, goal)| size <= goal) {
            break;
        }
        let along = multiply(level, links, &mut states, &way);
        let step: Lanes =
            std::array::from_fn(|k| if size[k] > goal[k] { (size[k] / along[k]) as f32 } else { 0.0 });
        let next = go(level, &mut states, step);
        let turned = std::array::from_fn(|k| (next[k] / size[k].max(NO_SIZE)) as f32);
        turn(level, &mut way, &mut states, step, turned);
        size = next;
    }
    states.iter().map(|state| state.x).collect()
}

/// Sets `product` to matrix · way, and returns way · matrix · way.
fn multiply(level: Level, links: &Links, states: &mut [State], way: &[Lanes]) -> [f64; LANES] {
    let part = |(k, states): (usize, &mut [State])| {
        let first = k * AT_ONCE;
        dispatch!(level, simd => multiply_some(simd, links, states, way, first))
    };
    total(states.par_chunks_mut(AT_ONCE).enumerate().map(part).collect())
}

#[simd]
fn multiply_some<S: Simd>(_: S, links: &Links, states: &mut [State], way: &[Lanes], first: usize) -> Lanes {
    let mut along = [0.0; LANES];
    for (i, state) in (first..).zip(states) {
        let own = &way[i];
        let mut product: Lanes = std::array::from_fn(|k| state.diagonal[k] * own[k]);
        for (j, weight) in links.around(i) {
            let other = &way[j];
            (0..LANES).for_each(|k| product[k] -= weight * other[k]);
        }
        (0..LANES).for_each(|k| along[k] += own[k] * product[k]);
        state.product = product;
    }
    along
}

/// Takes a step's part from the residuals, and returns Σ rest² / diagonal.
fn go(level: Level, states: &mut [State], step: Lanes) -> [f64; LANES] {
    let part = |states: &mut [State]| dispatch!(level, simd => go_some(simd, states, step));
    total(states.par_chunks_mut(AT_ONCE).map(part).collect())
}

#[simd]
fn go_some<S: Simd>(_: S, states: &mut [State], step: Lanes) -> Lanes {
    let mut size = [0.0; LANES];
    for State { diagonal, rest, product, .. } in states {
        for k in 0..LANES {
            rest[k] -= step[k] * product[k];
            size[k] += rest[k] * rest[k] / diagonal[k];
        }
    }
    size
}

/// Goes the step, and turns the way to the preconditioned residual.
fn turn(level: Level, way: &mut [Lanes], states: &mut [State], step: Lanes, turned: Lanes) {
    let parts = way.par_chunks_mut(AT_ONCE).zip(states.par_chunks_mut(AT_ONCE));
    parts.for_each(|(way, states)| {
        dispatch!(level, simd => turn_some(simd, way, states, step, turned));
    });
}

#[simd]
fn turn_some<S: Simd>(_: S, way: &mut [Lanes], states: &mut [State], step: Lanes, turned: Lanes) {
    for (way, State { diagonal, x, rest, .. }) in way.iter_mut().zip(states) {
        for k in 0..LANES {
            x[k] += step[k] * way[k];
            way[k] = rest[k] / diagonal[k] + turned[k] * way[k];
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
        // The first system is 1 at the first thing and 0 at the last one, the second one the other way round.
        let equation = |i: usize| {
            let seed = if i == 0 || i == N - 1 { 1e3 } else { 0.0 };
            let mut right = [0.0; LANES];
            (right[0], right[1]) = if i == 0 { (seed, 0.0) } else { (0.0, seed) };
            Equation { diagonal: [seed + links.degrees[i]; LANES], right, x: [0.0; LANES] }
        };
        let solved = solve(&links, (0..N).map(equation).collect());
        for (i, values) in solved.iter().enumerate() {
            let along = i as f32 / (N - 1) as f32;
            assert!(
                (values[0] - (1.0 - along)).abs() < 0.01 && (values[1] - along).abs() < 0.01,
                "{values:?}"
            );
            assert_eq!(values[2..], [0.0; LANES - 2]);
        }
        let start = |i: usize| Equation { x: solved[i], ..equation(i) };
        let again = solve(&links, (0..N).map(start).collect());
        let change = again.iter().flatten().zip(solved.iter().flatten()).map(|(a, b)| (a - b).abs());
        assert!(change.fold(0.0, f32::max) < 1e-3);
    }
}
