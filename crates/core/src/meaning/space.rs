//! The vocabulary as a text encoder sees it.

use super::{
    calibration::{Fit, Query},
    vocabulary::Vocabulary,
};
use crate::{Error, Result, num};
use ndarray::{Array2, ArrayView1, s};
use std::ops::Range;

/// A function that encodes texts as vectors of equal length.
pub type Encode<'a> = dyn FnMut(&[&str]) -> Result<Vec<Vec<f32>>> + 'a;

/// The words of a vocabulary in the space of a text encoder, and what was learned from them about it.
///
/// Vectors lose the mean of the concepts' names before they are compared: encoders give all texts much in
/// common. A vector that is zero, not finite or of another length has a cosine of 0 with everything.
#[derive(Debug)]
pub struct Space<'v> {
    vocabulary: &'v Vocabulary,
    encoder: String,
    mean: Vec<f32>,
    /// The concepts' words, centred, as unit rows.
    words: Array2<f32>,
    /// Rows of each concept.
    rows: Vec<Range<usize>>,
    /// Unrelated words, centred, as unit rows.
    unrelated: Array2<f32>,
    fit: Fit,
}

impl<'v> Space<'v> {
    /// Encodes the vocabulary and fits how far the encoder can be trusted. `encode` is called once, with all
    /// words; it puts them in the scene's template. `encoder` is the hash that the encoder goes by.
    pub fn new(vocabulary: &'v Vocabulary, encoder: &str, encode: &mut Encode<'_>) -> Result<Self> {
        let concepts = vocabulary.concepts();
        let mut texts: Vec<&str> = Vec::new();
        let mut rows = Vec::with_capacity(concepts.len());
        for concept in concepts {
            let from = texts.len();
            texts.extend(concept.words.iter().map(String::as_str));
            rows.push(from..texts.len());
        }
        let listed = texts.len();
        texts.extend(vocabulary.unrelated().iter().map(String::as_str));
        let vectors = encode(&texts)?;
        let dim = vectors.first().map_or(0, Vec::len);
        if vectors.len() != texts.len() || vectors.iter().any(|v| v.len() != dim) {
            let what = format!(
                "the text encoder gave {} vectors, not all of {dim} numbers, for {} words",
                vectors.len(),
                texts.len()
            );
            return Err(Error::input(what, "Choose another text encoder."));
        }
        let mean = mean(rows.iter().map(|r| &vectors[r.start]), dim);
        let (words, unrelated) = vectors.split_at(listed);
        let mut space = Self {
            vocabulary,
            encoder: encoder.to_owned(),
            words: centred_rows(words, &mean),
            unrelated: centred_rows(unrelated, &mean),
            mean,
            rows,
            fit: Fit::default(),
        };
        space.fit = Fit::of(&space);
        Ok(space)
    }

    /// Returns the vocabulary that was encoded.
    pub fn vocabulary(&self) -> &'v Vocabulary {
        self.vocabulary
    }

    /// Returns the hash that the encoder goes by.
    pub fn encoder(&self) -> &str {
        &self.encoder
    }

    /// Returns the mean of the concepts' names.
    pub fn mean(&self) -> &[f32] {
        &self.mean
    }

    /// Returns how far the encoder can be trusted.
    pub fn fit(&self) -> &Fit {
        &self.fit
    }

    /// Returns the concepts that are no rivals of a prompt: the one that it is listed under and those near to
    /// it; for words in no list, the one that the encoder takes for the same.
    pub fn same_as(&self, prompt: &str, embedding: &[f32]) -> Vec<usize> {
        let phrase = self.vocabulary.phrase(prompt);
        let same = match self.vocabulary.look_up(&phrase) {
            Some((concept, _)) => Some(concept),
            None => self.fit.concept_meant(self.vocabulary, &phrase, &self.query(embedding).concepts),
        };
        same.into_iter().flat_map(|concept| [&[concept], self.vocabulary.near(concept)].concat()).collect()
    }

    /// Centres a vector and gives it unit length; all zeros if that is not possible.
    pub(super) fn centred(&self, vector: &[f32]) -> Vec<f32> {
        centred(vector, &self.mean)
    }

    /// A prompt, compared with every concept.
    pub(super) fn query(&self, embedding: &[f32]) -> Query {
        let embedding = self.centred(embedding);
        let cosines = self.words.dot(&ArrayView1::from(&embedding));
        let concepts = self.rows.iter().map(|rows| largest(rows.clone().map(|row| cosines[row]))).collect();
        Query { embedding, concepts }
    }

    /// Calls `visit` with the cosines of each word of the lexicon that is no name with all words: the
    /// concept, the number of the word in it, the cosines.
    pub(super) fn each_synonym(&self, mut visit: impl FnMut(usize, usize, ArrayView1<'_, f32>)) {
        let concepts = self.vocabulary.concepts().iter().zip(&self.rows);
        for (i, (_, rows)) in concepts.enumerate().filter(|(_, (concept, _))| concept.in_lexicon) {
            let cosines = self.words.slice(s![rows.start + 1..rows.end, ..]).dot(&self.words.t());
            for (word, cosines) in cosines.outer_iter().enumerate() {
                visit(i, word + 1, cosines);
            }
        }
    }

    /// The largest cosine of each concept, its word `left_out` not counted.
    pub(super) fn best_of_concepts(
        &self,
        cosines: ArrayView1<'_, f32>,
        left_out: Option<(usize, usize)>,
    ) -> Vec<f32> {
        let left_out = left_out.map(|(concept, word)| self.rows[concept].start + word);
        let counted = |rows: &Range<usize>| rows.clone().filter(|&row| Some(row) != left_out);
        self.rows.iter().map(|rows| largest(counted(rows).map(|row| cosines[row]))).collect()
    }

    /// Unrelated words, compared with every concept.
    pub(super) fn unrelated(&self) -> impl Iterator<Item = (&'v str, Query)> {
        let texts = self.vocabulary.unrelated().iter().map(String::as_str);
        texts.zip(self.unrelated.outer_iter()).map(|(text, row)| {
            let concepts = self.best_of_concepts(self.words.dot(&row).view(), None);
            (text, Query { embedding: row.to_vec(), concepts })
        })
    }
}

/// The largest number; −1 if there is none.
pub(super) fn largest(cosines: impl Iterator<Item = f32>) -> f32 {
    cosines.fold(-1.0, f32::max)
}

/// The mean of the finite vectors.
fn mean<'a>(vectors: impl Iterator<Item = &'a Vec<f32>>, dim: usize) -> Vec<f32> {
    let mut sum = vec![0.0_f64; dim];
    let mut n = 0.0_f64;
    for vector in vectors.filter(|v| v.iter().all(|x| x.is_finite())) {
        sum.iter_mut().zip(vector).for_each(|(sum, &x)| *sum += f64::from(x));
        n += 1.0;
    }
    sum.into_iter().map(|sum| (sum / n.max(1.0)) as f32).collect()
}

fn centred(vector: &[f32], mean: &[f32]) -> Vec<f32> {
    let difference: Vec<f32> = vector.iter().zip(mean).map(|(x, mean)| x - mean).collect();
    // What is left of equal vectors is rounding, which has no meaning.
    let is_usable = vector.len() == mean.len() && num::norm(&difference) > 1e-4 * num::norm(vector);
    let unit = if is_usable { num::normalised(&difference) } else { None };
    unit.unwrap_or_else(|| vec![0.0; mean.len()])
}

fn centred_rows(vectors: &[Vec<f32>], mean: &[f32]) -> Array2<f32> {
    let mut rows = Array2::zeros((vectors.len(), mean.len()));
    for (mut row, vector) in rows.outer_iter_mut().zip(vectors) {
        row.assign(&ArrayView1::from(&centred(vector, mean)));
    }
    rows
}
