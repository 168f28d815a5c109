//! The single table of everything that the window can be told to do: menus, tooltips, keys and the shortcut
//! sheet all read it. Its keys are the default ones; [`keys`] applies those that the user chose instead.

mod acts;
pub(crate) mod keys;
mod obstacles;
pub(crate) mod router;
mod run;

use crate::viewer::{
    picture::areas::Curve,
    shared::{Dialog, Shared},
    state::{document::THRESHOLD_STEP, playback::HOP, view_mode::ViewMode},
};
use acts::{
    Given, begin_range, centre_orbit, copy_areas, dismiss, end_range, exclude, full_screen, go_to_bookmark,
    go_to_found, look_here, magnify_time, pick, shuttle, switch, toggle_bookmark, what_to_open,
};
use egui::{Key, KeyboardShortcut, Modifiers, ViewportCommand};
use obstacles::{
    Obstacle, bookmarked, never, no_bookmarks, no_demo, no_export, no_marks, no_picture, no_prompts,
    no_reconstruction, no_span, not_bookmarked, not_found, not_in_a_file, not_reconstructible, nothing_open,
    nothing_to_compare, nothing_to_redo, nothing_to_undo, nowhere_to_look, picking, reconstructing,
    uncounted,
};

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
    /// Acts as long as the key is held down; see [`Shared::is_peeking`].
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
    /// Says why the command cannot be given in the present state; `None` if it can.
    obstacle: fn(&Shared) -> Obstacle,
    /// Carries out the command.
    act: fn(&mut Shared, &Given<'_>),
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

/// Makes the commands and their rows from one list, so that no command can lack a row.
macro_rules! commands {
    ($($command:ident: $group:ident, $scope:ident, $keys:expr, $label:literal,
        $tooltip:literal, unless $obstacle:expr, act $act:expr;)*) => {
        /// Something the user can ask for.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
        pub(crate) enum Command {
            $($command,)*
        }

        /// Every command in the order of [`Command`], grouped as in the menus.
        pub(crate) const COMMANDS: &[Entry] = &[$(Entry {
            command: Command::$command,
            label: $label,
            tooltip: $tooltip,
            group: Group::$group,
            scope: Scope::$scope,
            keys: &$keys,
            obstacle: $obstacle,
            act: $act,
        },)*];
    };
}

commands! {
    OpenFile: File, Always, [ctrl(Key::O)], "Open file…",
        "Open a reconstruction (.safetensors), a session (.surgtpgs) or a video",
        unless picking, act |s, g| pick(s, false, g.ctx);
    OpenFolder: File, Always, [ctrl_shift(Key::O)], "Open folder…",
        "Open a recording: a folder of frames",
        unless picking, act |s, g| pick(s, true, g.ctx);
    OpenPath: File, Always, [], "Open by its path…",
        "Type or choose a path in this window, without the system's dialog",
        unless picking, act |s, _| s.opening.asked = Some(what_to_open(s, false));
    OpenDemo: File, Always, [], "Open the demo",
        "A made-up recording with everything ready: the first time it takes some minutes",
        unless no_demo, act |s, g| s.open_demo(g.ctx);
    StartPage: File, Always, [ctrl(Key::W)], "Start page",
        "Close what is open and choose something else; unsaved work is kept",
        unless |s| nothing_open(s).or(reconstructing(s)), act |s, g| s.close(g.ctx);
    SaveSession: File, Always, [ctrl(Key::S)], "Save session",
        "Save prompts, bookmarks and view in a small file; pictures stay where they are",
        unless |s| nothing_open(s).or(picking(s)), act |s, g| s.save_session(false, g.ctx);
    SaveSessionAs: File, Always, [ctrl_shift(Key::S)], "Save session as…",
        "Save the session in another file",
        unless |s| nothing_open(s).or(picking(s)), act |s, g| s.save_session(true, g.ctx);
    OpenMarks: File, Always, [], "Open marks…",
        "Add the marks of a file that was saved here, or annotations of another program",
        unless |s| nothing_open(s).or(picking(s)), act |s, g| s.open_marks(g.ctx);
    SaveMarks: File, Always, [], "Save marks…",
        "Write all marks to a file, which the command line reads, too",
        unless |s| nothing_open(s).or(picking(s)).or(no_marks(s)), act |s, g| s.save_marks(g.ctx);
    Reconstruct: File, Always, [ctrl(Key::R)], "Reconstruct…",
        "Make a reconstruction of the open recording",
        unless not_reconstructible, act |s, _| s.dialog = Some(Dialog::Reconstruct);
    Export: File, Always, [ctrl(Key::E)], "Export…",
        "Write masked frames as files",
        unless no_export, act |s, _| s.dialog = Some(Dialog::Export);
    Quality: File, Always, [ctrl(Key::M)], "Measure quality…",
        "How well the reconstruction and what its class names find match the recording and its labels",
        unless |s| not_in_a_file(s).or(nothing_to_compare(s)), act |s, _| s.dialog = Some(Dialog::Quality);
    Quit: File, Always, [ctrl(Key::Q)], "Quit",
        "Close the window",
        unless never, act |_, g| g.ctx.send_viewport_cmd(ViewportCommand::Close);
    Undo: Edit, Viewport, [ctrl(Key::Z)], "Undo",
        "Undo the last change; written files stay",
        unless nothing_to_undo, act |s, _| s.document.undo();
    Redo: Edit, Viewport, [ctrl_shift(Key::Z), ctrl(Key::Y)], "Redo",
        "Do again what was undone",
        unless nothing_to_redo, act |s, _| s.document.redo();
    CopyAreas: Edit, Viewport, [], "Copy areas as a table",
        "Frame, time and area of every visible prompt as CSV, for a spreadsheet",
        unless uncounted, act copy_areas;
    CopyPicture: Edit, Viewport, [ctrl(Key::C)], "Copy picture",
        "Copy the picture as it is shown, with names, frame and time, to paste it into slides",
        unless no_picture, act |s, g| s.copy_picture(g.now, g.ctx);
    PlayPause: Time, Viewport, [key(Key::Space)], "Play or pause",
        "Play forwards, or pause; after playing backwards, at the recording's own speed",
        unless nothing_open, act |s, g| s.play_or_pause(g.now);
    StepBack: Time, Viewport, [key(Key::ArrowLeft)], "Back 1 frame",
        "Back 1 frame",
        unless nothing_open, act |s, g| s.step(-1, g.now);
    StepForward: Time, Viewport, [key(Key::ArrowRight)], "Forward 1 frame",
        "Forward 1 frame",
        unless nothing_open, act |s, g| s.step(1, g.now);
    HopBack: Time, Viewport, [shift(Key::ArrowLeft)], "Back 10 frames",
        "Back 10 frames",
        unless nothing_open, act |s, g| s.step(-HOP, g.now);
    HopForward: Time, Viewport, [shift(Key::ArrowRight)], "Forward 10 frames",
        "Forward 10 frames",
        unless nothing_open, act |s, g| s.step(HOP, g.now);
    First: Time, Viewport, [key(Key::Home)], "First frame",
        "Go to the first frame",
        unless nothing_open, act |s, g| s.playback.go_to(0, g.now);
    Last: Time, Viewport, [key(Key::End)], "Last frame",
        "Go to the last frame",
        unless nothing_open, act |s, g| s.playback.go_to(usize::MAX, g.now);
    GoToFrame: Time, Viewport, [key(Key::G)], "Go to frame…",
        "Type the number of a frame",
        unless nothing_open, act |s, _| s.dialog = Some(Dialog::GoToFrame);
    PlayBackwards: Time, Viewport, [key(Key::J)], "Play backwards",
        "Play backwards; again for twice the speed",
        unless nothing_open, act |s, g| shuttle(s, g, -1);
    Stop: Time, Viewport, [key(Key::K)], "Stop",
        "Stop playing",
        unless nothing_open, act |s, g| s.pause(g.now);
    PlayForwards: Time, Viewport, [key(Key::L)], "Play forwards",
        "Play forwards; again for twice the speed",
        unless nothing_open, act |s, g| shuttle(s, g, 1);
    Slower: Time, Viewport, [key(Key::OpenBracket)], "Slower",
        "Play slower",
        unless nothing_open, act |s, g| s.playback.change_speed(-1, g.now);
    Faster: Time, Viewport, [key(Key::CloseBracket)], "Faster",
        "Play faster",
        unless nothing_open, act |s, g| s.playback.change_speed(1, g.now);
    NormalSpeed: Time, Viewport, [key(Key::Backslash)], "Normal speed",
        "Play at the recording's own speed",
        unless nothing_open, act |s, g| s.playback.normal_speed(g.now);
    Loop: Time, Viewport, [shift(Key::L)], "Repeat",
        "Start again at the end",
        unless nothing_open, act |s, _| s.playback.toggle_looping();
    RangeStart: Time, Viewport, [key(Key::I)], "Range starts here",
        "Play and repeat from this frame on",
        unless nothing_open, act begin_range;
    RangeEnd: Time, Viewport, [shift(Key::I)], "Range ends here",
        "Play and repeat up to this frame",
        unless nothing_open, act end_range;
    RangeClear: Time, Viewport, [alt(Key::I)], "Whole recording",
        "Play the whole recording again",
        unless nothing_open, act |s, _| s.document.set_range(None);
    Exclude: Time, Viewport, [ctrl_shift(Key::E)], "Leave out these frames",
        "Leave this frame, or the range that plays, out of everything; again takes it back in",
        unless nothing_open, act exclude;
    FirstFound: Time, Viewport, [shift(Key::Home)], "First frame where it is found",
        "Go to the first frame on which the selected prompt is found",
        unless not_found, act |s, g| go_to_found(s, g, Curve::first);
    LargestFound: Time, Viewport, [key(Key::P)], "Frame where it is largest",
        "Go to the frame on which the selected prompt is largest",
        unless not_found, act |s, g| go_to_found(s, g, Curve::largest);
    LastFound: Time, Viewport, [shift(Key::End)], "Last frame where it is found",
        "Go to the last frame on which the selected prompt is found",
        unless not_found, act |s, g| go_to_found(s, g, Curve::last);
    Bookmark: Time, Viewport, [key(Key::M)], "Bookmark",
        "Mark this frame",
        unless |s| nothing_open(s).or(bookmarked(s)), act toggle_bookmark;
    DeleteBookmark: Time, Viewport, [ctrl_shift(Key::M)], "Delete the bookmark",
        "Take the mark of this frame away, with its note",
        unless not_bookmarked, act toggle_bookmark;
    Bookmarks: Time, Viewport, [shift(Key::M)], "Bookmarks and notes…",
        "The list of bookmarks, with notes and flags",
        unless nothing_open, act |s, _| s.dialog = Some(Dialog::Bookmarks);
    Phases: Time, Viewport, [shift(Key::P)], "Phases…",
        "Name the parts of the recording; save and read them as files",
        unless nothing_open, act |s, _| s.dialog = Some(Dialog::Phases);
    TimeCloser: Time, Viewport, [alt(Key::ArrowUp)], "Enlarge the time bar",
        "Show fewer frames on the time bar, around this one; the mouse wheel over it does the same",
        unless nothing_open, act |s, _| magnify_time(s, 2.0);
    TimeFarther: Time, Viewport, [alt(Key::ArrowDown)], "Reduce the time bar",
        "Show more frames on the time bar",
        unless no_span, act |s, _| magnify_time(s, 0.5);
    PreviousBookmark: Time, Viewport, [ctrl(Key::ArrowLeft)], "Previous bookmark",
        "Go to the bookmark before this frame",
        unless no_bookmarks, act |s, g| go_to_bookmark(s, g, -1);
    NextBookmark: Time, Viewport, [ctrl(Key::ArrowRight)], "Next bookmark",
        "Go to the bookmark after this frame",
        unless no_bookmarks, act |s, g| go_to_bookmark(s, g, 1);
    FocusPrompt: Prompts, Always, [key(Key::Slash), ctrl(Key::L)], "Type a prompt",
        "Go to the prompt box",
        unless no_prompts, act |s, _| s.prompt_box.wants_focus = true;
    Negatives: Prompts, Viewport, [key(Key::N)], "What prompts are compared with…",
        "The generic phrases that a prompt has to beat",
        unless nothing_open, act |s, _| s.dialog = Some(Dialog::Comparison);
    HideOverlays: Prompts, Always, [ctrl(Key::H)], "Hide all overlays",
        "Show or hide everything drawn over the picture",
        unless nothing_open, act |s, _| s.document.is_hidden ^= true;
    Peek: Prompts, Hold, [key(Key::X)], "Peek at the recorded frame (hold)",
        "The recorded frame without anything drawn over it, as long as the key is held",
        unless nothing_open, act |_, _| {};
    CycleStyle: Prompts, Viewport, [key(Key::O)], "Next overlay style",
        "Outline, fill or heatmap",
        unless nothing_open, act |s, _| s.document.next_style();
    MoreOpacity: Prompts, Viewport, [shift(Key::O)], "More opaque overlay",
        "Make the overlay more opaque by 0.2; starts again at 0.2",
        unless nothing_open, act |s, _| s.document.next_opacity();
    BelowInstruments: Prompts, Viewport, [alt(Key::O)], "Below instruments",
        "Draw what is found below the instruments, or over them",
        unless nothing_open, act |s, _| s.document.overlay.below_instruments ^= true;
    ThresholdDown: Prompts, Viewport, [key(Key::T)], "Lower threshold",
        "Lower the threshold of the selected prompt by 0.01: more is found",
        unless nothing_open, act |s, _| s.document.nudge_threshold(-THRESHOLD_STEP);
    ThresholdUp: Prompts, Viewport, [shift(Key::T)], "Raise threshold",
        "Raise the threshold of the selected prompt by 0.01: less is found",
        unless nothing_open, act |s, _| s.document.nudge_threshold(THRESHOLD_STEP);
    SwapOriginal: View, Viewport, [shift(Key::B)], "Recorded or reconstructed",
        "Switch between the recorded frame and the reconstruction",
        unless nothing_to_compare, act |s, _| switch(s, ViewMode::Reconstruction);
    SideBySide: View, Viewport, [shift(Key::W)], "Side by side",
        "The recorded frame beside the reconstruction",
        unless nothing_to_compare, act |s, _| switch(s, ViewMode::SideBySide);
    Wipe: View, Viewport, [key(Key::W)], "Wipe",
        "Drag a line between the recorded frame and the reconstruction",
        unless nothing_to_compare, act |s, _| switch(s, ViewMode::Wipe);
    Blink: View, Viewport, [key(Key::B)], "Blink",
        "The recorded frame and the reconstruction in turns",
        unless nothing_to_compare, act |s, _| switch(s, ViewMode::Blink);
    Difference: View, Viewport, [key(Key::F)], "Difference",
        "How much the reconstruction differs from the recorded frame",
        unless nothing_to_compare, act |s, _| switch(s, ViewMode::Difference);
    Depth: View, Viewport, [key(Key::D)], "Depth",
        "How far each point is from the endoscope",
        unless no_reconstruction, act |s, _| switch(s, ViewMode::Depth);
    DepthBeside: View, Viewport, [shift(Key::D)], "Beside its depth",
        "The reconstruction beside its depth",
        unless no_reconstruction, act |s, _| switch(s, ViewMode::DepthBeside);
    Motion: View, Viewport, [shift(Key::F)], "Moving",
        "How far each point moves over the recording",
        unless no_reconstruction, act |s, _| switch(s, ViewMode::Motion);
    Opacity: View, Viewport, [key(Key::A)], "Opacity",
        "How opaque the reconstruction is: where it is not, nothing was reconstructed",
        unless no_reconstruction, act |s, _| switch(s, ViewMode::Opacity);
    CentreOrbit: View, Viewport, [key(Key::C)], "Turn around this point",
        "Look around the point under the pointer, or the one whose scores are shown, from now on",
        unless no_reconstruction, act centre_orbit;
    Measure: View, Viewport, [key(Key::U)], "Ruler",
        "Measure on the picture: drag from one point to another",
        unless nothing_open, act |s, _| {
            s.viewport.has_ruler ^= true;
            s.put_away_marking();
        };
    Mark: View, Viewport, [key(Key::S)], "Mark by hand",
        "Mark a structure on a frame; it is then found on all of them",
        unless nothing_open, act |s, _| s.toggle_marking();
    LookHere: View, Viewport, [shift(Key::S)], "Look here",
        "Go where one more mark would help most",
        unless nowhere_to_look, act look_here;
    Dismiss: View, Viewport, [key(Key::Escape)], "Close what is open",
        "Close the message, the point's scores, the ruler or the tool for marking",
        unless never, act |s, _| dismiss(s);
    ResetView: View, Viewport, [key(Key::R)], "Back to the endoscope",
        "Back to the endoscope's own view, without zoom",
        unless nothing_open, act |s, _| s.document.reset_look();
    FullScreen: View, Always, [key(Key::F11)], "Full screen",
        "Fill the screen, or back to a window",
        unless never, act |_, g| full_screen(g.ctx);
    Larger: View, Always, [ctrl(Key::Plus), ctrl(Key::Equals)], "Larger text and buttons",
        "Make text and buttons larger, for a screen that is far away",
        unless never, act |s, _| s.preferences.scale_by(1);
    Smaller: View, Always, [ctrl(Key::Minus)], "Smaller text and buttons",
        "Make text and buttons smaller",
        unless never, act |s, _| s.preferences.scale_by(-1);
    NormalSize: View, Always, [ctrl(Key::Num0)], "Normal text and buttons",
        "Text and buttons at their normal size",
        unless never, act |s, _| s.preferences.scale_by(0);
    Shortcuts: Help, Always, [key(Key::F1)], "Keyboard shortcuts",
        "All keys on one sheet",
        unless never, act |s, _| s.dialog = Some(Dialog::Shortcuts);
    About: Help, Always, [], "About SurgTPGS",
        "Version, intended use and privacy",
        unless never, act |s, _| s.dialog = Some(Dialog::About);
    TogglePrompt: Prompts, Viewport, PLAIN_DIGITS, "Show or hide prompt 1–9",
        "Show or hide what this prompt found",
        unless nothing_open, act |s, g| s.document.toggle_visible(g.index);
    SoloPrompt: Prompts, Viewport, ALT_DIGITS, "Show only prompt 1–9",
        "Show only what this prompt found; again shows all",
        unless nothing_open, act |s, g| s.document.solo(g.index);
}

/// Returns `true` if a command opens a text field or a dialog, which has the keyboard from then on.
pub(crate) fn takes_keyboard(command: Command) -> bool {
    use Command as C;
    matches!(
        command,
        C::FocusPrompt
            | C::GoToFrame
            | C::Bookmarks
            | C::Phases
            | C::Negatives
            | C::Reconstruct
            | C::Export
            | C::Quality
            | C::Shortcuts
            | C::About
    )
}

/// Returns the row of a command.
pub(crate) fn entry(command: Command) -> &'static Entry {
    &COMMANDS[command as usize]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::viewer::state::document::OPACITY_STEP;

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
            assert_eq!(entry(a.command).label, a.label);
        }
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
    }
}
