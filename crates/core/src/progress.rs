//! Progress of long work, and the request to stop it.
//!
//! All long work of this crate reports to an [`Observer`]. Training does not: its caller takes every step
//! with [`Trainer::step`](crate::train::Trainer::step), and sees the whole trainer between two steps.

use crate::{Error, Result};
use std::ops::ControlFlow;

/// Progress of long work.
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

/// Gets the progress of long work, often. [`ControlFlow::Break`] asks the work to stop.
pub type Observer<'a> = dyn FnMut(&Progress<'_>) -> ControlFlow<()> + 'a;

impl<'a> Progress<'a> {
    /// Creates a progress without further words.
    pub fn new(stage: &'a str, done: usize, total: usize) -> Self {
        Self { stage, done, total, detail: "" }
    }

    /// Tells the observer. Returns [`Error::Cancelled`] if it asks to stop.
    pub fn tell(&self, observer: &mut Observer<'_>) -> Result<()> {
        if observer(self).is_break() { Err(Error::Cancelled) } else { Ok(()) }
    }
}

/// Observes nothing and never asks to stop; use as `&mut unobserved`.
pub fn unobserved(_: &Progress<'_>) -> ControlFlow<()> {
    ControlFlow::Continue(())
}
