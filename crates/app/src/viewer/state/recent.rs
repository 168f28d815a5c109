//! Paths that were opened last, as far as they are not there any more.

use crate::viewer::backend::task::{Task, TaskEvent};
use egui::Context;
use std::path::{Path, PathBuf};

/// Paths that were opened last and are not there any more. They are looked for on a thread of their own: a
/// disk of another computer that does not answer would hold up the window.
#[derive(Default)]
pub(crate) struct Gone {
    /// The paths that were looked for last.
    looked_for: Vec<PathBuf>,
    gone: Vec<PathBuf>,
    task: Option<Task<Vec<PathBuf>>>,
}

impl Gone {
    /// Looks for paths, unless these were looked for last, and takes what has been found.
    pub(crate) fn poll(&mut self, paths: &[PathBuf], ctx: &Context) {
        if self.looked_for != paths {
            self.looked_for = paths.to_vec();
            let mut gone = paths.to_vec();
            self.task = Some(Task::start("recent files", ctx, move |_| {
                gone.retain(|path| !path.exists());
                Ok(gone)
            }));
        }
        if let Some(TaskEvent::Done(gone)) = self.task.as_mut().and_then(Task::poll) {
            (self.task, self.gone) = (None, gone.unwrap_or_default());
        }
    }

    /// Returns `true` if a path is known not to be there.
    pub(crate) fn has(&self, path: &Path) -> bool {
        self.gone.iter().any(|gone| gone == path)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_same_paths_are_looked_for_once() {
        let folder = tempfile::tempdir().unwrap();
        let mut paths = vec![folder.path().to_owned(), folder.path().join("gone.mp4")];
        let (mut gone, ctx) = (Gone::default(), Context::default());
        let look = |gone: &mut Gone, paths: &[PathBuf]| {
            gone.poll(paths, &ctx);
            while gone.task.is_some() {
                std::thread::yield_now();
                gone.poll(paths, &ctx);
            }
        };
        look(&mut gone, &paths);
        assert!(!gone.has(&paths[0]) && gone.has(&paths[1]));
        std::fs::write(&paths[1], "").unwrap();
        look(&mut gone, &paths);
        assert!(gone.has(&paths[1]));
        paths.swap(0, 1);
        look(&mut gone, &paths);
        assert!(!gone.has(&paths[0]));
    }
}
