//! The menu of a prompt: other words, another colour, another place in the list.

use crate::viewer::{
    action::Action,
    panels::widgets::{caption, colour_button, removable_row},
    shared::Shared,
    state::content::{Prompt, PromptId},
    theme,
};
use crate::{settings::PROMPT_COLOURS, text::split_words};
use egui::{Id, Key, Popup, PopupCloseBehavior, Response, TextEdit, Ui, vec2};

/// The menu of one prompt at a time.
#[derive(Default)]
pub(crate) struct PromptMenu {
    /// Prompt whose menu is open, or was open last.
    prompt: Option<PromptId>,
}

impl PromptMenu {
    /// Shows the menu, opened and closed by the `buttons` of the prompts' rows. All menus have one id,
    /// because egui never forgets the layout of an id, and because the menu then stays open when rows change
    /// places.
    pub(crate) fn ui(&mut self, ui: &Ui, shared: &Shared, actions: &mut Vec<Action>, buttons: &[Response]) {
        let (ctx, id) = (ui.ctx(), Id::unique("prompt menu"));
        let rows = || shared.document.prompts().iter().zip(buttons);
        let pressed = rows().find(|(_, button)| button.clicked()).map(|(prompt, _)| prompt.id);
        // egui closes a menu that is not shown, for example where there are no rows.
        let before = self.prompt.filter(|_| Popup::is_id_open(ctx, id));
        if before.is_none() && pressed.is_some() {
            Popup::open_id(ctx, id);
        }
        self.prompt = before.or(pressed);
        if let Some((prompt, button)) = rows().find(|(prompt, _)| self.prompt == Some(prompt.id)) {
            let menu = Popup::from_response(button).id(id).open_memory(None);
            menu.close_behavior(PopupCloseBehavior::CloseOnClickOutside)
                .width(250.0)
                .show(|ui| contents_ui(ui, shared, actions, prompt));
        }
        // The menu of another prompt follows in the next frame: the words typed in this one are accepted when
        // their field is left.
        match pressed {
            Some(_) if pressed == before => Popup::close_id(ctx, id),
            Some(_) => {
                self.prompt = pressed;
                Popup::open_id(ctx, id);
            }
            None => {}
        }
    }
}

fn contents_ui(ui: &mut Ui, shared: &Shared, actions: &mut Vec<Action>, prompt: &Prompt) {
    words_ui(ui, actions, prompt);
    but_not_ui(ui, actions, prompt);
    ui.add_space(4.0);
    colours_ui(ui, actions, prompt);
    let mut is_instrument = prompt.is_instrument;
    let tip = "What it finds lies over what the other prompts find";
    if ui.checkbox(&mut is_instrument, "This is an instrument").on_hover_text(tip).changed() {
        let id = prompt.id;
        actions.push(Action::edit(move |d| d.set_instrument(id, is_instrument)));
    }
    ui.separator();
    let (first, last) = (shared.document.prompts().first(), shared.document.prompts().last());
    let [is_first, is_last] = [first, last].map(|p| p.is_some_and(|p| p.id == prompt.id));
    for (label, by, is_end) in [("Move up", -1, is_first), ("Move down", 1, is_last)] {
        let tip = "Prompts further down are drawn over those above";
        let item = egui::Button::new(label).frame(false).min_size(vec2(ui.available_width(), 0.0));
        if ui.add_enabled(!is_end, item).on_hover_text(tip).clicked() {
            let id = prompt.id;
            actions.push(Action::edit(move |d| d.reorder(id, by)));
        }
    }
}

fn words_ui(ui: &mut Ui, actions: &mut Vec<Action>, prompt: &Prompt) {
    ui.label(caption("Words"));
    let label = format!("Words of {}", prompt.text);
    let id = prompt.id;
    let field = Field { label: &label, salt: ("words", id), is_live: false };
    if let Some(words) = field.ui(ui, &prompt.text) {
        actions.push(Action::Rename(id, words));
    }
}

fn but_not_ui(ui: &mut Ui, actions: &mut Vec<Action>, prompt: &Prompt) {
    ui.label(caption("But not (words between commas)"));
    let label = format!("{} but not", prompt.text);
    // It acts while it is typed: neither Enter nor Esc is needed.
    let id = prompt.id;
    let field = Field { label: &label, salt: ("but not", id), is_live: true };
    if let Some(words) = field.ui(ui, &prompt.but_not.join(", ")) {
        actions.push(Action::edit(move |d| d.set_but_not(id, &split_words(&words))));
    }
    for (index, not_like) in prompt.not_like.iter().enumerate() {
        let is_removed = removable_row(ui, &not_like.name, "point", |ui| {
            ui.label(caption(format!("nor {}", not_like.name)));
        });
        if is_removed {
            actions.push(Action::edit(move |d| d.remove_not_like(id, index)));
        }
    }
}

/// A text field.
struct Field<'a> {
    label: &'a str,
    salt: (&'static str, PromptId),
    /// `true` to return the text whenever it changes.
    is_live: bool,
}

impl Field<'_> {
    /// Shows the field. Returns its text on Enter, on leaving it, and while it changes if it is live. A field
    /// that is not live is given up by Esc.
    fn ui(&self, ui: &mut Ui, text: &str) -> Option<String> {
        let id = ui.scope_id().with(self.salt);
        let mut typed = ui.data(|d| d.get_temp::<String>(id)).unwrap_or_else(|| text.to_owned());
        let field = ui.add(TextEdit::singleline(&mut typed).char_limit(200).desired_width(f32::INFINITY));
        field.ctx.accesskit_node_builder(field.id, |node| node.set_label(self.label));
        if field.lost_focus() {
            ui.data_mut(|d| d.remove::<String>(id));
            return (self.is_live || !ui.input(|i| i.key_pressed(Key::Escape))).then_some(typed);
        }
        if field.changed() {
            ui.data_mut(|d| d.insert_temp(id, typed.clone()));
            return self.is_live.then_some(typed);
        }
        None
    }
}

fn colours_ui(ui: &mut Ui, actions: &mut Vec<Action>, prompt: &Prompt) {
    ui.label(caption("Colour"));
    ui.horizontal(|ui| {
        ui.spacing_mut().item_spacing.x = 4.0;
        for (number, colour) in PROMPT_COLOURS.into_iter().enumerate() {
            let name = format!("Colour {} for {}", number + 1, prompt.text);
            if colour_button(ui, theme::colour32(colour), prompt.colour == colour, &name).clicked() {
                let id = prompt.id;
                actions.push(Action::edit(move |d| d.set_colour(id, colour)));
            }
        }
    });
}
