//! Check of a recording: its content, and faults that would make a reconstruction of it wrong. The recording
//! is read in the background once it is open.

use crate::viewer::{action::Action, backend::Checked, panels::widgets::caption, shared::Shared, theme};
use egui::{Frame, Margin, RichText, ScrollArea, Ui};

/// Largest height of the report; the rest is scrolled to.
const MAX_HEIGHT: f32 = 330.0;

/// Shows the report of a recording that is not reconstructed.
pub(crate) fn import_check_ui(ui: &mut Ui, shared: &Shared, actions: &mut Vec<Action>) {
    let is_wanted = !shared.is_reconstructing() && shared.info().is_some_and(|i| !i.has_reconstruction);
    let Some(check) = shared.reconstruction.check.as_ref().filter(|_| is_wanted) else { return };
    let frame = Frame::new().fill(theme::RAISED).corner_radius(8).inner_margin(Margin::same(12));
    let flips = frame.show(ui, |ui| {
        ui.set_width(ui.available_width());
        match &check.outcome {
            None => {
                let progress = &check.task.progress;
                ui.label(caption(format!(
                    "Checking the recording: {} of {} frames",
                    progress.done, progress.total
                )));
                false
            }
            Some(Err(problem)) => {
                ui.label(RichText::new(problem).font(theme::small()).color(theme::ERROR));
                false
            }
            Some(Ok(checked)) => report_ui(ui, checked),
        }
    });
    ui.add_space(10.0);
    if flips.inner {
        actions.push(Action::FlipMasks);
    }
}

/// Shows the report; returns `true` if the masks are to be inverted.
fn report_ui(ui: &mut Ui, checked: &Checked) -> bool {
    let report = &checked.report;
    let (verdict, colour) = match (report.ok, report.warnings.len()) {
        (false, _) => ("A reconstruction would be wrong", theme::ERROR),
        (true, 0) => ("This recording can be reconstructed", theme::TEXT),
        (true, _) => ("It can be reconstructed; please read", theme::AMBER),
    };
    ui.label(RichText::new(verdict).strong().color(colour));
    ScrollArea::vertical().max_height(MAX_HEIGHT).show(ui, |ui| {
        for (texts, colour) in [(&report.errors, theme::ERROR), (&report.warnings, theme::AMBER)] {
            for text in texts {
                ui.label(RichText::new(text).font(theme::small()).color(colour));
            }
        }
        let size = format!("{} of {} × {} px", report.frames, report.width, report.height);
        for (name, text) in [
            ("Frames", &size),
            ("Camera", &report.camera),
            ("Depth", &report.depth),
            ("Masks", &report.masks),
            ("Labels", &report.labels),
        ] {
            ui.label(caption(format!("{name}: {text}")));
        }
    });
    let tip = "What the masks hide is kept, and what they keep is hidden, from now on. This is kept in a file beside \
               the recording, which itself is never written to; once more turns it back.";
    checked.can_flip && ui.button("Flip the masks").on_hover_text(tip).clicked()
}
