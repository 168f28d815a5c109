//! The export dialog: formats, frames and folder, the number of files before the start, then the progress.

use super::{
    app::ViewerApp,
    document::ViewMode,
    jobs::{Job, JobEvent},
    source::{Backend, ExportPrompt, ExportRequest, ExportSummary},
    theme,
    widgets::{self, caption, main_button, thousands},
};
use crate::outputs;
use egui::{Context, DragValue, ProgressBar, RichText, Ui};
use std::{
    path::{Path, PathBuf},
    sync::Arc,
};
use surgtpgs_core::{
    export::{Format, FormatGroup},
    files::{is_free_folder, unfinished_kind},
};

/// State of the dialog, from the question to the result.
pub(crate) struct ExportDialog {
    request: ExportRequest,
    /// Name of the open scene, after which a new folder is named.
    name: String,
    last_frame: usize,
    has_original: bool,
    picking: Option<Job<Option<PathBuf>>>,
    state: State,
}

enum State {
    Asking,
    Running(Job<ExportSummary>),
    Finished(ExportSummary),
}

impl ExportDialog {
    /// Makes the dialog for the visible prompts of the open scene.
    pub(crate) fn new(app: &ViewerApp) -> Option<Self> {
        let info = app.info()?;
        let prompt = |p: &super::document::Prompt| ExportPrompt {
            question: app.document.question(p),
            threshold: p.threshold,
            colour: p.colour,
            is_instrument: p.is_instrument,
        };
        let shows_original = app.document.mode == ViewMode::Original;
        let request = ExportRequest {
            scene: info.path.clone(),
            folder: free_folder(&info.output_folder, &info.name, "export"),
            formats: vec![Format::Overlay, Format::Binary],
            frames: app.playback.bounds(),
            excluded: app.document.excluded().to_vec(),
            from_original: shows_original && info.has_original,
            prompts: app.document.prompts().iter().filter(|p| p.is_visible).map(prompt).collect(),
            negatives: app.document.comparison().common(),
            is_exclusive: false,
            look: app.document.overlay,
            clean_up: app.document.content().clean_up,
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

    pub(crate) fn is_running(&self) -> bool {
        matches!(self.state, State::Running(_))
    }

    /// Takes the results of the threads; returns a problem to show.
    pub(crate) fn poll(&mut self) -> Option<String> {
        if let Some(JobEvent::Done(result)) = self.picking.as_mut().and_then(Job::poll) {
            self.picking = None;
            if let Ok(Some(folder)) = result {
                self.request.folder = folder_in(&folder, &self.name);
            }
        }
        let State::Running(job) = &mut self.state else { return None };
        let Some(JobEvent::Done(result)) = job.poll() else { return None };
        match result {
            Ok(summary) => self.state = State::Finished(summary),
            Err(e) => {
                self.state = State::Asking;
                return Some(super::remedy::message(&e));
            }
        }
        None
    }

    fn start(&mut self, backend: Arc<dyn Backend>, ctx: &Context) {
        let request = self.request.clone();
        self.state = State::Running(Job::start("export", ctx, move |job| backend.export(&request, job)));
    }

    fn pick_folder(&mut self, ctx: &Context) {
        self.picking = Some(Job::start("file dialog", ctx, |_| {
            Ok(rfd::FileDialog::new().set_title("Export into this folder").pick_folder())
        }));
    }
}

/// Returns the folder for an export of `name` after the user picked `folder`. This is `folder` if it is free
/// or holds an export to continue, and otherwise a new folder in it.
pub(super) fn folder_in(folder: &Path, name: &str) -> PathBuf {
    match is_free_folder(folder) {
        Ok(true) => folder.to_owned(),
        _ if unfinished_kind(folder).as_deref() == Some(outputs::EXPORT) => folder.to_owned(),
        _ => free_folder(folder, name, "export"),
    }
}

/// Returns the path of a folder that does not exist yet.
pub(super) fn free_folder(parent: &Path, name: &str, what: &str) -> PathBuf {
    let path = |i: usize| {
        let number = if i == 1 { String::new() } else { format!("-{i}") };
        parent.join(format!("{name}-{what}{number}"))
    };
    (1..1000).map(path).find(|p| !p.exists()).unwrap_or_else(|| path(1000))
}

/// Shows the dialog, if it is open.
pub(crate) fn export_dialog_ui(ctx: &Context, app: &mut ViewerApp) {
    let Some(mut dialog) = app.export.take() else { return };
    let backend = app.backend.clone();
    let (is_done, is_closed) = widgets::dialog(ctx, "export", 560.0, |ui| {
        ui.heading("Export masked frames");
        match &dialog.state {
            State::Asking => asking_ui(ui, &mut dialog, backend),
            State::Running(job) => running_ui(ui, job),
            State::Finished(summary) => finished_ui(ui, summary),
        }
    });
    let is_running = matches!(dialog.state, State::Running(_));
    if !is_done && (is_running || !is_closed) {
        app.export = Some(dialog);
    }
}

/// Shows the settings of an export; returns `true` if the dialog is to be closed.
fn asking_ui(ui: &mut Ui, dialog: &mut ExportDialog, backend: Arc<dyn Backend>) -> bool {
    let names: Vec<_> = dialog.request.prompts.iter().map(|p| format!("\"{}\"", p.question.text)).collect();
    let what = if names.is_empty() { "No visible prompt".to_owned() } else { names.join(", ") };
    ui.label(RichText::new(what).color(if names.is_empty() { theme::AMBER } else { theme::TEXT_WEAK }));
    ui.add_space(6.0);
    formats_ui(ui, &mut dialog.request.formats);
    ui.separator();
    frames_ui(ui, dialog);
    ui.horizontal(|ui| {
        let folder = dialog.request.folder.display().to_string();
        if ui.add_enabled(dialog.picking.is_none(), egui::Button::new("Folder…")).clicked() {
            dialog.pick_folder(&ui.ctx().clone());
        }
        ui.add(egui::Label::new(caption(folder)).truncate());
    });
    ui.add_space(10.0);
    let has_gaps = dialog.request.has_gaps();
    if has_gaps {
        let text = "Frames are left out in between: videos, tables and volumes need them in one piece. Choose frames before or \
                    behind what is left out.";
        ui.label(RichText::new(text).font(theme::small()).color(theme::AMBER));
    }
    let is_ready = !dialog.request.formats.is_empty() && !dialog.request.prompts.is_empty() && !has_gaps;
    let count = if is_ready { dialog.request.num_files() } else { 0 };
    ui.label(RichText::new(format!("{} files will be written", thousands(count))).strong());
    ui.label(caption("A provenance.json beside them says how they were made."));
    ui.horizontal(|ui| {
        if ui.add_enabled(is_ready, main_button("Start export")).clicked() {
            dialog.start(backend, &ui.ctx().clone());
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

fn frames_ui(ui: &mut Ui, dialog: &mut ExportDialog) {
    let request = &mut dialog.request;
    ui.horizontal(|ui| {
        ui.label("Frames");
        // Frames are shown from 1 and stored from 0.
        let (mut from, mut to) = (request.frames.0 + 1, request.frames.1 + 1);
        let last = dialog.last_frame + 1;
        ui.add(DragValue::new(&mut from).range(1..=last)).on_hover_text("First frame");
        ui.label("to");
        ui.add(DragValue::new(&mut to).range(1..=last)).on_hover_text("Last frame");
        request.frames = (from.min(to) - 1, to.max(from) - 1);
        if ui.button("All").clicked() {
            request.frames = (0, dialog.last_frame);
        }
    });
    ui.horizontal(|ui| {
        ui.label("Pictures from");
        ui.add_enabled_ui(dialog.has_original, |ui| {
            ui.radio_value(&mut request.from_original, true, "the recording");
        });
        ui.radio_value(&mut request.from_original, false, "the reconstruction");
    });
    if request.prompts.len() > 1 {
        ui.checkbox(&mut request.is_exclusive, "Each pixel belongs to one prompt only (the highest score)");
    }
}

fn running_ui(ui: &mut Ui, job: &Job<ExportSummary>) -> bool {
    let progress = &job.progress;
    ui.label(format!("{} of {} frames", thousands(progress.done), thousands(progress.total)));
    ui.add(ProgressBar::new(progress.fraction()).desired_height(10.0).fill(theme::ACCENT));
    let label = if job.is_cancelling() { "Stopping…" } else { "Stop" };
    if ui.add_enabled(!job.is_cancelling(), egui::Button::new(label)).clicked() {
        job.cancel();
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
