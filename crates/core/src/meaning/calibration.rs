//! Measures of an encoder: how far it can be trusted, and what unrelated words reach with a scene's classes.

use super::{
    ClassWords,
    classes::Class,
    grammar::Phrase,
    logistic,
    space::{Half, Space, centred, largest},
    vocabulary::{Clues, Vocabulary},
};
use crate::num;
use rand::{SeedableRng, seq::index};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};
use std::collections::HashSet;

/// Share of the prompts in no list that mean a class of the scene.
const PRIOR: f32 = 0.2;
/// Length of the random lists in which words are asked.
const LIST: usize = 12;
/// Negative samples for each positive one.
const NEGATIVES: usize = 2;
/// Smallest area under the ROC curve with which an encoder tells meanings apart.
const MIN_AUC: f32 = 0.75;
/// Log odds that the words alone give: a constant, and weights of the [`Clues`]. Fits of different encoders
/// agree on them.
const OF_WORDS: [f64; 4] = [-0.6, 2.1, 2.8, 5.5];

/// Odds, by an encoder's cosines, that two words mean the same: learned from one half of the synonyms of the
/// lexicon, each asked as if it were in no list.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Fit {
    /// `true` if cosines say anything about meaning; without, the encoder is not asked.
    pub tells_apart: bool,
    /// Area under the ROC curve of the cosine, on synonyms that the fit has not seen.
    pub auc: f32,
    /// Log odds: constant; weights of the cosine, of its lead over all rivals, and of the clues `telling` and
    /// `head` in the words.
    pub of_encoder: [f32; 5],
    /// The cosine below which 75 % of the words lie that mean something else.
    pub unrelated_cosine: f32,
}

/// The samples for a fit.
#[derive(Default)]
struct Samples {
    cosines: Vec<f32>,
    is_meant: Vec<bool>,
    /// Features and truth of the samples that no clue decides.
    open: Vec<[f64; 5]>,
    open_is_meant: Vec<bool>,
}

impl Fit {
    /// Fits the words of a space.
    pub fn of(space: &Space<'_>) -> Self {
        let samples = Samples::of(space, Half::Fitted);
        let held_out = Samples::of(space, Half::HeldOut);
        let auc = logistic::area_under_curve(&held_out.cosines, &held_out.is_meant);
        let of_encoder = logistic::fit(&samples.open, &samples.open_is_meant).map(|weight| weight as f32);
        let negatives = samples.cosines.iter().zip(&samples.is_meant).filter(|(_, is_meant)| !**is_meant);
        let mut negatives: Vec<f32> = negatives.map(|(cosine, _)| *cosine).collect();
        Self {
            tells_apart: auc >= MIN_AUC && of_encoder[1] > 0.0,
            auc,
            of_encoder,
            unrelated_cosine: num::percentile(&mut negatives, 75.0).unwrap_or(1.0),
        }
    }

    /// Log odds that a prompt means something, from its clues, the cosine and its lead over rivals. The
    /// encoder only counts above `floor`.
    pub(super) fn log_odds(&self, clues: Clues, cosine: f32, lead: f32, floor: f32) -> f32 {
        let sum = |weights: &[f64], features: &[f64]| -> f64 {
            weights.iter().zip(features).map(|(weight, feature)| weight * feature).sum()
        };
        let words = sum(&OF_WORDS, &[1.0, clues.covered, clues.telling, clues.head]);
        let encoder = sum(&self.of_encoder.map(f64::from), &features(clues, cosine, lead));
        let counts = self.tells_apart && cosine > floor;
        (if counts { words.max(encoder) } else { words }) as f32 + num::logit(PRIOR)
    }

    /// The concept that words in no list mean most probably, if that is more probable than not.
    fn concept_meant(&self, vocabulary: &Vocabulary, phrase: &Phrase, cosines: &[f32]) -> Option<usize> {
        let odds = |concept: usize| {
            let words = content_words(vocabulary, concept, None);
            let clues = vocabulary.clues(phrase, &words, Some(concept))?;
            let lead = lead(cosines, concept);
            Some(self.log_odds(clues, cosines[concept], lead, self.unrelated_cosine))
                .filter(|odds| *odds > 0.0)
        };
        let likely = (0..cosines.len()).filter_map(|concept| Some((odds(concept)?, concept)));
        likely.max_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, concept)| concept)
    }
}

impl Space<'_> {
    /// Returns the concepts that are no rivals of a prompt: the one that it is listed under and those near to
    /// it; for words in no list, the one that the encoder takes for the same.
    pub fn same_as(&self, fit: &Fit, prompt: &str, embedding: &[f32]) -> Vec<usize> {
        let vocabulary = self.vocabulary();
        let phrase = vocabulary.phrase(prompt);
        let same = match vocabulary.look_up(&phrase) {
            Some((concept, _)) => Some(concept),
            None => fit.concept_meant(vocabulary, &phrase, &self.query(embedding).concepts),
        };
        same.into_iter().flat_map(|concept| [&[concept], vocabulary.near(concept)].concat()).collect()
    }
}

fn features(clues: Clues, cosine: f32, lead: f32) -> [f64; 5] {
    [1.0, f64::from(cosine), f64::from(lead), clues.telling, clues.head]
}

/// Lead of one cosine over all others.
fn lead(cosines: &[f32], of: usize) -> f32 {
    let rivals = cosines.iter().enumerate().filter(|(i, _)| *i != of);
    cosines[of] - largest(rivals.map(|(_, cosine)| *cosine))
}

/// The words of content of a concept, its word `left_out` not counted.
fn content_words(vocabulary: &Vocabulary, concept: usize, left_out: Option<usize>) -> HashSet<&str> {
    let contents = vocabulary.concepts()[concept].contents.iter().enumerate();
    let counted = contents.filter(|(word, _)| Some(*word) != left_out);
    counted.flat_map(|(_, content)| content).map(String::as_str).collect()
}

impl Samples {
    /// Asks each synonym of one half of the lexicon in random lists of concepts, once with its own concept in
    /// the list and the word itself taken out of it, and some times with its own concept unknown; then the
    /// unrelated words.
    fn of(space: &Space<'_>, half: Half) -> Self {
        let vocabulary = space.vocabulary();
        let concepts = vocabulary.concepts();
        let listed: Vec<usize> = (0..concepts.len()).filter(|&i| concepts[i].num_in_lexicon > 0).collect();
        let mut rng = ChaCha8Rng::seed_from_u64(0);
        let mut list = || -> Vec<usize> {
            index::sample(&mut rng, listed.len(), LIST.min(listed.len())).iter().map(|i| listed[i]).collect()
        };
        let mut samples = Self::default();
        space.each_synonym(half, |own, word, cosines| {
            let phrase = vocabulary.phrase(&concepts[own].words[word]);
            let mut best = space.best_of_concepts(cosines, Some((own, word)));
            vocabulary.near(own).iter().for_each(|&near| best[near] = -1.0);
            let others = |list: Vec<usize>| {
                list.into_iter().filter(|i| *i != own && !vocabulary.near(own).contains(i))
            };
            let with_own: Vec<_> = others(list()).chain([own]).collect();
            samples.add(vocabulary, &phrase, &best, &with_own, Some((own, word)));
            best[own] = -1.0;
            for _ in 0..NEGATIVES {
                samples.add(
                    vocabulary,
                    &phrase,
                    &best,
                    &others(list()).collect::<Vec<_>>(),
                    Some((own, word)),
                );
            }
        });
        for (text, mut query) in space.unrelated() {
            let phrase = vocabulary.phrase(text);
            if let Some((own, _)) = vocabulary.look_up(&phrase) {
                query.concepts[own] = -1.0;
            }
            samples.add(vocabulary, &phrase, &query.concepts, &list(), None);
        }
        samples
    }

    /// Adds the concept of `list` that is nearest to a phrase as a sample; `own` is the phrase's concept and
    /// its number among the concept's words.
    fn add(
        &mut self,
        vocabulary: &Vocabulary,
        phrase: &Phrase,
        cosines: &[f32],
        list: &[usize],
        own: Option<(usize, usize)>,
    ) {
        let nearest = list.iter().copied().max_by(|&a, &b| cosines[a].total_cmp(&cosines[b]));
        let Some(nearest) = nearest else { return };
        let own = own.filter(|(concept, _)| *concept == nearest);
        self.cosines.push(cosines[nearest]);
        self.is_meant.push(own.is_some());
        let words = content_words(vocabulary, nearest, own.map(|(_, word)| word));
        if let Some(clues) = vocabulary.clues(phrase, &words, Some(nearest)) {
            self.open.push(features(clues, cosines[nearest], lead(cosines, nearest)));
            self.open_is_meant.push(own.is_some());
        }
    }
}

/// Measures of an encoder and a scene's classes, made once and kept in the scene file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Calibration {
    /// Hash of the vocabulary.
    pub vocabulary: String,
    /// Hash that the encoder goes by.
    pub encoder: String,
    /// Mean of the vocabulary's concepts, which vectors lose before they are compared.
    pub mean: Vec<f32>,
    /// Fit that tells how far the encoder can be trusted.
    pub fit: Fit,
    /// Cosines that unrelated words reach with the scene's classes.
    pub floors: Floors,
}

/// Cosines that unrelated words reach with a scene's classes.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Floors {
    /// 95 % quantile of the cosine with the nearest class.
    pub nearest: f32,
    /// 50, 95 and 100 % quantile for each class.
    pub classes: Vec<[f32; 3]>,
}

impl Calibration {
    /// Measures an encoder and the classes of a scene.
    pub fn measure(space: &Space<'_>, classes: &[ClassWords]) -> Self {
        Self {
            vocabulary: space.vocabulary().sha256().to_owned(),
            encoder: space.encoder().to_owned(),
            mean: space.mean().to_vec(),
            fit: Fit::of(space),
            floors: Floors::measure(space, classes),
        }
    }

    /// The cosine with a class that a prompt has to exceed for the encoder to count. A vector without a
    /// direction, whose cosines are 0, never does.
    pub(super) fn floor(&self) -> f32 {
        self.floors.nearest.max(self.fit.unrelated_cosine).max(0.0)
    }
}

impl Floors {
    /// Measures the classes of a scene. Without classes or unrelated words, nothing is above the floors.
    pub fn measure(space: &Space<'_>, classes: &[ClassWords]) -> Self {
        let classes = Class::all(space.vocabulary(), classes);
        let cosines: Vec<Vec<f32>> = space
            .unrelated()
            .map(|(_, query)| name_cosines(&query.embedding, space.mean(), &classes))
            .collect();
        let quantile = |mut values: Vec<f32>, q: f64| num::percentile(&mut values, q).unwrap_or(1.0);
        let nearest = cosines.iter().filter(|row| !row.is_empty()).map(|row| largest(row.iter().copied()));
        Self {
            nearest: quantile(nearest.collect(), 95.0),
            classes: (0..classes.len())
                .map(|i| [50.0, 95.0, 100.0].map(|q| quantile(cosines.iter().map(|row| row[i]).collect(), q)))
                .collect(),
        }
    }
}

/// The cosine of a centred unit embedding with the name of each class; `mean` is what embeddings lose.
pub(super) fn name_cosines(embedding: &[f32], mean: &[f32], classes: &[Class]) -> Vec<f32> {
    classes.iter().map(|class| num::dot(&centred(&class.embedding, mean), embedding)).collect()
}
