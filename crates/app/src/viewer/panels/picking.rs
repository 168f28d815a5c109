//! Paths that a dialog asks for by the dialog of the system, beside a field to type them into.

use crate::viewer::{
    backend::{
        Backend,
        paths::{PathAsk, Picked},
        task::{Task, TaskEvent},
    },
    panels::widgets::caption,
};
use egui::{Button, Context, Response, Ui};
use std::{path::PathBuf, sync::Arc};

/// The dialog of the system.
#[derive(Default)]
pub(crate) struct Picking {
    task: Option<Task<Picked>>,
    /// `true` if the system turned out to have no file dialog.
    has_no_dialog: bool,
}

impl Picking {
    /// Shows the dialog of the system.
    pub(crate) fn ask(&mut self, ask: PathAsk, backend: Arc<dyn Backend>, ctx: &Context) {
        self.task = Some(Task::start("file dialog", ctx, move |_| Ok(backend.pick(&ask))));
    }

    /// Returns the path that the user picked, once.
    pub(crate) fn poll(&mut self) -> Option<PathBuf> {
        let Some(TaskEvent::Done(result)) = self.task.as_mut().and_then(Task::poll) else { return None };
        self.task = None;
        match result {
            Ok(Picked::Path(path)) => return Some(path),
            Ok(Picked::Unavailable) => self.has_no_dialog = true,
            _ => {}
        }
        None
    }

    /// Shows a button to ask with, while that is possible.
    pub(crate) fn button_ui(&self, ui: &mut Ui, label: &str) -> Response {
        ui.add_enabled(self.task.is_none() && !self.has_no_dialog, Button::new(label))
    }

    /// Says so if the system has no file dialog.
    pub(crate) fn note_ui(&self, ui: &mut Ui) {
        if self.has_no_dialog {
            ui.label(caption("This computer shows no file dialog: type the path into the field."));
        }
    }
}
