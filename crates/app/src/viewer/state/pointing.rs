//! Clicks and boxes that wait for the masks of the objects they point at.

use crate::viewer::backend::task::Task;
use std::{collections::VecDeque, path::PathBuf};
use surgtpgs_core::marks::Mark;

/// Marks that a network makes masks of, in the order in which they were made.
#[derive(Default)]
pub(crate) struct Pointing {
    /// Recording that they were made on.
    pub(crate) recording: PathBuf,
    pub(crate) waiting: VecDeque<Mark>,
    /// The mark at hand, with the task that returns it with its mask.
    pub(crate) underway: Option<(Mark, Task<Mark>)>,
}

impl Pointing {
    /// Returns the number of marks that wait.
    pub(crate) fn count(&self) -> usize {
        self.waiting.len() + usize::from(self.underway.is_some())
    }
}
