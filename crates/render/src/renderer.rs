//! The whole chain on the device, behind the trait that the CPU implements too.

use crate::{
    Gpu,
    buffers::uniform,
    layout::View,
    passes::{Input, Passes},
    scene_buffers::SceneBuffers,
};
use surgtpgs_core::{
    Result,
    camera::Camera,
    raster::{FEATURE_PLANE, FrameClock, FramePass, Images, Renderer},
    scene::Scene,
};

/// Renders scenes on a GPU; twin of [`surgtpgs_core::raster::CpuRenderer`].
///
/// A scene is uploaded once and recognised by where its arrays lie, how long they are and samples of their values;
/// after editing a few values in place call [`GpuRenderer::forget_scene`].
#[derive(Debug)]
pub struct GpuRenderer {
    gpu: Gpu,
    passes: Passes,
    scene: Option<(u64, SceneBuffers)>,
    /// Time and latent dimension that the deformed Gaussians on the device stand for.
    deformed_at: Option<(f32, usize)>,
    staging: Option<wgpu::Buffer>,
}

impl GpuRenderer {
    /// Compiles the passes.
    pub fn new(gpu: Gpu) -> Result<Self> {
        let passes = Passes::new(&gpu)?;
        Ok(Self { gpu, passes, scene: None, deformed_at: None, staging: None })
    }

    /// The device it renders on.
    pub fn gpu(&self) -> &Gpu {
        &self.gpu
    }

    /// Uploads the scene anew with the next frame.
    pub fn forget_scene(&mut self) {
        self.scene = None;
        self.deformed_at = None;
    }

    /// Starts with room for `capacity` splat-tile pairs; it grows as needed, at the cost of a repeated frame.
    pub fn set_pair_capacity(&mut self, capacity: usize) -> Result<()> {
        self.passes.bin.set_capacity(&self.gpu, capacity)
    }

    fn upload(&mut self, scene: &Scene) -> Result<()> {
        let fingerprint = scene.fingerprint();
        if self.scene.as_ref().is_none_or(|(known, _)| *known != fingerprint) {
            self.forget_scene();
            let buffers = SceneBuffers::new(&self.gpu, &scene.gaussians, &scene.deformation)?;
            self.scene = Some((fingerprint, buffers));
        }
        Ok(())
    }

    /// Runs the passes until all pairs fit; returns the planes.
    fn draw(
        &mut self,
        scene: &Scene,
        camera: &Camera,
        time: f32,
        latent_dim: usize,
        clock: &mut FrameClock,
    ) -> Result<Vec<f32>> {
        self.upload(scene)?;
        if self.deformed_at != Some((time, latent_dim)) {
            clock.lap(FramePass::Deform);
        }
        clock.lap(FramePass::Project);
        clock.lap(FramePass::Bin);
        loop {
            let (wanted, planes) = self.draw_once(scene, camera, time, latent_dim)?;
            if !self.passes.bin.grow_if_full(&self.gpu, wanted)? {
                return Ok(planes);
            }
        }
    }

    /// One submission, one wait. Also returns how many pairs were wanted: beyond the capacity the planes are wrong.
    fn draw_once(
        &mut self,
        scene: &Scene,
        camera: &Camera,
        time: f32,
        latent_dim: usize,
    ) -> Result<(u32, Vec<f32>)> {
        let Self { gpu, passes, scene: Some((_, buffers)), .. } = self else { return Ok((0, Vec::new())) };
        let n = scene.gaussians.len();
        let view = View::new(camera, &scene.gaussians, passes.bin.capacity());
        let must_deform = self.deformed_at != Some((time, latent_dim));
        if must_deform {
            passes.deform.prepare(gpu, &scene.deformation, n, time, latent_dim)?;
        }
        passes.project.prepare(gpu, n)?;
        passes.bin.prepare(gpu, &view)?;
        passes.raster.prepare(gpu, &view, latent_dim)?;
        let view_buffer = uniform(gpu, &view);
        let mut encoder = gpu.device().create_command_encoder(&Default::default());
        {
            let pass = &mut encoder.begin_compute_pass(&Default::default());
            if must_deform {
                passes.deform.encode(gpu, pass, buffers, &scene.deformation, time, latent_dim);
            }
            passes.project.encode(gpu, pass, &view_buffer, &passes.deform.rows, &buffers.sh_rest, n);
            passes.bin.encode(gpu, pass, &view_buffer, &view, &passes.project.splats);
            let input = Input {
                splats: &passes.project.splats,
                features: &passes.deform.features,
                pairs: passes.bin.pairs(),
                ranges: &passes.bin.ranges,
            };
            passes.raster.encode(gpu, pass, &view_buffer, &view, &input, latent_dim);
        }
        self.deformed_at = Some((time, latent_dim));
        self.read_back(encoder)
    }

    /// Submits, waits, and copies out the number of pairs and the planes.
    fn read_back(&mut self, mut encoder: wgpu::CommandEncoder) -> Result<(u32, Vec<f32>)> {
        let planes = &self.passes.raster.planes;
        let count = size_of::<u32>() as u64;
        let size = planes.num_bytes() + count;
        if self.staging.as_ref().is_none_or(|s| s.size() < size) {
            self.staging = None;
        }
        let staging = self.staging.get_or_insert_with(|| {
            self.gpu.device().create_buffer(&wgpu::BufferDescriptor {
                label: Some("readback"),
                size,
                usage: wgpu::BufferUsages::MAP_READ | wgpu::BufferUsages::COPY_DST,
                mapped_at_creation: false,
            })
        });
        encoder.copy_buffer_to_buffer(self.passes.bin.num_wanted().buffer(), 0, staging, 0, count);
        encoder.copy_buffer_to_buffer(planes.buffer(), 0, staging, count, planes.num_bytes());
        self.gpu.queue().submit([encoder.finish()]);
        let bytes = self.gpu.read_staging(staging, size)?;
        let (wanted, planes) = bytes.split_at(count as usize);
        Ok((bytemuck::pod_read_unaligned(wanted), bytemuck::pod_collect_to_vec(planes)))
    }
}

impl Renderer for GpuRenderer {
    fn name(&self) -> String {
        self.gpu.name()
    }

    /// All passes go to the device at once: [`FramePass::Raster`] stands for the time of those that ran.
    fn render_into(
        &mut self,
        scene: &Scene,
        camera: &Camera,
        time: f32,
        features: bool,
        images: &mut Images,
        clock: &mut FrameClock,
    ) -> Result<()> {
        (images.width, images.height) = (camera.width as usize, camera.height as usize);
        images.planes.clear();
        let latent_dim = if features { scene.gaussians.latent_dim } else { 0 };
        if images.width * images.height == 0 {
            return Ok(());
        }
        clock.start();
        let gpu = self.gpu.clone();
        let result = gpu.guarded(|| self.draw(scene, camera, time, latent_dim, clock));
        if result.is_err() {
            // What is on the device is unknown now.
            self.forget_scene();
        }
        images.planes = result?;
        clock.lap(FramePass::Raster);
        debug_assert_eq!(images.planes.len(), images.width * images.height * (FEATURE_PLANE + latent_dim));
        Ok(())
    }
}
