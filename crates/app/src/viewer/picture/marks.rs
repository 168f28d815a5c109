//! Rendered and recorded frames as the window shows them.

use crate::viewer::picture::request::{Finding, Outlines, Request};
use egui::ColorImage;
use image::RgbImage;
use std::sync::Arc;
use surgtpgs_core::{
    grid::{Grid, Mask},
    overlay::{OverlayPrompt, OverlayStyle, outlines, overlay_layers},
};

/// Returns the lines around everything found.
pub(crate) fn outline(findings: &[Finding], tools: Option<&Mask>, request: &Request) -> Arc<Outlines> {
    let layers = layers(findings, request);
    let size = layers.first().map_or((0, 0), |(p, _)| (p.scores.width, p.scores.height));
    let lines = outlines(&layers, tools, request.look);
    Arc::new(Outlines { lines, size, opacity: request.look.outline_opacity })
}

/// Draws the fills or the heatmap of everything found over the frame; returns `None` if there are none.
pub(crate) fn mark(
    frame: &RgbImage,
    findings: &[Finding],
    tools: Option<&Mask>,
    request: &Request,
) -> Option<Arc<ColorImage>> {
    if request.look.style == OverlayStyle::Outline {
        return None;
    }
    let layers = layers(findings, request);
    let (first, _) = layers.first()?;
    let (width, height) = (first.scores.width as u32, first.scores.height as u32);
    let resized;
    let frame = if frame.dimensions() == (width, height) {
        frame
    } else {
        resized = image::imageops::thumbnail(frame, width, height);
        &resized
    };
    Some(Arc::new(color_image(&overlay_layers(frame, &layers, tools, request.look))))
}

/// Returns what is drawn of each prompt that has an answer, and `true` for instruments.
fn layers<'a>(findings: &'a [Finding], request: &Request) -> Vec<(OverlayPrompt<'a>, bool)> {
    let layer = |finding: &'a Finding| {
        let prompt = request.prompts.iter().find(|p| p.id == finding.id)?;
        let drawn = OverlayPrompt {
            scores: &finding.outcome.as_ref().ok()?.cleaned,
            threshold: prompt.threshold,
            colour: prompt.colour,
            is_dashed: finding.stand_in(prompt).is_some(),
        };
        Some((drawn, prompt.is_instrument))
    };
    findings.iter().filter_map(layer).collect()
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
