//! Carrying out of commands.

use super::{Command, Invocation, acts::Given, entry, keys};
use crate::viewer::shared::Shared;
use egui::Context;

impl Shared {
    /// Returns `true` if a command can be given in the present state.
    pub(crate) fn is_enabled(&self, command: Command) -> bool {
        (entry(command).when)(self)
    }

    /// Carries out a command, if it can be given.
    pub(crate) fn run(&mut self, Invocation { command, index }: Invocation, ctx: &Context) {
        if self.is_enabled(command) {
            let is_stop_down = keys::is_down(ctx, Command::Stop, &self.preferences.keys);
            let given = Given { index, ctx, now: ctx.input(|i| i.time), is_stop_down };
            (entry(command).act)(self, &given);
        }
    }
}
