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

/// Number of steps in which a pixel is divided where flow is kept: flow is less exact than that.
const STEPS_PER_PX: f32 = 32.0;

/// Flow to a marked frame from the frames around it.
pub(super) struct FlowToMarked {
    marked: usize,
    /// Luminance of the marked frame, and of the first and the last frame that have a flow.
    luma: Grid<f32>,
    ends: [Grid<f32>; 2],
    /// Flow from each frame, in steps. There is one for each frame on the way, so they are kept in few bytes.
    flows: BTreeMap<usize, Grid<[i16; 2]>>,
    /// `true` to compare each frame with the marked one itself.
    corrects_drift: bool,
}

impl FlowToMarked {
    /// Starts at a marked frame of this luminance.
    pub(super) fn new(marked: usize, luma: Grid<f32>, corrects_drift: bool) -> Self {
        let zero = Grid::filled(luma.width, luma.height, [0; 2]);
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
                let mut flow = joined(&patch_flow(&here, &self.ends[end]), &in_px(&self.flows[&last]));
                if self.corrects_drift {
                    flow = mended(&here, &self.luma, &flow);
                }
                self.flows.insert(next, flow.map(|v| v.map(|px| (px * STEPS_PER_PX).round() as i16)));
                self.ends[end] = here;
            }
            last = next;
        }
        Ok(in_px(&self.flows[&frame]))
    }
}

/// Returns flow that is kept in steps.
fn in_px(steps: &Grid<[i16; 2]>) -> Grid<Vector> {
    steps.map(|v| v.map(|steps| f32::from(steps) / STEPS_PER_PX))
}
