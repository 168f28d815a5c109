//! The start page: ways to begin, what was opened last, work that is running, and work that was left unsaved.

use crate::viewer::{
    action::Action,
    command::{Command, entry},
    panels::{
        exporting::exporting_ui,
        recovery::left_ui,
        training::training_ui,
        widgets::{add_unless, caption},
    },
    shared::Shared,
    theme,
};
use egui::{Button, Frame, Margin, RichText, ScrollArea, Ui, vec2};

/// Width of the page's column.
const WIDTH: f32 = 520.0;

/// Shows the start page.
pub(crate) fn start_ui(ui: &mut Ui, shared: &Shared, actions: &mut Vec<Action>) {
    let room = ui.available_size();
    ScrollArea::vertical().auto_shrink(false).show(ui, |ui| {
        let width = WIDTH.min(room.x - 32.0);
        ui.add_space(((room.y - 560.0) / 3.0).max(12.0));
        ui.horizontal(|ui| {
            ui.add_space(((room.x - width) / 2.0).max(0.0));
            ui.vertical(|ui| {
                ui.set_width(width);
                page_ui(ui, shared, actions);
            });
        });
    });
}

fn page_ui(ui: &mut Ui, shared: &Shared, actions: &mut Vec<Action>) {
    ui.label(RichText::new("SurgTPGS").size(34.0));
    let what = "Find anatomy and instruments in a recorded operation, by words";
    ui.label(RichText::new(what).color(theme::TEXT_WEAK));
    ui.add_space(16.0);
    if let Some(waiting) = shared.opening.waiting_for() {
        ui.horizontal_wrapped(|ui| {
            ui.spinner();
            ui.label(waiting);
        });
        ui.add_space(12.0);
    }
    exporting_ui(ui, shared, actions);
    training_ui(ui, shared, actions);
    left_ui(ui, shared, actions);
    for (command, text) in [
        (Command::OpenFile, "Open a video or a file…"),
        (Command::OpenFolder, "Open a folder of frames…"),
        (Command::OpenDemo, "See the demo"),
    ] {
        begin_ui(ui, shared, actions, command, text);
    }
    ui.horizontal_wrapped(|ui| {
        ui.label(caption("Or drop a file or folder here, or"));
        if ui.link(caption("type its path").color(theme::ACCENT)).clicked() {
            actions.push(Action::Run(Command::OpenPath));
        }
    });
    recent_ui(ui, shared, actions);
    ui.add_space(16.0);
}

/// Shows a way to begin, as a large button with an explanation.
fn begin_ui(ui: &mut Ui, shared: &Shared, actions: &mut Vec<Action>, command: Command, text: &str) {
    let button = Button::new(RichText::new(text).size(17.0)).min_size(vec2(ui.available_width(), 44.0));
    if add_unless(ui, shared.obstacle(command), button, shared.tooltip(command)).clicked() {
        actions.push(Action::Run(command));
    }
    ui.label(caption(entry(command).tooltip));
    ui.add_space(6.0);
}

fn recent_ui(ui: &mut Ui, shared: &Shared, actions: &mut Vec<Action>) {
    let recent = shared.recent();
    if recent.is_empty() {
        return;
    }
    ui.add_space(14.0);
    ui.label(RichText::new("Opened last").strong());
    for path in recent {
        let (name, exists) = (shared.path_name(path), !shared.opening.gone.has(path));
        let folder = path.parent().map(|p| p.display().to_string()).unwrap_or_default();
        let missing = if exists { "" } else { "  (not there any more)" };
        let frame = Frame::new().inner_margin(Margin::symmetric(0, 1));
        frame.show(ui, |ui| {
            let button = Button::new(format!("{name}{missing}"));
            let button = button.truncate().min_size(vec2(ui.available_width(), theme::CONTROL_HEIGHT));
            let place = path.display().to_string();
            let response = ui.add_enabled(exists, button).on_hover_text(&place);
            if response.on_disabled_hover_text(&place).clicked() {
                actions.push(Action::Open(path.to_owned()));
            }
            ui.add(egui::Label::new(caption(folder)).truncate());
        });
    }
}
