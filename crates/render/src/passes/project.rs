//! From Gaussians at time t to splats on the image plane (`shaders/project.wgsl`).

use crate::{
    Gpu,
    buffers::DeviceVec,
    kernel::Kernel,
    layout::{DeformedRow, SplatRow},
    shader_source::GROUP,
};
use surgtpgs_core::Result;

#[derive(Debug)]
pub(crate) struct ProjectPass {
    kernel: Kernel,
    /// Output, [N].
    pub splats: DeviceVec<SplatRow>,
}

impl ProjectPass {
    pub(crate) fn new(gpu: &Gpu) -> Result<Self> {
        Ok(Self {
            kernel: Kernel::new(gpu, "project.wgsl", "project", 0)?,
            splats: DeviceVec::new(gpu, "splats"),
        })
    }

    pub(crate) fn prepare(&mut self, gpu: &Gpu, n: usize) -> Result<()> {
        self.splats.resize(gpu, n)
    }

    pub(crate) fn encode(
        &self,
        gpu: &Gpu,
        pass: &mut wgpu::ComputePass<'_>,
        view: &wgpu::Buffer,
        rows: &DeviceVec<DeformedRow>,
        sh_rest: &DeviceVec<f32>,
        n: usize,
    ) {
        let bindings = [
            (0, view.as_entire_binding()),
            (1, rows.binding()),
            (2, sh_rest.binding()),
            (3, self.splats.binding()),
        ];
        self.kernel.dispatch(gpu, pass, &bindings, (n as u32).div_ceil(GROUP));
    }
}
