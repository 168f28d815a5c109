//! Actions of the commands, and the conditions under which they can be given.

use super::{
    app::ViewerApp,
    areas::{self, Curve},
    command::{self, Command, Invocation},
    document::ViewMode,
    export_dialog::ExportDialog,
    help::Sheet,
    import_check::ImportCheck,
    jobs::Job,
    quality::Quality,
    ruler::Ruler,
    session,
    source::Info,
    training::TrainDialog,
};
use egui::Context;

impl ViewerApp {
    /// Returns `true` if a command can be given in the present state.
    pub(super) fn is_enabled(&self, command: Command) -> bool {
        let info = self.info();
        let has = |f: fn(&Info) -> bool| info.is_some_and(f);
        match command {
            Command::OpenFile | Command::OpenFolder => self.picking.is_none(),
            Command::Quit
            | Command::FullScreen
            | Command::Larger
            | Command::Smaller
            | Command::NormalSize
            | Command::Dismiss
            | Command::Shortcuts
            | Command::About => true,
            Command::Undo => self.document.undo_name().is_some(),
            Command::Redo => self.document.redo_name().is_some(),
            Command::SaveSession | Command::SaveSessionAs => info.is_some() && self.saving.is_none(),
            Command::Reconstruct => {
                let is_wrong = self.import_check.as_ref().is_some_and(ImportCheck::has_errors);
                let is_busy = self.training.is_some() || self.is_making_demo();
                has(|i| i.recording.is_some()) && !is_busy && !is_wrong
            }
            Command::Export => has(|i| i.has_features) && !self.is_reconstructing(),
            Command::Quality => has(|i| i.has_reconstruction && i.has_original) && !self.is_reconstructing(),
            Command::FocusPrompt => has(|i| i.has_features),
            Command::FirstFound | Command::LargestFound | Command::LastFound | Command::CopyAreas => {
                self.selected_curve().is_some_and(|curve| curve.is_complete())
            }
            Command::PreviousBookmark | Command::NextBookmark => !self.document.bookmarks().is_empty(),
            Command::Depth | Command::DepthBeside | Command::Motion | Command::Opacity => {
                has(|i| i.has_reconstruction)
            }
            Command::SwapOriginal
            | Command::SideBySide
            | Command::Wipe
            | Command::Blink
            | Command::Difference => has(|i| i.has_reconstruction && i.has_original),
            _ => info.is_some(),
        }
    }

    /// Carries out a command, if it can be given.
    pub(super) fn run(&mut self, invocation: Invocation, ctx: &Context) {
        if !self.is_enabled(invocation.command) {
            return;
        }
        match invocation.command {
            Command::OpenFile => self.pick(false, ctx),
            Command::OpenFolder => self.pick(true, ctx),
            Command::SaveSession => self.save_session(false, ctx),
            Command::SaveSessionAs => self.save_session(true, ctx),
            Command::Reconstruct => {
                let excluded = self.document.excluded().to_vec();
                self.train_dialog = self.info().and_then(|info| TrainDialog::new(info, excluded));
            }
            Command::Export => self.export = ExportDialog::new(self),
            Command::Quality => self.quality = Quality::start(self, ctx),
            Command::Quit => ctx.send_viewport_cmd(egui::ViewportCommand::Close),
            Command::Undo => self.document.undo(),
            Command::Redo => self.document.redo(),
            Command::FocusPrompt => self.prompt_box.wants_focus = true,
            Command::TogglePrompt => self.document.toggle_visible(invocation.index),
            Command::SoloPrompt => self.document.solo(invocation.index),
            Command::Negatives => self.comparison_sheet = Some(String::new()),
            Command::HideOverlays => self.document.is_hidden ^= true,
            Command::Peek => {}
            Command::CycleStyle => self.document.next_style(),
            Command::MoreOpacity => self.document.next_opacity(),
            Command::BelowInstruments => self.document.overlay.below_instruments ^= true,
            Command::ThresholdDown => self.document.nudge_threshold(-command::THRESHOLD_STEP),
            Command::ThresholdUp => self.document.nudge_threshold(command::THRESHOLD_STEP),
            Command::Measure => {
                self.ruler = if self.ruler.is_some() { None } else { Some(Ruler::default()) };
            }
            // Dismisses one thing at a time, the topmost first.
            Command::Dismiss => {
                if self.problem.take().is_none() && self.probe.take().is_none() {
                    self.ruler = None;
                }
            }
            Command::CentreOrbit => {
                let pivot = ctx.input(|i| i.pointer.hover_pos()).and_then(|at| self.point_in_space(at));
                if pivot.is_some() {
                    self.document.look.orbit.pivot = pivot;
                }
            }
            Command::ResetView => self.document.reset_look(),
            Command::FullScreen => {
                let is_full = ctx.input(|i| i.viewport().fullscreen.unwrap_or(false));
                ctx.send_viewport_cmd(egui::ViewportCommand::Fullscreen(!is_full));
            }
            Command::Larger => self.preferences.scale_by(1),
            Command::Smaller => self.preferences.scale_by(-1),
            Command::NormalSize => self.preferences.scale_by(0),
            Command::Shortcuts => self.sheet = Some(Sheet::Shortcuts),
            Command::About => self.sheet = Some(Sheet::About),
            Command::SwapOriginal => self.switch(ViewMode::Original),
            Command::SideBySide => self.switch(ViewMode::SideBySide),
            Command::Wipe => self.switch(ViewMode::Wipe),
            Command::Blink => self.switch(ViewMode::Blink),
            Command::Difference => self.switch(ViewMode::Difference),
            Command::Depth => self.switch(ViewMode::Depth),
            Command::DepthBeside => self.switch(ViewMode::DepthBeside),
            Command::Motion => self.switch(ViewMode::Motion),
            Command::Opacity => self.switch(ViewMode::Opacity),
            time => self.run_time(time, ctx),
        }
    }

    /// Carries out a command that concerns time.
    fn run_time(&mut self, command: Command, ctx: &Context) {
        let now = ctx.input(|i| i.time);
        let frame = self.playback.frame();
        match command {
            Command::PlayPause => self.playback.toggle(now),
            Command::StepBack => self.playback.step(-1),
            Command::StepForward => self.playback.step(1),
            Command::HopBack => self.playback.step(-command::HOP),
            Command::HopForward => self.playback.step(command::HOP),
            Command::First => self.playback.seek(0, now),
            Command::Last => self.playback.seek(usize::MAX, now),
            Command::GoToFrame => self.go_to = Some(String::new()),
            // As on a video deck: while the stop key is held down, these keys make single steps.
            Command::PlayBackwards if command::is_down(ctx, Command::Stop) => self.playback.step(-1),
            Command::PlayForwards if command::is_down(ctx, Command::Stop) => self.playback.step(1),
            Command::PlayBackwards => self.playback.shuttle(-1.0, now),
            Command::Stop => self.playback.pause(),
            Command::PlayForwards => self.playback.shuttle(1.0, now),
            Command::Slower => self.playback.change_speed(-1, now),
            Command::Faster => self.playback.change_speed(1, now),
            Command::NormalSpeed => self.playback.normal_speed(now),
            Command::Loop => self.playback.toggle_looping(),
            Command::RangeStart => self.document.set_range(Some(self.playback.range_from_here())),
            Command::RangeEnd => self.document.set_range(Some(self.playback.range_to_here())),
            Command::RangeClear => self.document.set_range(None),
            Command::Exclude => {
                let (from, to) = self.document.content().range.unwrap_or((frame, frame));
                self.document.toggle_excluded(from, to);
            }
            Command::FirstFound => self.go_to_found(Curve::first, now),
            Command::LargestFound => self.go_to_found(Curve::largest, now),
            Command::LastFound => self.go_to_found(Curve::last, now),
            Command::CopyAreas => {
                let curves = super::curves::curves(self);
                let rows = curves.iter().map(|(_, p, c)| (p.text.as_str(), p.threshold, c.clone()));
                ctx.copy_text(areas::csv(rows, |frame| self.playback.seconds(frame)));
            }
            Command::Bookmark => self.document.toggle_bookmark(frame),
            Command::Bookmarks => self.shows_bookmarks = true,
            Command::PreviousBookmark => self.go_beside(-1, now),
            Command::NextBookmark => self.go_beside(1, now),
            _ => {}
        }
    }

    /// Returns the point in space under a place on the screen, in the endoscope's axes; `None` where there is
    /// no recorded depth.
    fn point_in_space(&self, at: egui::Pos2) -> Option<[f32; 3]> {
        let [u, v] = self.panes.picture_position(at)?;
        let (info, picture) = (self.info()?, self.picture()?);
        let (depth, lens) = (picture.depth_values.as_ref()?, info.lens?);
        let index = |share: f32, n: usize| ((share * n as f32) as usize).min(n.saturating_sub(1));
        let is_recorded = picture.request.view.orbit.is_home() && !depth.data.is_empty();
        let z = if is_recorded { depth.at(index(u, depth.width), index(v, depth.height)) } else { 0.0 };
        let on_axis = |share: f32, n: usize, c: f32, f: f32| (share * n as f32 - c) / f * z;
        let x = on_axis(u, info.width, lens.cx, lens.fx);
        let y = on_axis(v, info.height, lens.cy, lens.fy);
        (z > 0.0).then_some([x, y, z])
    }

    fn go_to_found(&mut self, which: impl Fn(&Curve) -> Option<usize>, now: f64) {
        if let Some(frame) = self.selected_curve().as_ref().and_then(which) {
            self.playback.pause();
            self.playback.seek(frame, now);
        }
    }

    fn go_beside(&mut self, direction: isize, now: f64) {
        if let Some(frame) = self.document.bookmark_beside(self.playback.frame(), direction) {
            self.playback.pause();
            self.playback.seek(frame, now);
        }
    }

    /// Shows a view; if it is shown already, shows the reconstruction.
    fn switch(&mut self, mode: ViewMode) {
        let is_shown = self.document.mode == mode;
        self.document.mode = if is_shown { ViewMode::Reconstruction } else { mode };
    }

    /// Asks for a path on a thread of its own, because a native dialog may block as long as it is open.
    fn pick(&mut self, folder: bool, ctx: &Context) {
        self.picking = Some(Job::start("file dialog", ctx, move |_| {
            let dialog = rfd::FileDialog::new();
            let [scene, splats] = surgtpgs_core::scene::EXTENSIONS;
            let files = [scene, splats, session::EXTENSION, "mp4", "mov", "mkv", "avi"];
            Ok(if folder {
                dialog.set_title("Open a recording: a folder of frames").pick_folder()
            } else {
                dialog
                    .set_title("Open a reconstruction, a session or a video")
                    .add_filter("Reconstructions, sessions and videos", &files)
                    .add_filter("All files", &["*"])
                    .pick_file()
            })
        }));
    }
}
