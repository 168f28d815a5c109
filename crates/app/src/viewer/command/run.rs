//! Carrying out of commands.

use super::{Command, Invocation, acts::Given, entry, keys};
use crate::viewer::{shared::Shared, state::toast::Back};
use egui::Context;

impl Shared {
    /// Returns `true` if a command can be given in the present state.
    pub(crate) fn is_enabled(&self, command: Command) -> bool {
        (entry(command).when)(self)
    }

    /// Carries out a command, if it can be given, and says what it changed.
    pub(crate) fn run(&mut self, Invocation { command, index }: Invocation, ctx: &Context) {
        if !self.is_enabled(command) {
            return;
        }
        let is_stop_down = keys::is_down(ctx, Command::Stop, &self.preferences.keys);
        let given = Given { index, ctx, now: ctx.input(|i| i.time), is_stop_down };
        let (revision, is_hidden) = (self.document.revision(), self.document.is_hidden);
        let edit = |name: Option<&str>| name.unwrap_or_default().to_owned();
        let (undone, redone) = (edit(self.document.undo_name()), edit(self.document.redo_name()));
        (entry(command).act)(self, &given);
        let said = match command {
            Command::Undo => Some((format!("Undone: {undone}"), None)),
            Command::Redo => Some((format!("Done again: {redone}"), None)),
            _ if self.document.is_hidden && !is_hidden => {
                Some(("Everything drawn over the picture is hidden".into(), Some(Back::ShowOverlays)))
            }
            _ => None,
        };
        match said {
            Some((text, back)) => self.say(text, back, given.now),
            None if self.document.is_hidden != is_hidden => self.toast = None,
            None => self.say_edit_since(revision, given.now),
        }
    }
}
