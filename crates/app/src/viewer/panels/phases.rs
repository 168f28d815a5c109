//! The list of phases, with their names and frames, and their files.

use crate::viewer::{
    action::Action,
    backend::paths::taken,
    command::Command,
    panels::widgets::{Icon, add_unless, caption, dialog, icon_button, main_button, path_field},
    shared::{Dialog, Shared},
    state::phases::{self, CHOLEC80, Phase},
    text::timecode,
    theme,
};
use egui::{Context, DragValue, Popup, RichText, ScrollArea, TextEdit, Ui};
use std::{
    ops::RangeInclusive,
    path::{Path, PathBuf},
};
use surgtpgs_core::{files::write_whole, reading::read_text};

/// The dialog, with what is typed into it.
#[derive(Default)]
pub(crate) struct PhasesDialog {
    asked: Option<Asked>,
}

/// Contents of the fields.
struct Asked {
    name: String,
    /// `true` until the field of the name has the focus for the first time.
    wants_name: bool,
    file: PathBuf,
    /// Result of the last writing or reading, and `true` for a fault.
    said: Option<(String, bool)>,
}

impl PhasesDialog {
    /// Shows the dialog, if it is open.
    pub(crate) fn ui(&mut self, ctx: &Context, shared: &Shared, actions: &mut Vec<Action>) {
        if shared.dialog != Some(Dialog::Phases) {
            self.asked = None;
            return;
        }
        let Some(info) = shared.info() else { return };
        let asked = self.asked.get_or_insert_with(|| Asked {
            name: String::new(),
            wants_name: true,
            file: info.output_folder.join(format!("{}-phases.csv", info.name)),
            said: None,
        });
        let (is_done, is_closed) = dialog(ctx, "phases", 660.0, |ui| {
            ui.heading("Phases");
            let (from, to) = new_range(shared);
            ui.label(caption(format!("A new phase is of frames {} to {}: {}", from + 1, to + 1, RANGE_TIP)));
            add_ui(ui, asked, (from, to), actions);
            ui.add_space(6.0);
            ScrollArea::vertical().max_height(300.0).show(ui, |ui| rows_ui(ui, shared, actions));
            ui.separator();
            files_ui(ui, asked, shared, actions);
            ui.add_space(10.0);
            ui.add(main_button("Close")).clicked()
        });
        if is_done || is_closed {
            actions.push(Action::CloseDialog);
            actions.push(Action::edit(move |d| d.end_gesture()));
        }
    }
}

/// Explanation of the frames of a new phase.
const RANGE_TIP: &str = "the part that plays, or all from the present frame on.";

/// Returns first and last frame of a new phase.
fn new_range(shared: &Shared) -> (usize, usize) {
    let rest = (shared.seen_frame(), shared.playback.num_frames() - 1);
    shared.playback.range().unwrap_or(rest)
}

fn add_ui(ui: &mut Ui, asked: &mut Asked, (from, to): (usize, usize), actions: &mut Vec<Action>) {
    ui.horizontal_wrapped(|ui| {
        let field =
            ui.add(TextEdit::singleline(&mut asked.name).hint_text("Name of the phase").desired_width(240.0));
        field.ctx.accesskit_node_builder(field.id, |node| node.set_label("Name of the phase"));
        if std::mem::take(&mut asked.wants_name) {
            field.request_focus();
        }
        let names =
            ui.button("Names…").on_hover_text("The phases of a cholecystectomy, as Cholec80 calls them");
        Popup::menu(&names).show(|ui| {
            for name in CHOLEC80 {
                if ui.button(name).clicked() {
                    name.clone_into(&mut asked.name);
                }
            }
        });
        let is_named = !asked.name.trim().is_empty();
        let is_entered = field.lost_focus() && ui.input(|i| i.key_pressed(egui::Key::Enter));
        let add = ui.add_enabled(is_named, egui::Button::new("Add"));
        let is_clicked = add.on_disabled_hover_text("Give it a name first").clicked();
        if (is_clicked || is_entered) && is_named {
            let phase = Phase::new(&std::mem::take(&mut asked.name), from, to);
            actions.push(Action::edit(move |d| d.add_phase(phase)));
        }
    });
}

fn rows_ui(ui: &mut Ui, shared: &Shared, actions: &mut Vec<Action>) {
    let phases = shared.document.phases();
    if phases.is_empty() {
        ui.label(RichText::new("None yet.").color(theme::TEXT_WEAK));
    }
    for (index, phase) in phases.iter().enumerate() {
        ui.horizontal_wrapped(|ui| {
            let mut changed = phase.clone();
            let field = ui.add(TextEdit::singleline(&mut changed.name).desired_width(220.0));
            field.ctx.accesskit_node_builder(field.id, |node| {
                node.set_label(format!("Name of phase {}", index + 1))
            });
            // Frames are shown from 1 and stored from 0. Half a number must not take frames from a neighbour.
            let (mut first, mut end) = (phase.first + 1, phase.last + 1);
            let lowest = index.checked_sub(1).map_or(1, |before| phases[before].last + 2);
            let highest = phases.get(index + 1).map_or(shared.playback.num_frames(), |next| next.first);
            let tip = "First frame, after the last one of the phase before";
            frame_ui(ui, &mut first, lowest..=end, &format!("First frame of phase {}", index + 1), tip);
            ui.label("to");
            let tip = "Last frame, before the first one of the next phase";
            frame_ui(ui, &mut end, first..=highest, &format!("Last frame of phase {}", index + 1), tip);
            (changed.first, changed.last) = (first - 1, end - 1);
            if changed != *phase {
                actions.push(Action::edit(move |d| d.change_phase(index, changed)));
            }
            let start = phase.first;
            let time = timecode(shared.playback.seconds(start));
            if ui.button(time).on_hover_text("Go to its first frame").clicked() {
                actions.push(Action::GoTo(start));
                actions.push(Action::CloseDialog);
            }
            let name = format!("Delete the phase {}", phase.name);
            if icon_button(ui, Icon::Cross, &name, "Delete this phase (undo brings it back)", false, true)
                .clicked()
            {
                actions.push(Action::edit(move |d| d.remove_phase(index)));
            }
        });
    }
}

/// Shows a field for the number of a frame, which counts once it is typed whole.
fn frame_ui(ui: &mut Ui, frame: &mut usize, range: RangeInclusive<usize>, name: &str, tip: &str) {
    let field = ui.add(DragValue::new(frame).range(range).update_while_editing(false)).on_hover_text(tip);
    field.ctx.accesskit_node_builder(field.id, |node| node.set_label(name));
}

fn files_ui(ui: &mut Ui, asked: &mut Asked, shared: &Shared, actions: &mut Vec<Action>) {
    ui.label("File of phases");
    path_field(ui, "File of phases", &mut asked.file);
    ui.horizontal_wrapped(|ui| {
        let phases = shared.document.phases();
        let seconds = |frame| shared.playback.seconds(frame);
        let obstacle = phases.is_empty().then_some("There is no phase yet");
        let tip = "Name, first and last frame, start and end of every phase, as a table (CSV)";
        if add_unless(ui, obstacle, egui::Button::new("Save as table"), tip).clicked() {
            asked.said = Some(save(&asked.file.with_extension("csv"), &phases::csv(phases, seconds)));
        }
        let tip = "A line with number and phase of every frame, as in the dataset Cholec80";
        if add_unless(ui, obstacle, egui::Button::new("Save as Cholec80"), tip).clicked() {
            asked.said = Some(save(&asked.file.with_extension("txt"), &phases::cholec80(phases)));
        }
        let tip = "Replaces the phases by those of the file, in either form (undo brings them back)";
        if ui.button("Read").on_hover_text(tip).clicked() {
            let read = read_text(&asked.file).map_err(|e| format!("The file cannot be read: {e}."));
            match read.and_then(|text| phases::read(&text, shared.playback.num_frames())) {
                Ok(phases) => {
                    asked.said = Some((format!("{} phases were read.", phases.len()), false));
                    actions.push(Action::edit(move |d| d.set_phases(phases)));
                }
                Err(why) => asked.said = Some((why, true)),
            }
        }
    });
    if let Some((text, is_fault)) = &asked.said {
        let colour = if *is_fault { theme::ERROR } else { theme::TEXT_WEAK };
        ui.label(RichText::new(text).font(theme::small()).color(colour));
    }
    ui.label(caption(format!(
        "Phases are saved with the session, too ({}).",
        shared.keys_text(Command::SaveSession)
    )));
}

/// Writes a new file; says where, or what is wrong, with `true` for a fault.
fn save(file: &Path, text: &str) -> (String, bool) {
    if let Some(why) = taken(file) {
        return (why, true);
    }
    match write_whole(file, text.as_bytes()) {
        Ok(()) => (format!("Saved as {}", file.display()), false),
        Err(e) => (e.to_string(), true),
    }
}
