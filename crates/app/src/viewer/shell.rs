//! The window as a whole: joins the state, the commands and the panels, and nothing else.

use crate::viewer::{
    backend::Backend,
    command::router::KeyRouter,
    panels::Panels,
    shared::Shared,
    state::{autosave::Autosave, preferences::Preferences},
    theme,
};
use egui::{Context, Ui, ViewportCommand, Visuals};
use std::{path::PathBuf, sync::Arc};

/// First content of the window.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum ViewerInput {
    /// A scene, a recording, a prepared folder or a session.
    Path(PathBuf),
    /// The start page. The first time, when nothing was ever opened, the built-in demo.
    Start,
}

/// The window: its state, and the panels that show it.
pub(crate) struct Shell {
    pub(crate) shared: Shared,
    panels: Panels,
    /// `true` once the window was made to fit its screen.
    fits: bool,
}

/// Share of the screen that a window takes which was larger; the rest is for the system's bars.
const SCREEN_SHARE: f32 = 0.88;

impl Shell {
    pub(crate) fn new(
        ctx: &Context,
        backend: Arc<dyn Backend>,
        preferences: Preferences,
        autosave: Autosave,
    ) -> Self {
        theme::apply(ctx);
        // The keys for zooming are commands of the command table.
        ctx.options_mut(|o| o.zoom_with_keyboard = false);
        ctx.add_plugin(KeyRouter::default());
        KeyRouter::tell(ctx, &preferences.keys, false);
        Self { shared: Shared::new(backend, preferences, autosave), panels: Panels::default(), fits: false }
    }

    /// Opens the first content of the window.
    pub(crate) fn begin(&mut self, input: &ViewerInput, ctx: &Context) {
        let is_new = self.shared.preferences.recent.is_empty()
            && self.shared.preferences.remembers_files
            && self.shared.saving.autosave.left.is_empty();
        match input {
            ViewerInput::Path(path) => self.shared.open_path(path, ctx),
            ViewerInput::Start if is_new => self.shared.open_demo(ctx),
            ViewerInput::Start => {}
        }
    }

    /// Updates and shows the window once.
    fn show(&mut self, ui: &mut Ui) {
        let ctx = ui.ctx().clone();
        let now = ctx.input(|i| i.time);
        self.fit_screen(&ctx);
        self.update(now, &ctx);
        let mut actions = Vec::new();
        self.panels.ui(ui, &self.shared, &mut actions);
        if !actions.is_empty() {
            // The panels have shown the state before the actions.
            ctx.request_repaint();
        }
        actions.into_iter().for_each(|action| self.shared.act(action, &ctx));
        self.shared.ask(self.shared.is_peeking(&ctx));
        let waits = [self.shared.playback.seconds_to_next(now), self.shared.expire_toast(now)];
        waits.into_iter().flatten().for_each(|wait| ctx.request_repaint_after_secs(wait as f32));
        let prompt_box = &self.shared.prompt_box;
        let is_box_empty = prompt_box.is_focused && prompt_box.text.is_empty();
        KeyRouter::tell(&ctx, &self.shared.preferences.keys, is_box_empty);
        self.shared.keep_preferences(&ctx);
        self.shared.keep_window_size(&ctx);
        self.shared.keep_unsaved(now, &ctx);
    }

    /// Makes a window that is larger than its screen fit, once the screen is known.
    fn fit_screen(&mut self, ctx: &Context) {
        let (screen, outer) = ctx.input(|i| (i.viewport().monitor_size, i.viewport().outer_rect));
        let Some((screen, outer)) = screen.zip(outer).filter(|_| !self.fits) else { return };
        self.fits = true;
        if outer.width() > screen.x || outer.height() > screen.y {
            let size = outer.size().min(SCREEN_SHARE * screen);
            ctx.send_viewport_cmd(ViewportCommand::InnerSize(size));
            ctx.send_viewport_cmd(ViewportCommand::OuterPosition(((screen - size) / 2.0).to_pos2()));
        }
    }

    /// Takes the news of threads, keys and clock.
    fn update(&mut self, now: f64, ctx: &Context) {
        let shared = &mut self.shared;
        shared.viewport.is_moving = false;
        shared.poll_opening(now, ctx);
        shared.poll_training(now, ctx);
        shared.poll_export();
        shared.hold_close(now, ctx);
        for invocation in KeyRouter::take(ctx) {
            shared.run(invocation, ctx);
        }
        if let Some(path) = ctx.input(|i| i.raw.dropped_files.first().map(|f| f.path().to_owned())) {
            shared.open_path(&path, ctx);
        }
        shared.play(now);
        ctx.set_zoom_factor(shared.preferences.scale_percent as f32 / 100.0);
    }
}

impl eframe::App for Shell {
    fn ui(&mut self, ui: &mut Ui, _frame: &mut eframe::Frame) {
        self.show(ui);
    }

    fn clear_color(&self, visuals: &Visuals) -> [f32; 4] {
        visuals.panel_fill.to_normalized_gamma_f32()
    }

    fn on_exit(&mut self) {
        self.shared.keep_at_exit();
        if let Some(open) = &self.shared.open {
            open.end();
        }
    }
}
