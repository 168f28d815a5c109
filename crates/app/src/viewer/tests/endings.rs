//! Tests of the end of work: finished while something else is shown or drawn, stopped, failed, gone on with.

use super::{
    pointing::click_at,
    reconstructing::{closes, training},
    *,
};
use crate::{
    jobs,
    viewer::{
        command::Command,
        state::{
            content::Look,
            marking::{Draft, Tool},
            reconstruction::Training,
        },
    },
};
use surgtpgs_core::{marks::Shape, train::TrainSettings};

fn open(window: &mut Window, path: &str) {
    let ctx = window.harness.ctx.clone();
    window.harness.state_mut().shared.open_path(Path::new(path), &ctx);
    window.until(|app| app.info().is_some_and(|i| i.path == Path::new(path)));
}

/// Opens a recording, and lets it wait to be reconstructed.
fn queue(window: &mut Window, path: &str) {
    open(window, path);
    window.press_with(Modifiers::COMMAND, Key::R);
    window.harness.step();
    window.click("Start after the others");
}

fn show_start_page(window: &mut Window) {
    let ctx = window.harness.ctx.clone();
    window.harness.state_mut().shared.run(Command::StartPage.into(), &ctx);
    (0..3).for_each(|_| window.harness.step());
    assert!(window.harness.state().shared.open.is_none());
}

fn start_slow_export(window: &mut Window) {
    window.add_prompt("gallbladder");
    window.backend.is_export_slow.store(true, Ordering::Relaxed);
    window.press_with(Modifiers::COMMAND, Key::E);
    window.harness.step();
    window.click("Start export");
}

/// Returns the mark that is being drawn, and the part of the picture that is seen.
fn in_hand(window: &Window) -> (Option<Draft>, Look) {
    let shared = &window.harness.state().shared;
    (shared.viewport.marking.draft.clone(), shared.document.look)
}

#[test]
fn a_finished_reconstruction_takes_nothing_out_of_the_hand() {
    let mut window = training();
    let shared = &mut window.harness.state_mut().shared;
    let panes = shared.viewport.panes.clone();
    shared.document.look.zoom.magnify(2.0, panes.0[0].0.center(), &panes);
    let marking = &mut shared.viewport.marking;
    (marking.is_on, marking.name, marking.tool) = (true, "tool".into(), Tool::Outline);
    (0..3).for_each(|_| window.harness.step());
    click_at(&mut window, [0.4, 0.4]);
    click_at(&mut window, [0.6, 0.6]);
    let before = in_hand(&window);
    assert!(before.0.is_some() && !before.1.zoom.is_home());
    window.backend.is_trained.store(true, Ordering::Relaxed);
    window.until_shown("clip.safetensors is reconstructed.");
    assert_eq!(in_hand(&window), before);
    let shared = &mut window.harness.state_mut().shared;
    let shape = Shape::Click { point_px: [5.0, 5.0], radius_px: 1.0 };
    shared.document.add_mark(Mark::new(3, "tool", true, shape));
    for command in [Command::CopyAreas, Command::LargestFound, Command::Export, Command::Quality] {
        let why = shared.obstacle(command);
        assert_eq!(why, Some("This is a preview: open the finished reconstruction"));
    }
    window.scroll_and_click("Open it");
    window.until(|app| app.opening.underway.is_none() && app.reconstruction.finished.is_empty());
    assert_eq!(in_hand(&window), before);
}

#[test]
fn the_view_stays_when_a_reconstruction_ends() {
    let (beside, depth) = (ViewMode::SideBySide, ViewMode::Depth);
    for (mode, draws, expected) in
        [(beside, true, beside), (depth, false, depth), (beside, false, ViewMode::Original)]
    {
        let mut window = training();
        let shared = &mut window.harness.state_mut().shared;
        (shared.document.mode, shared.viewport.marking.is_on) = (mode, draws);
        window.backend.is_trained.store(true, Ordering::Relaxed);
        window.until(|app| app.reconstruction.training.is_none() && app.opening.underway.is_none());
        assert_eq!(window.harness.state().shared.document.mode, expected, "{mode:?}, {draws}");
    }
}

#[test]
fn what_plays_plays_on_when_a_reconstruction_ends() {
    for plays in [true, false] {
        let mut window = training();
        let now = window.harness.ctx.input(|i| i.time);
        let playback = &mut window.harness.state_mut().shared.playback;
        playback.change_speed(-1, now);
        match plays {
            true => playback.play(now),
            false => playback.toggle_looping(),
        }
        window.backend.is_trained.store(true, Ordering::Relaxed);
        window.until(|app| app.reconstruction.training.is_none() && app.opening.underway.is_none());
        let playback = &window.harness.state().shared.playback;
        assert_eq!((playback.is_playing(), playback.is_looping(), playback.speed()), (plays, plays, 0.5));
    }
}

#[test]
fn all_that_finished_meanwhile_are_offered() {
    let mut window = training();
    queue(&mut window, "/elsewhere/second");
    open(&mut window, "/elsewhere/third");
    window.stop_training();
    window.until(|app| app.reconstruction.training.as_ref().is_some_and(|t| t.recording.ends_with("second")));
    window.harness.state().shared.reconstruction.training.as_ref().unwrap().task.cancel();
    window.until(|app| app.reconstruction.training.is_none());
    for name in ["clip.safetensors", "other.safetensors"] {
        assert!(window.shows(&format!("{name} is reconstructed.")), "{name}");
    }
    window.harness.query_all_by_label("Not now").next().unwrap().click();
    (0..3).for_each(|_| window.harness.step());
    assert!(!window.shows("clip.safetensors is reconstructed."));
    assert!(window.shows("other.safetensors is reconstructed."));
}

#[test]
fn a_stop_before_anything_was_learned_is_no_problem() {
    let mut window = Window::on(bare());
    window.backend.is_preparing.store(true, Ordering::Relaxed);
    window.click("Reconstruct…");
    window.click("Start");
    window.until_shown("Reconstructing: preparing");
    window.harness.state().shared.reconstruction.training.as_ref().unwrap().task.cancel();
    window.until_shown("Stopped: nothing was learned yet");
    assert_eq!(window.harness.state().shared.problem, None);
}

#[test]
fn a_failure_names_its_recording_where_another_is_shown() {
    let mut window = training();
    queue(&mut window, "/elsewhere/broken");
    open(&mut window, "/elsewhere/third");
    window.stop_training();
    window.until(|app| app.problem.is_some());
    let problem = window.harness.state().shared.problem.clone().unwrap();
    assert!(problem.starts_with("broken could not be reconstructed: there is nothing to learn"), "{problem}");
}

#[test]
fn the_time_of_what_waited_is_not_that_of_what_is_shown() {
    let mut window = training();
    queue(&mut window, "/elsewhere/second");
    open(&mut window, "/elsewhere/third");
    window.backend.is_preparing.store(true, Ordering::Relaxed);
    window.stop_training();
    // There is a pace after two seconds.
    let is_under_way = |t: &Training| t.is_preparing() && t.task.progress.seconds > 2.0;
    window.until(|app| app.reconstruction.training.as_ref().is_some_and(is_under_way));
    assert!(window.shows("estimating the time…"));
}

#[test]
fn what_waits_is_reconstructed_if_a_failure_keeps_the_window_open() {
    let mut window = training();
    queue(&mut window, "/elsewhere/second");
    window.backend.is_disk_full.store(true, Ordering::Relaxed);
    assert!(!closes(&mut window));
    window.until_shown("Reconstructing clip.mp4: not saved yet");
    window.harness.state().shared.reconstruction.training.as_ref().unwrap().task.give_up();
    window.until(|app| app.reconstruction.training.as_ref().is_some_and(|t| t.recording.ends_with("second")));
    let problem = window.harness.state().shared.problem.clone();
    assert!(problem.is_some_and(|why| why.contains("disk is full")));
}

#[test]
fn the_demo_waits_for_the_training_that_is_running() {
    let mut window = training();
    let ctx = window.harness.ctx.clone();
    let shared = &mut window.harness.state_mut().shared;
    shared.opening.demo_folder = Some("/data/demo".into());
    shared.open_demo(&ctx);
    window.until(|app| app.info().is_some_and(|i| i.path == Path::new("/data/demo")));
    assert!(window.shows("Then Demo: a made-up recording"));
    window.stop_training();
    window.until(Shared::is_reconstructing);
}

#[test]
fn the_start_page_shows_a_training_and_what_closing_the_window_does() {
    let mut window = training();
    open(&mut window, "/elsewhere/second");
    show_start_page(&mut window);
    assert!(window.shows("Open a video or a file…") && window.shows("Reconstructing clip.mp4: training"));
    assert!(window.shows("Stop and keep what was learned"));
    window.backend.is_disk_full.store(true, Ordering::Relaxed);
    assert!(!closes(&mut window));
    window.until_shown("The window closes once what was learned is saved");
    window.backend.is_disk_full.store(false, Ordering::Relaxed);
    window.until_shown("clip.safetensors is reconstructed.");
    window.click("Open it");
    window.until(|app| app.info().is_some_and(|i| i.path == Path::new("/data/clip.safetensors")));
}

#[test]
fn the_start_page_shows_an_export_and_what_is_said() {
    let mut window = Window::on(scene());
    start_slow_export(&mut window);
    show_start_page(&mut window);
    assert!(window.shows("Exporting"));
    assert!(!closes(&mut window));
    window.harness.step();
    assert!(window.shows("An export is running. Close the window again to stop it"));
}

#[test]
fn an_export_that_was_stopped_goes_on_in_its_folder() {
    let mut window = Window::on(scene());
    start_slow_export(&mut window);
    window.click("Stop the export");
    window.until_shown("Stopped. The 96 files that were finished");
    window.backend.is_export_slow.store(false, Ordering::Relaxed);
    for is_left_out in [true, false] {
        window.harness.state_mut().shared.document.toggle_excluded(3, 3);
        (0..3).for_each(|_| window.harness.step());
        assert_eq!(window.shows("Go on with it"), !is_left_out);
    }
    window.click("Go on with it");
    window.until_shown("96 files are in");
    assert!(!window.shows("Go on with it"));
    let exported = window.backend.exported.lock().unwrap();
    assert_eq!(exported.len(), 2);
    assert!(exported[0] == exported[1]);
}

#[test]
fn a_scene_is_offered_again_only_if_its_training_goes_on() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("clip.safetensors");
    let mut stopped = surgtpgs_core::stress::ordinary(4);
    stopped.provenance.settings = serde_json::json!(TrainSettings::default().with_quality(Quality::Best));
    stopped.provenance.steps = 9;
    stopped.save(&file).unwrap();
    let (output_folder, made_before) = (folder.path().to_owned(), Some(file.clone()));
    let mut window = Window::on(Info { output_folder, made_before, ..bare() });
    let told = "It was stopped before its end. Parts that are done are kept";
    window.click("Reconstruct…");
    window.click("only what you mark by hand");
    assert!(!window.shows(told), "nothing of it can be gone on with");
    window.press(Key::Escape);
    stopped.save(&jobs::chapter_path(&file, 2)).unwrap();
    window.click("Reconstruct…");
    assert!(!window.shows(told), "no words are found in it");
    window.click("only what you mark by hand");
    assert!(window.shows(told));
    for (quality, goes_on) in [("Quick look", false), ("Best: more detail", true)] {
        window.harness.get_by_label_contains(quality).click();
        (0..3).for_each(|_| window.harness.step());
        assert_eq!(window.shows(told), goes_on, "{quality}");
    }
    let request = window.train_briefly();
    assert_eq!((request.scene, request.replaces, request.quality), (file, true, Quality::Best));

    window.until(|app| app.opening.underway.is_none());
    window.press_with(Modifiers::COMMAND, Key::R);
    window.harness.step();
    window.harness.get_by_label_contains("Quick look").click();
    (0..3).for_each(|_| window.harness.step());
    let request = window.train_briefly();
    assert_eq!((request.scene, request.replaces), (folder.path().join("clip-2.safetensors"), false));
}
