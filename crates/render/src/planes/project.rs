//! From Gaussians at time t to splats on the image plane (`shaders/project.wgsl`).

use crate::{
    buffers::{DeviceVec, Uniform},
    device::Gpu,
    kernel::{Kernel, Pass},
    rows::{DeformedRow, SplatRow, ViewParams},
    shader::{GROUP, shader},
};
use surgtpgs_core::{Result, raster};

shader! {
    pub(super) Wgsl = "project.wgsl";
    const NEAR = raster::NEAR;
    const MIN_EXTENT = raster::MIN_EXTENT;
    var<uniform> view: ViewParams;
    var<read> deformed: [DeformedRow];
    /// [N][bands][3]; one unread number if the degree is 0.
    var<read> sh_rest: [f32];
    var<write> splats: [SplatRow];
}

#[derive(Debug)]
pub(crate) struct ProjectPass {
    kernel: Kernel,
    /// Output, [N].
    pub splats: DeviceVec<SplatRow>,
}

impl ProjectPass {
    pub(crate) fn new(gpu: &Gpu) -> Result<Self> {
        Ok(Self {
            kernel: Kernel::new(gpu, &Wgsl::SHADER, "project", 0)?,
            splats: DeviceVec::new(gpu, "splats"),
        })
    }

    pub(crate) fn prepare(&mut self, gpu: &Gpu, n: usize) -> Result<()> {
        self.splats.resize(gpu, n)
    }

    pub(crate) fn encode(
        &self,
        gpu: &Gpu,
        pass: &mut Pass<'_>,
        view: &Uniform<ViewParams>,
        rows: &DeviceVec<DeformedRow>,
        sh_rest: &DeviceVec<f32>,
        n: usize,
    ) {
        let bindings =
            [Wgsl::view(view), Wgsl::deformed(rows), Wgsl::sh_rest(sh_rest), Wgsl::splats(&self.splats)];
        self.kernel.dispatch(gpu, pass, &bindings, (n as u32).div_ceil(GROUP));
    }
}
