//! The whole chain on the device, behind the trait that the CPU renderer implements too.

use crate::{
    Gpu,
    buffers::{Part, uniform},
    layout::View,
    passes::{Passes, run},
    scene_buffers::SceneBuffers,
    shown::ShownBuffers,
    timer::Timer,
};
use surgtpgs_core::{
    Result,
    camera::Camera,
    raster::{FEATURE_PLANE, FrameClock, FramePass, Images, Pick, Renderer},
    scene::Scene,
};

/// Input of a frame.
#[derive(Clone, Copy)]
pub struct Frame<'a> {
    /// Scene with the Gaussians.
    pub scene: &'a Scene,
    /// Camera to render from; its size is that of the picture.
    pub camera: &'a Camera,
    /// Time, 0–1.
    pub time: f32,
    /// `true` to render features.
    pub features: bool,
}

impl Frame<'_> {
    fn latent_dim(&self) -> usize {
        if self.features { self.scene.gaussians.latent_dim } else { 0 }
    }
}

/// Renders scenes on a GPU; twin of [`surgtpgs_core::raster::CpuRenderer`].
///
/// A scene is uploaded once. It is recognised by the addresses and lengths of its arrays and by samples
/// of their values. After editing a few values in place, call [`GpuRenderer::forget_scene`].
#[derive(Debug)]
pub struct GpuRenderer {
    pub(crate) gpu: Gpu,
    pub(crate) passes: Passes,
    scene: Option<([u64; 2], SceneBuffers)>,
    /// Time and latent dimension of the deformed Gaussians on the device.
    deformed_at: Option<(f32, usize)>,
    /// View, time and latent dimension of the splats, bins and image planes on the device.
    drawn: Option<(View, f32, usize)>,
    staging: Option<wgpu::Buffer>,
    pub(crate) timer: Timer,
    pub(crate) shown: ShownBuffers,
}

impl GpuRenderer {
    /// Compiles the passes.
    pub fn new(gpu: Gpu) -> Result<Self> {
        let passes = Passes::new(&gpu)?;
        let shown = ShownBuffers::new(&gpu);
        let (scene, deformed_at, drawn, staging) = (None, None, None, None);
        Ok(Self { gpu, passes, scene, deformed_at, drawn, staging, timer: Timer::default(), shown })
    }

    /// The device it renders on.
    pub fn gpu(&self) -> &Gpu {
        &self.gpu
    }

    /// Makes the next frame upload the scene anew.
    pub fn forget_scene(&mut self) {
        self.scene = None;
        self.deformed_at = None;
        self.drawn = None;
    }

    /// Sets the initial room to `capacity` splat-tile pairs. It grows as needed, at the cost of a
    /// repeated frame.
    pub fn set_pair_capacity(&mut self, capacity: usize) -> Result<()> {
        self.passes.bin.set_capacity(&self.gpu, capacity)
    }

    fn upload(&mut self, scene: &Scene) -> Result<()> {
        let revision = scene.revision();
        if self.scene.as_ref().is_none_or(|(known, _)| *known != revision) {
            self.forget_scene();
            let buffers = SceneBuffers::new(&self.gpu, &scene.gaussians, &scene.deformation)?;
            self.scene = Some((revision, buffers));
        }
        Ok(())
    }

    /// Adds the passes up to the image planes, except those whose results are still valid. Uploads the
    /// scene if it has changed.
    pub(crate) fn encode_frame(
        &mut self,
        frame: &Frame<'_>,
        clock: &mut FrameClock,
    ) -> Result<wgpu::CommandEncoder> {
        self.upload(frame.scene)?;
        let Self { gpu, passes, scene, timer, .. } = self;
        let mut encoder = gpu.device().create_command_encoder(&Default::default());
        let Some((_, buffers)) = scene else { return Ok(encoder) };
        let Frame { scene: Scene { gaussians, deformation, .. }, camera, time, .. } = *frame;
        let (n, latent_dim) = (gaussians.len(), frame.latent_dim());
        let view = View::new(camera, gaussians, passes.bin.capacity());
        let must_deform = self.deformed_at != Some((time, latent_dim));
        timer.start();
        if self.drawn == Some((view, time, latent_dim)) {
            return Ok(encoder);
        }
        passes.project.prepare(gpu, n)?;
        passes.bin.prepare(gpu, &view)?;
        passes.raster.prepare(gpu, &view, latent_dim)?;
        let view_buffer = uniform(gpu, &view);
        if must_deform {
            passes.deform.prepare(gpu, deformation, n, time, latent_dim)?;
            let pass = &mut timer.begin(&mut encoder, "deform");
            passes.deform.encode(gpu, pass, buffers, deformation, time, latent_dim);
            clock.lap(FramePass::Deform);
        }
        {
            let pass = &mut timer.begin(&mut encoder, "project");
            passes.project.encode(gpu, pass, &view_buffer, &passes.deform.rows, &buffers.sh_rest, n);
            clock.lap(FramePass::Project);
        }
        {
            let pass = &mut timer.begin(&mut encoder, "bin");
            passes.bin.encode(gpu, pass, &view_buffer, &view, &passes.project.splats);
            clock.lap(FramePass::Bin);
        }
        {
            let pass = &mut timer.begin(&mut encoder, "raster");
            let input = passes.raster_input();
            passes.raster.encode(gpu, pass, &view_buffer, &view, &input, latent_dim);
            clock.lap(FramePass::Raster);
        }
        self.deformed_at = Some((time, latent_dim));
        self.drawn = Some((view, time, latent_dim));
        Ok(encoder)
    }

    /// Renders until all pairs fit; returns the planes.
    fn draw(&mut self, frame: &Frame<'_>, clock: &mut FrameClock) -> Result<Vec<f32>> {
        loop {
            let encoder = self.encode_frame(frame, clock)?;
            let planes = self.passes.raster.planes.part();
            let bytes = self.submit(encoder, &[self.num_wanted(), planes])?;
            let (wanted, planes) = bytes.split_at(size_of::<u32>());
            if !self.passes.bin.grow_if_full(&self.gpu, bytemuck::pod_read_unaligned(wanted))? {
                return Ok(bytemuck::pod_collect_to_vec(planes));
            }
        }
    }

    /// Location of the number of pairs wanted. If it exceeds the capacity, the frame is wrong.
    pub(crate) fn num_wanted(&self) -> Part {
        (self.passes.bin.num_wanted().buffer().clone(), size_of::<u32>() as u64)
    }

    /// Submits, waits, and copies out the first bytes of each buffer, one after the other.
    pub(crate) fn submit(&mut self, mut encoder: wgpu::CommandEncoder, parts: &[Part]) -> Result<Vec<u8>> {
        self.timer.finish(&mut encoder);
        let size = parts.iter().map(|(_, size)| size).sum();
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
        let mut at = 0;
        for (buffer, size) in parts {
            encoder.copy_buffer_to_buffer(buffer, 0, staging, at, *size);
            at += size;
        }
        self.gpu.queue().submit([encoder.finish()]);
        self.gpu.read_staging(staging, size)
    }

    /// Returns the Gaussian at a pixel of the last rendered frame; `None` outside of it or if nothing
    /// contributes.
    pub fn pick(&mut self, [x, y]: [usize; 2]) -> Result<Option<Pick>> {
        let Self { gpu, passes, drawn: Some((view, ..)), .. } = self else { return Ok(None) };
        if x >= view.size[0] as usize || y >= view.size[1] as usize {
            return Ok(None);
        }
        gpu.guarded(|| {
            passes.pick.prepare(gpu, [x as u32, y as u32])?;
            let view = uniform(gpu, view);
            run(gpu, |pass| passes.pick.encode(gpu, pass, &view, &passes.raster_input()));
            passes.pick.read(gpu)
        })
    }

    /// Switches on the timing of every pass of [`GpuRenderer::show`]; returns `false` if the adapter
    /// cannot time.
    pub fn time_passes(&mut self) -> bool {
        self.timer.switch_on(&self.gpu)
    }

    /// Milliseconds of each pass of the last shown frame; empty unless they are timed.
    pub fn pass_times_ms(&self) -> Result<Vec<(&'static str, f64)>> {
        self.timer.read(&self.gpu)
    }
}

impl Renderer for GpuRenderer {
    fn name(&self) -> String {
        self.gpu.name()
    }

    /// Renders with all passes in one submission, so that [`FramePass::Raster`] stands for the time of
    /// those that ran.
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
        let frame = Frame { scene, camera, time, features };
        if images.width * images.height == 0 {
            return Ok(());
        }
        clock.start();
        let gpu = self.gpu.clone();
        let result = gpu.guarded(|| self.draw(&frame, clock));
        if result.is_err() {
            // The contents of the device are unknown after an error.
            self.forget_scene();
        }
        images.planes = result?;
        clock.waited(FramePass::Raster);
        debug_assert_eq!(
            images.planes.len(),
            images.width * images.height * (FEATURE_PLANE + frame.latent_dim())
        );
        Ok(())
    }
}
