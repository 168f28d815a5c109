//! The window before anything is open.

use crate::viewer::{
    action::Action,
    command::{Command, entry},
    panels::widgets::caption,
    shared::Shared,
    theme,
};
use egui::{RichText, Ui, vec2};

/// Shows the empty window, with ways to begin.
pub(crate) fn start_ui(ui: &mut Ui, shared: &Shared, actions: &mut Vec<Action>) {
    let height = ui.available_height();
    ui.vertical_centered(|ui| {
        ui.add_space((height * 0.28).max(20.0));
        if let Some(waiting) = shared.opening.waiting_for() {
            ui.spinner();
            ui.label(waiting);
            return;
        }
        ui.label(RichText::new("SurgTPGS").size(34.0));
        ui.label(
            RichText::new("Find anatomy and instruments in a recorded operation, by words")
                .color(theme::TEXT_WEAK),
        );
        ui.add_space(24.0);
        for command in [Command::OpenFile, Command::OpenFolder] {
            let button =
                egui::Button::new(RichText::new(entry(command).label).size(17.0)).min_size(vec2(260.0, 44.0));
            let response =
                ui.add_enabled(shared.is_enabled(command), button).on_hover_text(shared.tooltip(command));
            if response.clicked() {
                actions.push(Action::Run(command));
            }
            ui.label(caption(entry(command).tooltip));
            ui.add_space(10.0);
        }
        ui.label(RichText::new("or drop one here").color(theme::TEXT_WEAK));
    });
}
