//! Relevancy of pixels for a prompt: score = min(P, σ(T·(max_j p_j − max_i n_i))).
//!
//! p_j and n_i are cosines of the pixel's decoded feature with what the prompt means and with everything
//! that competes with it; P is the probability that the prompt means that ([`crate::meaning`]). With one p
//! and P = 1 it is the smallest of the pairwise softmaxes in the paper. Three rungs compute it: [`Exact`]
//! decodes every pixel, [`Folded`] gets the same value with fewer operations, [`Lattice`] looks it up.

mod decoding;
mod fidelity;
mod folded;
mod lattice;
mod points;
mod query;

pub use decoding::Exact;
pub use fidelity::{Fidelity, fidelity};
pub use folded::Folded;
pub use lattice::{Lattice, LatticeReport, LatticeTables};
pub use points::Points;
pub use query::{Query, Rivals};

use crate::{codec::Codec, grid::Grid, raster::Images};

/// Settings of a query that the user can see; recorded with every result.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct RelevancySettings {
    /// Sharpness of the score; 10 in the reference code.
    pub temperature: f32,
    /// Score above which a pixel is found. One half is as likely as not; the paper has 0.4.
    pub threshold: f32,
    /// Words that every prompt is compared with, encoded without the template.
    pub phrases: Vec<String>,
    /// `true` to ask what the words of a prompt mean, and to let it compete with everything that means
    /// something else; `false` to compare it with the phrases alone.
    pub class_negatives: bool,
    /// `true` to use that listed classes without a pixel in training frames are known to be absent.
    #[serde(default = "yes")]
    pub knows_unseen: bool,
    /// Smallest accumulated opacity. Pixels with less are holes, which are never found.
    pub min_alpha: f32,
}

fn yes() -> bool {
    true
}

impl Default for RelevancySettings {
    fn default() -> Self {
        Self {
            temperature: 10.0,
            threshold: 0.5,
            phrases: Vec::new(),
            class_negatives: true,
            knows_unseen: true,
            min_alpha: 0.5,
        }
    }
}

impl RelevancySettings {
    /// Canonical phrases of the paper.
    pub const CANONICAL: [&str; 4] = ["object", "things", "stuff", "texture"];

    /// Settings of the paper: each prompt as it is, against the canonical phrases alone.
    pub fn paper() -> Self {
        Self {
            threshold: 0.4,
            phrases: Self::CANONICAL.map(String::from).to_vec(),
            class_negatives: false,
            ..Self::default()
        }
    }
}

/// A way to compute scores. Every rung gives the exact rung's values within its stated error.
///
/// Scores are 0 in holes (alpha below `min_alpha`), at latents that are not finite or shorter than
/// [`Points::MIN_LENGTH`], and for a query that does not fit the codec (see [`Query::check`]).
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
    Lattice(Box<Lattice>),
    /// For any other latent space.
    Folded(Folded),
}

/// Returns the fastest rung for a codec: the lattice if the latent space is 3-D, else the folded decoder.
pub fn best(codec: Codec) -> Fastest {
    match Lattice::new(&codec) {
        Some(lattice) => Fastest::Lattice(Box::new(lattice)),
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
