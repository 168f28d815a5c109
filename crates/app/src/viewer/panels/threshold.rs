//! The threshold slider of a prompt, under the distribution of its scores.

use crate::viewer::{panels::widgets::focus_ring, picture::found::Found, theme};
use egui::{Align2, Color32, Key, Rect, Role, Sense, Stroke, Ui, WidgetInfo, pos2, vec2};
use surgtpgs_core::summary::SCORE_BINS;

/// Score at which a pixel is as likely what the prompt means as something else.
pub(crate) const TIE: f32 = 0.5;

const HEIGHT: f32 = 52.0;
const CAPTION: f32 = 17.0;

/// Shows and changes a threshold; returns `true` when a change ends (mouse released, or key pressed).
pub(crate) fn threshold_ui(
    ui: &mut Ui,
    name: &str,
    threshold: &mut f32,
    colour: [u8; 3],
    found: Option<&Found>,
) -> bool {
    let size = vec2(ui.available_width(), HEIGHT + CAPTION);
    let (rect, response) = ui.allocate_exact_size(size, Sense::click_and_drag());
    let plot = Rect::from_min_max(rect.min + vec2(4.0, 0.0), rect.max - vec2(4.0, CAPTION));
    if let Some(pointer) = response.interact_pointer_pos() {
        let at = ((pointer.x - plot.left()) / plot.width().max(1.0)).clamp(0.0, 1.0);
        *threshold = (at * 100.0).round() / 100.0;
    }
    let by_key = response
        .has_focus()
        .then(|| ui.input(|i| i.num_presses(Key::ArrowRight) as f32 - i.num_presses(Key::ArrowLeft) as f32));
    if let Some(steps) = by_key.filter(|s| *s != 0.0) {
        *threshold = ((*threshold * 100.0 + steps).round() / 100.0).clamp(0.0, 1.0);
    }
    response.widget_info(|| {
        let mut info = WidgetInfo::slider(true, f64::from(*threshold), format!("Threshold of {name}"));
        info.role = Role::Slider;
        info
    });
    paint(ui, plot, *threshold, colour, found, response.hovered() || response.dragged());
    focus_ring(ui.painter(), plot, &response);
    let is_over = response.drag_stopped() || response.clicked() || by_key.is_some_and(|s| s != 0.0);
    response.on_hover_text(
        "How many pixels of this frame have which similarity score (tall bars are compressed).\n\
         Pixels to the right of the line count as found: drag it to find more or less.\n\
         0.5: as likely as not what these words mean.",
    );
    is_over
}

fn paint(ui: &Ui, plot: Rect, threshold: f32, colour: [u8; 3], found: Option<&Found>, is_hot: bool) {
    let painter = ui.painter();
    painter.rect_filled(plot, 3.0, theme::BACKDROP);
    let x = |score: f32| plot.left() + plot.width() * score;
    if let Some(found) = found {
        let log = |n: u32| (n as f32).ln_1p();
        let top = found.histogram.iter().copied().map(log).fold(1.0, f32::max);
        for (i, &n) in found.histogram.iter().enumerate().filter(|(_, n)| **n > 0) {
            let (from, to) = (i as f32 / SCORE_BINS as f32, (i + 1) as f32 / SCORE_BINS as f32);
            let height = (log(n) / top * (plot.height() - 4.0)).max(1.5);
            let bar = Rect::from_min_max(
                pos2(x(from) + 0.5, plot.bottom() - height),
                pos2(x(to) - 0.5, plot.bottom()),
            );
            let is_found = (from + to) / 2.0 > threshold;
            let fill = if is_found { theme::colour32(colour) } else { theme::TEXT_WEAK.gamma_multiply(0.45) };
            painter.rect_filled(bar, 0.0, fill);
        }
    }
    let caption_y = plot.bottom() + 3.0;
    let dash = egui::Shape::dashed_line(
        &[pos2(x(TIE), plot.top()), pos2(x(TIE), plot.bottom() + 3.0)],
        Stroke::new(1.0, theme::TEXT_WEAK),
        3.0,
        3.0,
    );
    painter.extend(dash);
    painter.text(
        pos2(x(TIE), caption_y),
        Align2::CENTER_TOP,
        "0.5: as likely as not",
        egui::FontId::proportional(12.5),
        theme::TEXT_WEAK,
    );
    let stroke = Stroke::new(if is_hot { 3.0 } else { 2.0 }, Color32::WHITE);
    painter.vline(x(threshold), plot.y_range(), stroke);
    painter.circle_filled(
        pos2(x(threshold), plot.top() + 4.0),
        if is_hot { 6.0 } else { 5.0 },
        Color32::WHITE,
    );
}
