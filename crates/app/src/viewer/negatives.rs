//! Phrases that prompts are compared with: generic phrases, the recording's other classes, and a prompt's own
//! "but not".

use super::{
    app::ViewerApp,
    document::{Document, Prompt},
    theme,
    widgets::{Icon, caption, dialog, icon_button, main_button},
};
use crate::engine::{Negatives, Question};
use egui::{Context, Key, RichText, TextEdit, Ui};
use surgtpgs_core::relevancy::RelevancySettings;

/// A generic phrase, which can be switched off for a while to see its effect.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub(crate) struct Phrase {
    pub(crate) text: String,
    pub(crate) is_on: bool,
}

/// Phrases and classes that all prompts are compared with.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(default)]
pub(crate) struct Comparison {
    pub(crate) phrases: Vec<Phrase>,
    pub(crate) uses_classes: bool,
}

impl Default for Comparison {
    fn default() -> Self {
        let standard = RelevancySettings::default();
        let phrase = |text| Phrase { text, is_on: true };
        Self {
            phrases: standard.phrases.into_iter().map(phrase).collect(),
            uses_classes: standard.class_negatives,
        }
    }
}

impl Comparison {
    /// Returns the negatives of a prompt without exceptions of its own.
    pub(crate) fn common(&self) -> Negatives {
        let on = self.phrases.iter().filter(|p| p.is_on).map(|p| &p.text);
        let none = Negatives { phrases: Vec::new(), samples: Vec::new(), uses_classes: self.uses_classes };
        none.with(on)
    }
}

impl Document {
    pub(crate) fn comparison(&self) -> &Comparison {
        &self.content().comparison
    }

    /// Returns the question of a prompt.
    pub(crate) fn question(&self, prompt: &Prompt) -> Question {
        let mut negatives = self.comparison().common().with(&prompt.but_not);
        negatives.samples.extend(prompt.not_like.iter().map(|n| (n.name.clone(), n.sample.clone())));
        Question { text: prompt.text.clone(), like: prompt.like.clone(), negatives }
    }

    /// Returns the question for words that are not a prompt (yet).
    pub(crate) fn bare_question(&self, text: &str) -> Question {
        Question::words(text, self.comparison().common())
    }

    pub(crate) fn add_phrase(&mut self, text: &str) {
        let text = text.trim();
        let is_new = !self.comparison().phrases.iter().any(|p| p.text.eq_ignore_ascii_case(text));
        if is_new && !text.is_empty() {
            let phrase = Phrase { text: text.to_owned(), is_on: true };
            let name = format!("comparing with \"{text}\"");
            self.edit(name, None, |content| content.comparison.phrases.push(phrase));
        }
    }

    pub(crate) fn toggle_phrase(&mut self, index: usize) {
        let Some(phrase) = self.comparison().phrases.get(index) else { return };
        let name = format!(
            "{} \"{}\"",
            if phrase.is_on { "not comparing with" } else { "comparing with" },
            phrase.text
        );
        self.edit(name, None, |content| content.comparison.phrases[index].is_on ^= true);
    }

    pub(crate) fn remove_phrase(&mut self, index: usize) {
        let Some(phrase) = self.comparison().phrases.get(index) else { return };
        let name = format!("no longer comparing with \"{}\"", phrase.text);
        self.edit(name, None, |content| drop(content.comparison.phrases.remove(index)));
    }

    pub(crate) fn set_uses_classes(&mut self, uses_classes: bool) {
        if self.comparison().uses_classes != uses_classes {
            let name = "comparing with the other classes".to_owned();
            self.edit(name, None, |content| content.comparison.uses_classes = uses_classes);
        }
    }

    pub(crate) fn reset_comparison(&mut self) {
        if *self.comparison() != Comparison::default() {
            self.edit("the standard phrases".into(), None, |content| {
                content.comparison = Comparison::default()
            });
        }
    }
}

/// Shows the dialog with the generic phrases, if it is open.
pub(crate) fn comparison_ui(ctx: &Context, app: &mut ViewerApp) {
    let Some(mut typed) = app.comparison_sheet.take() else { return };
    let (is_done, is_closed) = dialog(ctx, "comparison", 460.0, |ui| {
        ui.heading("What prompts are compared with");
        ui.label(caption(
            "A pixel's similarity score says how much closer it is to your words than to the closest of these. \
             Switch one off to see what it does. A prompt's own exceptions are in its menu, under \"But not\".",
        ));
        ui.add_space(6.0);
        phrases_ui(ui, &mut app.document);
        let field =
            ui.add(TextEdit::singleline(&mut typed).hint_text("Another phrase").desired_width(f32::INFINITY));
        field.ctx.accesskit_node_builder(field.id, |node| node.set_label("Another phrase"));
        if field.lost_focus() && ui.input(|i| i.key_pressed(Key::Enter)) {
            app.document.add_phrase(&std::mem::take(&mut typed));
        }
        let mut uses_classes = app.document.comparison().uses_classes;
        if ui.checkbox(&mut uses_classes, "The recording's other classes as well").changed() {
            app.document.set_uses_classes(uses_classes);
        }
        if !app.document.comparison().phrases.iter().any(|p| p.is_on) {
            let text = "Without any phrase, scores are no longer comparable with other recordings.";
            ui.label(RichText::new(text).font(theme::small()).color(theme::AMBER));
        }
        ui.add_space(10.0);
        ui.horizontal(|ui| {
            if ui.button("Standard phrases").clicked() {
                app.document.reset_comparison();
            }
            ui.add(main_button("Close")).clicked()
        })
        .inner
    });
    if !is_done && !is_closed {
        app.comparison_sheet = Some(typed);
    }
}

fn phrases_ui(ui: &mut Ui, document: &mut Document) {
    for (index, phrase) in document.comparison().phrases.clone().into_iter().enumerate() {
        ui.horizontal(|ui| {
            let mut is_on = phrase.is_on;
            if ui.checkbox(&mut is_on, &phrase.text).changed() {
                document.toggle_phrase(index);
            }
            ui.with_layout(egui::Layout::right_to_left(egui::Align::Center), |ui| {
                let name = format!("Remove {}", phrase.text);
                let tip = "Remove this phrase (undo brings it back)";
                if icon_button(ui, Icon::Cross, &name, tip, false, true).clicked() {
                    document.remove_phrase(index);
                }
            });
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::text::split_words;
    use surgtpgs_core::overlay::OverlayLook;

    #[test]
    fn a_prompt_is_compared_with_the_common_phrases_that_are_on_and_its_own() {
        let mut document = Document::new(OverlayLook::default(), 0.4);
        document.add("liver");
        let id = document.prompts()[0].id;
        let standard = document.question(&document.prompts()[0]);
        assert_eq!(standard.negatives.phrases, RelevancySettings::default().phrases);
        document.toggle_phrase(0);
        document.add_phrase(" smoke ");
        document.add_phrase("Smoke");
        document.set_but_not(id, &split_words("fat, , Things"));
        let question = document.question(&document.prompts()[0]);
        assert_eq!(question.negatives.phrases, ["things", "stuff", "texture", "smoke", "fat"]);
        assert_eq!(document.bare_question("x").negatives.phrases, ["things", "stuff", "texture", "smoke"]);
        document.reset_comparison();
        let exception = document.question(&document.prompts()[0]).negatives.phrases;
        assert_eq!(exception, ["object", "things", "stuff", "texture", "fat"], "the prompt's own stays");
        (0..4).for_each(|_| document.undo());
        assert_eq!(document.question(&document.prompts()[0]), standard);
    }
}
