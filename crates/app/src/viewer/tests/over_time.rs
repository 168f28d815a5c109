//! Tests of areas over time, and of the ways to move through them.

use super::*;
use crate::viewer::{command::Command, state::phases::Phase};

/// Opens a window with one prompt that is found on frames 10 to 20, most of it on frame 15.
fn counted() -> Window {
    let mut window = Window::on(scene());
    window.add_prompt("polyp");
    window.until(|app| app.selected_curve().is_some_and(|curve| curve.is_complete()));
    window
}

#[test]
fn the_curve_is_counted_while_idle_and_leads_to_first_largest_and_last() {
    let mut window = counted();
    assert!(window.shows("Area over time. polyp: largest on frame 16, 38 % of the picture"));
    assert!(window.shows("Found on 11 of 48 frames"));
    window.press_with(Modifiers::SHIFT, Key::Home);
    assert_eq!(window.frame(), 10);
    window.press_with(Modifiers::SHIFT, Key::End);
    assert_eq!(window.frame(), 20);
    window.press(Key::P);
    assert_eq!(window.frame(), 15);
    window.click("First");
    assert_eq!(window.frame(), 10);
}

#[test]
fn the_curve_is_that_of_the_picture_on_every_frame_and_follows_the_threshold() {
    let mut window = counted();
    for threshold in [0.4, 0.9] {
        let id = window.harness.state().shared.document.selected.unwrap();
        window.harness.state_mut().shared.document.set_threshold(id, threshold);
        for frame in [9, 10, 15, 21] {
            window.harness.state_mut().shared.playback.seek(frame, 0.0);
            window.until_picture(|p| {
                p.request.view.frame == frame && p.request.prompts[0].threshold == threshold
            });
            let app = &window.harness.state().shared;
            let on_picture = app.picture().unwrap().findings[0].outcome.as_ref().unwrap().area_px;
            let on_curve = app.selected_curve().unwrap().points[frame].unwrap().area_px;
            assert_eq!(on_curve, on_picture, "frame {frame} above {threshold}");
        }
    }
}

#[test]
fn a_click_on_the_curve_goes_there() {
    let mut window = counted();
    window.harness.get_by_label_contains("Area over time").click();
    window.harness.step();
    window.harness.step();
    assert!((22..=25).contains(&window.frame()), "the middle of {FRAMES} frames, not {}", window.frame());
}

#[test]
fn a_prompt_that_is_nowhere_leads_nowhere() {
    let mut window = Window::on(scene());
    window.add_prompt("nothing");
    window.until(|app| app.selected_curve().is_some_and(|curve| curve.is_complete()));
    assert!(window.shows("nothing: found on no frame"));
    let leads = |command| window.harness.state().shared.is_enabled(command);
    assert!([Command::FirstFound, Command::LargestFound, Command::LastFound].map(leads) == [false; 3]);
    assert!(leads(Command::CopyAreas));
    window.press(Key::ArrowRight);
    window.press(Key::P);
    assert_eq!(window.frame(), 1);
}

#[test]
fn areas_can_be_copied_as_a_table() {
    let mut window = counted();
    let ctx = window.harness.ctx.clone();
    window.harness.state_mut().shared.run(Command::CopyAreas.into(), &ctx);
    let copied = ctx.output(|o| o.commands.clone()).into_iter().find_map(|c| match c {
        egui::OutputCommand::CopyText(text) => Some(text),
        _ => None,
    });
    let table = copied.unwrap();
    assert_eq!(table.lines().count(), FRAMES + 1);
    assert!(table.contains("16,0.600,\"polyp\",0.50,288,0.375000"), "{table}");
    let said = window.harness.state().shared.toast.as_ref().map(|toast| toast.text.clone());
    assert_eq!(said.as_deref(), Some("A table of 48 rows is copied"));
}

#[test]
fn a_table_that_would_lack_rows_is_not_copied() {
    let (permit, gate) = mpsc::channel();
    // Without a permission, nothing is counted.
    let mut window = Window::gated(scene(), Some(gate));
    window.until(|app| app.picture().is_some());
    window.add_prompt("polyp");
    let why = |window: &Window| window.harness.state().shared.obstacle(Command::CopyAreas);
    assert_eq!(why(&window), Some("The areas are still being counted"));
    window.harness.state_mut().shared.document.toggle_visible(0);
    assert_eq!(why(&window), Some("No prompt is shown"));
    drop(permit);
}

#[test]
fn a_prompt_that_cannot_be_looked_for_says_so_and_keeps_no_other_from_being_copied() {
    let mut window = counted();
    window.add_prompt("broken");
    window.until(|app| app.selected_curve().is_some_and(|curve| curve.is_complete()));
    let why = |window: &Window, command| window.harness.state().shared.obstacle(command);
    for command in [Command::FirstFound, Command::LargestFound, Command::LastFound] {
        assert_eq!(why(&window, command), Some("It cannot be looked for"));
    }
    assert!(window.shows("broken: cannot be looked for") && !window.shows("ounting…"));
    assert_eq!(why(&window, Command::CopyAreas), None);
    let ctx = window.harness.ctx.clone();
    window.harness.state_mut().shared.run(Command::CopyAreas.into(), &ctx);
    assert!(window.harness.state().shared.toast.as_ref().unwrap().text.contains("48 rows"));
    window.harness.state_mut().shared.document.toggle_visible(0);
    assert_eq!(why(&window, Command::CopyAreas), Some("No shown prompt can be looked for"));
    window.harness.state_mut().shared.document.toggle_visible(1);
    assert_eq!(why(&window, Command::CopyAreas), Some("No prompt is shown"));
}

#[test]
fn frames_that_are_left_out_are_neither_gone_to_nor_counted() {
    let mut window = counted();
    let document = &mut window.harness.state_mut().shared.document;
    [(10, 10), (14, 16), (20, 20)].into_iter().for_each(|(from, to)| document.toggle_excluded(from, to));
    for (modifiers, key, frame) in
        [(Modifiers::NONE, Key::P, 13), (Modifiers::SHIFT, Key::Home, 11), (Modifiers::SHIFT, Key::End, 19)]
    {
        window.press_with(modifiers, key);
        assert_eq!(window.frame(), frame);
    }
    window.harness.step();
    assert!(window.shows("Found on 6 of 43 frames"));
    assert!(window.shows("Area over time. polyp: largest on frame 14, 25 % of the picture"));
    let ctx = window.harness.ctx.clone();
    window.harness.state_mut().shared.run(Command::CopyAreas.into(), &ctx);
    assert!(window.harness.state().shared.toast.as_ref().unwrap().text.contains("43 rows"));
}

#[test]
fn frames_that_no_part_reconstructs_are_told_and_not_counted() {
    let mut window = Window::on(Info { unlearned: vec![0..3, 12..40], ..scene() });
    window.add_prompt("polyp");
    window.until_found();
    let missing = "This part is not reconstructed";
    assert!(window.harness.query_all_by_label(missing).count() >= 2, "in the row and on the picture");
    assert!(!window.shows(NOTHING));
    window.until(|app| app.selected_curve().is_some_and(|curve| curve.is_complete()));
    // Frames 11 and 12 of those from 11 to 21 where it is.
    assert!(window.shows("Found on 2 of 17 frames"));
    let ctx = window.harness.ctx.clone();
    window.harness.state_mut().shared.run(Command::CopyAreas.into(), &ctx);
    assert!(window.harness.state().shared.toast.as_ref().unwrap().text.contains("17 rows"));
    window.press_with(Modifiers::SHIFT, Key::Home);
    window.until_picture(|p| p.request.view.frame == 10 && !p.findings.is_empty());
    assert!(!window.shows(missing));
}

#[test]
fn a_scene_in_training_is_not_counted() {
    let recording = Info { has_reconstruction: false, has_features: false, has_labels: true, ..scene() };
    let mut window = Window::on(recording);
    window.click("Reconstruct…");
    window.click("Start");
    window.until(|app| app.document.mode == ViewMode::SideBySide);
    assert!(window.harness.state().shared.areas().is_none());
}

#[test]
fn with_the_stop_key_held_j_and_l_are_single_steps() {
    let mut window = Window::on(scene());
    window.harness.key_down(Key::K);
    window.harness.step();
    for expected in [1, 2] {
        window.press(Key::L);
        assert_eq!(window.frame(), expected);
    }
    window.press(Key::J);
    assert_eq!(window.frame(), 1);
    window.harness.key_up(Key::K);
    window.harness.step();
    assert!(!window.harness.state().shared.playback.is_playing());
    window.press(Key::L);
    assert!(window.harness.state().shared.playback.is_playing());
}

/// Plays, and lets the clock run ahead of the pictures, as on a slow machine.
fn lagging() -> Window {
    let mut window = Window::on(scene());
    window.press(Key::Space);
    let now = window.harness.ctx.input(|i| i.time);
    window.harness.state_mut().shared.playback.seek(40, now);
    window
}

#[test]
fn what_stops_or_marks_a_frame_goes_by_the_picture_that_is_seen() {
    for (key, by) in [(Key::Space, 0), (Key::K, 0), (Key::ArrowRight, 1)] {
        let mut window = lagging();
        window.press(key);
        assert!(!window.harness.state().shared.playback.is_playing(), "{key:?}");
        assert!((by..by + 4).contains(&window.frame()), "{key:?} stops on frame {}", window.frame());
    }
    let mut window = lagging();
    window.press(Key::M);
    let app = &window.harness.state().shared;
    assert!(app.playback.is_playing() && app.document.bookmarks()[0].frame < 4);
    let mut window = lagging();
    window.press(Key::I);
    let range = window.harness.state().shared.document.content().range;
    assert!(range.is_some_and(|(first, last)| first < 4 && last == FRAMES - 1), "{range:?}");
}

/// Opens a window whose first picture stays: the next one is not finished as long as the sender is kept.
pub(super) fn stuck() -> (mpsc::Sender<()>, Window) {
    let (permit, gate) = mpsc::channel();
    let mut window = Window::gated(scene(), Some(gate));
    window.until(|app| app.picture().is_some());
    window.harness.state_mut().shared.document.mode = ViewMode::Reconstruction;
    window.until_picture(|p| p.reconstruction.is_some());
    window.add_prompt("gallbladder");
    (permit, window)
}

/// Plays for most of a second.
fn play_on(window: &mut Window) {
    window.press(Key::Space);
    (0..50).for_each(|_| window.harness.step());
    assert!(window.harness.state().shared.playback.is_playing());
}

#[test]
fn a_frame_that_was_asked_for_counts_before_its_picture_is_there() {
    let (_permit, mut window) = stuck();
    play_on(&mut window);
    window.press(Key::End);
    (0..20).for_each(|_| window.harness.step());
    assert!(window.frame() < FRAMES - 1, "it plays on");
    window.press(Key::M);
    window.press(Key::Space);
    assert_eq!(window.frame(), FRAMES - 1);
    let app = &window.harness.state().shared;
    assert!(!app.playback.is_playing() && app.document.bookmarks()[0].frame == FRAMES - 1);
    window.type_at_once("g12\n");
    play_on(&mut window);
    window.press(Key::K);
    assert_eq!(window.frame(), 11);
    window.press(Key::ArrowRight);
    play_on(&mut window);
    window.press(Key::Space);
    assert_eq!(window.frame(), 12);
    assert_eq!(window.harness.state().shared.picture().unwrap().request.view.frame, 0);
}

#[test]
fn bookmarks_are_gone_to_and_phases_begun_from_the_picture_that_is_seen() {
    let (_permit, mut window) = stuck();
    play_on(&mut window);
    assert!(window.frame() > 10);
    window.harness.state_mut().shared.document.toggle_bookmark(10);
    window.press_with(Modifiers::COMMAND, Key::ArrowRight);
    assert_eq!(window.frame(), 10, "the one behind the picture, not the clock");
    let (_permit, mut window) = stuck();
    play_on(&mut window);
    window.press_with(Modifiers::SHIFT, Key::P);
    (0..2).for_each(|_| window.harness.step());
    assert!(window.shows("A new phase is of frames 1 to 48"));
}

#[test]
fn every_key_of_the_map_is_a_command() {
    use crate::viewer::{command::keys::find, state::preferences::Keymap};
    let (none, shift, alt) = (Modifiers::NONE, Modifiers::SHIFT, Modifiers::ALT);
    let ctrl = Modifiers::COMMAND;
    for (modifiers, keys) in [
        (none, "Space Left Right Home End J K L [ ] \\ I M G / 1 9 O T W B D R C F1 F11"),
        (shift, "Left Right I O T"),
        (ctrl, "Left Right Z Y O S E L H"),
        (alt, "I 1 9"),
        (ctrl | shift, "Z E M"),
    ] {
        for name in keys.split(' ') {
            let key = Key::from_name(name).unwrap();
            assert!(find(key, modifiers, &Keymap::new()).is_some(), "{modifiers:?} {name}");
        }
    }
    assert!(find(Key::Tab, none, &Keymap::new()).is_none(), "Tab moves the focus");
}

#[test]
fn excluded_frames_are_not_shown_not_exported_and_not_learned_from() {
    let mut window = Window::on(scene());
    window.add_prompt("gallbladder");
    window.until_found();
    window.press(Key::I);
    window.press(Key::ArrowRight);
    window.press_with(Modifiers::SHIFT, Key::I);
    window.press_with(Modifiers::COMMAND | Modifiers::SHIFT, Key::E);
    window.until_picture(|p| p.request.view.frame == 1);
    assert_eq!(window.harness.state().shared.document.excluded(), [(0, 1)]);
    assert!(window.shows("This frame is left out of everything"));
    assert_eq!(window.harness.state().shared.viewport.panes.0.len(), 0, "nothing of it is seen");
    window.press_with(Modifiers::ALT, Key::I);
    window.press(Key::Space);
    window.harness.step();
    assert!(window.frame() >= 2, "playing goes on behind it");
    window.press(Key::Space);
    window.until_picture(|p| p.request.view.frame >= 2);
    assert!(!window.shows("This frame is left out of everything"));
    window.press_with(Modifiers::COMMAND, Key::E);
    window.harness.step();
    // 46 overlays, 46 masks
    assert!(window.shows("92 files will be written"));
    window.click("Start export");
    let backend = window.backend.clone();
    window.until(|_| !backend.exported.lock().unwrap().is_empty());
    assert_eq!(backend.exported.lock().unwrap()[0].0.frames, (2..FRAMES).collect::<Vec<_>>());
    let session = window.harness.state().shared.session().unwrap();
    assert!(serde_json::to_string(&session).unwrap().contains("\"excluded\":[[0,1]]"));
}

#[test]
fn frames_that_are_not_reconstructed_yet_are_no_files() {
    let mut window = Window::on(Info { learned: 0.4, unlearned: vec![0..3, 8..9], ..scene() });
    window.add_prompt("gallbladder");
    window.until_found();
    window.press_with(Modifiers::COMMAND, Key::E);
    window.harness.step();
    // 44 overlays, 44 masks
    assert!(window.shows("88 files will be written"));
    assert!(window.shows("Frames that are not reconstructed yet are left out: 4"));
}

#[test]
fn nothing_is_learned_from_excluded_frames() {
    let recording = Info { has_reconstruction: false, has_features: false, has_labels: true, ..scene() };
    let mut window = Window::on(recording);
    window.press_with(Modifiers::COMMAND | Modifiers::SHIFT, Key::E);
    window.click("Reconstruct…");
    window.click("Start");
    // The button moves while the panel grows.
    window.until(|app| app.reconstruction.training.is_some());
    window.harness.state().shared.reconstruction.training.as_ref().unwrap().task.cancel();
    window.until(|app| app.reconstruction.training.is_none());
    assert_eq!(window.backend.trained.lock().unwrap()[0].excluded, [(0, 0)]);
}

#[test]
fn playing_never_sticks_on_a_range_that_is_left_out() {
    let mut window = Window::on(scene());
    window.press_with(Modifiers::SHIFT, Key::ArrowRight);
    window.press(Key::I);
    window.press(Key::ArrowRight);
    window.press_with(Modifiers::SHIFT, Key::I);
    window.press_with(Modifiers::COMMAND | Modifiers::SHIFT, Key::E);
    assert_eq!(window.harness.state().shared.document.excluded(), [(10, 11)]);
    window.press(Key::Space);
    let mut shown = std::collections::BTreeSet::new();
    for _ in 0..200 {
        window.harness.step();
        shown.insert(window.frame());
    }
    assert!(shown.len() > 30 && !shown.contains(&10) && !shown.contains(&11), "{shown:?}");
}

#[test]
fn small_pictures_along_the_bar_come_while_nothing_else_is_to_be_done() {
    let mut window = Window::on(scene());
    window.until(|app| {
        let open = app.open.as_ref().unwrap();
        !open.wanted.is_empty() && open.thumbnails.missing(&open.wanted).is_empty()
    });
    let frames = window.harness.state().shared.open.as_ref().unwrap().wanted.clone();
    assert!(frames.len() > 10 && frames.is_sorted() && frames[frames.len() - 1] > 40, "{frames:?}");
    let window = Window::on(Info { has_original: false, ..scene() });
    assert!(window.harness.state().shared.open.as_ref().unwrap().wanted.is_empty());
}

#[test]
fn the_time_bar_is_enlarged_around_the_present_frame_and_follows_it() {
    let mut window = Window::on(scene());
    window.harness.state_mut().shared.playback.seek(24, 0.0);
    (0..2).for_each(|_| window.press_with(Modifiers::ALT, Key::ArrowUp));
    let (first, last) = window.harness.state().shared.viewport.span.unwrap();
    assert!((last - first - 47.0 / 4.0).abs() < 0.01 && first < 24.0 && last > 24.0, "{first} to {last}");
    window.harness.get_by_role_and_label(Role::Slider, "Frame").click();
    (0..3).for_each(|_| window.harness.step());
    assert!((23..=25).contains(&window.frame()), "the middle of what is shown, not {}", window.frame());
    window.press(Key::End);
    (0..3).for_each(|_| window.harness.step());
    let (_, last) = window.harness.state().shared.viewport.span.unwrap();
    assert_eq!(last, 47.0, "what is shown is seen");
    (0..2).for_each(|_| window.press_with(Modifiers::ALT, Key::ArrowDown));
    assert_eq!(window.harness.state().shared.viewport.span, None);
}

#[test]
fn phases_are_named_kept_with_the_session_and_read_back() {
    let folder = tempfile::tempdir().unwrap();
    let mut window = Window::on(Info { output_folder: folder.path().to_owned(), ..scene() });
    window.press(Key::I);
    window.harness.state_mut().shared.document.set_range(Some((3, 12)));
    window.harness.step();
    window.press_with(Modifiers::SHIFT, Key::P);
    window.harness.step();
    window.type_into("Name of the phase", "Preparation");
    window.click("Add");
    let phases = |window: &Window| -> Vec<(String, usize, usize)> {
        let phases = window.harness.state().shared.document.phases();
        phases.iter().map(|p| (p.name.clone(), p.first, p.last)).collect()
    };
    let expected = vec![("Preparation".to_owned(), 3, 12)];
    assert_eq!(phases(&window), expected);
    window.click("Save as Cholec80");
    window.click("Save as table");
    assert!(window.shows("Saved as"));
    window.click("Save as table");
    assert!(window.shows("is there already"), "nothing is written over");
    let written = std::fs::read_to_string(folder.path().join("clip-phases.txt")).unwrap();
    assert!(written.starts_with("Frame\tPhase\n3\tPreparation\n"));
    window.harness.state_mut().shared.document.remove_phase(0);
    window.click("Read");
    assert_eq!(phases(&window), expected, "from the table");
    window.harness.state_mut().shared.document.undo();
    assert!(phases(&window).is_empty());
    window.harness.state_mut().shared.document.redo();
    window.click("Close");
    assert!(window.shows("Phases. Preparation: frames 4 to 13"));
    let session = window.harness.state().shared.session().unwrap();
    let text = serde_json::to_string(&session).unwrap();
    assert!(text.contains(r#""phases":[{"name":"Preparation","first":3,"last":12}]"#), "{text}");
}

#[test]
fn the_name_of_a_phase_is_typed_at_once() {
    let mut window = Window::on(scene());
    window.press_with(Modifiers::SHIFT, Key::P);
    (0..3).for_each(|_| window.harness.step());
    assert!(window.harness.get_by_label("Name of the phase").is_focused());
    window.harness.event(egui::Event::Text("Preparation".into()));
    window.harness.step();
    window.press(Key::Enter);
    let phases = window.harness.state().shared.document.phases();
    assert_eq!(phases.iter().map(|p| p.name.as_str()).collect::<Vec<_>>(), ["Preparation"]);
}

#[test]
fn a_half_typed_frame_of_a_phase_takes_nothing_from_its_neighbours() {
    let mut window = Window::on(scene());
    let document = &mut window.harness.state_mut().shared.document;
    document.add_phase(Phase::new("Preparation", 0, 9));
    document.add_phase(Phase::new("Dissection", 10, 23));
    let phases = |window: &Window| -> Vec<(usize, usize)> {
        window.harness.state().shared.document.phases().iter().map(|p| (p.first, p.last)).collect()
    };
    window.press_with(Modifiers::SHIFT, Key::P);
    window.harness.step();
    for (typed, expected) in [("15", 14), ("1", 10)] {
        window.harness.get_by_label("First frame of phase 2").focus();
        (0..2).for_each(|_| window.harness.step());
        window.press_with(Modifiers::COMMAND, Key::A);
        for letter in typed.chars() {
            window.harness.event(egui::Event::Text(letter.into()));
            window.harness.step();
            assert_eq!(phases(&window)[0], (0, 9), "after {letter}");
        }
        window.press(Key::Enter);
        window.harness.step();
        assert_eq!(phases(&window), [(0, 9), (expected, 23)]);
    }
    window.click("Delete the phase Preparation");
    assert!(window.shows("Deleted the phase \"Preparation\""));
}

#[test]
fn bookmarks_have_colours_of_their_own() {
    let mut window = Window::on(scene());
    window.press(Key::M);
    window.press_with(Modifiers::SHIFT, Key::M);
    window.harness.step();
    window.click("Colour of the bookmark at frame 1");
    window.click("Colour 3");
    let colour = window.harness.state().shared.document.bookmarks()[0].colour;
    assert_eq!(colour, Some(crate::settings::PROMPT_COLOURS[2]));
    window.harness.state_mut().shared.document.undo();
    assert_eq!(window.harness.state().shared.document.bookmarks()[0].colour, None);
}
