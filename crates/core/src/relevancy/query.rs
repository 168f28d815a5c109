//! Prompts as vectors: what each may be, and everything that competes with it.

use crate::{Error, Result, codec::Codec, num};
use ndarray::{Array2, ArrayView2};
use std::sync::Arc;

/// Margin of a prompt that means nothing: its scores are 0 at every temperature in use.
const NEVER: f32 = -1e4;

/// Texts that every prompt of a scene competes with: its classes, or the concepts of a vocabulary.
#[derive(Clone, Debug, Default)]
pub struct Rivals {
    names: Vec<String>,
    /// Unit embeddings, [names, dim].
    rows: Array2<f32>,
}

impl Rivals {
    /// Collects texts with their unit embeddings. A text whose embedding is not as long as the first one's
    /// is left out.
    pub fn new<'a>(texts: impl IntoIterator<Item = (&'a str, &'a [f32])>) -> Arc<Self> {
        let (mut names, mut flat, mut dim) = (Vec::new(), Vec::new(), None);
        for (name, row) in texts.into_iter().filter(|(_, row)| !row.is_empty()) {
            if *dim.get_or_insert(row.len()) == row.len() {
                names.push(name.to_owned());
                flat.extend_from_slice(row);
            }
        }
        let rows = Array2::from_shape_vec((names.len(), dim.unwrap_or(0)), flat).unwrap_or_default();
        Arc::new(Self { names, rows })
    }

    /// Returns the number of texts.
    pub fn len(&self) -> usize {
        self.names.len()
    }

    /// Returns `true` if there are no texts.
    pub fn is_empty(&self) -> bool {
        self.names.is_empty()
    }

    /// Returns the unit embeddings, [texts, dim].
    pub(super) fn rows(&self) -> ArrayView2<'_, f32> {
        self.rows.view()
    }
}

impl PartialEq for Rivals {
    fn eq(&self, other: &Self) -> bool {
        std::ptr::eq(self, other) || (self.names == other.names && self.rows == other.rows)
    }
}

/// One encoded prompt with everything that it is compared with.
#[derive(Clone, Debug, PartialEq)]
pub struct Query {
    /// The words as typed.
    pub prompt: String,
    /// Unit embeddings of what the prompt means; the one nearest to a pixel counts. Without any, nothing is
    /// found.
    pub meant: Vec<Vec<f32>>,
    /// Probability that the prompt means these, 0–1; no score is higher.
    pub certainty: f32,
    /// Unit embeddings that this prompt alone is compared with, with their words.
    pub negatives: Vec<(String, Vec<f32>)>,
    /// Texts that all prompts compete with.
    pub rivals: Arc<Rivals>,
    /// Indices of rivals that mean the same as the prompt and do not compete with it.
    pub allies: Vec<usize>,
}

impl Query {
    /// Asks for an embedding that competes with nothing yet.
    pub fn new(prompt: &str, embedding: Vec<f32>) -> Self {
        Self {
            prompt: prompt.to_owned(),
            meant: vec![embedding],
            certainty: 1.0,
            negatives: Vec::new(),
            rivals: Arc::default(),
            allies: Vec::new(),
        }
    }

    /// Adds words that this prompt alone is compared with.
    pub fn but_not(self, negatives: Vec<(String, Vec<f32>)>) -> Self {
        Self { negatives, ..self }
    }

    /// Lets the prompt compete with `rivals`, all but those of the indices `allies`.
    pub fn among(self, rivals: &Arc<Rivals>, allies: Vec<usize>) -> Self {
        Self { rivals: rivals.clone(), allies, ..self }
    }

    /// Returns the words that the prompt is compared with: its own negatives, then the rivals.
    pub fn compared_with(&self) -> impl Iterator<Item = &str> {
        let own = self.negatives.iter().map(|(words, _)| words.as_str());
        own.chain(self.competitors().map(|k| self.rivals.names[k].as_str()))
    }

    /// Checks that a scene with `codec` can answer this query; the error says what does not fit. The
    /// scores of a query that does not fit are zero everywhere.
    pub fn check(&self, codec: &Codec) -> Result<()> {
        let dim = codec.embedding_dim();
        if let Some(length) = self.texts().map(<[f32]>::len).find(|length| *length != dim) {
            return Err(Error::input(
                format!(
                    "the prompt \"{}\" was encoded with {length} numbers, the scene's features have {dim}",
                    self.prompt,
                ),
                "Choose the text encoder that the scene was prepared with.",
            ));
        }
        if !self.texts().flatten().all(|v| v.is_finite()) {
            return Err(Error::input(
                format!("the encoding of the prompt \"{}\" or of a negative is not finite", self.prompt),
                "Check the text encoder.",
            ));
        }
        Ok(())
    }

    /// Largest margin that a temperature allows, see [`Query::certainty`].
    fn largest_margin(&self, temperature: f32) -> f32 {
        let limit = num::logit(self.certainty.clamp(0.0, 1.0)) / temperature;
        if limit.is_nan() { NEVER } else { limit.max(NEVER) }
    }

    /// Indices of the rivals that compete.
    fn competitors(&self) -> impl Iterator<Item = usize> {
        (0..self.rivals.len()).filter(|k| !self.allies.contains(k))
    }

    /// Embeddings of what is meant, then those of the negatives, then those of competing rivals.
    pub fn texts(&self) -> impl Iterator<Item = &[f32]> {
        let rival = |k: usize| self.rivals.rows.row(k).to_slice().unwrap_or(&[]);
        self.own_texts().chain(self.competitors().map(rival))
    }

    /// Embeddings of what is meant, then those of the negatives.
    fn own_texts(&self) -> impl Iterator<Item = &[f32]> {
        self.meant.iter().chain(self.negatives.iter().map(|(_, e)| e)).map(Vec::as_slice)
    }

    /// Texts as rows, those that are meant first; `None` if they do not fit `codec`.
    pub(super) fn rows(&self, codec: &Codec, temperature: f32) -> Option<TextRows> {
        self.rows_of(self.texts(), codec, temperature)
    }

    /// Texts without the rivals as rows; `None` if any text does not fit `codec`.
    pub(super) fn own_rows(&self, codec: &Codec, temperature: f32) -> Option<TextRows> {
        self.rows_of(self.own_texts(), codec, temperature)
    }

    /// Margin of one embedding, as it enters the score.
    pub(super) fn margin(&self, embedding: &[f32], temperature: f32) -> f32 {
        let cosines: Vec<f32> = self.texts().map(|text| num::dot(text, embedding)).collect();
        let (num_meant, largest) = (self.meant.len(), self.largest_margin(temperature));
        TextRows { rows: Array2::default((0, 0)), num_meant, largest }.margin(&cosines, None)
    }

    fn rows_of<'a>(
        &self,
        texts: impl Iterator<Item = &'a [f32]>,
        codec: &Codec,
        temperature: f32,
    ) -> Option<TextRows> {
        self.check(codec).ok()?;
        let flat: Vec<f32> = texts.flatten().copied().collect();
        let dim = codec.embedding_dim();
        let rows = Array2::from_shape_vec((flat.len() / dim.max(1), dim), flat).ok()?;
        Some(TextRows { rows, num_meant: self.meant.len(), largest: self.largest_margin(temperature) })
    }
}

/// Texts of a query as rows, to be compared with many embeddings.
#[derive(Clone, Debug)]
pub(super) struct TextRows {
    /// [texts, dim], those that are meant first.
    pub(super) rows: Array2<f32>,
    num_meant: usize,
    largest: f32,
}

impl TextRows {
    /// The same texts in another basis, whose vectors are the columns of `basis`.
    pub(super) fn in_basis(&self, basis: &Array2<f32>) -> Self {
        Self { rows: self.rows.dot(basis), ..*self }
    }

    /// Returns max p − max n, at most the largest margin: p are the cosines with what is meant (the first of
    /// `cosines`), n the others and `rival`. Without any n it is max p.
    pub(super) fn margin(&self, cosines: &[f32], rival: Option<f32>) -> f32 {
        // Unlike `f32::max`, keeps NaN of the first value: such a point is not decided by a table.
        let best = |values: &[f32]| values.iter().copied().reduce(|a, b| if b > a { b } else { a });
        let (meant, others) = cosines.split_at(self.num_meant.min(cosines.len()));
        let Some(meant) = best(meant) else { return NEVER };
        let other = match (best(others), rival) {
            (Some(a), Some(b)) => Some(if b > a { b } else { a }),
            (a, b) => a.or(b),
        };
        let margin = other.map_or(meant, |other| meant - other);
        if margin > self.largest { self.largest } else { margin }
    }
}
