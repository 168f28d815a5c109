//! Tests of the start page, and of the ways to choose a path.

use super::*;
use crate::viewer::{
    ViewerInput,
    backend::paths::PathKind,
    command::Command,
    state::{content::Bookmark, session::Session},
};

/// Opens a window that nothing was opened in, with the notice read.
fn unopened() -> Window {
    let mut window = Window::with(Arc::new(FakeBackend { info: scene(), ..Default::default() }));
    let shared = &mut window.harness.state_mut().shared;
    shared.preferences.is_acknowledged = true;
    shared.opening.demo_folder = Some("/data/demo".into());
    (0..2).for_each(|_| window.harness.step());
    window
}

fn begin(window: &mut Window, input: &ViewerInput) {
    let ctx = window.harness.ctx.clone();
    window.harness.state_mut().begin(input, &ctx);
    (0..3).for_each(|_| window.harness.step());
}

#[test]
fn the_first_start_shows_the_demo_and_calls_it_so() {
    let mut window = unopened();
    begin(&mut window, &ViewerInput::Start);
    window.until(|app| app.open.is_some());
    assert!(window.shows("Demo: a made-up recording"));
}

#[test]
fn a_window_with_a_place_on_the_screen_is_drawn_and_its_size_kept() {
    let mut window = unopened();
    let viewport = window.harness.input_mut().viewports.get_mut(&egui::ViewportId::ROOT).unwrap();
    viewport.inner_rect = Some(egui::Rect::from_min_size(egui::pos2(40.0, 20.0), egui::vec2(1000.0, 700.0)));
    window.harness.step();
    let ctx = window.harness.ctx.clone();
    let shared = &window.harness.state().shared;
    assert_eq!(shared.window_size, Some([1000.0, 700.0].map(|side| side * ctx.zoom_factor())));
}

#[test]
fn all_of_the_demo_is_offered_once() {
    let mut window = unopened();
    let preferences = &mut window.harness.state_mut().shared.preferences;
    ["/data/demo/recording", "/data/own.mp4", "/data/demo/scene.safetensors"]
        .into_iter()
        .for_each(|path| preferences.remember(Path::new(path)));
    begin(&mut window, &ViewerInput::Start);
    assert_eq!(window.harness.query_all_by_label_contains("Demo: a made-up recording").count(), 1);
    assert!(window.shows("own.mp4"));
}

#[test]
fn later_starts_offer_what_was_opened_last() {
    let folder = tempfile::tempdir().unwrap();
    let mut window = unopened();
    let preferences = &mut window.harness.state_mut().shared.preferences;
    preferences.remember(Path::new("/data/gone.mp4"));
    preferences.remember(folder.path());
    begin(&mut window, &ViewerInput::Start);
    assert!(window.harness.state().shared.open.is_none());
    for offered in ["Open a video or a file…", "Open a folder of frames…", "See the demo", "gone.mp4"] {
        assert!(window.shows(offered), "{offered}");
    }
    window.until_shown("not there any more");
    let name = folder.path().file_name().unwrap().to_string_lossy().into_owned();
    window.harness.get_by_label_contains(&name).click();
    window.until(|app| app.open.is_some());
    assert!(!window.shows("Demo: a made-up recording"));
}

#[test]
fn work_left_unsaved_is_on_the_start_page() {
    let folder = tempfile::tempdir().unwrap();
    let mut session = Session::new("/data/clip.safetensors".into());
    session.content.bookmarks = vec![Bookmark::default()];
    session.save(&folder.path().join("0.surgtpgs")).unwrap();
    let mut window = unopened();
    window.harness.state_mut().shared.saving.autosave = Autosave::open(Some(folder.path().to_owned()));
    begin(&mut window, &ViewerInput::Start);
    assert!(window.harness.state().shared.open.is_none(), "work that waits is shown before the demo");
    assert!(window.shows("clip: 1 bookmark"));
    window.click("Restore");
    window.until(|app| app.saving.to_apply.is_none() && app.document.bookmarks().len() == 1);
}

#[test]
fn without_a_file_dialog_the_window_asks_itself() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::create_dir(folder.path().join("clips")).unwrap();
    std::fs::write(folder.path().join("clips/own.mp4"), "").unwrap();
    std::fs::write(folder.path().join("clips/notes.txt"), "").unwrap();
    let mut window = unopened();
    window.press_with(Modifiers::COMMAND, Key::O);
    window.until(|app| app.opening.asked.is_some());
    let shared = &mut window.harness.state_mut().shared;
    let ask = shared.opening.asked.take().unwrap();
    window.harness.step();
    // Once more, in a folder that the test knows.
    let ask = PathAsk { folder: Some(folder.path().to_owned()), ..ask };
    window.harness.state_mut().shared.opening.asked = Some(ask);
    window.until_shown("clips/");
    (0..3).for_each(|_| window.harness.step());
    window.click("clips/");
    window.until_shown("own.mp4");
    assert!(!window.shows("notes.txt"), "what cannot be opened is not offered");
    window.click("own.mp4");
    window.until(|app| app.info().is_some_and(|i| i.path.ends_with("clips/own.mp4")));
    assert!(window.harness.state().shared.opening.asked.is_none());
    window.press_with(Modifiers::COMMAND, Key::O);
    window.until(|app| app.opening.asked.is_some());
    let asked = window.harness.state().shared.opening.asked.clone();
    assert_eq!(asked.unwrap().folder, Some(folder.path().join("clips")), "beside what is open");
}

#[test]
fn a_session_can_be_saved_without_a_file_dialog_and_the_window_says_where() {
    let folder = tempfile::tempdir().unwrap();
    let mut window = Window::on(Info { output_folder: folder.path().to_owned(), ..scene() });
    window.add_prompt("liver");
    window.press_with(Modifiers::COMMAND, Key::S);
    window.until(|app| app.opening.asked.is_some());
    (0..3).for_each(|_| window.harness.step());
    window.click("Save");
    window.harness.step();
    assert!(window.shows("Saved as clip.surgtpgs"));
    assert!(Session::load(&folder.path().join("clip.surgtpgs")).is_ok());
    window.press_with(Modifiers::COMMAND | Modifiers::SHIFT, Key::S);
    window.until(|app| app.opening.asked.is_some());
    let ask = window.harness.state().shared.opening.asked.clone().unwrap();
    assert_eq!(ask.kind, PathKind::Save("clip-2.surgtpgs".into(), "Sessions"), "what is free is offered");
}

#[test]
fn a_path_is_typed_as_soon_as_the_window_asks_for_it() {
    let folder = tempfile::tempdir().unwrap();
    let mut window = Window::on(Info { output_folder: folder.path().to_owned(), ..scene() });
    window.add_prompt("liver");
    let ask = |window: &mut Window, key| {
        window.press_with(Modifiers::COMMAND, key);
        window.until(|app| app.opening.asked.is_some());
        (0..3).for_each(|_| window.harness.step());
        assert!(window.harness.get_by_label("Path").is_focused());
    };
    let type_text = |window: &mut Window, text: &str| {
        window.harness.event(egui::Event::Text(text.into()));
        (0..2).for_each(|_| window.harness.step());
    };
    ask(&mut window, Key::S);
    type_text(&mut window, "review");
    window.press(Key::Enter);
    window.until_shown("Saved as review.surgtpgs");
    assert!(Session::load(&folder.path().join("review.surgtpgs")).is_ok());
    ask(&mut window, Key::O);
    type_text(&mut window, "/own.mp4");
    let typed = window.harness.get_by_label("Path").value();
    assert_eq!(typed.as_deref(), Some("/data/own.mp4"), "behind the folder");
}

#[test]
fn a_session_is_not_saved_over_a_file_that_the_dialog_did_not_ask_about() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("op.2024.surgtpgs");
    std::fs::write(&file, "of yesterday").unwrap();
    let mut window = Window::on(scene());
    window.add_prompt("liver");
    let save_as = |window: &mut Window, name: &str| {
        *window.backend.picked.lock().unwrap() = Some(Picked::Path(folder.path().join(name)));
        window.press_with(Modifiers::COMMAND | Modifiers::SHIFT, Key::S);
        window.until(|app| app.opening.picking.is_none());
    };
    save_as(&mut window, "op.2024");
    assert!(window.shows("is there already") && window.harness.state().shared.is_unsaved());
    assert_eq!(std::fs::read_to_string(&file).unwrap(), "of yesterday");
    save_as(&mut window, "op.2024.surgtpgs");
    assert!(Session::load(&file).is_ok(), "the dialog asked about this name");
    assert_eq!(window.harness.state().shared.problem, None, "it is saved after all");
    save_as(&mut window, "op.2024");
    assert!(window.shows("Saved as op.2024.surgtpgs"), "it is the session's own file");
}

#[test]
fn what_the_systems_dialog_returns_is_opened_and_closing_it_does_nothing() {
    let mut window = unopened();
    *window.backend.picked.lock().unwrap() = Some(Picked::Nothing);
    window.click("Open a video or a file…");
    window.until(|app| app.opening.picking.is_none());
    assert!(window.harness.state().shared.opening.asked.is_none());
    *window.backend.picked.lock().unwrap() = Some(Picked::Path("/data/clip.mp4".into()));
    window.click("Open a video or a file…");
    window.until(|app| app.info().is_some_and(|i| i.path == Path::new("/data/clip.mp4")));
}

#[test]
fn the_start_page_stays_though_something_was_being_opened() {
    let mut window = Window::on(scene());
    let ctx = window.harness.ctx.clone();
    let opens: [fn(&mut Shared, &egui::Context); 2] = [
        |shared, ctx| shared.open_path(Path::new("/data/other.safetensors"), ctx),
        |shared, ctx| shared.open_demo(ctx),
    ];
    for begin in opens {
        let shared = &mut window.harness.state_mut().shared;
        shared.opening.demo_folder = Some("/data/demo".into());
        shared.open_path(Path::new("/data/clip.safetensors"), &ctx);
        window.until(|app| app.open.is_some() && app.opening.underway.is_none());
        let shared = &mut window.harness.state_mut().shared;
        begin(shared, &ctx);
        shared.run(Command::StartPage.into(), &ctx);
        for _ in 0..50 {
            window.harness.step();
            std::thread::sleep(std::time::Duration::from_millis(1));
        }
        let shared = &window.harness.state().shared;
        assert!(shared.open.is_none() && shared.opening.waiting_for().is_none());
    }
}

#[test]
fn the_start_page_is_one_command_away_and_loses_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let mut window = Window::on(scene());
    window.harness.state_mut().shared.saving.autosave = Autosave::open(Some(folder.path().to_owned()));
    window.add_prompt("liver");
    window.press(Key::Space);
    assert!(window.harness.state().shared.playback.is_playing());
    let ctx = window.harness.ctx.clone();
    window.harness.state_mut().shared.run(Command::StartPage.into(), &ctx);
    (0..3).for_each(|_| window.harness.step());
    let app = &window.harness.state().shared;
    assert!(app.open.is_none() && !app.playback.is_playing());
    assert!(window.shows("Open a video or a file…") && window.shows("clip: 1 prompt, at frame"));
    window.click("Restore");
    window.until(|app| app.document.prompts().len() == 1);
}
