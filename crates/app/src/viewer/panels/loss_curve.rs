//! The loss during training, and its terms, as a curve.

use crate::viewer::{panels::widgets::caption, state::loss_curve::LossCurve, theme};
use egui::{Color32, RichText, Ui, WidgetInfo};
use egui_plot::{Line, Plot, PlotPoints};
use surgtpgs_core::train::LossTerms;

const HEIGHT: f32 = 110.0;
/// Smallest value of the logarithmic scale; smaller values are drawn as this one.
const SMALLEST: f64 = 1e-6;

/// A term of the loss: its name, its colour, and its value.
type Term = (&'static str, Color32, fn(&LossTerms<f32>) -> f32);

static TERMS: [Term; 5] = [
    ("total", theme::TEXT, LossTerms::total),
    ("colour", Color32::from_rgb(0x3d, 0xd6, 0xff), |t| t.colour),
    ("depth", Color32::from_rgb(0xf6, 0xe0, 0x4e), |t| t.depth),
    ("words", Color32::from_rgb(0xff, 0x7a, 0xe0), |t| t.features + t.region),
    ("smoothness", Color32::from_rgb(0x62, 0xe8, 0x8a), |t| t.total_variation),
];

fn short(value: f32) -> String {
    if value < 0.001 { format!("{value:.0e}") } else { format!("{value:.3}") }
}

/// Shows the curve with its legend.
pub(crate) fn loss_curve_ui(ui: &mut Ui, curve: &LossCurve) {
    let Some(last) = curve.last().copied() else { return };
    let height = |value: f32| f64::from(value).max(SMALLEST).log10();
    let shown = TERMS.iter().filter(|(.., of)| curve.points.iter().any(|(_, t)| f64::from(of(t)) > SMALLEST));
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
        .clone()
        .map(|(name, colour, of)| {
            let points: PlotPoints<'_> =
                curve.points.iter().map(|(step, t)| [*step as f64, height(of(t))]).collect();
            Line::new(*name, points).color(*colour).width(if *name == "total" { 2.0 } else { 1.2 })
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
        for (name, colour, of) in shown {
            ui.label(RichText::new(*name).font(theme::small()).color(*colour));
            ui.label(caption(short(of(&last))));
        }
    });
}

/// Describes the loss in words, for users who cannot see the curve.
fn describe(curve: &LossCurve) -> String {
    let Some(last) = curve.last() else { return "Loss: nothing yet".into() };
    let terms = TERMS.iter().map(|(name, _, of)| (name, of(last))).filter(|(_, value)| *value > 0.0);
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
