//! The ruler: a line drawn over the picture, its length, and the scale that converts it to millimetres.

use crate::viewer::{
    action::Action,
    backend::Info,
    command::Command,
    panels::{
        plates::Plates,
        widgets::{caption, card, plate},
    },
    shared::Shared,
    state::{
        measure::{Measurement, NoLength, Scale, measure},
        zoom::Panes,
    },
    theme,
};
use egui::{Align2, Painter, Response, RichText, Stroke, TextEdit, Ui, pos2, vec2};

/// Name of the card.
pub(crate) const CARD: &str = "ruler";

/// The ruler.
#[derive(Clone, Debug, Default)]
pub(crate) struct Ruler {
    /// Both ends, as shares of the picture's width and height.
    line: Option<[[f32; 2]; 2]>,
    /// Known length being typed.
    known: String,
    /// Known scale being typed.
    px_per_mm: String,
}

impl Ruler {
    /// Draws the line while the mouse is dragged; returns `true` if the ruler has the mouse.
    pub(crate) fn drag(&mut self, shared: &Shared, panes: &Panes, response: &Response) -> bool {
        let position = |at: Option<egui::Pos2>| at.and_then(|at| panes.picture_position(at));
        let to = position(response.interact_pointer_pos()).filter(|_| response.dragged());
        let from = position(response.ctx.input(|i| i.pointer.press_origin()));
        if let (Some(from), Some(to), true) = (from, to, shared.viewport.has_ruler) {
            self.line = Some([from, to]);
        }
        shared.viewport.has_ruler
    }

    /// Paints the line and its length on every pane, while the ruler is in use. Texts that are placed later
    /// make way for the length.
    pub(crate) fn paint(&self, ui: &Ui, shared: &Shared, panes: &Panes, plates: &mut Plates) {
        let Some(line) = self.line.filter(|_| shared.viewport.has_ruler) else { return };
        let Some(measured) = measured(shared, line) else { return };
        let text = measured.text(shared.document.content().scale.as_ref());
        let [a, b] = line;
        for ((pane, a), (_, b)) in panes.screen_positions(a).zip(panes.screen_positions(b)) {
            let painter = ui.painter().with_clip_rect(pane);
            paint_line(&painter, a, b);
            // Below the line, so that it hides no end.
            let at = pos2(a.x.midpoint(b.x), a.y.max(b.y) + 12.0);
            plates.take(plate(&painter, at, &text));
        }
    }

    /// Shows the card with the length, while the ruler is in use.
    pub(crate) fn ui(&mut self, ui: &Ui, shared: &Shared, actions: &mut Vec<Action>, area: egui::Rect) {
        if !shared.viewport.has_ruler {
            *self = Self::default();
            return;
        }
        let measured = self.line.and_then(|line| measured(shared, line));
        card(ui.ctx(), CARD, area, Align2::RIGHT_BOTTOM, |ui| {
            self.card_ui(ui, shared, actions, measured);
        });
    }

    fn card_ui(
        &mut self,
        ui: &mut Ui,
        shared: &Shared,
        actions: &mut Vec<Action>,
        measured: Option<Measurement>,
    ) {
        ui.horizontal(|ui| {
            ui.label(RichText::new("Ruler").strong());
            ui.with_layout(egui::Layout::right_to_left(egui::Align::Center), |ui| {
                if ui.button("Put away").on_hover_text(shared.tooltip(Command::Measure)).clicked() {
                    actions.push(Action::Run(Command::Measure));
                }
            });
        });
        let Some(measured) = measured else {
            ui.label(caption("Drag on the picture from one point to another."));
            return;
        };
        let frame = shared.picture().map_or(0, |p| p.request.view.frame);
        let text = measured.text(shared.document.content().scale.as_ref());
        ui.label(format!("{text}  ·  frame {}", frame + 1));
        let is_guessed = shared.info().is_some_and(Info::shape_is_guessed);
        let warning = match measured.in_space {
            Err(NoLength::NoSurface) => Some("Nothing was reconstructed at one end."),
            Err(NoLength::NoDepth) if is_guessed => Some("Pixels only: the shape is guessed."),
            Err(NoLength::NoDepth) => Some("Pixels only: this view has no measured depth."),
            Ok(length) if length.is_at_edge => {
                Some("Depth jumps at one end: it may belong to what lies behind.")
            }
            Ok(_) => None,
        };
        if let Some(warning) = warning {
            ui.label(RichText::new(warning).font(theme::small()).color(theme::AMBER));
        }
        match shared.document.content().scale.clone() {
            Some(scale) => scale_ui(ui, actions, &scale),
            None => self.calibrate_ui(ui, actions, measured, frame),
        }
    }

    /// Asks for a known length or a known scale, which millimetres need.
    fn calibrate_ui(&mut self, ui: &mut Ui, actions: &mut Vec<Action>, measured: Measurement, frame: usize) {
        ui.label(caption("Without a scale there are no real lengths. If you know one, enter it:"));
        let mut scale = None;
        if let Ok(length) = measured.in_space {
            let wanted = |mm| Scale::from_known(length, mm, frame);
            let texts = ["Known length in millimetres", "millimetres is this line", "Set the scale"];
            scale = number_ui(ui, &mut self.known, texts, wanted);
        }
        let texts = ["Pixels in a millimetre", "pixels in a millimetre", "Set"];
        scale = scale.or(number_ui(ui, &mut self.px_per_mm, texts, Scale::from_px_per_mm));
        if scale.is_some() {
            actions.push(Action::edit(move |d| d.set_scale(scale)));
        }
    }
}

/// Returns the length of a line on the shown frame.
fn measured(shared: &Shared, line: [[f32; 2]; 2]) -> Option<Measurement> {
    let (info, picture) = (shared.info()?, shared.picture()?);
    // Nobody measured the depth of turned views, nor that of guessed shapes: lengths are in pixels only.
    let is_recorded = picture.request.view.orbit.is_home();
    let depth = picture.depth_values.as_deref().filter(|_| is_recorded && info.has_measured_depth);
    Some(measure(line, (info.width, info.height), depth, info.lens))
}

fn paint_line(painter: &Painter, a: egui::Pos2, b: egui::Pos2) {
    for stroke in [Stroke::new(5.0, theme::PLATE), Stroke::new(2.0, theme::TEXT)] {
        painter.line_segment([a, b], stroke);
        for end in [a, b] {
            painter.circle_stroke(end, 5.0, stroke);
        }
    }
}

fn scale_ui(ui: &mut Ui, actions: &mut Vec<Action>, scale: &Scale) {
    ui.label(caption(format!("Scale from {}", scale.source)));
    if scale.px_per_mm.is_some() {
        let text = "This holds where everything lies as far away as what it was measured at: what is nearer is shorter \
                    than it says, what is farther is longer.";
        ui.label(RichText::new(text).font(theme::small()).color(theme::AMBER));
    }
    if ui.button("Remove the scale").clicked() {
        actions.push(Action::edit(move |d| d.set_scale(None)));
    }
}

/// Shows a field for a number; returns its scale when the button is pressed.
fn number_ui(
    ui: &mut Ui,
    typed: &mut String,
    [name, unit, verb]: [&str; 3],
    scale: impl Fn(f64) -> Option<Scale>,
) -> Option<Scale> {
    let row = ui.horizontal_wrapped(|ui| {
        let field = ui.add(TextEdit::singleline(typed).desired_width(60.0));
        field.ctx.accesskit_node_builder(field.id, |node| node.set_label(name));
        ui.label(caption(unit));
        let number = typed.trim().replace(',', ".").parse().ok();
        let wanted = number.and_then(scale);
        let is_set = ui.add_enabled(wanted.is_some(), egui::Button::new(verb)).clicked();
        wanted.filter(|_| is_set)
    });
    row.inner
}

/// Paints a cross at a position on the screen.
pub(crate) fn paint_cross(painter: &Painter, at: egui::Pos2) {
    for stroke in [Stroke::new(4.0, theme::PLATE), Stroke::new(1.6, theme::TEXT)] {
        for (dx, dy) in [(1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0)] {
            let from = pos2(at.x + 5.0 * dx, at.y + 5.0 * dy);
            painter.line_segment([from, from + 9.0 * vec2(dx, dy)], stroke);
        }
    }
}
