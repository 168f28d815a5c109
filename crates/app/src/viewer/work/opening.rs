//! Opening of scenes, recordings, sessions and the demo.

use crate::viewer::{
    backend::{
        FrameSource, Info,
        paths::{PathAsk, PathKind, Picked, taken},
        task::{Task, TaskEvent},
    },
    picture::open::Open,
    shared::{Shared, Viewport},
    state::{
        content::Look,
        marking::Marking,
        opening::{Opened, Underway},
        playback::Playback,
        recent::Gone,
        reconstruction::ImportCheck,
        saving::{Origin, Saved, SavedKind, ToApply},
        session::Session,
        view_mode::ViewMode,
        zoom::Zoom,
    },
};
use egui::{Context, Event};
use std::path::{Path, PathBuf};
use surgtpgs_core::{files::absolute_path, mask::CleanUp};

impl Shared {
    /// Opens a scene, a recording or a session in the background.
    pub(crate) fn open_path(&mut self, path: &Path, ctx: &Context) {
        // Remembered paths must mean the same wherever the program is started next.
        let path = &absolute_path(path);
        self.saving.to_apply = None;
        // Opening something gives up the demo, even if it is still being made.
        self.opening.demo = None;
        self.reconstruction.forget(path);
        if Session::is_file(path) {
            let session = Session::load(path);
            if let Some(session) = self.settle(session) {
                self.open_session(session, Origin::File(path.to_owned()), ctx);
            }
            return;
        }
        let (backend, at) = (self.backend.clone(), path.to_owned());
        let task = Task::start("open", ctx, move |_| {
            let source = backend.open(&at)?;
            let saved = Session::newest_beside(source.info());
            Ok(Opened { source, saved })
        });
        let name =
            path.file_name().map_or_else(|| path.display().to_string(), |n| n.to_string_lossy().into());
        self.opening.underway = Some(Underway { name, path: path.to_owned(), task });
        self.problem = None;
    }

    /// Opens the built-in demo. If it is not in its folder, it is made and reconstructed there first.
    pub(crate) fn open_demo(&mut self, ctx: &Context) {
        let Some(folder) = self.opening.demo_folder.clone() else { return };
        self.problem = None;
        let (backend, folder) = (self.backend.clone(), absolute_path(&folder));
        self.opening.demo = Some(Task::start("demo", ctx, move |task| backend.demo(&folder, task)));
    }

    /// Asks for a path by the system's dialog, on a thread of its own.
    pub(crate) fn ask_for(&mut self, ask: PathAsk, ctx: &Context) {
        let (backend, asked) = (self.backend.clone(), ask.clone());
        let task = Task::start("file dialog", ctx, move |_| Ok(backend.pick(&asked)));
        self.opening.picking = Some((task, ask));
    }

    /// Takes what the system's dialog returned. If the system has none, the window asks itself.
    fn poll_picking(&mut self, now: f64, ctx: &Context) {
        let event = self.opening.picking.as_mut().and_then(|(task, _)| task.poll());
        let Some(TaskEvent::Done(result)) = event else { return };
        let Some((_, ask)) = self.opening.picking.take() else { return };
        match self.settle(result) {
            Some(Picked::Path(path)) => self.take_picked(&path, &ask.kind, now, ctx),
            Some(Picked::Unavailable) => self.opening.asked = Some(ask),
            Some(Picked::Nothing) | None => {}
        }
    }

    /// Uses a path that the user chose: opens what exists, saves the session in what is to be written.
    pub(crate) fn take_picked(&mut self, path: &Path, kind: &PathKind, now: f64, ctx: &Context) {
        self.opening.asked = None;
        match kind {
            PathKind::File(_) | PathKind::Folder => self.open_path(path, ctx),
            PathKind::Marks => self.read_marks(path, ctx),
            PathKind::MasksModel => self.take_masks_model(path),
            PathKind::SaveMarks(_) | PathKind::Save(..) => self.write_picked(path, kind, now),
        }
    }

    /// Writes the file that was asked for, but not over one that nobody was asked about: a dialog asks about
    /// the name that it returns, which may lack the extension.
    fn write_picked(&mut self, path: &Path, kind: &PathKind, now: f64) {
        let file = kind.completed(path);
        let saved = &self.saving.saved;
        let is_own = saved.file.as_ref() == Some(&file) && !saved.is_changed_elsewhere();
        let is_agreed = file == path || is_own;
        match (taken(&file).filter(|_| !is_agreed), kind) {
            (Some(why), PathKind::SaveMarks(_)) => self.refuse_saving(SavedKind::Marks, why),
            (Some(why), _) => self.refuse_saving(SavedKind::Session, why),
            (None, PathKind::SaveMarks(_)) => self.write_marks(&file, now),
            (None, _) => self.write_session(&file, now),
        }
    }

    /// Takes what the threads have opened or made.
    pub(crate) fn poll_opening(&mut self, now: f64, ctx: &Context) {
        self.poll_picking(now, ctx);
        self.poll_marks(now);
        self.poll_pointing(now, ctx);
        self.poll_demo(ctx);
        self.opening.gone.poll(&self.preferences.recent, ctx);
        if let Some(TaskEvent::Done(result)) = self.opening.underway.as_mut().and_then(|u| u.task.poll())
            && let Some(underway) = self.opening.underway.take()
        {
            match self.settle(result) {
                Some(Opened { source, saved }) => {
                    self.show_source(source, ctx);
                    self.begin_with(&underway.path, saved, ctx);
                }
                None => self.drop_session(),
            }
        }
        if let Some(check) = &mut self.reconstruction.check {
            check.poll();
        }
        self.poll_flipping(ctx);
        if let Some(open) = &mut self.open {
            // The next letter is shown first.
            let is_release = |event: &Event| matches!(event, Event::Key { pressed: false, .. });
            if ctx.input(|i| i.raw.events.iter().all(is_release)) {
                open.wait_for_letter();
            }
            open.poll();
        }
    }

    /// Takes the demo from its task. It can be looked at while it is being made.
    fn poll_demo(&mut self, ctx: &Context) {
        match self.opening.demo.as_mut().and_then(Task::poll) {
            Some(TaskEvent::Update(source)) => self.show_source(source, ctx),
            Some(TaskEvent::Done(result)) => {
                self.opening.demo = None;
                if let Some(demo) = self.settle(result) {
                    self.opening.train_when_open = demo.train;
                    self.open_path(&demo.path, ctx);
                }
            }
            _ => {}
        }
    }

    fn show_source(&mut self, source: Box<dyn FrameSource>, ctx: &Context) {
        let Some(open) = self.settle(Open::start(source, ctx)) else { return };
        let info = &open.info;
        let is_same_recording = self.info().is_some_and(|i| i.is_same_recording(info));
        let loses_frames = self.info().is_some_and(|i| i.has_other_frames(info)) && !self.is_untouched();
        self.put_unsaved_aside(is_same_recording);
        let now = ctx.input(|i| i.time);
        let clock = Playback::new(info.num_frames, info.frames_per_second).with_times(&info.frame_seconds);
        self.playback = if is_same_recording { clock.going_on(&self.playback, now) } else { clock };
        if !is_same_recording {
            self.document.start_recording(CleanUp::usual(info.width, info.height));
            self.viewport.span = None;
            self.prompt_box.text.clear();
            // What is usual need not be saved.
            self.saving.saved = Saved { content: self.document.content().clone(), ..Saved::default() };
        }
        // The part of the picture that is enlarged stays, and so does the mark that is being drawn on it.
        let zoom = if is_same_recording { self.document.look.zoom } else { Zoom::default() };
        self.document.look = Look { zoom, ..Look::default() };
        self.document.mode = self.mode_of(info, is_same_recording);
        let Viewport { probe, has_ruler, marking, .. } = &mut self.viewport;
        (*probe, *has_ruler) = (None, false);
        if !is_same_recording {
            *marking = Marking::default();
            self.opening.marks = None;
        }
        if loses_frames {
            let what = "These are other frames than before: your work on those is kept";
            self.say(what, None, now);
        }
        self.open = Some(open);
        let title = format!("{} – SurgTPGS", self.title());
        ctx.send_viewport_cmd(egui::ViewportCommand::Title(title));
    }

    /// Returns the view of what is opened. Of the same recording it is the one that was chosen before.
    fn mode_of(&self, info: &Info, is_same_recording: bool) -> ViewMode {
        let mode = self.document.mode;
        // Previews are shown beside the recorded frame, which is enough at the end, unless one draws on it.
        let is_for_previews = mode == ViewMode::SideBySide && !self.viewport.marking.is_on;
        let stays = is_same_recording && !is_for_previews && mode.is_possible(info);
        if stays { mode } else { ViewMode::usual(info) }
    }

    /// Completes opening `path` once it is shown: applies its session, or the one that was `saved` last beside
    /// it, and starts its training or its check.
    fn begin_with(&mut self, path: &Path, saved: Option<(PathBuf, Session)>, ctx: &Context) {
        self.preferences.remember(match &self.saving.to_apply {
            Some(ToApply { origin: Origin::File(file), .. }) => file,
            _ => path,
        });
        let is_asked = self.saving.to_apply.is_some();
        let is_back = !is_asked && self.bring_back();
        self.apply_session(0.0);
        let now = ctx.input(|i| i.time);
        if is_back {
            self.say("Your work on this recording is back", None, now);
        } else if !is_asked {
            self.bring_saved(|info| saved.filter(|(_, session)| session.is_about(info)), now);
        }
        let request = self.opening.train_when_open.take().filter(|r| r.recording == *path);
        if let Some(request) = request.filter(|r| !self.reconstruction.is_planned(&r.recording)) {
            self.start_training(request, ctx);
        }
        let is_bare = !self.is_reconstructing() && self.info().is_some_and(|i| !i.has_reconstruction);
        let check = || ImportCheck::start(self.backend.clone(), path.to_owned(), ctx);
        self.reconstruction.check = is_bare.then(check);
    }

    /// Closes what is open, gives up what is being opened or made, and shows the start page. Unsaved work is
    /// kept, and offered there.
    pub(crate) fn close(&mut self, ctx: &Context) {
        self.put_unsaved_aside(false);
        (self.opening.underway, self.opening.demo) = (None, None);
        (self.opening.train_when_open, self.saving.to_apply) = (None, None);
        // The start page looks again for what was opened last.
        self.opening.gone = Gone::default();
        self.playback.pause();
        self.document.start_recording(CleanUp::default());
        self.saving.saved = Saved::default();
        (self.reconstruction.check, self.opening.marks) = (None, None);
        (self.open, self.problem) = (None, None);
        ctx.send_viewport_cmd(egui::ViewportCommand::Title("SurgTPGS".into()));
    }

    /// Inverts in the background which side of the checked recording's masks is kept.
    pub(crate) fn flip_masks(&mut self, ctx: &Context) {
        let check = self.reconstruction.check.as_mut();
        let Some(check) = check.filter(|check| check.flipping.is_none()) else { return };
        let (backend, path) = (self.backend.clone(), check.path.clone());
        check.flipping = Some(Task::start("flip masks", ctx, move |_| backend.flip_masks(&path)));
    }

    /// Opens a recording again once its masks are inverted and nothing else is being opened.
    fn poll_flipping(&mut self, ctx: &Context) {
        let check = self.reconstruction.check.as_mut().filter(|_| self.opening.underway.is_none());
        let Some(check) = check else { return };
        let Some(TaskEvent::Done(flipped)) = check.flipping.as_mut().and_then(Task::poll) else { return };
        check.flipping = None;
        let path = check.path.clone();
        if self.settle(flipped).is_some() {
            self.open_path(&path, ctx);
        }
    }
}
