//! Weighted links between like things, and examples of looks.

use kiddo::{ImmutableKdTree, SquaredEuclidean};
use rayon::prelude::*;
use std::num::NonZeroUsize;

/// Numbers by which looks are compared over any distance: roots of colours, and roughly the place.
pub(super) type Look = [f32; 5];

/// Difference of roots of colours, of 0 to 1, at which looks weigh e^(−½). Roots tell dark tissue apart.
const LOOK_COLOUR: f32 = 0.1;
/// Distance that does so, in widths of the picture.
const LOOK_WIDTHS: f32 = 1.0 / 3.0;
/// Example that counts, by its distance: a single one may be a mistake.
const EXAMPLE: usize = 3;

/// Returns the look of a colour (roots, 0–1) at a place (in widths of the picture).
pub(super) fn look(colour: [f32; 3], place: [f32; 2]) -> Look {
    let [r, g, b] = colour.map(|c| c / LOOK_COLOUR);
    let [x, y] = place.map(|p| p / LOOK_WIDTHS);
    [r, g, b, x, y]
}

/// Links of things with others, both ways, with weights of 0 to 1.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Links {
    /// First link of each thing; one more at the end.
    first: Vec<u32>,
    to: Vec<u32>,
    weights: Vec<f32>,
    /// Sum of the weights of each thing.
    pub(super) degrees: Vec<f32>,
    looks: Vec<Look>,
}

impl Links {
    /// Links things of these looks; a link that is given several times counts once.
    pub(super) fn new(looks: Vec<Look>, links: impl Iterator<Item = (u32, u32, f32)>) -> Self {
        let mut all: Vec<(u32, u32, f32)> = links.flat_map(|(i, j, w)| [(i, j, w), (j, i, w)]).collect();
        all.par_sort_unstable_by_key(|(i, j, _)| (*i, *j));
        all.dedup_by_key(|(i, j, _)| (*i, *j));
        let mut first = vec![0; looks.len() + 1];
        let mut degrees = vec![0.0; looks.len()];
        for (i, _, weight) in &all {
            first[*i as usize + 1] += 1;
            degrees[*i as usize] += weight;
        }
        (1..first.len()).for_each(|i| first[i] += first[i - 1]);
        let (to, weights) = all.into_iter().map(|(_, j, weight)| (j, weight)).unzip();
        Self { first, to, weights, degrees, looks }
    }

    pub(super) fn len(&self) -> usize {
        self.degrees.len()
    }

    /// Returns Σ weight · value over the links of thing `i`.
    pub(super) fn sum_around(&self, i: usize, values: &[f32]) -> f32 {
        let links = self.first[i] as usize..self.first[i + 1] as usize;
        let neighbours = self.to[links.clone()].iter().zip(&self.weights[links]);
        neighbours.map(|(j, weight)| weight * values[*j as usize]).sum()
    }

    /// Returns how much each thing looks like the examples, 0–1.
    pub(super) fn likeness(&self, examples: &[usize]) -> Vec<f32> {
        let examples: Vec<Look> = examples.iter().map(|i| self.looks[*i]).collect();
        let Ok(tree) = ImmutableKdTree::<f32, 5>::new_from_slice(&examples) else {
            return vec![0.0; self.looks.len()];
        };
        let count = NonZeroUsize::new(EXAMPLE.min(examples.len())).unwrap_or(NonZeroUsize::MIN);
        let likeness = |look: &Look| {
            let nearest = tree.query(look).nearest_n::<SquaredEuclidean<f32>>(count).execute();
            nearest.last().map_or(0.0, |last| (-0.5 * last.distance).exp())
        };
        self.looks.par_iter().map(likeness).collect()
    }
}
