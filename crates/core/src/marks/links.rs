//! Weighted links between similar nodes: the edges of a graph.

use rayon::prelude::*;

/// Links between nodes, in both directions, with weights of 0 to 1.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Links {
    /// First link of each node; one more at the end.
    first: Vec<u32>,
    to: Vec<u32>,
    weights: Vec<f32>,
    /// Sum of the weights of each node.
    pub(super) degrees: Vec<f32>,
}

impl Links {
    /// Links `n` nodes; a link that is given several times counts once.
    pub(super) fn new(n: usize, links: impl Iterator<Item = (u32, u32, f32)>) -> Self {
        let mut all: Vec<(u32, u32, f32)> = links.flat_map(|(i, j, w)| [(i, j, w), (j, i, w)]).collect();
        all.par_sort_unstable_by_key(|(i, j, _)| (*i, *j));
        all.dedup_by_key(|(i, j, _)| (*i, *j));
        let mut first = vec![0; n + 1];
        let mut degrees = vec![0.0; n];
        for (i, _, weight) in &all {
            first[*i as usize + 1] += 1;
            degrees[*i as usize] += weight;
        }
        (1..first.len()).for_each(|i| first[i] += first[i - 1]);
        let (to, weights) = all.into_iter().map(|(_, j, weight)| (j, weight)).unzip();
        Self { first, to, weights, degrees }
    }

    pub(super) fn len(&self) -> usize {
        self.degrees.len()
    }

    /// Returns the links of node `i`: the other node, and the weight.
    #[inline]
    pub(super) fn around(&self, i: usize) -> impl Iterator<Item = (usize, f32)> {
        let links = self.first[i] as usize..self.first[i + 1] as usize;
        self.to[links.clone()].iter().zip(&self.weights[links]).map(|(j, weight)| (*j as usize, *weight))
    }
}
