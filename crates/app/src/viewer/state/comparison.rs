//! Edits of what prompts are compared with: generic phrases, the recording's other classes, and a prompt's
//! own "but not".

use crate::engine::Question;
use crate::viewer::state::{
    content::{Comparison, Phrase, Prompt},
    document::Document,
};
use surgtpgs_core::relevancy::RelevancySettings;

impl Document {
    pub(crate) fn comparison(&self) -> &Comparison {
        &self.content().comparison
    }

    /// Returns the question of a prompt.
    pub(crate) fn question(&self, prompt: &Prompt) -> Question {
        let mut negatives = self.comparison().common().with(&prompt.but_not);
        negatives.samples.extend(prompt.not_like.iter().map(|n| (n.name.clone(), n.sample.clone())));
        let (text, like) = (prompt.text.clone(), prompt.like.clone());
        Question { text, like, negatives, shows_nearest: prompt.shows_nearest }
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
            let name = "asking what words mean".to_owned();
            self.edit(name, None, |content| content.comparison.uses_classes = uses_classes);
        }
    }

    pub(crate) fn reset_comparison(&mut self) {
        self.compare_by("comparing as usual", &RelevancySettings::default());
    }

    pub(crate) fn compare_as_in_paper(&mut self) {
        self.compare_by("comparing as in the paper", &RelevancySettings::paper());
    }

    fn compare_by(&mut self, name: &str, settings: &RelevancySettings) {
        let comparison = Comparison::of(settings);
        if *self.comparison() != comparison {
            self.edit(name.to_owned(), None, |content| content.comparison = comparison);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::engine::Negatives;
    use crate::text::split_words;
    use surgtpgs_core::overlay::OverlayLook;

    #[test]
    fn a_prompt_is_compared_with_the_common_phrases_that_are_on_and_its_own() {
        let mut document = Document::new(OverlayLook::default(), 0.4);
        document.add("liver");
        let id = document.prompts()[0].id;
        let standard = document.question(&document.prompts()[0]);
        assert_eq!(standard.negatives.phrases, RelevancySettings::default().phrases);
        document.compare_as_in_paper();
        assert_eq!(document.bare_question("x").negatives, Negatives::of(&RelevancySettings::paper()));
        document.toggle_phrase(0);
        document.add_phrase(" smoke ");
        document.add_phrase("Smoke");
        document.set_but_not(id, &split_words("fat, , Things"));
        let question = document.question(&document.prompts()[0]);
        assert_eq!(question.negatives.phrases, ["things", "stuff", "texture", "smoke", "fat"]);
        assert_eq!(document.bare_question("x").negatives.phrases, ["things", "stuff", "texture", "smoke"]);
        document.reset_comparison();
        let exception = document.question(&document.prompts()[0]).negatives.phrases;
        assert_eq!(exception, ["fat", "Things"], "the prompt's own stay");
        (0..5).for_each(|_| document.undo());
        assert_eq!(document.question(&document.prompts()[0]), standard);
    }
}
