//! The window's state and its heartbeat: take what threads made, obey commands, show panels, ask for the next picture.

use super::{
    command::{self, Command, Invocation},
    document::{Document, PREVIEW, ViewMode},
    export_dialog::ExportDialog,
    help::Sheet,
    jobs::{Job, JobEvent},
    key_router::KeyRouter,
    orbit::Orbit,
    pipeline::{AskedPrompt, Finding, Picture, Request},
    playback::Playback,
    preferences::Preferences,
    shown::Shown,
    source::{Backend, Demo, FrameSource, Info, TrainRequest, View},
    theme,
    training::{TrainDialog, Training},
    viewport::Zoom,
    worker::Worker,
};
use egui::{Context, Ui};
use std::{
    path::{Path, PathBuf},
    sync::Arc,
};

/// How long typing must rest before what was typed is looked for, seconds.
const TYPING_PAUSE: f64 = 0.15;
/// Pictures that take longer than this are made at half size while something moves, milliseconds.
const SLOW_MS: f64 = 60.0;

/// The whole window.
pub(crate) struct ViewerApp {
    pub(super) backend: Arc<dyn Backend>,
    pub(super) preferences: Preferences,
    pub(super) document: Document,
    pub(super) playback: Playback,
    pub(super) orbit: Orbit,
    pub(super) zoom: Zoom,
    /// Where the line of the wipe is, as share of the width.
    pub(super) wipe: f32,
    pub(super) prompt_box: PromptBox,
    pub(super) open: Option<Open>,
    pub(super) opening: Option<Opening>,
    picking: Option<Job<Option<PathBuf>>>,
    demo: Option<Job<Demo>>,
    pub(super) train_dialog: Option<TrainDialog>,
    pub(super) training: Option<Training>,
    pub(super) export: Option<ExportDialog>,
    pub(super) sheet: Option<Sheet>,
    /// The number being typed under "go to frame".
    pub(super) go_to: Option<String>,
    /// What went wrong last, until it is dismissed.
    pub(super) problem: Option<String>,
    /// The user is moving time or view just now.
    pub(super) is_moving: bool,
    /// The recording being opened is to be reconstructed without being asked (the built-in demo).
    train_when_open: Option<TrainRequest>,
}

/// The text field for prompts.
#[derive(Debug, Default)]
pub(crate) struct PromptBox {
    pub(super) text: String,
    /// When it was last typed in; `None` once the typing has been looked for.
    pub(super) edited_at: Option<f64>,
    /// The words that are looked for before they are added.
    pub(super) live: String,
    pub(super) wants_focus: bool,
}

/// What is open.
pub(crate) struct Open {
    pub(super) info: Info,
    worker: Worker,
    asked: Option<Request>,
    pub(super) shown: Option<Shown>,
    /// What the last picture at full size took, milliseconds.
    full_ms: f64,
}

/// Something is being opened.
pub(crate) struct Opening {
    pub(super) name: String,
    path: PathBuf,
    job: Job<Box<dyn FrameSource>>,
}

impl ViewerApp {
    pub(crate) fn new(ctx: &Context, backend: Arc<dyn Backend>, preferences: Preferences) -> Self {
        theme::apply(ctx);
        ctx.add_plugin(KeyRouter::default());
        let threshold = surgtpgs_core::relevancy::RelevancySettings::default().threshold;
        Self {
            backend,
            document: Document::new(preferences.style, preferences.opacity, threshold),
            preferences,
            playback: Playback::new(1, None),
            orbit: Orbit::default(),
            zoom: Zoom::default(),
            wipe: 0.5,
            prompt_box: PromptBox::default(),
            open: None,
            opening: None,
            picking: None,
            demo: None,
            train_dialog: None,
            training: None,
            export: None,
            sheet: None,
            go_to: None,
            problem: None,
            is_moving: false,
            train_when_open: None,
        }
    }

    /// Opens a scene or a recording in the background.
    pub(crate) fn open_path(&mut self, path: &Path, ctx: &Context) {
        let (backend, at) = (self.backend.clone(), path.to_owned());
        let job = Job::start("open", ctx, move |_| backend.open(&at));
        let name =
            path.file_name().map_or_else(|| path.display().to_string(), |n| n.to_string_lossy().into());
        self.opening = Some(Opening { name, path: path.to_owned(), job });
        self.problem = None;
    }

    /// Opens the built-in demo, which is made and reconstructed in `work_dir` first if it is not there.
    pub(crate) fn open_demo(&mut self, work_dir: &Path, ctx: &Context) {
        let (backend, folder) = (self.backend.clone(), work_dir.to_owned());
        self.demo = Some(Job::start("demo", ctx, move |job| backend.demo(&folder, job)));
    }

    /// What is being made ready, in words.
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

    /// What a prompt found in the picture that is shown; `None` as long as it has not been answered.
    pub(super) fn finding(&self, id: u64, text: &str) -> Option<&Finding> {
        self.picture()?.findings.iter().find(|f| f.id == id && f.text == text)
    }

    pub(super) fn info(&self) -> Option<&Info> {
        self.open.as_ref().map(|o| &o.info)
    }

    /// Whether a command can be given now.
    pub(super) fn is_enabled(&self, command: Command) -> bool {
        let info = self.info();
        let has = |f: fn(&Info) -> bool| info.is_some_and(f);
        match command {
            Command::OpenFile | Command::OpenFolder => self.picking.is_none(),
            Command::Quit | Command::FullScreen | Command::Shortcuts | Command::About => true,
            Command::Undo => self.document.undo_name().is_some(),
            Command::Redo => self.document.redo_name().is_some(),
            Command::Reconstruct => has(|i| i.has_original) && self.training.is_none(),
            Command::Export => has(|i| i.has_features) && self.training.is_none(),
            Command::FocusPrompt => has(|i| i.has_features),
            Command::Depth => has(|i| i.has_reconstruction),
            Command::SwapOriginal | Command::SideBySide | Command::Wipe => {
                has(|i| i.has_reconstruction && i.has_original)
            }
            _ => info.is_some(),
        }
    }

    /// Obeys a command, unless it cannot be given now.
    pub(super) fn run(&mut self, invocation: Invocation, ctx: &Context) {
        if !self.is_enabled(invocation.command) {
            return;
        }
        let now = ctx.input(|i| i.time);
        let swap = |a: ViewMode, b: ViewMode, now: ViewMode| if now == a { b } else { a };
        let mode = self.document.mode;
        match invocation.command {
            Command::OpenFile => self.pick(false, ctx),
            Command::OpenFolder => self.pick(true, ctx),
            Command::Reconstruct => self.train_dialog = self.info().map(TrainDialog::new),
            Command::Export => self.export = ExportDialog::new(self),
            Command::Quit => ctx.send_viewport_cmd(egui::ViewportCommand::Close),
            Command::Undo => self.document.undo(),
            Command::Redo => self.document.redo(),
            Command::PlayPause => self.playback.toggle(now),
            Command::StepBack => self.playback.step(-1),
            Command::StepForward => self.playback.step(1),
            Command::HopBack => self.playback.step(-command::HOP),
            Command::HopForward => self.playback.step(command::HOP),
            Command::First => self.playback.seek(0, now),
            Command::Last => self.playback.seek(usize::MAX, now),
            Command::GoToFrame => self.go_to = Some(String::new()),
            Command::PlayBackwards => self.playback.shuttle(-1.0, now),
            Command::Stop => self.playback.pause(),
            Command::PlayForwards => self.playback.shuttle(1.0, now),
            Command::Slower => self.playback.change_speed(-1, now),
            Command::Faster => self.playback.change_speed(1, now),
            Command::NormalSpeed => self.playback.normal_speed(now),
            Command::Loop => self.playback.toggle_looping(),
            Command::RangeStart => self.playback.set_range_start(),
            Command::RangeEnd => self.playback.set_range_end(),
            Command::RangeClear => self.playback.clear_range(),
            Command::FocusPrompt => self.prompt_box.wants_focus = true,
            Command::TogglePrompt => self.document.toggle_visible(invocation.index),
            Command::SoloPrompt => self.document.solo(invocation.index),
            Command::HideOverlays => self.document.is_hidden ^= true,
            Command::Peek => {}
            Command::CycleStyle => self.document.next_style(),
            Command::MoreOpacity => self.document.next_opacity(),
            Command::ThresholdDown => self.document.nudge_threshold(-command::THRESHOLD_STEP),
            Command::ThresholdUp => self.document.nudge_threshold(command::THRESHOLD_STEP),
            Command::SwapOriginal => {
                self.document.mode = swap(ViewMode::Original, ViewMode::Reconstruction, mode)
            }
            Command::SideBySide => {
                self.document.mode = swap(ViewMode::SideBySide, ViewMode::Reconstruction, mode)
            }
            Command::Wipe => self.document.mode = swap(ViewMode::Wipe, ViewMode::Reconstruction, mode),
            Command::Depth => self.document.mode = swap(ViewMode::Depth, ViewMode::Reconstruction, mode),
            Command::ResetView => (self.orbit, self.zoom) = Default::default(),
            Command::FullScreen => {
                let is_full = ctx.input(|i| i.viewport().fullscreen.unwrap_or(false));
                ctx.send_viewport_cmd(egui::ViewportCommand::Fullscreen(!is_full));
            }
            Command::Shortcuts => self.sheet = Some(Sheet::Shortcuts),
            Command::About => self.sheet = Some(Sheet::About),
        }
    }

    /// Starts training in the background.
    pub(super) fn start_training(&mut self, request: TrainRequest, ctx: &Context) {
        self.training = Some(Training::start(self.backend.clone(), request, ctx));
    }

    /// Asks for a path on a thread of its own: a native dialog may block for as long as it is open.
    fn pick(&mut self, folder: bool, ctx: &Context) {
        self.picking = Some(Job::start("file dialog", ctx, move |_| {
            let dialog = rfd::FileDialog::new();
            Ok(if folder {
                dialog.set_title("Open a recording: a folder of frames").pick_folder()
            } else {
                dialog
                    .set_title("Open a reconstruction or a video")
                    .add_filter("Reconstructions and videos", &["safetensors", "mp4", "mov", "mkv", "avi"])
                    .add_filter("All files", &["*"])
                    .pick_file()
            })
        }));
    }

    /// One heartbeat.
    pub(crate) fn show(&mut self, ui: &mut Ui) {
        let ctx = ui.ctx().clone();
        let now = ctx.input(|i| i.time);
        self.is_moving = false;
        self.poll_jobs(&ctx);
        self.take_picture(&ctx);
        for invocation in KeyRouter::take(&ctx) {
            self.run(invocation, &ctx);
        }
        if let Some(path) = ctx.input(|i| i.raw.dropped_files.first().map(|f| f.path().to_owned())) {
            self.open_path(&path, &ctx);
        }
        self.playback.advance(now);
        self.watch_typing(now, &ctx);
        super::layout::window_ui(ui, self);
        self.ask(&ctx);
        if let Some(wait) = self.playback.seconds_to_next(now) {
            ctx.request_repaint_after_secs(wait as f32);
        }
        self.keep_preferences(&ctx);
    }

    /// Looks for what is being typed once the typing rests.
    fn watch_typing(&mut self, now: f64, ctx: &Context) {
        let Some(edited_at) = self.prompt_box.edited_at else { return };
        let left = edited_at + TYPING_PAUSE - now;
        if left <= 0.0 {
            self.prompt_box.live = self.prompt_box.text.trim().to_owned();
            self.prompt_box.edited_at = None;
        } else {
            ctx.request_repaint_after_secs(left as f32);
        }
    }

    fn poll_jobs(&mut self, ctx: &Context) {
        if let Some(JobEvent::Done(result)) = self.picking.as_mut().and_then(Job::poll) {
            self.picking = None;
            if let Some(path) = self.settle(result).flatten() {
                self.open_path(&path, ctx);
            }
        }
        if let Some(JobEvent::Done(result)) = self.demo.as_mut().and_then(Job::poll) {
            self.demo = None;
            if let Some(demo) = self.settle(result) {
                self.train_when_open = demo.train;
                self.open_path(&demo.path, ctx);
            }
        }
        if let Some(JobEvent::Done(result)) = self.opening.as_mut().and_then(|o| o.job.poll())
            && let Some(opening) = self.opening.take()
            && let Some(source) = self.settle(result)
        {
            self.show_source(source, &opening.path, ctx);
        }
        self.poll_training(ctx);
        if let Some(problem) = self.export.as_mut().and_then(ExportDialog::poll) {
            self.problem = Some(problem);
        }
    }

    fn poll_training(&mut self, ctx: &Context) {
        while let Some(event) = self.training.as_mut().and_then(|t| t.job.poll()) {
            match event {
                JobEvent::Progress(_) => {}
                JobEvent::Preview(source) => self.show_preview(source),
                JobEvent::Done(result) => {
                    self.training = None;
                    if let Some(scene) = self.settle(result) {
                        self.open_path(&scene, ctx);
                    }
                }
            }
        }
    }

    /// Shows how far the training is: beside the recorded frame, unless another view was chosen meanwhile.
    fn show_preview(&mut self, source: Box<dyn FrameSource>) {
        let Some(open) = &mut self.open else { return };
        if !open.info.has_reconstruction && self.document.mode == ViewMode::Original {
            self.document.mode = ViewMode::SideBySide;
        }
        open.info = source.info().clone();
        open.worker.replace(source);
        open.asked = None;
    }

    /// The value, or its error as the problem to show.
    fn settle<T>(&mut self, result: surgtpgs_core::Result<T>) -> Option<T> {
        result.map_err(|e| self.problem = Some(e.to_string())).ok()
    }

    fn show_source(&mut self, source: Box<dyn FrameSource>, path: &Path, ctx: &Context) {
        let info = source.info().clone();
        let Some(worker) = self.settle(Worker::start(source, ctx)) else { return };
        let is_same_recording =
            self.info().is_some_and(|i| (&i.name, i.num_frames) == (&info.name, info.num_frames));
        let frame = if is_same_recording { self.playback.frame() } else { 0 };
        self.playback = Playback::new(info.num_frames, info.frames_per_second);
        self.playback.seek(frame, 0.0);
        (self.orbit, self.zoom) = Default::default();
        self.document.mode =
            if info.has_reconstruction { ViewMode::Reconstruction } else { ViewMode::Original };
        self.export = None;
        ctx.send_viewport_cmd(egui::ViewportCommand::Title(format!("{} – SurgTPGS", info.name)));
        self.open = Some(Open { info, worker, asked: None, shown: None, full_ms: 0.0 });
        self.preferences.remember(path);
        if let Some(request) = self.train_when_open.take().filter(|r| r.recording == *path) {
            self.start_training(request, ctx);
        }
    }

    fn take_picture(&mut self, ctx: &Context) {
        let Some(open) = &mut self.open else { return };
        let Some(picture) = open.worker.take() else { return };
        if !picture.request.view.is_preview {
            open.full_ms = picture.took_ms;
        }
        match &mut open.shown {
            Some(shown) => shown.update(picture, ctx),
            none => *none = Some(Shown::new(picture, ctx)),
        }
    }

    /// Asks for the picture of the present state unless it was asked for already.
    fn ask(&mut self, ctx: &Context) {
        let is_peeking = self.is_peeking(ctx);
        let Some(request) = self.request(is_peeking) else { return };
        let Some(open) = &mut self.open else { return };
        if open.asked.as_ref() != Some(&request) {
            open.worker.submit(request.clone());
            open.asked = Some(request);
        }
    }

    /// Whether the recorded frame alone is to be seen just now.
    pub(super) fn is_peeking(&self, ctx: &Context) -> bool {
        command::is_held(ctx, Command::Peek) && self.info().is_some_and(|i| i.has_original)
    }

    /// Whether a turned view makes sense: where a recorded frame is compared, both must look from the same place.
    pub(super) fn may_orbit(&self) -> bool {
        matches!(self.document.mode, ViewMode::Reconstruction | ViewMode::Depth)
            && self.info().is_some_and(|i| i.has_reconstruction)
    }

    fn request(&self, is_peeking: bool) -> Option<Request> {
        let open = self.open.as_ref()?;
        let mode = self.document.mode;
        let orbit = if self.may_orbit() { self.orbit } else { Orbit::default() };
        let is_moving = self.is_moving || self.playback.is_playing();
        Some(Request {
            view: View {
                frame: self.playback.frame(),
                orbit,
                is_preview: is_moving && open.full_ms > SLOW_MS,
            },
            needs_original: mode.needs_original() || is_peeking,
            needs_reconstruction: mode.needs_reconstruction() && mode != ViewMode::Depth,
            needs_depth: mode == ViewMode::Depth,
            prompts: if open.info.has_features { self.asked_prompts() } else { Vec::new() },
            style: self.document.style,
            opacity: self.document.opacity,
        })
    }

    /// The visible prompts, and the one being typed.
    fn asked_prompts(&self) -> Vec<AskedPrompt> {
        let asked = |p: &super::document::Prompt| AskedPrompt {
            id: p.id,
            text: p.text.clone(),
            threshold: p.threshold,
            colour: p.colour,
        };
        let mut prompts: Vec<AskedPrompt> =
            self.document.prompts().iter().filter(|p| p.is_visible).map(asked).collect();
        let live = &self.prompt_box.live;
        if !live.is_empty() && !prompts.iter().any(|p| p.text.eq_ignore_ascii_case(live)) {
            prompts.push(AskedPrompt {
                id: PREVIEW,
                text: live.clone(),
                threshold: self.document.default_threshold(),
                colour: self.document.next_colour(),
            });
        }
        prompts
    }

    /// Remembers overlay choices once they rest.
    fn keep_preferences(&mut self, ctx: &Context) {
        let (style, opacity) = (self.document.style, self.document.opacity);
        let is_changed = (self.preferences.style, self.preferences.opacity) != (style, opacity);
        if is_changed && !ctx.input(|i| i.pointer.any_down()) {
            (self.preferences.style, self.preferences.opacity) = (style, opacity);
            self.preferences.save();
        }
    }
}

impl eframe::App for ViewerApp {
    fn ui(&mut self, ui: &mut Ui, _frame: &mut eframe::Frame) {
        self.show(ui);
    }
}
