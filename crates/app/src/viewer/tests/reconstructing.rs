//! Tests of everything that can be seen and done while a recording is reconstructed.

use super::*;

pub(super) fn training() -> Window {
    let mut window = Window::on(bare());
    window.click("Reconstruct…");
    window.click("Start");
    window.until(|app| app.document.mode == ViewMode::SideBySide);
    window
}

#[test]
fn the_picture_stays_where_it_is_while_one_draws_on_it() {
    let mut window = Window::on(Info { has_reconstruction: false, has_features: false, ..scene() });
    window.click("Reconstruct…");
    window.harness.state_mut().shared.viewport.marking.is_on = true;
    window.click("Start");
    window.until(|app| app.info().is_some_and(|info| info.has_reconstruction));
    assert_eq!(window.harness.state().shared.document.mode, ViewMode::Original);
}

#[test]
fn the_loss_and_its_terms_are_a_curve_while_it_learns() {
    let mut window = training();
    window.click("Details of the training");
    window.until_shown("Loss over the steps, now total");
    // Terms that this training does not have are not shown.
    assert!(window.shows("colour") && window.shows("depth") && !window.shows("words 0"));
}

#[test]
fn previews_can_be_rarer_or_off() {
    let mut window = training();
    let seconds = |window: &Window| {
        window.harness.state().shared.reconstruction.training.as_ref().unwrap().task.preview_seconds()
    };
    assert_eq!(seconds(&window), 4);
    window.click("20 s");
    assert_eq!(seconds(&window), 20);
    window.click("off");
    assert_eq!(seconds(&window), 0);
}

#[test]
fn the_part_under_the_play_head_is_asked_for() {
    let mut window = training();
    window.press(Key::End);
    window.harness.step();
    let shared = &window.harness.state().shared;
    let wanted = shared.reconstruction.training.as_ref().unwrap().task.play_head();
    assert!(wanted > 0 && wanted == shared.playback.frame());
}

#[test]
fn a_long_recording_is_announced_as_several_parts() {
    let recording = Info { num_frames: 800, ..bare() };
    let mut window = Window::on(recording);
    window.click("Reconstruct…");
    window.until_shown("reconstructed in about 9 parts");
}

#[test]
fn little_memory_is_said_before_the_system_ends_the_program() {
    let mut window = training();
    assert!(!window.shows("of memory are left"));
    *window.backend.available_bytes.lock().unwrap() = Some(250_000_000);
    for _ in 0..90 {
        window.harness.step();
    }
    assert!(window.shows("Only 250 MB of memory are left"));
}

#[test]
fn what_was_reconstructed_before_is_offered_first() {
    let made = Path::new("/data/clip.safetensors");
    let mut window = Window::on(Info { made_before: Some(made.into()), ..bare() });
    assert!(window.shows("was reconstructed before") && window.shows("Reconstruct…"));
    window.click("Open the reconstruction");
    window.until(|app| app.info().is_some_and(|i| i.path == made));
}

#[test]
fn a_recording_is_checked_when_it_is_opened_and_its_masks_can_be_flipped() {
    let inverted = CheckReport {
        ok: false,
        frames: 48,
        warnings: vec!["Masks hide 94 % of the frames on average; they are probably inverted.".into()],
        errors: vec!["Nothing of frame 1 is left to learn from".into()],
        ..CheckReport::default()
    };
    let checked = Mutex::new(Checked { report: inverted, can_flip: true });
    let backend = Arc::new(FakeBackend { info: bare(), checked, ..Default::default() });
    let mut window = Window::with(backend);
    window.harness.state_mut().shared.preferences.is_acknowledged = true;
    let ctx = window.harness.ctx.clone();
    window.harness.state_mut().shared.open_path(Path::new("/data/recording"), &ctx);
    window.until(|app| app.reconstruction.would_be_wrong());
    assert!(window.shows("A reconstruction would be wrong") && window.shows("probably inverted"));
    window.click("Reconstruct…");
    assert!(window.harness.state().shared.dialog != Some(Dialog::Reconstruct), "nobody is led into it");
    window.backend.is_flip_slow.store(true, Ordering::Relaxed);
    window.click("Flip the masks");
    let is_disabled = window.harness.get_by_label("Flip the masks").accesskit_node().is_disabled();
    assert!(is_disabled, "it is flipped once, and the window goes on");
    window.backend.is_flip_slow.store(false, Ordering::Relaxed);
    window.until(|app| app.open.is_some() && app.is_enabled(crate::viewer::command::Command::Reconstruct));
    window.until_shown("This recording can be reconstructed");
    assert!(window.shows("This recording can be reconstructed") && !window.shows("probably inverted"));
    window.click("Reconstruct…");
    assert!(window.harness.state().shared.dialog == Some(Dialog::Reconstruct));
}

#[test]
fn a_reconstruction_is_not_checked_again() {
    let window = Window::on(scene());
    assert!(window.harness.state().shared.reconstruction.check.is_none());
}

#[test]
fn what_was_learned_waits_for_room_also_after_stopping_until_it_is_given_up() {
    let mut window = training();
    window.backend.is_disk_full.store(true, Ordering::Relaxed);
    window.stop_training();
    window.until_shown("Reconstructing: not saved yet");
    assert!(window.shows("tried every second") && !window.shows("left"));
    window.click("Give up what was learned");
    window.until(|app| app.reconstruction.training.is_none() && app.opening.underway.is_none());
    let app = &window.harness.state().shared;
    assert!(app.problem.as_ref().is_some_and(|p| p.contains("disk is full")), "{:?}", app.problem);
    assert!(!app.info().unwrap().has_reconstruction, "no file holds what the preview showed");

    window.press(Key::Escape);
    window.click("Reconstruct…");
    window.click("Start");
    window.until_shown("Reconstructing: training");
    window.stop_training();
    window.until_shown("Reconstructing: not saved yet");
    window.backend.is_disk_full.store(false, Ordering::Relaxed);
    window.until(|app| app.reconstruction.training.is_none() && app.opening.underway.is_none());
    assert!(window.harness.state().shared.info().unwrap().has_reconstruction);
}

#[test]
fn whatever_else_is_opened_stays_and_the_reconstruction_is_offered() {
    let mut window = training();
    let ctx = window.harness.ctx.clone();
    window.harness.state_mut().shared.open_path(Path::new("/data/other.safetensors"), &ctx);
    window.until_shown("Reconstructing clip.mp4: training");
    let is_other = |app: &Shared| app.info().is_some_and(|i| i.path == Path::new("/data/other.safetensors"));
    assert!(is_other(&window.harness.state().shared));
    window.stop_training();
    window.until_shown("clip.safetensors is reconstructed");
    assert!(is_other(&window.harness.state().shared));
    window.click("Open it");
    window.until(|app| app.info().is_some_and(|i| i.path == Path::new("/data/clip.safetensors")));
    assert!(!window.shows("is reconstructed."));
}

#[test]
fn a_scene_is_reconstructed_again_from_its_recording_and_shown_meanwhile() {
    let mut window = Window::on(Info { recording: Some("/data/recording".into()), ..scene() });
    window.press_with(Modifiers::COMMAND, Key::R);
    window.harness.step();
    window.click("Start");
    window.until_shown("Reconstructing: training");
    let app = &window.harness.state().shared;
    assert_eq!(app.info().unwrap().path, Path::new("/data/clip.safetensors"));
    assert!(app.is_enabled(crate::viewer::command::Command::Export));
    window.press_with(Modifiers::COMMAND, Key::E);
    window.harness.state().shared.reconstruction.training.as_ref().unwrap().task.cancel();
    window.until(|app| app.reconstruction.training.is_none() && app.opening.underway.is_none());
    let app = &window.harness.state().shared;
    assert!(
        app.dialog == Some(Dialog::Export) && !app.reconstruction.finished.is_empty(),
        "nobody is interrupted"
    );
    assert_eq!(window.backend.trained.lock().unwrap()[0].recording, Path::new("/data/recording"));

    let window = Window::on(Info { has_original: false, ..scene() });
    assert!(!window.harness.state().shared.is_enabled(crate::viewer::command::Command::Reconstruct));
}

/// Asks the window to close, and returns `true` if it would.
pub(super) fn closes(window: &mut Window) -> bool {
    let input = window.harness.input_mut();
    let viewport = input.viewports.entry(egui::ViewportId::ROOT).or_default();
    viewport.events.push(egui::ViewportEvent::Close);
    window.harness.step();
    let output = &window.harness.output().viewport_output[&egui::ViewportId::ROOT];
    !output.commands.contains(&egui::ViewportCommand::CancelClose)
}

#[test]
fn a_window_that_is_closed_keeps_what_was_learned_first() {
    let mut window = Window::on(scene());
    assert!(closes(&mut window), "nothing holds it");

    let mut window = training();
    window.backend.is_disk_full.store(true, Ordering::Relaxed);
    assert!(!closes(&mut window) && !closes(&mut window), "twice, by mistake");
    window.until_shown("The window closes once what was learned is saved");
    window.until_shown("not saved yet");
    window.backend.is_disk_full.store(false, Ordering::Relaxed);
    let is_closing = |window: &Window| {
        let output = &window.harness.output().viewport_output[&egui::ViewportId::ROOT];
        output.commands.contains(&egui::ViewportCommand::Close)
    };
    while window.harness.state().shared.reconstruction.training.is_some() {
        window.harness.step();
    }
    assert!(is_closing(&window));
    assert_eq!(window.backend.trained.lock().unwrap().len(), 1);

    // A training that ended by itself is no more given up than one that is stopped.
    let mut window = training();
    window.backend.is_disk_full.store(true, Ordering::Relaxed);
    window.backend.is_trained.store(true, Ordering::Relaxed);
    window.until_shown("not saved yet");
    assert!(!closes(&mut window));
    window.until_shown("Close it again to give that up");
    for _ in 0..50 {
        window.harness.step();
        std::thread::sleep(std::time::Duration::from_millis(1));
    }
    assert!(window.harness.state().shared.reconstruction.training.is_some(), "it waits to be saved");
    window.backend.is_disk_full.store(false, Ordering::Relaxed);
    window.until(|app| app.reconstruction.training.is_none());
    assert_eq!(window.backend.trained.lock().unwrap().len(), 1);

    // A user who asks again later closes the window without the scene.
    let mut window = training();
    window.backend.is_disk_full.store(true, Ordering::Relaxed);
    assert!(!closes(&mut window));
    for _ in 0..400 {
        window.harness.step();
    }
    assert!(closes(&mut window));
}

#[test]
fn an_export_keeps_the_window_open_until_it_is_closed_again() {
    let mut window = Window::on(scene());
    window.add_prompt("gallbladder");
    window.backend.is_export_slow.store(true, Ordering::Relaxed);
    window.press_with(Modifiers::COMMAND, Key::E);
    window.harness.step();
    window.click("Start export");
    let pass = |window: &mut Window, seconds: usize| (0..60 * seconds).for_each(|_| window.harness.step());
    assert!(!closes(&mut window) && !closes(&mut window), "a key that is held down asks twice");
    window.harness.step();
    assert!(window.shows("An export is running. Close the window again to stop it"));
    pass(&mut window, 10);
    assert!(!closes(&mut window), "the message is gone, and comes again");
    pass(&mut window, 2);
    assert!(
        closes(&mut window)
            && window.harness.state().shared.exporting.as_ref().is_some_and(|e| e.task.is_cancelling())
    );
}

#[test]
fn parts_outside_of_the_body_and_other_shots_are_left_out_at_a_click() {
    let mut window = Window::on(bare());
    let frames = window.harness.state().shared.info().unwrap().num_frames;
    let report = CheckReport {
        ok: true,
        frames,
        cuts: vec![frames - 4],
        without_tissue: vec![(0, 1)],
        ..CheckReport::default()
    };
    let outcome = Some(Ok(Checked { report, can_flip: false }));
    window.harness.state_mut().shared.reconstruction.check.as_mut().unwrap().outcome = outcome;
    window.harness.step();
    let excluded = |window: &Window| window.harness.state().shared.document.excluded().to_vec();
    window.click("Leave out what is outside of the body");
    assert_eq!(excluded(&window), [(0, 1)]);
    assert!(!window.shows("Leave out what is outside of the body"));
    window.click("Keep this shot alone");
    assert_eq!(excluded(&window), [(0, 1), (frames - 4, frames - 1)]);
    window.press_with(Modifiers::COMMAND, Key::Z);
    assert_eq!(excluded(&window), [(0, 1)]);
}

#[test]
fn the_pace_of_a_training_is_remembered_for_the_next_one() {
    let mut window = training();
    assert!(window.harness.state().shared.preferences.seconds_per_step_and_pixel.is_none());
    // A tenth of the steps says what one takes.
    window.until(|app| app.reconstruction.training.as_ref().is_some_and(|t| t.seconds_per_step.is_some()));
    window.stop_training();
    window.until(|app| app.reconstruction.training.is_none());
    assert!(
        window.harness.state().shared.preferences.seconds_per_step_and_pixel.is_some_and(|pace| pace > 0.0)
    );
}

#[test]
fn no_time_is_promised_before_the_first_training() {
    let mut window = Window::on(bare());
    window.click("Reconstruct…");
    assert!(window.shows("Standard: good enough to work with"));
    assert!(!window.shows("Standard: good enough to work with,"));
}

#[test]
fn the_choice_of_quality_speaks_of_minutes_not_of_steps() {
    let mut window = Window::on(bare());
    window.harness.state_mut().shared.preferences.seconds_per_step_and_pixel = Some(1e-4);
    window.click("Reconstruct…");
    // 32 × 24 pixels, 4000 steps: 307 s
    assert!(window.shows("Standard: good enough to work with, about 5 minutes"));
    assert!(window.shows("Best: more detail, about 50 minutes"));
    assert!(!window.shows("steps") && !window.shows("Gaussians"));
}

#[test]
fn the_questions_are_about_what_is_open() {
    let mut window = Window::on(bare());
    window.click("Reconstruct…");
    assert!(window.shows("Reconstruct this recording"));
    let ctx = window.harness.ctx.clone();
    window.harness.state_mut().shared.open_path(Path::new("/elsewhere/second"), &ctx);
    window.until(|app| app.info().is_some_and(|i| i.path == Path::new("/elsewhere/second")));
    window.until(|app| app.dialog.is_none());
    assert!(!window.shows("Reconstruct this recording"));
    window.click("Reconstruct…");
    window.click("Start");
    window.until(|app| app.reconstruction.training.is_some());
    let training = window.harness.state().shared.reconstruction.training.as_ref().unwrap();
    assert_eq!(training.recording, Path::new("/elsewhere/second"));
}

#[test]
fn a_scene_is_replaced_only_if_the_user_agreed() {
    let folder = tempfile::tempdir().unwrap();
    let mut window = Window::on(Info { output_folder: folder.path().to_owned(), ..bare() });
    window.click("Reconstruct…");
    let scene = folder.path().join("clip.safetensors");
    std::fs::write(&scene, "of yesterday").unwrap();
    window.until_shown("is there already");
    window.click("Start");
    assert!(window.harness.state().shared.reconstruction.training.is_none(), "it cannot be started");
    *window.backend.picked.lock().unwrap() = Some(Picked::Path(scene.clone()));
    window.click("Save as…");
    while window.shows("is there already") {
        window.harness.step();
    }
    let request = window.train_briefly();
    assert_eq!((request.scene, request.replaces), (scene, true));
}

fn type_into(window: &mut Window, field: &str, text: &str) {
    window.harness.get_by_role_and_label(Role::TextInput, field).focus();
    window.harness.step();
    window.harness.get_by_role_and_label(Role::TextInput, field).type_text(text);
    window.harness.step();
}

/// Opens the questions before the reconstruction of a recording without labels, with networks chosen.
fn with_models(folder: &Path) -> Window {
    let mut window = Window::on(Info { has_labels: false, ..bare() });
    choose_models(&mut window, folder);
    window
}

/// Opens the questions before the reconstruction, and chooses networks there.
fn choose_models(window: &mut Window, folder: &Path) {
    let models = ["sam", "clip"].map(|name| folder.join(name));
    models.iter().for_each(|folder| std::fs::create_dir_all(folder).unwrap());
    window.click("Reconstruct…");
    window.click("by networks that find regions and tell what they show");
    assert!(window.shows("Choose a folder."));
    for (field, folder) in
        ["Folder with a Segment Anything", "Folder with an image encoder"].iter().zip(&models)
    {
        type_into(window, field, &folder.display().to_string());
    }
}

#[test]
fn networks_are_tried_at_once_and_remembered_once_they_are_used() {
    let folder = tempfile::tempdir().unwrap();
    let mut window = with_models(folder.path());
    let fault = Some("This folder has no model for regions.".to_owned());
    *window.backend.faults.lock().unwrap() = ModelFaults { masks: fault, ..Default::default() };
    window.harness.step();
    type_into(&mut window, "Folder with a text encoder", "/no/such");
    window.until_shown("This folder has no model for regions.");
    window.until_shown("There is no such folder.");
    window.until_shown("cannot be used yet");
    window.click("Start");
    assert!(window.harness.state().shared.reconstruction.training.is_none(), "it cannot be started");

    *window.backend.faults.lock().unwrap() = ModelFaults::default();
    window.press(Key::Escape);
    let mut window = with_models(folder.path());
    window.until_shown("These networks can be used.");
    window.click("Coarse");
    window.click("Start");
    window.until(|app| app.reconstruction.training.is_some());
    let shared = &window.harness.state().shared;
    let models = &shared.preferences.models;
    assert_eq!((models.masks.clone(), models.points_per_side), (folder.path().join("sam"), 8));
    // Networks took most of the time, and are done.
    window.until(|app| app.reconstruction.training.as_ref().is_some_and(|t| t.fraction() >= 0.6));
    window.stop_training();
    window.until(|app| app.reconstruction.training.is_none());
    let request = window.backend.trained.lock().unwrap()[0].clone();
    assert!(matches!(&request.words, Words::Models(models) if models.images == folder.path().join("clip")));
    assert_eq!(request.features_folder(), Path::new("/data/clip-features"));
}

#[test]
fn what_the_same_networks_found_is_used_again_and_what_others_found_stays() {
    let [folder, models] = [(); 2].map(|()| tempfile::tempdir().unwrap());
    let features = folder.path().join("clip-features");
    std::fs::create_dir(&features).unwrap();
    std::fs::write(features.join("prepared.json"), "{}").unwrap();
    let output_folder = folder.path().to_owned();
    for (found, used) in [(Some(&features), "clip-features"), (None, "clip-features-2")] {
        let output_folder = output_folder.clone();
        let mut window = Window::on(Info { has_labels: false, output_folder, ..bare() });
        *window.backend.found.lock().unwrap() = found.cloned();
        choose_models(&mut window, models.path());
        window.until_shown("These networks can be used.");
        assert_eq!(window.shows("What these networks found in it before is used again."), found.is_some());
        let request = window.train_briefly();
        assert_eq!(request.features_folder(), folder.path().join(used));
    }
}

#[test]
fn recordings_wait_for_each_other_and_can_be_taken_out() {
    let mut window = training();
    let ctx = window.harness.ctx.clone();
    for name in ["/elsewhere/second", "/elsewhere/third"] {
        window.harness.state_mut().shared.open_path(Path::new(name), &ctx);
        window.until(|app| app.info().is_some_and(|i| i.path == Path::new(name)));
        window.press_with(Modifiers::COMMAND, Key::R);
        window.harness.step();
        window.click("Start after the others");
    }
    assert!(window.shows("Then second") && window.shows("Then third"));
    let app = &window.harness.state().shared;
    assert!(!app.is_enabled(crate::viewer::command::Command::Reconstruct), "not twice");
    let scenes = app.reconstruction.planned_scenes();
    assert_eq!(scenes.iter().collect::<std::collections::BTreeSet<_>>().len(), 3, "{scenes:?}");
    window.click("Do not reconstruct third");
    assert!(!window.shows("Then third"));
    window.stop_training();
    let is_second = |app: &Shared| {
        app.reconstruction.training.as_ref().is_some_and(|t| t.recording == Path::new("/elsewhere/second"))
    };
    window.until(is_second);
    assert!(window.harness.state().shared.reconstruction.queue.is_empty());
    window.harness.state().shared.reconstruction.training.as_ref().unwrap().task.cancel();
    window.until(|app| app.reconstruction.training.is_none());
    assert_eq!(window.backend.trained.lock().unwrap().len(), 2);
}
