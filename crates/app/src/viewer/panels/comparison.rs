//! The dialog about what prompts are compared with: generic phrases, and the recording's other classes.

use crate::viewer::{
    action::Action,
    panels::widgets::{caption, dialog, main_button, removable_row},
    shared::{Dialog, Shared},
    theme,
};
use egui::{Context, Key, RichText, TextEdit, Ui};

/// The dialog with the generic phrases.
#[derive(Default)]
pub(crate) struct ComparisonDialog {
    /// Phrase being typed.
    typed: String,
}

impl ComparisonDialog {
    /// Shows the dialog, if it is open.
    pub(crate) fn ui(&mut self, ctx: &Context, shared: &Shared, actions: &mut Vec<Action>) {
        if shared.dialog != Some(Dialog::Comparison) {
            self.typed.clear();
            return;
        }
        let (is_done, is_closed) = dialog(ctx, "comparison", 460.0, |ui| {
            ui.heading("What prompts are compared with");
            ui.label(caption(
            "A prompt competes with everything that means something else. Words that you add here compete with \
             every prompt, too. Switch one off to see what it does. A prompt's own exceptions are in its menu, \
             under \"But not\".",
        ));
            ui.add_space(6.0);
            phrases_ui(ui, shared, actions);
            let field = ui.add(
                TextEdit::singleline(&mut self.typed)
                    .hint_text("Another phrase")
                    .desired_width(f32::INFINITY),
            );
            field.ctx.accesskit_node_builder(field.id, |node| node.set_label("Another phrase"));
            if field.lost_focus() && ui.input(|i| i.key_pressed(Key::Enter)) {
                let phrase = std::mem::take(&mut self.typed);
                actions.push(Action::edit(move |d| d.add_phrase(&phrase)));
            }
            let mut uses_classes = shared.document.comparison().uses_classes;
            if ui
                .checkbox(&mut uses_classes, "Ask what the words mean, and let everything else compete")
                .changed()
            {
                actions.push(Action::edit(move |d| d.set_uses_classes(uses_classes)));
            }
            if !uses_classes && !shared.document.comparison().phrases.iter().any(|p| p.is_on) {
                let text = "Nothing competes: every prompt is found nearly everywhere.";
                ui.label(RichText::new(text).font(theme::small()).color(theme::AMBER));
            }
            ui.add_space(10.0);
            ui.horizontal_wrapped(|ui| {
                if ui.button("As usual").clicked() {
                    actions.push(Action::edit(move |d| d.reset_comparison()));
                }
                let tip = "The words as they are, against object, things, stuff and texture alone";
                if ui.button("As in the paper").on_hover_text(tip).clicked() {
                    actions.push(Action::edit(move |d| d.compare_as_in_paper()));
                }
                ui.add(main_button("Close")).clicked()
            })
            .inner
        });
        if is_done || is_closed {
            actions.push(Action::CloseDialog);
        }
    }
}

fn phrases_ui(ui: &mut Ui, shared: &Shared, actions: &mut Vec<Action>) {
    for (index, phrase) in shared.document.comparison().phrases.iter().enumerate() {
        let is_removed = removable_row(ui, &phrase.text, "phrase", |ui| {
            let mut is_on = phrase.is_on;
            if ui.checkbox(&mut is_on, &phrase.text).changed() {
                actions.push(Action::edit(move |d| d.toggle_phrase(index)));
            }
        });
        if is_removed {
            actions.push(Action::edit(move |d| d.remove_phrase(index)));
        }
    }
}
