//! Rendered and recorded frames as the window shows them.

use crate::viewer::picture::request::{AskedPrompt, Finding, Request};
use egui::ColorImage;
use image::RgbImage;
use std::sync::Arc;
use surgtpgs_core::{
    grid::{Grid, Mask},
    overlay::{OverlayPrompt, overlay_layers},
};

/// Draws everything found over the frame; returns `None` if there is nothing to draw.
pub(crate) fn mark(
    frame: &RgbImage,
    findings: &[Finding],
    tools: Option<&Mask>,
    request: &Request,
) -> Option<Arc<ColorImage>> {
    let layers: Vec<(&Grid<f32>, &AskedPrompt, bool)> = findings
        .iter()
        .filter_map(|finding| {
            let prompt = request.prompts.iter().find(|p| p.id == finding.id)?;
            Some((&*finding.outcome.as_ref().ok()?.cleaned, prompt, finding.stand_in(prompt).is_some()))
        })
        .collect();
    let (first, ..) = layers.first()?;
    let (width, height) = (first.width as u32, first.height as u32);
    let resized;
    let frame = if frame.dimensions() == (width, height) {
        frame
    } else {
        resized = image::imageops::thumbnail(frame, width, height);
        &resized
    };
    let prompts: Vec<(OverlayPrompt<'_>, bool)> = layers
        .iter()
        .map(|&(scores, p, is_dashed)| {
            let drawn = OverlayPrompt { scores, threshold: p.threshold, colour: p.colour, is_dashed };
            (drawn, p.is_instrument)
        })
        .collect();
    Some(Arc::new(color_image(&overlay_layers(frame, &prompts, tools, request.look))))
}

/// Share of its colour that a pixel keeps if the endoscope did not see it.
const FADED: f32 = 0.3;
/// Grey level that such a pixel fades to.
const FADED_TO: f32 = 48.0;

/// Fades the pixels that the endoscope did not see; returns their share of the picture.
pub(crate) fn fade(colour: &mut RgbImage, depth: &Grid<f32>, unseen: &Mask) -> f32 {
    let mut count = 0;
    for ((pixel, z), _) in
        colour.pixels_mut().zip(&depth.data).zip(&unseen.data).filter(|(_, unseen)| **unseen)
    {
        // Pixels without a surface are black already.
        if *z > 0.0 {
            count += 1;
            pixel.0 = pixel.0.map(|v| (FADED * f32::from(v) + (1.0 - FADED) * FADED_TO).round() as u8);
        }
    }
    count as f32 / depth.data.len().max(1) as f32
}

pub(crate) fn color_image(image: &RgbImage) -> ColorImage {
    ColorImage::from_rgb([image.width() as usize, image.height() as usize], image.as_raw())
}
