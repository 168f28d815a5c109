//! Takes the keys of commands out of the input before egui sees them.
//!
//! A modal dialog owns all keys. A focused text field owns all but the Ctrl chords and function keys of
//! [`Scope::Always`]. Another focused widget owns the arrows, Home, End, Enter, Space and Esc. All other keys
//! belong to the viewport. egui itself would move the focus by the arrows, therefore this happens before the
//! pass begins.

use crate::viewer::{
    command::{Command, Entry, Invocation, Scope, keys},
    state::preferences::Keymap,
};
use egui::{Context, Event, Key, Modifiers, Plugin, RawInput};

/// Collects the commands given by key.
#[derive(Debug, Default)]
pub(crate) struct KeyRouter {
    pressed: Vec<Invocation>,
    /// Keys that the user chose.
    keymap: Keymap,
}

impl KeyRouter {
    /// Sets the keys that the user chose.
    pub(crate) fn set_keymap(ctx: &Context, keymap: &Keymap) {
        ctx.with_plugin(|router: &mut Self| {
            if router.keymap != *keymap {
                router.keymap = keymap.clone();
            }
        });
    }

    /// Takes the commands given since the last call, in order.
    pub(crate) fn take(ctx: &Context) -> Vec<Invocation> {
        ctx.with_plugin(|router: &mut Self| std::mem::take(&mut router.pressed)).unwrap_or_default()
    }
}

/// Owner of the keyboard.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Owner {
    Modal,
    Text,
    Widget,
    Viewport,
}

impl Plugin for KeyRouter {
    fn debug_name(&self) -> &'static str {
        "keys of commands"
    }

    fn input_hook(&mut self, ctx: &Context, input: &mut RawInput) {
        let owner = if ctx.memory(|m| m.top_modal_layer().is_some()) {
            Owner::Modal
        } else if ctx.text_edit_focused() {
            Owner::Text
        } else if ctx.egui_wants_keyboard_input() {
            Owner::Widget
        } else {
            Owner::Viewport
        };
        let before = self.pressed.len();
        input.events.retain(|event| {
            let Event::Key { key, pressed: true, modifiers, .. } = event else { return true };
            let found = keys::find(*key, *modifiers, &self.keymap);
            let Some((entry, index)) = found.filter(|(e, _)| is_command(owner, e, *key, *modifiers)) else {
                return true;
            };
            self.pressed.push(Invocation { command: entry.command, index });
            // egui must see Esc, which also closes menus, and the stop key, which changes other keys while
            // held.
            *key == Key::Escape || entry.command == Command::Stop
        });
        // The key of a command that opens a text field must not also be typed into that field.
        if self.pressed.len() > before && owner != Owner::Text {
            input.events.retain(|event| !matches!(event, Event::Text(_)));
        }
    }
}

fn is_command(owner: Owner, entry: &Entry, key: Key, modifiers: Modifiers) -> bool {
    let is_function_key = key.name().len() > 1 && key.name().starts_with('F');
    match owner {
        Owner::Modal => false,
        Owner::Text => entry.scope == Scope::Always && (modifiers.command || is_function_key),
        Owner::Widget => !matches!(
            key,
            Key::ArrowLeft | Key::ArrowRight | Key::Home | Key::End | Key::Enter | Key::Space | Key::Escape
        ),
        Owner::Viewport => true,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn acts(owner: Owner, key: Key, modifiers: Modifiers) -> bool {
        keys::find(key, modifiers, &Keymap::new())
            .is_some_and(|(entry, _)| is_command(owner, entry, key, modifiers))
    }

    #[test]
    fn a_text_field_owns_letters_arrows_and_its_own_undo() {
        for key in [Key::Space, Key::ArrowLeft, Key::V, Key::Slash, Key::Num1, Key::Home] {
            assert!(acts(Owner::Viewport, key, Modifiers::NONE), "{key:?}");
            assert!(!acts(Owner::Text, key, Modifiers::NONE), "{key:?}");
        }
        assert!(!acts(Owner::Text, Key::Z, Modifiers::COMMAND));
        assert!(acts(Owner::Text, Key::E, Modifiers::COMMAND));
        assert!(acts(Owner::Text, Key::F1, Modifiers::NONE));
    }

    #[test]
    fn a_slider_owns_arrows_but_no_letters() {
        assert!(!acts(Owner::Widget, Key::ArrowRight, Modifiers::NONE));
        assert!(!acts(Owner::Widget, Key::Space, Modifiers::NONE));
        assert!(acts(Owner::Widget, Key::V, Modifiers::NONE));
        assert!(!acts(Owner::Modal, Key::V, Modifiers::NONE));
    }
}
