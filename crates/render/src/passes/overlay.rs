//! Draws the found regions over a frame (`shaders/overlay.wgsl`).

use super::run;
use crate::{
    Gpu, Mark,
    buffers::{DeviceVec, uniform},
    kernel::Kernel,
    layout::{Overlay, PromptRow},
    shader_source::GROUP,
};
use image::RgbImage;
use surgtpgs_core::{
    Result,
    overlay::{OverlayLook, OverlayPrompt},
};

#[derive(Debug)]
pub(crate) struct OverlayPass {
    kernel: Kernel,
}

impl OverlayPass {
    pub(super) fn new(gpu: &Gpu) -> Result<Self> {
        Ok(Self { kernel: Kernel::new(gpu, "overlay.wgsl", "overlay", 0)? })
    }

    /// Adds the pass, which draws over `pixels` in place.
    pub(crate) fn encode(
        &self,
        gpu: &Gpu,
        pass: &mut wgpu::ComputePass<'_>,
        params: &Overlay,
        [prompts, scores, pixels]: [wgpu::BindingResource<'_>; 3],
    ) {
        let uniform = uniform(gpu, params);
        let bindings = [(0, uniform.as_entire_binding()), (1, prompts), (2, scores), (3, pixels)];
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
        let rows: Vec<PromptRow> = prompts
            .iter()
            .map(|p| PromptRow::from(&Mark { threshold: p.threshold, colour: p.colour }))
            .collect();
        let scores: Vec<f32> = prompts.iter().flat_map(|p| p.scores.data.iter().copied()).collect();
        let params = Overlay::new(size, prompts.len(), look);
        let rows = DeviceVec::from_slice(gpu, "prompts", &rows)?;
        let scores = DeviceVec::from_slice(gpu, "scores", &scores)?;
        let pixels = DeviceVec::from_slice(gpu, "pixels", &to_pixels(frame))?;
        let bindings = [rows.binding(), scores.binding(), pixels.binding()];
        run(gpu, |pass| self.encode(gpu, pass, &params, bindings));
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
    for (pixel, number) in picture.pixels_mut().zip(pixels) {
        let [r, g, b, _] = number.to_le_bytes();
        pixel.0 = [r, g, b];
    }
    picture
}
