//! An export in the background, from its start until its result is read.

use crate::{
    engine::Negatives,
    jobs::ExportRequest,
    viewer::{
        backend::{
            Backend,
            task::{Task, TaskEvent, TaskProgress},
        },
        state::toast::SHOWN_SECS,
    },
};
use egui::Context;
use std::{path::Path, sync::Arc};
use surgtpgs_core::{Result, export::ExportSummary};

/// Seconds within which closing the window again is the same wish, such as a key that is held down.
const SAME_WISH: f64 = 1.0;

/// Pace of an export. Work before its first frame, such as carrying marks, is no part of it.
#[derive(Default)]
struct Pace {
    /// Frames that are left from an earlier export.
    begun: Option<usize>,
    /// Progress when the first frame was finished.
    first: Option<TaskProgress>,
}

impl Pace {
    fn follow(&mut self, progress: &TaskProgress) {
        if progress.total > 0 && progress.done > *self.begun.get_or_insert(progress.done) {
            self.first.get_or_insert_with(|| progress.clone());
        }
    }

    /// Returns the seconds that the export will still take; `None` before there is a pace.
    fn seconds_left(&self, progress: &TaskProgress) -> Option<f64> {
        let first = self.first.as_ref()?;
        let since = TaskProgress {
            done: progress.done.saturating_sub(first.done),
            total: progress.total.saturating_sub(first.done),
            seconds: progress.seconds - first.seconds,
            ..progress.clone()
        };
        since.seconds_left()
    }
}

/// An export in the background.
pub(crate) struct Exporting {
    pub(crate) task: Task<ExportSummary>,
    /// The request. Made again after a stop, it goes on.
    pub(crate) asked: (ExportRequest, Negatives),
    /// Result, once there is one.
    pub(crate) summary: Option<ExportSummary>,
    pace: Pace,
    /// Time at which the window was last asked to close, seconds.
    close_asked: Option<f64>,
}

impl Exporting {
    pub(crate) fn start(
        backend: Arc<dyn Backend>,
        request: ExportRequest,
        negatives: Negatives,
        ctx: &Context,
    ) -> Self {
        let asked = (request.clone(), negatives.clone());
        let task = Task::start("export", ctx, move |task| backend.export(&request, &negatives, task));
        Self { task, asked, summary: None, pace: Pace::default(), close_asked: None }
    }

    /// Returns the folder that is written.
    pub(crate) fn folder(&self) -> &Path {
        &self.asked.0.folder
    }

    /// Takes the result; returns an error that ended the export.
    pub(crate) fn poll(&mut self) -> Result<()> {
        if let Some(TaskEvent::Done(result)) = self.task.poll() {
            self.summary = Some(result?);
        }
        self.pace.follow(&self.task.progress);
        Ok(())
    }

    pub(crate) fn is_running(&self) -> bool {
        self.summary.is_none()
    }

    /// Returns the seconds that it will still take; `None` before there is a pace.
    pub(crate) fn seconds_left(&self) -> Option<f64> {
        self.pace.seconds_left(&self.task.progress)
    }

    /// Returns `true` if it keeps the window from closing. Asked again while the message about that is shown,
    /// it stops instead.
    pub(crate) fn holds_close(&mut self, now: f64) -> bool {
        if !self.is_running() || self.task.is_cancelling() {
            return false;
        }
        let before = self.close_asked.replace(now);
        let is_again = before.is_some_and(|before| (SAME_WISH..=SHOWN_SECS).contains(&(now - before)));
        if is_again {
            self.task.cancel();
        }
        !is_again
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_pace_is_that_of_frames_from_the_first_finished_one_on() {
        let mut pace = Pace::default();
        let mut left = |done, seconds| {
            let progress = TaskProgress { done, total: 60, seconds, ..TaskProgress::default() };
            pace.follow(&progress);
            pace.seconds_left(&progress)
        };
        // Ten frames were there before, and marks were carried for 11 s.
        assert_eq!([left(10, 0.0), left(11, 11.0), left(12, 11.5)], [None; 3]);
        assert_eq!([left(21, 16.0), left(60, 35.5)], [Some(19.5), Some(0.0)]);
    }
}
