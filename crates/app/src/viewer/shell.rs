//! The window as a whole: joins the state, the commands and the panels, and nothing else.

use crate::viewer::{
    backend::Backend,
    command::router::KeyRouter,
    panels::Panels,
    shared::Shared,
    state::{autosave::Autosave, preferences::Preferences},
    theme,
};
use egui::{Context, Ui};
use std::sync::Arc;

/// The window: its state, and the panels that show it.
pub(crate) struct Shell {
    pub(crate) shared: Shared,
    panels: Panels,
}

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
        KeyRouter::set_keymap(ctx, &preferences.keys);
        Self { shared: Shared::new(backend, preferences, autosave), panels: Panels::default() }
    }

    /// Updates and shows the window once.
    fn show(&mut self, ui: &mut Ui) {
        let ctx = ui.ctx().clone();
        let now = ctx.input(|i| i.time);
        self.update(now, &ctx);
        let mut actions = Vec::new();
        self.panels.ui(ui, &self.shared, &mut actions);
        if !actions.is_empty() {
            // The panels have shown the state before the actions.
            ctx.request_repaint();
        }
        actions.into_iter().for_each(|action| self.shared.act(action, &ctx));
        self.shared.ask(self.shared.is_peeking(&ctx));
        if let Some(wait) = self.shared.playback.seconds_to_next(now) {
            ctx.request_repaint_after_secs(wait as f32);
        }
        KeyRouter::set_keymap(&ctx, &self.shared.preferences.keys);
        self.shared.keep_preferences(&ctx);
        self.shared.keep_unsaved(now, &ctx);
    }

    /// Takes the news of threads, keys and clock.
    fn update(&mut self, now: f64, ctx: &Context) {
        let shared = &mut self.shared;
        shared.viewport.is_moving = false;
        shared.poll_opening(ctx);
        shared.poll_training(now, ctx);
        shared.poll_saving();
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

    fn on_exit(&mut self) {
        self.shared.keep_at_exit();
    }
}
