//! Optical flow from the frames around a marked frame to it, chained frame by frame.
//!
//! The flow from a frame to its neighbour is joined with the flow from there to the marked frame. Then the
//! frame is compared with the marked one itself, and the flow is corrected by the difference, so that errors
//! do not add up.

use crate::{
    Result,
    flow::{Vector, joined, mended, patch_flow},
    grid::Grid,
};
use std::collections::BTreeMap;

/// Flow to a marked frame from the frames around it.
pub(super) struct FlowToMarked {
    marked: usize,
    /// Luminance of the marked frame, and of the first and the last frame that have a flow.
    luma: Grid<f32>,
    ends: [Grid<f32>; 2],
    /// Flow from each frame.
    flows: BTreeMap<usize, Grid<Vector>>,
    /// `true` to compare each frame with the marked one itself.
    corrects_drift: bool,
}

impl FlowToMarked {
    /// Starts at a marked frame of this luminance.
    pub(super) fn new(marked: usize, luma: Grid<f32>, corrects_drift: bool) -> Self {
        let zero = Grid::filled(luma.width, luma.height, [0.0; 2]);
        let ends = [luma.clone(), luma.clone()];
        Self { marked, luma, ends, flows: BTreeMap::from([(marked, zero)]), corrects_drift }
    }

    /// Returns `true` if each frame is compared with the marked one itself.
    pub(super) fn corrects_drift(&self) -> bool {
        self.corrects_drift
    }

    /// Returns the flow from a frame to the marked one. `luma` returns the luminance of a frame.
    pub(super) fn flow(
        &mut self,
        frame: usize,
        luma: &mut dyn FnMut(usize) -> Result<Grid<f32>>,
    ) -> Result<Grid<Vector>> {
        let mut last = self.marked;
        while last != frame {
            let (next, end) = if frame > last { (last + 1, 1) } else { (last - 1, 0) };
            if !self.flows.contains_key(&next) {
                let here = luma(next)?;
                let mut flow = joined(&patch_flow(&here, &self.ends[end]), &self.flows[&last]);
                if self.corrects_drift {
                    flow = mended(&here, &self.luma, &flow);
                }
                self.flows.insert(next, flow);
                self.ends[end] = here;
            }
            last = next;
        }
        Ok(self.flows[&frame].clone())
    }
}
