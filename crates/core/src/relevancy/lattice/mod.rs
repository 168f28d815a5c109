//! The lattice rung: scores looked up in the 3-D latent space.
//!
//! The decoder turns three numbers into a direction, so the score of a prompt is a function on a cube. It is
//! tabulated on the cells of an octree, but only where features have been seen. A cell holds decoded unit
//! embeddings at its corners and at the midpoints of itself, its faces and its edges. Scores are interpolated
//! between the corners. The midpoints tell the error of that, and a cell whose error is too large for a
//! prompt is cut into eight. Decoded points are shared by neighbours and kept for later frames and prompts. A
//! new prompt costs one matrix product over them, a known one a table look-up per pixel.
//!
//! Some points cannot be tabulated: latents outside the cube, cells whose error is too large even at the
//! finest level, and all new cells once the table is full. These are decoded exactly, point by point.
//!
//! The rivals that all prompts compete with are ranked once per vertex, so that hundreds of them cost a new
//! prompt nothing.

mod look_up;
mod ranking;
mod table;
mod tree;

use super::{Folded, Points, Query, Relevancy, RelevancySettings, Rivals, decoding::score_by_decoding};
use crate::codec::Codec;
use look_up::{Open, look_up};
use ranking::Ranking;
use std::sync::Arc;
use table::ScoreTable;
use tree::{BRICK, BRICK_LEVELS, COARSE, EMPTY, EXTENT, FINE, FINE_PER_UNIT, Tree};

/// Number of vertices that one thread compares with texts or rivals at once.
const VERTICES_AT_ONCE: usize = 512;
/// Number of prompts whose tables are kept.
const MAX_TABLES: usize = 16;
/// Number of sets of rivals whose rankings are kept: a scene has one, and prompts without any none.
const MAX_RANKINGS: usize = 2;

/// Scores tabulated over the latent space at the features of the scene, and interpolated.
pub struct Lattice {
    folded: Folded,
    tree: Tree,
    /// Tables, the most recently used last.
    tables: Vec<ScoreTable>,
    /// Rankings of rivals, the most recently used last.
    rankings: Vec<Ranking>,
    decoded_points: usize,
}

/// Tables of a lattice for a device that looks scores up in them, see `shaders/lattice.wgsl`.
#[derive(Debug)]
pub struct LatticeTables<'a> {
    /// Values of the coarsest cells, then brick by brick those of the cells within a cut cell.
    pub cells: &'a [u32],
    /// Version that changes whenever `cells` differ, be it those of this or of another lattice.
    pub version: [u64; 2],
    /// Polynomials of each prompt in every leaf: factors of 1, z, y, yz, x, xz, xy and xyz; NaN where
    /// points must be decoded.
    pub polynomials: Vec<&'a [[f32; 8]]>,
}

/// Size and accuracy of a lattice.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct LatticeReport {
    /// Number of cells that are looked up.
    pub cells: usize,
    /// Number of decoded points.
    pub vertices: usize,
    /// Numbers kept per decoded point.
    pub rank: usize,
    /// Edge of the largest and of the smallest cell, in latent units.
    pub edges: [f32; 2],
    /// Largest score error at the midpoints of all cells, over the prompts in use.
    pub max_midpoint_error: f32,
    /// Number of points of the last call that were decoded exactly instead of looked up.
    pub decoded_points: usize,
    /// Memory of decoded points and cells, bytes.
    pub bytes: usize,
}

impl Lattice {
    /// Makes a lattice for a codec with three latent numbers; `None` for any other.
    pub fn new(codec: &Codec) -> Option<Self> {
        (codec.latent_dim() == 3).then(|| {
            let folded = Folded::new(codec.clone());
            Self {
                tree: Tree::new(folded.rank()),
                folded,
                tables: Vec::new(),
                rankings: Vec::new(),
                decoded_points: 0,
            }
        })
    }

    /// Largest allowed error of the interpolation at a cell's midpoints; beyond it the cell is cut. The
    /// promise is twice that, 1/255, anywhere in the cell: on every frame of three scenes, the largest
    /// error was 1.5 times the tolerance.
    const TOLERANCE: f32 = 0.5 / 255.0;
    /// Number of places in [`LatticeTables::cells`] along an edge of the latent cube, as a power of two.
    pub const COARSE_BITS: u32 = COARSE.trailing_zeros();
    /// Number of halvings that a brick of cells holds.
    pub const BRICK_LEVELS: u32 = BRICK_LEVELS as u32;
    /// Smallest value of a cell that refers to a brick.
    pub const BRICK: u32 = BRICK;
    /// Smallest value of a cell that is not tabulated.
    pub const EMPTY: u32 = EMPTY;
    /// Half the edge of the latent cube, which extends to ± this.
    pub const EXTENT: f32 = EXTENT;
    /// Number of finest cells along an edge of the cube.
    pub const FINE: usize = FINE;
    /// Number of finest cells per latent unit.
    pub const FINE_PER_UNIT: f32 = FINE_PER_UNIT;

    /// Tables of `queries` (which must fit the codec) in the state after all queries so far.
    pub fn tables(&mut self, queries: &[&Query], temperature: f32) -> LatticeTables<'_> {
        let first = self.choose_tables(&distinct(queries.iter().copied()), temperature);
        self.bring_up_to_date(first);
        let table = |query: &&Query| self.tables[first..].iter().find(|t| t.is_for(query, temperature));
        LatticeTables {
            cells: self.tree.cells(),
            version: self.tree.version(),
            polynomials: queries.iter().filter_map(table).map(|t| &t.polynomials[..]).collect(),
        }
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

    /// Moves the tables of `queries`, each another one, to the end of the list, in their order, and makes missing
    /// ones. Returns the index of the first.
    fn choose_tables(&mut self, queries: &[&Query], temperature: f32) -> usize {
        for &query in queries {
            let known = self.tables.iter().position(|t| t.is_for(query, temperature));
            let table = match known {
                Some(i) => self.tables.remove(i),
                None => ScoreTable::new(query, &self.folded, temperature),
            };
            self.tables.push(table);
            self.choose_ranking(&query.rivals);
        }
        self.rankings.drain(..self.rankings.len().saturating_sub(MAX_RANKINGS.max(queries.len())));
        let kept = MAX_TABLES.max(queries.len());
        self.tables.drain(..self.tables.len().saturating_sub(kept));
        self.tables.len() - queries.len()
    }

    /// Looks points up in the tables from `first` on.
    fn look_up(&mut self, first: usize, points: &Points<'_>, scores: &mut [Vec<f32>]) -> Open {
        self.bring_up_to_date(first);
        look_up(&self.tree, &self.tables[first..], points, scores)
    }

    /// Moves the ranking of `rivals` to the end of the list; makes it if it is missing.
    fn choose_ranking(&mut self, rivals: &Arc<Rivals>) {
        if rivals.is_empty() {
            return;
        }
        let ranking = match self.rankings.iter().position(|r| r.is_of(rivals)) {
            Some(i) => self.rankings.remove(i),
            None => Ranking::new(rivals, &self.folded),
        };
        self.rankings.push(ranking);
    }

    /// Completes the tables from `first` on for all cells of the tree.
    fn bring_up_to_date(&mut self, first: usize) {
        self.rankings.iter_mut().for_each(|ranking| ranking.update(&self.tree));
        let Self { tables, tree, rankings, .. } = self;
        tables[first..].iter_mut().for_each(|table| table.update(tree, rankings, Self::TOLERANCE));
    }

    /// Writes the scores of `points` and tabulates the cells that are needed. Returns the points that no
    /// cell can decide.
    fn look_up_growing(
        &mut self,
        points: &Points<'_>,
        asked: &[&Query],
        temperature: f32,
        scores: &mut [Vec<f32>],
    ) -> Vec<usize> {
        let first = self.choose_tables(asked, temperature);
        let Open { mut missing, mut waiting, mut undecided } = self.look_up(first, points, scores);
        while !waiting.is_empty() {
            if !self.tree.grow(missing, &self.folded.layers) {
                self.tree.freeze();
            }
            let few = points.chosen(&waiting);
            let mut found: Vec<Vec<f32>> = asked.iter().map(|_| vec![0.0; few.len()]).collect();
            let open = self.look_up(first, &few, &mut found);
            scatter(&waiting, &found, scores);
            undecided.extend(open.undecided.iter().map(|&i| waiting[i]));
            waiting = open.waiting.iter().map(|&i| waiting[i]).collect();
            missing = open.missing;
        }
        undecided
    }
}

/// Returns each of some queries once, in the order in which they come first.
fn distinct<'a>(queries: impl Iterator<Item = &'a Query>) -> Vec<&'a Query> {
    let mut distinct: Vec<&Query> = Vec::new();
    for query in queries {
        if !distinct.contains(&query) {
            distinct.push(query);
        }
    }
    distinct
}

/// Writes the scores of a few points to their places.
fn scatter(numbers: &[usize], few: &[Vec<f32>], scores: &mut [Vec<f32>]) {
    for (out, few) in scores.iter_mut().zip(few) {
        numbers.iter().zip(few).for_each(|(&i, score)| out[i] = *score);
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
        // A repeated prompt is looked up once; one that does not fit scores 0.
        let asked = distinct(queries.iter().filter(|q| q.check(self.folded.codec()).is_ok()));
        let nothing = || vec![0.0; points.len()];
        if points.latent_dim() != 3 || asked.is_empty() {
            return queries.iter().map(|_| nothing()).collect();
        }
        let mut found: Vec<Vec<f32>> = asked.iter().map(|_| nothing()).collect();
        let undecided = self.look_up_growing(points, &asked, settings.temperature, &mut found);
        self.decoded_points = undecided.len();
        if !undecided.is_empty() {
            let texts: Vec<_> = asked.iter().map(|q| self.folded.rows(q, settings.temperature)).collect();
            let layers = &self.folded.layers;
            let few = points.chosen(&undecided);
            let decoded = score_by_decoding(layers, &few, &texts, settings.temperature);
            scatter(&undecided, &decoded, &mut found);
        }
        let mut scores = Vec::with_capacity(queries.len());
        for (i, query) in queries.iter().enumerate() {
            let known = asked.iter().position(|a| *a == query);
            let is_last = !queries[i + 1..].contains(query);
            scores.push(match known {
                Some(k) if is_last => std::mem::take(&mut found[k]),
                Some(k) => found[k].clone(),
                None => nothing(),
            });
        }
        scores
    }
}
