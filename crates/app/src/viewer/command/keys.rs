//! Keys of the commands: the default ones, and those that the user chose instead, e.g. for foot pedals and
//! presenters, which send keys, too.
//!
//! A key belongs to one command: choosing it for one command takes it from the others.

use crate::viewer::{
    command::{COMMANDS, Command, DIGITS, Entry, Scope, entry},
    shared::Shared,
    state::preferences::Keymap,
};
use egui::{Context, Key, KeyboardShortcut, Modifiers};

/// Chooses a key for a command, or restores its default keys (`None`). A command that had this key chosen
/// gets its default keys back.
pub(crate) fn choose(keymap: &mut Keymap, command: Command, key: Option<KeyboardShortcut>) {
    let text = key.map(format);
    keymap.retain(|_, other| text.as_ref() != Some(&*other));
    match text {
        Some(text) => drop(keymap.insert(name(command), text)),
        None => drop(keymap.remove(&name(command))),
    }
}

/// Returns the present keys of a command. Chosen keys that cannot be read do not count.
pub(crate) fn keys(entry: &Entry, keymap: &Keymap) -> Vec<KeyboardShortcut> {
    match chosen(keymap, entry.command) {
        Some(key) => vec![key],
        None => {
            let taken: Vec<_> = keymap.values().filter_map(|text| parse(text)).collect();
            entry.keys.iter().filter(|key| !taken.contains(key)).copied().collect()
        }
    }
}

/// Returns `true` if the user chose the key of a command.
pub(crate) fn is_chosen(command: Command, keymap: &Keymap) -> bool {
    chosen(keymap, command).is_some()
}

/// Finds the command of a key, and the index of that key. Modifiers must be exactly those of the key:
/// Shift+Left is not Left.
pub(crate) fn find(pressed: Key, modifiers: Modifiers, keymap: &Keymap) -> Option<(&'static Entry, usize)> {
    COMMANDS.iter().filter(|e| e.scope != Scope::Hold).find_map(|entry| {
        let matches = |k: &KeyboardShortcut| k.logical_key == pressed && is_exactly(modifiers, k.modifiers);
        keys(entry, keymap).iter().position(matches).map(|index| (entry, index))
    })
}

/// Returns `true` while one of the keys to stop is down, ignoring modifiers.
pub(crate) fn is_stop_down(ctx: &Context, keymap: &Keymap) -> bool {
    ctx.input(|i| keys(entry(Command::Stop), keymap).iter().any(|k| i.key_down(k.logical_key)))
}

/// Returns `true` if a key can be chosen. Tab moves the focus, Esc closes what is open, and digits belong to
/// the prompts.
pub(crate) fn can_be_chosen(key: KeyboardShortcut) -> bool {
    let numbers = |entry: &&Entry| matches!(entry.command, Command::TogglePrompt | Command::SoloPrompt);
    let is_number = COMMANDS.iter().filter(numbers).any(|entry| entry.keys.contains(&key));
    !matches!(key.logical_key, Key::Tab | Key::Escape) && !is_number
}

/// Formats the keys of a command, e.g. "Shift+W"; empty if it has none.
pub(crate) fn keys_text(entry: &Entry, keymap: &Keymap) -> String {
    let keys = keys(entry, keymap);
    match &keys[..] {
        [first, .., last] if keys.len() == DIGITS.len() => {
            format!("{}–{}", in_words(first), key_name(last.logical_key))
        }
        keys => keys.iter().map(in_words).collect::<Vec<_>>().join(", "),
    }
}

impl Shared {
    /// Formats the keys of a command, e.g. "Shift+W"; empty if it has none.
    pub(crate) fn keys_text(&self, command: Command) -> String {
        keys_text(entry(command), &self.preferences.keys)
    }

    /// Returns the tooltip of a command, with its keys.
    pub(crate) fn tooltip(&self, command: Command) -> String {
        self.with_keys(entry(command).tooltip, command)
    }

    /// Appends the keys of a command to a sentence, if there are any.
    pub(crate) fn with_keys(&self, sentence: &str, command: Command) -> String {
        match self.keys_text(command) {
            keys if keys.is_empty() => sentence.to_owned(),
            keys => format!("{sentence} ({keys})"),
        }
    }

    /// Returns `true` while only the recorded frame is to be shown: while the key of [`Command::Peek`] is
    /// down and no text field has the focus.
    pub(crate) fn is_peeking(&self, ctx: &Context) -> bool {
        let is_held = || {
            let keys = keys(entry(Command::Peek), &self.preferences.keys);
            ctx.input(|i| i.modifiers.is_none() && keys.iter().any(|k| i.key_down(k.logical_key)))
        };
        self.info().is_some_and(|i| i.has_original) && !ctx.text_edit_focused() && is_held()
    }
}

fn name(command: Command) -> String {
    format!("{command:?}")
}

fn chosen(keymap: &Keymap, command: Command) -> Option<KeyboardShortcut> {
    if keymap.is_empty() { None } else { parse(keymap.get(&name(command))?) }
}

/// Formats a key as it is shown.
fn in_words(key: &KeyboardShortcut) -> String {
    let mut text = String::new();
    for (held, name) in [
        (key.modifiers.command, if cfg!(target_os = "macos") { "Cmd+" } else { "Ctrl+" }),
        (key.modifiers.alt, "Alt+"),
        (key.modifiers.shift, "Shift+"),
    ] {
        text += if held { name } else { "" };
    }
    text + key_name(key.logical_key)
}

/// Returns the name of a key in words, because key symbols are not in every font.
fn key_name(key: Key) -> &'static str {
    match key {
        Key::ArrowLeft => "Left",
        Key::ArrowRight => "Right",
        Key::ArrowUp => "Up",
        Key::ArrowDown => "Down",
        Key::Escape => "Esc",
        Key::OpenBracket => "[",
        Key::CloseBracket => "]",
        Key::Backslash => "\\",
        Key::Slash => "/",
        Key::Plus => "+",
        Key::Equals => "=",
        Key::Minus => "-",
        other => other.name(),
    }
}

fn is_exactly(pressed: Modifiers, wanted: Modifiers) -> bool {
    pressed.alt == wanted.alt && pressed.shift == wanted.shift && pressed.command == wanted.command
}

/// Formats a key as it is stored, e.g. "Ctrl+Shift+Z"; the same on every system.
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
    fn modifiers_must_match_exactly() {
        let find = |key, modifiers| super::find(key, modifiers, &Keymap::new());
        assert_eq!(find(Key::ArrowLeft, Modifiers::NONE).unwrap().0.command, Command::StepBack);
        assert_eq!(find(Key::ArrowLeft, Modifiers::SHIFT).unwrap().0.command, Command::HopBack);
        assert!(find(Key::ArrowLeft, Modifiers::ALT).is_none());
        assert_eq!(
            find(Key::Num3, Modifiers::ALT).map(|(e, i)| (e.command, i)),
            Some((Command::SoloPrompt, 2))
        );
        assert!(find(Key::X, Modifiers::NONE).is_none(), "held keys are not commands of one press");
    }

    #[test]
    fn keys_are_named_as_people_say_them() {
        assert_eq!(keys_text(entry(Command::HopBack), &Keymap::new()), "Shift+Left");
        assert_eq!(keys_text(entry(Command::SoloPrompt), &Keymap::new()), "Alt+1–9");
    }

    #[test]
    fn a_chosen_key_is_taken_from_whoever_had_it() {
        let mut keymap = Keymap::new();
        let d = KeyboardShortcut::new(Modifiers::NONE, Key::D);
        let of = |key, keymap: &Keymap| find(key, Modifiers::NONE, keymap).map(|(entry, _)| entry.command);
        choose(&mut keymap, Command::PlayPause, Some(d));
        assert_eq!(of(Key::D, &keymap), Some(Command::PlayPause));
        assert!(of(Key::Space, &keymap).is_none() && keys(entry(Command::Depth), &keymap).is_empty());
        choose(&mut keymap, Command::Bookmark, Some(d));
        assert_eq!(of(Key::D, &keymap), Some(Command::Bookmark));
        assert_eq!(of(Key::Space, &keymap), Some(Command::PlayPause));
        choose(&mut keymap, Command::Bookmark, None);
        assert_eq!(of(Key::D, &keymap), Some(Command::Depth));
        assert!(keymap.is_empty() && !is_chosen(Command::Bookmark, &keymap));
    }

    /// Compares the table in the manual with the commands; `UPDATE_README=1` writes it.
    #[test]
    fn the_manual_lists_every_key() {
        let file = concat!(env!("CARGO_MANIFEST_DIR"), "/README.md");
        let manual = std::fs::read_to_string(file).unwrap();
        let mut table = String::from("| Key | Command | What it does |\n|---|---|---|\n");
        for entry in COMMANDS.iter().filter(|e| !e.keys.is_empty()) {
            let keys = keys_text(entry, &Keymap::new()).replace("Cmd+", "Ctrl+").replace(", ", "`, `");
            let label = entry.label.trim_end_matches('…');
            table += &format!("| `{keys}` | {label} | {} |\n", entry.tooltip);
        }
        let (before, rest) = manual.split_once("<!-- keys -->\n").unwrap();
        let (listed, after) = rest.split_once("<!-- /keys -->").unwrap();
        if std::env::var_os("UPDATE_README").is_some() {
            let updated = format!("{before}<!-- keys -->\n{table}<!-- /keys -->{after}");
            std::fs::write(file, updated).unwrap();
        } else {
            assert_eq!(listed, table, "run this test once with UPDATE_README=1");
        }
    }
}
