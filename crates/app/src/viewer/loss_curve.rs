//! The loss during training, and its terms.

use super::{theme, widgets::caption};
use egui::{Color32, RichText, Ui, WidgetInfo};
use egui_plot::{Line, Plot, PlotPoints};
use surgtpgs_core::train::LossTerms;

/// Number of points that are kept; a curve of this size cannot show more.
const MAX_POINTS: usize = 240;
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

/// The loss over the steps so far, as means of equally many steps.
#[derive(Debug)]
pub(crate) struct LossCurve {
    /// Means, each with its last step.
    points: Vec<(usize, LossTerms<f32>)>,
    /// Number of steps in a mean.
    every: usize,
    /// The unfinished mean: the number of its steps so far, and their sum.
    open: (usize, LossTerms<f32>),
}

impl Default for LossCurve {
    fn default() -> Self {
        Self { points: Vec::new(), every: 1, open: Default::default() }
    }
}

impl LossCurve {
    /// Adds a step. A step whose loss is not finite is left out, because nothing was learned from it.
    pub(crate) fn push(&mut self, step: usize, terms: LossTerms<f32>) {
        if !terms.total().is_finite() {
            return;
        }
        self.open = (self.open.0 + 1, combined(self.open.1, terms, 1.0));
        if self.open.0 < self.every {
            return;
        }
        let (count, sum) = std::mem::take(&mut self.open);
        self.points.push((step, combined(LossTerms::default(), sum, 1.0 / count as f32)));
        if self.points.len() >= MAX_POINTS {
            let pairs = self.points.chunks_exact(2);
            self.points = pairs.map(|p| (p[1].0, combined(scaled(p[0].1, 0.5), p[1].1, 0.5))).collect();
            self.every *= 2;
        }
    }

    /// Returns the latest mean.
    fn last(&self) -> Option<&LossTerms<f32>> {
        self.points.last().map(|(_, terms)| terms)
    }

    /// Describes the loss in words, for users who cannot see the curve.
    fn describe(&self) -> String {
        let Some(last) = self.last() else { return "Loss: nothing yet".into() };
        let terms = curves(last).filter(|(_, value)| *value > 0.0);
        let terms: Vec<String> = terms.map(|(name, value)| format!("{name} {}", short(value))).collect();
        format!("Loss over the steps, now {}", terms.join(", "))
    }
}

fn scaled(terms: LossTerms<f32>, by: f32) -> LossTerms<f32> {
    combined(LossTerms::default(), terms, by)
}

/// Computes a + share · b, term by term.
fn combined(a: LossTerms<f32>, b: LossTerms<f32>, share: f32) -> LossTerms<f32> {
    let (a, b) = (a.values(), b.values());
    LossTerms::of(std::array::from_fn(|k| a[k] + share * b[k]))
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
    response.widget_info(|| WidgetInfo::labeled(egui::Role::GraphicsDocument, true, curve.describe()));
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

#[cfg(test)]
mod tests {
    use super::*;

    fn terms(colour: f32) -> LossTerms<f32> {
        LossTerms { colour, depth: 2.0 * colour, ..Default::default() }
    }

    #[test]
    fn a_long_training_is_thinned_to_means() {
        let mut curve = LossCurve::default();
        (1..=5000).for_each(|step| curve.push(step, terms(step as f32)));
        assert!(curve.points.len() < MAX_POINTS && curve.points.len() > MAX_POINTS / 4);
        let (step, mean) = curve.points[0];
        assert!((mean.colour - (1 + step) as f32 / 2.0).abs() < 1e-3, "{step} {mean:?}");
        assert!((mean.depth - 2.0 * mean.colour).abs() < 1e-3);
        assert!(curve.points.windows(2).all(|p| p[1].0 - p[0].0 == curve.every));
    }

    #[test]
    fn what_is_not_finite_is_left_out() {
        let mut curve = LossCurve::default();
        curve.push(1, terms(f32::NAN));
        assert!(curve.last().is_none() && curve.describe().contains("nothing yet"));
        curve.push(2, terms(0.5));
        assert_eq!(curve.last().map(LossTerms::total), Some(1.5));
    }
}
