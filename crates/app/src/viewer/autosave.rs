//! What is not saved yet, written again and again beside the preferences, so that neither a crash nor a closed window
//! loses it. A window's file is there exactly as long as something in it is not saved elsewhere.
//!
//! Every window locks a file of its own; the system frees the lock whatever ends the program. What lies beside a free
//! lock was left behind and is offered to the user.

use super::{
    jobs::{Job, JobEvent},
    session::Session,
};
use std::{
    fs::{File, OpenOptions},
    path::{Path, PathBuf},
};
use surgtpgs_core::Result;

/// Seconds between two writes of what is no edit, such as the frame.
pub(crate) const EVERY_SECS: f64 = 30.0;

/// Windows that can be open at once and still be protected.
const MAX_WINDOWS: usize = 32;

/// This window's place, and what other windows left behind.
#[derive(Default)]
pub(crate) struct Autosave {
    place: Option<Place>,
    /// What was left behind, newest first.
    pub(crate) left: Vec<Left>,
    writing: Option<Job<()>>,
    /// What is on disk.
    written: Option<Session>,
    /// When something other than an edit is to be written, by the window's clock.
    due: Option<f64>,
    revision: u64,
}

struct Place {
    file: PathBuf,
    /// Held, never read: the lock is the message.
    _lock: File,
}

/// What another window left.
pub(crate) struct Left {
    pub(crate) session: Session,
    file: PathBuf,
    _lock: File,
}

impl Autosave {
    /// The user's own folder.
    pub(crate) fn user_folder() -> Option<PathBuf> {
        dirs::data_local_dir().map(|dir| dir.join("surgtpgs").join("unsaved"))
    }

    /// Takes a free place in `folder`, and what was left in the others. Without a folder nothing is kept.
    pub(crate) fn open(folder: Option<PathBuf>) -> Self {
        let mut autosave = Self::default();
        let Some(folder) = folder else { return autosave };
        for number in 0..MAX_WINDOWS {
            let file = folder.join(format!("{number}.{}", super::session::EXTENSION));
            let is_left = file.is_file();
            // A free place is enough; further ones matter only for what was left there.
            if autosave.place.is_some() && !is_left {
                continue;
            }
            let Some(lock) = lock(&file.with_extension("lock")) else { continue };
            if !is_left {
                autosave.place = Some(Place { file, _lock: lock });
            } else if let Ok(session) = Session::load(&file) {
                autosave.left.push(Left { session, file, _lock: lock });
            } else {
                tracing::warn!("what was left unsaved cannot be read ({})", file.display());
            }
        }
        let time = |left: &Left| std::fs::metadata(&left.file).and_then(|m| m.modified()).ok();
        autosave.left.sort_by_key(|left| std::cmp::Reverse(time(left)));
        autosave
    }

    /// Writes what is not saved: edits at once, anything else after [`EVERY_SECS`]. Returns in how many seconds to call
    /// again, if nothing happens before.
    pub(crate) fn keep(
        &mut self,
        now: f64,
        revision: u64,
        session: &Session,
        ctx: &egui::Context,
    ) -> Option<f64> {
        let place = self.place.as_ref()?;
        if let Some(JobEvent::Done(result)) = self.writing.as_mut().and_then(Job::poll) {
            self.writing = None;
            if let Err(e) = result {
                tracing::warn!("the work could not be kept: {e}");
            }
        }
        if self.written.as_ref() == Some(session) {
            (self.due, self.revision) = (None, revision);
            return None;
        }
        let due = *self.due.get_or_insert(now + EVERY_SECS);
        if revision == self.revision && now < due {
            return Some(due - now);
        }
        if self.writing.is_none() {
            let (file, theirs) = (place.file.clone(), session.clone());
            self.writing = Some(Job::start("keeping the work", ctx, move |_| theirs.save(&file)));
            self.written = Some(session.clone());
            (self.due, self.revision) = (None, revision);
        }
        None
    }

    /// Nothing needs to be kept: it was saved elsewhere, or there is nothing.
    pub(crate) fn clear(&mut self, revision: u64) {
        (self.due, self.revision) = (None, revision);
        self.finish_writing();
        if self.written.take().is_some()
            && let Some(place) = &self.place
        {
            remove(&place.file);
        }
    }

    /// Writes at once, at the end of the program.
    pub(crate) fn keep_now(&mut self, session: &Session) -> Result<()> {
        self.finish_writing();
        match &self.place {
            Some(place) if self.written.as_ref() != Some(session) => session.save(&place.file),
            _ => Ok(()),
        }
    }

    /// Takes what was left behind newest; its file remains until it is kept in this window's place.
    pub(crate) fn restore(&mut self) -> Option<Session> {
        if self.left.is_empty() {
            return None;
        }
        let left = self.left.remove(0);
        if let Some(place) = &self.place
            && std::fs::rename(&left.file, &place.file).is_ok()
        {
            self.written = Some(left.session.clone());
        }
        Some(left.session)
    }

    /// Forgets what was left behind.
    pub(crate) fn discard(&mut self) {
        self.left.drain(..).for_each(|left| remove(&left.file));
    }

    fn finish_writing(&mut self) {
        while let Some(job) = &mut self.writing {
            match job.poll() {
                Some(JobEvent::Done(_)) => self.writing = None,
                _ => std::thread::yield_now(),
            }
        }
    }
}

fn lock(file: &Path) -> Option<File> {
    std::fs::create_dir_all(file.parent()?).ok()?;
    let file = OpenOptions::new().create(true).truncate(false).write(true).open(file).ok()?;
    file.try_lock().ok().map(|()| file)
}

fn remove(file: &Path) {
    if let Err(e) = std::fs::remove_file(file) {
        tracing::warn!("what was kept could not be removed: {e} ({})", file.display());
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn folder() -> (tempfile::TempDir, Option<PathBuf>) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("unsaved");
        (folder, Some(path))
    }

    fn session(name: &str) -> Session {
        Session::new(PathBuf::from("/data").join(name))
    }

    #[test]
    fn what_a_window_left_is_offered_once_it_is_gone_and_not_before() {
        let (_held, folder) = folder();
        let ctx = egui::Context::default();
        let mut first = Autosave::open(folder.clone());
        first.keep(0.0, 1, &session("a.safetensors"), &ctx);
        first.finish_writing();
        assert!(Autosave::open(folder.clone()).left.is_empty(), "the window is still open");
        drop(first);
        let mut next = Autosave::open(folder.clone());
        assert_eq!(next.left[0].session, session("a.safetensors"));
        assert_eq!(next.restore(), Some(session("a.safetensors")));
        drop(next);
        assert_eq!(Autosave::open(folder.clone()).left.len(), 1, "restored, and still not saved elsewhere");
        let mut last = Autosave::open(folder.clone());
        last.discard();
        drop(last);
        assert!(Autosave::open(folder).left.is_empty());
    }

    #[test]
    fn edits_are_written_at_once_and_the_rest_after_a_while() {
        let (_held, folder) = folder();
        let ctx = egui::Context::default();
        let mut autosave = Autosave::open(folder.clone());
        let file = autosave.place.as_ref().unwrap().file.clone();
        assert_eq!(autosave.keep(10.0, 0, &session("a"), &ctx), Some(EVERY_SECS));
        assert_eq!(autosave.keep(20.0, 0, &session("b"), &ctx), Some(EVERY_SECS - 10.0));
        assert!(!file.exists());
        autosave.keep(10.0 + EVERY_SECS, 0, &session("c"), &ctx);
        autosave.finish_writing();
        assert_eq!(Session::load(&file).unwrap(), session("c"));
        autosave.keep(41.0, 1, &session("d"), &ctx);
        autosave.finish_writing();
        assert_eq!(Session::load(&file).unwrap(), session("d"));
        assert_eq!(autosave.keep(42.0, 1, &session("d"), &ctx), None, "nothing to do");
        autosave.clear(1);
        assert!(!file.exists());
    }

    #[test]
    fn without_a_folder_and_with_damaged_files_it_goes_on() {
        let ctx = egui::Context::default();
        assert_eq!(Autosave::open(None).keep(0.0, 1, &session("a"), &ctx), None);
        let (_held, folder) = folder();
        std::fs::create_dir_all(folder.as_ref().unwrap()).unwrap();
        std::fs::write(folder.as_ref().unwrap().join("0.surgtpgs"), "damaged").unwrap();
        let autosave = Autosave::open(folder);
        assert!(autosave.left.is_empty() && autosave.place.is_some());
    }
}
