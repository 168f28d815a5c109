//! Weak seeds everywhere, of things that look like marked ones: they reach parts that no mark touches.

use super::{
    links::Links,
    looks::{Answers, Looks},
    seeds::Seeds,
};

/// Share of a name from which on a marked thing is an example of the name's looks.
const EXAMPLE: f32 = 0.5;
/// Part of all shares from which on a thing that is not marked is one.
const CLEAR: f32 = 0.7;
/// Part of all shares that no name has, from which on the name of a thing that is not marked is open.
const OPEN: f32 = 0.3;
/// Variance of an open thing's answer where half of the picture has a name. Where less has, most that is open
/// shows nothing that was marked, and counts more.
const NAMED: f64 = 3.0;
/// Number of marked things of a name that tell its looks well; fewer weigh less.
const MANY: f32 = 200.0;
/// Power of answers: names that are hardly less sure do not share a thing.
const CERTAIN: i32 = 2;
/// Weight of what another frame tells surely of a thing, beside that of looks.
const TOLD: f32 = 100.0;

/// A share of each name for each thing, as its looks tell, and how sure that is. What looks like nothing that
/// is marked has a share of no name.
pub(super) struct Hints {
    /// [names][things].
    pub(super) shares: Vec<Vec<f32>>,
    /// Weight of each thing: up to 1 for its looks, more with what is told.
    pub(super) weights: Vec<f32>,
}

/// Shares that other marked frames tell.
pub(super) struct Told {
    /// [names][things].
    pub(super) shares: Vec<Vec<f32>>,
    /// Certainty of the shares of each thing, about 0–1.
    pub(super) weights: Vec<f32>,
}

impl Hints {
    /// Takes as examples of a name what is marked so, and what `shares` clearly give to it, if there are some.
    /// What is denied all names is an example of none.
    pub(super) fn of(looks: &Looks, links: &Links, seeds: &Seeds, shares: &[Vec<f32>]) -> Self {
        let names = 0..seeds.weights.len();
        let is_marked = |k: usize, i: usize| {
            let (weight, share) = (seeds.weights[k][i], seeds.shares[k][i]);
            weight > EXAMPLE && share > EXAMPLE * weight
        };
        let is_clear = |k: usize, i: usize| {
            links.degrees[i] > 0.0 && shares.get(k).is_some_and(|plane| plane[i] > CLEAR)
        };
        let marked = |k: usize| (0..links.len()).filter(|i| is_marked(k, *i)).count();
        let counts: Vec<usize> = names.clone().map(marked).collect();
        let examples = |k: usize| -> Vec<usize> {
            (0..links.len()).filter(|i| counts[k] > 0 && (is_marked(k, *i) || is_clear(k, *i))).collect()
        };
        let shows = |i: &usize| names.clone().any(|k| is_marked(k, *i));
        let is_denied = |i: &usize| names.clone().all(|k| seeds.weights[k][*i] > EXAMPLE) && !shows(i);
        let is_left = |i: usize| shares.iter().map(|plane| plane[i]).sum::<f32>() < 1.0 - OPEN;
        let is_open = |i: &usize| links.degrees[*i] > 0.0 && !shows(i) && !is_denied(i) && is_left(*i);
        let denied: Vec<usize> = (0..links.len()).filter(is_denied).collect();
        let open: Vec<usize> = (0..links.len()).filter(is_open).collect();
        let examples: Vec<Vec<usize>> = names.clone().map(examples).collect();
        let shown = counts.iter().filter(|count| **count > 0).count().max(1);
        let variance = if shares.is_empty() {
            // The more names there are, the likelier a thing shows one of them.
            shown.pow(3) as f64
        } else {
            let inside = links.degrees.iter().filter(|degree| **degree > 0.0).count();
            let odds = inside.saturating_sub(open.len()) as f64 / open.len().max(1) as f64;
            NAMED * odds.powi(3)
        };
        let answers = looks.answers(&examples, &denied, (&open, variance));
        let marked = counts.iter().sum::<usize>() as f32 / shown as f32;
        Self::weighed(answers, (marked / MANY).min(1.0))
    }

    /// Takes what other frames tell alone.
    pub(super) fn of_told(told: &Told) -> Self {
        let nothing = vec![0.0; told.weights.len()];
        Self { shares: vec![nothing.clone(); told.shares.len()], weights: nothing }.with_told(told)
    }

    /// Adds what other frames tell of each thing: shares, [names][things], and how sure they are.
    pub(super) fn with_told(mut self, told: &Told) -> Self {
        for (i, weight) in self.weights.iter_mut().enumerate() {
            let other = TOLD * told.weights[i];
            let sum = (*weight + other).max(f32::MIN_POSITIVE);
            for (own, told) in self.shares.iter_mut().zip(&told.shares) {
                own[i] = (*weight * own[i] + other * told[i]) / sum;
            }
            *weight += other;
        }
        self
    }

    /// Makes answers shares, and leaves what is not known to no name; `trust` is the weight of a sure one.
    fn weighed(Answers { mut sure, known }: Answers, trust: f32) -> Self {
        let mut weights = vec![0.0; known.len()];
        for (i, weight) in weights.iter_mut().enumerate() {
            let answered: f32 = sure.iter().map(|plane| plane[i]).sum();
            let none = 1.0 - known[i].min(answered.min(1.0));
            let largest = sure.iter().map(|plane| plane[i]).fold(none, f32::max);
            *weight = trust * largest;
            sure.iter_mut().for_each(|plane| plane[i] = plane[i].powi(CERTAIN));
            let sum = sure.iter().map(|plane| plane[i]).sum::<f32>() + none.powi(CERTAIN);
            sure.iter_mut().for_each(|plane| plane[i] /= sum.max(f32::MIN_POSITIVE));
        }
        Self { shares: sure, weights }
    }
}
