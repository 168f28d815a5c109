//! State of the window, and its update: takes results from the threads, carries out commands, shows the
//! panels, and requests the next picture.

use super::{
    areas::{Areas, Curve, Measure},
    autosave::Autosave,
    command::{self, Command},
    document::{Document, Look, PREVIEW, Prompt, PromptId, ViewMode},
    export_dialog::ExportDialog,
    help::Sheet,
    import_check::ImportCheck,
    jobs::{Job, JobEvent},
    keep::Saved,
    key_router::KeyRouter,
    keymap,
    orbit::Orbit,
    pipeline::{AskedPrompt, Finding, Picture, Request},
    playback::Playback,
    preferences::Preferences,
    quality::Quality,
    ruler::Ruler,
    session::Session,
    shown::Shown,
    source::{Backend, Demo, FrameSource, Info, TrainRequest, View},
    theme,
    training::{TrainDialog, Training},
    worker::Worker,
    zoom::Panes,
};
use egui::{Context, Ui};
use std::{
    path::{Path, PathBuf},
    sync::Arc,
};
use surgtpgs_core::{files::absolute_path, sequence::names_instrument};

/// Duration above which pictures are made at half size while something moves, milliseconds.
const SLOW_MS: f64 = 60.0;

/// State of the whole window.
pub(crate) struct ViewerApp {
    pub(super) backend: Arc<dyn Backend>,
    pub(super) preferences: Preferences,
    pub(super) document: Document,
    pub(super) playback: Playback,
    pub(super) panes: Panes,
    /// Position of the wipe's dividing line, as share of the width.
    pub(super) wipe: f32,
    pub(super) prompt_box: PromptBox,
    /// Prompt whose menu is open, or was open last.
    pub(super) prompt_menu: Option<PromptId>,
    pub(super) open: Option<Open>,
    pub(super) opening: Option<Opening>,
    pub(super) picking: Option<Job<Option<PathBuf>>>,
    demo: Option<Job<Demo>>,
    pub(super) train_dialog: Option<TrainDialog>,
    pub(super) training: Option<Training>,
    /// Finished reconstruction that was not opened, because something else was shown or the window was busy.
    pub(super) reconstructed: Option<PathBuf>,
    pub(super) import_check: Option<ImportCheck>,
    pub(super) export: Option<ExportDialog>,
    pub(super) quality: Option<Quality>,
    pub(super) sheet: Option<Sheet>,
    /// Command whose key is being chosen on the shortcut sheet.
    pub(super) choosing_key: Option<Command>,
    pub(super) ruler: Option<Ruler>,
    /// Phrase being typed in the dialog "What prompts are compared with"; `None` while it is closed.
    pub(super) comparison_sheet: Option<String>,
    /// Point of the picture that is probed, as share of its width and height.
    pub(super) probe: Option<[f32; 2]>,
    /// `true` if the list of bookmarks is open.
    pub(super) shows_bookmarks: bool,
    pub(super) saved: Saved,
    pub(super) saving: Option<Job<Option<PathBuf>>>,
    /// Session to apply once its scene or recording is open, and the session's file.
    pub(super) session_to_apply: Option<(Session, Option<PathBuf>)>,
    pub(super) autosave: Autosave,
    /// `true` if the offer to restore unsaved work is put off, at most until the next start.
    pub(super) is_recovery_put_off: bool,
    /// Number being typed in the dialog "Go to frame"; `None` while it is closed.
    pub(super) go_to: Option<String>,
    /// Latest problem, until it is dismissed.
    pub(super) problem: Option<String>,
    /// `true` if the user moves time or view during this update.
    pub(super) is_moving: bool,
    /// Training to start, without asking, once its recording is open (for the built-in demo).
    train_when_open: Option<TrainRequest>,
}

/// State of the text field for prompts.
#[derive(Debug, Default)]
pub(crate) struct PromptBox {
    pub(super) text: String,
    pub(super) wants_focus: bool,
    pub(super) is_focused: bool,
    /// Words of earlier prompts, newest first.
    pub(super) earlier: Vec<String>,
}

impl PromptBox {
    /// Returns the words being typed, which are looked for before they are added.
    pub(super) fn live(&self) -> &str {
        self.text.trim()
    }
}

/// The open scene or recording.
pub(crate) struct Open {
    pub(super) info: Info,
    worker: Worker,
    asked: Option<Request>,
    /// `None` while a passing state is shown, such as a preview of training.
    areas: Option<Areas>,
    pub(super) shown: Option<Shown>,
    /// Duration of the last picture at full size, milliseconds.
    full_ms: f64,
}

/// A scene or recording that is being opened.
pub(crate) struct Opening {
    pub(super) name: String,
    path: PathBuf,
    job: Job<Box<dyn FrameSource>>,
}

impl ViewerApp {
    pub(crate) fn new(
        ctx: &Context,
        backend: Arc<dyn Backend>,
        preferences: Preferences,
        autosave: Autosave,
    ) -> Self {
        theme::apply(ctx);
        // The keys for zooming are commands of the command table.
        ctx.options_mut(|o| o.zoom_with_keyboard = false);
        ctx.add_plugin(KeyRouter::default());
        keymap::apply(&preferences.keys);
        let threshold = surgtpgs_core::relevancy::RelevancySettings::default().threshold;
        Self {
            backend,
            document: Document::new(preferences.overlay, threshold),
            preferences,
            playback: Playback::new(1, None),
            panes: Panes::default(),
            wipe: 0.5,
            prompt_box: PromptBox::default(),
            prompt_menu: None,
            open: None,
            opening: None,
            picking: None,
            demo: None,
            train_dialog: None,
            training: None,
            reconstructed: None,
            import_check: None,
            export: None,
            quality: None,
            sheet: None,
            choosing_key: None,
            ruler: None,
            comparison_sheet: None,
            probe: None,
            shows_bookmarks: false,
            saved: Saved::default(),
            saving: None,
            session_to_apply: None,
            autosave,
            is_recovery_put_off: false,
            go_to: None,
            problem: None,
            is_moving: false,
            train_when_open: None,
        }
    }

    /// Opens a scene, a recording or a session in the background.
    pub(crate) fn open_path(&mut self, path: &Path, ctx: &Context) {
        // Remembered paths must mean the same wherever the program is started next.
        let path = &absolute_path(path);
        self.session_to_apply = None;
        // Opening something gives up the demo, even if it is still being made.
        self.demo = None;
        self.reconstructed.take_if(|scene| scene == path);
        if Session::is_file(path) {
            let session = Session::load(path);
            if let Some(session) = self.settle(session) {
                self.open_session(session, Some(path.to_owned()), ctx);
            }
            return;
        }
        let (backend, at) = (self.backend.clone(), path.to_owned());
        let job = Job::start("open", ctx, move |_| backend.open(&at));
        let name =
            path.file_name().map_or_else(|| path.display().to_string(), |n| n.to_string_lossy().into());
        self.opening = Some(Opening { name, path: path.to_owned(), job });
        self.problem = None;
    }

    /// Opens the built-in demo. If it is not in `work_dir`, it is made and reconstructed there first.
    pub(crate) fn open_demo(&mut self, work_dir: &Path, ctx: &Context) {
        let (backend, folder) = (self.backend.clone(), absolute_path(work_dir));
        self.demo = Some(Job::start("demo", ctx, move |job| backend.demo(&folder, job)));
    }

    /// Returns `true` while the demo is being made.
    pub(super) fn is_making_demo(&self) -> bool {
        self.demo.is_some()
    }

    /// Describes in words what is being made or opened.
    pub(super) fn waiting_for(&self) -> Option<String> {
        match (&self.demo, &self.opening) {
            (Some(job), _) => Some(match job.progress.total {
                0 => "Making the demo recording…".into(),
                total => format!("Making the demo recording… {} of {total} frames", job.progress.done),
            }),
            (_, Some(opening)) => Some(format!("Opening {}…", opening.name)),
            _ => None,
        }
    }

    pub(super) fn picture(&self) -> Option<&Picture> {
        Some(&self.open.as_ref()?.shown.as_ref()?.picture)
    }

    /// Returns what a prompt found in the shown picture; `None` until the prompt has been answered.
    pub(super) fn finding(&self, id: u64, text: &str) -> Option<&Finding> {
        self.picture()?.findings.iter().find(|f| f.id == id && f.text == text)
    }

    /// Returns the areas of all prompts on every frame, as far as they have been counted.
    pub(super) fn areas(&self) -> Option<&Areas> {
        self.open.as_ref()?.areas.as_ref()
    }

    /// Returns the area over time of the selected prompt.
    pub(super) fn selected_curve(&self) -> Option<Curve> {
        let prompt = self.document.prompt(self.document.selected?)?;
        self.areas()?.curve(&self.measure(prompt), prompt.threshold)
    }

    /// Returns the measure that is counted for a prompt on every frame.
    pub(super) fn measure(&self, prompt: &Prompt) -> Measure {
        let question = self.document.question(prompt);
        Measure::new(question, self.document.content().clean_up, prompt.threshold)
    }

    pub(super) fn info(&self) -> Option<&Info> {
        self.open.as_ref().map(|o| &o.info)
    }

    /// Updates and shows the window once.
    pub(crate) fn show(&mut self, ui: &mut Ui) {
        let ctx = ui.ctx().clone();
        let now = ctx.input(|i| i.time);
        self.is_moving = false;
        self.poll_jobs(&ctx);
        self.hold_close(now, &ctx);
        self.take_picture(&ctx);
        for invocation in KeyRouter::take(&ctx) {
            self.run(invocation, &ctx);
        }
        if let Some(path) = ctx.input(|i| i.raw.dropped_files.first().map(|f| f.path().to_owned())) {
            self.open_path(&path, &ctx);
        }
        self.playback.set_range(self.document.content().range);
        self.playback.advance(now);
        self.skip_excluded(now);
        ctx.set_zoom_factor(self.preferences.scale_percent as f32 / 100.0);
        super::layout::window_ui(ui, self);
        self.ask(&ctx);
        if let Some(wait) = self.playback.seconds_to_next(now) {
            ctx.request_repaint_after_secs(wait as f32);
        }
        self.keep_preferences(&ctx);
        self.keep_unsaved(now, &ctx);
    }

    /// Skips excluded frames while playing.
    fn skip_excluded(&mut self, now: f64) {
        let (frame, num_frames) = (self.playback.frame(), self.playback.num_frames());
        if self.playback.is_playing() && self.document.is_excluded(frame) {
            match self.document.next_included(frame, self.playback.speed() > 0.0, num_frames) {
                Some(next) => self.playback.seek(next, now),
                None => self.playback.pause(),
            }
        }
    }

    fn poll_jobs(&mut self, ctx: &Context) {
        if let Some(JobEvent::Done(result)) = self.picking.as_mut().and_then(Job::poll) {
            self.picking = None;
            if let Some(path) = self.settle(result).flatten() {
                self.open_path(&path, ctx);
            }
        }
        self.poll_demo(ctx);
        if let Some(JobEvent::Done(result)) = self.opening.as_mut().and_then(|o| o.job.poll())
            && let Some(opening) = self.opening.take()
        {
            match self.settle(result) {
                Some(source) => {
                    self.show_source(source, ctx);
                    self.begin_with(&opening.path, ctx);
                }
                None => self.session_to_apply = None,
            }
        }
        if let Some(check) = &mut self.import_check {
            check.poll();
        }
        self.poll_training(ctx);
        self.poll_saving();
        if let Some(problem) = self.quality.as_mut().and_then(Quality::poll) {
            self.quality = self.quality.take().filter(Quality::is_measured);
            self.problem = Some(problem);
        }
        if let Some(problem) = self.export.as_mut().and_then(ExportDialog::poll) {
            self.problem = Some(problem);
        }
    }

    /// Takes the demo from its job. It can be looked at while it is being made.
    fn poll_demo(&mut self, ctx: &Context) {
        match self.demo.as_mut().and_then(Job::poll) {
            Some(JobEvent::Preview(source)) => self.show_source(source, ctx),
            Some(JobEvent::Done(result)) => {
                self.demo = None;
                if let Some(demo) = self.settle(result) {
                    self.train_when_open = demo.train;
                    self.open_path(&demo.path, ctx);
                }
            }
            _ => {}
        }
    }

    /// Shows an intermediate state of training: beside the recorded frame, unless the user chose another
    /// view.
    pub(super) fn show_preview(&mut self, source: Box<dyn FrameSource>) {
        let Some(open) = &mut self.open else { return };
        if !open.info.has_reconstruction && self.document.mode == ViewMode::Original {
            self.document.mode = ViewMode::SideBySide;
        }
        open.info = source.info().clone();
        open.worker.replace(source);
        open.asked = None;
        open.areas = None;
    }

    /// Returns the value of a result, or shows its error as the problem.
    pub(super) fn settle<T>(&mut self, result: surgtpgs_core::Result<T>) -> Option<T> {
        result.map_err(|e| self.problem = Some(super::remedy::message(&e))).ok()
    }

    fn show_source(&mut self, source: Box<dyn FrameSource>, ctx: &Context) {
        let info = source.info().clone();
        let Some(worker) = self.settle(Worker::start(source, ctx)) else { return };
        let is_same_recording = self.info().is_some_and(|i| i.is_same_recording(&info));
        self.put_unsaved_aside(is_same_recording);
        let frame = if is_same_recording { self.playback.frame() } else { 0 };
        self.playback = Playback::new(info.num_frames, info.frames_per_second);
        self.playback.seek(frame, 0.0);
        if !is_same_recording {
            self.document.start_recording();
            self.saved = Saved::default();
        }
        self.document.look = Look::default();
        self.document.mode =
            if info.has_reconstruction { ViewMode::Reconstruction } else { ViewMode::Original };
        // A running export holds everything that it needs; any other export dialog is closed.
        self.export.take_if(|export| !export.is_running());
        self.quality = None;
        (self.ruler, self.probe) = (None, None);
        ctx.send_viewport_cmd(egui::ViewportCommand::Title(format!("{} – SurgTPGS", info.name)));
        let areas = Some(Areas::new(info.num_frames));
        self.open = Some(Open { info, worker, asked: None, areas, shown: None, full_ms: 0.0 });
    }

    /// Completes opening `path` once it is shown: applies its session, and starts its training or its check.
    fn begin_with(&mut self, path: &Path, ctx: &Context) {
        let session_file = self.session_to_apply.as_ref().and_then(|(_, file)| file.clone());
        self.preferences.remember(session_file.as_deref().unwrap_or(path));
        if self.session_to_apply.is_none() && self.autosave.recall(path) {
            self.is_recovery_put_off = false;
        }
        self.apply_session(0.0);
        let request = self.train_when_open.take().filter(|r| r.recording == *path);
        if let Some(request) = request.filter(|_| self.training.is_none()) {
            self.start_training(request, ctx);
        }
        let is_bare = !self.is_reconstructing() && self.info().is_some_and(|i| !i.has_reconstruction);
        let check = || ImportCheck::start(self.backend.clone(), path.to_owned(), ctx);
        self.import_check = is_bare.then(check);
    }

    fn take_picture(&mut self, ctx: &Context) {
        let Some(open) = &mut self.open else { return };
        for measured in open.worker.take_measured() {
            if let Some(areas) = &mut open.areas {
                areas.take(measured);
            }
        }
        let Some(picture) = open.worker.take() else { return };
        if !picture.request.view.is_preview {
            open.full_ms = picture.took_ms;
        }
        match &mut open.shown {
            Some(shown) => shown.update(picture, ctx),
            none => *none = Some(Shown::new(picture, ctx)),
        }
    }

    /// Requests the picture of the present state, unless it has been requested already.
    fn ask(&mut self, ctx: &Context) {
        let is_peeking = self.is_peeking(ctx);
        let Some(request) = self.request(is_peeking) else { return };
        let Some(open) = &mut self.open else { return };
        if open.asked.as_ref() != Some(&request) {
            open.worker.submit(request.clone());
            open.asked = Some(request);
        }
    }

    /// Returns `true` while only the recorded frame is to be shown.
    pub(super) fn is_peeking(&self, ctx: &Context) -> bool {
        command::is_held(ctx, Command::Peek) && self.info().is_some_and(|i| i.has_original)
    }

    /// Returns `true` if the view may be turned. Where a recorded frame is compared, both pictures must be
    /// seen from the same place.
    pub(super) fn may_orbit(&self) -> bool {
        let alone = self.document.mode.layer().is_some() || self.document.mode == ViewMode::Reconstruction;
        alone && self.info().is_some_and(|i| i.has_reconstruction)
    }

    fn request(&self, is_peeking: bool) -> Option<Request> {
        let open = self.open.as_ref()?;
        let mode = self.document.mode;
        let turned = self.document.look.orbit;
        let orbit = if self.may_orbit() && !turned.is_home() { turned } else { Orbit::default() };
        let is_moving = self.is_moving || self.playback.is_playing();
        Some(Request {
            view: View {
                frame: self.playback.frame(),
                orbit,
                is_preview: is_moving && open.full_ms > SLOW_MS,
            },
            needs_original: mode.needs_original() || is_peeking,
            needs_reconstruction: mode.needs_reconstruction(),
            layer: mode.layer(),
            needs_difference: mode == ViewMode::Difference,
            prompts: if open.info.has_features { self.asked_prompts() } else { Vec::new() },
            candidates: self.unmarked_words().iter().map(|text| self.document.bare_question(text)).collect(),
            look: self.document.overlay,
            clean_up: self.document.content().clean_up,
            point: self.probe.filter(|_| open.info.has_features),
        })
    }

    /// Returns the words whose scores are wanted without being drawn. If there are none and the prompt box
    /// has the focus, an example word is returned, so that the text encoder and the features are ready at the
    /// first letter.
    fn unmarked_words(&self) -> Vec<String> {
        let words = self.candidates();
        let rehearses = words.is_empty() && self.prompt_box.is_focused;
        let info = self.info().filter(|i| rehearses && i.has_features);
        info.map_or(words, |info| info.example_prompts.first().cloned().into_iter().collect())
    }

    /// Returns the visible prompts and the one being typed.
    fn asked_prompts(&self) -> Vec<AskedPrompt> {
        let asked = |p: &Prompt| AskedPrompt {
            id: p.id,
            question: self.document.question(p),
            threshold: p.threshold,
            colour: p.colour,
            is_instrument: p.is_instrument,
        };
        let mut prompts: Vec<AskedPrompt> =
            self.document.prompts().iter().filter(|p| p.is_visible).map(asked).collect();
        let live = self.prompt_box.live();
        if !live.is_empty() && !prompts.iter().any(|p| p.question.text.eq_ignore_ascii_case(live)) {
            prompts.push(AskedPrompt {
                id: PREVIEW,
                question: self.document.bare_question(live),
                threshold: self.document.default_threshold(),
                colour: self.document.next_colour(),
                is_instrument: names_instrument(live),
            });
        }
        prompts
    }

    /// Saves changed overlay choices once no mouse button is down.
    fn keep_preferences(&mut self, ctx: &Context) {
        let overlay = self.document.overlay;
        if self.preferences.overlay != overlay && !ctx.input(|i| i.pointer.any_down()) {
            self.preferences.overlay = overlay;
            self.preferences.save();
        }
    }
}

impl eframe::App for ViewerApp {
    fn ui(&mut self, ui: &mut Ui, _frame: &mut eframe::Frame) {
        self.show(ui);
    }

    fn on_exit(&mut self) {
        self.keep_at_exit();
    }
}
