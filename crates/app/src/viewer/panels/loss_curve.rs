//! The loss during training, and its terms, as a curve.

use crate::viewer::{panels::widgets::caption, state::loss_curve::LossCurve, theme};
use egui::{Color32, RichText, Ui, WidgetInfo};
use egui_plot::{Line, Plot, PlotPoints};
use surgtpgs_core::train::LossTerms;

const HEIGHT: f32 = 110.0;
/// Smallest value of the logarithmic scale; smaller values are drawn as this one.
const SMALLEST: f64 = 1e-6;

/// Colours of the total and of the terms.
const COLOURS: [Color32; 7] = [
    theme::TEXT,
    Color32::from_rgb(0x3d, 0xd6, 0xff),
    Color32::from_rgb(0xf6, 0xe0, 0x4e),
    Color32::from_rgb(0xff, 0x7a, 0xe0),
    Color32::from_rgb(0x62, 0xe8, 0x8a),
    Color32::from_rgb(0xff, 0xa0, 0x5c),
    Color32::from_rgb(0xb0, 0x9c, 0xff),
];

/// Returns the names and values of the curves: the total, then the terms.
fn curves(terms: &LossTerms<f32>) -> impl Iterator<Item = (&'static str, f32)> {
    std::iter::once(("total", terms.total())).chain(terms.named())
}

fn short(value: f32) -> String {
    if value < 0.001 { format!("{value:.0e}") } else { format!("{value:.3}") }
}

/// Shows the curve with its legend.
pub(crate) fn loss_curve_ui(ui: &mut Ui, curve: &LossCurve) {
    let Some(last) = curve.last().copied() else { return };
    let colour = |k: usize| COLOURS[k % COLOURS.len()];
    let height = |value: f32| f64::from(value).max(SMALLEST).log10();
    // Number, name and last value of each curve that is not 0 all along.
    let value = |k: usize, terms: &LossTerms<f32>| curves(terms).nth(k).map_or(0.0, |(_, value)| value);
    let shown = curves(&last).enumerate().map(|(k, (name, value))| (k, name, value));
    let shown = shown.filter(|(k, ..)| curve.points.iter().any(|(_, t)| f64::from(value(*k, t)) > SMALLEST));
    let shown: Vec<(usize, &str, f32)> = shown.collect();
    let plot = Plot::new("loss")
        .height(HEIGHT)
        .allow_drag(false)
        .allow_zoom(false)
        .allow_scroll(false)
        .allow_boxed_zoom(false)
        .show_axes([false, true])
        .y_axis_formatter(|mark, _| format!("{:.0e}", 10f64.powf(mark.value)))
        .label_formatter(|_| None);
    let lines: Vec<Line<'_>> = shown
        .iter()
        .map(|&(k, name, _)| {
            let points: PlotPoints<'_> =
                curve.points.iter().map(|(step, t)| [*step as f64, height(value(k, t))]).collect();
            Line::new(name, points).color(colour(k)).width(if k == 0 { 2.0 } else { 1.2 })
        })
        .collect();
    let response = plot.show(ui, |plot| lines.into_iter().for_each(|line| plot.line(line))).response;
    response.widget_info(|| WidgetInfo::labeled(egui::Role::GraphicsDocument, true, describe(curve)));
    response.on_hover_text(
        "The loss over the steps, on a logarithmic scale: how much pictures, depth and features still differ from the \
         recording. It may wobble; it should fall.",
    );
    ui.horizontal_wrapped(|ui| {
        ui.spacing_mut().item_spacing.x = 10.0;
        for (k, name, last) in shown {
            ui.label(RichText::new(name).font(theme::small()).color(colour(k)));
            ui.label(caption(short(last)));
        }
    });
}

/// Describes the loss in words, for users who cannot see the curve.
fn describe(curve: &LossCurve) -> String {
    let Some(last) = curve.last() else { return "Loss: nothing yet".into() };
    let terms = curves(last).filter(|(_, value)| *value > 0.0);
    let terms: Vec<String> = terms.map(|(name, value)| format!("{name} {}", short(value))).collect();
    format!("Loss over the steps, now {}", terms.join(", "))
}
#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_latest_terms_are_named() {
        let mut curve = LossCurve::default();
        curve.push(1, LossTerms { colour: f32::NAN, ..Default::default() });
        assert!(describe(&curve).contains("nothing yet"));
        curve.push(2, LossTerms { colour: 0.5, depth: 1.0, ..Default::default() });
        assert_eq!(describe(&curve), "Loss over the steps, now total 1.500, colour 0.500, depth 1.000");
    }
}
