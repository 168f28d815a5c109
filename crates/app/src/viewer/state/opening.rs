//! Things that are being opened or made.

use crate::viewer::{
    backend::{
        Demo, FrameSource, TrainRequest,
        paths::{PathAsk, Picked},
        task::Task,
    },
    state::{recent::Gone, session::Session},
};
use std::path::PathBuf;
use surgtpgs_core::marks::Marks;

/// The task that makes the demo; it can be looked at meanwhile.
pub(crate) type DemoTask = Task<Demo, Box<dyn FrameSource>>;

/// Things that are being opened or made, and what follows once they are there.
#[derive(Default)]
pub(crate) struct Opening {
    /// The system's dialog that asks for a path, and what it asks.
    pub(crate) picking: Option<(Task<Picked>, PathAsk)>,
    /// Path that the window's own dialog asks for, because the system has none or it is to be typed.
    pub(crate) asked: Option<PathAsk>,
    /// Paths that were opened before and are not there any more.
    pub(crate) gone: Gone,
    /// Folder of the built-in demo.
    pub(crate) demo_folder: Option<PathBuf>,
    pub(crate) demo: Option<DemoTask>,
    pub(crate) underway: Option<Underway>,
    /// Task that reads a file of marks.
    pub(crate) marks: Option<Task<Marks>>,
    /// Training to start, without asking, once its recording is open (for the built-in demo).
    pub(crate) train_when_open: Option<TrainRequest>,
}

/// A scene or recording that is being opened.
pub(crate) struct Underway {
    pub(crate) name: String,
    pub(crate) path: PathBuf,
    pub(crate) task: Task<Opened>,
}

/// A scene or recording that was opened.
pub(crate) struct Opened {
    pub(crate) source: Box<dyn FrameSource>,
    /// The session that was saved last beside it, and its file.
    pub(crate) saved: Option<(PathBuf, Session)>,
}

impl Opening {
    /// Returns `true` while the demo is being made.
    pub(crate) fn is_making_demo(&self) -> bool {
        self.demo.is_some()
    }

    /// Describes in words what is being made or opened.
    pub(crate) fn waiting_for(&self) -> Option<String> {
        match (&self.demo, &self.underway) {
            (Some(task), _) => Some(match task.progress.total {
                0 => "Making the demo recording…".into(),
                total => format!("Making the demo recording… {} of {total} frames", task.progress.done),
            }),
            (_, Some(underway)) => Some(format!("Opening {}…", underway.name)),
            _ => None,
        }
    }
}
