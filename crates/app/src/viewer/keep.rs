//! Sessions of the window: saved where the user chooses, and kept automatically until then.

use super::{
    app::ViewerApp,
    command::{Command, tooltip, with_keys},
    document::Content,
    jobs::{Job, JobEvent},
    session::{self, Display, Session, Time},
    theme,
    widgets::{dialog, main_button},
};
use egui::{Context, RichText};
use serde_json::{Map, Value};
use std::path::{Path, PathBuf};

/// File of the session, and its saved content.
#[derive(Default)]
pub(crate) struct Saved {
    /// Session file, once there is one.
    pub(super) file: Option<PathBuf>,
    /// Content of the file.
    content: Content,
    unknown: Map<String, Value>,
}

impl ViewerApp {
    /// Returns the session of the present state; `None` while nothing is open.
    pub(super) fn session(&self) -> Option<Session> {
        let info = self.info()?;
        let document = &self.document;
        Some(Session {
            content: document.content().clone(),
            display: Display {
                mode: document.mode,
                overlay: document.overlay,
                is_hidden: document.is_hidden,
                wipe: self.wipe,
                look: document.look,
            },
            time: Time {
                frame: self.playback.frame(),
                speed: self.playback.speed(),
                repeats: self.playback.is_looping(),
            },
            earlier_prompts: self.prompt_box.earlier.clone(),
            unknown: self.saved.unknown.clone(),
            recording: info.frames_sha256.clone(),
            ..Session::new(info.path.clone())
        })
    }

    /// Opens the scene or recording of a session; the session itself is applied once that is open.
    pub(super) fn open_session(&mut self, session: Session, file: Option<PathBuf>, ctx: &Context) {
        let opened = session.opened.clone();
        self.open_path(&opened, ctx);
        self.session_to_apply = Some((session, file));
    }

    /// Applies a session whose scene or recording has just been opened.
    pub(super) fn apply_session(&mut self, now: f64) {
        let Some((session, file)) = self.session_to_apply.take() else { return };
        let Some(info) = self.open.as_ref().map(|o| o.info.clone()) else { return };
        let Session { content, display, time, earlier_prompts, unknown, recording, .. } = session;
        if let (Some(then), Some(now)) = (&recording, &info.frames_sha256)
            && then != now
        {
            let what = "The recording is not as it was when this session was saved: its frames have other names or sizes.";
            self.problem = Some(format!("{what} Check that marks and bookmarks are where they belong."));
        }
        let saved = if file.is_some() { content.clone() } else { Content::default() };
        self.document.load(content, info.num_frames);
        if display.mode.is_possible(&info) {
            self.document.mode = display.mode;
        }
        self.document.overlay = display.overlay.mended();
        self.document.is_hidden = display.is_hidden;
        self.document.look = display.look.mended(super::viewport::orbit_limit(&info));
        self.wipe = if display.wipe.is_finite() { display.wipe.clamp(0.02, 0.98) } else { 0.5 };
        self.playback.restore(time.speed, time.repeats, now);
        self.playback.seek(time.frame, now);
        self.prompt_box.earlier = earlier_prompts;
        self.saved = Saved { file, content: saved, unknown };
    }

    /// Returns `true` if there are decisions that no session file has.
    pub(super) fn is_unsaved(&self) -> bool {
        self.open.is_some() && !self.document.content().is_alike(&self.saved.content)
    }

    /// Saves the session. Asks for the path the first time, or if the session is to be saved `elsewhere`.
    pub(super) fn save_session(&mut self, elsewhere: bool, ctx: &Context) {
        if let Some(file) = self.saved.file.clone().filter(|_| !elsewhere) {
            self.write_session(&file);
            return;
        }
        let Some(info) = self.info() else { return };
        let (folder, name) = (info.output_folder.clone(), format!("{}.{}", info.name, session::EXTENSION));
        self.saving = Some(Job::start("file dialog", ctx, move |_| {
            let dialog = rfd::FileDialog::new().set_title("Save the session as").set_directory(folder);
            Ok(dialog.set_file_name(name).add_filter("Sessions", &[session::EXTENSION]).save_file())
        }));
    }

    /// Takes the path that the user picked for the session.
    pub(super) fn poll_saving(&mut self) {
        if let Some(JobEvent::Done(result)) = self.saving.as_mut().and_then(Job::poll) {
            self.saving = None;
            if let Ok(Some(path)) = result {
                self.write_session(&path.with_extension(session::EXTENSION));
            }
        }
    }

    /// Writes the session file.
    pub(super) fn write_session(&mut self, file: &Path) {
        let Some(session) = self.session() else { return };
        let saved = session.save(file);
        if self.settle(saved).is_some() {
            self.saved.file = Some(file.to_owned());
            self.saved.content = session.content;
            self.preferences.remember(file);
        }
    }

    /// Keeps unsaved work automatically, so that it cannot be lost.
    pub(super) fn keep_unsaved(&mut self, now: f64, ctx: &Context) {
        if self.opening.is_some() || self.session_to_apply.is_some() || ctx.input(|i| i.pointer.any_down()) {
            return;
        }
        let revision = self.document.revision();
        let Some(session) = self.session().filter(|_| self.is_unsaved()) else {
            if self.open.is_some() {
                self.autosave.clear(revision);
            }
            return;
        };
        match self.autosave.keep(now, revision, &session, ctx) {
            Ok(Some(wait)) => ctx.request_repaint_after_secs(wait as f32),
            Ok(None) => {}
            Err(e) => {
                let hint = with_keys("Save the session elsewhere", Command::SaveSessionAs);
                self.problem.get_or_insert(format!("What is not saved yet cannot be kept safe: {e} {hint}."));
            }
        }
    }

    /// Puts unsaved work aside that would be lost when something else is shown.
    pub(super) fn put_unsaved_aside(&mut self, is_same_recording: bool) {
        let is_replaced =
            self.session_to_apply.is_some() || (!is_same_recording && self.document.content().has_marks());
        let Some(session) = self.session().filter(|_| is_replaced && self.is_unsaved()) else { return };
        if let Err(e) = self.autosave.put_aside(session) {
            let hint = "Open it again to restore it, before this window is closed.";
            self.problem = Some(format!("The work on what was open could not be kept safe: {e} {hint}"));
        }
        // The work is offered again when its recording is opened, or at the next start.
        self.is_recovery_put_off = true;
    }

    /// Keeps unsaved work at the end of the program, or removes it if nothing is to be remembered.
    pub(super) fn keep_at_exit(&mut self) {
        if !self.preferences.remembers_files {
            self.autosave.forget();
        } else if let Some(session) = self.session().filter(|_| self.is_unsaved())
            && let Err(e) = self.autosave.keep_now(&session)
        {
            tracing::warn!("the work could not be kept: {e}");
        }
    }
}

/// Offers at the start to restore work that was left unsaved.
pub(crate) fn recovery_ui(ctx: &Context, app: &mut ViewerApp) {
    if !app.preferences.is_acknowledged {
        return;
    }
    let Some(left) = app.autosave.left.first().filter(|_| !app.is_recovery_put_off) else { return };
    let what = summary(&left.session);
    let file = left.session.opened.display().to_string();
    let (answer, is_closed) = dialog(ctx, "recovery", 480.0, |ui| {
        ui.heading("Your last work was not saved");
        ui.label(what);
        ui.label(RichText::new(file).font(theme::small()).color(theme::TEXT_WEAK));
        ui.add_space(10.0);
        ui.horizontal(|ui| {
            let restore = ui.add(main_button("Restore")).clicked();
            let later = ui.button("Ask again next time").clicked();
            let tip = format!(
                "Forget it for good. What is restored can be saved: {}",
                tooltip(Command::SaveSession)
            );
            let discard = ui.button("Discard").on_hover_text(tip).clicked();
            (restore, later, discard)
        })
        .inner
    });
    match answer {
        (true, ..) => {
            if let Some(session) = app.autosave.restore() {
                app.open_session(session, None, ctx);
            }
        }
        (_, _, true) => app.autosave.discard(),
        (_, is_later, _) => app.is_recovery_put_off = is_later || is_closed,
    }
}

/// Summarises a session, e.g. "clip: 2 prompts, 1 bookmark, at frame 8".
fn summary(session: &Session) -> String {
    let count = |n: usize, what: &str| format!("{n} {what}{}", if n == 1 { "" } else { "s" });
    let content = &session.content;
    format!(
        "{}: {}, {}, at frame {}",
        session.name(),
        count(content.prompts.len(), "prompt"),
        count(content.bookmarks.len(), "bookmark"),
        session.time.frame + 1
    )
}
