//! From splats, tile by tile and front to back, to image planes (`shaders/raster.wgsl`).

use crate::{
    buffers::{Array, DeviceVec, Uniform},
    device::Gpu,
    kernel::{Kernel, Pass},
    rows::{SplatRow, ViewParams},
    shader::shader,
};
use std::collections::BTreeMap;
use surgtpgs_core::{Result, raster::FEATURE_PLANE};

shader! {
    pub(super) Wgsl = "raster.wgsl";
    const RASTER_BATCH = BATCH;
    var<uniform> view: ViewParams;
    var<read> splats: [SplatRow];
    /// [N][LATENT_DIM]; one unread number if LATENT_DIM is 0.
    var<read> features: [f32];
    /// Gaussian indices, sorted by tile, then depth.
    var<read> pair_gaussians: [u32];
    /// [first, end) of each tile in pair_gaussians.
    var<read> tile_ranges: [[u32; 2]];
    var<write> planes: [f32];
}

/// Number of splats that a tile's workgroup holds at once.
const BATCH: u32 = 64;

#[derive(Debug)]
pub(crate) struct RasterPass {
    /// Kernels by latent dimension.
    kernels: BTreeMap<usize, Kernel>,
    /// Output, [planes][rows][columns].
    pub planes: DeviceVec<f32>,
}

/// Input of the pass.
pub(crate) struct RasterInput<'a> {
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
    pub(crate) fn prepare(&mut self, gpu: &Gpu, view: &ViewParams, latent_dim: usize) -> Result<()> {
        if let std::collections::btree_map::Entry::Vacant(entry) = self.kernels.entry(latent_dim) {
            entry.insert(Kernel::new(gpu, &Wgsl::SHADER, "raster", latent_dim)?);
        }
        let pixels = view.size[0] as usize * view.size[1] as usize;
        self.planes.resize(gpu, pixels * (FEATURE_PLANE + latent_dim))
    }

    /// Adds the pass; [`Self::prepare`] must have been called with the same arguments.
    pub(crate) fn encode(
        &self,
        gpu: &Gpu,
        pass: &mut Pass<'_>,
        view_buffer: &Uniform<ViewParams>,
        view: &ViewParams,
        input: &RasterInput<'_>,
        latent_dim: usize,
    ) {
        let bindings = [
            Wgsl::view(view_buffer),
            Wgsl::splats(input.splats),
            // The second half of them are the openings of gates.
            Wgsl::features(Array::from(input.features).moving(input.features.num_bytes() / 2)),
            Wgsl::pair_gaussians(input.pairs),
            Wgsl::tile_ranges(input.ranges),
            Wgsl::planes(&self.planes),
        ];
        self.kernels[&latent_dim].dispatch_2d(gpu, pass, &bindings, view.tiles);
    }
}
