//! Shares of a frame, mixed from several sources.

use super::marked_frame::add_looked_up;
use crate::{flow::Vector, grid::Grid};
use rayon::prelude::*;

/// Weighted means of shares, pixel by pixel. Each name has weights of its own: a source may know of one name
/// that a pixel does not show it, and nothing of another.
pub(super) struct Mix {
    /// Σ weight · share, [names][pixels].
    sums: Vec<Vec<f32>>,
    /// Σ weight, [names][pixels].
    weights: Vec<Vec<f32>>,
}

/// Names that a source knows, and how far it knows the others at each pixel: as far as the pixel shows names
/// that it knows, it shows no other.
pub(super) struct Known {
    /// `true` for names that are known everywhere.
    pub(super) names: Vec<bool>,
    /// Known share of all other names at each pixel; empty if there are none.
    pub(super) others: Vec<f32>,
}

impl Known {
    /// Knows all names.
    pub(super) fn all(num_names: usize) -> Self {
        Self { names: vec![true; num_names], others: Vec::new() }
    }

    /// Returns how far a name is known at a pixel, 0–1.
    pub(super) fn of(&self, name: usize, pixel: usize) -> f32 {
        if self.names[name] { 1.0 } else { self.others[pixel] }
    }
}

impl Mix {
    /// Mixes nothing yet.
    pub(super) fn nothing(num_names: usize, num_pixels: usize) -> Self {
        let zeros = vec![vec![0.0; num_pixels]; num_names];
        Self { sums: zeros.clone(), weights: zeros }
    }

    /// Starts with shares [names][pixels], of which `weight` gives the weight of a name at a pixel.
    pub(super) fn of(shares: &[Vec<f32>], weight: impl Fn(usize, usize) -> f32 + Sync) -> Self {
        let mut mix = Self::nothing(shares.len(), shares.first().map_or(0, Vec::len));
        mix.add(shares, weight);
        mix
    }

    /// Adds shares with their weights.
    pub(super) fn add(&mut self, shares: &[Vec<f32>], weight: impl Fn(usize, usize) -> f32 + Sync) {
        let planes = self.sums.par_iter_mut().zip(&mut self.weights).zip(shares).enumerate();
        planes.for_each(|(name, ((sums, weights), shares))| {
            let pixels = sums.iter_mut().zip(weights).zip(shares).enumerate();
            pixels.for_each(|(i, ((sum, total), share))| {
                let weight = weight(name, i);
                *sum += weight * share;
                *total += weight;
            });
        });
    }

    /// Adds shares of another frame, as far as they are `known`, which `flow` leads to from each pixel.
    /// `weights` are those of the pixels.
    pub(super) fn add_along(
        &mut self,
        (shares, known): (&[Vec<f32>], &Known),
        flow: &Grid<Vector>,
        weights: &Grid<f32>,
    ) {
        let planes = self.sums.par_iter_mut().zip(&mut self.weights).zip(shares).enumerate();
        planes.for_each(|(name, ((sums, totals), shares))| {
            add_looked_up(sums, shares, flow, weights);
            if known.names[name] {
                totals.iter_mut().zip(&weights.data).for_each(|(total, weight)| *total += weight);
            } else {
                add_looked_up(totals, &known.others, flow, weights);
            }
        });
    }

    /// Returns the shares and their weights, [names][pixels]. Shares without a weight are 0.
    pub(super) fn finish(mut self) -> (Vec<Vec<f32>>, Vec<Vec<f32>>) {
        self.sums.par_iter_mut().zip(&self.weights).for_each(|(sums, weights)| {
            sums.iter_mut().zip(weights).for_each(|(sum, weight)| *sum /= weight.max(f32::MIN_POSITIVE));
        });
        (self.sums, self.weights)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_source_does_not_know_it_says_nothing_of() {
        // The first source knows the first name alone, which the first pixel shows a little.
        let first = [vec![0.1, 1.0], vec![0.0; 2]];
        let known = Known { names: vec![true, false], others: vec![0.1, 1.0] };
        let alone = |mix: Mix| mix.finish().0;
        let mix = Mix::of(&first, |name, pixel| known.of(name, pixel));
        assert_eq!(alone(mix), [[0.1, 1.0], [0.0; 2]], "a little stays a little");
        let mut mix = Mix::of(&first, |name, pixel| known.of(name, pixel));
        let everywhere = [vec![0.0; 2], vec![1.0; 2]];
        mix.add(&everywhere, |_, _| 1.0);
        let shares = alone(mix);
        assert_eq!(shares[0], [0.05, 0.5]);
        assert!((shares[1][0] - 1.0 / 1.1).abs() < 1e-6 && shares[1][1] == 0.5, "{:?}", shares[1]);
    }

    #[test]
    fn shares_are_looked_up_along_the_flow() {
        let flow = Grid::from_vec(2, 1, vec![[1.0, 0.0], [0.0, 0.0]]);
        let weights = Grid::from_vec(2, 1, vec![0.5, 0.25]);
        let mut mix = Mix::nothing(1, 2);
        mix.add_along((&[vec![0.0, 0.8]], &Known::all(1)), &flow, &weights);
        assert_eq!(mix.finish(), (vec![vec![0.8, 0.8]], vec![vec![0.5, 0.25]]));
    }
}
