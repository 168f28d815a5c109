//! Draws the found regions over a frame (`shaders/overlay.wgsl`).

use crate::{
    buffers::{DeviceVec, uniform},
    device::Gpu,
    kernel::{Kernel, Pass, run},
    shader::{GROUP, shader, shader_struct},
};
use image::RgbImage;
use rayon::prelude::*;
use surgtpgs_core::{
    Result,
    overlay::{self, OverlayLook, OverlayPrompt},
};

/// Pixels that one thread converts at once.
const PIXELS_AT_ONCE: usize = 1 << 15;

shader! {
    pub(super) Wgsl = "overlay.wgsl";
    const CONTOUR_WIDTH = overlay::CONTOUR_WIDTH;
    const DASH = overlay::DASH;
    const HALO_DARKNESS = overlay::HALO_DARKNESS;
    var<uniform> params: OverlayParams;
    var<read> prompts: [PromptRow];
    /// [prompts][rows][columns]
    var<read> scores: [f32];
    /// One number per pixel: red in the lowest byte, then green, blue and 255; drawn over in place.
    var<write> pixels: [u32];
}

shader_struct! {
    /// Settings for drawing over a frame.
    pub(crate) struct OverlayParams {
        /// Columns and rows.
        size: [u32; 2],
        /// Number of prompts to draw.
        num_prompts: u32,
        /// [`surgtpgs_core::overlay::OverlayStyle`] as a number.
        style: u32,
        /// Opacity of fills and heatmaps, 0–1.
        opacity: f32,
        /// Opacity of contours and their halos, 0–1.
        outline_opacity: f32,
        /// Padding to a multiple of 16 bytes.
        padding: [u32; 2],
        /// Factors of the powers of a score in the colour of a heatmap, red, green, blue and 0.
        heat_0: [f32; 4],
        /// As `heat_0`, for the first power.
        heat_1: [f32; 4],
        /// As `heat_0`, for the second power.
        heat_2: [f32; 4],
        /// As `heat_0`, for the third power.
        heat_3: [f32; 4],
        /// As `heat_0`, for the fourth power.
        heat_4: [f32; 4],
        /// As `heat_0`, for the fifth power.
        heat_5: [f32; 4],
        /// As `heat_0`, for the sixth power.
        heat_6: [f32; 4],
    }
}

shader_struct! {
    /// One prompt to draw.
    pub(crate) struct PromptRow {
        /// Colour, 0–255.
        colour: [f32; 3],
        /// Score above which a pixel is found.
        threshold: f32,
        /// 1 for a dashed contour without a fill.
        is_dashed: u32,
        /// Padding to a multiple of 16 bytes.
        padding: u32,
        /// Padding to a multiple of 16 bytes.
        padding_2: [u32; 2],
    }
}

impl OverlayParams {
    /// Settings for a frame of `size` with `num_prompts` prompts.
    pub fn new(size: [u32; 2], num_prompts: usize, look: OverlayLook) -> Self {
        let OverlayLook { style, outline_opacity, .. } = look;
        let opacity = if style.shows_scores() { look.heat_opacity } else { look.opacity };
        let heat = look.palette.coefficients().map(|[r, g, b]| [r, g, b, 0.0]);
        let [heat_0, heat_1, heat_2, heat_3, heat_4, heat_5, heat_6] = heat;
        Self {
            size,
            num_prompts: num_prompts as u32,
            style: style as u32,
            opacity,
            outline_opacity,
            padding: [0; 2],
            heat_0,
            heat_1,
            heat_2,
            heat_3,
            heat_4,
            heat_5,
            heat_6,
        }
    }
}

impl PromptRow {
    pub(super) fn new(colour: [u8; 3], threshold: f32, is_dashed: bool) -> Self {
        let colour = colour.map(f32::from);
        Self { colour, threshold, is_dashed: u32::from(is_dashed), ..Default::default() }
    }
}

#[derive(Debug)]
pub(crate) struct OverlayPass {
    kernel: Kernel,
}

impl OverlayPass {
    pub(super) fn new(gpu: &Gpu) -> Result<Self> {
        Ok(Self { kernel: Kernel::new(gpu, &Wgsl::SHADER, "overlay", 0)? })
    }

    /// Adds the pass, which draws over `pixels` in place.
    pub(crate) fn encode(
        &self,
        gpu: &Gpu,
        pass: &mut Pass<'_>,
        params: &OverlayParams,
        prompts: &DeviceVec<PromptRow>,
        scores: &DeviceVec<f32>,
        pixels: &DeviceVec<u32>,
    ) {
        let uniform = uniform(gpu, params);
        let bindings = [
            Wgsl::params(&uniform),
            Wgsl::prompts(prompts),
            Wgsl::scores(scores),
            Wgsl::pixels(pixels.in_place()),
        ];
        let num_pixels = params.size[0] * params.size[1];
        self.kernel.dispatch(gpu, pass, &bindings, num_pixels.div_ceil(GROUP));
    }

    /// Uploads, draws, and waits for the picture.
    pub(super) fn draw(
        &self,
        gpu: &Gpu,
        frame: &RgbImage,
        prompts: &[OverlayPrompt<'_>],
        look: OverlayLook,
    ) -> Result<RgbImage> {
        let size = [frame.width(), frame.height()];
        let num_pixels = size[0] * size[1];
        let fits = |p: &&OverlayPrompt<'_>| [p.scores.width, p.scores.height] == size.map(|s| s as usize);
        let prompts: Vec<&OverlayPrompt<'_>> = prompts.iter().filter(fits).collect();
        if num_pixels == 0 || prompts.is_empty() {
            return Ok(frame.clone());
        }
        let rows: Vec<PromptRow> =
            prompts.iter().map(|p| PromptRow::new(p.colour, p.threshold, p.is_dashed)).collect();
        let scores: Vec<f32> = prompts.iter().flat_map(|p| p.scores.data.iter().copied()).collect();
        let params = OverlayParams::new(size, prompts.len(), look);
        let rows = DeviceVec::from_slice(gpu, "prompts", &rows)?;
        let scores = DeviceVec::from_slice(gpu, "scores", &scores)?;
        let pixels = DeviceVec::from_slice(gpu, "pixels", &to_pixels(frame))?;
        run(gpu, |pass| self.encode(gpu, pass, &params, &rows, &scores, &pixels));
        Ok(from_pixels(size, &pixels.read(gpu, num_pixels as usize)?))
    }
}

/// Converts to one number per pixel: red in the lowest byte, then green, blue and 255.
pub(crate) fn to_pixels(picture: &RgbImage) -> Vec<u32> {
    picture.pixels().map(|p| u32::from_le_bytes([p.0[0], p.0[1], p.0[2], 255])).collect()
}

/// Converts the numbers of [`to_pixels`] back to a picture of columns × rows.
pub(crate) fn from_pixels([width, height]: [u32; 2], pixels: &[u32]) -> RgbImage {
    let mut picture = RgbImage::new(width, height);
    let colours = picture.par_chunks_exact_mut(3).zip(pixels).with_min_len(PIXELS_AT_ONCE);
    colours.for_each(|(colour, number)| colour.copy_from_slice(&number.to_le_bytes()[..3]));
    picture
}
