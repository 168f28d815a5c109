//! The lattice rung: scores looked up in the 3-D latent space.
//!
//! The decoder turns three numbers into a direction, so what a prompt scores is a function on a cube. It is
//! tabulated on the cells of an octree, but only where features have been seen: a cell holds decoded unit
//! embeddings at its corners and at the midpoints of itself and its faces. Corners are interpolated; the
//! midpoints tell how wrong that is, and a cell that is too wrong for a prompt is cut in eight. Decoded
//! points are shared by neighbours and kept for later frames and prompts, so a new prompt costs one matrix
//! product over them, and a known one a table look-up per pixel.
//!
//! What cannot be tabulated (latents outside the cube, cells still too wrong at the finest level, a full
//! table) is decoded exactly, point by point.

mod table;
mod tree;

use super::{Folded, Points, Query, Relevancy, RelevancySettings, decoding::score_by_decoding};
use crate::codec::Codec;
use crate::num;
use rayon::prelude::*;
use table::Table;
use tree::{Spot, Tree};

/// Interpolation may be this wrong at a cell's midpoints before it is cut. The promise is nearly three times that
/// (1/255) anywhere in the cell; measured, it holds with room to spare.
const TOLERANCE: f32 = 0.35 / 255.0;
/// Prompts whose tables are kept.
const MAX_TABLES: usize = 16;
/// Points per task.
const POINTS_AT_ONCE: usize = 8192;

/// Scores tabulated over the latent space where the scene has features, interpolated.
pub struct Lattice {
    folded: Folded,
    tree: Tree,
    /// Most recently used last.
    tables: Vec<Table>,
    decoded_points: usize,
}

/// How large a lattice is and how well it does.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct LatticeReport {
    /// Cells that are looked up.
    pub cells: usize,
    /// Decoded points.
    pub vertices: usize,
    /// Numbers kept per decoded point.
    pub rank: usize,
    /// Edge of the largest and of the smallest cell, in latent units.
    pub edges: [f32; 2],
    /// Largest score error at the midpoints of all cells, over the prompts in use.
    pub max_midpoint_error: f32,
    /// Points of the last call that were decoded exactly instead of looked up.
    pub decoded_points: usize,
    /// Memory of decoded points and cells.
    pub bytes: usize,
}

impl Lattice {
    /// For a codec with three latent numbers; `None` for any other.
    pub fn new(codec: &Codec) -> Option<Self> {
        (codec.latent_dim() == 3).then(|| {
            let folded = Folded::new(codec.clone());
            Self { tree: Tree::new(folded.rank()), folded, tables: Vec::new(), decoded_points: 0 }
        })
    }

    /// Size and error so far.
    pub fn report(&self) -> LatticeReport {
        LatticeReport {
            cells: self.tree.num_leaves(),
            vertices: self.tree.num_vertices(),
            rank: self.folded.rank(),
            edges: self.tree.edges(),
            max_midpoint_error: self
                .tables
                .iter()
                .map(|t| t.max_error)
                .fold(0.0, |a, b| if b > a { b } else { a }),
            decoded_points: self.decoded_points,
            bytes: self.tree.bytes(),
        }
    }

    /// Moves the tables of `queries` to the end of the list (making new ones), in their order, up to date with
    /// the tree. Returns the index of each query's table.
    fn update_tables(&mut self, queries: &[&Query], temperature: f32) -> Vec<usize> {
        for &query in queries {
            let known = self.tables.iter().position(|t| t.is_for(query, temperature));
            let table = match known {
                Some(i) => self.tables.remove(i),
                None => Table::new(query, self.folded.text_rows(query).unwrap_or_default(), temperature),
            };
            self.tables.push(table);
        }
        let kept = MAX_TABLES.max(queries.len());
        self.tables.drain(..self.tables.len().saturating_sub(kept));
        let first = self.tables.len() - queries.len();
        for table in &mut self.tables[first..] {
            table.update(&mut self.tree, TOLERANCE);
        }
        (first..self.tables.len()).collect()
    }
}

impl Relevancy for Lattice {
    fn name(&self) -> &'static str {
        "lattice"
    }

    fn score_points(
        &mut self,
        points: &Points<'_>,
        queries: &[Query],
        settings: &RelevancySettings,
    ) -> Vec<Vec<f32>> {
        let mut scores = vec![vec![0.0; points.len()]; queries.len()];
        // A repeated prompt is looked up once; one that does not fit scores zero.
        let mut asked: Vec<&Query> = Vec::new();
        let fits = |q: &&Query| self.folded.text_rows(q).is_some();
        for query in queries.iter().filter(fits) {
            if !asked.contains(&query) {
                asked.push(query);
            }
        }
        if points.latent_dim() != 3 || asked.is_empty() {
            return scores;
        }
        let found = loop {
            let tables = self.update_tables(&asked, settings.temperature);
            let tables: Vec<&Table> = tables.iter().map(|&i| &self.tables[i]).collect();
            let looked_up = look_up(&self.tree, &tables, points);
            if looked_up.missing.is_empty() {
                break looked_up;
            }
            let layers = &self.folded.layers;
            if !self.tree.grow(looked_up.missing, layers) {
                self.tree.freeze();
            }
        };
        let mut found_scores = found.scores;
        self.decoded_points = found.undecided.len();
        if !found.undecided.is_empty() {
            let texts: Vec<_> = asked.iter().map(|q| self.folded.text_rows(q)).collect();
            let exact = score_by_decoding(
                &self.folded.layers,
                points,
                &found.undecided,
                &texts,
                settings.temperature,
            );
            for (out, exact) in found_scores.iter_mut().zip(&exact) {
                found.undecided.iter().for_each(|&i| out[i] = exact[i]);
            }
        }
        for (query, out) in queries.iter().zip(&mut scores) {
            if let Some(k) = asked.iter().position(|a| *a == query) {
                out.clone_from(&found_scores[k]);
            }
        }
        scores
    }
}

/// What one pass over the points found.
struct LookedUp {
    scores: Vec<Vec<f32>>,
    /// Cells that were needed but are not tabulated; sorted, each once.
    missing: Vec<tree::Missing>,
    /// Points that no cell decides.
    undecided: Vec<usize>,
}

fn look_up(tree: &Tree, tables: &[&Table], points: &Points<'_>) -> LookedUp {
    let starts: Vec<usize> = (0..points.len()).step_by(POINTS_AT_ONCE).collect();
    let parts: Vec<LookedUp> = starts
        .into_par_iter()
        .map(|start| look_up_part(tree, tables, points, start..(start + POINTS_AT_ONCE).min(points.len())))
        .collect();
    let mut all = LookedUp {
        scores: vec![Vec::with_capacity(points.len()); tables.len()],
        missing: Vec::new(),
        undecided: Vec::new(),
    };
    for part in parts {
        all.scores.iter_mut().zip(&part.scores).for_each(|(a, b)| a.extend_from_slice(b));
        all.missing.extend(part.missing);
        all.undecided.extend(part.undecided);
    }
    all.missing.sort_unstable();
    all.missing.dedup();
    all
}

fn look_up_part(
    tree: &Tree,
    tables: &[&Table],
    points: &Points<'_>,
    range: std::ops::Range<usize>,
) -> LookedUp {
    let mut part = LookedUp {
        scores: vec![vec![0.0; range.len()]; tables.len()],
        missing: Vec::new(),
        undecided: Vec::new(),
    };
    for (out, i) in range.enumerate() {
        let Some(latent) = points.latent3(i) else { continue };
        match tree.locate(latent) {
            Spot::Leaf { leaf, at } => {
                let mut decided = true;
                for (table, scores) in tables.iter().zip(&mut part.scores) {
                    let margin = table.interpolate(leaf, at);
                    decided &= !margin.is_nan();
                    scores[out] = num::sigmoid(table.temperature * margin);
                }
                if !decided {
                    part.undecided.push(i);
                }
            }
            Spot::Missing(missing) => {
                if part.missing.last() != Some(&missing) {
                    part.missing.push(missing);
                }
            }
            Spot::Outside => part.undecided.push(i),
        }
    }
    part
}
