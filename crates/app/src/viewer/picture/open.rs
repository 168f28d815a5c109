//! The open scene or recording: the thread that makes its pictures, and the newest of them on the screen.

use crate::viewer::{
    backend::{FrameSource, Info},
    picture::{
        areas::Areas,
        request::{Finding, Picture, Request},
        textures::Shown,
        thumbnails::Thumbnails,
        worker::Worker,
    },
};
use egui::Context;
use std::time::Duration;
use surgtpgs_core::Result;

/// Duration above which pictures are made at half size while something moves, milliseconds.
const SLOW_MS: f64 = 60.0;

/// Longest time that a frame of the window waits for the answer to a letter.
const PATIENCE: Duration = Duration::from_millis(80);

/// Longest time that the end of the program waits for the picture in progress.
const LAST_PICTURE: Duration = Duration::from_secs(3);

/// The open scene or recording.
pub(crate) struct Open {
    pub(crate) info: Info,
    worker: Worker,
    asked: Option<Request>,
    /// `true` while the answer to a letter is on its way and has not been waited for.
    is_due: bool,
    /// Areas of all prompts on every frame; `None` while a passing state is shown, such as a preview of
    /// training.
    pub(crate) areas: Option<Areas>,
    pub(crate) shown: Option<Shown>,
    pub(crate) thumbnails: Thumbnails,
    /// Frames whose small pictures were asked for.
    pub(crate) wanted: Vec<usize>,
    /// Duration of the last picture at full size, milliseconds.
    full_ms: f64,
}

impl Open {
    /// Starts the thread that makes the pictures of `source`.
    pub(crate) fn start(source: Box<dyn FrameSource>, ctx: &Context) -> Result<Self> {
        let info = source.info().clone();
        let areas = Some(Areas::new(info.num_frames));
        let worker = Worker::start(source, ctx)?;
        Ok(Self {
            info,
            worker,
            asked: None,
            is_due: false,
            areas,
            shown: None,
            thumbnails: Thumbnails::default(),
            wanted: Vec::new(),
            full_ms: 0.0,
        })
    }

    /// Waits at the end of the program until no picture is being made any more.
    pub(crate) fn end(&self) {
        self.worker.end(LAST_PICTURE);
    }

    /// Continues with a passing state of the same recording.
    pub(crate) fn preview(&mut self, source: Box<dyn FrameSource>) {
        self.info = source.info().clone();
        self.worker.replace(source);
        self.asked = None;
        self.areas = None;
    }

    /// Waits briefly for the answer to a letter, once. A frame without it would be drawn in vain, which takes
    /// the time of the answer where there is no GPU.
    pub(crate) fn wait_for_letter(&mut self) {
        if std::mem::take(&mut self.is_due) {
            self.worker.wait(PATIENCE);
        }
    }

    /// Takes what the thread has made.
    pub(crate) fn poll(&mut self) {
        for measured in self.worker.take_measured() {
            let is_of_present = self.asked.as_ref().is_some_and(|asked| asked.marks == measured.marks);
            if let Some(areas) = self.areas.as_mut().filter(|_| is_of_present) {
                areas.take(measured);
            }
        }
        for (frame, image) in self.worker.take_thumbnails() {
            self.thumbnails.take(frame, image);
        }
        let Some(picture) = self.worker.take() else { return };
        self.is_due = false;
        // Depth that is not drawn is not made while something moves.
        let is_telling = !picture.request.wants_depth_alone() || picture.took_ms < self.full_ms;
        if !picture.request.view.is_preview && is_telling {
            self.full_ms = picture.took_ms;
        }
        match &mut self.shown {
            Some(shown) => shown.update(picture),
            none => *none = Some(Shown::new(picture)),
        }
    }

    /// Requests a picture, unless it has been requested already.
    pub(crate) fn ask(&mut self, request: Request) {
        if self.asked.as_ref() != Some(&request) {
            let is_marked_alike = self.asked.as_ref().is_none_or(|asked| asked.marks == request.marks);
            if let Some(areas) = self.areas.as_mut().filter(|_| !is_marked_alike) {
                // What was counted was found with other marks.
                *areas = Areas::new(self.info.num_frames);
            }
            self.is_due = request.is_typing;
            self.worker.submit(request.clone());
            self.asked = Some(request);
        }
    }

    /// Asks for small pictures of frames, which are made while nothing else is to be done.
    pub(crate) fn want_thumbnails(&mut self, frames: Vec<usize>) {
        self.worker.want_thumbnails(&frames);
        self.wanted = frames;
    }

    /// Returns `true` if pictures take so long that they are made at half size while something moves.
    pub(crate) fn is_slow(&self) -> bool {
        self.full_ms > SLOW_MS
    }

    /// Returns `true` if a passing state is shown, which is in no file.
    pub(crate) fn is_preview(&self) -> bool {
        self.areas.is_none()
    }

    pub(crate) fn picture(&self) -> Option<&Picture> {
        self.shown.as_ref().map(|shown| &shown.picture)
    }

    /// Returns what a prompt found in the shown picture; `None` until the prompt has been answered.
    pub(crate) fn finding(&self, id: u64, text: &str) -> Option<&Finding> {
        self.picture()?.findings.iter().find(|f| f.id == id && f.text == text)
    }
}
