//! Automatic saving of unsaved work to the user's data folder, so that neither a crash nor a closed window
//! loses it. A window's file exists exactly as long as something in the window is not saved elsewhere.
//!
//! Every window locks a lock file of its own. The system frees the lock however the program ends. A session
//! beside a free lock was left behind, and is offered to the user.

use crate::viewer::{
    backend::{
        Info,
        task::{Task, TaskEvent},
    },
    state::session::Session,
};
use std::{
    fs::{File, OpenOptions, TryLockError},
    path::{Path, PathBuf},
    time::SystemTime,
};
use surgtpgs_core::{Error, Result};

/// Seconds between two writes of changes that are not edits, such as the frame.
pub(crate) const EVERY_SECS: f64 = 30.0;

/// Number of works that can be kept, those of open windows included. Each holds a file open.
const MAX_PLACES: usize = 128;

/// The place of this window, and the sessions that other windows left behind.
#[derive(Default)]
pub(crate) struct Autosave {
    folder: Option<PathBuf>,
    /// Place of the work that is open; `None` until there is one to take.
    place: Option<Place>,
    /// Sessions left behind or put aside, newest first.
    pub(crate) left: Vec<Left>,
    next_id: LeftId,
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
    fn lock(folder: &Path, number: usize, is_used: bool) -> Result<Option<Self>> {
        let file = folder.join(format!("{number}.{}", crate::viewer::state::session::EXTENSION));
        if file.is_file() != is_used {
            return Ok(None);
        }
        let lock = lock(&file.with_extension("lock"))?;
        // Another window may have written or removed it before it freed the lock.
        Ok(lock.filter(|_| file.is_file() == is_used).map(|lock| Self { file, _lock: lock }))
    }

    /// Locks the first place that holds no session, in a folder that is made if it is missing.
    fn free(folder: &Path) -> Result<Self> {
        std::fs::create_dir_all(folder).map_err(|e| Error::io("make the folder", folder, e))?;
        let mut fault = None;
        for number in 0..MAX_PLACES {
            match Self::lock(folder, number, false) {
                Ok(Some(place)) => return Ok(place),
                Ok(None) => {}
                Err(e) => fault = Some(e),
            }
        }
        let is_full = || {
            let what = format!("{MAX_PLACES} unsaved works are kept here already");
            Error::input_at(folder, what, "Restore or discard some of them on the start page.")
        };
        Err(fault.unwrap_or_else(is_full))
    }
}

/// Number of a session that was left, which no other one has while the window is open.
pub(crate) type LeftId = u64;

/// A session that another window left behind, or that this one put aside or made its own.
pub(crate) struct Left {
    pub(crate) id: LeftId,
    pub(crate) session: Session,
    /// Place of its file; `None` if it is in memory alone.
    place: Option<Place>,
    /// `true` if this window put it aside, or used a part of it.
    pub(crate) is_own: bool,
    /// `false` if its file lacks changes, because it could not be written.
    is_kept: bool,
}

impl Left {
    /// Returns `true` if a file was written after the work was kept.
    pub(crate) fn is_older_than(&self, file: &Path) -> bool {
        let kept = self.place.as_ref().and_then(|place| written_at(&place.file));
        kept.zip(written_at(file)).is_some_and(|(kept, written)| kept < written)
    }

    /// Removes its file.
    fn remove(self) {
        if let Some(place) = self.place {
            remove(&place.file);
        }
    }
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
        for place in (0..MAX_PLACES).filter_map(|number| Place::lock(at, number, true).ok()?) {
            match Session::load(&place.file) {
                Ok(session) => {
                    let (id, place) = (left.len() as LeftId, Some(place));
                    left.push(Left { id, session, place, is_own: false, is_kept: true });
                }
                Err(_) => {
                    crate::text::say(&format!(
                        "what was left unsaved cannot be read ({})",
                        place.file.display()
                    ));
                }
            }
        }
        let time = |place: &Place| written_at(&place.file);
        left.sort_by_key(|left| std::cmp::Reverse(left.place.as_ref().and_then(time)));
        // Where there is no place, another try is made once there is something to keep.
        let (place, next_id) = (Place::free(at).ok(), left.len() as LeftId);
        Self { place, left, next_id, folder, ..Self::default() }
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
            Some(Err(e)) => self.put_off(now, e)?,
            Some(Ok(())) => self.is_failing = false,
            None => {}
        }
        if self.folder.is_none() {
            return Ok(None);
        }
        if self.written.as_ref() == Some(session) {
            (self.due, self.revision) = (None, revision);
            return Ok(None);
        }
        let due = *self.due.get_or_insert(now + EVERY_SECS);
        if revision == self.revision && now < due {
            return Ok(Some(due - now));
        }
        if self.writing.is_none() {
            self.revision = revision;
            let file = match self.file() {
                Ok(Some(file)) => file,
                Ok(None) => return Ok(None),
                Err(e) => return self.put_off(now, e).map(|()| Some(EVERY_SECS)),
            };
            let theirs = session.clone();
            self.writing = Some(Task::start("keeping the work", ctx, move |_| theirs.save(&file)));
            self.written = Some(session.clone());
            self.due = None;
        }
        Ok(None)
    }

    /// Puts off the next try to write after one that failed; the first time, this is an error.
    fn put_off(&mut self, now: f64, e: Error) -> Result<()> {
        self.due = Some(now + EVERY_SECS);
        if std::mem::replace(&mut self.is_failing, true) { Ok(()) } else { Err(e) }
    }

    /// Returns the file of this window's place, and takes a place if it has none; `None` if nothing is kept.
    fn file(&mut self) -> Result<Option<PathBuf>> {
        if let (None, Some(folder)) = (&self.place, &self.folder) {
            self.place = Some(Place::free(folder)?);
        }
        Ok(self.place.as_ref().map(|place| place.file.clone()))
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
        if self.written.as_ref() == Some(session) {
            return Ok(());
        }
        self.file()?.map_or(Ok(()), |file| session.save(&file))
    }

    /// Leaves `session` in its place, as if this window had ended; what follows gets another place. If the
    /// session cannot be written, it can be restored as long as this window is open.
    pub(crate) fn put_aside(&mut self, session: Session) -> Result<()> {
        let kept = self.keep_now(&session);
        let (place, is_kept) = (self.place.take(), kept.is_ok());
        self.left.insert(0, Left { id: self.next_id, session, place, is_own: true, is_kept });
        self.next_id += 1;
        (self.written, self.due, self.is_failing) = (None, None, false);
        kept
    }

    /// Removes all files of this window, at the end of the program.
    pub(crate) fn forget(&mut self) {
        self.clear(self.revision);
        self.left.extract_if(.., |left| left.is_own).for_each(Left::remove);
    }

    /// Returns a session that was left.
    pub(crate) fn left(&self, id: LeftId) -> Option<&Left> {
        self.left.iter().find(|left| left.id == id)
    }

    /// Moves the newest session about a scene or recording to the front of the sessions left, and returns it;
    /// `None` if there is none. One that was made on other frames is the last choice.
    pub(crate) fn recall(&mut self, info: &Info) -> Option<&Left> {
        let is_about = |left: &Left| left.session.is_about(info);
        let fits = |left: &Left| is_about(left) && !left.session.is_of_other_frames(info);
        let at = self.left.iter().position(fits).or_else(|| self.left.iter().position(is_about))?;
        self.left[..=at].rotate_right(1);
        self.left.first()
    }

    /// Makes a session that was left, and that the window now shows, the work of this window: its place becomes
    /// that of the window.
    pub(crate) fn adopt(&mut self, id: LeftId) {
        let Some(left) = self.take(id) else { return };
        self.clear(self.revision);
        if let Some(place) = left.place {
            self.place = Some(place);
            self.written = left.is_kept.then_some(left.session);
            self.is_failing = !left.is_kept;
        }
    }

    /// Makes a session that was left one of this window, as if it had put it aside.
    pub(crate) fn make_own(&mut self, id: LeftId) {
        self.left.iter_mut().filter(|left| left.id == id).for_each(|left| left.is_own = true);
    }

    /// Discards a session that was left.
    pub(crate) fn discard(&mut self, id: LeftId) {
        if let Some(left) = self.take(id) {
            left.remove();
        }
    }

    fn take(&mut self, id: LeftId) -> Option<Left> {
        let at = self.left.iter().position(|left| left.id == id)?;
        Some(self.left.remove(at))
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

/// Locks a file; `None` if another window has it.
fn lock(file: &Path) -> Result<Option<File>> {
    let fault = |e| Error::io("lock the file", file, e);
    let opened = OpenOptions::new().create(true).truncate(false).write(true).open(file).map_err(fault)?;
    match opened.try_lock() {
        Ok(()) => Ok(Some(opened)),
        Err(TryLockError::WouldBlock) => Ok(None),
        Err(TryLockError::Error(e)) => Err(fault(e)),
    }
}

/// Returns the time at which a file was written last.
fn written_at(file: &Path) -> Option<SystemTime> {
    file.metadata().and_then(|about| about.modified()).ok()
}

fn remove(file: &Path) {
    if let Err(e) = std::fs::remove_file(file)
        && e.kind() != std::io::ErrorKind::NotFound
    {
        crate::text::say(&format!("what was kept could not be removed: {e} ({})", file.display()));
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

    fn info(name: &str) -> Info {
        Info { path: PathBuf::from("/data").join(name), ..Info::default() }
    }

    /// Restores the first session left.
    fn restore(autosave: &mut Autosave) -> Session {
        let (id, session) = (autosave.left[0].id, autosave.left[0].session.clone());
        autosave.adopt(id);
        session
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
        assert_eq!(restore(&mut next), session("a.safetensors"));
        drop(next);
        assert_eq!(Autosave::open(folder.clone()).left.len(), 1, "restored, and still not saved elsewhere");
        let mut last = Autosave::open(folder.clone());
        last.discard(last.left[0].id);
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
        assert!(autosave.recall(&info("c")).is_none());
        assert!(autosave.recall(&info("a2")).is_some());
        assert_eq!(restore(&mut autosave), session("a2"));
        autosave.discard(autosave.left[0].id);
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
        assert_eq!(restore(&mut autosave), session("e"), "in memory");
    }

    #[test]
    fn frames_tell_more_of_what_work_is_about_than_paths() {
        let of = |name: &str, frames: &str| Session { recording: Some(frames.into()), ..session(name) };
        let mut autosave = Autosave::default();
        autosave.put_aside(of("a.mp4", "one")).unwrap();
        autosave.put_aside(of("a", "two")).unwrap();
        let recalled = |autosave: &mut Autosave, frames: &str| {
            let info = Info { frames_sha256: Some(frames.into()), ..info("a") };
            autosave.recall(&info).unwrap().session.clone()
        };
        assert_eq!(recalled(&mut autosave, "one"), of("a.mp4", "one"));
        assert_eq!(recalled(&mut autosave, "three"), of("a", "two"), "nothing is of these frames");
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
    fn work_without_a_place_says_so_and_stays_until_there_is_one() {
        let (_held, folder) = folder();
        let folder = folder.unwrap();
        let ctx = egui::Context::default();
        std::fs::write(&folder, "no folder").unwrap();
        let mut autosave = Autosave::open(Some(folder.clone()));
        assert!(autosave.keep(0.0, 1, &session("a"), &ctx).is_err());
        assert_eq!(
            autosave.keep(1.0, 1, &session("a"), &ctx).unwrap(),
            Some(EVERY_SECS - 1.0),
            "said before"
        );
        assert_eq!(
            autosave.keep(2.0, 2, &session("b"), &ctx).unwrap(),
            Some(EVERY_SECS),
            "tried with every edit"
        );
        assert!(autosave.put_aside(session("b")).is_err());
        std::fs::remove_file(&folder).unwrap();
        assert_eq!(restore(&mut autosave), session("b"), "in memory");
        autosave.keep_now(&session("b")).unwrap();
        assert_eq!(Session::load(&folder.join("0.surgtpgs")).unwrap(), session("b"));

        for number in 1..MAX_PLACES {
            session("old").save(&folder.join(format!("{number}.surgtpgs"))).unwrap();
        }
        let mut other = Autosave::open(Some(folder.clone()));
        assert_eq!(other.left.len(), MAX_PLACES - 1);
        let full = other.keep(0.0, 1, &session("c"), &ctx).unwrap_err().to_string();
        assert!(full.contains("128 unsaved works") && full.contains("discard some"), "{full}");
        assert!(other.put_aside(session("c")).is_err());
        assert_eq!(other.left[0].session, session("c"));
        other.discard(other.left[1].id);
        other.keep_now(&session("d")).unwrap();
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
