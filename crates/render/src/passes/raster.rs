//! From splats, tile by tile and front to back, to image planes (`shaders/raster.wgsl`).

use crate::{
    Gpu,
    buffers::DeviceVec,
    kernel::Kernel,
    layout::{SplatRow, View},
};
use std::collections::BTreeMap;
use surgtpgs_core::{Result, raster::FEATURE_PLANE};

#[derive(Debug)]
pub(crate) struct RasterPass {
    /// Kernels by latent dimension.
    kernels: BTreeMap<usize, Kernel>,
    /// Output, [planes][rows][columns].
    pub planes: DeviceVec<f32>,
}

/// Input of the pass.
pub(crate) struct Input<'a> {
    pub splats: &'a DeviceVec<SplatRow>,
    pub features: &'a DeviceVec<f32>,
    pub pairs: &'a DeviceVec<u32>,
    pub ranges: &'a DeviceVec<[u32; 2]>,
}

impl RasterPass {
    pub(crate) fn new(gpu: &Gpu) -> Self {
        Self { kernels: BTreeMap::new(), planes: DeviceVec::new(gpu, "image planes") }
    }

    /// Compiles for `latent_dim` and makes room for the image.
    pub(crate) fn prepare(&mut self, gpu: &Gpu, view: &View, latent_dim: usize) -> Result<()> {
        if let std::collections::btree_map::Entry::Vacant(entry) = self.kernels.entry(latent_dim) {
            entry.insert(Kernel::new(gpu, "raster.wgsl", "raster", latent_dim)?);
        }
        let pixels = view.size[0] as usize * view.size[1] as usize;
        self.planes.resize(gpu, pixels * (FEATURE_PLANE + latent_dim))
    }

    /// Adds the pass; [`Self::prepare`] must have been called with the same arguments.
    pub(crate) fn encode(
        &self,
        gpu: &Gpu,
        pass: &mut wgpu::ComputePass<'_>,
        view_buffer: &wgpu::Buffer,
        view: &View,
        input: &Input<'_>,
        latent_dim: usize,
    ) {
        let bindings = [
            (0, view_buffer.as_entire_binding()),
            (1, input.splats.binding()),
            (2, input.features.binding()),
            (3, input.pairs.binding()),
            (4, input.ranges.binding()),
            (5, self.planes.binding()),
        ];
        self.kernels[&latent_dim].dispatch_2d(gpu, pass, &bindings, view.tiles);
    }
}
