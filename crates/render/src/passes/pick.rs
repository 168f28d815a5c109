//! The Gaussian at one pixel (`shaders/pick.wgsl`).

use super::Input;
use crate::{Gpu, buffers::DeviceVec, kernel::Kernel, layout::Picked};
use surgtpgs_core::{Result, raster::Pick};

#[derive(Debug)]
pub(crate) struct PickPass {
    kernel: Kernel,
    picked: DeviceVec<Picked>,
}

impl PickPass {
    pub(crate) fn new(gpu: &Gpu) -> Result<Self> {
        let kernel = Kernel::new(gpu, "pick.wgsl", "pick", 0)?;
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
        pass: &mut wgpu::ComputePass<'_>,
        view_buffer: &wgpu::Buffer,
        input: &Input<'_>,
    ) {
        let bindings = [
            (0, view_buffer.as_entire_binding()),
            (1, input.splats.binding()),
            (2, input.pairs.binding()),
            (3, input.ranges.binding()),
            (4, self.picked.binding()),
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
