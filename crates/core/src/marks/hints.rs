//! Weak seeds at all nodes that look like marked ones: they reach parts that no mark touches.

use super::{
    appearance::{AppearanceFeatures, Prediction, Unlabelled},
    links::Links,
    seeds::Seeds,
};

/// Share of a name above which a marked node is a positive example of it.
const MIN_MARKED_SHARE: f32 = 0.5;
/// Share of a name above which a node without marks is a positive example of it.
const MIN_CLEAR_SHARE: f32 = 0.7;
/// Share of no name above which a node without marks is an unlabelled example.
const MIN_UNNAMED_SHARE: f32 = 0.3;
/// Variance of an unlabelled example where half of the picture has a name. Where less has one, most
/// unlabelled nodes show nothing that was marked, and count more.
const EVEN_ODDS_VARIANCE: f64 = 3.0;
/// Odds that a node shows a name above which even one that is unlike all examples may show one.
const HIGH_ODDS: f64 = 6.0;
/// Number of marked nodes per name from which on hints have their full weight.
const MANY_MARKED: f32 = 200.0;
/// Power of scores: names with close scores do not share a node.
pub(super) const SCORE_POWER: i32 = 2;
/// Weight of the shares of guides where they are certain, beside that of appearance.
const GUIDE_WEIGHT: f32 = 100.0;

/// Share of each name at each node, predicted from appearance, with a weight. A node that looks like no
/// marked one has a share of no name.
pub(super) struct Hints {
    /// [names][nodes].
    pub(super) shares: Vec<Vec<f32>>,
    /// Weights of the shares, [names][nodes]: up to 1 for appearance, more with guides.
    pub(super) weights: Vec<Vec<f32>>,
}

/// Shares looked up from the guides of a frame.
pub(super) struct GuideShares {
    /// [names][nodes].
    pub(super) shares: Vec<Vec<f32>>,
    /// Certainty of the shares, about 0–1: [names][nodes].
    pub(super) weights: Vec<Vec<f32>>,
}

impl Hints {
    /// Predicts the shares. Positive examples of a name are the nodes that are marked so, and those that
    /// `shares`, if there are any, clearly give to it. Pixels or Gaussians denied for every name are negative
    /// examples. Shares may have one more plane than there are names: parts of nodes that show a name, but no
    /// longer the one that they were given to.
    pub(super) fn of(
        appearance: &AppearanceFeatures,
        links: &Links,
        seeds: &Seeds,
        shares: &[Vec<f32>],
    ) -> Self {
        let names = 0..seeds.weights.len();
        let is_marked = |k: usize, i: usize| {
            let (weight, share) = (seeds.weights[k][i], seeds.shares[k][i]);
            weight > MIN_MARKED_SHARE && share > MIN_MARKED_SHARE * weight
        };
        let is_clear = |k: usize, i: usize| {
            links.degrees[i] > 0.0 && shares.get(k).is_some_and(|plane| plane[i] > MIN_CLEAR_SHARE)
        };
        let marked = |k: usize| (0..links.len()).filter(|i| is_marked(k, *i)).count();
        let counts: Vec<usize> = names.clone().map(marked).collect();
        let positives = |k: usize| -> Vec<usize> {
            (0..links.len()).filter(|i| counts[k] > 0 && (is_marked(k, *i) || is_clear(k, *i))).collect()
        };
        let shows = |i: &usize| names.clone().any(|k| is_marked(k, *i));
        let is_denied =
            |i: &usize| names.clone().all(|k| seeds.weights[k][*i] > MIN_MARKED_SHARE) && !shows(i);
        let is_unnamed =
            |i: usize| shares.iter().map(|plane| plane[i]).sum::<f32>() < 1.0 - MIN_UNNAMED_SHARE;
        let is_unlabelled =
            |i: &usize| links.degrees[*i] > 0.0 && !shows(i) && !is_denied(i) && is_unnamed(*i);
        let denied: Vec<usize> = (0..links.len()).filter(is_denied).collect();
        let unlabelled: Vec<usize> = (0..links.len()).filter(is_unlabelled).collect();
        let positives: Vec<Vec<usize>> = names.clone().map(positives).collect();
        let shown = counts.iter().filter(|count| **count > 0).count().max(1);
        let (variance, nearness_power) = if shares.is_empty() {
            // The more names there are, the likelier a node shows one of them.
            (shown.pow(3) as f64, 1.0)
        } else {
            let inside = links.degrees.iter().filter(|degree| **degree > 0.0).count();
            let odds = inside.saturating_sub(unlabelled.len()) as f64 / unlabelled.len().max(1) as f64;
            (EVEN_ODDS_VARIANCE * odds.powi(3), (HIGH_ODDS / odds).min(1.0))
        };
        let unlabelled = Unlabelled { nodes: &unlabelled, variance };
        let mut prediction = appearance.predict(&positives, &denied, unlabelled);
        prediction.nearness.iter_mut().for_each(|near| *near = near.powf(nearness_power as f32));
        let marked = counts.iter().sum::<usize>() as f32 / shown as f32;
        Self::from_prediction(prediction, (marked / MANY_MARKED).min(1.0))
    }

    /// Takes the shares of guides alone.
    pub(super) fn from_guides(guides: &GuideShares) -> Self {
        let zeros: Vec<Vec<f32>> = guides.shares.iter().map(|plane| vec![0.0; plane.len()]).collect();
        Self { shares: zeros.clone(), weights: zeros }.with_guides(guides)
    }

    /// Mixes in the shares of guides.
    pub(super) fn with_guides(mut self, guides: &GuideShares) -> Self {
        let own = self.shares.iter_mut().zip(&mut self.weights);
        for ((shares, weights), (guides, certainty)) in own.zip(guides.shares.iter().zip(&guides.weights)) {
            for (i, (share, weight)) in shares.iter_mut().zip(weights).enumerate() {
                let other = GUIDE_WEIGHT * certainty[i];
                let sum = (*weight + other).max(f32::MIN_POSITIVE);
                *share = (*weight * *share + other * guides[i]) / sum;
                *weight += other;
            }
        }
        self
    }

    /// Turns scores into shares; no name has the rest. `trust` is the weight of a score of 1.
    fn from_prediction(Prediction { score: mut shares, nearness }: Prediction, trust: f32) -> Self {
        let mut weights = vec![0.0; nearness.len()];
        for (i, weight) in weights.iter_mut().enumerate() {
            let total: f32 = shares.iter().map(|plane| plane[i]).sum();
            let none = 1.0 - nearness[i].min(total.min(1.0));
            let largest = shares.iter().map(|plane| plane[i]).fold(none, f32::max);
            *weight = trust * largest;
            shares.iter_mut().for_each(|plane| plane[i] = plane[i].powi(SCORE_POWER));
            let sum = shares.iter().map(|plane| plane[i]).sum::<f32>() + none.powi(SCORE_POWER);
            shares.iter_mut().for_each(|plane| plane[i] /= sum.max(f32::MIN_POSITIVE));
        }
        Self { weights: vec![weights; shares.len()], shares }
    }
}
