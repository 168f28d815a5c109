//! What was found, drawn over a frame (`shaders/overlay.wgsl`).

use super::run;
use crate::{
    Gpu,
    buffers::{DeviceVec, uniform},
    kernel::Kernel,
    layout::{Overlay, PromptRow},
    shader_source::GROUP,
};
use image::RgbImage;
use surgtpgs_core::{
    Result,
    overlay::{OverlayPrompt, OverlayStyle},
};

#[derive(Debug)]
pub(super) struct OverlayPass {
    kernel: Kernel,
}

impl OverlayPass {
    pub(super) fn new(gpu: &Gpu) -> Result<Self> {
        Ok(Self { kernel: Kernel::new(gpu, "overlay.wgsl", "overlay", 0)? })
    }

    /// Uploads, draws, and waits for the picture.
    pub(super) fn draw(
        &self,
        gpu: &Gpu,
        frame: &RgbImage,
        prompts: &[OverlayPrompt<'_>],
        style: OverlayStyle,
        opacity: f32,
    ) -> Result<RgbImage> {
        let size = [frame.width(), frame.height()];
        let num_pixels = size[0] * size[1];
        let fits = |p: &&OverlayPrompt<'_>| [p.scores.width, p.scores.height] == size.map(|s| s as usize);
        let prompts: Vec<&OverlayPrompt<'_>> = prompts.iter().filter(fits).collect();
        if num_pixels == 0 || prompts.is_empty() {
            return Ok(frame.clone());
        }
        let rows: Vec<PromptRow> = prompts.iter().map(|p| PromptRow::from(*p)).collect();
        let scores: Vec<f32> = prompts.iter().flat_map(|p| p.scores.data.iter().copied()).collect();
        let pixels: Vec<u32> =
            frame.pixels().map(|p| u32::from_le_bytes([p.0[0], p.0[1], p.0[2], 255])).collect();
        let params = uniform(gpu, &Overlay::new(size, prompts.len(), style, opacity));
        let rows = DeviceVec::from_slice(gpu, "prompts", &rows)?;
        let scores = DeviceVec::from_slice(gpu, "scores", &scores)?;
        let pixels = DeviceVec::from_slice(gpu, "pixels", &pixels)?;
        let bindings = [
            (0, params.as_entire_binding()),
            (1, rows.binding()),
            (2, scores.binding()),
            (3, pixels.binding()),
        ];
        run(gpu, |pass| self.kernel.dispatch(gpu, pass, &bindings, num_pixels.div_ceil(GROUP)));
        let drawn = pixels.read(gpu, num_pixels as usize)?;
        let pixel = |x: u32, y: u32| {
            let [r, g, b, _] = drawn[(y * size[0] + x) as usize].to_le_bytes();
            image::Rgb([r, g, b])
        };
        Ok(RgbImage::from_fn(size[0], size[1], pixel))
    }
}
