//! The request that waits, which may make the work in progress needless.

use std::sync::{Mutex, MutexGuard, PoisonError};

/// The request that waits for an engine, told by another thread.
#[derive(Debug, Default)]
pub(crate) struct Pending(Mutex<Option<Next>>);

/// A request that waits.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Next {
    /// A view of a frame: work for frames beside it still counts.
    Frame(usize),
    /// Something else: no work counts any more.
    Other,
}

impl Pending {
    /// Tells the request that waits.
    pub(crate) fn set(&self, next: Next) {
        *self.lock() = Some(next);
    }

    /// Tells that no request waits.
    pub(crate) fn clear(&self) {
        *self.lock() = None;
    }

    /// Returns `true` if the request that waits is about other frames than those that are `beside` the work in
    /// progress.
    pub(crate) fn is_elsewhere(&self, beside: impl Fn(usize) -> bool) -> bool {
        match *self.lock() {
            None => false,
            Some(Next::Frame(frame)) => !beside(frame),
            Some(Next::Other) => true,
        }
    }

    fn lock(&self) -> MutexGuard<'_, Option<Next>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
