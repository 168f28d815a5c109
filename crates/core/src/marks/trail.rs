//! Displacements from the frames around a marked frame to it, frame by frame.
//!
//! The flow to the next frame on the way is put before the displacements from there, and what is left is
//! found by comparing with the marked frame itself. So errors do not add up.

use crate::{
    Result,
    flow::{Vector, joined, mended, patch_flow},
    grid::Grid,
};
use std::collections::BTreeMap;

/// Displacements to a marked frame.
pub(super) struct Trail {
    marked: usize,
    /// Luminance of the marked frame, and of the first and the last one that was reached.
    luma: Grid<f32>,
    ends: [Grid<f32>; 2],
    /// Displacements from each frame that was reached.
    ways: BTreeMap<usize, Grid<Vector>>,
    /// `true` to compare with the marked frame itself.
    mends: bool,
}

impl Trail {
    /// Begins at a marked frame of this luminance.
    pub(super) fn new(marked: usize, luma: Grid<f32>, mends: bool) -> Self {
        let still = Grid::filled(luma.width, luma.height, [0.0; 2]);
        let ends = [luma.clone(), luma.clone()];
        Self { marked, luma, ends, ways: BTreeMap::from([(marked, still)]), mends }
    }

    /// Returns `true` if frames are compared with the marked one itself.
    pub(super) fn mends(&self) -> bool {
        self.mends
    }

    /// Returns the displacements from a frame to the marked one. `luma` gives the luminance of frames.
    pub(super) fn way(
        &mut self,
        frame: usize,
        luma: &mut dyn FnMut(usize) -> Result<Grid<f32>>,
    ) -> Result<Grid<Vector>> {
        let mut last = self.marked;
        while last != frame {
            let (next, end) = if frame > last { (last + 1, 1) } else { (last - 1, 0) };
            if !self.ways.contains_key(&next) {
                let here = luma(next)?;
                let mut way = joined(&patch_flow(&here, &self.ends[end]), &self.ways[&last]);
                if self.mends {
                    way = mended(&here, &self.luma, &way);
                }
                self.ways.insert(next, way);
                self.ends[end] = here;
            }
            last = next;
        }
        Ok(self.ways[&frame].clone())
    }
}
