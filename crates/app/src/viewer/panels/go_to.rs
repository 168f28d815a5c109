//! The dialog "Go to frame".

use crate::viewer::{
    action::Action,
    command::{Command, entry},
    panels::widgets::{dialog, main_button},
    shared::{Dialog, Shared},
    theme,
};
use egui::Context;

/// The small dialog to type a frame number.
#[derive(Default)]
pub(crate) struct GoToDialog {
    /// Number being typed.
    typed: String,
}

impl GoToDialog {
    /// Shows the dialog, if it is open. Afterwards the keys belong to the picture again.
    pub(crate) fn ui(&mut self, ctx: &Context, shared: &Shared, actions: &mut Vec<Action>) {
        if shared.dialog != Some(Dialog::GoToFrame) {
            self.typed.clear();
            return;
        }
        let last = shared.playback.num_frames();
        let (chosen, is_closed) = dialog(ctx, "go to frame", 280.0, |ui| {
            ui.heading(entry(Command::GoToFrame).label.trim_end_matches('…'));
            let field = ui.add(egui::TextEdit::singleline(&mut self.typed).hint_text(format!("1 to {last}")));
            field.request_focus();
            field.ctx.accesskit_node_builder(field.id, |node| node.set_label("Frame number"));
            let typed = self.typed.trim().parse::<usize>().ok().filter(|n| (1..=last).contains(n));
            if typed.is_none() && !self.typed.trim().is_empty() {
                ui.colored_label(theme::ERROR, format!("There are frames 1 to {last}."));
            }
            let go = ui.add_enabled(typed.is_some(), main_button("Go"));
            typed.filter(|_| go.clicked() || ui.input(|i| i.key_pressed(egui::Key::Enter)))
        });
        if let Some(number) = chosen {
            actions.push(Action::GoTo(number - 1));
        }
        if chosen.is_some() || is_closed {
            actions.push(Action::CloseDialog);
            ctx.memory_mut(|m| m.stop_text_input());
        }
    }
}
