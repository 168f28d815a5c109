//! Looks of things, and their answers to what marked ones show: kernel ridge regression (Rasmussen and
//! Williams 2006, "Gaussian Processes for Machine Learning", equation 2.25).

use crate::linear::Symmetric;
use rayon::prelude::*;
use std::f32::consts::LN_2;

/// Numbers by which looks are compared.
const DIM: usize = 9;
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
            look[7..].copy_from_slice(&seen.place.map(|v| v / WIDTHS));
            look
        };
        Self(things.map(look).collect())
    }

    /// Returns for every thing how sure it shows what the examples show. What looks like no example shows
    /// nothing. Things of `nothing` show no answer, and those of `open` none that is known,
    /// which counts little: the more answers there are, the likelier it is one of them.
    pub(super) fn answers(&self, examples: &[Vec<usize>], nothing: &[usize], open: &[usize]) -> Answers {
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
        let num_shown = examples.iter().filter(|of| !of.is_empty()).count();
        let variance = |a: usize| if a < num_told { NOISE } else { num_shown.pow(3) as f64 };
        let looks: Vec<Look> = chosen.iter().map(|(_, thing)| self.0[*thing]).collect();
        let kernel = Symmetric::from_fn(looks.len(), |a, b| {
            f64::from(likeness(&looks[a], &looks[b])) + if a == b { variance(a) } else { 0.0 }
        });
        let weights = |answer: usize| -> Vec<f32> {
            let mut weights: Vec<f64> =
                chosen.iter().map(|(of, _)| if *of == answer { 1.0 } else { 0.0 }).collect();
            // The noise keeps the kernel far from singular.
            if kernel.clone().solve(&mut weights) {
                weights.into_iter().map(|w| w as f32).collect()
            } else {
                vec![0.0; chosen.len()]
            }
        };
        let weights: Vec<Vec<f32>> = (0..examples.len()).into_par_iter().map(weights).collect();
        self.sums(&looks, &weights, num_shown_by)
    }

    /// Sums weight · likeness over the examples; things are known by the first `num_shown_by` of them.
    fn sums(&self, examples: &[Look], weights: &[Vec<f32>], num_shown_by: usize) -> Answers {
        let columns = weights.len() + 1;
        let mut rows = vec![0.0; self.0.len() * columns];
        let each = rows.par_chunks_exact_mut(columns).zip(&self.0).with_min_len(256);
        each.for_each_init(
            || vec![0.0; examples.len()],
            |alike, (row, look)| {
                alike.iter_mut().zip(examples).for_each(|(v, example)| *v = likeness(look, example));
                let nearest = alike[..num_shown_by].iter().copied().fold(0.0, f32::max);
                row[weights.len()] = nearest.powf(2.0 * LN_2 / (KNOWN * KNOWN));
                for (sum, weights) in row.iter_mut().zip(weights) {
                    *sum = weights.iter().zip(&*alike).map(|(w, v)| w * v).sum::<f32>().clamp(0.0, 1.0);
                }
            },
        );
        let plane = |k: usize| rows.iter().skip(k).step_by(columns).copied().collect();
        Answers { sure: (0..weights.len()).map(plane).collect(), known: plane(weights.len()) }
    }
}

/// Returns at most `most` of some things, evenly spread over them.
fn some_of(things: &[usize], most: usize) -> impl Iterator<Item = usize> {
    let count = things.len().min(most);
    (0..count).map(move |i| things[i * things.len() / count])
}

fn likeness(a: &Look, b: &Look) -> f32 {
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
        let Answers { sure, known } = looks.answers(&both, &[], &[]);
        assert!(sure[0][1] > 0.9 && sure[1][4] > 0.9, "{sure:?}");
        assert!(sure[0][4] < 0.1 && sure[1][1] < 0.1, "{sure:?}");
        assert!((sure[0][6] - sure[1][6]).abs() < 0.1, "{sure:?}");
        assert!(sure[0][7] + sure[1][7] < 0.01, "{sure:?}");
        assert!(known[1] > 0.9 && known[6] < 0.5 && known[7] < 1e-3, "{known:?}");
        let denied = looks.answers(&both[..1], &[3, 4, 5], &[]);
        assert!(denied.sure[0][4] < 0.1 && denied.known[4] < 0.1, "{:?}", denied.sure);
        let [alone, open] = [&[][..], &[3, 4, 5]].map(|open| looks.answers(&both[..1], &[], open).sure);
        assert!(open[0][4] < 0.5 * alone[0][4] && open[0][1] > 0.9, "{open:?}, {alone:?}");
        let nothing = looks.answers(&[Vec::new()], &[], &[6, 7]);
        assert_eq!((&nothing.sure[0], &nothing.known), (&vec![0.0; 8], &vec![0.0; 8]));
        assert_eq!(some_of(&[3, 5, 7, 9], 2).collect::<Vec<_>>(), [3, 7]);
    }
}
