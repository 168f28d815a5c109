//! From image planes to 8-bit colours and depth (`shaders/compose.wgsl`).

use crate::{
    buffers::{Array, DeviceVec, uniform},
    device::Gpu,
    kernel::{Kernel, Pass},
    shader::{GROUP, shader, shader_struct},
};
use image::RgbImage;
use rayon::prelude::*;
use surgtpgs_core::{Result, raster::FEATURE_PLANE};

/// Pixels that one thread converts at once.
const PIXELS_AT_ONCE: usize = 1 << 15;

shader! {
    pub(super) Wgsl = "compose.wgsl";
    var<uniform> params: ComposeParams;
    /// Planes in the layout of the raster pass.
    var<read> planes: [f32];
    /// Pixels inside the field of view: one bit per pixel, starting with the lowest bit of each word.
    var<read> inside: [u32];
    /// One number per pixel: red in the lowest byte, then green, blue and 255.
    var<write> pixels: [u32];
    var<write> depths: [f32];
}

shader_struct! {
    /// Conversion of planes to the shown picture.
    pub(crate) struct ComposeParams {
        /// Columns times rows.
        num_pixels: u32,
        /// Smallest accumulated opacity of a pixel that has depth.
        min_alpha: f32,
        /// Padding to a multiple of 16 bytes.
        padding: [u32; 2],
    }
}

#[derive(Debug)]
pub(crate) struct ComposePass {
    kernel: Kernel,
    /// Output: one number per pixel, red in the lowest byte.
    pub pixels: DeviceVec<u32>,
    /// Output: depth divided by opacity; 0 at pixels without depth.
    pub depths: DeviceVec<f32>,
}

impl ComposePass {
    pub(crate) fn new(gpu: &Gpu) -> Result<Self> {
        Ok(Self {
            kernel: Kernel::new(gpu, &Wgsl::SHADER, "compose", 0)?,
            pixels: DeviceVec::new(gpu, "pixels"),
            depths: DeviceVec::new(gpu, "depths"),
        })
    }

    /// Makes room for `num_pixels`.
    pub(crate) fn prepare(&mut self, gpu: &Gpu, num_pixels: usize) -> Result<()> {
        self.pixels.resize(gpu, num_pixels)?;
        self.depths.resize(gpu, num_pixels)
    }

    /// Adds the pass; `inside` has one bit per pixel.
    pub(crate) fn encode(
        &self,
        gpu: &Gpu,
        pass: &mut Pass<'_>,
        planes: &DeviceVec<f32>,
        inside: &DeviceVec<u32>,
        min_alpha: f32,
    ) {
        let num_pixels = self.pixels.len() as u32;
        let params = uniform(gpu, &ComposeParams { num_pixels, min_alpha, padding: [0; 2] });
        let bindings = [
            Wgsl::params(&params),
            // Features are not looked at.
            Wgsl::planes(Array::from(planes).moving(FEATURE_PLANE as u64 * self.depths.num_bytes())),
            Wgsl::inside(inside),
            Wgsl::pixels(&self.pixels),
            Wgsl::depths(&self.depths),
        ];
        self.kernel.dispatch(gpu, pass, &bindings, num_pixels.div_ceil(GROUP));
    }
}

/// Converts the numbers of [`ComposePass::pixels`] to a picture of columns × rows.
pub(super) fn to_picture([width, height]: [u32; 2], pixels: &[u32]) -> RgbImage {
    let mut picture = RgbImage::new(width, height);
    let colours = picture.par_chunks_exact_mut(3).zip(pixels).with_min_len(PIXELS_AT_ONCE);
    colours.for_each(|(colour, number)| colour.copy_from_slice(&number.to_le_bytes()[..3]));
    picture
}
