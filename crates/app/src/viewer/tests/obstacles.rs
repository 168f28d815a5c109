//! Tests that what cannot be done now says why.

use super::{marking::without_features, *};
use crate::viewer::command::{COMMANDS, Command};
use surgtpgs_core::marks::Shape;

const NOT_YET: &str = "Reconstruct the recording first";

/// Gives a key, and returns the message that follows.
fn said(window: &mut Window, modifiers: Modifiers, key: Key) -> String {
    window.harness.state_mut().shared.toast = None;
    window.press_with(modifiers, key);
    // The message needs a step to find its size.
    window.harness.step();
    let text = window.harness.state().shared.toast.as_ref().map(|toast| toast.text.clone());
    let text = text.unwrap_or_default();
    assert!(window.shows(&text));
    text
}

#[test]
fn the_key_of_a_command_that_cannot_be_given_says_why() {
    let (none, ctrl, shift) = (Modifiers::NONE, Modifiers::COMMAND, Modifiers::SHIFT);
    let mut window = Window::on(bare());
    let need_it = [(ctrl, Key::E), (ctrl, Key::M), (none, Key::W), (shift, Key::S), (none, Key::P)];
    for (modifiers, key) in need_it {
        assert_eq!(said(&mut window, modifiers, key), NOT_YET, "{key:?}");
    }
    assert_eq!(said(&mut window, ctrl, Key::Z), "There is nothing to undo");
    let mut window = Window::on(scene());
    assert_eq!(said(&mut window, shift, Key::S), "Mark a structure first");
    assert_eq!(said(&mut window, none, Key::P), "Type what to find first");
    window.add_prompt("gallbladder");
    window.harness.state_mut().shared.document.toggle_excluded(0, 0);
    window.until_found();
    assert_eq!(said(&mut window, ctrl, Key::C), "This frame is left out of everything");
}

#[test]
fn the_start_page_says_it_too() {
    let mut window = Window::with(Arc::new(FakeBackend { info: scene(), ..Default::default() }));
    window.harness.state_mut().shared.preferences.is_acknowledged = true;
    (0..2).for_each(|_| window.harness.step());
    let why = said(&mut window, Modifiers::COMMAND, Key::E);
    assert_eq!(why, "Open a recording or a reconstruction first");
    window.harness.state_mut().shared.toast = None;
    window.press(Key::D);
    assert_eq!(window.harness.state().shared.toast, None, "a letter means nothing here");
}

#[test]
fn an_offer_to_take_something_back_stays() {
    let mut window = Window::on(scene());
    window.add_prompt("gallbladder");
    window.click("Delete gallbladder");
    window.press_with(Modifiers::SHIFT, Key::S);
    window.harness.step();
    assert!(window.shows("Deleted \"gallbladder\"") && window.shows("Undo"));
}

#[test]
fn what_runs_already_is_named() {
    let mut window = Window::on(bare());
    window.click("Reconstruct…");
    window.click("Start");
    window.until(|app| app.document.mode == ViewMode::SideBySide);
    let why = said(&mut window, Modifiers::COMMAND, Key::E);
    assert_eq!(why, "It is being reconstructed: wait, or stop that first");
    let mut window = Window::on(scene());
    window.backend.is_export_slow.store(true, Ordering::Relaxed);
    window.add_prompt("gallbladder");
    window.press_with(Modifiers::COMMAND, Key::E);
    window.harness.step();
    window.click("Start export");
    window.until(|app| app.is_exporting());
    assert_eq!(said(&mut window, Modifiers::COMMAND, Key::E), "Another export is running");
    window.backend.is_export_slow.store(false, Ordering::Relaxed);
    window.until(|app| !app.is_exporting());
}

#[test]
fn a_grey_button_says_why_when_it_is_pointed_at() {
    let mut window = Window::on(bare());
    assert!(!window.shows(NOT_YET));
    window.harness.get_by_label("Wipe").hover();
    (0..60).for_each(|_| window.harness.step());
    assert!(window.shows(NOT_YET));

    let mut window = Window::on(scene());
    window.add_prompt("nothing");
    window.until(|app| app.selected_curve().is_some_and(|curve| curve.is_complete()));
    window.harness.step();
    let first = window.harness.get_by_label("First");
    assert!(first.accesskit_node().is_disabled());
    assert_eq!(first.accesskit_node().description().as_deref(), Some("It is found on no frame"));
}

/// Marks a point of some frames, and waits until everything is counted. Returns why one cannot look where a
/// mark would help, before and after.
fn counted(window: &mut Window, name: &str, frames: std::ops::Range<usize>) -> [Option<&'static str>; 2] {
    let why = |window: &Window| window.harness.state().shared.obstacle(Command::LookHere);
    let shape = Shape::Click { point_px: [5.0, 5.0], radius_px: 1.0 };
    let marks = frames.map(|frame| Mark::new(frame, name, true, shape.clone())).collect();
    window.harness.state_mut().shared.document.add_marks(|_| "marking".into(), marks);
    let before = why(window);
    window.until(|app| app.selected_curve().is_some_and(|curve| curve.is_complete()));
    [before, why(window)]
}

#[test]
fn where_a_mark_would_help_is_not_counted_yet_or_nowhere() {
    const COUNTING: Option<&str> = Some("The areas are still being counted");
    let mut window = Window::on(scene());
    let known = Some("Nothing is unsure: all that is marked is a known class");
    assert_eq!(counted(&mut window, "liver", 0..1), [COUNTING, known]);
    assert_eq!(counted(&mut window, "tool", 1..2)[1], None, "this is no class");
    let mut window = Window::on(without_features());
    assert_eq!(counted(&mut window, "tool", 0..FRAMES), [COUNTING, Some("Every frame is marked already")]);
}

#[test]
fn obstacles_are_a_few_words() {
    for window in [Window::on(bare()), Window::on(scene()), Window::with(Arc::default())] {
        let shared = &window.harness.state().shared;
        for why in COMMANDS.iter().filter_map(|entry| shared.obstacle(entry.command)) {
            assert!(!why.is_empty() && why.len() < 70 && !why.ends_with('.'), "{why}");
        }
    }
}
