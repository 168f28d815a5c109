//! Tests of single panels, without the window.

use super::*;
use crate::viewer::{
    action::Action,
    command::Command,
    panels::{go_to::GoToDialog, room::Room, timeline::timeline_ui},
};
use egui::Ui;
use std::cell::RefCell;

/// Shows a panel alone, acts on it, and returns what it asks for.
fn asked(
    shared: &Shared,
    mut panel: impl FnMut(&mut Ui, &Shared, &mut Vec<Action>),
    act: impl FnOnce(&mut Harness<'_>),
) -> Vec<Action> {
    let actions = RefCell::new(Vec::new());
    let mut harness = Harness::new_ui(|ui| panel(ui, shared, &mut actions.borrow_mut()));
    harness.step();
    act(&mut harness);
    drop(harness);
    actions.into_inner()
}

#[test]
fn the_time_bar_asks_for_its_commands_and_frames() {
    let window = Window::on(scene());
    let shared = &window.harness.state().shared;
    let show = |ui: &mut Ui, shared: &Shared, actions: &mut Vec<Action>| {
        timeline_ui(ui, shared, actions, Room::of(ui.ctx()));
    };
    let actions = asked(shared, show, |harness| {
        harness.get_by_label("Repeat").click();
        harness.step();
        harness.get_by_role_and_label(Role::Slider, "Frame").click();
        harness.step();
    });
    let is_asked = |action: &Action| !matches!(action, Action::Thumbnails(_));
    let actions: Vec<Action> = actions.into_iter().filter(is_asked).collect();
    let [Action::Run(Command::Loop), went @ ..] = &actions[..] else { panic!("{}", actions.len()) };
    assert!(!went.is_empty() && went.iter().all(|a| matches!(a, Action::GoTo(24))));
    assert!(shared.playback.is_looping(), "a panel changes nothing itself");
}

#[test]
fn words_that_are_not_understood_are_not_said_to_be_absent() {
    let mut window = Window::on(scene());
    window.type_prompt("Leber");
    let told = "These words are not known here: try another (English or Latin) word, or mark it by hand";
    window.until_shown(&format!("{told} – Enter keeps it"));
    window.press(Key::Enter);
    window.press(Key::Escape);
    window.until_found();
    assert!(window.shows(told) && !window.shows("ot in this recording"));
    let painted = painted(&window);
    assert!(painted.iter().any(|text| text == "Leber   words not known here"), "{painted:?}");
    assert!(!painted.iter().any(|text| text.contains("in this recording")), "{painted:?}");
}

#[test]
fn the_picture_gives_a_reason_only_where_it_is_that_of_all_prompts() {
    const NEUTRAL: &str = "Nothing was found on this frame";
    let mut window = Window::on(scene());
    let says = |window: &Window, words: &str| painted(window).iter().any(|text| text == words);
    ["banana", "spleen"].iter().for_each(|words| window.add_prompt(words));
    window.until_found();
    assert!(says(&window, "Not in this recording") && !says(&window, NEUTRAL));
    window.add_prompt("Leber");
    window.until_found();
    assert!(window.shows(NEUTRAL) && says(&window, NEUTRAL));
}

#[test]
fn the_export_says_what_nothing_will_be_written_for() {
    let mut window = Window::on(scene());
    ["gallbladder", "banana", "Leber", "spleen"].iter().for_each(|words| window.add_prompt(words));
    window.until_found();
    window.press_with(Modifiers::COMMAND, Key::E);
    window.harness.step();
    // 48 overlays, 48 masks
    assert!(window.shows("96 files will be written"));
    let absent = "\"banana\" (not in this recording), \"Leber\" (words not known here), \"spleen\" (not in";
    assert!(window.shows(&format!("Nothing will be written for {absent}")));
    window.press(Key::Escape);
    window.scroll_and_click("Show liver, dashed");
    window.until_picture(|p| p.request.prompts[3].question.shows_nearest && p.findings.len() == 4);
    window.press_with(Modifiers::COMMAND, Key::E);
    window.harness.step();
    assert!(window.shows("144 files will be written") && !window.shows("\"spleen\" (not"));
}

#[test]
fn a_frame_number_is_typed_and_gone_to() {
    let mut window = Window::on(scene());
    window.harness.state_mut().shared.dialog = Some(Dialog::GoToFrame);
    let mut dialog = GoToDialog::default();
    let show = |ui: &mut Ui, shared: &Shared, actions: &mut Vec<Action>| {
        dialog.ui(&ui.ctx().clone(), shared, actions);
    };
    let actions = asked(&window.harness.state().shared, show, |harness| {
        harness.get_by_label("Frame number").type_text("12");
        harness.step();
        harness.get_by_label("Go").click();
        harness.step();
        harness.step();
    });
    assert!(matches!(actions[..2], [Action::GoTo(11), Action::CloseDialog]));
}
