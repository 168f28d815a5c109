//! The cells: an octree over the latent cube that is filled only at places that were looked up.

use crate::{
    codec::{Linear, apply, normalise_rows},
    num,
};
use half::f16;
use ndarray::Array2;
use rayon::prelude::*;
use std::{
    collections::HashMap,
    ops::{BitAnd, BitOr, Shl, Shr},
    sync::atomic::{AtomicU64, Ordering},
};

/// Half the edge of the lattice, which covers [-EXTENT, EXTENT]³. Rendered latents are near the unit
/// sphere, except at pixels with few Gaussians.
pub(super) const EXTENT: f32 = 2.6;
/// Cells along an edge of the cube at the coarsest level. In larger cells the midpoints miss features
/// that are not smooth.
pub(super) const COARSE: usize = 128;
/// Number of times that a cell can be halved: a multiple of [`BRICK_LEVELS`].
pub(super) const MAX_LEVEL: u8 = 6;
/// Number of halvings that one brick holds.
pub(super) const BRICK_LEVELS: u8 = 3;
/// Steps of the vertex grid along an edge of a coarsest cell: twice as fine as the finest cells, for
/// midpoints.
const STEPS: u32 = 2 << MAX_LEVEL;
/// Largest memory; beyond it no more cells are added.
const MAX_BYTES: usize = 192 << 20;
/// Number of points that one thread decodes at once.
const POINTS_AT_ONCE: usize = 256;

/// Number of values along an edge of a brick.
const BRICK_EDGE: usize = 1 << BRICK_LEVELS;
/// Number of values in a brick.
const BRICK_SIZE: usize = BRICK_EDGE.pow(3);
/// Number of finest cells along an edge of the cube.
pub(super) const FINE: usize = COARSE << MAX_LEVEL;
/// Number of finest cells per latent unit.
pub(super) const FINE_PER_UNIT: f32 = FINE as f32 / (2.0 * EXTENT);

/// Offset of values that refer to a brick. The value of a place is one number: 8 · a leaf's index + its
/// level, or [`BRICK`] + the start of the brick that cuts it in 8³, or [`EMPTY`] + the level of the cell
/// to tabulate there.
pub(super) const BRICK: u32 = 2 << 30;
/// Offset of values of places that are not tabulated, see [`BRICK`].
pub(super) const EMPTY: u32 = 3 << 30;

/// Number for the next tree.
static NEXT_TREE: AtomicU64 = AtomicU64::new(0);

/// Corner offsets of a cell in units of its edge; bit 2 of the index is x, bit 1 y, bit 0 z.
const CORNERS: [[u32; 3]; 8] =
    [[0, 0, 0], [0, 0, 1], [0, 1, 0], [0, 1, 1], [1, 0, 0], [1, 0, 1], [1, 1, 0], [1, 1, 1]];
/// Number of points between the corners, which measure the error of the interpolation.
pub(super) const NUM_MIDPOINTS: usize = 19;
/// Midpoint offsets in units of half an edge: of the cell, then of its faces, then of its edges.
#[rustfmt::skip]
const MIDPOINTS: [[u32; 3]; NUM_MIDPOINTS] = [
    [1, 1, 1],
    [0, 1, 1], [2, 1, 1], [1, 0, 1], [1, 2, 1], [1, 1, 0], [1, 1, 2],
    [0, 0, 1], [0, 2, 1], [2, 0, 1], [2, 2, 1],
    [0, 1, 0], [0, 1, 2], [2, 1, 0], [2, 1, 2],
    [1, 0, 0], [1, 0, 2], [1, 2, 0], [1, 2, 2],
];

/// A tabulated cell with its vertices.
#[derive(Clone, Debug)]
pub(super) struct Leaf {
    pub(super) corners: [u32; 8],
    pub(super) midpoints: [u32; NUM_MIDPOINTS],
    place: Place,
}

/// Place of a cell, tabulated or not.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Place {
    level: u8,
    /// Index along each axis at its level.
    cell: [u16; 3],
}

/// Content of a place.
pub(super) enum Spot {
    /// A tabulated cell: its index and its level.
    Leaf(u32, u32),
    /// Nothing yet; the level of the cell to tabulate.
    Empty(u32),
}

fn is_brick(value: u32) -> bool {
    value & EMPTY == BRICK
}

/// Indices of the finest cell `fine` (its position along each axis, below [`FINE`]): the index of its
/// coarsest cell, and those within the bricks of the first and the second [`BRICK_LEVELS`]. Works on one
/// cell or several at once. Inlined, so that several stay in their registers.
#[inline(always)]
pub(super) fn numbers<T: Bits>([x, y, z]: [T; 3]) -> [T; 3] {
    let brick = u32::from(BRICK_LEVELS);
    let (coarse, all) = (COARSE.trailing_zeros(), u32::from(MAX_LEVEL));
    let inside = BRICK_EDGE as u32 - 1;
    [
        joined(x >> all, y >> all, z >> all, coarse),
        joined((x >> brick) & inside, (y >> brick) & inside, (z >> brick) & inside, brick),
        joined(x & inside, y & inside, z & inside, brick),
    ]
}

#[inline(always)]
fn joined<T: Bits>(x: T, y: T, z: T, bits: u32) -> T {
    (x << (2 * bits)) | (y << bits) | z
}

/// An integer, or several at once.
pub(super) trait Bits:
    Copy + Shr<u32, Output = Self> + Shl<u32, Output = Self> + BitAnd<u32, Output = Self> + BitOr<Output = Self>
{
}

impl<T> Bits for T where
    T: Copy + Shr<u32, Output = T> + Shl<u32, Output = T> + BitAnd<u32, Output = T> + BitOr<Output = T>
{
}

const _: () = assert!(MAX_LEVEL == 2 * BRICK_LEVELS && COARSE.is_power_of_two());

impl Place {
    /// Returns the cell of a level that contains the finest cell `fine`.
    pub(super) fn of(fine: [u32; 3], level: u32) -> Self {
        Self { level: level as u8, cell: fine.map(|f| (f >> (u32::from(MAX_LEVEL) - level)) as u16) }
    }

    /// Position of its first finest cell.
    fn fine(self) -> [u32; 3] {
        self.cell.map(|c| u32::from(c) << (MAX_LEVEL - self.level))
    }
}

/// Cells over the latent cube where features have been seen, as fine as the prompts so far require.
pub(super) struct Tree {
    /// Values of the coarsest cells, then brick by brick those of the cells within a cut cell.
    cells: Vec<u32>,
    leaves: Vec<Leaf>,
    /// Vertex indices by place on the vertex grid. Only looked up, never iterated.
    places: HashMap<[u16; 3], u32>,
    /// Unit embeddings, [vertices][rank].
    embeddings: Vec<f16>,
    rank: usize,
    /// `true` once the memory is used up and no more cells are added.
    frozen: bool,
    /// A number that no other tree has, and the number of changes of the cells.
    version: [u64; 2],
}

impl Tree {
    pub(super) fn new(rank: usize) -> Self {
        Self {
            cells: vec![EMPTY; COARSE.pow(3)],
            leaves: Vec::new(),
            places: HashMap::new(),
            embeddings: Vec::new(),
            rank,
            frozen: false,
            version: [NEXT_TREE.fetch_add(1, Ordering::Relaxed), 0],
        }
    }

    /// Content of a finest cell, given its indices in the coarsest cells and in the bricks, see [`numbers`].
    #[inline(always)]
    pub(super) fn at(&self, numbers: [u32; 3]) -> Spot {
        let value = self.value(numbers);
        if value < BRICK { Spot::Leaf(value >> 3, value & 7) } else { Spot::Empty(value & 7) }
    }

    #[inline(always)]
    fn value(&self, [coarse, first, second]: [u32; 3]) -> u32 {
        let value = self.cells[coarse as usize];
        if !is_brick(value) {
            return value;
        }
        let value = self.cells[(value - BRICK + first) as usize];
        if is_brick(value) { self.cells[(value - BRICK + second) as usize] } else { value }
    }

    fn set(&mut self, place: Place, value: u32) {
        self.version[1] += 1;
        let [coarse, in_bricks @ ..] = numbers(place.fine());
        let (mut slot, mut level) = (coarse as usize, 0);
        while place.level > level {
            if !is_brick(self.cells[slot]) {
                self.cells[slot] = BRICK + self.cells.len() as u32;
                self.cells.resize(self.cells.len() + BRICK_SIZE, EMPTY + u32::from(level) + 1);
            }
            let number = in_bricks[usize::from(level / BRICK_LEVELS)];
            let first = (self.cells[slot] - BRICK + number) as usize;
            if place.level < level + BRICK_LEVELS {
                let edge = BRICK_EDGE >> (place.level - level);
                for row in 0..edge * edge {
                    let start = first + (row / edge * BRICK_EDGE + row % edge) * BRICK_EDGE;
                    self.cells[start..start + edge].fill(value);
                }
                return;
            }
            (slot, level) = (first, level + BRICK_LEVELS);
        }
        self.cells[slot] = value;
    }

    /// Tabulates cells; returns `false` if there is no memory left for more.
    pub(super) fn grow(&mut self, missing: Vec<Place>, layers: &[Linear]) -> bool {
        let mut fresh: Vec<[u16; 3]> = Vec::new();
        for place in missing {
            if self.bytes() > MAX_BYTES {
                self.decode(&fresh, layers);
                return false;
            }
            let edge = STEPS >> place.level;
            let origin = place.cell.map(|c| u32::from(c) * edge);
            let mut vertex = |offset: [u32; 3], step: u32| {
                let at = [0, 1, 2].map(|k| (origin[k] + offset[k] * step) as u16);
                let next = self.places.len() as u32;
                *self.places.entry(at).or_insert_with(|| {
                    fresh.push(at);
                    next
                })
            };
            let corners = CORNERS.map(|offset| vertex(offset, edge));
            let midpoints = MIDPOINTS.map(|offset| vertex(offset, edge / 2));
            self.set(place, (self.leaves.len() as u32) << 3 | u32::from(place.level));
            self.leaves.push(Leaf { corners, midpoints, place });
        }
        self.decode(&fresh, layers);
        true
    }

    /// Stops adding cells: those that are not tabulated stay so.
    pub(super) fn freeze(&mut self) {
        self.frozen = true;
    }

    pub(super) fn is_frozen(&self) -> bool {
        self.frozen
    }

    /// Appends the embeddings of vertices at `places`.
    fn decode(&mut self, places: &[[u16; 3]], layers: &[Linear]) {
        let unit = 2.0 * EXTENT / (COARSE as f32 * STEPS as f32);
        let parts: Vec<Vec<f16>> = places
            .par_chunks(POINTS_AT_ONCE)
            .map(|part| {
                let latents =
                    Array2::from_shape_fn((part.len(), 3), |(i, k)| f32::from(part[i][k]) * unit - EXTENT);
                let decoded = normalise_rows(apply(layers, latents.view()));
                decoded.iter().map(|&v| f16::from_f32(v)).collect()
            })
            .collect();
        parts.iter().for_each(|part| self.embeddings.extend_from_slice(part));
    }

    /// Cuts a leaf into eight places, which are empty until looked up. Returns `false` if it is one of
    /// the finest.
    pub(super) fn split(&mut self, leaf: usize) -> bool {
        let place = self.leaves[leaf].place;
        if place.level >= MAX_LEVEL {
            return false;
        }
        // Another prompt may have cut it already.
        if self.value(numbers(place.fine())) == (leaf as u32) << 3 | u32::from(place.level) {
            let level = place.level + 1;
            let cell = place.cell.map(|c| 2 * c);
            for offset in CORNERS {
                let child = Place { level, cell: [0, 1, 2].map(|k| cell[k] + offset[k] as u16) };
                self.set(child, EMPTY + u32::from(level));
            }
        }
        true
    }

    /// Value of each place, see [`BRICK`].
    pub(super) fn cells(&self) -> &[u32] {
        &self.cells
    }

    /// Version that changes whenever [`Tree::cells`] differ, be it those of this or of another tree.
    pub(super) fn version(&self) -> [u64; 2] {
        self.version
    }

    pub(super) fn leaves(&self) -> &[Leaf] {
        &self.leaves
    }

    /// Embeddings of the vertices from index `first` on, [n][rank].
    pub(super) fn embeddings_from(&self, first: usize) -> &[f16] {
        &self.embeddings[first * self.rank..]
    }

    pub(super) fn rank(&self) -> usize {
        self.rank
    }

    pub(super) fn num_leaves(&self) -> usize {
        self.leaves.len()
    }

    pub(super) fn num_vertices(&self) -> usize {
        self.places.len()
    }

    /// Edge of the largest and of the smallest cell in latent units; zeros if there are no cells.
    pub(super) fn edges(&self) -> [f32; 2] {
        let levels = || self.leaves.iter().map(|l| l.place.level);
        let edge = |level: u8| 2.0 * EXTENT / (COARSE << level) as f32;
        match (levels().min(), levels().max()) {
            (Some(low), Some(high)) => [edge(low), edge(high)],
            _ => [0.0; 2],
        }
    }

    pub(super) fn bytes(&self) -> usize {
        let vertex = self.rank * size_of::<f16>() + size_of::<([u16; 3], u32)>();
        size_of_val(&self.cells[..]) + size_of_val(&self.leaves[..]) + self.places.len() * vertex
    }
}

/// Largest score error at the midpoints if `corners` are interpolated. If it is certainly below `enough`,
/// returns an upper bound instead.
pub(super) fn midpoint_error(
    corners: &[f32; 8],
    midpoints: &[f32; NUM_MIDPOINTS],
    temperature: f32,
    enough: f32,
) -> f32 {
    // At a midpoint, the interpolation is the mean of the corners around it.
    let mean = |a: usize, b: usize| 0.5 * (corners[a] + corners[b]);
    let along_z = [mean(0, 1), mean(2, 3), mean(4, 5), mean(6, 7)];
    let along_y = [mean(0, 2), mean(1, 3), mean(4, 6), mean(5, 7)];
    let along_x = [mean(0, 4), mean(1, 5), mean(2, 6), mean(3, 7)];
    let faces = [
        0.5 * (along_z[0] + along_z[1]),
        0.5 * (along_z[2] + along_z[3]),
        0.5 * (along_z[0] + along_z[2]),
        0.5 * (along_z[1] + along_z[3]),
        0.5 * (along_y[0] + along_y[2]),
        0.5 * (along_y[1] + along_y[3]),
    ];
    let centre = [0.5 * (faces[0] + faces[1])];
    let between = || centre.iter().chain(&faces).chain(&along_z).chain(&along_y).chain(&along_x);
    let worst = |error: &dyn Fn(f32, f32) -> f32| {
        let errors = between().zip(midpoints).map(|(&a, &b)| error(a, b));
        errors.fold(0.0, |worst, e| if e > worst || e.is_nan() { e } else { worst })
    };
    // The slope of the sigmoid is at most 1/4.
    let bound = 0.25 * temperature * worst(&|a, b| (a - b).abs());
    if bound <= enough {
        return bound;
    }
    worst(&|a, b| (num::sigmoid(temperature * a) - num::sigmoid(temperature * b)).abs())
}

/// Polynomial that interpolates corner values, in the order of [`CORNERS`]: factors of 1, z, y, yz, x,
/// xz, xy, xyz.
pub(super) fn polynomial(corners: &[f32; 8]) -> [f32; 8] {
    let mut c = *corners;
    for bit in [1, 2, 4] {
        for i in (0..8).filter(|i| i & bit != 0) {
            c[i] -= c[i ^ bit];
        }
    }
    c
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A "decoder" of one layer that adds a constant first number, so that directions tell latents apart.
    fn layers() -> Vec<Linear> {
        let weight = ndarray::arr2(&[[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]);
        vec![Linear { weight, bias: ndarray::arr1(&[1.0, 0.0, 0.0, 0.0]) }]
    }

    fn position(tree: &Tree, vertex: u32) -> [f32; 3] {
        let e = &tree.embeddings_from(vertex as usize)[..4];
        [1, 2, 3].map(|k| e[k].to_f32() / e[0].to_f32())
    }

    /// Interpolates corner values in the order of [`CORNERS`].
    fn trilinear(corners: &[f32; 8], [x, y, z]: [f32; 3]) -> f32 {
        let mix = |a: f32, b: f32, t: f32| a + (b - a) * t;
        let along_z = [0, 2, 4, 6].map(|i| mix(corners[i], corners[i + 1], z));
        mix(mix(along_z[0], along_z[1], y), mix(along_z[2], along_z[3], y), x)
    }

    /// Indices of the finest cell around a latent, and the position in it, 0-1.
    fn fine(latent: [f32; 3]) -> ([u32; 3], [f32; 3]) {
        let at = latent.map(|v| (v + EXTENT) * FINE_PER_UNIT);
        (at.map(|v| v as u32), at.map(f32::fract))
    }

    #[test]
    fn interpolated_corner_positions_are_the_latent_at_every_level() {
        let mut tree = Tree::new(4);
        let latent = [0.313, -1.177, 0.99];
        let (cell, within) = fine(latent);
        for expected_level in 0..=u32::from(MAX_LEVEL) {
            let Spot::Empty(level) = tree.at(numbers(cell)) else { panic!("not empty") };
            assert_eq!(level, expected_level);
            assert!(tree.grow(vec![Place::of(cell, level)], &layers()));
            let Spot::Leaf(leaf, level) = tree.at(numbers(cell)) else { panic!("no leaf") };
            let edge = 1 << (u32::from(MAX_LEVEL) - level);
            let at = [0, 1, 2].map(|k| ((cell[k] % edge) as f32 + within[k]) / edge as f32);
            let found = tree.leaves()[leaf as usize].clone();
            for (k, expected) in latent.into_iter().enumerate() {
                let corners = found.corners.map(|v| position(&tree, v)[k]);
                assert!((trilinear(&corners, at) - expected).abs() < 5e-3, "{k}: {corners:?}");
                let centre = position(&tree, found.midpoints[0])[k];
                assert!((centre - corners.iter().sum::<f32>() / 8.0).abs() < 5e-3);
            }
            tree.split(leaf as usize);
        }
        assert_eq!(tree.num_leaves(), usize::from(MAX_LEVEL) + 1);
        assert!(!tree.split(usize::from(MAX_LEVEL)), "the finest cells stay whole");
    }

    #[test]
    fn a_cut_cell_is_empty_at_the_next_level_and_its_neighbours_stay() {
        let mut tree = Tree::new(4);
        let edge = 1 << MAX_LEVEL;
        tree.grow(vec![Place::of([0; 3], 0), Place::of([edge, 0, 0], 0)], &layers());
        assert!(tree.split(0) && tree.split(0));
        assert!(matches!(tree.at(numbers([edge - 1; 3])), Spot::Empty(1)));
        tree.grow(vec![Place::of([0; 3], 1), Place::of([edge - 1; 3], 1)], &layers());
        assert!(matches!(tree.at(numbers([edge / 2 - 1; 3])), Spot::Leaf(2, 1)));
        assert!(matches!(tree.at(numbers([edge / 2; 3])), Spot::Leaf(3, 1)));
        assert!(matches!(tree.at(numbers([edge / 2, 0, 0])), Spot::Empty(1)));
        assert!(matches!(tree.at(numbers([edge, 0, 0])), Spot::Leaf(1, 0)));
        // The neighbour stays unchanged down to the finest level, through both bricks.
        for level in 2..=u32::from(MAX_LEVEL) {
            tree.split(tree.num_leaves() - if level == 2 { 2 } else { 1 });
            assert!(matches!(tree.at(numbers([0; 3])), Spot::Empty(l) if l == level));
            tree.grow(vec![Place::of([0; 3], level)], &layers());
        }
        assert!(matches!(tree.at(numbers([0; 3])), Spot::Leaf(_, 6)));
        assert!(matches!(tree.at(numbers([1, 0, 0])), Spot::Empty(6)));
        assert!(matches!(tree.at(numbers([edge / 2; 3])), Spot::Leaf(3, 1)));
    }

    #[test]
    fn neighbours_share_vertices() {
        let mut tree = Tree::new(4);
        let edge = 1 << MAX_LEVEL;
        tree.grow(vec![Place::of([0; 3], 0), Place::of([edge, 0, 0], 0)], &layers());
        // Two cells of 27 vertices share a face of 9.
        assert_eq!(tree.num_vertices(), 45);
    }

    #[test]
    fn the_polynomial_is_the_interpolation() {
        let corners = [0.3, -0.1, 0.7, 0.2, -0.4, 0.9, 0.05, 0.6];
        let c = polynomial(&corners);
        for at @ [x, y, z] in [[0.0; 3], [1.0; 3], [0.2, 0.7, 0.4], [1.0, 0.0, 0.5]] {
            let terms = [1.0, z, y, y * z, x, x * z, x * y, x * y * z];
            let value: f32 = c.iter().zip(terms).map(|(c, t)| c * t).sum();
            assert!((value - trilinear(&corners, at)).abs() < 1e-6);
        }
    }

    #[test]
    fn midpoint_error_sees_a_bump_in_the_middle() {
        let flat = [0.1; 8];
        assert_eq!(midpoint_error(&flat, &[0.1; NUM_MIDPOINTS], 10.0, 0.0), 0.0);
        let mut bump = [0.1; NUM_MIDPOINTS];
        bump[3] = 0.2;
        let error = num::sigmoid(2.0) - num::sigmoid(1.0);
        assert!((midpoint_error(&flat, &bump, 10.0, 0.0) - error).abs() < 1e-6);
        let bound = midpoint_error(&flat, &bump, 10.0, 0.3);
        assert!(bound >= error && bound <= 0.3);
        bump[5] = f32::NAN;
        assert!(midpoint_error(&flat, &bump, 10.0, 1.0).is_nan());
    }

    #[test]
    fn what_lies_between_corners_is_no_error() {
        let corners = [0.3, -0.1, 0.7, 0.2, -0.4, 0.9, 0.05, 0.6];
        let midpoints = MIDPOINTS.map(|offset| trilinear(&corners, offset.map(|o| o as f32 * 0.5)));
        assert!(midpoint_error(&corners, &midpoints, 10.0, 0.0) < 1e-6);
    }
}
