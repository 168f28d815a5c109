//! Automatic saving of unsaved work to the user's data folder, so that neither a crash nor a closed window
//! loses it. A window's file exists exactly as long as something in the window is not saved elsewhere.
//!
//! Every window locks a lock file of its own. The system frees the lock however the program ends. A session
//! beside a free lock was left behind, and is offered to the user.

use crate::viewer::{
    backend::task::{Task, TaskEvent},
    state::session::Session,
};
use std::{
    fs::{File, OpenOptions},
    path::{Path, PathBuf},
};
use surgtpgs_core::Result;

/// Seconds between two writes of changes that are not edits, such as the frame.
pub(crate) const EVERY_SECS: f64 = 30.0;

/// Number of windows that can be open at once and still be protected.
const MAX_WINDOWS: usize = 32;

/// The place of this window, and the sessions that other windows left behind.
#[derive(Default)]
pub(crate) struct Autosave {
    folder: Option<PathBuf>,
    place: Option<Place>,
    /// Sessions left behind or put aside, newest first.
    pub(crate) left: Vec<Left>,
    writing: Option<Task<()>>,
    /// Session that is on disk or being written.
    written: Option<Session>,
    /// `true` if the last write failed.
    is_failing: bool,
    /// Time at which changes other than edits are to be written, by the window's clock.
    due: Option<f64>,
    revision: u64,
}

struct Place {
    file: PathBuf,
    /// Open file that is never read; it only holds the lock.
    _lock: File,
}

impl Place {
    /// Locks the place with a number, if it holds a session (`is_used`) or holds none (`!is_used`). Returns
    /// `None` if that is not so or if another window has the place.
    fn lock(folder: &Path, number: usize, is_used: bool) -> Option<Self> {
        let file = folder.join(format!("{number}.{}", crate::viewer::state::session::EXTENSION));
        if file.is_file() != is_used {
            return None;
        }
        lock(&file.with_extension("lock")).map(|lock| Self { file, _lock: lock })
    }

    /// Locks the first place that holds no session.
    fn free(folder: &Path) -> Option<Self> {
        (0..MAX_WINDOWS).find_map(|number| Self::lock(folder, number, false))
    }
}

/// A session that another window left behind, or that this one put aside.
pub(crate) struct Left {
    pub(crate) session: Session,
    place: Place,
    is_own: bool,
}

impl Autosave {
    /// Returns the folder of the current user.
    pub(crate) fn user_folder() -> Option<PathBuf> {
        dirs::data_local_dir().map(|dir| dir.join("surgtpgs").join("unsaved"))
    }

    /// Takes a free place in `folder`, and the sessions left in the others. Without a folder nothing is kept.
    pub(crate) fn open(folder: Option<PathBuf>) -> Self {
        let Some(at) = &folder else { return Self::default() };
        let mut left = Vec::new();
        for place in (0..MAX_WINDOWS).filter_map(|number| Place::lock(at, number, true)) {
            match Session::load(&place.file) {
                Ok(session) => left.push(Left { session, place, is_own: false }),
                Err(_) => {
                    eprintln!("what was left unsaved cannot be read ({})", place.file.display());
                }
            }
        }
        let time = |left: &Left| std::fs::metadata(&left.place.file).and_then(|m| m.modified()).ok();
        left.sort_by_key(|left| std::cmp::Reverse(time(left)));
        Self { place: Place::free(at), left, folder, ..Self::default() }
    }

    /// Writes unsaved work: edits at once; other changes, and work that could not be written, after
    /// [`EVERY_SECS`]. Returns the number of seconds after which to call again if nothing happens before. A
    /// failing write is an error only once, until a write succeeds again.
    pub(crate) fn keep(
        &mut self,
        now: f64,
        revision: u64,
        session: &Session,
        ctx: &egui::Context,
    ) -> Result<Option<f64>> {
        match self.poll_writing() {
            Some(Err(e)) => {
                self.due = Some(now + EVERY_SECS);
                if !std::mem::replace(&mut self.is_failing, true) {
                    return Err(e);
                }
            }
            Some(Ok(())) => self.is_failing = false,
            None => {}
        }
        let Some(place) = &self.place else { return Ok(None) };
        if self.written.as_ref() == Some(session) {
            (self.due, self.revision) = (None, revision);
            return Ok(None);
        }
        let due = *self.due.get_or_insert(now + EVERY_SECS);
        if revision == self.revision && now < due {
            return Ok(Some(due - now));
        }
        if self.writing.is_none() {
            let (file, theirs) = (place.file.clone(), session.clone());
            self.writing = Some(Task::start("keeping the work", ctx, move |_| theirs.save(&file)));
            self.written = Some(session.clone());
            (self.due, self.revision) = (None, revision);
        }
        Ok(None)
    }

    /// Removes the kept work, because it was saved elsewhere or there is nothing to keep.
    pub(crate) fn clear(&mut self, revision: u64) {
        (self.due, self.revision) = (None, revision);
        self.finish_writing();
        // After a failed write, the file of the previous write remains.
        let may_exist = self.written.take().is_some() | std::mem::take(&mut self.is_failing);
        if may_exist && let Some(place) = &self.place {
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

    /// Leaves `session` in its place, as if this window had ended, and continues in another place. If the
    /// session cannot be written, it can be restored as long as this window is open.
    pub(crate) fn put_aside(&mut self, session: Session) -> Result<()> {
        let kept = self.keep_now(&session);
        if let Some(place) = self.place.take() {
            self.left.insert(0, Left { session, place, is_own: true });
        }
        self.place = self.folder.as_deref().and_then(Place::free);
        (self.written, self.due, self.is_failing) = (None, None, false);
        kept
    }

    /// Removes all files of this window, at the end of the program.
    pub(crate) fn forget(&mut self) {
        self.clear(self.revision);
        self.left.extract_if(.., |left| left.is_own).for_each(|left| remove(&left.place.file));
    }

    /// Moves the newest session of `opened` to the front of the sessions left; returns `false` if there is
    /// none.
    pub(crate) fn recall(&mut self, opened: &Path) -> bool {
        let found = self.left.iter().position(|left| left.session.opened == opened);
        if let Some(at) = found {
            self.left[..=at].rotate_right(1);
        }
        found.is_some()
    }

    /// Takes the first session left behind. Its file moves to the place of this window; if that fails, it
    /// stays where it is.
    pub(crate) fn restore(&mut self) -> Option<Session> {
        if self.left.is_empty() {
            return None;
        }
        let left = self.left.remove(0);
        if let Some(place) = &self.place
            && std::fs::rename(&left.place.file, &place.file).is_ok()
        {
            self.written = Some(left.session.clone());
        }
        Some(left.session)
    }

    /// Takes the first session left, if this window put it aside.
    pub(crate) fn restore_own(&mut self) -> Option<Session> {
        let is_own = self.left.first().is_some_and(|left| left.is_own);
        if is_own { self.restore() } else { None }
    }

    /// Discards the first session left behind.
    pub(crate) fn discard(&mut self) {
        self.left.drain(..1.min(self.left.len())).for_each(|left| remove(&left.place.file));
    }

    /// Returns the result of the write that has just ended, if any.
    fn poll_writing(&mut self) -> Option<Result<()>> {
        let Some(TaskEvent::Done(result)) = self.writing.as_mut()?.poll() else { return None };
        self.writing = None;
        if result.is_err() {
            self.written = None;
        }
        Some(result)
    }

    fn finish_writing(&mut self) {
        while self.writing.is_some() {
            match self.poll_writing() {
                Some(result) => self.is_failing = result.is_err(),
                None => std::thread::yield_now(),
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
    if let Err(e) = std::fs::remove_file(file)
        && e.kind() != std::io::ErrorKind::NotFound
    {
        eprintln!("what was kept could not be removed: {e} ({})", file.display());
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
        first.keep(0.0, 1, &session("a.safetensors"), &ctx).unwrap();
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
    fn what_is_put_aside_is_recalled_by_what_it_is_about_and_offered_to_the_next_window() {
        let (_held, folder) = folder();
        let ctx = egui::Context::default();
        let mut autosave = Autosave::open(folder.clone());
        autosave.keep(0.0, 1, &session("a"), &ctx).unwrap();
        autosave.put_aside(session("a2")).unwrap();
        autosave.put_aside(session("b")).unwrap();
        autosave.keep(0.0, 1, &session("c"), &ctx).unwrap();
        assert!(!autosave.recall(Path::new("/data/c")));
        assert!(autosave.recall(Path::new("/data/a2")));
        assert_eq!(autosave.restore(), Some(session("a2")));
        autosave.discard();
        assert!(autosave.left.is_empty());
        autosave.put_aside(session("d")).unwrap();
        drop(autosave);
        let left = Autosave::open(folder.clone()).left;
        assert_eq!(left.iter().map(|l| &l.session).collect::<Vec<_>>(), [&session("d")]);
        drop(left);

        let mut autosave = Autosave::open(folder.clone());
        let folder = folder.unwrap();
        std::fs::remove_dir_all(&folder).unwrap();
        std::fs::write(&folder, "no folder").unwrap();
        assert!(autosave.put_aside(session("e")).is_err());
        assert_eq!(autosave.restore(), Some(session("e")), "in memory");
    }

    #[test]
    fn edits_are_written_at_once_and_the_rest_after_a_while() {
        let (_held, folder) = folder();
        let ctx = egui::Context::default();
        let mut autosave = Autosave::open(folder.clone());
        let file = autosave.place.as_ref().unwrap().file.clone();
        assert_eq!(autosave.keep(10.0, 0, &session("a"), &ctx).unwrap(), Some(EVERY_SECS));
        assert_eq!(autosave.keep(20.0, 0, &session("b"), &ctx).unwrap(), Some(EVERY_SECS - 10.0));
        assert!(!file.exists());
        autosave.keep(10.0 + EVERY_SECS, 0, &session("c"), &ctx).unwrap();
        autosave.finish_writing();
        assert_eq!(Session::load(&file).unwrap(), session("c"));
        autosave.keep(41.0, 1, &session("d"), &ctx).unwrap();
        autosave.finish_writing();
        assert_eq!(Session::load(&file).unwrap(), session("d"));
        assert_eq!(autosave.keep(42.0, 1, &session("d"), &ctx).unwrap(), None, "nothing to do");
        autosave.clear(1);
        assert!(!file.exists());
    }

    #[test]
    fn what_cannot_be_written_is_said_once_and_tried_again() {
        let (_held, folder) = folder();
        let folder = folder.unwrap();
        let ctx = egui::Context::default();
        let mut autosave = Autosave::open(Some(folder.clone()));
        let file = autosave.place.as_ref().unwrap().file.clone();
        let settle = |autosave: &mut Autosave, now: f64, revision: u64, name: &str| loop {
            match autosave.keep(now, revision, &session(name), &ctx) {
                Ok(_) if autosave.writing.is_some() => std::thread::yield_now(),
                told => return told,
            }
        };
        assert_eq!(settle(&mut autosave, 0.0, 1, "a").unwrap(), None);
        std::fs::rename(&folder, folder.with_extension("aside")).unwrap();
        std::fs::write(&folder, "no folder").unwrap();
        assert!(settle(&mut autosave, 1.0, 2, "b").is_err());
        assert_eq!(settle(&mut autosave, 2.0, 2, "b").unwrap(), Some(EVERY_SECS - 1.0));
        assert_eq!(settle(&mut autosave, 1.0 + EVERY_SECS, 2, "b").unwrap(), Some(EVERY_SECS), "said before");
        assert!(autosave.keep_now(&session("b")).is_err());
        std::fs::remove_file(&folder).unwrap();
        std::fs::rename(folder.with_extension("aside"), &folder).unwrap();
        assert_eq!(Session::load(&file).unwrap(), session("a"), "what was kept before is still there");
        assert_eq!(settle(&mut autosave, 99.0, 2, "b").unwrap(), None);
        assert_eq!(Session::load(&file).unwrap(), session("b"));
        autosave.clear(2);
        assert!(!file.exists());
    }

    #[test]
    fn without_a_folder_and_with_damaged_files_it_goes_on() {
        let ctx = egui::Context::default();
        assert_eq!(Autosave::open(None).keep(0.0, 1, &session("a"), &ctx).unwrap(), None);
        let (_held, folder) = folder();
        std::fs::create_dir_all(folder.as_ref().unwrap()).unwrap();
        std::fs::write(folder.as_ref().unwrap().join("0.surgtpgs"), "damaged").unwrap();
        let autosave = Autosave::open(folder);
        assert!(autosave.left.is_empty() && autosave.place.is_some());
    }
}
