//! The export dialog: formats, frames and folder, the number of files before the start, then the progress.

use crate::outputs;
use crate::viewer::{
    action::Action,
    backend::{
        Backend, ExportPrompt, ExportRequest, ExportSummary,
        task::{Task, TaskEvent},
    },
    panels::{
        folder::free_folder,
        widgets::{self, caption, main_button},
    },
    remedy::message,
    shared::{Dialog, Shared},
    state::{content::Prompt, view_mode::ViewMode},
    text::thousands,
    theme,
};
use egui::{Context, DragValue, ProgressBar, RichText, Ui};
use std::{
    path::{Path, PathBuf},
    sync::Arc,
};
use surgtpgs_core::{
    export::{Format, FormatGroup},
    files::{is_free_folder, unfinished_kind},
};

/// An export, from the question to the result.
struct Export {
    request: ExportRequest,
    /// Name of the open scene, after which a new folder is named.
    name: String,
    last_frame: usize,
    has_original: bool,
    picking: Option<Task<Option<PathBuf>>>,
    state: State,
}

enum State {
    Asking,
    Running(Task<ExportSummary>),
    Finished(ExportSummary),
}

/// The export export.
#[derive(Default)]
pub(crate) struct ExportDialog {
    export: Option<Export>,
}

impl Export {
    /// Makes the dialog for the visible prompts of the open scene.
    fn new(shared: &Shared) -> Option<Self> {
        let info = shared.info()?;
        let prompt = |p: &Prompt| ExportPrompt {
            question: shared.document.question(p),
            threshold: p.threshold,
            colour: p.colour,
            is_instrument: p.is_instrument,
        };
        let shows_original = shared.document.mode == ViewMode::Original;
        let request = ExportRequest {
            scene: info.path.clone(),
            folder: free_folder(&info.output_folder, &info.name, "export"),
            formats: vec![Format::Overlay, Format::Binary],
            frames: shared.playback.bounds(),
            excluded: shared.document.excluded().to_vec(),
            from_original: shows_original && info.has_original,
            prompts: shared.document.prompts().iter().filter(|p| p.is_visible).map(prompt).collect(),
            negatives: shared.document.comparison().common(),
            is_exclusive: false,
            look: shared.document.overlay,
            clean_up: shared.document.content().clean_up,
        };
        Some(Self {
            request,
            name: info.name.clone(),
            last_frame: info.num_frames.saturating_sub(1),
            has_original: info.has_original,
            picking: None,
            state: State::Asking,
        })
    }

    fn is_running(&self) -> bool {
        matches!(self.state, State::Running(_))
    }

    /// Takes the results of the threads; returns a problem to show.
    fn poll(&mut self) -> Option<String> {
        if let Some(TaskEvent::Done(result)) = self.picking.as_mut().and_then(Task::poll) {
            self.picking = None;
            if let Ok(Some(folder)) = result {
                self.request.folder = folder_in(&folder, &self.name);
            }
        }
        let State::Running(task) = &mut self.state else { return None };
        let Some(TaskEvent::Done(result)) = task.poll() else { return None };
        match result {
            Ok(summary) => self.state = State::Finished(summary),
            Err(e) => {
                self.state = State::Asking;
                return Some(message(&e));
            }
        }
        None
    }

    fn start(&mut self, backend: Arc<dyn Backend>, ctx: &Context) {
        let request = self.request.clone();
        self.state = State::Running(Task::start("export", ctx, move |task| backend.export(&request, task)));
    }

    fn pick_folder(&mut self, ctx: &Context) {
        self.picking = Some(Task::start("file dialog", ctx, |_| {
            Ok(rfd::FileDialog::new().set_title("Export into this folder").pick_folder())
        }));
    }
}

/// Returns the folder for an export of `name` after the user picked `folder`. This is `folder` if it is free
/// or holds an export to continue, and otherwise a new folder in it.
pub(crate) fn folder_in(folder: &Path, name: &str) -> PathBuf {
    match is_free_folder(folder) {
        Ok(true) => folder.to_owned(),
        _ if unfinished_kind(folder).as_deref() == Some(outputs::EXPORT) => folder.to_owned(),
        _ => free_folder(folder, name, "export"),
    }
}

impl ExportDialog {
    /// Shows the dialog, if it is open.
    pub(crate) fn ui(&mut self, ctx: &Context, shared: &Shared, actions: &mut Vec<Action>) {
        let is_wanted = shared.dialog == Some(Dialog::Export);
        let opened = shared.info().map(|info| &info.path);
        // A running export holds everything that it needs; any other is about the open scene alone.
        let is_valid = |e: &mut Export| is_wanted && (e.is_running() || Some(&e.request.scene) == opened);
        let kept = self.export.take_if(is_valid);
        let had_other = self.export.take().is_some();
        if !is_wanted {
            return;
        }
        let begin = || if had_other { None } else { Export::new(shared) };
        let Some(mut export) = kept.or_else(begin) else {
            actions.push(Action::CloseDialog);
            return;
        };
        if let Some(problem) = export.poll() {
            actions.push(Action::Report(problem));
        }
        if export_ui(ctx, &mut export, &shared.backend) {
            actions.push(Action::CloseDialog);
        }
        self.export = Some(export);
    }
}

/// Shows an export; returns `true` if the dialog is to be closed. A running export is not closed by Esc.
fn export_ui(ctx: &Context, export: &mut Export, backend: &Arc<dyn Backend>) -> bool {
    let (is_done, is_closed) = widgets::dialog(ctx, "export", 560.0, |ui| {
        ui.heading("Export masked frames");
        match &export.state {
            State::Asking => asking_ui(ui, export, backend),
            State::Running(task) => running_ui(ui, task),
            State::Finished(summary) => finished_ui(ui, summary),
        }
    });
    is_done || (is_closed && !export.is_running())
}

/// Shows the settings of an export; returns `true` if the dialog is to be closed.
fn asking_ui(ui: &mut Ui, export: &mut Export, backend: &Arc<dyn Backend>) -> bool {
    let names: Vec<_> = export.request.prompts.iter().map(|p| format!("\"{}\"", p.question.text)).collect();
    let what = if names.is_empty() { "No visible prompt".to_owned() } else { names.join(", ") };
    ui.label(RichText::new(what).color(if names.is_empty() { theme::AMBER } else { theme::TEXT_WEAK }));
    ui.add_space(6.0);
    formats_ui(ui, &mut export.request.formats);
    ui.separator();
    frames_ui(ui, export);
    ui.horizontal(|ui| {
        let folder = export.request.folder.display().to_string();
        if ui.add_enabled(export.picking.is_none(), egui::Button::new("Folder…")).clicked() {
            export.pick_folder(&ui.ctx().clone());
        }
        ui.add(egui::Label::new(caption(folder)).truncate());
    });
    ui.add_space(10.0);
    let has_gaps = export.request.has_gaps();
    if has_gaps {
        let text = "Frames are left out in between: videos, tables and volumes need them in one piece. Choose frames before or \
                    behind what is left out.";
        ui.label(RichText::new(text).font(theme::small()).color(theme::AMBER));
    }
    let is_ready = !export.request.formats.is_empty() && !export.request.prompts.is_empty() && !has_gaps;
    let count = if is_ready { export.request.num_files() } else { 0 };
    ui.label(RichText::new(format!("{} files will be written", thousands(count))).strong());
    ui.label(caption("A provenance.json beside them says how they were made."));
    ui.horizontal(|ui| {
        if ui.add_enabled(is_ready, main_button("Start export")).clicked() {
            export.start(backend.clone(), &ui.ctx().clone());
        }
        ui.button("Cancel").clicked()
    })
    .inner
}

fn formats_ui(ui: &mut Ui, formats: &mut Vec<Format>) {
    for group in FormatGroup::ALL {
        ui.label(caption(group.label()));
        ui.horizontal_wrapped(|ui| {
            for format in group.formats() {
                let (label, explanation) = format.label();
                let mut is_on = formats.contains(&format);
                if ui.checkbox(&mut is_on, label).on_hover_text(explanation).changed() {
                    formats.retain(|f| *f != format);
                    if is_on {
                        formats.push(format);
                    }
                }
            }
        });
        ui.add_space(4.0);
    }
}

fn frames_ui(ui: &mut Ui, export: &mut Export) {
    let request = &mut export.request;
    ui.horizontal(|ui| {
        ui.label("Frames");
        // Frames are shown from 1 and stored from 0.
        let (mut from, mut to) = (request.frames.0 + 1, request.frames.1 + 1);
        let last = export.last_frame + 1;
        ui.add(DragValue::new(&mut from).range(1..=last)).on_hover_text("First frame");
        ui.label("to");
        ui.add(DragValue::new(&mut to).range(1..=last)).on_hover_text("Last frame");
        request.frames = (from.min(to) - 1, to.max(from) - 1);
        if ui.button("All").clicked() {
            request.frames = (0, export.last_frame);
        }
    });
    ui.horizontal(|ui| {
        ui.label("Pictures from");
        ui.add_enabled_ui(export.has_original, |ui| {
            ui.radio_value(&mut request.from_original, true, "the recording");
        });
        ui.radio_value(&mut request.from_original, false, "the reconstruction");
    });
    if request.prompts.len() > 1 {
        ui.checkbox(&mut request.is_exclusive, "Each pixel belongs to one prompt only (the highest score)");
    }
}

fn running_ui(ui: &mut Ui, task: &Task<ExportSummary>) -> bool {
    let progress = &task.progress;
    ui.label(format!("{} of {} frames", thousands(progress.done), thousands(progress.total)));
    ui.add(ProgressBar::new(progress.fraction()).desired_height(10.0).fill(theme::ACCENT));
    let label = if task.is_cancelling() { "Stopping…" } else { "Stop" };
    if ui.add_enabled(!task.is_cancelling(), egui::Button::new(label)).clicked() {
        task.cancel();
    }
    false
}

fn finished_ui(ui: &mut Ui, summary: &ExportSummary) -> bool {
    let files = thousands(summary.num_files);
    if summary.is_complete {
        ui.label(format!("{files} files are in"));
    } else {
        let text = format!("Stopped. The {files} files that were finished are complete, in");
        ui.label(RichText::new(text).color(theme::AMBER));
    }
    ui.label(RichText::new(summary.folder.display().to_string()).color(theme::TEXT_WEAK));
    ui.add(main_button("Close")).clicked()
}

#[cfg(test)]
mod tests {
    use super::*;
    use egui_kittest::{Harness, kittest::Queryable};

    #[test]
    fn every_format_is_offered() {
        let mut window =
            Harness::new_ui_state(|ui, formats: &mut Vec<Format>| formats_ui(ui, formats), Vec::new());
        for format in Format::ALL {
            window.get_by_label(format.label().0).click();
            window.run();
        }
        assert_eq!(*window.state(), Format::ALL);
    }
}
