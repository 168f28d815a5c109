//! Tests that drive the window as a user does, without a display. A small fake answers in place of the
//! engine: its frame i is a grey of level i, "gallbladder" is the left part of every picture, and "nothing"
//! is nowhere.

mod borders;
mod endings;
mod exports;
mod fixture;
mod hazards;
mod keys;
mod layout;
mod looks;
mod marking;
mod marking_demo;
mod monkey;
mod obstacles;
mod over_time;
mod panels;
mod pointing;
mod quality;
mod reconstructing;
mod recovery;
mod sessions;
mod starting;
mod strokes;

use crate::viewer::{
    backend::{
        Backend, Checked, Demo, FrameSource, FrameView, Info, ModelFaults, Models, Parts, Rendering,
        TrainNews, TrainRequest, Words,
        paths::{PathAsk, Picked},
        task::{NOT_SAVED, TaskContext},
    },
    panels::prompts::{ENCODING, NO_FEATURES, NOTHING},
    picture::request::Picture,
    shared::{Dialog, Shared},
    shell::Shell,
    state::{autosave::Autosave, preferences::Preferences, view_mode::ViewMode},
};
use crate::{
    engine::{Absence, Answer, Negatives, Question, Sample},
    evaluation::Evaluation,
    jobs::ExportRequest,
};
use egui::{Key, Modifiers, Role, accesskit::Toggled};
use egui_kittest::{
    Harness,
    kittest::{NodeT, Queryable},
};
use image::{Rgb, RgbImage};
use std::{
    path::{Path, PathBuf},
    sync::{
        Arc, Mutex,
        atomic::{AtomicBool, AtomicUsize, Ordering},
        mpsc,
    },
};
use surgtpgs_core::{
    Error, Result,
    about::intended_use,
    export::{ExportSummary, num_files},
    grid::{Grid, Mask},
    marks::{LookHere, Mark},
    sequence::{CheckReport, plain_words},
    train::{LossTerms, Quality},
};

use fixture::*;

#[test]
fn a_typed_prompt_becomes_a_row_with_its_area_on_the_picture() {
    let mut window = Window::on(scene());
    window.add_prompt("gallbladder");
    assert_eq!(window.harness.state().shared.document.prompts().len(), 1);
    window.until_found();
    let picture = window.harness.state().shared.picture().unwrap();
    let found = picture.findings[0].outcome.as_ref().unwrap();
    assert_eq!(found.area_fraction, 0.25);
    assert_eq!(found.histogram.iter().sum::<u32>(), SIZE.0 * SIZE.1);
    assert_eq!(picture.outlines.lines[0].lines.len(), 1);
    assert!(window.shows("25 % of the picture"));
    window.harness.get_by_label("Threshold of gallbladder");
}

#[test]
fn what_is_typed_is_looked_for_at_once_and_kept_by_enter() {
    let mut window = Window::on(scene());
    window.harness.get_by_label("Prompt").focus();
    window.until_picture(|p| p.candidates.iter().any(|(text, _)| text == "liver"));
    assert!(
        window.harness.state().shared.picture().unwrap().findings.is_empty(),
        "a rehearsal draws nothing"
    );
    window.type_prompt("/gall");
    window.until_picture(|p| p.findings.iter().any(|f| f.text == "gall"));
    assert!(window.shows("Enter keeps it"));
    assert!(window.harness.state().shared.document.prompts().is_empty());
    window.press(Key::Enter);
    assert_eq!(window.harness.state().shared.document.prompts()[0].text, "gall");
    assert_eq!(window.harness.state().shared.prompt_box.text, "");
}

#[test]
fn what_leaves_out_or_hides_says_so_and_offers_the_way_back() {
    let mut window = Window::on(scene());
    window.add_prompt("gallbladder");
    let ctrl = Modifiers::COMMAND;
    window.press_with(ctrl | Modifiers::SHIFT, Key::E);
    window.harness.step();
    assert!(window.shows("Left out frame 1"));
    window.harness.step();
    window.click("Undo");
    assert!(window.harness.state().shared.document.excluded().is_empty());
    window.press_with(ctrl, Key::H);
    window.harness.step();
    window.harness.step();
    assert!(window.shows("Everything drawn over the picture is hidden"));
    window.click("Show again");
    assert!(!window.harness.state().shared.document.is_hidden);
    window.click("Delete gallbladder");
    window.harness.step();
    assert!(window.shows("Deleted \"gallbladder\""));
    window.click("Undo");
    assert_eq!(window.harness.state().shared.document.prompts().len(), 1);
    window.press(Key::Num1);
    window.harness.step();
    assert!(window.shows("Hiding \"gallbladder\""));
    // The message goes by itself.
    (0..500).for_each(|_| window.harness.step());
    assert!(!window.shows("Hiding \"gallbladder\""));
}

#[test]
fn one_key_hides_and_shows_everything_drawn() {
    let mut window = Window::on(scene());
    window.add_prompt("gallbladder");
    window.until_found();
    assert!(!window.shows("overlays hidden"));
    window.press_with(Modifiers::COMMAND, Key::H);
    window.harness.step();
    assert!(window.shows("overlays hidden"));
    window.press_with(Modifiers::COMMAND, Key::H);
    window.harness.step();
    assert!(!window.shows("overlays hidden"));
}

#[test]
fn holding_x_shows_the_recorded_frame_until_it_is_let_go() {
    let mut window = Window::on(scene());
    window.harness.key_down(Key::X);
    window.until_picture(|p| p.original.is_some());
    window.harness.key_up(Key::X);
    window.until_picture(|p| p.original.is_none());
}

#[test]
fn what_is_nowhere_is_said_to_be_nowhere() {
    let mut window = Window::on(scene());
    window.add_prompt("nothing");
    window.until_found();
    assert!(window.harness.query_all_by_label(NOTHING).count() >= 2, "in the row and on the picture");
}

#[test]
fn what_means_something_else_says_so_and_shows_what_it_is_like_on_request() {
    let mut window = Window::on(scene());
    window.add_prompt("spleen");
    window.add_prompt("banana");
    window.until_found();
    assert!(window.shows("Not in this recording; looks like liver") && window.shows("Not in this recording"));
    assert_eq!(window.harness.query_all_by_label_contains("dashed").count(), 1);
    window.click("Show liver, dashed");
    window.until_picture(|p| p.request.prompts[0].question.shows_nearest && !p.findings.is_empty());
    let picture = window.harness.state().shared.picture().unwrap();
    let (prompt, finding) = (&picture.request.prompts[0], &picture.findings[0]);
    assert_eq!(finding.stand_in(prompt), Some("liver"));
    assert!(window.shows("Not in this recording; liver is 25 % of the picture"));
    window.press_with(Modifiers::COMMAND, Key::Z);
    window.until_picture(|p| !p.request.prompts[0].question.shows_nearest);
}

#[test]
fn a_prompt_that_fails_says_why_and_leaves_the_others_alone() {
    let mut window = Window::on(scene());
    window.add_prompt("broken");
    window.add_prompt("gallbladder");
    window.until_found();
    assert!(window.shows("the encoder cannot read this"));
    assert!(window.shows("25 % of the picture"));
}

#[test]
fn a_slow_answer_is_waited_for_in_words_and_never_drawn_on_another_frame() {
    let (permit, mut window) = over_time::stuck();
    assert!(window.shows(ENCODING));
    window.press(Key::ArrowRight);
    window.press(Key::ArrowRight);
    permit.send(()).unwrap();
    permit.send(()).unwrap();
    window.until_found();
    window.until_picture(|p| p.request.view.frame == 2 && !p.findings.is_empty());
    let picture = window.harness.state().shared.picture().unwrap();
    let bare = &picture.reconstruction.as_ref().unwrap().bare;
    assert_eq!(bare.pixels[0], egui::Color32::from_gray(2), "frame, picture and overlay are of one frame");
}

#[test]
fn a_scene_without_features_says_so() {
    let mut window = Window::on(Info { has_features: false, ..scene() });
    assert!(window.shows(NO_FEATURES));
    window.press(Key::Slash);
    window.harness.step();
    window.press(Key::D);
    assert_eq!(
        window.harness.state().shared.document.mode,
        ViewMode::Depth,
        "a prompt box that cannot be used takes no keys"
    );
}

#[test]
fn prompts_wait_for_the_reconstruction() {
    let mut window =
        Window::on(Info { has_reconstruction: false, has_features: false, has_labels: true, ..scene() });
    assert!(!window.shows(NO_FEATURES), "nothing is wrong yet");
    window.type_at_once("/liver\nfat\n");
    assert!(window.shows("Looked for once this recording is reconstructed"));
    let typed = |app: &Shared| app.document.prompts().iter().map(|p| p.text.clone()).collect::<Vec<_>>();
    assert_eq!(typed(&window.harness.state().shared), ["liver", "fat"]);
    window.press_with(Modifiers::COMMAND, Key::R);
    window.harness.step();
    window.harness.step();
    window.click("Start");
    assert!(window.shows("Waits for the reconstruction"));
    window.until(|app| app.info().is_some_and(|i| i.has_reconstruction));
    window.stop_training();
    window.until(|app| !app.is_reconstructing() && app.opening.underway.is_none());
    window.until_picture(|p| p.findings.len() == 2);
    assert!(!window.shows("Waits for the reconstruction"));
    assert_eq!(typed(&window.harness.state().shared), ["liver", "fat"]);
}

#[test]
fn words_wait_for_no_reconstruction_that_cannot_find_them() {
    let mut window = Window::on(Info { has_reconstruction: false, has_features: false, ..scene() });
    window.add_prompt("banana");
    window.press_with(Modifiers::COMMAND, Key::R);
    window.harness.step();
    window.harness.step();
    window.click("Start");
    window.until_shown("Cannot be looked for: mark it by hand");
    assert!(window.shows("no words will be found in it") && !window.shows("Waits for the reconstruction"));
    assert!(window.shows("Mark a structure by hand on one frame") && !window.shows("Or mark"));
    let shape = surgtpgs_core::marks::Shape::Click { point_px: [5.0, 5.0], radius_px: 1.0 };
    window.harness.state_mut().shared.document.add_mark(Mark::new(0, "banana", true, shape));
    window.harness.step();
    assert!(window.shows("only what is marked will be found in it"));
    assert!(!window.shows("no words will be found") && !window.shows("structure by hand on one frame"));
}

#[test]
fn views_are_switched_by_key_and_only_where_they_exist() {
    let mut window = Window::on(scene());
    for (modifiers, key, mode) in [
        (Modifiers::NONE, Key::W, ViewMode::Wipe),
        (Modifiers::SHIFT, Key::W, ViewMode::SideBySide),
        (Modifiers::NONE, Key::D, ViewMode::Depth),
        (Modifiers::NONE, Key::D, ViewMode::Original),
        (Modifiers::SHIFT, Key::B, ViewMode::Reconstruction),
        (Modifiers::SHIFT, Key::B, ViewMode::Original),
    ] {
        window.press_with(modifiers, key);
        assert_eq!(window.harness.state().shared.document.mode, mode);
    }
    let mut window = Window::on(Info { has_original: false, ..scene() });
    window.press_with(Modifiers::SHIFT, Key::B);
    assert_eq!(window.harness.state().shared.document.mode, ViewMode::Reconstruction);
}

#[test]
fn looking_around_is_marked_and_r_returns() {
    let mut window = Window::on(scene());
    let at = egui::pos2(400.0, 300.0);
    let button = |pressed, pos| egui::Event::PointerButton {
        pos,
        button: egui::PointerButton::Secondary,
        pressed,
        modifiers: Modifiers::NONE,
    };
    window.harness.hover_at(at);
    window.harness.step();
    window.harness.event(button(true, at));
    window.harness.step();
    for i in 1..=10 {
        window.harness.hover_at(at + egui::vec2(100.0 * i as f32, 0.0));
        window.harness.step();
    }
    let orbit = window.harness.state().shared.document.look.orbit;
    assert!(!orbit.is_home() && orbit.angle().to_degrees() <= 15.001);
    window.harness.event(button(false, at));
    window.until_picture(|p| !p.request.view.orbit.is_home());
    window.press(Key::R);
    window.until_picture(|p| p.request.view.orbit.is_home());
}

#[test]
fn prompts_can_be_hidden_deleted_and_brought_back() {
    let mut window = Window::on(scene());
    window.add_prompt("gallbladder");
    window.click("Hide gallbladder");
    assert!(!window.harness.state().shared.document.prompts()[0].is_visible);
    window.press(Key::Num1);
    assert!(window.harness.state().shared.document.prompts()[0].is_visible);
    window.click("Delete gallbladder");
    assert!(window.harness.state().shared.document.prompts().is_empty());
    window.press_with(Modifiers::COMMAND, Key::Z);
    assert_eq!(window.harness.state().shared.document.prompts().len(), 1);
}

#[test]
fn examples_of_the_recording_are_one_click_away() {
    let mut window = Window::on(scene());
    window.click("liver");
    assert_eq!(window.harness.state().shared.document.prompts()[0].text, "liver");
}

#[test]
fn the_export_says_how_many_files_before_it_starts() {
    let mut window = Window::on(scene());
    window.add_prompt("gallbladder");
    window.add_prompt("liver");
    window.press_with(Modifiers::COMMAND, Key::E);
    window.harness.step();
    // 48 overlays, 48 masks for each of 2 prompts
    assert!(window.shows("144 files will be written"));
    assert!(window.backend.exported.lock().unwrap().is_empty());
    window.click("Start export");
    window.until_shown("144 files are in");
    assert_eq!(window.harness.state().shared.dialog, None, "the window is not held up");
    assert_eq!(window.backend.exported.lock().unwrap()[0].0.questions.len(), 2);
    window.click("Open folder");
    assert_eq!(*window.backend.folders_shown.lock().unwrap(), [Path::new("/data/clip-export")]);
    window.click("Close");
    assert!(!window.shows("files are in"));
}

#[test]
fn a_recording_is_reconstructed_in_the_window_and_stopping_keeps_what_was_learned() {
    let recording = Info { has_reconstruction: false, has_features: false, has_labels: true, ..scene() };
    let mut window = Window::on(recording);
    assert_eq!(window.harness.state().shared.document.mode, ViewMode::Original);
    window.click("Reconstruct…");
    window.click("Start");
    window.until(|app| app.document.mode == ViewMode::SideBySide);
    assert!(window.shows("Reconstructing: training"));
    window.press(Key::ArrowRight);
    window.until_picture(|p| p.request.view.frame == 1 && p.reconstruction.is_some());
    window.click("Pause");
    window.until(|app| app.reconstruction.training.as_ref().is_some_and(|t| t.task.is_paused()));
    assert!(window.shows("paused"));
    window.click("Go on");
    assert!(!window.shows("paused"));
    window.click("Pause");
    window.stop_training();
    window.until(|app| app.reconstruction.training.is_none() && app.opening.underway.is_none());
    assert_eq!(window.frame(), 1, "the frame is kept");
    assert_eq!(window.harness.state().shared.document.mode, ViewMode::Original, "it replaces nothing");
}

#[test]
fn the_demo_is_opened_and_reconstructed_without_being_asked() {
    let recording = Info { has_reconstruction: false, has_features: false, ..scene() };
    let mut window = Window::with(Arc::new(FakeBackend { info: recording, ..Default::default() }));
    let ctx = window.harness.ctx.clone();
    let app = &mut window.harness.state_mut().shared;
    app.opening.demo_folder = Some("/data/demo".into());
    app.open_demo(&ctx);
    window.until(|app| app.reconstruction.training.is_some() && app.document.mode == ViewMode::SideBySide);
}

#[test]
fn a_training_of_the_demo_is_not_taken_for_that_of_the_own_recording() {
    let recording = Info { has_reconstruction: false, has_features: false, ..scene() };
    let sound = Checked { report: CheckReport { ok: true, ..CheckReport::default() }, can_flip: false };
    let checked = Mutex::new(sound);
    let mut window = Window::with(Arc::new(FakeBackend { info: recording, checked, ..Default::default() }));
    let ctx = window.harness.ctx.clone();
    let app = &mut window.harness.state_mut().shared;
    app.preferences.is_acknowledged = true;
    app.opening.demo_folder = Some("/data/demo".into());
    app.open_demo(&ctx);
    window.until(|app| app.reconstruction.training.is_some());
    window.harness.state_mut().shared.open_path(Path::new("/data/own"), &ctx);
    window.until_shown("This recording can be reconstructed");
    window.until_shown("Reconstructing Demo: a made-up recording: training");
    window.click("Reconstruct…");
    window.click("Start after the others");
    assert!(window.shows("Then own") && !window.shows("has not been reconstructed yet"));
    window.stop_training();
    window.until_shown("Demo: a made-up recording is reconstructed.");
}

#[test]
fn whoever_opens_something_while_the_demo_is_made_keeps_it() {
    let mut window = Window::with(Arc::new(FakeBackend { info: scene(), ..Default::default() }));
    let ctx = window.harness.ctx.clone();
    let app = &mut window.harness.state_mut().shared;
    app.opening.demo_folder = Some("/data/demo".into());
    app.open_demo(&ctx);
    app.open_path(Path::new("/data/own.safetensors"), &ctx);
    window.until(|app| app.open.is_some());
    (0..20).for_each(|_| window.harness.step());
    let app = &window.harness.state().shared;
    assert!(app.reconstruction.training.is_none() && !app.opening.is_making_demo());
    assert_eq!(app.preferences.recent, [Path::new("/data/own.safetensors")]);
}

#[test]
fn what_cannot_be_opened_says_why() {
    let mut window = Window::on(scene());
    let ctx = window.harness.ctx.clone();
    window.harness.state_mut().shared.open_path(Path::new("/no/such"), &ctx);
    window.until(|app| app.problem.is_some());
    assert!(window.shows("There is no such file"));
    assert!(window.harness.state().shared.open.is_some(), "what was open stays");
}

#[test]
fn the_notice_comes_first_and_the_small_one_stays() {
    let mut window = Window::with(Arc::default());
    window.harness.step();
    assert!(window.shows("For research use only"));
    window.click("I understand");
    assert!(!window.shows("For research use only"));
    assert!(window.shows(intended_use()));
    assert!(window.shows("Open a video or a file…"));
}

#[test]
fn nothing_changes_nothing_is_painted() {
    let mut window = Window::on(scene());
    window.add_prompt("gallbladder");
    window.until(|app| app.selected_curve().is_some_and(|curve| curve.is_complete()));
    // Not even a cursor blinks.
    window.press(Key::Slash);
    for _ in 0..120 {
        window.harness.step();
    }
    assert!(window.harness.get_by_label("Prompt").is_focused());
    let delay = window.harness.output().viewport_output[&egui::ViewportId::ROOT].repaint_delay;
    assert_eq!(delay, std::time::Duration::MAX);
}

#[test]
fn the_words_similarity_score_are_never_probability_or_confidence() {
    let mut window = Window::on(scene());
    window.add_prompt("gallbladder");
    window.until_found();
    assert!(window.shows("Similarity score"));
    for word in ["onfidence", "robability"] {
        assert!(!window.shows(word));
    }
}

#[test]
fn buttons_tell_their_state_without_being_seen() {
    let window = Window::on(scene());
    let looping = window.harness.get_by_role_and_label(Role::Button, "Repeat");
    assert_eq!(looping.accesskit_node().toggled(), Some(Toggled::True));
    window.harness.get_by_role_and_label(Role::Slider, "Frame");
}
