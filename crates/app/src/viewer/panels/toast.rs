//! The message about what has just happened, with a button that takes it back.

use crate::viewer::{
    action::Action,
    command::{Command, entry},
    panels::{
        plates::Plates,
        widgets::{Icon, icon_button},
    },
    shared::Shared,
    state::toast::{Back, Toast},
    theme,
};
use egui::{Align2, Area, Frame, Id, Margin, Rect, RichText, Role, Stroke, Ui, WidgetInfo, vec2};

/// Shows the message over the lower middle of the picture or of the start page, if there is one.
pub(crate) fn toast_ui(
    ui: &mut Ui,
    shared: &Shared,
    actions: &mut Vec<Action>,
    plates: &mut Plates,
    within: Rect,
) {
    let Some(toast) = &shared.toast else { return };
    let id = Id::unique("toast");
    // The size is known from the pass before.
    let size = ui.ctx().memory(|m| m.area_rect(id)).map_or(vec2(300.0, 48.0), |rect| rect.size());
    let place = plates.place(within, Align2::CENTER_BOTTOM, size);
    let centre = place.map_or_else(|| within.center_bottom() - vec2(0.0, 8.0), |rect| rect.center_bottom());
    let frame = Frame::new()
        .fill(theme::SELECTION)
        .stroke(Stroke::new(1.0, theme::ACCENT))
        .corner_radius(8)
        .inner_margin(Margin::symmetric(12, 6));
    let area = Area::new(id).pivot(Align2::CENTER_BOTTOM).fixed_pos(centre).order(egui::Order::Middle);
    area.show(ui.ctx(), |ui| {
        frame.show(ui, |ui| {
            ui.set_max_width((within.width() - 60.0).max(120.0));
            ui.horizontal(|ui| contents_ui(ui, toast, actions));
        });
    });
}

fn contents_ui(ui: &mut Ui, toast: &Toast, actions: &mut Vec<Action>) {
    let text = ui.add(egui::Label::new(RichText::new(&toast.text).color(theme::TEXT)).truncate());
    text.widget_info(|| WidgetInfo::labeled(Role::Status, true, &toast.text));
    if let Some(back) = toast.back {
        let (label, command) = match back {
            Back::Undo => (entry(Command::Undo).label, Command::Undo),
            Back::ShowOverlays => ("Show again", Command::HideOverlays),
        };
        if ui.button(label).clicked() {
            actions.push(Action::Run(command));
        }
    }
    if icon_button(ui, Icon::Cross, "Close this message", "Close this message", false, true).clicked() {
        actions.push(Action::CloseToast);
    }
}
