//! Terms of the loss, and their gradient with respect to the image planes (`shaders/loss.wgsl`,
//! `shaders/regions.wgsl`).

use crate::{
    buffers::{Array, Bound, DeviceVec, uniform},
    device::Gpu,
    kernel::{Kernel, Pass},
    shader::{GROUP, shader, shader_struct},
    train::{
        current::CurrentStep,
        frame::{Region, RegionBlock},
    },
};
use surgtpgs_core::{
    Result,
    raster::FEATURE_PLANE,
    train::{self, LossWeights, NUM_TERMS, TermScales},
};

/// Number of groups of four terms of the loss that are sums over pixels: all but the last term.
pub(super) const TERM_QUADS: usize = (NUM_TERMS - 1).div_ceil(4);

shader! {
    pub(super) LossWgsl = "loss.wgsl";
    const TERM_QUADS = TERM_QUADS as u32;
    const MIN_LOSS_ALPHA = train::MIN_LOSS_ALPHA as f32;
    const MIN_LOSS_DEPTH = train::MIN_LOSS_DEPTH as f32;
    var<uniform> params: LossParams;
    var<read> planes: [f32];
    /// r, g, b in the low bytes; the highest byte is not 0 if the pixel is supervised.
    var<read> pixels: [u32];
    /// z, 0 where unknown.
    var<read> depths: [f32];
    /// Row of the table of features; beyond its end if there is none.
    var<read> regions: [u32];
    /// [rows][LATENT_DIM]
    var<read> latents: [f32];
    var<write> g_planes: [f32];
    /// [workgroups][TERM_QUADS]: sums of each workgroup, see quads_of.
    var<write> partial_sums: [[f32; 4]];
}

shader_struct! {
    /// Weights of the loss.
    struct LossParams {
        /// Columns and rows.
        size: [u32; 2],
        /// 1 if depth is compared.
        has_depth: u32,
        /// 1 if features are compared.
        has_regions: u32,
        /// 1 for depth as in the released code.
        raw_depth: u32,
        /// 1 for total variation of colour and features outside the mask too.
        unmasked_variation: u32,
        /// Number of rows of the table of features.
        num_rows: u32,
        /// Typical depth, scene units.
        typical_depth: f32,
        /// Weight of |difference| to the wanted value, per value of colour.
        colour_difference: f32,
        /// Weight of the squared difference to the wanted value, per value of colour.
        colour_square: f32,
        /// Weight of |difference| of neighbours, per value of colour.
        colour_variation: f32,
        /// Weight of |difference| to the wanted value, for depth.
        depth_difference: f32,
        /// Weight of |difference| of neighbours, for depth.
        depth_variation: f32,
        /// Weight of |difference| to the wanted value, for features.
        feature_difference: f32,
        /// Weight of |difference| of neighbours, for features.
        feature_variation: f32,
        /// Padding to a multiple of 16 bytes.
        padding: u32,
    }
}

impl LossParams {
    /// The weights of the terms, everything else 0. A frame without supervised pixels has no term of colour.
    fn weighted(scales: &TermScales<f32>, is_supervised: bool) -> Self {
        let counts = |v: f32| if is_supervised { v } else { 0.0 };
        Self {
            colour_difference: counts(scales.colour.difference),
            colour_square: counts(scales.colour.square),
            colour_variation: counts(scales.colour.variation),
            depth_difference: scales.depth.difference,
            depth_variation: scales.depth.variation,
            feature_difference: scales.features.difference,
            feature_variation: scales.features.variation,
            ..Self::default()
        }
    }
}

shader! {
    pub(super) RegionsWgsl = "regions.wgsl";
    var<uniform> params: RegionsParams;
    var<read> planes: [f32];
    var<read> listed: [u32];
    var<read> blocks: [RegionBlock];
    var<read> regions: [Region];
    /// [blocks][QUADS][2]: sums of values, or of |F - mean| and of its sign.
    var<write> block_sums: [[f32; 4]];
    /// [regions][QUADS]
    var<write> means: [[f32; 4]];
    /// [regions][QUADS][2]: means of |F - mean| and of its sign.
    var<write> spreads: [[f32; 4]];
    var<write> g_planes: [f32];
}

shader_struct! {
    /// Sizes of region smoothness.
    struct RegionsParams {
        /// Number of pixels of a plane.
        num_pixels: u32,
        /// Number of blocks of listed pixels.
        num_blocks: u32,
        /// Number of large regions.
        num_regions: u32,
        /// 1 for one mean over all latent numbers.
        is_pooled: u32,
        /// Weight of a region.
        smoothness: f32,
        /// Padding to a multiple of 16 bytes.
        padding: u32,
        /// Padding to a multiple of 16 bytes.
        padding_2: [u32; 2],
    }
}

/// The kernels, and the buffers that they write.
#[derive(Debug)]
pub(in crate::train) struct LossPass {
    latent_dim: usize,
    loss: Kernel,
    sum_values: Kernel,
    fold_means: Kernel,
    sum_deviations: Kernel,
    fold_spreads: Kernel,
    add_gradients: Kernel,
    latents: DeviceVec<f32>,
    region_sums: DeviceVec<[f32; 4]>,
    means: DeviceVec<[f32; 4]>,
    /// Output: ∂L/∂planes.
    pub g_planes: DeviceVec<f32>,
    /// Output: sums of each workgroup.
    pub sums: DeviceVec<[f32; 4]>,
    /// Output: means of |F − mean| of each region.
    pub spreads: DeviceVec<[f32; 4]>,
}

impl LossPass {
    pub(super) fn new(gpu: &Gpu, latent_dim: usize, latents: &[f32]) -> Result<Self> {
        let regions = |entry| Kernel::new(gpu, &RegionsWgsl::SHADER, entry, latent_dim);
        Ok(Self {
            latent_dim,
            loss: Kernel::new(gpu, &LossWgsl::SHADER, "loss", latent_dim)?,
            sum_values: regions("sum_values")?,
            fold_means: regions("fold_means")?,
            sum_deviations: regions("sum_deviations")?,
            fold_spreads: regions("fold_spreads")?,
            add_gradients: regions("add_gradients")?,
            latents: DeviceVec::from_slice(gpu, "latent features", latents)?,
            region_sums: DeviceVec::new(gpu, "regions"),
            means: DeviceVec::new(gpu, "regions"),
            g_planes: DeviceVec::new(gpu, "gradients of the picture"),
            sums: DeviceVec::new(gpu, "loss terms"),
            spreads: DeviceVec::new(gpu, "regions"),
        })
    }

    /// Makes room for a step.
    pub(super) fn prepare(&mut self, step: &CurrentStep<'_>) -> Result<()> {
        let (gpu, pixels) = (step.gpu, step.num_pixels());
        let quads = self.latent_dim.div_ceil(4).max(1);
        let (blocks, regions) = (step.frame.blocks.len(), step.frame.large_regions.len());
        self.g_planes.resize(gpu, pixels * (FEATURE_PLANE + self.latent_dim))?;
        self.sums.resize(gpu, pixels.div_ceil(GROUP as usize) * TERM_QUADS)?;
        self.region_sums.resize(gpu, blocks * quads * 2)?;
        self.means.resize(gpu, regions * quads)?;
        self.spreads.resize(gpu, regions * quads * 2)
    }

    /// Number of workgroups of the loss; each writes its sums.
    pub(super) fn num_groups(&self) -> u32 {
        (self.sums.len() / TERM_QUADS) as u32
    }

    /// Adds the loss and its gradient with respect to the planes.
    pub(super) fn encode(&self, step: &CurrentStep<'_>, pass: &mut Pass<'_>) {
        let (gpu, frame, weights) = (step.gpu, step.frame, step.weights());
        let scales = TermScales::<f32>::new(&weights, frame.supervised, step.num_pixels(), self.latent_dim);
        let params = uniform(
            gpu,
            &LossParams {
                size: step.view.size,
                has_depth: u32::from(frame.has_depth && weights.depth != 0.0),
                has_regions: u32::from(frame.has_regions),
                raw_depth: u32::from(weights.raw_depth),
                unmasked_variation: u32::from(weights.unmasked_variation),
                num_rows: (step.context.latents.len() / self.latent_dim.max(1)) as u32,
                typical_depth: step.context.typical_depth,
                ..LossParams::weighted(&scales, frame.supervised > 0)
            },
        );
        let bindings = [
            LossWgsl::params(&params),
            LossWgsl::planes(&step.raster.planes),
            LossWgsl::pixels(&frame.pixels),
            LossWgsl::depths(&frame.depths),
            LossWgsl::regions(&frame.regions),
            LossWgsl::latents(&self.latents),
            LossWgsl::g_planes(&self.g_planes),
            LossWgsl::partial_sums(&self.sums),
        ];
        self.loss.dispatch(gpu, pass, &bindings, self.num_groups());
        if step.num_regions() > 0 {
            self.encode_regions(step, pass, &weights, scales.smoothness);
        }
    }

    fn encode_regions(
        &self,
        step: &CurrentStep<'_>,
        pass: &mut Pass<'_>,
        weights: &LossWeights,
        smoothness: f32,
    ) {
        let (gpu, frame) = (step.gpu, step.frame);
        let num_blocks = frame.blocks.len() as u32;
        let params = uniform(
            gpu,
            &RegionsParams {
                num_pixels: step.num_pixels() as u32,
                num_blocks,
                num_regions: frame.num_regions as u32,
                is_pooled: u32::from(weights.pooled_regions),
                smoothness,
                ..Default::default()
            },
        );
        let params = &RegionsWgsl::params(&params);
        // Only the features of listed pixels are looked at.
        let listed_bytes = frame.listed.num_bytes() * self.latent_dim as u64;
        let planes = &RegionsWgsl::planes(Array::from(&step.raster.planes).moving(listed_bytes));
        let listed = &RegionsWgsl::listed(&frame.listed);
        let blocks = &RegionsWgsl::blocks(&frame.blocks);
        let regions = &RegionsWgsl::regions(&frame.large_regions);
        let sums = &RegionsWgsl::block_sums(&self.region_sums);
        let means = &RegionsWgsl::means(&self.means);
        let spreads = &RegionsWgsl::spreads(&self.spreads);
        let g_planes = &RegionsWgsl::g_planes(Array::from(&self.g_planes).moving(2 * listed_bytes));
        let per_region = (frame.num_regions as u32).div_ceil(GROUP);
        let mut run = |kernel: &Kernel, bindings: &[&Bound<'_>], groups| {
            let bindings: Vec<_> = bindings.iter().map(|bound| (*bound).clone()).collect();
            kernel.dispatch(gpu, pass, &bindings, groups);
        };
        run(&self.sum_values, &[params, planes, listed, blocks, sums], num_blocks);
        run(&self.fold_means, &[params, regions, sums, means], per_region);
        run(&self.sum_deviations, &[params, planes, listed, blocks, sums, means], num_blocks);
        run(&self.fold_spreads, &[params, regions, sums, spreads], per_region);
        let all = [params, planes, listed, blocks, regions, means, spreads, g_planes];
        run(&self.add_gradients, &all, num_blocks);
    }
}
