//! Drawing what was found on top of a frame; the CPU twin of `shaders/overlay.wgsl`.

use crate::grid::Grid;
use image::RgbImage;

/// How a found region is drawn.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum OverlayStyle {
    /// A coloured contour with a dark halo: the surgeon's default.
    Outline,
    /// A translucent fill with contour.
    Fill,
    /// The score itself as colour, fixed range 0–1, never normalised per frame.
    Heatmap,
}

/// One prompt to draw.
#[derive(Clone, Copy, Debug)]
pub struct OverlayPrompt<'a> {
    /// Score image of the frame's size.
    pub scores: &'a Grid<f32>,
    /// Score above which a pixel is found.
    pub threshold: f32,
    /// The prompt's own colour.
    pub colour: [u8; 3],
}

/// Draws `prompts` over `frame`. `opacity` (0–1) scales fills and heatmaps; contours are 2 px at the frame's size.
pub fn overlay(
    frame: &RgbImage,
    prompts: &[OverlayPrompt<'_>],
    style: OverlayStyle,
    opacity: f32,
) -> RgbImage {
    let _ = (frame, prompts, style, opacity);
    todo!()
}
