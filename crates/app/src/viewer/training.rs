//! Reconstruction of a recording in the window: a dialog first, then the progress beside the picture.

use super::{
    app::ViewerApp,
    command::{Command, entry, tooltip},
    jobs::{Job, JobEvent},
    loss_curve::{LossCurve, loss_curve_ui},
    source::{Backend, Info, TrainRequest},
    theme,
    widgets::{caption, choice, dialog, duration, main_button, thousands},
};
use egui::{Context, Frame, Margin, ProgressBar, RichText, Ui};
use std::{
    path::{Path, PathBuf},
    sync::Arc,
};
use surgtpgs_core::{Error, Result, train::TrainSettings};

/// Default number of optimiser steps.
pub(crate) const DEFAULT_STEPS: usize = 3000;

/// Qualities to choose from: number of steps and label.
const QUALITIES: [(usize, &str); 3] = [(600, "Quick look"), (DEFAULT_STEPS, "Standard"), (9000, "Best")];

/// State of the dialog before training.
pub(crate) struct TrainDialog {
    request: TrainRequest,
    has_labels: bool,
    /// Warning about the quality that is lost because the recording is long.
    too_long: Option<String>,
    picking: Option<Job<Option<PathBuf>>>,
}

impl TrainDialog {
    /// Makes the dialog; `None` where the recording is not at hand.
    pub(crate) fn new(info: &Info, excluded: Vec<(usize, usize)>) -> Option<Self> {
        let (recording, scene) = (info.recording.clone()?, free_file(&info.output_folder, &info.name));
        let request = TrainRequest { recording, scene, iterations: DEFAULT_STEPS, excluded };
        let too_long = TrainSettings::default().length_warning(info.num_frames);
        Some(Self { request, has_labels: info.has_labels, too_long, picking: None })
    }

    /// Takes the path that the user picked.
    fn poll(&mut self) {
        if let Some(JobEvent::Done(result)) = self.picking.as_mut().and_then(Job::poll) {
            self.picking = None;
            if let Ok(Some(path)) = result {
                self.request.scene = path.with_extension("safetensors");
            }
        }
    }

    fn pick(&mut self, ctx: &Context) {
        let at = self.request.scene.clone();
        self.picking = Some(Job::start("file dialog", ctx, move |_| {
            let dialog = rfd::FileDialog::new().set_title("Save the reconstruction as");
            let dialog = dialog.set_directory(at.parent().unwrap_or(Path::new("")));
            let name = at.file_name().unwrap_or_default().to_string_lossy();
            Ok(dialog.set_file_name(name).add_filter("Reconstructions", &["safetensors"]).save_file())
        }));
    }
}

/// Returns the path of a scene file that does not exist yet, so that nothing is overwritten.
fn free_file(folder: &Path, name: &str) -> PathBuf {
    let numbered = |i: usize| if i == 1 { name.to_owned() } else { format!("{name}-{i}") };
    let path = |i| folder.join(format!("{}.safetensors", numbered(i)));
    (1..1000).map(path).find(|p| !p.exists()).unwrap_or_else(|| path(1000))
}

/// Training in the background.
pub(crate) struct Training {
    pub(super) job: Job<PathBuf>,
    recording: PathBuf,
    pub(super) curve: LossCurve,
    backend: Arc<dyn Backend>,
    /// Available memory, bytes, and the time of that reading, seconds.
    memory: Option<(u64, f64)>,
    /// Time at which the window was asked to close, seconds. Closing waits until the scene is saved.
    closing_since: Option<f64>,
}

impl Training {
    fn start(backend: Arc<dyn Backend>, request: TrainRequest, ctx: &Context) -> Self {
        let (theirs, recording) = (backend.clone(), request.recording.clone());
        let job = Job::start("training", ctx, move |job| theirs.reconstruct(&request, job));
        Self { job, recording, curve: LossCurve::default(), backend, memory: None, closing_since: None }
    }

    /// Returns `true` if this is the training on the recording of `info`.
    fn is_about(&self, info: &Info) -> bool {
        info.recording.as_ref() == Some(&self.recording)
    }

    /// Reads the available memory, at most once a second.
    fn watch_memory(&mut self, now: f64) {
        if self.memory.is_none_or(|(_, at)| now >= at + 1.0) {
            self.memory = self.backend.available_bytes().map(|bytes| (bytes, now));
        }
    }
}

/// Seconds after which another request to close the window is obeyed, without saving the scene.
const CLOSES_AFTER: f64 = 5.0;

impl ViewerApp {
    /// Starts training in the background.
    pub(super) fn start_training(&mut self, request: TrainRequest, ctx: &Context) {
        self.training = Some(Training::start(self.backend.clone(), request, ctx));
    }

    /// Returns `true` if the shown recording is being reconstructed: it or its latest preview is shown, but
    /// not a finished scene.
    pub(super) fn is_reconstructing(&self) -> bool {
        let shown = self.info().map(|i| &i.path);
        self.training.as_ref().is_some_and(|t| Some(&t.recording) == shown)
    }

    pub(super) fn poll_training(&mut self, ctx: &Context) {
        while let Some(event) = self.training.as_mut().and_then(|t| t.job.poll()) {
            match event {
                JobEvent::Progress(_) => {}
                JobEvent::Step(step, terms) => {
                    if let Some(training) = &mut self.training {
                        training.curve.push(step, terms);
                    }
                }
                JobEvent::Preview(source) if self.is_reconstructing() => self.show_preview(source),
                JobEvent::Preview(_) => {}
                JobEvent::Done(result) => self.end_training(result, ctx),
            }
        }
    }

    /// Opens the finished scene, unless something else is shown or the window is busy.
    fn end_training(&mut self, result: Result<PathBuf>, ctx: &Context) {
        let shows_preview = self.is_reconstructing() && self.info().is_some_and(|i| i.has_reconstruction);
        let Some(training) = self.training.take() else { return };
        let is_lost = !matches!(result, Ok(_) | Err(Error::Cancelled));
        if training.closing_since.is_some() && !is_lost {
            ctx.send_viewport_cmd(egui::ViewportCommand::Close);
        }
        if let Ok(scene) = &result {
            self.preferences.remember(scene);
        }
        let is_busy = self.opening.is_some() || self.export.is_some() || self.quality.is_some();
        match self.settle(result) {
            Some(scene) if !is_busy && self.info().is_some_and(|i| training.is_about(i)) => {
                self.open_path(&scene, ctx)
            }
            Some(scene) => self.reconstructed = Some(scene),
            // No file holds what the last preview shows, so the recording is opened again.
            None if shows_preview => {
                let problem = self.problem.take();
                self.open_path(&training.recording, ctx);
                self.problem = problem;
            }
            None => {}
        }
    }

    /// Delays closing the window until the scene is saved.
    pub(super) fn hold_close(&mut self, now: f64, ctx: &Context) {
        let is_asked = ctx.input(|i| i.viewport().close_requested());
        let Some(training) = self.training.as_mut().filter(|_| is_asked) else { return };
        if !training.job.is_cancelling() {
            training.job.cancel();
        }
        if now < *training.closing_since.get_or_insert(now) + CLOSES_AFTER {
            ctx.send_viewport_cmd(egui::ViewportCommand::CancelClose);
        }
    }
}

/// Available memory below which the system may end training, bytes.
const LOW_MEMORY: u64 = 600_000_000;

/// Returns a warning, if little memory is left.
fn memory_warning(available_bytes: u64) -> Option<String> {
    (available_bytes < LOW_MEMORY).then(|| {
        let megabytes = available_bytes / 1_000_000;
        format!(
            "Only {megabytes} MB of memory are left: close other programs, or stop and keep what was learned."
        )
    })
}

/// Shows the section of the right panel: an offer to reconstruct, or the progress.
pub(crate) fn training_ui(ui: &mut Ui, app: &mut ViewerApp) {
    reconstructed_ui(ui, app);
    let is_offered = app.info().is_some_and(|i| !i.has_reconstruction && i.has_original);
    if app.training.is_none() && !is_offered {
        return;
    }
    let is_about_shown = app.training.as_ref().zip(app.info()).is_some_and(|(t, info)| t.is_about(info));
    let frame = Frame::new().fill(theme::RAISED).corner_radius(8).inner_margin(Margin::same(12));
    frame.show(ui, |ui| {
        ui.set_width(ui.available_width());
        match &mut app.training {
            Some(training) => {
                training.watch_memory(ui.input(|i| i.time));
                progress_ui(ui, training, is_about_shown);
            }
            None => offer_ui(ui, app),
        }
    });
    ui.add_space(10.0);
}

fn offer_ui(ui: &mut Ui, app: &mut ViewerApp) {
    if let Some(making) = app.waiting_for().filter(|_| app.is_making_demo()) {
        ui.label(making);
        ui.label(caption("It is reconstructed as soon as it is there."));
        return;
    }
    ui.label("This recording has not been reconstructed yet.");
    ui.add_space(4.0);
    let button = egui::Button::new(RichText::new(entry(Command::Reconstruct).label).size(17.0));
    let size = [ui.available_width(), 40.0];
    let can_start = app.is_enabled(Command::Reconstruct);
    let response = ui.add_enabled_ui(can_start, |ui| ui.add_sized(size, button.fill(theme::SELECTION))).inner;
    if response.on_hover_text(tooltip(Command::Reconstruct)).clicked() {
        app.run(Command::Reconstruct.into(), &ui.ctx().clone());
    }
}

/// Offers to open a finished reconstruction while something else is shown.
fn reconstructed_ui(ui: &mut Ui, app: &mut ViewerApp) {
    let Some(scene) = app.reconstructed.clone() else { return };
    let name = scene.file_name().unwrap_or_default().to_string_lossy();
    ui.label(format!("{name} is reconstructed."));
    ui.horizontal(|ui| {
        if ui.add(main_button("Open it")).clicked() {
            app.open_path(&scene, &ui.ctx().clone());
        }
        if ui.button("Not now").clicked() {
            app.reconstructed = None;
        }
    });
    ui.add_space(10.0);
}

fn progress_ui(ui: &mut Ui, training: &Training, is_about_shown: bool) {
    let progress = &training.job.progress;
    let what = match training.recording.file_name() {
        Some(name) if !is_about_shown => format!("Reconstructing {}", name.to_string_lossy()),
        _ => "Reconstructing".into(),
    };
    let stage = if progress.stage.is_empty() { "Starting" } else { &progress.stage };
    ui.label(RichText::new(format!("{what}: {stage}")).strong());
    ui.add(ProgressBar::new(progress.fraction()).desired_height(10.0).fill(theme::ACCENT));
    // The lines below appear, vanish and wrap; buttons must not move under the pointer.
    ui.horizontal(|ui| stop_ui(ui, training));
    preview_ui(ui, training);
    let left = match progress.seconds_left() {
        _ if progress.is_unsaved() => "tried every second".into(),
        _ if training.job.is_paused() => "paused".into(),
        Some(seconds) => format!("about {} left", duration(seconds)),
        None => "estimating the time…".into(),
    };
    let steps = format!("{} of {}", thousands(progress.done), thousands(progress.total));
    let elapsed = format!("{} so far", duration(progress.seconds));
    ui.label(caption(format!("{steps}  ·  {elapsed}  ·  {left}")));
    if !progress.detail.is_empty() {
        ui.label(caption(&progress.detail));
    }
    if training.closing_since.is_some() {
        let what = "The window closes once what was learned is saved. Close it again to give that up.";
        ui.label(RichText::new(what).font(theme::small()).color(theme::AMBER));
    }
    if let Some(warning) = training.memory.and_then(|(bytes, _)| memory_warning(bytes)) {
        ui.label(RichText::new(warning).font(theme::small()).color(theme::AMBER));
    }
    loss_curve_ui(ui, &training.curve);
}

fn stop_ui(ui: &mut Ui, training: &Training) {
    let job = &training.job;
    let is_unsaved = job.progress.is_unsaved();
    let is_stopping = job.is_cancelling() && !is_unsaved;
    let is_paused = job.is_paused();
    let tip = "Rests, so that the computer is free for something else";
    let pause = egui::Button::new(if is_paused { "Go on" } else { "Pause" });
    if ui.add_enabled(!is_stopping && !is_unsaved, pause).on_hover_text(tip).clicked() {
        job.set_paused(!is_paused);
    }
    let label = match (is_unsaved, is_stopping) {
        (true, _) => "Give up what was learned",
        (_, true) => "Stopping…",
        _ => "Stop and keep what was learned",
    };
    if ui.add_enabled(!is_stopping, egui::Button::new(label)).clicked() {
        job.cancel();
    }
}

/// Shows the choice of the time between previews, each of which takes time from training.
fn preview_ui(ui: &mut Ui, training: &Training) {
    ui.horizontal(|ui| {
        ui.label(caption("Preview"));
        let mut seconds = training.job.preview_seconds();
        let tip = "How often the picture shows how far it is; each time costs training a moment".to_owned();
        let paces = [(1, "1 s"), (4, "4 s"), (20, "20 s"), (0, "off")];
        choice(ui, &mut seconds, &paces.map(|(pace, label)| (pace, label, tip.clone(), true)));
        training.job.set_preview_seconds(seconds);
    });
}

/// Shows the dialog before training: the quality, and the file to write.
pub(crate) fn train_dialog_ui(ctx: &Context, app: &mut ViewerApp) {
    let Some(mut asked) = app.train_dialog.take() else { return };
    asked.poll();
    let ((starts, is_cancelled), is_closed) = dialog(ctx, "reconstruct", 460.0, |ui| {
        ui.heading("Reconstruct this recording");
        ui.label(RichText::new("You can go on watching the recording meanwhile.").color(theme::TEXT_WEAK));
        ui.add_space(8.0);
        for (steps, label) in QUALITIES {
            ui.radio_value(
                &mut asked.request.iterations,
                steps,
                format!("{label}  ({} steps)", thousands(steps)),
            );
        }
        ui.add_space(8.0);
        let note = if asked.has_labels {
            "Its class labels are used, so that words can be found in it."
        } else {
            "It has no class labels: pictures and depth will work, finding words will not."
        };
        ui.label(RichText::new(note).color(if asked.has_labels { theme::TEXT } else { theme::AMBER }));
        if let Some(warning) = &asked.too_long {
            ui.label(RichText::new(warning).font(theme::small()).color(theme::AMBER));
        }
        if let Some(warning) = app.backend.available_bytes().and_then(memory_warning) {
            ui.label(RichText::new(warning).color(theme::AMBER));
        }
        ui.add_space(4.0);
        ui.horizontal(|ui| {
            if ui.add_enabled(asked.picking.is_none(), egui::Button::new("Save as…")).clicked() {
                asked.pick(ctx);
            }
            ui.add(egui::Label::new(caption(asked.request.scene.display().to_string())).truncate());
        });
        ui.add_space(10.0);
        ui.horizontal(|ui| {
            let start = ui.add(main_button("Start")).clicked();
            (start, ui.button("Cancel").clicked())
        })
        .inner
    });
    if starts {
        app.start_training(asked.request, ctx);
    } else if !is_cancelled && !is_closed {
        app.train_dialog = Some(asked);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_scene_is_written_over() {
        let folder = tempfile::tempdir().unwrap();
        assert_eq!(free_file(folder.path(), "clip"), folder.path().join("clip.safetensors"));
        std::fs::write(folder.path().join("clip.safetensors"), "").unwrap();
        assert_eq!(free_file(folder.path(), "clip"), folder.path().join("clip-2.safetensors"));
    }
}
