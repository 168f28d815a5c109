//! Training: its start, its news, its end, and closing the window meanwhile.

use crate::viewer::{
    backend::{FrameSource, TrainNews, TrainRequest, task::TaskEvent},
    remedy::{message, statement},
    shared::{Dialog, Shared},
    state::{reconstruction::Training, view_mode::ViewMode},
};
use egui::Context;
use std::path::PathBuf;
use surgtpgs_core::{Error, Result};

/// Seconds after which another request to close the window is obeyed, without saving the scene.
const CLOSES_AFTER: f64 = 5.0;

impl Shared {
    /// Starts training in the background, after those that are running or waiting.
    pub(crate) fn start_training(&mut self, request: TrainRequest, ctx: &Context) {
        if self.reconstruction.training.is_some() {
            let text = format!("{} is reconstructed next", self.path_name(&request.recording));
            self.reconstruction.queue.push_back(request);
            self.say(text, None, ctx.input(|i| i.time));
            return;
        }
        let pace = self.preferences.seconds_per_step_and_pixel;
        let shown = self.info().filter(|info| info.recording.as_ref() == Some(&request.recording));
        let expected =
            shown.map(|i| request.quality.expected_seconds(i.num_frames, [i.width, i.height], pace));
        self.reconstruction.training = Some(Training::start(self.backend.clone(), request, expected, ctx));
    }

    /// Returns `true` if the shown recording is being reconstructed: it or its latest preview is shown, but
    /// not a finished scene.
    pub(crate) fn is_reconstructing(&self) -> bool {
        let shown = self.info().map(|i| &i.path);
        self.reconstruction.training.as_ref().is_some_and(|t| Some(&t.recording) == shown)
    }

    /// Takes the news of the training.
    pub(crate) fn poll_training(&mut self, now: f64, ctx: &Context) {
        while let Some(event) = self.reconstruction.training.as_mut().and_then(Training::poll) {
            match event {
                // The task keeps it.
                TaskEvent::Progress(_) => {}
                TaskEvent::Update(TrainNews::Step(step, terms)) => {
                    if let Some(training) = &mut self.reconstruction.training {
                        training.curve.push(step, terms);
                    }
                }
                TaskEvent::Update(TrainNews::Preview(source)) if self.is_reconstructing() => {
                    self.show_preview(source);
                }
                TaskEvent::Update(TrainNews::Preview(_)) => {}
                TaskEvent::Done(result) => self.end_training(result, ctx),
            }
        }
        let looked_at = self.is_reconstructing().then(|| self.playback.frame());
        if let Some(training) = &mut self.reconstruction.training {
            if let Some(frame) = looked_at {
                training.task.set_play_head(frame);
            }
            training.watch_memory(now);
        }
    }

    /// Shows an intermediate state of training: beside the recorded frame, unless the user chose another
    /// view, or draws on this one.
    fn show_preview(&mut self, source: Box<dyn FrameSource>) {
        let Some(open) = &mut self.open else { return };
        let is_first = !open.info.has_reconstruction && self.document.mode == ViewMode::Original;
        if is_first && !self.viewport.marking.is_on {
            self.document.mode = ViewMode::SideBySide;
        }
        open.preview(source);
    }

    /// Takes the end of the training, with its scene or without, and begins the next one.
    fn end_training(&mut self, result: Result<PathBuf>, ctx: &Context) {
        let shows_preview = self.is_reconstructing() && self.info().is_some_and(|i| i.has_reconstruction);
        let Some(training) = self.reconstruction.training.take() else { return };
        let pixels = self.info().filter(|i| training.is_about(i)).map(|i| (i.width * i.height).max(1));
        if let Some((seconds, pixels)) = training.seconds_per_step.zip(pixels) {
            self.preferences.seconds_per_step_and_pixel = Some(seconds / pixels as f64);
        }
        let is_lost = !matches!(result, Ok(_) | Err(Error::Cancelled));
        if training.closing_since.is_some() && !is_lost {
            ctx.send_viewport_cmd(egui::ViewportCommand::Close);
        } else if let Some(next) = self.reconstruction.queue.pop_front() {
            self.start_training(next, ctx);
        }
        match result {
            Ok(scene) => self.take_scene(scene, &training, ctx),
            Err(error) => {
                if shows_preview {
                    // No file holds what the last preview shows.
                    self.open_path(&training.recording, ctx);
                }
                self.tell_end(&training, &error, ctx.input(|i| i.time));
            }
        }
    }

    /// Opens a finished scene, or offers it while something else is shown or the window is busy.
    fn take_scene(&mut self, scene: PathBuf, training: &Training, ctx: &Context) {
        self.preferences.remember(&scene);
        let is_busy = self.opening.underway.is_some()
            || self.opening.is_making_demo()
            || self.viewport.marking.draft.is_some()
            || matches!(self.dialog, Some(Dialog::Export | Dialog::Quality));
        if !is_busy && self.info().is_some_and(|i| training.is_about(i)) {
            self.open_path(&scene, ctx);
        } else {
            self.reconstruction.offer(scene);
        }
    }

    /// Tells that a training ended without a scene. One that was stopped is no problem.
    fn tell_end(&mut self, training: &Training, error: &Error, now: f64) {
        let is_shown = self.info().is_some_and(|i| training.is_about(i));
        let name = self.path_name(&training.recording);
        if !matches!(error, Error::Cancelled) {
            let named = || format!("{name} could not be reconstructed: {}", message(error));
            self.problem = Some(if is_shown { statement(error) } else { named() });
            return;
        }
        let what = match training.features {
            Some(_) => "what was found so far is kept, and reconstructing again goes on from there",
            None => "nothing was learned yet",
        };
        let who = if is_shown { "Stopped".to_owned() } else { format!("{name} was stopped") };
        self.say(format!("{who}: {what}"), None, now);
    }

    /// Delays closing the window: during an export until it is asked again, and until the scene is saved.
    pub(crate) fn hold_close(&mut self, now: f64, ctx: &Context) {
        let is_asked = ctx.input(|i| i.viewport().close_requested());
        if is_asked && (self.is_held_by_export(now) || self.is_held_by_training(now)) {
            ctx.send_viewport_cmd(egui::ViewportCommand::CancelClose);
        }
    }

    fn is_held_by_export(&mut self, now: f64) -> bool {
        let is_held = self.exporting.as_mut().is_some_and(|export| export.holds_close(now));
        if is_held {
            self.say("An export is running. Close the window again to stop it", None, now);
        }
        is_held
    }

    fn is_held_by_training(&mut self, now: f64) -> bool {
        let Some(training) = &mut self.reconstruction.training else { return false };
        if !training.task.is_cancelling() {
            training.task.cancel();
        }
        now < *training.closing_since.get_or_insert(now) + CLOSES_AFTER
    }
}
