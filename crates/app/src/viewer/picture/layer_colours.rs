//! Depth, motion and opacity as pictures.

use crate::viewer::state::view_mode::Layer;
use egui::ColorImage;
use surgtpgs_core::grid::Grid;

/// Colours of depth from near to far: cividis, readable with any colour vision.
const DEPTH_COLOURS: [[u8; 3]; 6] =
    [[255, 234, 70], [203, 186, 105], [149, 143, 120], [102, 105, 112], [49, 68, 107], [0, 32, 77]];

/// Returns the colour of a depth; `share` is 0 at the near and 1 at the far end of the scale.
pub(crate) fn depth_colour(share: f32) -> egui::Color32 {
    let at = if share.is_finite() { share.clamp(0.0, 1.0) } else { 1.0 } * (DEPTH_COLOURS.len() - 1) as f32;
    let k = (at as usize).min(DEPTH_COLOURS.len() - 2);
    let mix = |c: usize| {
        let (a, b) = (f32::from(DEPTH_COLOURS[k][c]), f32::from(DEPTH_COLOURS[k + 1][c]));
        (a + (b - a) * (at - k as f32)).round() as u8
    };
    egui::Color32::from_rgb(mix(0), mix(1), mix(2))
}

/// Returns the colour of a value as share of its scale. Bright means near, moving far, or opaque.
pub(crate) fn layer_colour(layer: Layer, share: f32) -> egui::Color32 {
    depth_colour(if layer == Layer::Depth { share } else { 1.0 - share })
}

/// Draws the values of a layer in colours. Pixels without a value are hatched, so that they are not mistaken
/// for small values.
pub(crate) fn colour_layer(layer: Layer, values: &Grid<f32>, (low, high): (f32, f32)) -> ColorImage {
    let span = (high - low).max(f32::MIN_POSITIVE);
    let pixel = |(i, &value): (usize, &f32)| {
        let is_there = if layer == Layer::Depth { value > 0.0 } else { value >= 0.0 };
        if is_there {
            return layer_colour(layer, ((value - low) / span).clamp(0.0, 1.0));
        }
        let is_line = (i % values.width + i / values.width) % 8 < 2;
        egui::Color32::from_gray(if is_line { 70 } else { 30 })
    };
    ColorImage::new([values.width, values.height], values.data.iter().enumerate().map(pixel).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn depth_colours_run_from_the_first_to_the_last_and_holes_are_grey() {
        assert_eq!(depth_colour(0.0), egui::Color32::from_rgb(255, 234, 70));
        assert_eq!(depth_colour(1.0), egui::Color32::from_rgb(0, 32, 77));
        assert_eq!(depth_colour(f32::NAN), depth_colour(1.0));
        let image = colour_layer(Layer::Depth, &Grid::from_vec(2, 1, vec![0.0, 10.0]), (10.0, 20.0));
        assert_eq!(image.pixels[0], egui::Color32::from_gray(70));
        assert_eq!(image.pixels[1], depth_colour(0.0));
    }

    #[test]
    fn what_moves_far_is_bright_what_is_still_is_dark_and_nothing_is_hatched() {
        let image =
            colour_layer(Layer::Motion, &Grid::from_vec(3, 1, vec![0.0, 99.0, f32::NAN]), (0.0, 10.0));
        let ends = [1.0, 0.0].map(depth_colour);
        assert_eq!((image.pixels[0], image.pixels[1], image.pixels[2].r()), (ends[0], ends[1], 30));
    }
}
