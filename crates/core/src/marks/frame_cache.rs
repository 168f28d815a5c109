//! Cache of segmented marked frames and of flows to marked frames, of limited size.

use super::{flow_to_marked::FlowToMarked, marked_frame::MarkedFrame};
use crate::grid::Grid;
use std::collections::BTreeMap;

/// Largest number of marked frames that are kept.
const MAX_CACHED_FRAMES: usize = 8;

/// Marked frames that were needed last, and flows to other marked frames.
#[derive(Default)]
pub(super) struct FrameCache {
    frames: BTreeMap<usize, MarkedFrame>,
    /// Flows to marked frames that are not segmented yet.
    flows: BTreeMap<usize, FlowToMarked>,
}

impl FrameCache {
    /// Returns `true` if a marked frame is segmented.
    pub(super) fn contains(&self, frame: usize) -> bool {
        self.frames.contains_key(&frame)
    }

    /// Returns a marked frame if it is segmented.
    pub(super) fn get(&self, frame: usize) -> Option<&MarkedFrame> {
        self.frames.get(&frame)
    }

    /// Returns a marked frame, to be changed, if it is segmented.
    pub(super) fn get_mut(&mut self, frame: usize) -> Option<&mut MarkedFrame> {
        self.frames.get_mut(&frame)
    }

    /// Returns all frames, to be changed.
    pub(super) fn frames_mut(&mut self) -> impl Iterator<Item = (usize, &mut MarkedFrame)> {
        self.frames.iter_mut().map(|(frame, marked)| (*frame, marked))
    }

    /// Adds a marked frame. It alone keeps its shares at full size: they take much memory, and are needed of
    /// the shown frame alone.
    pub(super) fn insert(&mut self, frame: usize, marked: MarkedFrame) {
        self.frames.values_mut().for_each(|other| other.full_size_shares = None);
        self.frames.insert(frame, marked);
    }

    /// Returns the flow to a marked frame that is not segmented yet; `luma` is its luminance.
    pub(super) fn flow_to(
        &mut self,
        frame: usize,
        luma: &Grid<f32>,
        corrects_drift: bool,
    ) -> &mut FlowToMarked {
        self.flows.entry(frame).or_insert_with(|| FlowToMarked::new(frame, luma.clone(), corrects_drift))
    }

    /// Removes and returns the flow to a marked frame ; `luma` is its luminance.
    pub(super) fn take_flow(&mut self, frame: usize, luma: &Grid<f32>, corrects_drift: bool) -> FlowToMarked {
        let earlier = self.flows.remove(&frame);
        earlier.unwrap_or_else(|| FlowToMarked::new(frame, luma.clone(), corrects_drift))
    }

    /// Removes a marked frame, but for the flow to it.
    pub(super) fn keep_flow_alone(&mut self, frame: usize) {
        if let Some(marked) = self.frames.remove(&frame) {
            self.flows.insert(frame, marked.flows);
        }
    }

    /// Removes marked frames that are far from a frame, so that memory does not grow with the recording.
    pub(super) fn evict_far(&mut self, frame: usize) {
        while self.frames.len() > MAX_CACHED_FRAMES {
            let farthest = self.frames.keys().copied().max_by_key(|f| (f.abs_diff(frame), *f));
            farthest.and_then(|farthest| self.frames.remove(&farthest));
        }
    }

    /// Takes over the frames of an earlier cache that still hold, and those flows to other frames that
    /// `is_wanted`.
    pub(super) fn take_over(
        &mut self,
        earlier: Self,
        holds: impl Fn(usize) -> bool,
        is_wanted: impl Fn(usize, &FlowToMarked) -> bool,
    ) {
        let mut flows = earlier.flows;
        for (frame, marked) in earlier.frames {
            if holds(frame) {
                self.frames.insert(frame, marked);
            } else {
                flows.insert(frame, marked.flows);
            }
        }
        flows.retain(|frame, flow| is_wanted(*frame, flow));
        self.flows = flows.into_iter().take(MAX_CACHED_FRAMES).collect();
    }
}
