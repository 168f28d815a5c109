//! Spreads seeds over a graph: a random walker with soft seeds, and a small pull towards no change (Grady
//! 2006, "Random walks for image segmentation").
//!
//! For each name: (D + ε + λ (deg − W)) z = D y, with D the weights of the seeds, y their shares, W the graph
//! and z the shares of all. Without seeds z is 0. It is in 0–1 by the maximum principle, and the shares of
//! names that are never denied add up to 1 at most, because all names share the graph. Of a correction, y and
//! z are changes of scores, −1 to 1.

use super::{
    conjugate::{Equation, solve},
    hints::Hints,
    links::Links,
    seeds::Seeds,
};
use crate::lanes::LANES;
use rayon::prelude::*;

/// Pull towards no change, ε, at each node.
pub(super) const PULL: f32 = 1e-5;
/// Largest weight of a seed: a node with this many marked pixels follows the marks alone.
const MAX_SEED_WEIGHT: f32 = 30.0;
/// Weight of a hint of score 1: far less than that of a mark.
const HINT_WEIGHT: f32 = 0.02;

/// Start of the solver: shares of each name, [names][nodes].
#[derive(Clone, Copy)]
pub(super) enum Before<'a> {
    /// Nothing.
    Nothing,
    /// Shares of a similar walk: starting from them takes less time.
    Nearly(&'a [Vec<f32>]),
}

/// Returns the share of each name, or its change, [names][nodes].
pub(super) fn spread(
    links: &Links,
    seeds: &Seeds,
    before: Before<'_>,
    pull: f32,
    hints: Option<&Hints>,
) -> Vec<Vec<f32>> {
    // Diagonal, right side and start of name `k` at node `i`.
    let equation = |i: usize, k: usize| {
        let weight = seeds.weights[k][i].min(MAX_SEED_WEIGHT);
        let share = seeds.shares[k][i] / seeds.weights[k][i].max(f32::MIN_POSITIVE);
        let x = match before {
            Before::Nothing => 0.0,
            Before::Nearly(shares) => shares[k][i],
        };
        let (hint_weight, hint) = match hints {
            Some(hints) if links.degrees[i] > 0.0 => (HINT_WEIGHT * hints.weights[k][i], hints.shares[k][i]),
            _ => (0.0, 0.0),
        };
        [weight + pull + links.degrees[i] + hint_weight, weight * share + hint_weight * hint, x]
    };
    let num_names = seeds.weights.len();
    let mut shares = Vec::with_capacity(num_names);
    for first in (0..num_names).step_by(LANES) {
        // Lanes without a name have nothing to solve.
        let lane = |i: usize, k: usize| if k < num_names { equation(i, k) } else { [1.0, 0.0, 0.0] };
        let lanes = |i: usize| {
            let each: [[f32; 3]; LANES] = std::array::from_fn(|k| lane(i, first + k));
            let [diagonal, right, x] = std::array::from_fn(|of| each.map(|numbers| numbers[of]));
            Equation { diagonal, right, x }
        };
        let equations = (0..links.len()).into_par_iter().with_min_len(1024).map(lanes).collect();
        let solved = solve(links, equations);
        let count = LANES.min(num_names - first);
        shares.extend((0..count).map(|k| solved.iter().map(|x| x[k].clamp(-1.0, 1.0)).collect()));
    }
    shares
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::marks::appearance::{Appearance, AppearanceFeatures};

    #[test]
    fn nodes_that_look_like_denied_ones_are_not_found() {
        // Marked nodes, some that may be denied, and two that lie elsewhere and look more like the latter.
        let counts = [(0.50, 300), (0.62, 300), (0.59, 2)];
        let of_light = |light: f32| Appearance {
            colour: [light, 0.0, 0.0],
            around: [light, 0.0, 0.0],
            roughness: 0.0,
            position: [0.5; 2],
            log_depth: 0.0,
        };
        let appearance = AppearanceFeatures::new(
            counts.into_iter().flat_map(|(light, n)| (0..n).map(move |_| of_light(light))),
        );
        let links = Links::new(602, std::iter::once((600, 601, 1e-3)));
        let share = |denied: f32| {
            let weights = [vec![1.0; 300], vec![denied; 300], vec![0.0; 2]].concat();
            let shares = [vec![1.0; 300], vec![0.0; 302]].concat();
            let seeds = Seeds { weights: vec![weights], shares: vec![shares] };
            let hints = Hints::of(&appearance, &links, &seeds, &[]);
            spread(&links, &seeds, Before::Nothing, PULL, Some(&hints))[0][600]
        };
        assert!(share(0.0) > 0.5 && share(1.0) < 0.5, "{} {}", share(0.0), share(1.0));
    }
}
