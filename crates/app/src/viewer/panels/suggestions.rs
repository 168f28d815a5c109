//! Suggested prompts: words used before, the classes of the recording, and common words of an operation.

use crate::viewer::{action::Action, panels::widgets::caption, shared::Shared, theme};
use egui::{Button, Popup, PopupCloseBehavior, RichText, ScrollArea, Ui};
use surgtpgs_core::sequence::is_same_name;

/// Things to find in common operations, named as in public data sets.
const PRESETS: [(&str, &[&str]); 2] = [
    (
        "Gallbladder removal (CholecSeg8k)",
        &[
            "abdominal wall",
            "liver",
            "gastrointestinal tract",
            "fat",
            "grasper",
            "connective tissue",
            "blood",
            "cystic duct",
            "l-hook electrocautery",
            "gallbladder",
            "hepatic vein",
            "liver ligament",
        ],
    ),
    (
        "Kidney operation (EndoVis 2018)",
        &[
            "instrument shaft",
            "instrument clasper",
            "instrument wrist",
            "kidney parenchyma",
            "covered kidney",
            "thread",
            "clamps",
            "suturing needle",
            "suction instrument",
            "small intestine",
            "ultrasound probe",
        ],
    ),
];

/// Shows a button that opens the lists.
pub(crate) fn suggestions_ui(ui: &mut Ui, shared: &Shared, actions: &mut Vec<Action>) {
    let button = ui.button(RichText::new("Suggestions").font(theme::small()));
    let button = button.on_hover_text("Words used before, and what is common in an operation");
    let menu = Popup::from_toggle_button_response(&button);
    menu.close_behavior(PopupCloseBehavior::CloseOnClickOutside).width(310.0).show(|ui| {
        ScrollArea::vertical().max_height(420.0).show(ui, |ui| {
            let is_new = |text: &&String| !shared.document.prompts().iter().any(|p| p.text == **text);
            let earlier: Vec<String> = shared.prompt_box.earlier.iter().filter(is_new).cloned().collect();
            words_ui(ui, shared, actions, "Looked for before", earlier.iter().map(String::as_str));
            let mut classes = shared.info().map(|i| i.example_prompts.clone()).unwrap_or_default();
            let is_new = |name: &&str| !classes.iter().any(|class| class == name);
            let marked: Vec<String> =
                shared.document.marks().names().into_iter().filter(is_new).map(str::to_owned).collect();
            classes.extend(marked);
            words_ui(ui, shared, actions, "Classes of this recording", classes.iter().map(String::as_str));
            // What this recording has is known where it has classes.
            for (title, words) in PRESETS.iter().filter(|_| classes.is_empty()) {
                words_ui(ui, shared, actions, title, words.iter().copied());
            }
        });
    });
}

fn words_ui<'a>(
    ui: &mut Ui,
    shared: &Shared,
    actions: &mut Vec<Action>,
    title: &str,
    words: impl Iterator<Item = &'a str>,
) {
    let mut words = words.peekable();
    if words.peek().is_none() {
        return;
    }
    ui.label(caption(title));
    ui.horizontal_wrapped(|ui| {
        ui.spacing_mut().item_spacing = egui::vec2(4.0, 4.0);
        for word in words {
            let is_there = shared.document.prompts().iter().any(|p| is_same_name(&p.text, word));
            let button = Button::selectable(is_there, RichText::new(word).font(theme::small()));
            if ui.add(button.frame_when_inactive(true)).clicked() {
                actions.push(Action::AddPrompt(word.to_owned()));
            }
        }
    });
    ui.add_space(6.0);
}
