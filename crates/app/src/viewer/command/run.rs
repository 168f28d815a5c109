//! Carrying out of commands.

use super::{Command, Invocation, Scope, acts::Given, entry, keys};
use crate::viewer::{shared::Shared, state::toast::Back};
use egui::Context;

impl Shared {
    /// Says why a command cannot be given in the present state; `None` if it can.
    pub(crate) fn obstacle(&self, command: Command) -> Option<&'static str> {
        (entry(command).obstacle)(self)
    }

    /// Returns `true` if a command can be given in the present state.
    pub(crate) fn is_enabled(&self, command: Command) -> bool {
        self.obstacle(command).is_none()
    }

    /// Says why a command cannot be given. An offer to take something back stays instead, and with nothing
    /// open plain letters mean nothing.
    fn refuse(&mut self, command: Command, obstacle: &str, now: f64) {
        let is_meant = self.open.is_some() || entry(command).scope == Scope::Always;
        let offers_back = self.toast.as_ref().is_some_and(|toast| toast.back.is_some());
        if is_meant && !offers_back {
            self.say(obstacle, None, now);
        }
    }

    /// Carries out a command, and says what it changed; or says why it cannot be given.
    pub(crate) fn run(&mut self, Invocation { command, index }: Invocation, ctx: &Context) {
        if let Some(obstacle) = self.obstacle(command) {
            self.refuse(command, obstacle, ctx.input(|i| i.time));
            return;
        }
        let is_stop_down = keys::is_stop_down(ctx, &self.preferences.keys);
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
