//! Progress of long work, and the wish to stop it.

use std::ops::ControlFlow;

/// Progress of a job.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Progress<'a> {
    /// Name of the work being done, e.g. "training".
    pub stage: &'a str,
    /// Number of steps of this stage that are done.
    pub done: usize,
    /// Number of steps of this stage.
    pub total: usize,
    /// Further words about the progress, or empty.
    pub detail: &'a str,
}

/// Called often; [`ControlFlow::Break`] asks the job to stop.
pub type Observer<'a> = dyn FnMut(&Progress<'_>) -> ControlFlow<()> + 'a;
