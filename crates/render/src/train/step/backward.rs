//! From the gradient of the image planes to those of the splats, through one slot for each splat-tile pair
//! (`shaders/backward.wgsl`, `shaders/gather.wgsl`).

use crate::{
    buffers::{Array, DeviceVec, uniform},
    device::Gpu,
    kernel::{Kernel, Pass},
    rows::{SplatGradientRow, SplatRow, ViewParams},
    shader::{GROUP, shader, shader_struct},
    train::current::CurrentStep,
};
use surgtpgs_core::Result;

/// Number of splats that a tile's workgroup replays at once. The least memory of a workgroup, 16 KiB,
/// allows 4.
const BATCH: u32 = 4;
/// Number of moments of dL/d(exponent) in a slot.
const SLOT_MOMENTS: u32 = 6;
/// Number of blended channels in a slot besides the features: r, g, b, depth.
const SLOT_BASE_CHANNELS: u32 = 4;

shader! {
    pub(super) BackwardWgsl = "backward.wgsl";
    const BACKWARD_BATCH = BATCH;
    const SLOT_MOMENTS = SLOT_MOMENTS;
    const SLOT_BASE_CHANNELS = SLOT_BASE_CHANNELS;
    var<uniform> view: ViewParams;
    var<read> splats: [SplatRow];
    var<read> features: [f32];
    /// Gaussian and slot of each pair, sorted by tile, then depth.
    var<read> pair_gaussians: [u32];
    var<read> pair_slots: [u32];
    var<read> tile_ranges: [[u32; 2]];
    var<read> planes: [f32];
    var<read> g_planes: [f32];
    var<write> slots: [f32];
}

shader! {
    pub(super) GatherWgsl = "gather.wgsl";
    const SLOT_MOMENTS = SLOT_MOMENTS;
    const SLOT_BASE_CHANNELS = SLOT_BASE_CHANNELS;
    var<uniform> view: ViewParams;
    var<uniform> params: GatherParams;
    var<read> splats: [SplatRow];
    var<read> depth_order: [u32];
    var<read> first_pair: [u32];
    var<read> num_pairs_wanted: [u32];
    var<read> slots: [f32];
    var<write> g_splats: [SplatGradientRow];
    /// dL/d(feature at time t), [N][LATENT_DIM].
    var<write> g_features: [f32];
}

shader_struct! {
    /// Settings for summing slots into gradients.
    struct GatherParams {
        /// Factors of the pull at a centre.
        pull_scale: [f32; 2],
        /// 0 if the gradient of depth does not move centres.
        depth_moves_centres: u32,
        /// Padding to a multiple of 16 bytes.
        padding: u32,
    }
}

/// The kernels, and the buffers that they write.
#[derive(Debug)]
pub(in crate::train) struct BackwardPass {
    latent_dim: usize,
    backward: Kernel,
    gather: Kernel,
    slots: DeviceVec<f32>,
    /// Output: ∂L/∂splats.
    pub g_splats: DeviceVec<SplatGradientRow>,
    /// Output: ∂L/∂features at the time of the step, [N][D].
    pub g_features: DeviceVec<f32>,
}

impl BackwardPass {
    pub(super) fn new(gpu: &Gpu, latent_dim: usize) -> Result<Self> {
        Ok(Self {
            latent_dim,
            backward: Kernel::new(gpu, &BackwardWgsl::SHADER, "backward", latent_dim)?,
            gather: Kernel::new(gpu, &GatherWgsl::SHADER, "gather", latent_dim)?,
            slots: DeviceVec::new(gpu, "slots of splat-tile pairs"),
            g_splats: DeviceVec::new(gpu, "gradients of splats"),
            g_features: DeviceVec::new(gpu, "gradients of features"),
        })
    }

    /// Makes room for a step, and clears the slots.
    pub(super) fn prepare(
        &mut self,
        step: &CurrentStep<'_>,
        encoder: &mut wgpu::CommandEncoder,
    ) -> Result<()> {
        let (gpu, n) = (step.gpu, step.num_gaussians());
        let slot_len = (SLOT_MOMENTS + SLOT_BASE_CHANNELS) as usize + self.latent_dim;
        self.slots.resize(gpu, step.bin.capacity() * slot_len)?;
        self.g_splats.resize(gpu, n)?;
        self.g_features.resize(gpu, n * self.latent_dim)?;
        encoder.clear_buffer(self.slots.buffer(), 0, Some(self.slots.num_bytes()));
        Ok(())
    }

    /// Adds the way from the planes' gradient to that of the splats.
    pub(super) fn encode(&self, step: &CurrentStep<'_>, pass: &mut Pass<'_>, g_planes: &DeviceVec<f32>) {
        let (gpu, features) = (step.gpu, &step.deform.features);
        let bindings = [
            BackwardWgsl::view(step.view_buffer),
            BackwardWgsl::splats(step.splats),
            // The second half of them are the openings of gates.
            BackwardWgsl::features(Array::from(features).moving(features.num_bytes() / 2)),
            BackwardWgsl::pair_gaussians(&step.bin.pair_gaussians),
            BackwardWgsl::pair_slots(step.bin.pairs()),
            BackwardWgsl::tile_ranges(&step.bin.ranges),
            BackwardWgsl::planes(&step.raster.planes),
            BackwardWgsl::g_planes(g_planes),
            BackwardWgsl::slots(&self.slots),
        ];
        self.backward.dispatch_2d(gpu, pass, &bindings, step.view.tiles);
        let settings = step.context.settings;
        let params = uniform(
            gpu,
            &GatherParams {
                pull_scale: step.context.pull_scale(&step.plan.view),
                depth_moves_centres: u32::from(settings.depth_moves_centres),
                padding: 0,
            },
        );
        let [depth_order, first_pair] = step.bin.slots();
        let bindings = [
            GatherWgsl::view(step.view_buffer),
            GatherWgsl::params(&params),
            GatherWgsl::splats(step.splats),
            GatherWgsl::depth_order(depth_order),
            GatherWgsl::first_pair(first_pair),
            GatherWgsl::num_pairs_wanted(step.bin.num_pairs_wanted()),
            GatherWgsl::slots(&self.slots),
            GatherWgsl::g_splats(&self.g_splats),
            GatherWgsl::g_features(&self.g_features),
        ];
        self.gather.dispatch(gpu, pass, &bindings, step.view.num_gaussians.div_ceil(GROUP));
    }
}
