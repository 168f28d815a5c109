//! Ground truth of a step, on the device.

use crate::{buffers::DeviceVec, device::Gpu, shader::shader_struct};
use std::collections::BTreeMap;
use surgtpgs_core::{
    Result,
    raster::project::Sampling,
    train::{Context, StepPlan, Truth},
};

/// Number of pixels of a region that one workgroup sums up.
const REGION_BLOCK: usize = 1024;

shader_struct! {
    /// A block of the listed pixels of one region.
    pub(super) struct RegionBlock {
        /// Index of the region.
        region: u32,
        /// First of the listed pixels.
        first: u32,
        /// End of the listed pixels.
        end: u32,
        /// Padding to a multiple of 16 bytes.
        padding: u32,
    }
}

shader_struct! {
    /// A large region.
    pub(super) struct Region {
        /// First of its blocks.
        first: u32,
        /// End of its blocks.
        end: u32,
        /// Number of supervised pixels.
        num_pixels: u32,
        /// Padding to a multiple of 16 bytes.
        padding: u32,
    }
}

/// The sampled pixels of one frame.
#[derive(Debug)]
pub(super) struct FrameBuffers {
    /// Number of supervised pixels.
    pub supervised: usize,
    pub has_depth: bool,
    pub has_regions: bool,
    pub num_regions: usize,
    /// Colours r, g, b, then 255 if the pixel is supervised.
    pub pixels: DeviceVec<u32>,
    /// Depths; one unread number if there are none.
    pub depths: DeviceVec<f32>,
    /// Rows of the table of features; one unread number if there are none.
    pub regions: DeviceVec<u32>,
    /// Pixels of the large regions, region by region.
    pub listed: DeviceVec<u32>,
    pub blocks: DeviceVec<RegionBlock>,
    pub large_regions: DeviceVec<Region>,
}

impl FrameBuffers {
    fn new(gpu: &Gpu, truth: &Truth<'_>, latent_dim: usize, min_region_px: usize) -> Result<Self> {
        let n = truth.width * truth.height;
        let byte = |plane: usize, i: usize| u32::from(truth.colour[plane * n + i]) << (8 * plane);
        let mask = |i: usize| if truth.mask[i] { 255u32 << 24 } else { 0 };
        let pixels: Vec<u32> = (0..n).map(|i| byte(0, i) | byte(1, i) | byte(2, i) | mask(i)).collect();
        let supervised = truth.mask.iter().filter(|m| **m).count();
        let rows = truth.latents.len() / latent_dim.max(1);
        let lists = RegionLists::new(truth, rows, min_region_px);
        let regions: Vec<u32> = truth.regions.iter().map(|r| u32::from(*r)).collect();
        Ok(Self {
            supervised,
            has_depth: supervised > 0 && !truth.depth.is_empty(),
            has_regions: supervised > 0 && latent_dim > 0 && !truth.regions.is_empty(),
            num_regions: lists.regions.len(),
            pixels: DeviceVec::from_slice(gpu, "pixels", &pixels)?,
            depths: DeviceVec::from_slice(gpu, "depth", truth.depth)?,
            regions: DeviceVec::from_slice(gpu, "regions", &regions)?,
            listed: DeviceVec::from_slice(gpu, "regions", &lists.pixels)?,
            blocks: DeviceVec::from_slice(gpu, "regions", &lists.blocks)?,
            large_regions: DeviceVec::from_slice(gpu, "regions", &lists.regions)?,
        })
    }

    fn bytes(&self) -> u64 {
        let lists = self.listed.num_bytes() + self.blocks.num_bytes() + self.large_regions.num_bytes();
        self.pixels.num_bytes() + self.depths.num_bytes() + self.regions.num_bytes() + lists
    }
}

/// Supervised pixels of the regions that are large enough to be smoothed.
#[derive(Default)]
struct RegionLists {
    pixels: Vec<u32>,
    blocks: Vec<RegionBlock>,
    regions: Vec<Region>,
}

impl RegionLists {
    fn new(truth: &Truth<'_>, rows: usize, min_px: usize) -> Self {
        let mut by_region = vec![Vec::new(); rows];
        for (i, (region, mask)) in truth.regions.iter().zip(truth.mask).enumerate() {
            if let Some(pixels) = by_region.get_mut(usize::from(*region)).filter(|_| *mask) {
                pixels.push(i as u32);
            }
        }
        let mut lists = Self::default();
        for pixels in by_region.iter().filter(|pixels| pixels.len() >= min_px.max(1)) {
            lists.add(pixels);
        }
        lists
    }

    fn add(&mut self, pixels: &[u32]) {
        let first_block = self.blocks.len() as u32;
        for block in pixels.chunks(REGION_BLOCK) {
            let first = self.pixels.len() as u32;
            self.pixels.extend_from_slice(block);
            let region = self.regions.len() as u32;
            self.blocks.push(RegionBlock { region, first, end: self.pixels.len() as u32, padding: 0 });
        }
        let end = self.blocks.len() as u32;
        self.regions.push(Region { first: first_block, end, num_pixels: pixels.len() as u32, padding: 0 });
    }
}

/// Frames on the device within a memory budget.
#[derive(Debug, Default)]
pub(super) struct FrameStore {
    frames: BTreeMap<(usize, bool, [usize; 2]), FrameBuffers>,
    bytes: u64,
}

impl FrameStore {
    /// Returns the pixels that a step renders.
    pub(super) fn get(
        &mut self,
        gpu: &Gpu,
        plan: &StepPlan,
        context: &Context<'_>,
        latent_dim: usize,
    ) -> Result<&FrameBuffers> {
        let sampling = plan.view.sampling;
        let key = (plan.index, plan.view.half, sampling.first);
        if !self.frames.contains_key(&key) {
            let sampled = (sampling != Sampling::ALL).then(|| plan.frame.sampled(sampling));
            let frame = sampled.as_ref().unwrap_or(&plan.frame);
            let truth = frame.truth(context.latents, context.typical_depth);
            let min_region_px = context.loss_weights(&plan.view).min_region_px;
            let buffers = FrameBuffers::new(gpu, &truth, latent_dim, min_region_px)?;
            // All frames are equally likely to be needed next, so it does not matter which are dropped.
            while self.bytes + buffers.bytes() > context.settings.frame_cache_bytes as u64
                && let Some((_, dropped)) = self.frames.pop_first()
            {
                self.bytes -= dropped.bytes();
            }
            self.bytes += buffers.bytes();
            self.frames.insert(key, buffers);
        }
        Ok(&self.frames[&key])
    }
}
