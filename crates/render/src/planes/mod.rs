//! From Gaussians to image planes. Each pass has the same inputs and outputs as its Rust twin:
//!
//! ```text
//! scene_buffers ─▶ deform (time t) ─▶ project (camera) ─▶ bin (scan, sort) ─▶ raster ─▶ image planes
//! ```

mod bin;
mod deform;
mod project;
mod raster;
mod scan;
mod sort;

pub(crate) use bin::BinPass;
pub(crate) use deform::{DeformParams, DeformPass};
pub(crate) use project::ProjectPass;
pub(crate) use raster::{RasterInput, RasterPass};
pub(crate) use scan::{Levels, Scan};
pub(crate) use sort::{Sort, SortBuffers};

use crate::{
    buffers::{DeviceVec, uniform},
    device::Gpu,
    kernel::run,
    rows::{DeformedRow, SplatRow, ViewParams},
    scene_buffers::{SceneBuffers, cut},
    shader::Shader,
    timer::Timer,
};
use surgtpgs_core::{
    Result,
    camera::Camera,
    deform::{Deformation, Deformed},
    gaussian::Gaussians,
    raster::{FrameClock, FramePass, Images, bin::Bins, project::Splat},
    scene::Scene,
};

/// Shaders of these passes.
pub(crate) const SHADERS: &[Shader] = &[
    bin::Wgsl::SHADER,
    deform::Wgsl::SHADER,
    project::Wgsl::SHADER,
    raster::Wgsl::SHADER,
    scan::Wgsl::SHADER,
    sort::Wgsl::SHADER,
];

/// Scene, camera and time to render.
#[derive(Clone, Copy)]
pub struct RenderInput<'a> {
    /// Scene with the Gaussians.
    pub scene: &'a Scene,
    /// Camera to render from; its size is that of the picture.
    pub camera: &'a Camera,
    /// Time, 0–1.
    pub time: f32,
    /// `true` to render features.
    pub features: bool,
}

impl RenderInput<'_> {
    pub(crate) fn latent_dim(&self) -> usize {
        if self.features { self.scene.gaussians.latent_dim } else { 0 }
    }
}

/// The passes from Gaussians to image planes. [`crate::GpuRenderer`] chains them on the device. Methods with
/// the name of a twin run one pass on data from the CPU, so that a wrong picture can be tracked down to one
/// pass.
#[derive(Debug)]
pub struct PlanePasses {
    gpu: Gpu,
    deform: DeformPass,
    project: ProjectPass,
    pub(crate) bin: BinPass,
    pub(crate) raster: RasterPass,
    /// Time and latent dimension of the deformed Gaussians on the device.
    deformed_at: Option<(f32, usize)>,
    /// View, time and latent dimension of the splats, bins and image planes on the device.
    drawn: Option<(ViewParams, f32, usize)>,
}

impl PlanePasses {
    /// Compiles the passes that do not depend on the scene.
    pub fn new(gpu: &Gpu) -> Result<Self> {
        gpu.guarded(|| {
            Ok(Self {
                gpu: gpu.clone(),
                deform: DeformPass::new(gpu),
                project: ProjectPass::new(gpu)?,
                bin: BinPass::new(gpu)?,
                raster: RasterPass::new(gpu),
                deformed_at: None,
                drawn: None,
            })
        })
    }

    /// Makes the next frame start from the Gaussians.
    pub(crate) fn forget(&mut self) {
        self.deformed_at = None;
        self.drawn = None;
    }

    /// Adds the passes whose results are no longer valid.
    pub(crate) fn encode(
        &mut self,
        encoder: &mut wgpu::CommandEncoder,
        timer: &mut Timer,
        buffers: &SceneBuffers,
        input: &RenderInput<'_>,
        clock: &mut FrameClock,
    ) -> Result<()> {
        let gpu = &self.gpu;
        let RenderInput { scene: Scene { gaussians, deformation, .. }, camera, time, .. } = *input;
        let (n, latent_dim) = (gaussians.len(), input.latent_dim());
        let view = ViewParams::new(camera, gaussians, self.bin.capacity());
        if self.drawn == Some((view, time, latent_dim)) {
            return Ok(());
        }
        self.project.prepare(gpu, n)?;
        self.bin.prepare(gpu, &view)?;
        self.raster.prepare(gpu, &view, latent_dim)?;
        let view_buffer = &uniform(gpu, &view);
        if self.deformed_at != Some((time, latent_dim)) {
            self.deform.prepare(gpu, deformation, n, time, latent_dim)?;
            let pass = &mut timer.begin(encoder, "deform");
            self.deform.encode(gpu, pass, buffers, deformation, time, latent_dim);
            clock.lap(FramePass::Deform);
        }
        {
            let pass = &mut timer.begin(encoder, "project");
            self.project.encode(gpu, pass, view_buffer, &self.deform.rows, &buffers.sh_rest, n);
            clock.lap(FramePass::Project);
        }
        {
            let pass = &mut timer.begin(encoder, "bin");
            self.bin.encode(gpu, pass, view_buffer, &view, &self.project.splats);
            clock.lap(FramePass::Bin);
        }
        {
            let pass = &mut timer.begin(encoder, "raster");
            self.raster.encode(gpu, pass, view_buffer, &view, &self.raster_input(), latent_dim);
            clock.lap(FramePass::Raster);
        }
        self.deformed_at = Some((time, latent_dim));
        self.drawn = Some((view, time, latent_dim));
        Ok(())
    }

    fn raster_input(&self) -> RasterInput<'_> {
        RasterInput {
            splats: &self.project.splats,
            features: &self.deform.features,
            pairs: self.bin.pairs(),
            ranges: &self.bin.ranges,
        }
    }

    /// Twin of [`surgtpgs_core::deform::deform`]. `rows_at_once` cuts the scene into parts of at most
    /// that many Gaussians; the result does not depend on it.
    pub fn deform(
        &mut self,
        gaussians: &Gaussians,
        deformation: &Deformation,
        time: f32,
        features: bool,
        rows_at_once: usize,
    ) -> Result<Deformed> {
        let gpu = self.gpu.clone();
        gpu.guarded(|| {
            let scene =
                SceneBuffers::in_parts(&gpu, gaussians, deformation, cut(gaussians.len(), rows_at_once))?;
            let dim = if features { gaussians.latent_dim } else { 0 };
            self.deform.prepare(&gpu, deformation, gaussians.len(), time, dim)?;
            run(&gpu, |pass| self.deform.encode(&gpu, pass, &scene, deformation, time, dim));
            let rows = self.deform.rows.read(&gpu, gaussians.len())?;
            let features = self.deform.features.read(&gpu, gaussians.len() * dim)?;
            Ok(DeformedRow::to_deformed(&rows, features))
        })
    }

    /// Twin of [`surgtpgs_core::raster::project::project_all`].
    pub fn project(
        &mut self,
        gaussians: &Gaussians,
        deformed: &Deformed,
        camera: &Camera,
    ) -> Result<Vec<Splat<f32>>> {
        let gpu = self.gpu.clone();
        gpu.guarded(|| {
            let rows = DeviceVec::from_slice(&gpu, "Gaussians", &DeformedRow::rows(deformed))?;
            let sh_rest = DeviceVec::from_slice(&gpu, "spherical harmonics", &gaussians.sh_rest)?;
            let view = uniform(&gpu, &ViewParams::new(camera, gaussians, 0));
            self.project.prepare(&gpu, gaussians.len())?;
            run(&gpu, |pass| self.project.encode(&gpu, pass, &view, &rows, &sh_rest, gaussians.len()));
            let splats = self.project.splats.read(&gpu, gaussians.len())?;
            Ok(splats.into_iter().map(Splat::from).collect())
        })
    }

    /// Twin of [`surgtpgs_core::raster::bin::bin`]. Starts with room for `capacity` pairs and grows as
    /// needed.
    pub fn bin(&mut self, splats: &[Splat<f32>], camera: &Camera, capacity: usize) -> Result<Bins> {
        let gpu = self.gpu.clone();
        gpu.guarded(|| {
            let rows: Vec<SplatRow> = splats.iter().map(SplatRow::from).collect();
            let rows = DeviceVec::from_slice(&gpu, "splats", &rows)?;
            self.bin.set_capacity(&gpu, capacity)?;
            loop {
                let view = view_of_splats(camera, splats.len(), self.bin.capacity());
                self.bin.prepare(&gpu, &view)?;
                run(&gpu, |pass| self.bin.encode(&gpu, pass, &uniform(&gpu, &view), &view, &rows));
                let wanted = self.bin.num_pairs_wanted().read(&gpu, 1)?[0];
                if !self.bin.grow_if_full(&gpu, wanted)? {
                    return self.bin.read(&gpu, &view);
                }
            }
        })
    }

    /// Twin of [`surgtpgs_core::raster::forward::raster`].
    pub fn raster(
        &mut self,
        splats: &[Splat<f32>],
        features: &[f32],
        latent_dim: usize,
        bins: &Bins,
        camera: &Camera,
    ) -> Result<Images> {
        let gpu = self.gpu.clone();
        gpu.guarded(|| {
            let rows: Vec<SplatRow> = splats.iter().map(SplatRow::from).collect();
            let ranges: Vec<[u32; 2]> = bins.first.windows(2).map(|w| [w[0], w[1]]).collect();
            let rows = DeviceVec::from_slice(&gpu, "splats", &rows)?;
            let features = DeviceVec::from_slice(&gpu, "features", features)?;
            let pairs = DeviceVec::from_slice(&gpu, "splat-tile pairs", &bins.splat)?;
            let ranges = DeviceVec::from_slice(&gpu, "tiles", &ranges)?;
            let view = view_of_splats(camera, splats.len(), pairs.len());
            self.raster.prepare(&gpu, &view, latent_dim)?;
            run(&gpu, |pass| {
                let input =
                    RasterInput { splats: &rows, features: &features, pairs: &pairs, ranges: &ranges };
                self.raster.encode(&gpu, pass, &uniform(&gpu, &view), &view, &input, latent_dim);
            });
            let planes = self.raster.planes.read(&gpu, usize::MAX)?;
            Ok(Images { width: camera.width as usize, height: camera.height as usize, planes })
        })
    }
}

/// Frame sizes for splats, which need no camera.
fn view_of_splats(camera: &Camera, num_splats: usize, capacity: usize) -> ViewParams {
    ViewParams {
        num_gaussians: num_splats as u32,
        ..ViewParams::new(camera, &Gaussians::default(), capacity)
    }
}
