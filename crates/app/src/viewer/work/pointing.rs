//! Masks of the objects that clicks and boxes point at, made by a network in the background.

use crate::viewer::{
    backend::{
        paths::{PathAsk, PathKind},
        task::{Task, TaskEvent},
    },
    shared::Shared,
    state::pointing::Pointing,
};
use egui::Context;
use std::path::{Path, PathBuf};
use surgtpgs_core::marks::Mark;

impl Shared {
    /// Returns `true` if clicks and boxes become masks: that is wanted, a network was chosen, and the recorded
    /// frames are at hand.
    pub(crate) fn finds_borders(&self) -> bool {
        let has_model = !self.preferences.models.masks.as_os_str().is_empty();
        self.preferences.finds_borders && has_model && self.recorded().is_some()
    }

    /// Returns the recording whose frames can be read.
    fn recorded(&self) -> Option<&PathBuf> {
        self.info().filter(|info| info.has_original)?.sequence.as_ref()
    }

    /// Adds a mark. If it points at an object whose borders are to be found, it is added once they are.
    pub(crate) fn add_mark(&mut self, mark: Mark, ctx: &Context) {
        if mark.pointed().is_none() || !self.finds_borders() {
            self.document.add_mark(mark);
            return;
        }
        let recording = self.recorded().cloned().unwrap_or_default();
        if self.pointing.recording != recording {
            self.pointing = Pointing { recording, ..Pointing::default() };
        }
        self.pointing.waiting.push_back(mark);
        self.point_at_next(ctx);
    }

    /// Asks for the mask of the next mark that waits, unless another one is being made.
    fn point_at_next(&mut self, ctx: &Context) {
        if self.pointing.underway.is_some() {
            return;
        }
        let Some(mark) = self.pointing.waiting.pop_front() else { return };
        let (backend, asked) = (self.backend.clone(), mark.clone());
        let (model, recording) = (self.preferences.models.masks.clone(), self.pointing.recording.clone());
        let task = Task::start("borders", ctx, move |_| backend.with_mask(&model, &recording, &asked));
        self.pointing.underway = Some((mark, task));
    }

    /// Takes the mask that was made. Where none was found, the mark counts as it was made.
    pub(crate) fn poll_pointing(&mut self, now: f64, ctx: &Context) {
        if self.recorded() != Some(&self.pointing.recording) {
            self.pointing = Pointing::default();
        }
        let event = self.pointing.underway.as_mut().and_then(|(_, task)| task.poll());
        let Some(TaskEvent::Done(result)) = event else { return };
        let Some((mark, _)) = self.pointing.underway.take() else { return };
        let made = self.settle(result);
        let is_same = made.as_ref() == Some(&mark);
        self.document.add_mark(made.unwrap_or(mark));
        if is_same {
            self.say("No object was found there: the mark counts as it was made", None, now);
        }
        self.point_at_next(ctx);
    }

    /// Asks for the folder of the network that finds borders.
    pub(crate) fn choose_masks_model(&mut self, ctx: &Context) {
        let known = &self.preferences.models.masks;
        let folder = known.parent().filter(|_| known.is_dir()).map(Path::to_owned);
        let title = "Choose a folder with a Segment Anything".into();
        self.ask_for(PathAsk { title, kind: PathKind::MasksModel, folder }, ctx);
    }

    /// Takes the folder of a network, which finds borders from now on.
    pub(crate) fn take_masks_model(&mut self, folder: &Path) {
        self.preferences.models.masks = folder.to_owned();
        self.preferences.finds_borders = true;
        self.preferences.save();
    }
}
