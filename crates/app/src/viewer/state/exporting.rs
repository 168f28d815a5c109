//! An export in the background, from its start until its result is read.

use crate::{
    engine::Negatives,
    jobs::ExportRequest,
    viewer::backend::{
        Backend,
        task::{Task, TaskEvent},
    },
};
use egui::Context;
use std::{path::PathBuf, sync::Arc};
use surgtpgs_core::{Result, export::ExportSummary};

/// An export in the background.
pub(crate) struct Exporting {
    pub(crate) task: Task<ExportSummary>,
    /// Folder that is written.
    pub(crate) folder: PathBuf,
    /// Result, once there is one.
    pub(crate) summary: Option<ExportSummary>,
}

impl Exporting {
    pub(crate) fn start(
        backend: Arc<dyn Backend>,
        request: ExportRequest,
        negatives: Negatives,
        ctx: &Context,
    ) -> Self {
        let folder = request.folder.clone();
        let task = Task::start("export", ctx, move |task| backend.export(&request, &negatives, task));
        Self { task, folder, summary: None }
    }

    /// Takes the result; returns an error that ended the export.
    pub(crate) fn poll(&mut self) -> Result<()> {
        if let Some(TaskEvent::Done(result)) = self.task.poll() {
            self.summary = Some(result?);
        }
        Ok(())
    }

    pub(crate) fn is_running(&self) -> bool {
        self.summary.is_none()
    }
}
