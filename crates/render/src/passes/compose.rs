//! From image planes to 8-bit colours and depth (`shaders/compose.wgsl`).

use crate::{
    Gpu,
    buffers::{DeviceVec, uniform},
    kernel::Kernel,
    layout::Compose,
    shader_source::GROUP,
};
use surgtpgs_core::Result;

#[derive(Debug)]
pub(crate) struct ComposePass {
    kernel: Kernel,
    /// Output: one number per pixel, red in the lowest byte.
    pub pixels: DeviceVec<u32>,
    /// Output: depth divided by opacity; 0 at pixels without depth.
    pub depths: DeviceVec<f32>,
}

impl ComposePass {
    pub(crate) fn new(gpu: &Gpu) -> Result<Self> {
        Ok(Self {
            kernel: Kernel::new(gpu, "compose.wgsl", "compose", 0)?,
            pixels: DeviceVec::new(gpu, "pixels"),
            depths: DeviceVec::new(gpu, "depths"),
        })
    }

    /// Makes room for `num_pixels`.
    pub(crate) fn prepare(&mut self, gpu: &Gpu, num_pixels: usize) -> Result<()> {
        self.pixels.resize(gpu, num_pixels)?;
        self.depths.resize(gpu, num_pixels)
    }

    /// Adds the pass; `inside` has one bit per pixel.
    pub(crate) fn encode(
        &self,
        gpu: &Gpu,
        pass: &mut wgpu::ComputePass<'_>,
        planes: &DeviceVec<f32>,
        inside: &DeviceVec<u32>,
        min_alpha: f32,
    ) {
        let num_pixels = self.pixels.len() as u32;
        let params = uniform(gpu, &Compose { num_pixels, min_alpha, padding: [0; 2] });
        let bindings = [
            (0, params.as_entire_binding()),
            (1, planes.binding()),
            (2, inside.binding()),
            (3, self.pixels.binding()),
            (4, self.depths.binding()),
        ];
        self.kernel.dispatch(gpu, pass, &bindings, num_pixels.div_ceil(GROUP));
    }
}
