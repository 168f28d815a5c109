//! Check of a recording: its content, and faults that would make a reconstruction of it wrong. The recording
//! is read in the background once it is open.

use crate::viewer::{
    action::Action,
    backend::{Checked, task::TaskProgress},
    panels::widgets::caption,
    shared::Shared,
    text::{sentence, thousands},
    theme,
};
use egui::{Button, CollapsingHeader, Frame, Margin, RichText, Ui};
use surgtpgs_core::sequence::CheckReport;

/// Shows the report of a recording that is not reconstructed.
pub(crate) fn import_check_ui(ui: &mut Ui, shared: &Shared, actions: &mut Vec<Action>) {
    let is_wanted = !shared.is_reconstructing() && shared.info().is_some_and(|i| !i.has_reconstruction);
    let Some(check) = shared.reconstruction.check.as_ref().filter(|_| is_wanted) else { return };
    let frame = Frame::new().fill(theme::RAISED).corner_radius(8).inner_margin(Margin::same(12));
    frame.show(ui, |ui| {
        ui.set_width(ui.available_width());
        match &check.outcome {
            None => drop(ui.label(caption(progress_text(&check.task.progress)))),
            Some(Err(problem)) => {
                ui.label(RichText::new(problem).font(theme::small()).color(theme::ERROR));
            }
            Some(Ok(checked)) => report_ui(ui, shared, checked, actions),
        }
    });
    ui.add_space(10.0);
}

/// Says how far the check is: its stage, and how much of that is done if it has parts.
fn progress_text(progress: &TaskProgress) -> String {
    let TaskProgress { stage, done, total, .. } = progress;
    let stage = if stage.is_empty() { "Checking the recording".into() } else { sentence(stage) };
    match total {
        0 | 1 => format!("{stage}…"),
        _ => format!("{stage}: {} of {}", thousands(*done), thousands(*total)),
    }
}

/// Shows the report. What makes a reconstruction wrong is shown at once, the rest when it is asked for.
fn report_ui(ui: &mut Ui, shared: &Shared, checked: &Checked, actions: &mut Vec<Action>) {
    let report = &checked.report;
    let (verdict, colour) = match report.ok {
        false => ("A reconstruction would be wrong", theme::ERROR),
        true => ("This recording can be reconstructed", theme::TEXT),
    };
    ui.label(RichText::new(verdict).strong().color(colour));
    let line = |ui: &mut Ui, text: &str, colour| {
        ui.label(RichText::new(text).font(theme::small()).color(colour));
    };
    report.errors.iter().for_each(|text| line(ui, text, theme::ERROR));
    let (title, colour) = match report.warnings.len() {
        0 => ("About this recording".to_owned(), theme::TEXT_WEAK),
        1 => ("1 thing to know about it".to_owned(), theme::AMBER),
        n => (format!("{n} things to know about it"), theme::AMBER),
    };
    let title = RichText::new(title).font(theme::small()).color(colour);
    let details = CollapsingHeader::new(title).id_salt(("things to know", report.ok));
    details.default_open(!report.ok).show(ui, |ui| {
        report.warnings.iter().for_each(|text| line(ui, text, theme::AMBER));
        contents_ui(ui, report);
        ui.label(caption("Numbers of frames count from 0 here, as in files."));
    });
    leave_out_ui(ui, shared, report, actions);
    let tip = "What the masks hide is kept, and what they keep is hidden, from now on. This is kept in a file beside \
               the recording, which itself is never written to; once more turns it back.";
    if checked.can_flip {
        let flip = ui.add_enabled(!shared.reconstruction.is_flipping(), Button::new("Flip the masks"));
        if flip.on_hover_text(tip).clicked() {
            actions.push(Action::FlipMasks);
        }
    }
}

/// Offers to leave out parts that show no tissue, and all shots but the shown one.
fn leave_out_ui(ui: &mut Ui, shared: &Shared, report: &CheckReport, actions: &mut Vec<Action>) {
    let is_in = |range: &(usize, usize)| shared.document.has_included(*range);
    let outside: Vec<(usize, usize)> = report.without_tissue.iter().copied().filter(is_in).collect();
    let other_shots: Vec<(usize, usize)> =
        other_shots(report, shared.playback.frame()).into_iter().filter(is_in).collect();
    let offers = [
        (
            outside,
            "Leave out what is outside of the body",
            "Parts whose colours are not those of tissue",
            "leaving out what is outside of the body",
        ),
        (
            other_shots,
            "Keep this shot alone",
            "Leaves out everything before and after the shot that is shown",
            "keeping one shot alone",
        ),
    ];
    for (ranges, label, tip, edit) in offers {
        if !ranges.is_empty() && ui.button(label).on_hover_text(tip).clicked() {
            actions.push(Action::edit(move |d| d.exclude(edit, &ranges)));
        }
    }
}

/// Returns the frames before and after the shot of `frame`, if there are several shots.
fn other_shots(report: &CheckReport, frame: usize) -> Vec<(usize, usize)> {
    let first = report.cuts.iter().copied().rfind(|cut| *cut <= frame);
    let next = report.cuts.iter().copied().find(|cut| *cut > frame);
    let before = first.map(|first| (0, first - 1));
    before.into_iter().chain(next.map(|next| (next, report.frames - 1))).collect()
}

/// Lists what the recording holds.
fn contents_ui(ui: &mut Ui, report: &CheckReport) {
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
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_check_says_what_it_does_and_counts_what_has_parts() {
        let text = |stage: &str, done, total| {
            progress_text(&TaskProgress { stage: stage.into(), done, total, ..TaskProgress::default() })
        };
        assert_eq!(text("", 0, 0), "Checking the recording…");
        assert_eq!(text("checking", 39, 63), "Checking: 39 of 63");
        assert_eq!(text("finding the scope's path", 0, 1), "Finding the scope's path…");
    }

    #[test]
    fn other_shots_are_all_that_is_before_and_after() {
        let report = CheckReport { frames: 30, cuts: vec![10, 20], ..CheckReport::default() };
        assert_eq!(other_shots(&report, 9), [(10, 29)]);
        assert_eq!(other_shots(&report, 10), [(0, 9), (20, 29)]);
        assert_eq!(other_shots(&report, 29), [(0, 19)]);
        assert_eq!(other_shots(&CheckReport { frames: 30, ..CheckReport::default() }, 3), []);
    }
}
