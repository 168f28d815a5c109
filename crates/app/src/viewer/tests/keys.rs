//! Tests of the keyboard: which keys move, which are typed, and how they are chosen.

use super::{pointing::drag, *};

#[test]
fn scrubbing_keys_move_exactly_and_the_picture_follows() {
    let mut window = Window::on(scene());
    window.press(Key::ArrowRight);
    assert_eq!(window.frame(), 1);
    window.press_with(Modifiers::SHIFT, Key::ArrowRight);
    assert_eq!(window.frame(), 11);
    window.press(Key::ArrowLeft);
    assert_eq!(window.frame(), 10);
    window.until_picture(|p| p.request.view.frame == 10);
    window.press(Key::End);
    assert_eq!(window.frame(), FRAMES - 1);
    window.press(Key::Home);
    assert_eq!(window.frame(), 0);
}

#[test]
fn space_plays_at_the_recordings_speed() {
    let mut window = Window::on(scene());
    window.press(Key::Space);
    assert!(window.harness.state().shared.playback.is_playing());
    let began = window.harness.ctx.input(|i| i.time);
    for _ in 0..30 {
        window.harness.step();
    }
    let elapsed = window.harness.ctx.input(|i| i.time) - began;
    let due = (elapsed * 25.0) as isize;
    assert!((window.frame() as isize - due % FRAMES as isize).abs() <= 1, "{} of {due}", window.frame());
    window.press(Key::Space);
    assert!(!window.harness.state().shared.playback.is_playing());
}

#[test]
fn a_frame_number_can_be_typed_and_the_keys_return_to_the_picture() {
    let mut window = Window::on(scene());
    window.press(Key::G);
    window.harness.step();
    window.harness.get_by_label("Frame number").type_text("13");
    window.harness.step();
    window.press(Key::Enter);
    window.harness.step();
    assert_eq!(window.frame(), 12);
    window.press(Key::ArrowRight);
    assert_eq!(window.frame(), 13);
}

#[test]
fn a_focused_text_field_owns_letters_digits_arrows_and_space() {
    let mut window = Window::on(scene());
    window.type_prompt("v");
    for key in [Key::B, Key::Space, Key::ArrowRight, Key::End, Key::Num1, Key::O, Key::D] {
        window.press(key);
    }
    let app = &window.harness.state().shared;
    assert!(!app.document.is_hidden && !app.playback.is_playing());
    assert_eq!((app.playback.frame(), app.document.mode), (0, ViewMode::Reconstruction));
    window.press(Key::Escape);
    window.harness.step();
    assert_eq!(window.harness.state().shared.prompt_box.text, "v", "Esc leaves the field and nothing else");
    window.press(Key::D);
    assert_eq!(window.harness.state().shared.document.mode, ViewMode::Depth);
}

#[test]
fn the_slash_that_opens_the_prompt_box_is_not_typed_into_it() {
    let mut window = Window::on(scene());
    window.type_at_once("/");
    assert!(window.harness.get_by_label("Prompt").is_focused());
    assert_eq!(window.harness.state().shared.prompt_box.text, "");
}

#[test]
fn what_is_typed_fast_is_never_half_command_half_text() {
    let mut window = Window::on(scene());
    let state = |window: &Window| {
        let app = &window.harness.state().shared;
        (app.document.mode, app.playback.frame(), app.playback.is_playing(), app.document.content().range)
    };
    let before = state(&window);
    window.type_at_once("/fat\nliver\ngallbladder vein");
    let words: Vec<_> =
        window.harness.state().shared.document.prompts().iter().map(|p| p.text.clone()).collect();
    assert_eq!(words, ["fat", "liver"]);
    assert_eq!(window.harness.state().shared.prompt_box.text, "gallbladder vein");
    assert!(
        window.harness.get_by_label("Prompt").is_focused(),
        "Enter keeps the box ready for the next word"
    );
    assert_eq!(state(&window), before);
    assert!(window.harness.state().shared.document.excluded().is_empty());

    // A click into the box and a word may come in one batch on a slow machine.
    let mut window = Window::on(scene());
    let pos = window.harness.get_by_label("Prompt").rect().center();
    let (button, modifiers) = (egui::PointerButton::Primary, Modifiers::NONE);
    let click = [true, false].map(|pressed| egui::Event::PointerButton { pos, button, pressed, modifiers });
    let events = &mut window.harness.input_mut().events;
    events.push(egui::Event::PointerMoved(pos));
    events.extend(click);
    window.type_at_once("fat\n");
    assert_eq!(window.harness.state().shared.document.prompts()[0].text, "fat");
    assert_eq!(state(&window), before);

    // The number of a frame, too, is typed behind the key that asks for it.
    let mut window = Window::on(scene());
    window.type_at_once("g12\n");
    assert_eq!((window.frame(), window.harness.state().shared.dialog), (11, None));

    // Where nothing can be asked, nobody takes the word, and it is no row of commands either.
    let mut window = Window::on(Info { has_features: false, ..scene() });
    window.type_at_once("/fad");
    assert_eq!(state(&window), before);
}

#[test]
fn the_name_of_what_is_marked_is_typed_at_once_wherever_the_panel_stands() {
    const FIELD: &str = "Name of what is marked";
    let mut window = Window::on(scene());
    let words = ["gallbladder", "liver", "fat", "polyp", "vein", "clip", "hook", "gauze"];
    words.into_iter().for_each(|words| window.add_prompt(words));
    window.harness.get_by_label("Delete gauze").scroll_to_me();
    (0..60).for_each(|_| window.harness.step());
    let rect = |window: &Window, label: &str| window.harness.get_by_label(label).rect();
    let top = rect(&window, "Prompt").bottom();
    assert!(rect(&window, "Mark by hand").bottom() < top, "the panel is scrolled down");
    let state = |window: &Window| {
        let app = &window.harness.state().shared;
        (app.document.mode, app.playback.frame(), app.playback.is_playing(), app.document.content().range)
    };
    let before = state(&window);
    window.press(Key::S);
    (0..60).for_each(|_| window.harness.step());
    assert!(rect(&window, FIELD).top() >= top && window.harness.get_by_label(FIELD).is_focused());
    assert_eq!(window.harness.get_by_label(FIELD).value().as_deref(), Some("gauze"));
    window.type_at_once("bile");
    assert_eq!(window.harness.state().shared.viewport.marking.name, "bile", "it takes the other's place");
    assert_eq!(state(&window), before);

    // Enter gives the keys back, and so does a stroke.
    window.press(Key::Enter);
    window.press(Key::ArrowRight);
    window.until_picture(|p| p.request.view.frame == 1);
    let names = |window: &Window| -> Vec<String> {
        window.harness.state().shared.document.marks().all().iter().map(|mark| mark.name.clone()).collect()
    };
    for _ in 0..2 {
        drag(&mut window, [0.3, 0.5], [0.6, 0.5]);
        assert_eq!(names(&window), ["bile"]);
        window.press_with(Modifiers::COMMAND, Key::Z);
        assert!(names(&window).is_empty());
        window.press(Key::S);
        window.press(Key::S);
        assert!(!window.harness.get_by_label(FIELD).is_focused(), "the name is kept");
        window.harness.get_by_label(FIELD).focus();
        window.harness.step();
        assert!(window.harness.get_by_label(FIELD).is_focused());
    }
}

#[test]
fn no_key_types_over_a_name_that_the_tool_keeps() {
    let mut window = Window::on(scene());
    window.type_at_once("sduct\n");
    (0..2).for_each(|_| window.press(Key::S));
    let marking = |window: &Window| window.harness.state().shared.viewport.marking.clone();
    for keys in ["x", " ", "d"] {
        window.type_at_once(keys);
        assert_eq!(marking(&window).name, "duct", "{keys:?}");
    }
    window.press_with(Modifiers::COMMAND, Key::Z);
    window.press(Key::End);
    assert_eq!((marking(&window).name.as_str(), window.frame()), ("duct", FRAMES - 1));
    assert_eq!(window.harness.state().shared.document.mode, ViewMode::Depth);
    window.type_at_once("s");
    assert!(!marking(&window).is_on && marking(&window).name == "duct");
}

#[test]
fn undoing_in_the_field_of_a_name_brings_no_name_of_another_mark_back() {
    let mut window = Window::on(scene());
    window.type_at_once("sduct\n");
    window.press(Key::S);
    window.add_prompt("gallbladder");
    window.press(Key::S);
    (0..3).for_each(|_| window.harness.step());
    assert!(window.harness.get_by_label("Name of what is marked").is_focused());
    window.press_with(Modifiers::COMMAND, Key::Z);
    window.harness.step();
    assert_eq!(window.harness.state().shared.viewport.marking.name, "gallbladder");
}

#[test]
fn a_name_typed_fast_behind_the_key_of_the_tool_is_no_row_of_commands() {
    let mut window = Window::on(scene());
    window.add_prompt("gallbladder");
    let marking = |window: &Window| window.harness.state().shared.viewport.marking.clone();
    let mode = |window: &Window| window.harness.state().shared.document.mode;
    window.type_at_once("sduct\n");
    assert!(marking(&window).is_on && marking(&window).name == "duct");
    assert_eq!(mode(&window), ViewMode::Reconstruction);
    window.type_at_once("sd");
    assert!(!marking(&window).is_on, "the same key puts it away");
    assert_eq!(mode(&window), ViewMode::Depth, "and the next one is a command");
    window.add_prompt("liver");
    window.press(Key::S);
    for is_on in [true, false] {
        window.press(Key::Escape);
        assert_eq!(marking(&window).is_on, is_on, "Esc leaves the field first");
    }
}

#[test]
fn arrows_move_through_time_while_the_prompt_box_is_empty() {
    let mut window = Window::on(scene());
    window.type_prompt("liver");
    window.press(Key::ArrowRight);
    assert_eq!(window.frame(), 0, "the cursor moves");
    window.press(Key::Enter);
    window.harness.step();
    window.press(Key::ArrowRight);
    assert_eq!(window.frame(), 1);
    assert!(window.harness.get_by_label("Prompt").is_focused());
}

#[test]
fn no_single_letter_loses_or_hides_work() {
    let mut window = Window::on(scene());
    window.add_prompt("gallbladder");
    window.press(Key::M);
    window.harness.state_mut().shared.document.set_note(0, "bleeding");
    let before = window.harness.state().shared.document.content().clone();
    for key in Key::ALL.iter().filter(|key| key.name().len() == 1 && key.name() >= "A") {
        for modifiers in [Modifiers::NONE, Modifiers::SHIFT] {
            window.press_with(modifiers, *key);
            window.press(Key::Escape);
            window.harness.step();
            let app = &mut window.harness.state_mut().shared;
            assert!(app.document.excluded().is_empty() && !app.document.is_hidden, "{key:?}");
            assert_eq!(app.document.bookmarks(), &before.bookmarks[..], "{key:?}");
            assert_eq!(app.document.prompts().len(), 1, "{key:?}");
            assert!(app.document.prompts()[0].is_visible, "{key:?}");
            (app.dialog, app.problem) = (None, None);
        }
    }
}

#[test]
fn every_command_that_takes_the_keyboard_is_known_to_take_it() {
    use crate::viewer::command::{COMMANDS, Command, takes_keyboard};
    let mut window = Window::on(Info { recording: Some("/data/r".into()), ..scene() });
    let ctx = window.harness.ctx.clone();
    let app = &mut window.harness.state_mut().shared;
    let is_tried = |command| !monkey::DIALOGS.contains(&command) && command != Command::StartPage;
    let mut num_taking = 0;
    for command in COMMANDS.iter().map(|e| e.command).filter(|c| is_tried(*c)) {
        (app.dialog, app.prompt_box.wants_focus) = (None, false);
        app.run(command.into(), &ctx);
        let takes = app.dialog.is_some() || app.prompt_box.wants_focus;
        assert_eq!(takes, takes_keyboard(command), "{command:?}");
        num_taking += usize::from(takes);
    }
    assert_eq!(num_taking, 10);
}

#[test]
fn the_shortcut_sheet_lists_the_command_table() {
    let mut window = Window::on(scene());
    window.press(Key::F1);
    window.harness.step();
    for entry in crate::viewer::command::COMMANDS.iter().filter(|e| !e.keys.is_empty()) {
        assert!(window.shows(entry.label.trim_end_matches('…')), "{}", entry.label);
    }
    window.press(Key::Escape);
    window.harness.step();
    assert!(window.harness.state().shared.dialog.is_none());
}

#[test]
fn keys_can_be_chosen_and_the_sheet_shows_them() {
    let mut window = Window::on(scene());
    window.press(Key::F1);
    // The sheet needs a few steps to find its size.
    (0..4).for_each(|_| window.harness.step());
    window.click("Key of Play or pause");
    assert!(window.shows("Press the new key for \"Play or pause\""));
    window.press(Key::D);
    window.harness.step();
    assert!(
        window.harness.state().shared.dialog == Some(Dialog::Shortcuts)
            && window.harness.state().shared.document.mode == ViewMode::Reconstruction
    );
    assert_eq!(window.harness.state().shared.preferences.keys["PlayPause"], "D");
    window.click("Key of Depth");
    window.press(Key::Escape);
    window.harness.step();
    assert!(
        window.harness.state().shared.dialog == Some(Dialog::Shortcuts) && !window.shows("Press the new key")
    );
    window.click("Close");
    window.press(Key::D);
    let app = &window.harness.state().shared;
    assert!(app.playback.is_playing() && app.document.mode != ViewMode::Depth, "the key is the other's now");
    window.press(Key::Space);
    assert!(window.harness.state().shared.playback.is_playing());
    window.press(Key::F1);
    (0..4).for_each(|_| window.harness.step());
    window.click("Usual keys again");
    window.click("Close");
    window.press(Key::Space);
    assert!(!window.harness.state().shared.playback.is_playing());
    window.press(Key::D);
    assert_eq!(window.harness.state().shared.document.mode, ViewMode::Depth);
}
