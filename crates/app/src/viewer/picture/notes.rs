//! Words about a picture that must be known wherever it is seen, on the screen and in copies.

use crate::viewer::{
    picture::{difference::FULL_SCALE, request::LayerPane},
    state::view_mode::Layer,
};

/// Note where the depth of the reconstruction was not measured.
pub(crate) const GUESSED: &str = "The shape is guessed";
/// Note on a view that the endoscope never had.
pub(crate) const SYNTHESISED: &str = "Synthesised view – not what the endoscope saw";
/// Note where a turned view shows more than was recorded.
pub(crate) const FADED: &str = "Faded: not seen by the endoscope on this frame";

/// Colours at both ends of most scales.
const DARK_TO_BRIGHT: [&str; 2] = ["blue", "yellow"];

/// Scale of the colours of a picture.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Scale {
    /// Name of what the colours show, with its unit.
    pub(crate) title: &'static str,
    /// Values at the left and at the right end, in words.
    pub(crate) ends: [String; 2],
    /// Names of the colours there.
    colours: [&'static str; 2],
}

impl Scale {
    /// The scale of a layer. Depth has numbers only if it is known; else [`GUESSED`] says more.
    pub(crate) fn of_layer(pane: &LayerPane, is_known: bool) -> Self {
        let (low, high) = pane.range;
        let (title, ends) = match pane.layer {
            Layer::Depth if is_known => {
                ("depth, scene units", [format!("near {low:.1}"), format!("far {high:.1}")])
            }
            Layer::Depth => ("depth", ["near".into(), "far".into()]),
            Layer::Motion => {
                ("path over the recording, pixels", ["still".into(), format!("{high:.0} or more")])
            }
            Layer::Opacity => ("opacity of the reconstruction", ["0".into(), "1".into()]),
        };
        let [dark, bright] = DARK_TO_BRIGHT;
        let colours = if pane.layer == Layer::Depth { [bright, dark] } else { [dark, bright] };
        Self { title, ends, colours }
    }

    /// The scale of the difference between a recorded frame and its reconstruction.
    pub(crate) fn of_difference() -> Self {
        let ends = ["0".into(), format!("{FULL_SCALE:.0} or more")];
        Self { title: "difference, levels of 255", ends, colours: DARK_TO_BRIGHT }
    }

    /// Describes the scale in a line, for pictures that it is not drawn on.
    pub(crate) fn words(&self) -> String {
        let Self { title, ends: [left, right], colours: [first, last] } = self;
        format!("{title}: {left} ({first}) to {right} ({last})")
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::viewer::picture::{difference::difference_colour, layer_colours::layer_colour};
    use std::sync::Arc;

    #[test]
    fn scales_are_named_by_their_values_and_colours() {
        let layer = |layer, range| {
            let image = Arc::new(egui::ColorImage::filled([1, 1], egui::Color32::BLACK));
            LayerPane { layer, image, range, note: String::new() }
        };
        let depth = layer(Layer::Depth, (34.0, 120.0));
        let words = Scale::of_layer(&depth, true).words();
        assert_eq!(words, "depth, scene units: near 34.0 (yellow) to far 120.0 (blue)");
        let words = Scale::of_layer(&depth, false).words();
        assert_eq!(words, "depth: near (yellow) to far (blue)");
        let words = Scale::of_layer(&layer(Layer::Motion, (0.0, 12.0)), true).words();
        assert_eq!(words, "path over the recording, pixels: still (blue) to 12 or more (yellow)");
        let words = Scale::of_difference().words();
        assert_eq!(words, "difference, levels of 255: 0 (blue) to 64 or more (yellow)");
    }

    #[test]
    fn colours_are_called_what_they_are() {
        let is_yellow = |colour: egui::Color32| colour.r() > 200 && colour.b() < 100;
        let ends = [0.0, 1.0];
        assert_eq!(ends.map(|share| is_yellow(layer_colour(Layer::Depth, share))), [true, false]);
        assert_eq!(ends.map(|share| is_yellow(layer_colour(Layer::Motion, share))), [false, true]);
        assert_eq!(ends.map(|share| is_yellow(layer_colour(Layer::Opacity, share))), [false, true]);
        assert_eq!(ends.map(|share| is_yellow(difference_colour(share))), [false, true]);
    }
}
