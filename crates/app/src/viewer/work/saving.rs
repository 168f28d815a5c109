//! Sessions: saved where the user chooses, and kept automatically until then.

use crate::viewer::{
    backend::{
        Info,
        paths::{PathAsk, PathKind, free_path},
    },
    remedy::statement,
    shared::Shared,
    state::{
        autosave::{Left, LeftId},
        content::Content,
        marks::canvas,
        saving::{Origin, Saved, SavedKind, ToApply},
        session::{self, Display, Session, Time},
    },
    text::sentence,
};
use egui::Context;
use std::{
    io::ErrorKind,
    path::{Path, PathBuf},
};
use surgtpgs_core::{Error, Result, files::absolute_path};

impl Shared {
    /// Returns the session of the present state; `None` while nothing is open.
    pub(crate) fn session(&self) -> Option<Session> {
        let info = self.info()?;
        let document = &self.document;
        let file = self.saving.saved.file.as_deref().map(absolute_path);
        Some(Session {
            content: document.content().clone(),
            display: Display {
                mode: document.mode,
                overlay: document.overlay,
                is_hidden: document.is_hidden,
                wipe: self.viewport.wipe,
                look: document.look,
            },
            time: Time {
                frame: self.playback.frame(),
                speed: self.playback.speed(),
                repeats: self.playback.is_looping(),
            },
            earlier_prompts: self.prompt_box.earlier.clone(),
            unknown: self.saving.saved.unknown.clone(),
            recording: info.frames_sha256.clone(),
            spots: info.spots_sha256.clone(),
            sequence: info.sequence.clone(),
            // Other names cannot be written.
            saved_as: file.filter(|file| file.to_str().is_some()),
            ..Session::new(info.path.clone())
        })
    }

    /// Returns `true` if a session is about what is open.
    pub(crate) fn is_about_open(&self, session: &Session) -> bool {
        self.info().is_some_and(|info| session.is_about(info))
    }

    /// Returns `true` if nothing was decided yet about what is open.
    pub(crate) fn is_untouched(&self) -> bool {
        self.saving.saved.file.is_none() && !self.is_unsaved()
    }

    /// Returns the path of a session's scene or recording: the earlier one, or, if nothing is there any more,
    /// that of what is open and has its frames.
    fn path_of(&self, session: &Session) -> PathBuf {
        let moved = self.info().filter(|info| session.is_about(info) && !session.opened.exists());
        moved.map_or(&session.opened, |info| &info.path).clone()
    }

    /// Opens the scene or recording of a session; the session itself is applied once that is open.
    pub(crate) fn open_session(&mut self, session: Session, origin: Origin, ctx: &Context) {
        let path = self.path_of(&session);
        self.open_path(&path, ctx);
        self.saving.to_apply = Some(ToApply { session, origin });
    }

    /// Opens what unsaved work is about, to restore it.
    pub(crate) fn restore(&mut self, id: LeftId, ctx: &Context) {
        if let Some(session) = self.saving.autosave.left(id).map(|left| left.session.clone()) {
            self.open_session(session, Origin::Left(id), ctx);
        }
    }

    /// Gives up the session to apply, because what it is about cannot be opened. Unsaved work stays kept.
    pub(crate) fn drop_session(&mut self) {
        let Some(dropped) = self.saving.to_apply.take() else { return };
        // It would be offered at once, and could not be restored.
        self.saving.is_recovery_put_off |= matches!(dropped.origin, Origin::Left(_));
        let why = self.problem.take().unwrap_or_default();
        self.problem = Some(format!("{why} {}", hint(&dropped)));
    }

    /// Takes the work on what is open that this window put aside, to apply it; returns `false` if there is
    /// none. Work of another window or on other frames is offered, and so is what would replace decisions.
    pub(crate) fn bring_back(&mut self) -> bool {
        let is_free = self.is_untouched();
        let Some(info) = self.open.as_ref().map(|open| &open.info) else { return false };
        let left = self.saving.autosave.recall(info).filter(|left| is_free && left.is_own);
        let back = left.filter(|left| !left.session.is_of_other_frames(info));
        let back = back.map(|left| (left.session.clone(), Origin::Left(left.id)));
        let brings = back.is_some();
        self.saving.to_apply = back.map(|(session, origin)| ToApply { session, origin });
        self.saving.is_recovery_put_off &= brings;
        brings
    }

    /// Applies the session that was saved last beside what is open, which `find` returns, and says so: if
    /// nothing is decided yet, and no later work is offered.
    pub(crate) fn bring_saved(&mut self, find: impl FnOnce(&Info) -> Option<(PathBuf, Session)>, now: f64) {
        let is_free = self.is_untouched() && !self.is_later_work_offered();
        let Some((file, session)) = self.info().filter(|_| is_free).and_then(find) else { return };
        let name = file.file_name().unwrap_or_default().to_string_lossy().into_owned();
        self.saving.to_apply = Some(ToApply { session, origin: Origin::File(file) });
        self.apply_session(now);
        self.say(format!("Your saved work on this recording is back: {name}"), None, now);
    }

    /// Returns `true` if there is unsaved work on the frames of what is open, and it is not put off.
    fn is_later_work_offered(&self) -> bool {
        let Some(info) = self.info() else { return false };
        let is_on_these = |left: &Left| left.session.is_about(info) && !left.session.is_of_other_frames(info);
        let is_offered = |left: &Left| !self.saving.for_later.contains(&left.id) && is_on_these(left);
        self.saving.autosave.left.iter().any(is_offered)
    }

    /// Forgets unsaved work for good. If it was about what is open, what was saved comes back.
    pub(crate) fn discard(&mut self, id: LeftId, now: f64) {
        self.saving.autosave.discard(id);
        self.bring_saved(Session::newest_beside, now);
    }

    /// Offers unsaved work again at the next start. If it was about what is open, what was saved comes back.
    pub(crate) fn restore_later(&mut self, id: LeftId, now: f64) {
        self.saving.for_later.push(id);
        self.bring_saved(Session::newest_beside, now);
    }

    /// Returns the session file that unsaved work belongs to, and its content; `None` if it is not there any
    /// more, is about something else, or was saved after the work was kept.
    fn file_of(&self, id: LeftId, info: &Info) -> Option<(PathBuf, Content)> {
        let left = self.saving.autosave.left(id)?;
        let file = left.session.saved_as.clone().filter(|file| !left.is_older_than(file))?;
        let saved = Session::load(&file).ok()?;
        let is_its = saved.is_about(info) && !saved.is_of_other_frames(info);
        is_its.then_some((file, saved.content))
    }

    /// Applies a session whose scene or recording has just been opened.
    pub(crate) fn apply_session(&mut self, now: f64) {
        let Some(ToApply { session, origin }) = self.saving.to_apply.take() else { return };
        let Some(info) = self.open.as_ref().map(|o| o.info.clone()) else { return };
        let is_of_other_frames = session.is_of_other_frames(&info);
        let saved = match origin {
            // What does not fit is lost here, so that it must not be saved over the file.
            Origin::File(file) => Some((file, session.content.clone())).filter(|_| !is_of_other_frames),
            Origin::Left(id) if is_of_other_frames => {
                // Nor must it replace the work itself, which stays with its frames.
                self.saving.autosave.make_own(id);
                self.saving.for_later.push(id);
                None
            }
            Origin::Left(id) => {
                let saved = self.file_of(id, &info);
                self.saving.autosave.adopt(id);
                saved
            }
        };
        let Session { content, display, time, earlier_prompts, unknown, .. } = session;
        self.load_content(content, &info, is_of_other_frames);
        if display.mode.is_possible(&info) {
            self.document.mode = display.mode;
        }
        self.document.overlay = display.overlay.mended();
        self.document.is_hidden = display.is_hidden;
        self.document.look = display.look.mended(info.orbit_limit());
        self.viewport.wipe = if display.wipe.is_finite() { display.wipe.clamp(0.02, 0.98) } else { 0.5 };
        // It was saved standing on a frame.
        self.playback.pause();
        self.playback.restore(time.speed, time.repeats, now);
        self.playback.go_to(time.frame, now);
        self.prompt_box.earlier = earlier_prompts;
        let (file, content) = saved.unzip();
        self.saving.saved = Saved { file, content: content.unwrap_or_default(), unknown };
    }

    /// Takes the content of a session as far as it fits what is open, and says what was left out. Marks that
    /// are not used stay with the session, unless it is of other frames: then they stay in its file.
    fn load_content(&mut self, content: Content, info: &Info, is_of_other_frames: bool) {
        let count = |content: &Content| content.marks.all().len() + content.bookmarks.len();
        let count_before = count(&content);
        let content = if info.shape_is_guessed() { content.without_scale_in_space() } else { content };
        let canvas = canvas(info);
        let marks = match is_of_other_frames {
            true => content.marks.kept(|mark| mark.fits(&canvas)),
            false => content.marks.fitting(&canvas),
        };
        let left_out = marks.left_out();
        self.document.load(Content { marks, ..content }, info.num_frames);
        let lacks_some = count(self.document.content()) < count_before;
        let other = is_of_other_frames.then(|| other_frames(lacks_some));
        let said: Vec<String> = other.into_iter().chain(left_out).collect();
        if !said.is_empty() {
            self.problem = Some(said.join(" "));
        }
    }

    /// Returns `true` if there are decisions that no session file has.
    pub(crate) fn is_unsaved(&self) -> bool {
        self.open.is_some() && !self.document.content().is_alike(&self.saving.saved.content)
    }

    /// Saves the session. Asks for the path the first time, if the session is to be saved `elsewhere`, or if
    /// its file was changed by somebody else.
    pub(crate) fn save_session(&mut self, elsewhere: bool, ctx: &Context) {
        let changed = self.give_up_changed_file();
        if let Some(file) = self.saving.saved.file.clone().filter(|_| !elsewhere) {
            self.write_session(&file, ctx.input(|i| i.time));
            return;
        }
        let Some(info) = self.info() else { return };
        let beside = changed.as_deref().and_then(|file| file.parent().zip(file.file_stem()));
        let (folder, name) = match beside {
            Some((folder, name)) => (folder, name.to_string_lossy().into_owned()),
            None => (info.output_folder.as_path(), info.name.clone()),
        };
        let file = free_path(folder, &name, session::EXTENSION, &[]);
        let kind = |name| PathKind::Save(name, "Sessions");
        self.ask_for(PathAsk::save("Save the session as", &file, kind), ctx);
    }

    /// Gives up the session's file if it was changed elsewhere, and says so: nothing is saved over it, and no
    /// file holds what is decided here. Returns the file.
    fn give_up_changed_file(&mut self) -> Option<PathBuf> {
        if !self.saving.saved.is_changed_elsewhere() {
            return None;
        }
        let Saved { file, unknown, .. } = std::mem::take(&mut self.saving.saved);
        self.saving.saved.unknown = unknown;
        let file = file?;
        let name = file.file_name().unwrap_or_default().to_string_lossy();
        let why = "was changed elsewhere since it was opened or saved here: save under another name.";
        self.refuse_saving(SavedKind::Session, format!("{name} {why}"));
        Some(file)
    }

    /// Writes the session file.
    pub(crate) fn write_session(&mut self, file: &Path, now: f64) {
        let Some(session) = self.session() else { return };
        // A file does not name itself.
        let session = Session { saved_as: None, ..session };
        let saved = session.save(file);
        if self.settle_saving(SavedKind::Session, file, saved) {
            self.saving.saved.file = Some(file.to_owned());
            self.saving.saved.content = session.content;
            self.preferences.remember(file);
            let name = file.file_name().unwrap_or_default().to_string_lossy();
            self.say(format!("Saved as {name}"), None, now);
        }
    }

    /// Takes the result of writing what the user saves; returns `true` if it is written. Then an earlier
    /// failure is no problem any more.
    pub(crate) fn settle_saving(&mut self, kind: SavedKind, file: &Path, written: Result<()>) -> bool {
        if let Err(e) = written {
            self.refuse_saving(kind, not_written(kind, file, &e));
            return false;
        }
        if let Some((_, why)) = self.saving.failed.take_if(|(failed, _)| *failed == kind) {
            self.problem.take_if(|problem| *problem == why);
        }
        true
    }

    /// Shows why something was not saved, at most until it is.
    pub(crate) fn refuse_saving(&mut self, kind: SavedKind, why: String) {
        self.saving.failed = Some((kind, why.clone()));
        self.problem = Some(why);
    }

    /// Keeps unsaved work automatically, so that it cannot be lost.
    pub(crate) fn keep_unsaved(&mut self, now: f64, ctx: &Context) {
        if self.opening.underway.is_some()
            || self.saving.to_apply.is_some()
            || ctx.input(|i| i.pointer.any_down())
        {
            return;
        }
        let revision = self.document.revision();
        let Some(session) = self.session().filter(|_| self.is_unsaved()) else {
            if self.open.is_some() {
                self.saving.autosave.clear(revision);
            }
            return;
        };
        match self.saving.autosave.keep(now, revision, &session, ctx) {
            Ok(Some(wait)) => ctx.request_repaint_after_secs(wait as f32),
            Ok(None) => {}
            Err(e) => {
                let hint = "Save the session elsewhere: File, Save session as.";
                self.problem.get_or_insert(format!("What is not saved yet cannot be kept safe: {e} {hint}"));
            }
        }
    }

    /// Puts unsaved work aside that would be lost when something else is shown.
    pub(crate) fn put_unsaved_aside(&mut self, is_same_recording: bool) {
        let is_replaced = self.saving.to_apply.is_some() || !is_same_recording;
        let Some(session) = self.session().filter(|_| is_replaced && self.is_unsaved()) else { return };
        if let Err(e) = self.saving.autosave.put_aside(session) {
            let hint = "Open it again to restore it, before this window is closed.";
            self.problem = Some(format!("The work on what was open could not be kept safe: {e} {hint}"));
        }
        // The work is offered again when its recording is opened, or at the next start.
        self.saving.is_recovery_put_off = true;
    }

    /// Keeps unsaved work at the end of the program, or removes it if nothing is to be remembered.
    pub(crate) fn keep_at_exit(&mut self) {
        if self.window_size.is_some() && self.preferences.window_size != self.window_size {
            self.preferences.window_size = self.window_size;
            self.preferences.save();
        }
        if !self.preferences.remembers_files {
            self.saving.autosave.forget();
        } else if let Some(session) = self.session().filter(|_| self.is_unsaved())
            && let Err(e) = self.saving.autosave.keep_now(&session)
        {
            // The window is gone: this is the last place that anybody may look at.
            crate::text::say(&format!("the work could not be kept: {e}"));
        }
    }

    /// Saves changed choices once no mouse button is down.
    pub(crate) fn keep_preferences(&mut self, ctx: &Context) {
        let look = (self.document.overlay, self.preferences.panel_width);
        if self.saving.kept_look.is_none_or(|kept| kept != look) && !ctx.input(|i| i.pointer.any_down()) {
            let is_first = self.saving.kept_look.replace(look).is_none();
            if !is_first || self.preferences.overlay != look.0 {
                self.preferences.overlay = look.0;
                self.preferences.save();
            }
        }
    }

    /// Remembers the size of the window, for the next start.
    pub(crate) fn keep_window_size(&mut self, ctx: &Context) {
        // Before the input is locked, which the zoom would wait for.
        let zoom = ctx.zoom_factor();
        let (size, is_usual) = ctx.input(|i| {
            let viewport = i.viewport();
            let is_special = viewport.fullscreen == Some(true) || viewport.maximized == Some(true);
            (viewport.inner_rect.map(|rect| rect.size() * zoom), !is_special)
        });
        if let Some(size) = size.filter(|_| is_usual) {
            self.window_size = Some(size.into());
        }
    }
}

/// Says what to do about a session whose scene or recording cannot be opened.
fn hint(ToApply { session, origin }: &ToApply) -> String {
    let first = match session.recording {
        Some(_) => "open the recording where it is now",
        None => "put the recording back where it was",
    };
    match origin {
        Origin::Left(_) => format!("Your work is still kept: {first}, then restore it."),
        Origin::File(_) => format!("If the recording was moved, {first}, then open this session again."),
    }
}

/// Says why something was not saved, and what to do.
fn not_written(kind: SavedKind, file: &Path, error: &Error) -> String {
    let Error::Io { source, .. } = error else { return statement(error) };
    let (file, what) = (absolute_path(file), kind.name());
    let folder = file.parent().unwrap_or(&file).display();
    let elsewhere = format!("save the {what} in another folder");
    match source.kind() {
        ErrorKind::PermissionDenied | ErrorKind::ReadOnlyFilesystem => {
            format!("SurgTPGS may not write into {folder}: {elsewhere}.")
        }
        ErrorKind::StorageFull | ErrorKind::QuotaExceeded => {
            format!("There is no room left in {folder}: make some, or {elsewhere}.")
        }
        _ => format!("The {what} could not be written into {folder}: {source}. {}.", sentence(&elsewhere)),
    }
}

/// Says that a session was made on other frames, and if some of its content was left out.
fn other_frames(lacks_some: bool) -> String {
    let what = "The recording is not as it was when this session was saved: its frames are other ones.";
    let lost = if lacks_some { " Marks or bookmarks that do not fit it were left out." } else { "" };
    format!("{what}{lost} Check that marks and bookmarks are where they belong.")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_was_not_written_names_the_folder_and_what_to_do() {
        let said = |kind, cause: std::io::Error| {
            not_written(kind, Path::new("/sys/a.json"), &Error::io("write the file", "/sys/a.json", cause))
        };
        for (cause, expected) in [
            (ErrorKind::PermissionDenied, "SurgTPGS may not write into /sys: "),
            (ErrorKind::StorageFull, "There is no room left in /sys: make some, or "),
        ] {
            let said = said(SavedKind::Session, cause.into());
            assert_eq!(said, format!("{expected}save the session in another folder."));
        }
        let cause = std::io::Error::other("it broke");
        let expected = "The marks could not be written into /sys: it broke.";
        assert_eq!(said(SavedKind::Marks, cause), format!("{expected} Save the marks in another folder."));
        let other = Error::input("it is no ordinary file", "Choose another name.");
        let said = not_written(SavedKind::Session, Path::new("/sys/a"), &other);
        assert_eq!(said, "It is no ordinary file. Choose another name.");
    }
}
