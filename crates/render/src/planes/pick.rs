//! The Gaussian at one pixel (`shaders/pick.wgsl`).

use super::raster::RasterInput;
use crate::{
    buffers::{DeviceVec, Uniform},
    device::Gpu,
    kernel::{Kernel, Pass},
    rows::{SplatRow, ViewParams},
    shader::{shader, shader_struct},
};
use surgtpgs_core::{Result, raster::Pick};

shader! {
    pub(super) Wgsl = "pick.wgsl";
    var<uniform> view: ViewParams;
    var<read> splats: [SplatRow];
    /// Gaussian indices, sorted by tile, then depth.
    var<read> pair_gaussians: [u32];
    /// [first, end) of each tile in pair_gaussians.
    var<read> tile_ranges: [[u32; 2]];
    var<write> picked: [Picked];
}

shader_struct! {
    /// Gaussian at a pixel.
    pub(crate) struct Picked {
        /// Column and row that were asked for.
        pixel: [u32; 2],
        /// Index of the Gaussian that contributes most.
        gaussian: u32,
        /// Its share; 0 if nothing contributes.
        weight: f32,
        /// Depth of its centre.
        depth: f32,
        /// Padding to a multiple of 16 bytes.
        padding: u32,
        /// Padding to a multiple of 16 bytes.
        padding_2: [u32; 2],
    }
}

#[derive(Debug)]
pub(crate) struct PickPass {
    kernel: Kernel,
    picked: DeviceVec<Picked>,
}

impl PickPass {
    pub(crate) fn new(gpu: &Gpu) -> Result<Self> {
        let kernel = Kernel::new(gpu, &Wgsl::SHADER, "pick", 0)?;
        Ok(Self { kernel, picked: DeviceVec::new(gpu, "picked pixel") })
    }

    /// Chooses the pixel.
    pub(crate) fn prepare(&mut self, gpu: &Gpu, pixel: [u32; 2]) -> Result<()> {
        self.picked.write(gpu, &[Picked { pixel, ..Default::default() }])
    }

    /// Adds the pass, after a frame's raster or in place of it.
    pub(crate) fn encode(
        &self,
        gpu: &Gpu,
        pass: &mut Pass<'_>,
        view: &Uniform<ViewParams>,
        input: &RasterInput<'_>,
    ) {
        let bindings = [
            Wgsl::view(view),
            Wgsl::splats(input.splats),
            Wgsl::pair_gaussians(input.pairs),
            Wgsl::tile_ranges(input.ranges),
            Wgsl::picked(&self.picked),
        ];
        self.kernel.dispatch(gpu, pass, &bindings, 1);
    }

    /// Waits for the device and returns the result.
    pub(crate) fn read(&self, gpu: &Gpu) -> Result<Option<Pick>> {
        let found = self.picked.read(gpu, 1)?.pop();
        let seen = found.filter(|p| p.weight > 0.0);
        Ok(seen.map(|p| Pick { gaussian: p.gaussian as usize, weight: p.weight, depth: p.depth }))
    }
}
