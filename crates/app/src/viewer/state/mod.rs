//! State of single concerns: the user's decisions, the clock, the preferences, their files, and tasks
//! underway.

pub(crate) mod autosave;
mod bookmarks;
pub(crate) mod clean_up;
mod comparison;
pub(crate) mod content;
pub(crate) mod document;
#[cfg(test)]
mod document_tests;
pub(crate) mod excluded;
pub(crate) mod exporting;
mod history;
pub(crate) mod loss_curve;
pub(crate) mod marking;
pub(crate) mod marks;
pub(crate) mod measure;
pub(crate) mod opening;
pub(crate) mod phases;
pub(crate) mod playback;
pub(crate) mod pointing;
pub(crate) mod preferences;
pub(crate) mod recent;
pub(crate) mod reconstruction;
pub(crate) mod saving;
pub(crate) mod session;
pub(crate) mod time_scale;
pub(crate) mod toast;
pub(crate) mod view_mode;
pub(crate) mod zoom;
