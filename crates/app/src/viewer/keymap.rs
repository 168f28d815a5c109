//! Keys that the user chose instead of the default ones, e.g. for foot pedals and presenters, which send
//! keys, too.
//!
//! A key belongs to one command: choosing it for one command takes it from the others. The thread of the
//! window has a single map, because menus, tooltips, the sheet and the router all read it.

use super::command::{COMMANDS, Command, Entry};
use egui::{Key, KeyboardShortcut, Modifiers};
use std::{cell::RefCell, collections::BTreeMap};

/// Chosen keys as they are stored: names of commands, and texts such as "Ctrl+Shift+Z".
pub(crate) type Keymap = BTreeMap<String, String>;

thread_local! {
    static CHOSEN: RefCell<BTreeMap<String, KeyboardShortcut>> = const { RefCell::new(BTreeMap::new()) };
}

/// Applies the chosen keys; entries that cannot be read are left out.
pub(crate) fn apply(keymap: &Keymap) {
    let read = |(name, text): (&String, &String)| Some((name.clone(), parse(text)?));
    CHOSEN.set(keymap.iter().filter_map(read).collect());
}

/// Chooses a key for a command, or restores its default keys (`None`). A command that had this key chosen
/// gets its default keys back.
pub(crate) fn choose(keymap: &mut Keymap, command: Command, key: Option<KeyboardShortcut>) {
    let text = key.map(format);
    keymap.retain(|_, other| text.as_ref() != Some(&*other));
    match text {
        Some(text) => drop(keymap.insert(name(command), text)),
        None => drop(keymap.remove(&name(command))),
    }
    apply(keymap);
}

/// Returns the present keys of a command.
pub(crate) fn keys(entry: &Entry) -> Vec<KeyboardShortcut> {
    CHOSEN.with_borrow(|chosen| match chosen.get(&name(entry.command)) {
        Some(key) => vec![*key],
        None => entry.keys.iter().filter(|key| !chosen.values().any(|c| c == *key)).copied().collect(),
    })
}

/// Returns `true` if the user chose the key of a command.
pub(crate) fn is_chosen(command: Command) -> bool {
    CHOSEN.with_borrow(|chosen| chosen.contains_key(&name(command)))
}

/// Returns `true` if a key can be chosen. Tab moves the focus, Esc closes what is open, and digits belong to
/// the prompts.
pub(crate) fn can_be_chosen(key: KeyboardShortcut) -> bool {
    let numbers = |entry: &&Entry| matches!(entry.command, Command::TogglePrompt | Command::SoloPrompt);
    let is_number = COMMANDS.iter().filter(numbers).any(|entry| entry.keys.contains(&key));
    !matches!(key.logical_key, Key::Tab | Key::Escape) && !is_number
}

fn name(command: Command) -> String {
    format!("{command:?}")
}

/// Formats a key, e.g. "Ctrl+Shift+Z"; the same on every system.
fn format(key: KeyboardShortcut) -> String {
    let KeyboardShortcut { modifiers, logical_key } = key;
    let mut text = String::new();
    for (held, name) in [(modifiers.command, "Ctrl+"), (modifiers.alt, "Alt+"), (modifiers.shift, "Shift+")] {
        text += if held { name } else { "" };
    }
    text + logical_key.name()
}

fn parse(text: &str) -> Option<KeyboardShortcut> {
    let mut rest = text;
    let mut modifiers = Modifiers::NONE;
    for (name, modifier) in
        [("Ctrl+", Modifiers::COMMAND), ("Alt+", Modifiers::ALT), ("Shift+", Modifiers::SHIFT)]
    {
        if let Some(left) = rest.strip_prefix(name) {
            (rest, modifiers) = (left, modifiers | modifier);
        }
    }
    let key = KeyboardShortcut::new(modifiers, Key::from_name(rest)?);
    can_be_chosen(key).then_some(key)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::viewer::command::{entry, find};

    #[test]
    fn every_key_is_read_as_it_is_written() {
        for key in COMMANDS.iter().flat_map(|e| e.keys).filter(|k| can_be_chosen(**k)) {
            assert_eq!(parse(&format(*key)), Some(*key));
        }
        for nothing in ["", "Ctrl+", "Banana", "Tab", "Escape", "1", "Alt+9"] {
            assert_eq!(parse(nothing), None, "{nothing}");
        }
    }

    #[test]
    fn a_chosen_key_is_taken_from_whoever_had_it() {
        let mut keymap = Keymap::new();
        let v = KeyboardShortcut::new(Modifiers::NONE, Key::V);
        choose(&mut keymap, Command::PlayPause, Some(v));
        assert_eq!(find(Key::V, Modifiers::NONE).unwrap().0.command, Command::PlayPause);
        assert!(find(Key::Space, Modifiers::NONE).is_none() && keys(entry(Command::HideOverlays)).is_empty());
        choose(&mut keymap, Command::Bookmark, Some(v));
        assert_eq!(find(Key::V, Modifiers::NONE).unwrap().0.command, Command::Bookmark);
        assert_eq!(find(Key::Space, Modifiers::NONE).unwrap().0.command, Command::PlayPause);
        choose(&mut keymap, Command::Bookmark, None);
        assert_eq!(find(Key::V, Modifiers::NONE).unwrap().0.command, Command::HideOverlays);
        assert!(keymap.is_empty() && !is_chosen(Command::Bookmark));
    }
}
