//! Small parts that several panels share. Icons are painted, because no font has all of them.

use crate::viewer::{
    command::{self, Command},
    shared::Shared,
    theme,
};
use egui::{
    Align2, Color32, Painter, Pos2, Rect, Response, Role, Sense, Shape, Stroke, Ui, UiBuilder, Vec2, Widget,
    WidgetInfo, WidgetText, pos2,
    text::{CCursor, CCursorRange},
    text_edit::TextEditState,
    vec2,
};
use std::ops::Range;
use surgtpgs_core::palette::Palette;

/// An icon that is painted on a button.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Icon {
    Play,
    Pause,
    StepBack,
    StepForward,
    HopBack,
    HopForward,
    First,
    Last,
    Loop,
    Eye,
    EyeClosed,
    Cross,
    Flag,
    Pin,
    More,
}

/// Shows a square button of a command; returns `true` if it was clicked. Tooltip and key come from the
/// command table.
pub(crate) fn command_button(ui: &mut Ui, shared: &Shared, icon: Icon, of: Command, is_on: bool) -> bool {
    let label = command::entry(of).label;
    icon_button(ui, icon, label, &shared.tooltip(of), is_on, true).clicked()
}

/// Shows a row with a button at its end that removes it: a `what`, such as a phrase, called `name`. Returns
/// `true` if the button was clicked.
pub(crate) fn removable_row(ui: &mut Ui, name: &str, what: &str, content: impl FnOnce(&mut Ui)) -> bool {
    let row = ui.horizontal(|ui| {
        content(ui);
        let button = ui.with_layout(egui::Layout::right_to_left(egui::Align::Center), |ui| {
            let tip = format!("Remove this {what} (undo brings it back)");
            icon_button(ui, Icon::Cross, &format!("Remove {name}"), &tip, false, true)
        });
        button.inner.clicked()
    });
    row.inner
}

/// Shows a square button with an icon; `label` is its name for users who cannot see it.
pub(crate) fn icon_button(
    ui: &mut Ui,
    icon: Icon,
    label: &str,
    tooltip: &str,
    is_on: bool,
    is_enabled: bool,
) -> Response {
    let sense = if is_enabled { Sense::click() } else { Sense::hover() };
    let (rect, response) = ui.allocate_exact_size(Vec2::splat(theme::CONTROL_HEIGHT), sense);
    response.widget_info(|| WidgetInfo::selected(Role::Button, is_enabled, is_on, label));
    if ui.is_rect_visible(rect) {
        let visuals = ui.style().interact_selectable(&response, is_on);
        let is_raised = is_on || response.hovered() || response.has_focus();
        if is_raised && is_enabled {
            let stroke = if response.has_focus() { visuals.bg_stroke } else { Stroke::NONE };
            ui.painter().rect(
                rect,
                visuals.corner_radius,
                visuals.weak_bg_fill,
                stroke,
                egui::StrokeKind::Inside,
            );
        }
        let colour = if is_enabled { visuals.text_color() } else { theme::LINE };
        paint_icon(ui.painter(), icon, Rect::from_center_size(rect.center(), Vec2::splat(16.0)), colour);
    }
    response.on_hover_text(tooltip)
}

fn paint_icon(painter: &Painter, icon: Icon, r: Rect, colour: Color32) {
    let stroke = Stroke::new(1.8, colour);
    // Maps from the unit square to the icon's.
    let at = |x: f32, y: f32| pos2(r.left() + x * r.width(), r.top() + y * r.height());
    let triangle = |x0: f32, x1: f32| {
        painter.add(Shape::convex_polygon(
            vec![at(x0, 0.12), at(x1, 0.5), at(x0, 0.88)],
            colour,
            Stroke::NONE,
        ));
    };
    let bar = |x: f32, width: f32| {
        painter.rect_filled(Rect::from_min_max(at(x, 0.12), at(x + width, 0.88)), 1.0, colour);
    };
    match icon {
        Icon::Play => triangle(0.15, 0.95),
        Icon::Pause => [0.16, 0.6].into_iter().for_each(|x| bar(x, 0.24)),
        Icon::StepForward => {
            bar(0.18, 0.14);
            triangle(0.42, 0.92);
        }
        Icon::StepBack => {
            bar(0.68, 0.14);
            triangle(0.58, 0.08);
        }
        Icon::HopForward => [0.0, 0.5].into_iter().for_each(|x| triangle(x, x + 0.5)),
        Icon::HopBack => [0.5, 1.0].into_iter().for_each(|x| triangle(x, x - 0.5)),
        Icon::Last => {
            triangle(0.1, 0.75);
            bar(0.76, 0.14);
        }
        Icon::First => {
            bar(0.1, 0.14);
            triangle(0.9, 0.25);
        }
        Icon::Loop => {
            // Two half turns, each ending in an arrow head.
            for (from, side) in [(0.55, 1.0), (0.05, -1.0)] {
                let points = arc(r.center(), r.width() * 0.4, from, from + 0.36);
                let end = points[points.len() - 1];
                painter.add(Shape::line(points, stroke));
                let head = [vec2(0.0, -4.5), vec2(4.5, 0.5), vec2(0.0, 4.0)].map(|d| end + side * d);
                painter.add(Shape::convex_polygon(head.to_vec(), colour, Stroke::NONE));
            }
        }
        Icon::Eye | Icon::EyeClosed => {
            let lid = |bend: f32| -> Vec<Pos2> {
                (0..=12).map(|i| i as f32 / 12.0).map(|x| at(x, 0.5 + bend * (x * (1.0 - x)) * 4.0)).collect()
            };
            painter.add(Shape::line(lid(-0.34), stroke));
            painter.add(Shape::line(lid(0.34), stroke));
            painter.circle_filled(at(0.5, 0.5), r.width() * 0.17, colour);
            if icon == Icon::EyeClosed {
                painter.line_segment([at(0.06, 0.98), at(0.94, 0.02)], Stroke::new(2.2, colour));
            }
        }
        Icon::More => [0.14, 0.5, 0.86].into_iter().for_each(|x| {
            painter.circle_filled(at(x, 0.5), 2.0, colour);
        }),
        Icon::Pin => {
            let mark = vec![
                at(0.2, 0.05),
                at(0.8, 0.05),
                at(0.8, 0.95),
                at(0.5, 0.68),
                at(0.2, 0.95),
                at(0.2, 0.05),
            ];
            painter.add(Shape::line(mark, stroke));
        }
        Icon::Flag => {
            painter.line_segment([at(0.22, 0.05), at(0.22, 0.98)], stroke);
            let cloth = vec![at(0.28, 0.08), at(0.92, 0.3), at(0.28, 0.55)];
            painter.add(Shape::convex_polygon(cloth, colour, Stroke::NONE));
        }
        Icon::Cross => {
            painter.line_segment([at(0.2, 0.2), at(0.8, 0.8)], stroke);
            painter.line_segment([at(0.8, 0.2), at(0.2, 0.8)], stroke);
        }
    }
}

/// Returns the points of an arc of a circle, clockwise from the top; `from` and `to` in turns.
fn arc(centre: Pos2, radius: f32, from: f32, to: f32) -> Vec<Pos2> {
    let at = |turn: f32| centre + radius * Vec2::angled((turn - 0.25) * std::f32::consts::TAU);
    (0..=20).map(|i| at(from + (to - from) * i as f32 / 20.0)).collect()
}

/// Adds a widget that is grey while there is an obstacle. Its tooltip says what it is for, or what is in its
/// way.
pub(crate) fn add_unless(
    ui: &mut Ui,
    obstacle: Option<&str>,
    widget: impl Widget,
    tooltip: impl Into<WidgetText>,
) -> Response {
    let response = ui.add_enabled(obstacle.is_none(), widget);
    let Some(obstacle) = obstacle else { return response.on_hover_text(tooltip) };
    response.ctx.accesskit_node_builder(response.id, |node| node.set_description(obstacle));
    response.on_disabled_hover_text(obstacle)
}

/// Shows several options side by side to choose one of: (value, label, tooltip, enabled). They are wrapped
/// where there is no room. The tooltip of one that is not enabled says why.
pub(crate) fn choice<T: Copy + PartialEq>(ui: &mut Ui, value: &mut T, options: &[(T, &str, String, bool)]) {
    ui.scope(|ui| {
        ui.spacing_mut().item_spacing = vec2(2.0, 2.0);
        ui.horizontal_wrapped(|ui| {
            for (option, label, tooltip, is_enabled) in options {
                let button = egui::Button::selectable(*value == *option, *label);
                let button = button.min_size(vec2(0.0, theme::CONTROL_HEIGHT)).frame_when_inactive(true);
                let response = ui.add_enabled(*is_enabled, button).on_hover_text(tooltip);
                if response.on_disabled_hover_text(tooltip).clicked() {
                    *value = *option;
                }
            }
        });
    });
}

/// Shows a small button that stands for a colour; `name` is for users who cannot see it.
pub(crate) fn colour_button(ui: &mut Ui, colour: Color32, is_own: bool, name: &str) -> Response {
    let (rect, response) = ui.allocate_exact_size(vec2(26.0, 26.0), Sense::click());
    response.widget_info(|| WidgetInfo::selected(Role::RadioButton, true, is_own, name));
    ui.painter().rect_filled(rect.shrink(3.0), 4.0, colour);
    if is_own || response.hovered() {
        let stroke = Stroke::new(2.0, if is_own { theme::TEXT } else { theme::LINE_HOVER });
        ui.painter().rect_stroke(rect, 5.0, stroke, egui::StrokeKind::Inside);
    }
    focus_ring(ui.painter(), rect, &response);
    response
}

/// Shows the choice of the colours of a heatmap.
pub(crate) fn palette_ui(ui: &mut Ui, palette: &mut Palette) {
    let options = Palette::ALL.map(|p| (p, p.label(), "From dark to bright with the score".to_owned(), true));
    choice(ui, palette, &options);
}

/// Space around the contents of a dialog, points.
const FRAME: f32 = 18.0;

/// Room for a scroll bar beside what it scrolls, points.
pub(crate) const SCROLL_BAR: f32 = 12.0;
/// Least height of what is scrolled in a dialog, points.
const LEAST_SCROLLED: f32 = 60.0;

/// Makes scroll bars seen wherever there is more to see, not only below the pointer.
pub(crate) fn show_scroll_bars(ui: &mut Ui) {
    let style = &mut ui.spacing_mut().scroll;
    style.floating_width = 6.0;
    style.dormant_background_opacity = style.active_background_opacity;
    style.dormant_handle_opacity = style.active_handle_opacity;
}

/// Shows a dialog over the window, which can be scrolled where the window is small. The window is dimmed and
/// does not react meanwhile. Returns the result of `content`, and `true` if Esc or a click beside the dialog
/// closes it.
pub(crate) fn dialog<T>(
    ctx: &egui::Context,
    name: &'static str,
    width: f32,
    content: impl FnOnce(&mut Ui) -> T,
) -> (T, bool) {
    dialog_with_footer(ctx, name, width, content, |_, result| result)
}

/// Shows a dialog as [`dialog`] does. Its `footer` stays in sight below what is scrolled. It gets the result
/// of `content`; its own one is returned.
pub(crate) fn dialog_with_footer<T, U>(
    ctx: &egui::Context,
    name: &'static str,
    width: f32,
    content: impl FnOnce(&mut Ui) -> T,
    footer: impl FnOnce(&mut Ui, T) -> U,
) -> (U, bool) {
    let frame = egui::Frame::new()
        .fill(theme::RAISED)
        .stroke(Stroke::new(1.0, theme::LINE))
        .corner_radius(10)
        .inner_margin(FRAME);
    let modal =
        egui::Modal::new(egui::Id::unique(name)).frame(frame).backdrop_color(Color32::from_black_alpha(150));
    let room = ctx.content_rect().size() - vec2(2.0 * FRAME + 16.0, 2.0 * FRAME + 16.0);
    let (long_id, footer_id) = (egui::Id::unique((name, "is long")), egui::Id::unique((name, "footer")));
    let scrolled_height = |below: f32| (room.y - below).max(LEAST_SCROLLED);
    let modal = modal.show(ctx, |ui| {
        ui.set_width(width.min(room.x));
        let mut inner = ui.new_child(UiBuilder::new().max_rect(ui.available_rect_before_wrap()));
        let height = scrolled_height(ui.data(|d| d.get_temp::<f32>(footer_id).unwrap_or(0.0)));
        let area = egui::ScrollArea::vertical().max_height(height).auto_shrink([false, true]);
        // As high as it gets from the start: it must not grow under the pointer.
        let area = area.min_scrolled_height(height);
        let usual_bars = ui.spacing().scroll;
        show_scroll_bars(&mut inner);
        let shown = area.show(&mut inner, |ui| {
            ui.spacing_mut().scroll = usual_bars;
            // The scroll bar covers nothing.
            let is_long = ui.data(|d| d.get_temp::<bool>(long_id).unwrap_or(false));
            ui.set_width(ui.available_width() - if is_long { SCROLL_BAR } else { 0.0 });
            content(ui)
        });
        let scrolled = inner.min_rect();
        let result = footer(&mut inner, shown.inner);
        let below = inner.min_rect().bottom() - scrolled.bottom();
        // What is scrolled makes room for the footer, also where its height was not known yet.
        let height = scrolled_height(below);
        let size = vec2(inner.min_rect().width(), scrolled.height().min(height) + below);
        ui.advance_cursor_after_rect(Rect::from_min_size(scrolled.min, size));
        ui.data_mut(|d| {
            d.insert_temp(long_id, shown.content_size.y > height);
            d.insert_temp(footer_id, below);
        });
        result
    });
    let is_closed = modal.should_close();
    (modal.inner, is_closed)
}

/// Shows a small panel over the picture.
pub(crate) fn card(
    ctx: &egui::Context,
    name: &'static str,
    within: Rect,
    anchor: Align2,
    content: impl FnOnce(&mut Ui),
) {
    const WIDTH: f32 = 300.0;
    let room = (within.size() - vec2(50.0, 50.0)).max(vec2(60.0, 40.0));
    let at = anchor.pos_in_rect(&within.shrink(12.0));
    let frame = egui::Frame::new()
        .fill(theme::RAISED)
        .stroke(Stroke::new(1.0, theme::LINE))
        .corner_radius(8)
        .inner_margin(12);
    egui::Area::new(egui::Id::unique(name)).pivot(anchor).fixed_pos(at).show(ctx, |ui| {
        frame.show(ui, |ui| {
            ui.set_width(WIDTH.min(room.x));
            let area = egui::ScrollArea::vertical().max_height(room.y).min_scrolled_height(room.y);
            area.auto_shrink([false, true]).show(ui, content);
        });
    });
}

/// Paints a border around a widget that has the focus.
pub(crate) fn focus_ring(painter: &Painter, rect: Rect, response: &Response) {
    if response.has_focus() {
        painter.rect_stroke(rect, 4.0, Stroke::new(1.5, theme::ACCENT), egui::StrokeKind::Outside);
    }
}

/// Makes a dialog's main button.
pub(crate) fn main_button(text: &str) -> egui::Button<'_> {
    egui::Button::new(text).fill(theme::SELECTION).min_size(vec2(0.0, 36.0))
}

/// Shows a field to type a path into, as wide as there is room.
pub(crate) fn path_field(ui: &mut Ui, label: &str, path: &mut std::path::PathBuf) {
    let mut typed = path.display().to_string();
    // An id of its own: the field keeps the focus when a message appears above it.
    let field = egui::TextEdit::singleline(&mut typed).id(egui::Id::unique(("path field", label)));
    let field = ui.add(field.desired_width(f32::INFINITY));
    field.ctx.accesskit_node_builder(field.id, |node| node.set_label(label));
    if field.changed() {
        *path = typed.into();
    }
}

/// Gives a text field the focus, with some of its letters selected. It begins anew: undoing in it brings
/// back no text that it held for something else.
pub(crate) fn focus_selecting(field: &Response, letters: Range<usize>) {
    let mut state = TextEditState::default();
    let range = CCursorRange::two(CCursor::new(letters.start), CCursor::new(letters.end));
    state.cursor.set_char_range(Some(range));
    state.store(&field.ctx, field.id);
    field.request_focus();
}

/// Makes less important text.
pub(crate) fn caption(text: impl Into<String>) -> egui::RichText {
    egui::RichText::new(text).font(theme::small()).color(theme::TEXT_WEAK)
}

/// Paints text on a dark plate below a place, readable on any picture; returns the plate.
pub(crate) fn plate(painter: &Painter, at: Pos2, text: &str) -> Rect {
    let galley = painter.layout_no_wrap(text.to_owned(), egui::FontId::proportional(14.5), theme::TEXT);
    let rect = Align2::CENTER_TOP.anchor_size(at, galley.size() + vec2(16.0, 9.0));
    painter.rect_filled(rect, 5.0, theme::PLATE);
    painter.galley(rect.min + vec2(8.0, 4.5), galley, theme::TEXT);
    rect
}

/// Paints a prompt's colour with its number.
pub(crate) fn swatch(painter: &Painter, rect: Rect, colour: [u8; 3], number: &str) {
    painter.rect_filled(rect, 4.0, theme::colour32(colour));
    painter.text(
        rect.center(),
        Align2::CENTER_CENTER,
        number,
        egui::FontId::proportional((0.72 * rect.height()).min(13.0)),
        Color32::BLACK,
    );
}
