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
