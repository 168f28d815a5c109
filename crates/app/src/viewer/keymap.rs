//! Keys that the user chose instead of the delivered ones: foot pedals and presenters send keys, too.
//!
//! A key belongs to one command: chosen for one, it is taken from the others. The window's thread has one map, because menus,
//! tooltips, the sheet and the router all read it.

use super::command::{COMMANDS, Command, Entry};
use egui::{Key, KeyboardShortcut, Modifiers};
use std::{cell::RefCell, collections::BTreeMap};

/// The chosen key of commands, as it is kept from one start to the next: names of commands, and texts such as "Ctrl+Shift+Z".
pub(crate) type Keymap = BTreeMap<String, String>;

thread_local! {
    static CHOSEN: RefCell<BTreeMap<String, KeyboardShortcut>> = const { RefCell::new(BTreeMap::new()) };
}

/// From now on these keys are the chosen ones; what cannot be read is left out.
pub(crate) fn apply(keymap: &Keymap) {
    let read = |(name, text): (&String, &String)| Some((name.clone(), parse(text)?));
    CHOSEN.set(keymap.iter().filter_map(read).collect());
}

/// Chooses a key for a command, or none (`None`): then it has the delivered ones again. Another command that had it chosen has
/// its delivered ones again.
pub(crate) fn choose(keymap: &mut Keymap, command: Command, key: Option<KeyboardShortcut>) {
    let text = key.map(format);
    keymap.retain(|_, other| text.as_ref() != Some(&*other));
    match text {
        Some(text) => drop(keymap.insert(name(command), text)),
        None => drop(keymap.remove(&name(command))),
    }
    apply(keymap);
}

/// The keys of a command now.
pub(crate) fn keys(entry: &Entry) -> Vec<KeyboardShortcut> {
    CHOSEN.with_borrow(|chosen| match chosen.get(&name(entry.command)) {
        Some(key) => vec![*key],
        None => entry.keys.iter().filter(|key| !chosen.values().any(|c| c == *key)).copied().collect(),
    })
}

/// Whether the user chose the key of a command.
pub(crate) fn is_chosen(command: Command) -> bool {
    CHOSEN.with_borrow(|chosen| chosen.contains_key(&name(command)))
}

/// Whether a key can be chosen: Tab moves the focus, Esc closes what is open, and digits are the prompts'.
pub(crate) fn can_be_chosen(key: KeyboardShortcut) -> bool {
    let numbers = |entry: &&Entry| matches!(entry.command, Command::TogglePrompt | Command::SoloPrompt);
    let is_number = COMMANDS.iter().filter(numbers).any(|entry| entry.keys.contains(&key));
    !matches!(key.logical_key, Key::Tab | Key::Escape) && !is_number
}

fn name(command: Command) -> String {
    format!("{command:?}")
}

/// "Ctrl+Shift+Z"; the same on every system.
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
