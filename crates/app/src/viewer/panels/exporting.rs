//! Progress and result of an export, in the side panel and on the start page.

use crate::viewer::{
    action::Action,
    panels::widgets::{caption, main_button},
    shared::Shared,
    state::exporting::Exporting,
    text::{about, counted, thousands},
    theme,
};
use egui::{Button, Frame, Margin, ProgressBar, RichText, Ui};
use surgtpgs_core::export::ExportSummary;

/// Shows the export that is running or has just ended, if there is one.
pub(crate) fn exporting_ui(ui: &mut Ui, shared: &Shared, actions: &mut Vec<Action>) {
    let Some(exporting) = &shared.exporting else { return };
    let frame = Frame::new().fill(theme::RAISED).corner_radius(8).inner_margin(Margin::same(12));
    frame.show(ui, |ui| {
        ui.set_width(ui.available_width());
        match &exporting.summary {
            None => running_ui(ui, exporting),
            Some(summary) => finished_ui(ui, shared, exporting, summary, actions),
        }
    });
    ui.add_space(10.0);
}

fn running_ui(ui: &mut Ui, exporting: &Exporting) {
    let task = &exporting.task;
    let progress = &task.progress;
    let text = match progress.total {
        0 => "Exporting…".to_owned(),
        total => format!("Exporting: {} of {}", thousands(progress.done), counted(total, "frame", "frames")),
    };
    ui.label(RichText::new(text).strong());
    ui.add(ProgressBar::new(progress.fraction()).desired_height(10.0).fill(theme::ACCENT));
    let label = if task.is_cancelling() { "Stopping…" } else { "Stop the export" };
    let tip = "What is finished stays, and the export can go on from there";
    let button = ui.add_enabled(!task.is_cancelling(), Button::new(label)).on_hover_text(tip);
    if button.clicked() {
        task.cancel();
    }
    let left = exporting.seconds_left().map(|seconds| format!("{} left", about(seconds)));
    ui.label(caption(left.unwrap_or_else(|| "estimating the time…".into())));
}

fn finished_ui(
    ui: &mut Ui,
    shared: &Shared,
    exporting: &Exporting,
    summary: &ExportSummary,
    actions: &mut Vec<Action>,
) {
    let files = counted(summary.files, "file", "files");
    let verb = if summary.files == 1 { ("is", "was") } else { ("are", "were") };
    if summary.complete {
        ui.label(format!("{files} {} in", verb.0));
    } else {
        let text = format!("Stopped. The {files} that {} finished {} complete, in", verb.1, verb.0);
        ui.label(RichText::new(text).color(theme::AMBER));
    }
    let folder = exporting.folder().display().to_string();
    ui.add(egui::Label::new(RichText::new(folder).color(theme::TEXT_WEAK)).wrap());
    for words in &summary.left_out {
        ui.label(RichText::new(format!("Note: {words}.")).color(theme::AMBER));
    }
    ui.horizontal_wrapped(|ui| {
        let tip = "Writes what is missing, with the same settings, into the same folder";
        let may_go_on = !summary.complete && shared.may_export(&exporting.asked.0);
        if may_go_on && ui.button("Go on with it").on_hover_text(tip).clicked() {
            actions.push(Action::Export(Box::new(exporting.asked.clone())));
        }
        if ui.add(main_button("Open folder")).clicked() {
            actions.push(Action::ShowFolder(exporting.folder().to_owned()));
        }
        if ui.button("Close").clicked() {
            actions.push(Action::ForgetExport);
        }
    });
}
