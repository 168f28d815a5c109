//! Relevancy of pixels for a prompt: score = σ(T·(p − max_i n_i)) (method §9.2).
//!
//! p and n_i are cosines of the pixel's decoded feature with the prompt and with the negatives. The
//! formula is the smallest of the pairwise softmaxes in the paper. Three rungs compute it: [`Exact`]
//! decodes every pixel, [`Folded`] gets the same value with fewer operations, [`Lattice`] looks it up.

mod decoding;
mod fidelity;
mod folded;
mod lattice;
mod points;

pub use decoding::Exact;
pub use fidelity::{Fidelity, fidelity};
pub use folded::Folded;
pub use lattice::{Lattice, LatticeReport, LatticeTables};
pub use points::Points;

use crate::{Error, Result, codec::Codec, grid::Grid, num, raster::Images, sequence::Class};
use ndarray::Array2;

/// Settings of a query that the user can see; recorded with every result.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct RelevancySettings {
    /// Sharpness of the score; 10 in the reference code.
    pub temperature: f32,
    /// Score above which a pixel is found; 0.4 in the paper.
    pub threshold: f32,
    /// Canonical phrases, encoded without the template.
    pub phrases: Vec<String>,
    /// `true` to use the scene's other classes as negatives too (all but those nearest to the prompt).
    pub class_negatives: bool,
    /// Smallest accumulated opacity. Pixels with less are holes, which are never found.
    pub min_alpha: f32,
}

impl Default for RelevancySettings {
    fn default() -> Self {
        Self {
            temperature: 10.0,
            threshold: 0.4,
            phrases: ["object", "things", "stuff", "texture"].map(String::from).to_vec(),
            class_negatives: true,
            min_alpha: 0.5,
        }
    }
}

/// One encoded prompt with everything that it is compared with.
#[derive(Clone, Debug, PartialEq)]
pub struct Query {
    /// The words as typed.
    pub prompt: String,
    /// Unit embedding of the (templated) prompt.
    pub embedding: Vec<f32>,
    /// Unit embeddings of the negatives, with their words.
    pub negatives: Vec<(String, Vec<f32>)>,
}

/// Margin of classes that are too near to the prompt to be its negatives: their cosine with the prompt is
/// above best − `CLASS_MARGIN` · (best − mean over the classes). It is relative, because encoders differ
/// in how far apart they put words: related names may differ by 0.3 in one and by 0.03 in another.
pub const CLASS_MARGIN: f32 = 0.25;

impl Query {
    /// Chooses the negatives for a prompt: the phrases, and depending on the settings the scene's other
    /// classes (all but the nearest one and those within [`CLASS_MARGIN`] of it). Classes whose embedding
    /// has another length than the prompt's are left out.
    pub fn new(
        prompt: &str,
        embedding: Vec<f32>,
        phrases: &[(String, Vec<f32>)],
        classes: &[(Class, Vec<f32>)],
        settings: &RelevancySettings,
    ) -> Self {
        let mut negatives = phrases.to_vec();
        if settings.class_negatives {
            let fitting = classes.iter().filter(|(_, e)| e.len() == embedding.len());
            let cosines: Vec<_> = fitting.map(|c| (c, num::dot(&c.1, &embedding))).collect();
            let best = cosines.iter().map(|c| c.1).fold(f32::NEG_INFINITY, f32::max);
            let mean = cosines.iter().map(|c| c.1).sum::<f32>() / cosines.len().max(1) as f32;
            let limit = best - CLASS_MARGIN * (best - mean);
            let others = cosines.into_iter().filter(|(_, cosine)| *cosine < limit);
            negatives.extend(others.map(|((class, e), _)| (class.name.clone(), e.clone())));
        }
        Self { prompt: prompt.to_owned(), embedding, negatives }
    }

    /// Checks that a scene with `codec` can answer this query; the error says what does not fit. The
    /// scores of a query that does not fit are zero everywhere.
    pub fn check(&self, codec: &Codec) -> Result<()> {
        let dim = codec.embedding_dim();
        if let Some(text) = self.texts().find(|t| t.len() != dim) {
            return Err(Error::input(
                format!(
                    "the prompt \"{}\" was encoded with {} numbers, the scene's features have {dim}",
                    self.prompt,
                    text.len()
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

    /// Embedding of the prompt, then those of the negatives.
    fn texts(&self) -> impl Iterator<Item = &Vec<f32>> {
        std::iter::once(&self.embedding).chain(self.negatives.iter().map(|(_, e)| e))
    }

    /// Texts as rows, the prompt first; `None` if they do not fit `codec`.
    fn text_rows(&self, codec: &Codec) -> Option<Array2<f32>> {
        self.check(codec).ok()?;
        let flat: Vec<f32> = self.texts().flatten().copied().collect();
        Array2::from_shape_vec((self.negatives.len() + 1, codec.embedding_dim()), flat).ok()
    }
}

/// p − max n from cosines with the prompt (first) and the negatives; p alone if there are no negatives.
fn margin(cosines: &[f32]) -> f32 {
    let Some((&prompt, negatives)) = cosines.split_first() else { return f32::NEG_INFINITY };
    let mut best = f32::NEG_INFINITY;
    for &n in negatives {
        if n > best {
            best = n;
        }
    }
    if negatives.is_empty() { prompt } else { prompt - best }
}

/// A way to compute scores. Every rung gives the exact rung's values within its stated error.
///
/// Scores are 0 in holes (alpha below `min_alpha`), at features that are not finite, and for a query that
/// does not fit the codec (see [`Query::check`]).
pub trait Relevancy: Send {
    /// Name for reports: "exact", "folded", "lattice".
    fn name(&self) -> &'static str;

    /// Computes one score per point (0–1) for each query.
    fn score_points(
        &mut self,
        points: &Points<'_>,
        queries: &[Query],
        settings: &RelevancySettings,
    ) -> Vec<Vec<f32>>;

    /// Computes one score image per query, from rendered features and alpha.
    fn score(&mut self, images: &Images, queries: &[Query], settings: &RelevancySettings) -> Vec<Grid<f32>> {
        let scores = self.score_points(&Points::of_images(images, settings.min_alpha), queries, settings);
        scores.into_iter().map(|s| Grid::from_vec(images.width, images.height, s)).collect()
    }
}

/// Fastest rung for a codec.
pub enum Fastest {
    /// For a latent space of 3 dimensions; a device can look scores up in its tables.
    Lattice(Lattice),
    /// For any other latent space.
    Folded(Folded),
}

/// Returns the fastest rung for a codec: the lattice if the latent space is 3-D, else the folded decoder.
pub fn best(codec: Codec) -> Fastest {
    match Lattice::new(&codec) {
        Some(lattice) => Fastest::Lattice(lattice),
        None => Fastest::Folded(Folded::new(codec)),
    }
}

impl Relevancy for Fastest {
    fn name(&self) -> &'static str {
        match self {
            Self::Lattice(lattice) => lattice.name(),
            Self::Folded(folded) => folded.name(),
        }
    }

    fn score_points(
        &mut self,
        points: &Points<'_>,
        queries: &[Query],
        settings: &RelevancySettings,
    ) -> Vec<Vec<f32>> {
        match self {
            Self::Lattice(lattice) => lattice.score_points(points, queries, settings),
            Self::Folded(folded) => folded.score_points(points, queries, settings),
        }
    }
}

#[cfg(test)]
mod tests;
