//! Looks of things, and their answers to what marked ones show: kernel ridge regression (Rasmussen and
//! Williams 2006, "Gaussian Processes for Machine Learning", equation 2.25).

use crate::{
    lanes::{LANES, exp2},
    linear::Symmetric,
};
use fearless_simd::{Level, dispatch, f32x8, prelude::*};
use fearless_simd_macros::simd;
use rayon::prelude::*;
use std::f32::consts::{LN_2, LOG2_E};

/// Numbers by which looks are compared.
const DIM: usize = 9;
/// First number of the place.
const PLACE: usize = 7;
/// Look of a thing. Two looks at a distance of d are alike by e^(−d²/2).
type Look = [f32; DIM];

/// Difference of brightness (mean of the roots of red, green and blue, 0–1) that counts as 1.
const BRIGHTNESS: f32 = 0.23;
/// Difference of hue, as differences of roots, that does so; light changes it less than brightness.
const HUE: f32 = 0.13;
/// Part of these that the surroundings count.
const AROUND: f32 = 0.7;
/// Difference of the standard deviation of brightness that counts as 1.
const ROUGHNESS: f32 = 0.13;
/// Distance that does so, in widths of the picture.
const WIDTHS: f32 = 2.0 / 3.0;

/// Examples of looks at most, of all answers together, but for [`FEWEST`] of each.
const MOST_EXAMPLES: usize = 256;
const FEWEST: usize = 8;
/// Things at most whose answer is open.
const MOST_OPEN: usize = 128;
/// Variance of an example's answer: a single one may be a mistake.
const NOISE: f64 = 0.03;
/// Least variance of any answer: the kernel stays far from singular.
const LEAST_NOISE: f64 = 1e-4;
/// Distance to the nearest example at which a thing is half known.
const KNOWN: f32 = 0.65;

/// Returns mean and two differences of the roots of red, green and blue: a change of light alone changes the
/// first one most.
pub(super) fn opponents([r, g, b]: [f32; 3]) -> [f32; 3] {
    [(r + g + b) / 3.0, r - g, (r + g) / 2.0 - b]
}

/// A thing as it is seen.
pub(super) struct Appearance {
    /// Colour as [`opponents`].
    pub(super) colour: [f32; 3],
    /// The same of its surroundings.
    pub(super) around: [f32; 3],
    /// Standard deviation of the brightness around it.
    pub(super) roughness: f32,
    /// Place in widths of the picture.
    pub(super) place: [f32; 2],
}

/// Answers of all things.
pub(super) struct Answers {
    /// Certainty that a thing shows what the examples of an answer show, 0–1: [answers][things].
    pub(super) sure: Vec<Vec<f32>>,
    /// Nearness of each thing to an example of any answer, 0–1.
    pub(super) known: Vec<f32>,
}

/// Looks of all things of one kind.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Looks(Vec<Look>);

impl Looks {
    pub(super) fn new(things: impl Iterator<Item = Appearance>) -> Self {
        let look = |seen: Appearance| {
            let [own, around] = [seen.colour, seen.around]
                .map(|[light, red, yellow]| [light / BRIGHTNESS, red / HUE, yellow / HUE]);
            let mut look = [0.0; DIM];
            look[..3].copy_from_slice(&own);
            look[3..6].copy_from_slice(&around.map(|v| AROUND * v));
            look[6] = seen.roughness / ROUGHNESS;
            look[PLACE..].copy_from_slice(&seen.place.map(|v| v / WIDTHS));
            look
        };
        Self(things.map(look).collect())
    }

    /// Returns the brightness of a thing, as [`opponents`] gives it.
    pub(super) fn brightness(&self, thing: usize) -> f32 {
        BRIGHTNESS * self.0[thing][0]
    }

    /// Returns the likeness of a thing and one of others, their places aside, 0–1.
    pub(super) fn likeness(&self, thing: usize, others: &Self, other: usize) -> f32 {
        likeness(&self.0[thing][..PLACE], &others.0[other][..PLACE])
    }

    /// Returns for every thing how sure it shows what the examples show. What looks like no example shows
    /// nothing. Things of `nothing` show no answer, and those of `open` none that is known, with a variance of
    /// their own.
    pub(super) fn answers(
        &self,
        examples: &[Vec<usize>],
        nothing: &[usize],
        open: (&[usize], f64),
    ) -> Answers {
        self.answers_of(self, examples, nothing, open)
    }

    /// Does the same for other things.
    pub(super) fn answers_of(
        &self,
        things: &Self,
        examples: &[Vec<usize>],
        nothing: &[usize],
        (open, variance_of_open): (&[usize], f64),
    ) -> Answers {
        let all = examples.iter().map(Vec::as_slice).chain([nothing]);
        let count: usize = all.clone().map(<[usize]>::len).sum();
        let mut chosen: Vec<(usize, usize)> = all
            .enumerate()
            .flat_map(|(answer, of)| {
                let most = (MOST_EXAMPLES * of.len() / count.max(1)).max(FEWEST);
                some_of(of, most).map(move |thing| (answer, thing))
            })
            .collect();
        let num_shown_by = chosen.iter().filter(|(answer, _)| *answer < examples.len()).count();
        let num_told = chosen.len();
        chosen.extend(some_of(open, MOST_OPEN).map(|thing| (usize::MAX, thing)));
        let variance = |a: usize| if a < num_told { NOISE } else { variance_of_open.max(LEAST_NOISE) };
        let looks: Vec<Look> = chosen.iter().map(|(_, thing)| self.0[*thing]).collect();
        let mut kernel = Symmetric::from_fn(looks.len(), |a, b| {
            f64::from(likeness(&looks[a], &looks[b])) + if a == b { variance(a) } else { 0.0 }
        });
        let is_solved = kernel.factorize();
        let mut weights = vec![vec![0.0; examples.len()]; chosen.len()];
        for answer in 0..examples.len() {
            let mut answers: Vec<f64> =
                chosen.iter().map(|(of, _)| if *of == answer { 1.0 } else { 0.0 }).collect();
            if is_solved && kernel.substitute(&mut answers) {
                weights.iter_mut().zip(answers).for_each(|(weights, w)| weights[answer] = w as f32);
            }
        }
        things.sums(&looks, (&weights, examples.len()), num_shown_by)
    }

    /// Sums weight · likeness over the examples, with weights [examples][answers]; things are known by the
    /// first `num_shown_by` examples.
    fn sums(
        &self,
        examples: &[Look],
        (weights, num_answers): (&[Vec<f32>], usize),
        num_shown_by: usize,
    ) -> Answers {
        // Eight things beside each other: [blocks][answers, known][lanes].
        let columns = num_answers + 1;
        let mut sums = vec![[0.0; LANES]; self.0.len().div_ceil(LANES) * columns];
        let level = Level::new();
        let blocks = sums.par_chunks_exact_mut(columns).zip(self.0.par_chunks(LANES)).with_min_len(64);
        blocks.for_each(|(sums, things)| {
            dispatch!(level, simd => sum_block(simd, things, examples, weights, num_shown_by, sums));
        });
        let plane = |k: usize| -> Vec<f32> {
            (0..self.0.len()).map(|i| sums[i / LANES * columns + k][i % LANES]).collect()
        };
        Answers { sure: (0..num_answers).map(plane).collect(), known: plane(num_answers) }
    }
}

/// Sums weight · likeness for at most eight things; the last of the `sums` is how well they are known.
#[simd]
fn sum_block<S: Simd>(
    simd: S,
    things: &[Look],
    examples: &[Look],
    weights: &[Vec<f32>],
    num_shown_by: usize,
    sums: &mut [[f32; LANES]],
) {
    let own: [f32x8<S>; DIM] =
        std::array::from_fn(|d| f32x8::from_fn(simd, |i| things.get(i).map_or(0.0, |look| look[d])));
    let mut nearest = f32x8::splat(simd, 0.0);
    let Some((known, sums)) = sums.split_last_mut() else { return };
    for (i, (example, weights)) in examples.iter().zip(weights).enumerate() {
        let mut distance_2 = f32x8::splat(simd, 0.0);
        for (own, other) in own.iter().zip(example) {
            let difference = *own - *other;
            distance_2 = difference.mul_add(difference, distance_2);
        }
        let alike = exp2(simd, (distance_2 * (-0.5 * LOG2_E)).max(f32x8::splat(simd, -126.0)));
        if i < num_shown_by {
            nearest = nearest.max(alike);
        }
        for (sum, weight) in sums.iter_mut().zip(weights) {
            let so_far = f32x8::load_array_ref(simd, sum);
            *sum = alike.mul_add(f32x8::splat(simd, *weight), so_far).to_array();
        }
    }
    sums.iter_mut().flatten().for_each(|sum| *sum = sum.clamp(0.0, 1.0));
    *known = nearest.to_array().map(|v| v.powf(2.0 * LN_2 / (KNOWN * KNOWN)));
}

/// Returns at most `most` of some things, evenly spread over them.
fn some_of(things: &[usize], most: usize) -> impl Iterator<Item = usize> {
    let count = things.len().min(most);
    (0..count).map(move |i| things[i * things.len() / count])
}

fn likeness(a: &[f32], b: &[f32]) -> f32 {
    let distance_2: f32 = a.iter().zip(b).map(|(a, b)| (a - b) * (a - b)).sum();
    (-0.5 * distance_2).exp()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn things_answer_as_their_likes_do() {
        let seen = |light: f32| Appearance {
            colour: [light, 0.0, 0.0],
            around: [light, 0.0, 0.0],
            roughness: 0.0,
            place: [0.5; 2],
        };
        // Two kinds, one thing between them, and one that is like neither.
        let lights = [0.1, 0.12, 0.14, 0.5, 0.52, 0.54, 0.32, 3.0];
        let looks = Looks::new(lights.into_iter().map(seen));
        let both = [vec![0, 1, 2], vec![3, 4, 5]];
        let Answers { sure, known } = looks.answers(&both, &[], (&[], 1.0));
        assert!(sure[0][1] > 0.9 && sure[1][4] > 0.9, "{sure:?}");
        assert!(sure[0][4] < 0.1 && sure[1][1] < 0.1, "{sure:?}");
        assert!((sure[0][6] - sure[1][6]).abs() < 0.1, "{sure:?}");
        assert!(sure[0][7] + sure[1][7] < 0.01, "{sure:?}");
        assert!(known[1] > 0.9 && known[6] < 0.5 && known[7] < 1e-3, "{known:?}");
        let denied = looks.answers(&both[..1], &[3, 4, 5], (&[], 1.0));
        assert!(denied.sure[0][4] < 0.1 && denied.known[4] < 0.1, "{:?}", denied.sure);
        let [alone, open] =
            [&[][..], &[3, 4, 5]].map(|open| looks.answers(&both[..1], &[], (open, 1.0)).sure);
        assert!(open[0][4] < 0.5 * alone[0][4] && open[0][1] > 0.9, "{open:?}, {alone:?}");
        let nothing = looks.answers(&[Vec::new()], &[], (&[6, 7], 1.0));
        assert_eq!((&nothing.sure[0], &nothing.known), (&vec![0.0; 8], &vec![0.0; 8]));
        assert_eq!(some_of(&[3, 5, 7, 9], 2).collect::<Vec<_>>(), [3, 7]);
    }
}
