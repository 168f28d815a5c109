//! The whole chain on the device, behind the trait that the CPU renderer implements too.

use crate::{
    buffers::Part,
    device::Gpu,
    planes::{PlanePasses, RenderInput},
    scene_buffers::SceneBuffers,
    shown::{Asked, Shown, ShownPasses, Wanted, parse},
    timer::{PassCost, Timer},
};
use surgtpgs_core::{
    Result,
    camera::Camera,
    grid::Mask,
    raster::{FEATURE_PLANE, FrameClock, FramePass, Images, Renderer},
    scene::Scene,
};

/// Renders scenes on a GPU; twin of [`surgtpgs_core::raster::CpuRenderer`].
///
/// A scene is uploaded once, and again when it was changed.
#[derive(Debug)]
pub struct GpuRenderer {
    gpu: Gpu,
    planes: PlanePasses,
    shown: ShownPasses,
    scene: Option<([u64; 2], SceneBuffers)>,
    staging: Option<wgpu::Buffer>,
    timer: Timer,
    /// `true` if the tables left pixels of the last frame open.
    had_open: bool,
}

impl GpuRenderer {
    /// Compiles the passes.
    pub fn new(gpu: Gpu) -> Result<Self> {
        let (planes, shown) = (PlanePasses::new(&gpu)?, ShownPasses::new(&gpu)?);
        Ok(Self { gpu, planes, shown, scene: None, staging: None, timer: Timer::default(), had_open: false })
    }

    /// The device it renders on.
    pub fn gpu(&self) -> &Gpu {
        &self.gpu
    }

    /// Makes the next frame upload the scene anew.
    fn forget_scene(&mut self) {
        self.scene = None;
        self.planes.forget();
    }

    /// Makes everything on the device anew after an error: its contents are unknown, and an array that there was
    /// no memory for can never be used.
    fn renew(&mut self) {
        self.forget_scene();
        // On a device that was lost there is nothing to make.
        if let Ok(new) = Self::new(self.gpu.clone()) {
            *self = Self { timer: std::mem::take(&mut self.timer), ..new };
        }
    }

    /// Sets the initial room to `capacity` splat-tile pairs. It grows as needed, at the cost of a
    /// repeated frame.
    pub fn set_pair_capacity(&mut self, capacity: usize) -> Result<()> {
        self.planes.bin.set_capacity(&self.gpu, capacity)
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

    /// Adds the passes up to the image planes. Uploads the scene if it has changed.
    fn encode_planes(
        &mut self,
        input: &RenderInput<'_>,
        clock: &mut FrameClock,
    ) -> Result<wgpu::CommandEncoder> {
        self.upload(input.scene)?;
        let mut encoder = self.gpu.device().create_command_encoder(&Default::default());
        self.timer.start();
        if let Some((_, buffers)) = &self.scene {
            self.planes.encode(&mut encoder, &mut self.timer, buffers, input, clock)?;
        }
        Ok(encoder)
    }

    /// Renders until all pairs fit; returns the planes.
    fn draw(&mut self, input: &RenderInput<'_>, clock: &mut FrameClock) -> Result<Vec<f32>> {
        loop {
            let mut encoder = self.encode_planes(input, clock)?;
            let planes = self.planes.raster.planes.part();
            let parts = [self.num_pairs_wanted(), planes];
            self.timer.finish(&mut encoder);
            let (wanted, planes) =
                submit(&self.gpu, &mut self.staging, encoder, &parts, |[wanted, planes]| {
                    (bytemuck::pod_read_unaligned(wanted), bytemuck::pod_collect_to_vec(planes))
                })?;
            if !self.planes.bin.grow_if_full(&self.gpu, wanted)? {
                return Ok(planes);
            }
        }
    }

    /// Renders and scores the prompts in one submission. Pixels outside `field_of_view` are black and never
    /// found. It is sampled at the frame's size; `None` means that everything is inside.
    pub fn show(
        &mut self,
        input: &RenderInput<'_>,
        field_of_view: Option<&Mask>,
        asked: Option<Asked<'_>>,
        wanted: Wanted,
        clock: &mut FrameClock,
    ) -> Result<Shown> {
        let size = [input.camera.width, input.camera.height];
        if size.contains(&0) {
            return Ok(Shown::default());
        }
        clock.start();
        let mut asked = asked.filter(|asked| !asked.queries.is_empty());
        let is_asked = asked.is_some();
        let gpu = self.gpu.clone();
        let shown = gpu.guarded(|| {
            self.shown.set_inside(size, field_of_view)?;
            self.show_until_right(input, asked.as_mut(), wanted, clock)
        });
        if shown.is_err() {
            self.renew();
        }
        clock.waited(if is_asked { FramePass::Relevancy } else { FramePass::Raster });
        shown
    }

    /// Repeats the frame if pairs did not fit, and mends the scores if the tables left pixels open.
    fn show_until_right(
        &mut self,
        input: &RenderInput<'_>,
        mut asked: Option<&mut Asked<'_>>,
        wanted: Wanted,
        clock: &mut FrameClock,
    ) -> Result<Shown> {
        let size = [input.camera.width, input.camera.height];
        loop {
            let mut encoder = self.encode_planes(input, clock)?;
            if let Some(asked) = asked.as_deref_mut() {
                let planes = &self.planes.raster.planes;
                self.shown.encode_scores(&mut encoder, &mut self.timer, planes, asked, size)?;
                clock.lap(FramePass::Relevancy);
            }
            // What is likely to be repaired is not read back before.
            let read = if asked.is_some() && self.had_open { Wanted::default() } else { wanted };
            let (shown, num_open, num_pairs) = self.finish(encoder, asked.is_some(), size, read)?;
            if self.planes.bin.grow_if_full(&self.gpu, num_pairs)? {
                continue;
            }
            let Some(asked) = asked else { return Ok(shown) };
            self.had_open = num_open > 0;
            if !self.had_open && read == wanted {
                return Ok(shown);
            }
            let mut encoder = self.gpu.device().create_command_encoder(&Default::default());
            if self.had_open {
                self.shown.encode_repair(&mut encoder, asked, num_open)?;
            }
            return Ok(self.finish(encoder, true, size, wanted)?.0);
        }
    }

    /// Adds what picture and depth need, submits, and waits. Returns the wanted results, the number of pixels
    /// that were left open, and the number of pairs wanted.
    fn finish(
        &mut self,
        mut encoder: wgpu::CommandEncoder,
        is_asked: bool,
        size: [u32; 2],
        wanted: Wanted,
    ) -> Result<(Shown, usize, u32)> {
        if wanted.picture || wanted.depth {
            let planes = &self.planes.raster.planes;
            self.shown.encode_picture(&mut encoder, &mut self.timer, planes, size)?;
        }
        let [a, b, c, d] = self.shown.parts(is_asked, wanted);
        let parts = [self.num_pairs_wanted(), a, b, c, d];
        self.timer.finish(&mut encoder);
        submit(&self.gpu, &mut self.staging, encoder, &parts, |[num_pairs, parts @ ..]| {
            let (shown, num_open) = parse(parts, size);
            (shown, num_open, bytemuck::pod_read_unaligned(num_pairs))
        })
    }

    /// Location of the number of pairs wanted. If it exceeds the capacity, the frame is wrong.
    fn num_pairs_wanted(&self) -> Part {
        (self.planes.bin.num_pairs_wanted().buffer().clone(), size_of::<u32>() as u64)
    }

    /// Switches on the timing of every pass of [`GpuRenderer::show`]; returns `false` if the adapter
    /// cannot time.
    pub fn time_passes(&mut self) -> bool {
        self.timer.switch_on(&self.gpu)
    }

    /// Cost of each pass of the last shown frame; empty unless they are timed.
    pub fn pass_costs(&self) -> Result<Vec<PassCost>> {
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
        let input = RenderInput { scene, camera, time, features };
        if images.width * images.height == 0 {
            return Ok(());
        }
        clock.start();
        let gpu = self.gpu.clone();
        let result = gpu.guarded(|| self.draw(&input, clock));
        if result.is_err() {
            self.renew();
        }
        images.planes = result?;
        clock.waited(FramePass::Raster);
        debug_assert_eq!(
            images.planes.len(),
            images.width * images.height * (FEATURE_PLANE + input.latent_dim())
        );
        Ok(())
    }
}

/// Submits, waits, and reads the first bytes of each buffer by way of `staging`.
fn submit<T, const N: usize>(
    gpu: &Gpu,
    staging: &mut Option<wgpu::Buffer>,
    mut encoder: wgpu::CommandEncoder,
    parts: &[Part; N],
    read: impl FnOnce([&[u8]; N]) -> T,
) -> Result<T> {
    let size = parts.iter().map(|(_, size)| size).sum();
    if staging.as_ref().is_none_or(|s| s.size() < size) {
        *staging = None;
    }
    let staging = staging.get_or_insert_with(|| {
        gpu.device().create_buffer(&wgpu::BufferDescriptor {
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
    gpu.submit(encoder);
    gpu.read_staging(staging, size, |mut rest| {
        read(parts.each_ref().map(|(_, size)| {
            let (part, others) = rest.split_at(*size as usize);
            rest = others;
            part
        }))
    })
}
