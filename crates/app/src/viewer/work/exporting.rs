//! Exports in the background, and copies of the picture.

use crate::viewer::{picture::copy, shared::Shared, state::exporting::Exporting};
use crate::{engine::Negatives, jobs::ExportRequest};
use egui::{Context, Rect, pos2};

impl Shared {
    /// Starts an export, unless one is running.
    pub(crate) fn start_export(&mut self, request: ExportRequest, negatives: Negatives, ctx: &Context) {
        if !self.is_exporting() {
            let backend = self.backend.clone();
            self.exporting = Some(Exporting::start(backend, request, negatives, ctx));
        }
        self.dialog = None;
    }

    /// Returns `true` if an export is of the scene that is open, and of no frame that is left out now.
    pub(crate) fn may_export(&self, request: &ExportRequest) -> bool {
        let is_open = self.info().is_some_and(|info| info.path == request.scene);
        is_open && !request.frames.iter().any(|frame| self.document.is_excluded(*frame))
    }

    pub(crate) fn is_exporting(&self) -> bool {
        self.exporting.as_ref().is_some_and(Exporting::is_running)
    }

    /// Takes the result of an export; an error is shown as the problem.
    pub(crate) fn poll_export(&mut self) {
        let Some(exporting) = self.exporting.as_mut().filter(|e| e.is_running()) else { return };
        let polled = exporting.poll();
        if self.settle(polled).is_none() {
            self.exporting = None;
        }
    }

    /// Copies the picture as it is shown to the clipboard.
    pub(crate) fn copy_picture(&mut self, now: f64, ctx: &Context) {
        let notes = self.picture_notes();
        let shown = copy::Shown {
            mode: self.document.mode,
            is_hidden: self.document.is_hidden,
            wipe: self.viewport.wipe,
            seconds: self.playback.seconds(self.picture().map_or(0, |p| p.request.view.frame)),
            notes: &notes,
        };
        let seen = |(pane, picture): &(Rect, Rect)| {
            let share = |at: egui::Pos2| ((at - picture.min) / picture.size()).to_pos2();
            let part = pane.intersect(*picture);
            Rect::from_min_max(share(part.min), share(part.max))
                .intersect(Rect::from_min_max(pos2(0.0, 0.0), pos2(1.0, 1.0)))
        };
        let seen: Vec<Rect> = self.viewport.panes.0.iter().map(seen).collect();
        let Some(image) = self.picture().and_then(|p| copy::copy(p, shown, &seen)) else { return };
        let [width, height] = image.size;
        ctx.copy_image(image);
        self.say(format!("The picture is copied, {width} × {height} pixels"), None, now);
    }
}
