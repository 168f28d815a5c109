//! Appearance of nodes as feature vectors, and labels predicted from it: kernel ridge regression (Rasmussen
//! and Williams 2006, "Gaussian Processes for Machine Learning", equation 2.25).

use crate::{
    lanes::{LANES, exp2},
    linear::Symmetric,
};
use fearless_simd::{Level, dispatch, f32x8, prelude::*};
use fearless_simd_macros::simd;
use rayon::prelude::*;
use std::f32::consts::{LN_2, LOG2_E};

/// Length of a feature vector.
const DIM: usize = 10;
/// Index of the first number of the position.
const POSITION: usize = 7;
/// Index of the depth.
const DEPTH: usize = 9;
/// Feature vector of a node. The likeness of two vectors at a distance of d is e^(−d²/2).
type FeatureVector = [f32; DIM];

/// Difference of brightness (mean of the roots of red, green and blue, 0–1) that counts as 1.
const BRIGHTNESS: f32 = 0.23;
/// Difference of hue, as differences of roots, that counts as 1; light changes it less than brightness.
const HUE: f32 = 0.13;
/// Weight of the colour of the surroundings, relative to the node's own.
const AROUND: f32 = 0.7;
/// Difference of the standard deviation of brightness that counts as 1.
const ROUGHNESS: f32 = 0.13;
/// Distance that counts as 1, in widths of the picture.
const WIDTHS: f32 = 2.0 / 3.0;
/// Difference of the logarithm of depth that counts as 1.
const LOG_DEPTH: f32 = 0.3;

/// Largest number of labelled examples of all classes together; each class keeps [`MIN_EXAMPLES`].
const MAX_EXAMPLES: usize = 256;
const MIN_EXAMPLES: usize = 8;
/// Largest number of unlabelled examples.
const MAX_UNLABELLED: usize = 128;
/// Variance of the label of an example: a single one may be a mistake.
const LABEL_VARIANCE: f64 = 0.03;
/// Smallest variance of any label: the kernel stays far from singular.
const MIN_VARIANCE: f64 = 1e-4;
/// Distance to the nearest example at which the nearness is one half.
const HALF_NEARNESS: f32 = 0.65;

/// Returns mean and two differences of the roots of red, green and blue: a change of light alone changes the
/// first one most.
pub(super) fn opponents([r, g, b]: [f32; 3]) -> [f32; 3] {
    [(r + g + b) / 3.0, r - g, (r + g) / 2.0 - b]
}

/// Appearance of a node.
pub(super) struct Appearance {
    /// Colour as [`opponents`].
    pub(super) colour: [f32; 3],
    /// Mean colour of its surroundings.
    pub(super) around: [f32; 3],
    /// Standard deviation of the brightness around it.
    pub(super) roughness: f32,
    /// Position in widths of the picture.
    pub(super) position: [f32; 2],
    /// Logarithm of its depth, less a number that is the same for all nodes; 0 where depth tells nothing.
    pub(super) log_depth: f32,
}

/// Unlabelled examples: their label is 0 for every class, with a variance of their own.
#[derive(Clone, Copy)]
pub(super) struct Unlabelled<'a> {
    pub(super) nodes: &'a [usize],
    pub(super) variance: f64,
}

impl Unlabelled<'_> {
    /// No examples.
    pub(super) const NONE: Self = Self { nodes: &[], variance: 1.0 };
}

/// Labels predicted for all nodes.
pub(super) struct Prediction {
    /// Score of each class at each node, 0–1: [classes][nodes].
    pub(super) score: Vec<Vec<f32>>,
    /// Nearness of each node to a positive example of any class, 0–1.
    pub(super) nearness: Vec<f32>,
}

/// Feature vectors of all nodes of a graph.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct AppearanceFeatures(Vec<FeatureVector>);

impl AppearanceFeatures {
    /// Makes a feature vector of the appearance of each node.
    pub(super) fn new(nodes: impl Iterator<Item = Appearance>) -> Self {
        let vector = |node: Appearance| {
            let [own, around] = [node.colour, node.around]
                .map(|[light, red, yellow]| [light / BRIGHTNESS, red / HUE, yellow / HUE]);
            let mut vector = [0.0; DIM];
            vector[..3].copy_from_slice(&own);
            vector[3..6].copy_from_slice(&around.map(|v| AROUND * v));
            vector[6] = node.roughness / ROUGHNESS;
            vector[POSITION..DEPTH].copy_from_slice(&node.position.map(|v| v / WIDTHS));
            vector[DEPTH] = node.log_depth / LOG_DEPTH;
            vector
        };
        Self(nodes.map(vector).collect())
    }

    /// Returns the brightness of a node, as [`opponents`] gives it.
    pub(super) fn brightness(&self, node: usize) -> f32 {
        BRIGHTNESS * self.0[node][0]
    }

    /// Returns the likeness of a node and a node of `others`, 0–1. Positions and depths do not
    /// count.
    pub(super) fn likeness(&self, node: usize, others: &Self, other: usize) -> f32 {
        likeness(&self.0[node][..POSITION], &others.0[other][..POSITION])
    }

    /// Predicts the classes of all nodes from examples among them, see [`Self::fit`].
    pub(super) fn predict(
        &self,
        positives: &[Vec<usize>],
        negatives: &[usize],
        unlabelled: Unlabelled<'_>,
    ) -> Prediction {
        self.fit(positives, negatives, unlabelled).predict(self)
    }

    /// Fits a regression to examples among the nodes. `positives` are the examples of each class, and
    /// `negatives` show none of the classes.
    pub(super) fn fit(
        &self,
        positives: &[Vec<usize>],
        negatives: &[usize],
        unlabelled: Unlabelled<'_>,
    ) -> Regression {
        let all = positives.iter().map(Vec::as_slice).chain([negatives]);
        let count: usize = all.clone().map(<[usize]>::len).sum();
        let mut chosen: Vec<(usize, usize)> = all
            .enumerate()
            .flat_map(|(class, of)| {
                let most = (MAX_EXAMPLES * of.len() / count.max(1)).max(MIN_EXAMPLES);
                some_of(of, most).map(move |node| (class, node))
            })
            .collect();
        let num_positives = chosen.iter().filter(|(class, _)| *class < positives.len()).count();
        let num_labelled = chosen.len();
        chosen.extend(some_of(unlabelled.nodes, MAX_UNLABELLED).map(|node| (usize::MAX, node)));
        let variance =
            |a: usize| if a < num_labelled { LABEL_VARIANCE } else { unlabelled.variance.max(MIN_VARIANCE) };
        let examples: Vec<FeatureVector> = chosen.iter().map(|(_, node)| self.0[*node]).collect();
        let mut kernel = Symmetric::from_fn(examples.len(), |a, b| {
            f64::from(likeness(&examples[a], &examples[b])) + if a == b { variance(a) } else { 0.0 }
        });
        let is_solved = kernel.factorize();
        let num_classes = positives.len();
        let mut weights = vec![vec![0.0; num_classes]; chosen.len()];
        for class in 0..num_classes {
            let mut labels: Vec<f64> =
                chosen.iter().map(|(of, _)| if *of == class { 1.0 } else { 0.0 }).collect();
            if is_solved && kernel.substitute(&mut labels) {
                weights.iter_mut().zip(labels).for_each(|(weights, w)| weights[class] = w as f32);
            }
        }
        Regression { examples, weights, num_classes, num_positives }
    }
}

/// Regression of classes on appearance, fitted to examples.
#[derive(Clone, Debug)]
pub(super) struct Regression {
    examples: Vec<FeatureVector>,
    /// [examples][classes].
    weights: Vec<Vec<f32>>,
    num_classes: usize,
    /// Number of the examples that show a class; they come first.
    num_positives: usize,
}

impl Regression {
    /// Predicts the classes of nodes: sums weight · likeness over the examples. A node that looks like no
    /// example has scores near 0.
    pub(super) fn predict(&self, AppearanceFeatures(vectors): &AppearanceFeatures) -> Prediction {
        // Eight nodes beside each other: [blocks][classes, nearness][lanes].
        let columns = self.num_classes + 1;
        let mut sums = vec![[0.0; LANES]; vectors.len().div_ceil(LANES) * columns];
        let level = Level::new();
        let blocks = sums.par_chunks_exact_mut(columns).zip(vectors.par_chunks(LANES)).with_min_len(64);
        blocks.for_each(|(sums, nodes)| {
            let Self { examples, weights, num_positives, .. } = self;
            dispatch!(level, simd => sum_block(simd, nodes, examples, weights, *num_positives, sums));
        });
        let plane = |k: usize| -> Vec<f32> {
            (0..vectors.len()).map(|i| sums[i / LANES * columns + k][i % LANES]).collect()
        };
        Prediction { score: (0..self.num_classes).map(plane).collect(), nearness: plane(self.num_classes) }
    }
}

/// Sums weight · likeness for at most eight nodes; the last of the `sums` is their nearness.
#[simd]
fn sum_block<S: Simd>(
    simd: S,
    nodes: &[FeatureVector],
    examples: &[FeatureVector],
    weights: &[Vec<f32>],
    num_positives: usize,
    sums: &mut [[f32; LANES]],
) {
    let own: [f32x8<S>; DIM] =
        std::array::from_fn(|d| f32x8::from_fn(simd, |i| nodes.get(i).map_or(0.0, |vector| vector[d])));
    let mut nearest = f32x8::splat(simd, 0.0);
    let Some((nearness, sums)) = sums.split_last_mut() else { return };
    for (i, (example, weights)) in examples.iter().zip(weights).enumerate() {
        let mut distance_2 = f32x8::splat(simd, 0.0);
        for (own, other) in own.iter().zip(example) {
            let difference = *own - *other;
            distance_2 = difference.mul_add(difference, distance_2);
        }
        let likeness = exp2(simd, (distance_2 * (-0.5 * LOG2_E)).max(f32x8::splat(simd, -126.0)));
        if i < num_positives {
            nearest = nearest.max(likeness);
        }
        for (sum, weight) in sums.iter_mut().zip(weights) {
            let so_far = f32x8::load_array_ref(simd, sum);
            *sum = likeness.mul_add(f32x8::splat(simd, *weight), so_far).to_array();
        }
    }
    sums.iter_mut().flatten().for_each(|sum| *sum = sum.clamp(0.0, 1.0));
    *nearness = nearest.to_array().map(|v| v.powf(2.0 * LN_2 / (HALF_NEARNESS * HALF_NEARNESS)));
}

/// Returns at most `most` of some nodes, evenly spread over them.
fn some_of(nodes: &[usize], most: usize) -> impl Iterator<Item = usize> {
    let count = nodes.len().min(most);
    (0..count).map(move |i| nodes[i * nodes.len() / count])
}

/// Returns the likeness of two vectors: the kernel of the regression.
fn likeness(a: &[f32], b: &[f32]) -> f32 {
    let distance_2: f32 = a.iter().zip(b).map(|(a, b)| (a - b) * (a - b)).sum();
    (-0.5 * distance_2).exp()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nodes_get_the_label_of_examples_that_look_like_them() {
        let of_light = |light: f32| Appearance {
            colour: [light, 0.0, 0.0],
            around: [light, 0.0, 0.0],
            roughness: 0.0,
            position: [0.5; 2],
            log_depth: 0.0,
        };
        // Two kinds of nodes, one node between them, and one that is like neither.
        let lights = [0.1, 0.12, 0.14, 0.5, 0.52, 0.54, 0.32, 3.0];
        let features = AppearanceFeatures::new(lights.into_iter().map(of_light));
        let both = [vec![0, 1, 2], vec![3, 4, 5]];
        let Prediction { score, nearness } = features.predict(&both, &[], Unlabelled::NONE);
        assert!(score[0][1] > 0.9 && score[1][4] > 0.9, "{score:?}");
        assert!(score[0][4] < 0.1 && score[1][1] < 0.1, "{score:?}");
        assert!((score[0][6] - score[1][6]).abs() < 0.1, "{score:?}");
        assert!(score[0][7] + score[1][7] < 0.01, "{score:?}");
        assert!(nearness[1] > 0.9 && nearness[6] < 0.5 && nearness[7] < 1e-3, "{nearness:?}");
        let denied = features.predict(&both[..1], &[3, 4, 5], Unlabelled::NONE);
        assert!(denied.score[0][4] < 0.1 && denied.nearness[4] < 0.1, "{:?}", denied.score);
        let [alone, open] = [&[][..], &[3, 4, 5]]
            .map(|nodes| features.predict(&both[..1], &[], Unlabelled { nodes, variance: 1.0 }).score);
        assert!(open[0][4] < 0.5 * alone[0][4] && open[0][1] > 0.9, "{open:?}, {alone:?}");
        let nothing = features.predict(&[Vec::new()], &[], Unlabelled { nodes: &[6, 7], variance: 1.0 });
        assert_eq!((&nothing.score[0], &nothing.nearness), (&vec![0.0; 8], &vec![0.0; 8]));
        assert_eq!(some_of(&[3, 5, 7, 9], 2).collect::<Vec<_>>(), [3, 7]);
    }
}
