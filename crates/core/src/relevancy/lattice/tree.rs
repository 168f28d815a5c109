//! Where cells are: an octree over the latent cube that exists only where it was looked at.

use crate::{
    codec::{Linear, apply, normalise_rows},
    num,
};
use half::f16;
use ndarray::Array2;
use rayon::prelude::*;
use std::collections::HashMap;

/// The lattice covers [-EXTENT, EXTENT]³: rendered latents are near the unit sphere.
const EXTENT: f32 = 1.3;
/// Cells along an edge of the cube at the coarsest level.
const COARSE: usize = 64;
/// Times that a cell can be halved.
const MAX_LEVEL: u8 = 3;
/// Steps of the vertex grid along an edge of a coarsest cell: twice as fine as the finest cells, for midpoints.
const STEPS: u32 = 2 << MAX_LEVEL;
/// Decoded points are kept up to this much memory.
const MAX_BYTES: usize = 256 << 20;
/// Points decoded at once by one thread.
const POINTS_AT_ONCE: usize = 256;

/// Node values: a leaf number, [`EMPTY`], or [`INNER`] + the index of the first of eight children.
const EMPTY: u32 = u32::MAX;
const INNER: u32 = 1 << 31;

/// Corner offsets of a cell in units of its edge; bit 2 is x, bit 1 y, bit 0 z.
const CORNERS: [[u32; 3]; 8] =
    [[0, 0, 0], [0, 0, 1], [0, 1, 0], [0, 1, 1], [1, 0, 0], [1, 0, 1], [1, 1, 0], [1, 1, 1]];
/// Midpoint offsets in units of half an edge: of the cell, then of its faces.
pub(super) const MIDPOINTS: [[u32; 3]; 7] =
    [[1, 1, 1], [0, 1, 1], [2, 1, 1], [1, 0, 1], [1, 2, 1], [1, 1, 0], [1, 1, 2]];

/// A tabulated cell: its vertices.
#[derive(Clone, Debug)]
pub(super) struct Leaf {
    pub(super) corners: [u32; 8],
    pub(super) midpoints: [u32; 7],
    place: Missing,
}

/// A cell by its place; also one that is asked for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Missing {
    /// Where its node is.
    node: u32,
    level: u8,
    /// Its number along each axis at its level.
    cell: [u16; 3],
}

/// Where a latent falls.
pub(super) enum Spot {
    /// In a tabulated cell, at this fraction of its edges.
    Leaf {
        /// Number of the leaf.
        leaf: u32,
        /// 0–1 along each axis.
        at: [f32; 3],
    },
    /// In a cell that is not tabulated yet.
    Missing(Missing),
    /// Outside the cube, or nowhere (not finite).
    Outside,
}

pub(super) struct Tree {
    nodes: Vec<u32>,
    leaves: Vec<Leaf>,
    /// Vertex numbers by place on the vertex grid. Only asked, never iterated.
    places: HashMap<[u16; 3], u32>,
    /// Unit embeddings, [vertices][rank].
    embeddings: Vec<f16>,
    rank: usize,
    /// No more cells are added: the memory is used up.
    frozen: bool,
}

impl Tree {
    pub(super) fn new(rank: usize) -> Self {
        Self {
            nodes: vec![EMPTY; COARSE * COARSE * COARSE],
            leaves: Vec::new(),
            places: HashMap::new(),
            embeddings: Vec::new(),
            rank,
            frozen: false,
        }
    }

    #[inline]
    pub(super) fn locate(&self, latent: [f32; 3]) -> Spot {
        let grid = latent.map(|v| (v + EXTENT) * (COARSE as f32 / (2.0 * EXTENT)));
        // Written so that NaN is outside.
        if !grid.iter().all(|&g| g >= 0.0 && g < COARSE as f32) {
            return Spot::Outside;
        }
        let mut cell = grid.map(|g| g as u16);
        let mut at = [0, 1, 2].map(|k| grid[k] - f32::from(cell[k]));
        let mut node = (usize::from(cell[0]) * COARSE + usize::from(cell[1])) * COARSE + usize::from(cell[2]);
        let mut level = 0;
        loop {
            let value = self.nodes[node];
            if value < INNER {
                return Spot::Leaf { leaf: value, at };
            }
            if value == EMPTY {
                return if self.frozen {
                    Spot::Outside
                } else {
                    Spot::Missing(Missing { node: node as u32, level, cell })
                };
            }
            let mut child = 0;
            for k in 0..3 {
                let upper = at[k] >= 0.5;
                at[k] = 2.0 * at[k] - f32::from(u8::from(upper));
                cell[k] = 2 * cell[k] + u16::from(upper);
                child = 2 * child + usize::from(upper);
            }
            node = (value - INNER) as usize + child;
            level += 1;
        }
    }

    /// Tabulates cells; returns false when there is no memory left for more.
    pub(super) fn grow(&mut self, missing: Vec<Missing>, layers: &[Linear]) -> bool {
        let mut fresh: Vec<[u16; 3]> = Vec::new();
        for place in missing {
            if (self.places.len() + 15) * self.rank * 2 > MAX_BYTES {
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
            self.nodes[place.node as usize] = self.leaves.len() as u32;
            self.leaves.push(Leaf { corners, midpoints, place });
        }
        self.decode(&fresh, layers);
        true
    }

    /// From now on, cells that are not tabulated count as outside.
    pub(super) fn freeze(&mut self) {
        self.frozen = true;
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

    /// Cuts a leaf in eight, empty until looked at; false if it is one of the finest.
    pub(super) fn split(&mut self, leaf: usize) -> bool {
        let place = self.leaves[leaf].place;
        if place.level >= MAX_LEVEL {
            return false;
        }
        // Another prompt may have cut it before.
        if self.nodes[place.node as usize] == leaf as u32 {
            self.nodes[place.node as usize] = INNER + self.nodes.len() as u32;
            self.nodes.extend([EMPTY; 8]);
        }
        true
    }

    pub(super) fn leaves(&self) -> &[Leaf] {
        &self.leaves
    }

    /// Embeddings of vertices from number `first` on, [n][rank].
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

    /// Edge of the largest and smallest cell in latent units; zeros without cells.
    pub(super) fn edges(&self) -> [f32; 2] {
        let levels = || self.leaves.iter().map(|l| l.place.level);
        let edge = |level: u8| 2.0 * EXTENT / (COARSE << level) as f32;
        match (levels().min(), levels().max()) {
            (Some(low), Some(high)) => [edge(low), edge(high)],
            _ => [0.0; 2],
        }
    }

    pub(super) fn bytes(&self) -> usize {
        size_of_val(&self.nodes[..]) + size_of_val(&self.leaves[..]) + size_of_val(&self.embeddings[..])
    }
}

/// The score error of interpolating `corners` at each midpoint, largest of all.
pub(super) fn midpoint_error(corners: &[f32; 8], midpoints: &[f32; 7], temperature: f32) -> f32 {
    let mut worst = 0.0;
    for (offset, &truth) in MIDPOINTS.iter().zip(midpoints) {
        let between = trilinear(corners, offset.map(|o| o as f32 * 0.5));
        let error = (num::sigmoid(temperature * between) - num::sigmoid(temperature * truth)).abs();
        if error > worst || error.is_nan() {
            worst = error;
        }
    }
    worst
}

/// Interpolates corner values in the order of [`CORNERS`].
#[inline]
pub(super) fn trilinear(corners: &[f32; 8], [x, y, z]: [f32; 3]) -> f32 {
    let mix = |a: f32, b: f32, t: f32| a + (b - a) * t;
    let along_z = [0, 2, 4, 6].map(|i| mix(corners[i], corners[i + 1], z));
    mix(mix(along_z[0], along_z[1], y), mix(along_z[2], along_z[3], y), x)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A one-layer "decoder" that adds a constant first number, so that directions tell latents apart.
    fn layers() -> Vec<Linear> {
        let weight = ndarray::arr2(&[[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]);
        vec![Linear { weight, bias: ndarray::arr1(&[1.0, 0.0, 0.0, 0.0]) }]
    }

    fn position(tree: &Tree, vertex: u32) -> [f32; 3] {
        let e = &tree.embeddings_from(vertex as usize)[..4];
        [1, 2, 3].map(|k| e[k].to_f32() / e[0].to_f32())
    }

    #[test]
    fn interpolated_corner_positions_are_the_latent_at_every_level() {
        let mut tree = Tree::new(4);
        let latent = [0.313, -1.177, 0.99];
        for _ in 0..=MAX_LEVEL {
            let Spot::Missing(missing) = tree.locate(latent) else { panic!("not missing") };
            assert!(tree.grow(vec![missing], &layers()));
            let Spot::Leaf { leaf, at } = tree.locate(latent) else { panic!("no leaf") };
            let cell = tree.leaves()[leaf as usize].clone();
            for (k, expected) in latent.into_iter().enumerate() {
                let corners = cell.corners.map(|v| position(&tree, v)[k]);
                assert!((trilinear(&corners, at) - expected).abs() < 5e-3, "{k}: {corners:?}");
                let centre = position(&tree, cell.midpoints[0])[k];
                assert!((centre - corners.iter().sum::<f32>() / 8.0).abs() < 5e-3);
            }
            tree.split(leaf as usize);
        }
        assert_eq!(tree.num_leaves(), usize::from(MAX_LEVEL) + 1);
        assert!(!tree.split(usize::from(MAX_LEVEL)), "the finest cells stay whole");
    }

    #[test]
    fn neighbours_share_vertices() {
        let mut tree = Tree::new(4);
        let edge = 2.0 * EXTENT / COARSE as f32;
        let missing: Vec<Missing> = [0.5, 1.5]
            .iter()
            .map(|x| match tree.locate([x * edge, 0.5 * edge, 0.5 * edge]) {
                Spot::Missing(m) => m,
                _ => panic!("not missing"),
            })
            .collect();
        tree.grow(missing, &layers());
        // Two cells of 15 vertices share a face: 4 corners and its midpoint.
        assert_eq!(tree.num_vertices(), 25);
    }

    #[test]
    fn what_is_not_in_the_cube_is_outside() {
        let tree = Tree::new(4);
        for bad in [f32::NAN, f32::INFINITY, -1.31, 1.31, 1e30] {
            assert!(matches!(tree.locate([0.0, bad, 0.0]), Spot::Outside), "{bad}");
        }
        assert!(matches!(tree.locate([-1.3, 1.299, 0.0]), Spot::Missing(_)));
    }

    #[test]
    fn midpoint_error_sees_a_bump_in_the_middle() {
        let flat = [0.1; 8];
        assert_eq!(midpoint_error(&flat, &[0.1; 7], 10.0), 0.0);
        let mut bump = [0.1; 7];
        bump[3] = 0.2;
        assert!((midpoint_error(&flat, &bump, 10.0) - (num::sigmoid(2.0) - num::sigmoid(1.0))).abs() < 1e-6);
        bump[5] = f32::NAN;
        assert!(midpoint_error(&flat, &bump, 10.0).is_nan());
    }
}
