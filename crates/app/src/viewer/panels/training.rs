//! Reconstruction of a recording in the window: a dialog first, then the progress beside the picture.

use crate::viewer::{
    action::Action,
    backend::{
        Backend, SCENE, TrainRequest, Words,
        earlier::{Earlier, StoppedScene, new_features_beside},
        paths::{PathAsk, PathKind, free_path, taken, with_extension},
    },
    command::{Command, entry},
    panels::{
        loss_curve::loss_curve_ui,
        models::{ModelsForm, words_ui},
        picking::Picking,
        widgets::{Icon, caption, choice, dialog_with_footer, icon_button, main_button, path_field},
    },
    shared::{Dialog, Shared},
    state::reconstruction::Training,
    text::{about, duration, thousands},
    theme,
};
use egui::{CollapsingHeader, Context, Frame, Margin, ProgressBar, RichText, Ui};
use std::{path::PathBuf, sync::Arc};
use surgtpgs_core::train::{Quality, TrainSettings};

/// Returns the name of a quality, and its purpose.
fn label(quality: Quality) -> (&'static str, &'static str) {
    match quality {
        Quality::Quick => ("Quick look", "to see whether it works"),
        Quality::Standard => ("Standard", "good enough to work with"),
        Quality::Best => ("Best", "more detail"),
    }
}

/// Questions before training.
struct Asked {
    request: TrainRequest,
    has_labels: bool,
    /// Expected duration of each quality, seconds; `None` before the first training on this computer.
    expected_seconds: [Option<f64>; Quality::ALL.len()],
    /// Number of parts that the recording is learned in.
    chapters: usize,
    /// The networks to choose, and their check.
    models: ModelsForm,
    /// Scene whose training was stopped. Its file is offered, and replaced, if that can be gone on with.
    stopped: Option<StoppedScene>,
    /// File that is offered otherwise.
    free: PathBuf,
    /// File that was offered last.
    offered: PathBuf,
    /// File that the user agreed to replace.
    agreed: Option<PathBuf>,
    picking: Picking,
}

impl Asked {
    /// Makes the dialog; `None` where the recording is not at hand.
    fn new(shared: &Shared) -> Option<Self> {
        let info = shared.info()?;
        let (recording, name) = (info.recording.clone()?, &info.name);
        let planned = shared.reconstruction.planned_scenes();
        let Earlier { stopped, features } = Earlier::on(info);
        let stopped = stopped.filter(|stopped| !planned.contains(&stopped.path));
        let free = free_path(&info.output_folder, name, SCENE, &planned);
        let models = ModelsForm::new(shared.preferences.models.clone(), recording.clone(), features);
        let words = if info.has_labels {
            Words::Labels
        } else if models.is_known() {
            Words::Models(models.chosen.clone())
        } else {
            Words::Nothing
        };
        let excluded = shared.document.excluded().to_vec();
        let quality = stopped.as_ref().and_then(|stopped| stopped.quality(&excluded)).unwrap_or_default();
        let (scene, replaces, features) = (free.clone(), false, None);
        let request = TrainRequest { recording, scene, replaces, quality, excluded, words, features };
        let pace = shared.preferences.seconds_per_step_and_pixel;
        let expected = |quality: Quality| {
            pace.map(|pace| quality.expected_seconds(info.num_frames, [info.width, info.height], Some(pace)))
        };
        Some(Self {
            request,
            has_labels: info.has_labels,
            chapters: TrainSettings::default().expected_chapters(info.num_frames),
            expected_seconds: Quality::ALL.map(expected),
            models,
            stopped,
            offered: free.clone(),
            free,
            agreed: None,
            picking: Picking::default(),
        })
    }

    /// Takes the path that the user picked.
    fn poll(&mut self) {
        if let Some(path) = self.picking.poll() {
            self.request.scene = with_extension(&path, SCENE);
            // The system's dialog asks about the name that it returns.
            self.agreed = Some(path);
        }
    }

    fn pick(&mut self, backend: Arc<dyn Backend>, ctx: &Context) {
        let kind = |name| PathKind::Save(name, "Reconstructions");
        let ask = PathAsk::save("Save the reconstruction as", &self.asked_request().scene, kind);
        self.picking.ask(ask, backend, ctx);
    }

    /// Returns the file of the scene whose training is gone on with; `None` if it would begin anew.
    fn resumed(&self) -> Option<&PathBuf> {
        let TrainRequest { quality, excluded, words, .. } = &self.request;
        let goes_on = |stopped: &&StoppedScene| {
            stopped.quality(excluded).as_ref() == Some(quality) && stopped.finds(words)
        };
        self.stopped.as_ref().filter(goes_on).map(|stopped| &stopped.path)
    }

    /// Offers the file that fits the choices, unless the user chose another one.
    fn offer(&mut self) {
        let offer = self.resumed().unwrap_or(&self.free).clone();
        let before = std::mem::replace(&mut self.offered, offer);
        if self.request.scene == before {
            self.request.scene.clone_from(&self.offered);
        }
    }

    /// Returns what is asked for: with the extension of a scene, and to replace what is gone on with or what
    /// the user agreed to.
    fn asked_request(&self) -> TrainRequest {
        let scene = with_extension(&self.request.scene, SCENE);
        let replaces = self.resumed() == Some(&scene) || self.agreed.as_ref() == Some(&scene);
        TrainRequest { replaces, scene, ..self.request.clone() }
    }

    /// Returns the request to start, with the folder for what networks find: nothing that others found is
    /// replaced.
    fn started_request(&self) -> TrainRequest {
        let request = self.asked_request();
        let found = || self.models.found().cloned().unwrap_or_else(|| new_features_beside(&request.scene));
        let features = matches!(request.words, Words::Models(_)).then(found);
        TrainRequest { features, ..request }
    }

    /// Says why the scene cannot be saved under its name; `None` if it can. Other scenes are `planned`.
    fn fault(&self, planned: &[PathBuf]) -> Option<String> {
        let TrainRequest { scene, replaces, .. } = self.asked_request();
        if planned.contains(&scene) {
            return Some(format!("{} is being made already: choose another name.", scene.display()));
        }
        taken(&scene).filter(|_| !replaces)
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

/// Shows the section of the right panel and of the start page: what is finished, the progress, and an offer
/// to reconstruct.
pub(crate) fn training_ui(ui: &mut Ui, shared: &Shared, actions: &mut Vec<Action>) {
    reconstructed_ui(ui, shared, actions);
    let is_bare = shared.info().is_some_and(|i| !i.has_reconstruction && i.has_original);
    let is_offered = is_bare && shared.will_find_words().is_none();
    let training = shared.reconstruction.training.as_ref();
    if training.is_none() && !is_offered {
        return;
    }
    let frame = Frame::new().fill(theme::RAISED).corner_radius(8).inner_margin(Margin::same(12));
    frame.show(ui, |ui| {
        ui.set_width(ui.available_width());
        if let Some(training) = training {
            progress_ui(ui, shared, training);
            queue_ui(ui, shared, actions);
        }
        if training.is_some() && is_offered {
            ui.separator();
        }
        if is_offered {
            offer_ui(ui, shared, actions);
        }
    });
    ui.add_space(10.0);
}

fn offer_ui(ui: &mut Ui, shared: &Shared, actions: &mut Vec<Action>) {
    if let Some(making) = shared.opening.waiting_for().filter(|_| shared.opening.is_making_demo()) {
        ui.label(making);
        ui.label(caption("It is reconstructed as soon as it is there."));
        return;
    }
    let size = [ui.available_width(), 40.0];
    let large = |label: &str| egui::Button::new(RichText::new(label).size(17.0)).fill(theme::SELECTION);
    let reconstruct = entry(Command::Reconstruct).label;
    let can_start = shared.is_enabled(Command::Reconstruct);
    let response = if let Some(made) = shared.info().and_then(|info| info.made_before.as_ref()) {
        ui.label("This recording was reconstructed before.");
        ui.add_space(4.0);
        let response = ui.add_sized(size, large("Open the reconstruction"));
        if response.on_hover_text(shared.path_name(made)).clicked() {
            actions.push(Action::Open(made.clone()));
        }
        ui.add_enabled(can_start, egui::Button::new(reconstruct))
    } else {
        ui.label("This recording has not been reconstructed yet.");
        ui.add_space(4.0);
        ui.add_enabled_ui(can_start, |ui| ui.add_sized(size, large(reconstruct))).inner
    };
    let obstacle = shared.obstacle(Command::Reconstruct).unwrap_or_default();
    let response = response.on_disabled_hover_text(obstacle);
    if response.on_hover_text(shared.tooltip(Command::Reconstruct)).clicked() {
        actions.push(Action::Run(Command::Reconstruct));
    }
}

/// Offers to open finished reconstructions while something else is shown, or the window is busy.
fn reconstructed_ui(ui: &mut Ui, shared: &Shared, actions: &mut Vec<Action>) {
    for scene in &shared.reconstruction.finished {
        ui.label(format!("{} is reconstructed.", shared.path_name(scene)));
        ui.horizontal(|ui| {
            if ui.add(main_button("Open it")).clicked() {
                actions.push(Action::Open(scene.clone()));
            }
            if ui.button("Not now").clicked() {
                actions.push(Action::ForgetFinished(scene.clone()));
            }
        });
        ui.add_space(10.0);
    }
}

fn progress_ui(ui: &mut Ui, shared: &Shared, training: &Training) {
    let progress = &training.task.progress;
    let what = if shared.info().is_some_and(|info| training.is_about(info)) {
        "Reconstructing".into()
    } else {
        format!("Reconstructing {}", shared.path_name(&training.recording))
    };
    let stage = if progress.stage.is_empty() { "Starting" } else { &progress.stage };
    ui.label(RichText::new(format!("{what}: {stage}")).strong());
    ui.add(ProgressBar::new(training.fraction()).desired_height(10.0).fill(theme::ACCENT));
    // The lines below appear, vanish and wrap; buttons must not move under the pointer.
    ui.horizontal_wrapped(|ui| stop_ui(ui, training));
    preview_ui(ui, training);
    let left = match training.seconds_left() {
        _ if progress.is_unsaved() => "tried every second".into(),
        _ if training.task.is_paused() => "paused".into(),
        Some(seconds) => format!("{} left", about(seconds)),
        None => "estimating the time…".into(),
    };
    let elapsed = format!("{} so far", duration(training.seconds()));
    ui.label(caption(format!("{:.0} %  ·  {elapsed}  ·  {left}", 100.0 * training.fraction())));
    if training.closing_since.is_some() {
        let what = "The window closes once what was learned is saved. Close it again to give that up.";
        ui.label(RichText::new(what).font(theme::small()).color(theme::AMBER));
    }
    if let Some(warning) = training.memory.and_then(|(bytes, _)| memory_warning(bytes)) {
        ui.label(RichText::new(warning).font(theme::small()).color(theme::AMBER));
    }
    CollapsingHeader::new(caption("Details of the training")).show(ui, |ui| {
        let steps = format!("step {} of {}", thousands(progress.done), thousands(progress.total));
        let detail =
            if progress.detail.is_empty() { steps } else { format!("{steps}  ·  {}", progress.detail) };
        ui.label(caption(detail));
        loss_curve_ui(ui, &training.curve);
    });
}

/// Shows the recordings that wait to be reconstructed.
fn queue_ui(ui: &mut Ui, shared: &Shared, actions: &mut Vec<Action>) {
    for (index, request) in shared.reconstruction.queue.iter().enumerate() {
        ui.horizontal(|ui| {
            let name = shared.path_name(&request.recording);
            let label = format!("Do not reconstruct {name}");
            if icon_button(ui, Icon::Cross, &label, "Takes it out of those that wait", false, true).clicked()
            {
                actions.push(Action::Unqueue(index));
            }
            ui.add(egui::Label::new(caption(format!("Then {name}"))).truncate());
        });
    }
}

fn stop_ui(ui: &mut Ui, training: &Training) {
    let task = &training.task;
    let is_unsaved = task.progress.is_unsaved();
    let is_stopping = task.is_cancelling() && !is_unsaved;
    let is_paused = task.is_paused();
    let tip = "Rests, so that the computer is free for something else";
    let pause = egui::Button::new(if is_paused { "Go on" } else { "Pause" });
    if ui.add_enabled(!is_stopping && !is_unsaved, pause).on_hover_text(tip).clicked() {
        task.set_paused(!is_paused);
    }
    let label = match (is_unsaved, is_stopping) {
        (true, _) => "Give up what was learned",
        (_, true) => "Stopping…",
        _ if training.is_preparing() && training.features.is_some() => "Stop and keep what was found",
        _ if training.is_preparing() => "Stop",
        _ => "Stop and keep what was learned",
    };
    if ui.add_enabled(!is_stopping, egui::Button::new(label)).clicked() {
        if is_unsaved { task.give_up() } else { task.cancel() }
    }
}

/// Shows the choice of the time between previews, each of which takes time from training.
fn preview_ui(ui: &mut Ui, training: &Training) {
    ui.horizontal(|ui| {
        ui.label(caption("Preview"));
        let mut seconds = training.task.preview_seconds();
        let tip = "How often the picture shows how far it is; each time costs training a moment".to_owned();
        let paces = [(1, "1 s"), (4, "4 s"), (20, "20 s"), (0, "off")];
        choice(ui, &mut seconds, &paces.map(|(pace, label)| (pace, label, tip.clone(), true)));
        training.task.set_preview_seconds(seconds);
    });
}

/// The dialog before training: the quality, and the file to write.
#[derive(Default)]
pub(crate) struct TrainDialog {
    asked: Option<Asked>,
}

impl TrainDialog {
    /// Shows the dialog, if it is open.
    pub(crate) fn ui(&mut self, ctx: &Context, shared: &Shared, actions: &mut Vec<Action>) {
        if shared.dialog != Some(Dialog::Reconstruct) {
            self.asked = None;
            return;
        }
        let recording = shared.info().and_then(|info| info.recording.as_ref());
        let asked = match self.asked.take() {
            // Something else may have been opened meanwhile.
            Some(asked) => Some(asked).filter(|asked| Some(&asked.request.recording) == recording),
            None => Asked::new(shared),
        };
        let Some(mut asked) = asked else {
            actions.push(Action::CloseDialog);
            return;
        };
        asked.poll();
        let memory = shared.backend.available_bytes().and_then(memory_warning);
        let content = |ui: &mut Ui| (asked_ui(ui, &mut asked, shared, memory), asked);
        let footer =
            |ui: &mut Ui, (is_ready, asked): (bool, Asked)| (start_ui(ui, &asked, is_ready, shared), asked);
        let (((starts, is_cancelled), asked), is_closed) =
            dialog_with_footer(ctx, "reconstruct", 560.0, content, footer);
        if starts {
            if let Words::Models(models) = asked.request.words.clone() {
                actions.push(Action::prefer(move |p| p.models = models));
            }
            actions.push(Action::Train(asked.started_request()));
        }
        if starts || is_cancelled || is_closed {
            actions.push(Action::CloseDialog);
        }
        self.asked = Some(asked);
    }
}

/// Shows the questions; returns `true` if what words are found by can be used.
fn asked_ui(ui: &mut Ui, asked: &mut Asked, shared: &Shared, memory_warning: Option<String>) -> bool {
    ui.heading("Reconstruct this recording");
    ui.label(RichText::new("You can go on watching the recording meanwhile.").color(theme::TEXT_WEAK));
    ui.add_space(8.0);
    for (quality, seconds) in Quality::ALL.into_iter().zip(asked.expected_seconds) {
        let (label, purpose) = label(quality);
        let time = seconds.map_or_else(String::new, |seconds| format!(", {}", about(seconds)));
        let text = format!("{label}: {purpose}{time}");
        ui.radio_value(&mut asked.request.quality, quality, text);
    }
    ui.add_space(8.0);
    let is_ready =
        words_ui(ui, &mut asked.request.words, asked.has_labels, &mut asked.models, &shared.backend);
    asked.offer();
    if matches!(asked.request.words, Words::Models(_)) && asked.models.found().is_some() {
        ui.label(caption("What these networks found in it before is used again."));
    }
    if asked.chapters > 1 {
        ui.label(caption(format!(
            "It is long, and is reconstructed in about {} parts, one after the other. Parts that are done can be \
             watched and searched while the next ones are made.",
            asked.chapters
        )));
    }
    if let Some(warning) = memory_warning {
        ui.label(RichText::new(warning).color(theme::AMBER));
    }
    ui.add_space(4.0);
    ui.horizontal(|ui| {
        if asked.picking.button_ui(ui, "Save as…").clicked() {
            asked.pick(shared.backend.clone(), ui.ctx());
        }
        path_field(ui, "File of the reconstruction", &mut asked.request.scene);
    });
    asked.picking.note_ui(ui);
    if asked.resumed().is_some_and(|scene| *scene == asked.asked_request().scene) {
        ui.label(caption(
            "It was stopped before its end. Parts that are done are kept, and it goes on with the others.",
        ));
    }
    is_ready
}

/// Shows the buttons, and why it cannot be started; returns whether to start and to cancel were pressed.
fn start_ui(ui: &mut Ui, asked: &Asked, is_ready: bool, shared: &Shared) -> (bool, bool) {
    let fault = asked.fault(&shared.reconstruction.planned_scenes());
    if let Some(why) = &fault {
        ui.label(RichText::new(why).font(theme::small()).color(theme::AMBER));
    }
    ui.add_space(10.0);
    ui.horizontal(|ui| {
        let label = if shared.reconstruction.training.is_some() { "Start after the others" } else { "Start" };
        let start = ui.add_enabled(is_ready && fault.is_none(), main_button(label)).clicked();
        (start, ui.button("Cancel").clicked())
    })
    .inner
}
