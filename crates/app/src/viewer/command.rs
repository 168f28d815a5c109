//! The single table of everything that the window can be told to do. Menus, tooltips, keys and the shortcut
//! sheet all read it. Its keys are the default ones; [`keymap`] has the keys that the user chose instead.

use super::keymap;
use egui::{Key, KeyboardShortcut, Modifiers};

/// Something the user can ask for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) enum Command {
    OpenFile,
    OpenFolder,
    SaveSession,
    SaveSessionAs,
    Reconstruct,
    Export,
    Quality,
    Quit,
    Undo,
    Redo,
    CopyAreas,
    PlayPause,
    StepBack,
    StepForward,
    HopBack,
    HopForward,
    First,
    Last,
    GoToFrame,
    PlayBackwards,
    Stop,
    PlayForwards,
    Slower,
    Faster,
    NormalSpeed,
    Loop,
    RangeStart,
    RangeEnd,
    RangeClear,
    Exclude,
    FirstFound,
    LargestFound,
    LastFound,
    Bookmark,
    Bookmarks,
    PreviousBookmark,
    NextBookmark,
    FocusPrompt,
    TogglePrompt,
    SoloPrompt,
    Negatives,
    HideOverlays,
    Peek,
    CycleStyle,
    MoreOpacity,
    BelowInstruments,
    ThresholdDown,
    ThresholdUp,
    SwapOriginal,
    SideBySide,
    Wipe,
    Blink,
    Difference,
    Depth,
    DepthBeside,
    Motion,
    Opacity,
    CentreOrbit,
    Measure,
    Dismiss,
    ResetView,
    FullScreen,
    Larger,
    Smaller,
    NormalSize,
    Shortcuts,
    About,
}

/// Group of a command, which is a heading of the shortcut sheet.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Group {
    File,
    Edit,
    Time,
    Prompts,
    View,
    Help,
}

impl Group {
    pub(crate) const ALL: [Self; 6] =
        [Self::File, Self::Edit, Self::Time, Self::Prompts, Self::View, Self::Help];

    pub(crate) fn title(self) -> &'static str {
        match self {
            Self::File => "File",
            Self::Edit => "Edit",
            Self::Time => "Time",
            Self::Prompts => "Prompts",
            Self::View => "View",
            Self::Help => "Help",
        }
    }
}

/// Situations in which the keys of a command act.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Scope {
    /// Acts even while text is typed, if the key is a Ctrl chord or a function key.
    Always,
    /// Acts unless a text field has the focus, which then gets the key.
    Viewport,
    /// Acts as long as the key is held down; see [`is_held`].
    Hold,
}

/// One row of the table.
#[derive(Debug)]
pub(crate) struct Entry {
    pub(crate) command: Command,
    pub(crate) label: &'static str,
    pub(crate) tooltip: &'static str,
    pub(crate) group: Group,
    pub(crate) scope: Scope,
    /// Alternative keys. For the commands of numbered prompts, key n acts on prompt n.
    pub(crate) keys: &'static [KeyboardShortcut],
}

/// A command as it was given.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Invocation {
    pub(crate) command: Command,
    /// Index of the command's key that was pressed.
    pub(crate) index: usize,
}

impl From<Command> for Invocation {
    fn from(command: Command) -> Self {
        Self { command, index: 0 }
    }
}

/// Number of frames of the long step.
pub(crate) const HOP: isize = 10;
/// Change of the threshold by a threshold key.
pub(crate) const THRESHOLD_STEP: f32 = 0.01;
/// Increase of the opacity by the opacity key.
pub(crate) const OPACITY_STEP: f32 = 0.2;

const fn key(key: Key) -> KeyboardShortcut {
    KeyboardShortcut::new(Modifiers::NONE, key)
}
const fn shift(key: Key) -> KeyboardShortcut {
    KeyboardShortcut::new(Modifiers::SHIFT, key)
}
const fn ctrl(key: Key) -> KeyboardShortcut {
    KeyboardShortcut::new(Modifiers::COMMAND, key)
}
const fn ctrl_shift(key: Key) -> KeyboardShortcut {
    KeyboardShortcut::new(Modifiers::COMMAND.plus(Modifiers::SHIFT), key)
}
const fn alt(key: Key) -> KeyboardShortcut {
    KeyboardShortcut::new(Modifiers::ALT, key)
}

const DIGITS: [Key; 9] =
    [Key::Num1, Key::Num2, Key::Num3, Key::Num4, Key::Num5, Key::Num6, Key::Num7, Key::Num8, Key::Num9];

const fn digits(modifiers: Modifiers) -> [KeyboardShortcut; 9] {
    let mut keys = [KeyboardShortcut::new(modifiers, Key::Num1); 9];
    let mut i = 0;
    while i < 9 {
        keys[i] = KeyboardShortcut::new(modifiers, DIGITS[i]);
        i += 1;
    }
    keys
}

const PLAIN_DIGITS: [KeyboardShortcut; 9] = digits(Modifiers::NONE);
const ALT_DIGITS: [KeyboardShortcut; 9] = digits(Modifiers::ALT);

macro_rules! table {
    ($($command:ident $group:ident $scope:ident [$($key:expr),*] $label:literal $tooltip:literal)*) => {
        /// Every command, grouped as in the menus.
        pub(crate) const COMMANDS: &[Entry] = &[$(Entry {
            command: Command::$command,
            label: $label,
            tooltip: $tooltip,
            group: Group::$group,
            scope: Scope::$scope,
            keys: &[$($key),*],
        },)*
            Entry {
                command: Command::TogglePrompt,
                label: "Show or hide prompt 1–9",
                tooltip: "Show or hide what this prompt found",
                group: Group::Prompts,
                scope: Scope::Viewport,
                keys: &PLAIN_DIGITS,
            },
            Entry {
                command: Command::SoloPrompt,
                label: "Show only prompt 1–9",
                tooltip: "Show only what this prompt found; again shows all",
                group: Group::Prompts,
                scope: Scope::Viewport,
                keys: &ALT_DIGITS,
            },
        ];
    };
}

table! {
    OpenFile      File Always [ctrl(Key::O)] "Open file…" "Open a reconstruction (.safetensors), a session (.surgtpgs) or a video"
    OpenFolder    File Always [ctrl_shift(Key::O)] "Open folder…" "Open a recording: a folder of frames"
    SaveSession   File Always [ctrl(Key::S)] "Save session" "Save prompts, bookmarks and view in a small file; pictures stay where they are"
    SaveSessionAs File Always [ctrl_shift(Key::S)] "Save session as…" "Save the session in another file"
    Reconstruct   File Always [ctrl(Key::R)] "Reconstruct…" "Make a reconstruction of the open recording"
    Export        File Always [ctrl(Key::E)] "Export…" "Write masked frames as files"
    Quality       File Always [ctrl(Key::M)] "Measure quality…" "How well the reconstruction and what its class names find match the recording and its labels"
    Quit          File Always [ctrl(Key::Q)] "Quit" "Close the window"
    Undo          Edit Viewport [ctrl(Key::Z)] "Undo" "Undo the last change; written files stay"
    Redo          Edit Viewport [ctrl_shift(Key::Z), ctrl(Key::Y)] "Redo" "Do again what was undone"
    CopyAreas     Edit Viewport [] "Copy areas as a table" "Frame, time and area of every visible prompt as CSV, for a spreadsheet"
    PlayPause     Time Viewport [key(Key::Space)] "Play or pause" "Play or pause at the recording's own speed"
    StepBack      Time Viewport [key(Key::ArrowLeft)] "Back 1 frame" "Back 1 frame"
    StepForward   Time Viewport [key(Key::ArrowRight)] "Forward 1 frame" "Forward 1 frame"
    HopBack       Time Viewport [shift(Key::ArrowLeft)] "Back 10 frames" "Back 10 frames"
    HopForward    Time Viewport [shift(Key::ArrowRight)] "Forward 10 frames" "Forward 10 frames"
    First         Time Viewport [key(Key::Home)] "First frame" "Go to the first frame"
    Last          Time Viewport [key(Key::End)] "Last frame" "Go to the last frame"
    GoToFrame     Time Viewport [key(Key::G)] "Go to frame…" "Type the number of a frame"
    PlayBackwards Time Viewport [key(Key::J)] "Play backwards" "Play backwards; again for twice the speed"
    Stop          Time Viewport [key(Key::K)] "Stop" "Stop playing"
    PlayForwards  Time Viewport [key(Key::L)] "Play forwards" "Play forwards; again for twice the speed"
    Slower        Time Viewport [key(Key::OpenBracket)] "Slower" "Play slower"
    Faster        Time Viewport [key(Key::CloseBracket)] "Faster" "Play faster"
    NormalSpeed   Time Viewport [key(Key::Backslash)] "Normal speed" "Play at the recording's own speed"
    Loop          Time Viewport [shift(Key::L)] "Repeat" "Start again at the end"
    RangeStart    Time Viewport [key(Key::I)] "Range starts here" "Play and repeat from this frame on"
    RangeEnd      Time Viewport [shift(Key::I)] "Range ends here" "Play and repeat up to this frame"
    RangeClear    Time Viewport [alt(Key::I)] "Whole recording" "Play the whole recording again"
    Exclude       Time Viewport [key(Key::E)] "Leave out or take in" "Leave this frame, or the range that plays, out of everything; again takes it back in"
    FirstFound    Time Viewport [shift(Key::Home)] "First frame with it" "Go to the first frame on which the selected prompt is found"
    LargestFound  Time Viewport [key(Key::P)] "Frame with most of it" "Go to the frame on which the selected prompt is largest"
    LastFound     Time Viewport [shift(Key::End)] "Last frame with it" "Go to the last frame on which the selected prompt is found"
    Bookmark      Time Viewport [key(Key::M)] "Bookmark" "Mark this frame, or take its mark away"
    Bookmarks     Time Viewport [shift(Key::M)] "Bookmarks and notes…" "The list of bookmarks, with notes and flags"
    PreviousBookmark Time Viewport [ctrl(Key::ArrowLeft)] "Previous bookmark" "Go to the bookmark before this frame"
    NextBookmark  Time Viewport [ctrl(Key::ArrowRight)] "Next bookmark" "Go to the bookmark after this frame"
    FocusPrompt   Prompts Always [key(Key::Slash), ctrl(Key::L)] "Type a prompt" "Go to the prompt box"
    Negatives     Prompts Viewport [key(Key::N)] "What prompts are compared with…" "The generic phrases that a prompt has to beat"
    HideOverlays  Prompts Viewport [key(Key::V)] "Hide all overlays" "Show or hide everything drawn over the picture"
    Peek          Prompts Hold [key(Key::X)] "Peek at the recorded frame (hold)" "The recorded frame without anything drawn over it, as long as the key is held"
    CycleStyle    Prompts Viewport [key(Key::O)] "Next overlay style" "Outline, fill or heatmap"
    MoreOpacity   Prompts Viewport [shift(Key::O)] "More opaque overlay" "Make the overlay more opaque by 0.2; starts again at 0.2"
    BelowInstruments Prompts Viewport [alt(Key::O)] "Below instruments" "Draw what is found below the instruments, or over them"
    ThresholdDown Prompts Viewport [key(Key::T)] "Lower threshold" "Lower the threshold of the selected prompt by 0.01: more is found"
    ThresholdUp   Prompts Viewport [shift(Key::T)] "Raise threshold" "Raise the threshold of the selected prompt by 0.01: less is found"
    SwapOriginal  View Viewport [shift(Key::B)] "Original or reconstruction" "Switch between the recorded frame and the reconstruction"
    SideBySide    View Viewport [shift(Key::W)] "Side by side" "The recorded frame beside the reconstruction"
    Wipe          View Viewport [key(Key::W)] "Wipe" "Drag a line between the recorded frame and the reconstruction"
    Blink         View Viewport [key(Key::B)] "Blink" "The recorded frame and the reconstruction in turns"
    Difference    View Viewport [key(Key::F)] "Difference" "How much the reconstruction differs from the recorded frame"
    Depth         View Viewport [key(Key::D)] "Depth" "How far each point is from the endoscope"
    DepthBeside   View Viewport [shift(Key::D)] "Beside its depth" "The reconstruction beside its depth"
    Motion        View Viewport [shift(Key::F)] "Moving" "How far each point moves over the recording"
    Opacity       View Viewport [key(Key::A)] "Opacity" "How opaque the reconstruction is: where it is not, nothing was reconstructed"
    CentreOrbit   View Viewport [key(Key::C)] "Turn around this point" "Look around the point under the pointer from now on"
    Measure       View Viewport [key(Key::U)] "Ruler" "Measure on the picture: drag from one point to another"
    Dismiss       View Viewport [key(Key::Escape)] "Close what is open" "Close the message, the point's scores or the ruler"
    ResetView     View Viewport [key(Key::R)] "Back to the endoscope" "Back to the endoscope's own view, without zoom"
    FullScreen    View Always [key(Key::F11)] "Full screen" "Fill the screen, or back to a window"
    Larger        View Always [ctrl(Key::Plus), ctrl(Key::Equals)] "Larger text and buttons" "Make text and buttons larger, for a screen that is far away"
    Smaller       View Always [ctrl(Key::Minus)] "Smaller text and buttons" "Make text and buttons smaller"
    NormalSize    View Always [ctrl(Key::Num0)] "Normal text and buttons" "Text and buttons at their normal size"
    Shortcuts     Help Always [key(Key::F1)] "Keyboard shortcuts" "All keys on one sheet"
    About         Help Always [] "About SurgTPGS" "Version, intended use and privacy"
}

/// Returns the row of a command.
pub(crate) fn entry(command: Command) -> &'static Entry {
    COMMANDS.iter().find(|e| e.command == command).unwrap_or(&COMMANDS[0])
}

/// Finds the command of a key, and the index of that key. Modifiers must be exactly those of the key:
/// Shift+Left is not Left.
pub(crate) fn find(pressed: Key, modifiers: Modifiers) -> Option<(&'static Entry, usize)> {
    COMMANDS.iter().filter(|e| e.scope != Scope::Hold).find_map(|entry| {
        let matches = |k: &KeyboardShortcut| k.logical_key == pressed && is_exactly(modifiers, k.modifiers);
        keymap::keys(entry).iter().position(matches).map(|index| (entry, index))
    })
}

/// Returns `true` while the key of a [`Scope::Hold`] command is down and no text field has the focus.
pub(crate) fn is_held(ctx: &egui::Context, command: Command) -> bool {
    !ctx.text_edit_focused()
        && ctx.input(|i| {
            i.modifiers.is_none() && keymap::keys(entry(command)).iter().any(|k| i.key_down(k.logical_key))
        })
}

/// Returns `true` while one of a command's keys is down, ignoring modifiers.
pub(crate) fn is_down(ctx: &egui::Context, command: Command) -> bool {
    ctx.input(|i| keymap::keys(entry(command)).iter().any(|k| i.key_down(k.logical_key)))
}

/// Formats the keys of a command, e.g. "Shift+W"; empty if it has none.
pub(crate) fn keys_text(entry: &Entry) -> String {
    let one = |k: &KeyboardShortcut| {
        let mut text = String::new();
        for (held, name) in [
            (k.modifiers.command, if cfg!(target_os = "macos") { "Cmd+" } else { "Ctrl+" }),
            (k.modifiers.alt, "Alt+"),
            (k.modifiers.shift, "Shift+"),
        ] {
            text += if held { name } else { "" };
        }
        text + key_name(k.logical_key)
    };
    let keys = keymap::keys(entry);
    match &keys[..] {
        [first, .., last] if keys.len() == DIGITS.len() => {
            format!("{}–{}", one(first), key_name(last.logical_key))
        }
        keys => keys.iter().map(one).collect::<Vec<_>>().join(", "),
    }
}

/// Returns the tooltip of a command, with its keys.
pub(crate) fn tooltip(command: Command) -> String {
    with_keys(entry(command).tooltip, command)
}

/// Appends the keys of a command to a sentence, if there are any.
pub(crate) fn with_keys(sentence: &str, command: Command) -> String {
    match keys_text(entry(command)) {
        keys if keys.is_empty() => sentence.to_owned(),
        keys => format!("{sentence} ({keys})"),
    }
}

/// Returns the name of a key in words, because key symbols are not in every font.
fn key_name(key: Key) -> &'static str {
    match key {
        Key::ArrowLeft => "Left",
        Key::ArrowRight => "Right",
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

#[cfg(test)]
mod tests {
    use super::*;

    fn chord(k: &KeyboardShortcut) -> (Key, bool, bool, bool) {
        (k.logical_key, k.modifiers.command, k.modifiers.shift, k.modifiers.alt)
    }

    #[test]
    fn no_two_commands_share_a_key() {
        let mut seen = Vec::new();
        for entry in COMMANDS {
            for k in entry.keys {
                assert!(!seen.contains(&chord(k)), "{:?} of {:?} is taken", k, entry.command);
                seen.push(chord(k));
            }
        }
    }

    #[test]
    fn every_command_is_listed_once() {
        for (i, a) in COMMANDS.iter().enumerate() {
            assert!(COMMANDS[i + 1..].iter().all(|b| a.command != b.command), "{:?}", a.command);
            assert!(!a.label.is_empty() && !a.tooltip.is_empty() && !a.tooltip.ends_with('.'));
        }
    }

    #[test]
    fn modifiers_must_match_exactly() {
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
    fn numbers_in_words_are_the_numbers_that_act() {
        for command in [Command::HopBack, Command::HopForward] {
            assert!(entry(command).tooltip.contains(&format!("{HOP} frames")));
        }
        for command in [Command::ThresholdDown, Command::ThresholdUp] {
            assert!(entry(command).tooltip.contains(&format!("by {THRESHOLD_STEP}:")));
        }
        assert!(entry(Command::MoreOpacity).tooltip.contains(&format!("by {OPACITY_STEP};")));
        assert_eq!(tooltip(Command::HopBack), "Back 10 frames (Shift+Left)");
        assert_eq!(keys_text(entry(Command::SoloPrompt)), "Alt+1–9");
    }
}
