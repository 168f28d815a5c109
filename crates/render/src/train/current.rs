//! A training step that is being encoded.

use super::{frame::FrameBuffers, resident::Resident};
use crate::{
    buffers::{DeviceVec, Uniform},
    device::Gpu,
    planes::{BinPass, DeformPass, RasterPass},
    rows::{SplatRow, ViewParams},
};
use surgtpgs_core::{
    deform::Deformation,
    train::{Context, LossWeights, StepPlan},
};

/// Plan and data of the current step, and the picture that it has rendered.
pub(super) struct CurrentStep<'a> {
    pub gpu: &'a Gpu,
    pub view: &'a ViewParams,
    pub view_buffer: &'a Uniform<ViewParams>,
    pub plan: &'a StepPlan,
    pub context: &'a Context<'a>,
    pub deformation: &'a Deformation,
    pub deform: &'a DeformPass,
    pub splats: &'a DeviceVec<SplatRow>,
    pub bin: &'a BinPass,
    pub raster: &'a RasterPass,
    pub frame: &'a FrameBuffers,
    pub resident: &'a Resident,
}

impl CurrentStep<'_> {
    pub(super) fn num_gaussians(&self) -> usize {
        self.view.num_gaussians as usize
    }

    pub(super) fn num_pixels(&self) -> usize {
        self.view.size[0] as usize * self.view.size[1] as usize
    }

    pub(super) fn weights(&self) -> LossWeights {
        self.context.loss_weights(&self.plan.view)
    }

    /// Number of regions to be smoothed.
    pub(super) fn num_regions(&self) -> usize {
        if self.frame.has_regions { self.frame.num_regions } else { 0 }
    }
}
