//! The passes, each with the same inputs and outputs as its Rust twin. [`Passes`] runs them one by one on
//! data from the CPU, so that a wrong picture can be tracked down to one pass. [`crate::GpuRenderer`]
//! chains them on the device.

mod bin;
mod compose;
mod deform;
mod lattice;
mod overlay;
mod pick;
mod project;
mod raster;
mod scan;
mod sort;
mod summary;

pub(crate) use bin::BinPass;
pub(crate) use compose::ComposePass;
pub(crate) use deform::DeformPass;
pub(crate) use lattice::LatticePass;
pub(crate) use overlay::{OverlayPass, from_pixels, to_pixels};
pub(crate) use pick::PickPass;
pub(crate) use project::ProjectPass;
pub(crate) use raster::{Input, RasterPass};
pub(crate) use scan::{Levels, Scan};
pub(crate) use sort::{Sort, SortBuffers};
pub(crate) use summary::SummaryPass;

use crate::{
    Gpu,
    buffers::{DeviceVec, uniform},
    layout::{DeformedRow, SplatRow, View},
    scene_buffers::{SceneBuffers, cut},
};
use image::RgbImage;
use surgtpgs_core::{
    Result,
    camera::Camera,
    deform::{Deformation, Deformed},
    gaussian::Gaussians,
    overlay::{OverlayLook, OverlayPrompt},
    raster::{Images, bin::Bins, project::Splat},
};

/// All passes, compiled.
#[derive(Debug)]
pub struct Passes {
    gpu: Gpu,
    pub(crate) deform: DeformPass,
    pub(crate) project: ProjectPass,
    pub(crate) bin: BinPass,
    pub(crate) raster: RasterPass,
    pub(crate) compose: ComposePass,
    pub(crate) lattice: LatticePass,
    pub(crate) overlay: OverlayPass,
    pub(crate) summary: SummaryPass,
    pub(crate) pick: PickPass,
}

impl Passes {
    /// Compiles the passes that do not depend on the scene.
    pub fn new(gpu: &Gpu) -> Result<Self> {
        gpu.guarded(|| {
            Ok(Self {
                gpu: gpu.clone(),
                deform: DeformPass::new(gpu),
                project: ProjectPass::new(gpu)?,
                bin: BinPass::new(gpu)?,
                raster: RasterPass::new(gpu),
                compose: ComposePass::new(gpu)?,
                lattice: LatticePass::new(gpu)?,
                overlay: OverlayPass::new(gpu)?,
                summary: SummaryPass::new(gpu)?,
                pick: PickPass::new(gpu)?,
            })
        })
    }

    /// Input of raster and pick for the current frame.
    pub(crate) fn raster_input(&self) -> Input<'_> {
        Input {
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
            let view = uniform(&gpu, &View::new(camera, gaussians, 0));
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
                let wanted = self.bin.num_wanted().read(&gpu, 1)?[0];
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
                let input = Input { splats: &rows, features: &features, pairs: &pairs, ranges: &ranges };
                self.raster.encode(&gpu, pass, &uniform(&gpu, &view), &view, &input, latent_dim);
            });
            let planes = self.raster.planes.read(&gpu, usize::MAX)?;
            Ok(Images { width: camera.width as usize, height: camera.height as usize, planes })
        })
    }

    /// Twin of [`surgtpgs_core::overlay::overlay`].
    pub fn overlay(
        &self,
        frame: &RgbImage,
        prompts: &[OverlayPrompt<'_>],
        look: OverlayLook,
    ) -> Result<RgbImage> {
        self.gpu.guarded(|| self.overlay.draw(&self.gpu, frame, prompts, look))
    }
}

/// Frame sizes for splats, which need no camera.
fn view_of_splats(camera: &Camera, num_splats: usize, capacity: usize) -> View {
    View { num_gaussians: num_splats as u32, ..View::new(camera, &Gaussians::default(), capacity) }
}

/// Submits one compute pass.
pub(crate) fn run(gpu: &Gpu, encode: impl FnOnce(&mut wgpu::ComputePass<'_>)) {
    let mut encoder = gpu.device().create_command_encoder(&Default::default());
    encode(&mut encoder.begin_compute_pass(&Default::default()));
    gpu.queue().submit([encoder.finish()]);
}
