//! Takes the keys of commands out of the input before egui sees them.
//!
//! A modal dialog owns all keys. A focused text field owns all but the Ctrl chords and function keys of
//! [`Scope::Always`]; an empty prompt box also leaves the arrows, Home and End to the picture. Another
//! focused widget owns the arrows, Home, End, Enter, Space and Esc. All other keys belong to the viewport.
//! egui itself would move the focus by the arrows, therefore this happens before the pass begins.
//!
//! One batch of input may hold keys for two owners, such as "/fat" typed fast: a command that opens the
//! prompt box, and a word. Everything typed behind a key or click that may move the focus waits for the next
//! pass, when it is known who owns it.

use crate::viewer::{
    command::{Command, Entry, Invocation, Scope, keys, takes_keyboard},
    state::preferences::Keymap,
};
use egui::{Context, Event, Key, Modifiers, Plugin, RawInput};

/// Collects the commands given by key.
#[derive(Debug, Default)]
pub(crate) struct KeyRouter {
    pressed: Vec<Invocation>,
    /// Keys that the user chose.
    keymap: Keymap,
    /// `true` if the prompt box has the focus and is empty.
    is_box_empty: bool,
    /// Typed events that wait for the next pass.
    waiting: Vec<Event>,
    /// `true` if they were typed behind a command that takes the keyboard. If it took nothing, they are
    /// dropped.
    waits_for_field: bool,
}

impl KeyRouter {
    /// Sets the keys that the user chose, and whether an empty prompt box has the focus.
    pub(crate) fn tell(ctx: &Context, keymap: &Keymap, is_box_empty: bool) {
        ctx.with_plugin(|router: &mut Self| {
            router.is_box_empty = is_box_empty;
            if router.keymap != *keymap {
                router.keymap = keymap.clone();
            }
        });
    }

    /// Takes the commands given since the last call, in order.
    pub(crate) fn take(ctx: &Context) -> Vec<Invocation> {
        ctx.with_plugin(|router: &mut Self| std::mem::take(&mut router.pressed)).unwrap_or_default()
    }

    /// Returns the typed events of the last pass that had to wait, unless nobody took the keyboard for them.
    fn waited(&mut self, owner: Owner) -> Vec<Event> {
        let is_taken = matches!(owner, Owner::Text | Owner::Modal);
        let is_wanted = !std::mem::take(&mut self.waits_for_field) || is_taken;
        std::mem::take(&mut self.waiting).into_iter().filter(|_| is_wanted).collect()
    }

    /// Returns the command that a pressed key gives.
    fn command(&self, owner: Owner, key: Key, modifiers: Modifiers) -> Option<Invocation> {
        let (entry, index) = keys::find(key, modifiers, &self.keymap)?;
        let is_given = is_command(owner, entry, key, modifiers, self.is_box_empty);
        is_given.then_some(Invocation { command: entry.command, index })
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

impl Owner {
    fn of(ctx: &Context) -> Self {
        if ctx.memory(|m| m.top_modal_layer().is_some()) {
            Self::Modal
        } else if ctx.text_edit_focused() {
            Self::Text
        } else if ctx.egui_wants_keyboard_input() {
            Self::Widget
        } else {
            Self::Viewport
        }
    }
}

impl Plugin for KeyRouter {
    fn debug_name(&self) -> &'static str {
        "keys of commands"
    }

    fn input_hook(&mut self, ctx: &Context, input: &mut RawInput) {
        let owner = Owner::of(ctx);
        let takes_text = matches!(owner, Owner::Text | Owner::Modal);
        let mut must_wait = false;
        // The letter of a command's key must not also be typed.
        let mut is_used = false;
        let events: Vec<Event> =
            self.waited(owner).into_iter().chain(std::mem::take(&mut input.events)).collect();
        for event in events {
            match event {
                // The system's keys for copying come as this event, which belongs to selected text first.
                Event::Copy if !takes_text && !must_wait => {
                    self.pressed.extend(self.command(owner, Key::C, Modifiers::COMMAND));
                }
                Event::Text(_) if std::mem::take(&mut is_used) || !(takes_text || must_wait) => continue,
                ref typed if must_wait && is_typed(typed) => {
                    is_used = false;
                    self.waiting.push(event);
                    continue;
                }
                Event::Key { key, pressed: true, modifiers, .. } => {
                    let given = self.command(owner, key, modifiers);
                    is_used = given.is_some();
                    self.waits_for_field = given.is_some_and(|i| takes_keyboard(i.command));
                    // The tool for marking may take the keyboard for its name, or is put away.
                    let may_take =
                        given.is_some_and(|i| matches!(i.command, Command::Mark | Command::LookHere));
                    let moves_focus = matches!(key, Key::Enter | Key::Escape | Key::Tab);
                    must_wait = self.waits_for_field || may_take || moves_focus;
                    self.pressed.extend(given);
                    // egui must see Esc, which also closes menus, and the stop key, which changes other keys
                    // while held.
                    if is_used && key != Key::Escape && given.is_none_or(|i| i.command != Command::Stop) {
                        continue;
                    }
                }
                // A click may move the focus, too.
                Event::PointerButton { .. } => must_wait = true,
                _ => {}
            }
            input.events.push(event);
        }
        if !self.waiting.is_empty() {
            ctx.request_repaint();
        }
    }
}

/// Returns `true` for events of the keyboard.
fn is_typed(event: &Event) -> bool {
    matches!(event, Event::Key { .. } | Event::Text(_) | Event::Paste(_) | Event::Ime(_))
}

fn is_command(owner: Owner, entry: &Entry, key: Key, modifiers: Modifiers, is_box_empty: bool) -> bool {
    let is_function_key = key.name().len() > 1 && key.name().starts_with('F');
    let moves_cursor = matches!(key, Key::ArrowLeft | Key::ArrowRight | Key::Home | Key::End);
    match owner {
        Owner::Modal => false,
        Owner::Text => {
            let is_chord = entry.scope == Scope::Always && (modifiers.command || is_function_key);
            is_chord || (is_box_empty && moves_cursor)
        }
        Owner::Widget => !(moves_cursor || matches!(key, Key::Enter | Key::Space | Key::Escape)),
        Owner::Viewport => true,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn acts(owner: Owner, key: Key, modifiers: Modifiers) -> bool {
        KeyRouter::default().command(owner, key, modifiers).is_some()
    }

    #[test]
    fn a_text_field_owns_letters_arrows_and_its_own_undo() {
        for key in [Key::Space, Key::ArrowLeft, Key::D, Key::Slash, Key::Num1, Key::Home] {
            assert!(acts(Owner::Viewport, key, Modifiers::NONE), "{key:?}");
            assert!(!acts(Owner::Text, key, Modifiers::NONE), "{key:?}");
        }
        assert!(!acts(Owner::Text, Key::Z, Modifiers::COMMAND));
        assert!(acts(Owner::Text, Key::E, Modifiers::COMMAND));
        assert!(acts(Owner::Text, Key::F1, Modifiers::NONE));
    }

    #[test]
    fn an_empty_prompt_box_leaves_the_arrows_to_the_picture() {
        let router = KeyRouter { is_box_empty: true, ..KeyRouter::default() };
        let acts = |key| router.command(Owner::Text, key, Modifiers::NONE).is_some();
        assert!(acts(Key::ArrowLeft) && acts(Key::End));
        assert!(!acts(Key::Space) && !acts(Key::D) && !acts(Key::Num1));
    }

    #[test]
    fn a_slider_owns_arrows_but_no_letters() {
        assert!(!acts(Owner::Widget, Key::ArrowRight, Modifiers::NONE));
        assert!(!acts(Owner::Widget, Key::Space, Modifiers::NONE));
        assert!(acts(Owner::Widget, Key::D, Modifiers::NONE));
        assert!(!acts(Owner::Modal, Key::D, Modifiers::NONE));
    }
}
