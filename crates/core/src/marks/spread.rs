//! Spreads seeds over the graph: a random walker with soft seeds, and a small pull towards what was known
//! before (Grady 2006, "Random walks for image segmentation").
//!
//! For each name: (D + ε + λ (deg − W)) z = D (y − x₀), with D the weights of the seeds, y their shares, W
//! the graph, x₀ the share before (0 if nothing was known) and z its change. Without seeds z is 0. Where
//! nothing was known, z is in 0–1 by the maximum principle, and the shares of names that are never denied add
//! up to 1 at most, because all names share the graph.

use super::{hints::Hints, links::Links, seeds::Seeds};
use rayon::prelude::*;

/// Pull of no change, ε: what a walker has to overcome at each thing.
pub(super) const PULL: f32 = 1e-5;
/// Largest weight of a seed; a thing of this many marked pixels follows the marks alone.
const MOST_WEIGHT: f32 = 30.0;
/// Residual at which the solution is good, relative to the right side.
const TOLERANCE: f64 = 1e-3;
/// Largest number of steps of the solver.
const MOST_STEPS: usize = 300;

/// Returns the change of the share of each name, [names][things]; `before` holds the shares before, in the
/// same order.
pub(super) fn spread(
    links: &Links,
    seeds: &Seeds,
    before: Option<&[Vec<f32>]>,
    pull: f32,
    hints: Option<&Hints>,
) -> Vec<Vec<f32>> {
    let solve = |k: usize| {
        let before = before.map_or(&[][..], |before| &before[k]);
        let mut system = System::new(links, &seeds.weights[k], &seeds.shares[k], before, pull);
        hints.into_iter().for_each(|hints| system.add(hints, k));
        system.solve()
    };
    (0..seeds.weights.len()).into_par_iter().map(solve).collect()
}

/// Weight of a hint that is sure: far less than that of a mark.
const HINT: f32 = 0.02;

/// The linear system of one name.
struct System<'a> {
    links: &'a Links,
    diagonal: Vec<f32>,
    right: Vec<f32>,
}

impl<'a> System<'a> {
    fn new(links: &'a Links, weights: &[f32], shares: &[f32], before: &[f32], pull: f32) -> Self {
        let n = links.len();
        let (mut diagonal, mut right) = (Vec::with_capacity(n), Vec::with_capacity(n));
        for i in 0..n {
            let weight = weights[i].min(MOST_WEIGHT);
            let share = shares[i] / weights[i].max(f32::MIN_POSITIVE);
            diagonal.push(weight + pull + links.degrees[i]);
            right.push(weight * (share - before.get(i).unwrap_or(&0.0)));
        }
        Self { links, diagonal, right }
    }

    /// Adds the hints on name `k`. All names have the same weights.
    fn add(&mut self, hints: &Hints, k: usize) {
        for i in (0..self.right.len()).filter(|i| self.links.degrees[*i] > 0.0) {
            let weight = HINT * hints.weights[i];
            self.diagonal[i] += weight;
            self.right[i] += weight * hints.shares[k][i];
        }
    }

    fn times(&self, x: &[f32], out: &mut [f32]) {
        for (i, out) in out.iter_mut().enumerate() {
            *out = self.diagonal[i] * x[i] - self.links.sum_around(i, x);
        }
    }

    /// Solves by conjugate gradients with the diagonal as preconditioner.
    fn solve(&self) -> Vec<f32> {
        let mut x = vec![0.0; self.right.len()];
        let mut product = x.clone();
        let mut rest = self.right.clone();
        let scaled =
            |rest: &[f32]| -> Vec<f32> { rest.iter().zip(&self.diagonal).map(|(r, d)| r / d).collect() };
        let mut way = scaled(&rest);
        let mut size = dot(&rest, &way);
        let goal = TOLERANCE * TOLERANCE * size;
        for _ in 0..MOST_STEPS {
            if size <= goal {
                break;
            }
            self.times(&way, &mut product);
            let step = (size / dot(&way, &product)) as f32;
            x.iter_mut().zip(&way).for_each(|(x, w)| *x += step * w);
            rest.iter_mut().zip(&product).for_each(|(r, p)| *r -= step * p);
            let scaled = scaled(&rest);
            let next = dot(&rest, &scaled);
            let turn = (next / size) as f32;
            way.iter_mut().zip(&scaled).for_each(|(w, s)| *w = s + turn * *w);
            size = next;
        }
        x.iter_mut().for_each(|x| *x = x.clamp(-1.0, 1.0));
        x
    }
}

fn dot(a: &[f32], b: &[f32]) -> f64 {
    a.iter().zip(b).map(|(a, b)| f64::from(*a) * f64::from(*b)).sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::marks::looks::{Appearance, Looks};

    #[test]
    fn things_that_look_like_denied_ones_are_not_found() {
        // Marked ones, some that may be denied, and two that lie elsewhere and look more like the latter.
        let counts = [(0.50, 300), (0.62, 300), (0.59, 2)];
        let appearance = |light: f32| Appearance {
            colour: [light, 0.0, 0.0],
            around: [light, 0.0, 0.0],
            roughness: 0.0,
            place: [0.5; 2],
        };
        let looks =
            Looks::new(counts.into_iter().flat_map(|(light, n)| (0..n).map(move |_| appearance(light))));
        let links = Links::new(602, std::iter::once((600, 601, 1e-3)));
        let share = |denied: f32| {
            let weights = [vec![1.0; 300], vec![denied; 300], vec![0.0; 2]].concat();
            let shares = [vec![1.0; 300], vec![0.0; 302]].concat();
            let seeds = Seeds { weights: vec![weights], shares: vec![shares] };
            let hints = Hints::of(&looks, &links, &seeds, &[]);
            spread(&links, &seeds, None, PULL, Some(&hints))[0][600]
        };
        assert!(share(0.0) > 0.5 && share(1.0) < 0.5, "{} {}", share(0.0), share(1.0));
    }
}
