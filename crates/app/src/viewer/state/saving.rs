//! The session file of the window, and sessions that are about to be applied or saved.

use crate::viewer::state::{
    autosave::{Autosave, LeftId},
    content::Content,
    session::Session,
};
use serde_json::{Map, Value};
use std::path::PathBuf;
use surgtpgs_core::overlay::OverlayLook;

/// Session file, autosave, and the session that is being applied or saved.
pub(crate) struct Saving {
    pub(crate) saved: Saved,
    pub(crate) to_apply: Option<ToApply>,
    pub(crate) autosave: Autosave,
    /// Style of the overlay and width of the panel, as the preferences were saved last.
    pub(crate) kept_look: Option<(OverlayLook, f32)>,
    /// `true` if the offer to restore unsaved work is put off until something else is opened.
    pub(crate) is_recovery_put_off: bool,
    /// Unsaved works that are not offered again before the next start, but on the start page.
    pub(crate) for_later: Vec<LeftId>,
    /// Kind of what could not be saved last, and the problem that says why.
    pub(crate) failed: Option<(SavedKind, String)>,
}

/// Kind of what the user saves.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum SavedKind {
    Session,
    Marks,
}

impl SavedKind {
    /// Returns its name in a sentence.
    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Session => "session",
            Self::Marks => "marks",
        }
    }
}

/// A session to apply once its scene or recording is open.
pub(crate) struct ToApply {
    pub(crate) session: Session,
    pub(crate) origin: Origin,
}

/// Origin of a session.
pub(crate) enum Origin {
    /// A file that the user saved.
    File(PathBuf),
    /// Work that was left unsaved. It stays there until it is applied.
    Left(LeftId),
}

/// File of the session, and its saved content.
#[derive(Default)]
pub(crate) struct Saved {
    /// Session file, once there is one.
    pub(crate) file: Option<PathBuf>,
    /// Content of the file.
    pub(crate) content: Content,
    pub(crate) unknown: Map<String, Value>,
}

impl Saved {
    /// Returns `true` if the file holds other decisions than were read or written here. One that is gone
    /// holds none.
    pub(crate) fn is_changed_elsewhere(&self) -> bool {
        let Some(file) = self.file.as_ref().filter(|file| file.exists()) else { return false };
        !Session::load(file).is_ok_and(|there| there.content.is_alike(&self.content))
    }
}

impl Saving {
    pub(crate) fn new(autosave: Autosave) -> Self {
        Self {
            saved: Saved::default(),
            kept_look: None,
            to_apply: None,
            autosave,
            is_recovery_put_off: false,
            for_later: Vec::new(),
            failed: None,
        }
    }
}
