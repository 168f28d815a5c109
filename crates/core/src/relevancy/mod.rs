//! How much a pixel is what the prompt says: score = σ(T·(p − max_i n_i)) (design §7, method §9.2).

use crate::{codec::Codec, grid::Grid, raster::Images, sequence::Class};

/// The visible settings of a query; recorded with every result.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct RelevancySettings {
    /// Sharpness; 10 in the reference code.
    pub temperature: f32,
    /// Score above which a pixel is found; 0.4 in the paper.
    pub threshold: f32,
    /// Canonical phrases, encoded bare.
    pub phrases: Vec<String>,
    /// Also use the scene's other classes as negatives (all but those nearest to the prompt).
    pub class_negatives: bool,
    /// Pixels with less accumulated opacity are holes: never found.
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

/// One prompt, encoded, with everything it is compared to.
#[derive(Clone, Debug, PartialEq)]
pub struct Query {
    /// The words as typed.
    pub prompt: String,
    /// Unit embedding of the (templated) prompt.
    pub embedding: Vec<f32>,
    /// Unit embeddings of the negatives, with the words they stand for.
    pub negatives: Vec<(String, Vec<f32>)>,
}

impl Query {
    /// Chooses the negatives for a prompt: the phrases, and by the settings the scene's other classes.
    pub fn new(
        prompt: &str,
        embedding: Vec<f32>,
        phrases: &[(String, Vec<f32>)],
        classes: &[(Class, Vec<f32>)],
        settings: &RelevancySettings,
    ) -> Self {
        let _ = (prompt, embedding, phrases, classes, settings);
        todo!()
    }
}

/// A way to compute score images; every rung gives the exact rung's values within its stated error.
pub trait Relevancy: Send {
    /// Name for reports: "exact", "folded", "lattice".
    fn name(&self) -> &'static str;
    /// One score image (0–1, 0 in holes) per query, from rendered features and alpha.
    fn score(&mut self, images: &Images, queries: &[Query], settings: &RelevancySettings) -> Vec<Grid<f32>>;
}

/// Decodes every pixel: the truth the other rungs are measured against.
pub struct Exact {
    /// The scene's codec.
    pub codec: Codec,
}

/// Scores tabulated over the latent space where the scene has features, interpolated.
pub struct Lattice {
    /// The scene's codec.
    pub codec: Codec,
}
