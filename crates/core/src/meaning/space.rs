//! The vocabulary as a text encoder sees it.

use super::{classes::Class, vocabulary::Vocabulary};
use crate::{Error, Result, hash::sha256, num};
use half::f16;
use ndarray::{Array2, ArrayView1};
use std::ops::Range;

/// A function that encodes texts as vectors of equal length.
pub type Encode<'a> = dyn FnMut(&[&str]) -> Result<Vec<Vec<f32>>> + 'a;

/// The words of a vocabulary in the space of a text encoder.
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
    /// The concepts' names as they were encoded, unit rows.
    names: Array2<f32>,
}

impl<'v> Space<'v> {
    /// Encodes the vocabulary. `encode` is called once, with all words; it puts them in the scene's template.
    /// `encoder` is the hash that the encoder goes by.
    pub fn new(vocabulary: &'v Vocabulary, encoder: &str, encode: &mut Encode<'_>) -> Result<Self> {
        let texts = Self::texts(vocabulary);
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
        Ok(Self::of(vocabulary, encoder, &vectors, dim))
    }

    /// Makes a space of vectors that were kept, one after the other; `None` if they do not fit the vocabulary.
    pub fn of_kept(vocabulary: &'v Vocabulary, encoder: &str, kept: &[f16]) -> Option<Self> {
        let count = Self::texts(vocabulary).len();
        let dim = kept.len().checked_div(count).filter(|dim| *dim > 0 && dim * count == kept.len())?;
        let vectors: Vec<Vec<f32>> =
            kept.chunks_exact(dim).map(|row| row.iter().map(|v| v.to_f32()).collect()).collect();
        Some(Self::of(vocabulary, encoder, &vectors, dim))
    }

    /// Returns the texts that a space is made of: some words of each concept, then unrelated words.
    pub fn texts(vocabulary: &Vocabulary) -> Vec<&str> {
        let concepts = vocabulary.concepts().iter().flat_map(|concept| concept.encoded());
        concepts.chain(vocabulary.unrelated()).map(String::as_str).collect()
    }

    /// Makes a space of a vector of `dim` numbers for each text.
    fn of(vocabulary: &'v Vocabulary, encoder: &str, vectors: &[Vec<f32>], dim: usize) -> Self {
        let mut listed = 0;
        let mut rows = Vec::with_capacity(vocabulary.concepts().len());
        for concept in vocabulary.concepts() {
            rows.push(listed..listed + concept.encoded().len());
            listed += concept.encoded().len();
        }
        let mean = mean(rows.iter().map(|r| &vectors[r.start]), dim);
        let (words, unrelated) = vectors.split_at(listed);
        let names: Vec<f32> = rows.iter().flat_map(|r| vectors[r.start].iter().copied()).collect();
        Self {
            vocabulary,
            encoder: encoder.to_owned(),
            words: centred_rows(words, &mean),
            unrelated: centred_rows(unrelated, &mean),
            names: Array2::from_shape_vec((rows.len(), dim), names).unwrap_or_default(),
            mean,
            rows,
        }
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

    /// Returns the concepts' names with their embeddings.
    pub fn concepts(&self) -> impl Iterator<Item = (&'v str, &[f32])> {
        let rows = self.names.outer_iter().map(|row| row.to_slice().unwrap_or(&[]));
        self.vocabulary.concepts().iter().map(|concept| concept.name.as_str()).zip(rows)
    }

    /// A vector without the mean of the concepts, as a unit vector.
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

    /// Calls `visit` with the cosines of the synonyms of the lexicon with all words, those of one half: the
    /// concept, the number of the word in it, the cosines.
    pub(super) fn each_synonym(&self, half: Half, mut visit: impl FnMut(usize, usize, ArrayView1<'_, f32>)) {
        for (i, (concept, rows)) in self.vocabulary.concepts().iter().zip(&self.rows).enumerate() {
            for (k, word) in concept.encoded().iter().enumerate().skip(1) {
                if Half::of(word) == half {
                    visit(i, k, self.words.dot(&self.words.row(rows.start + k)).view());
                }
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

/// A prompt in an encoder's space.
#[derive(Clone, Debug)]
pub(super) struct Query {
    /// The centred unit embedding.
    pub embedding: Vec<f32>,
    /// Its largest cosine with the words of each concept.
    pub concepts: Vec<f32>,
}

impl Query {
    /// The cosine with each class: with its name or with a word of its concept, whichever is larger.
    pub(super) fn class_cosines(&self, space: &Space<'_>, classes: &[Class]) -> Vec<f32> {
        let cosine = |class: &Class| {
            let own = num::dot(&space.centred(&class.embedding), &self.embedding);
            class.concept.map_or(own, |concept| own.max(self.concepts[concept]))
        };
        classes.iter().map(cosine).collect()
    }
}

/// Half of the lexicon's synonyms.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Half {
    /// Fits are made on these.
    Fitted,
    /// Fits are judged on these.
    HeldOut,
}

impl Half {
    /// Half that a word is in, by its hash.
    fn of(word: &str) -> Self {
        let is_even = sha256(word.as_bytes()).bytes().next().is_some_and(|digit| digit % 2 == 0);
        if is_even { Self::Fitted } else { Self::HeldOut }
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

/// Takes the mean from a vector and gives it unit length; all zeros if that is not possible.
pub(super) fn centred(vector: &[f32], mean: &[f32]) -> Vec<f32> {
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
