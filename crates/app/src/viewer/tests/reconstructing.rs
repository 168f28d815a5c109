//! What can be seen and done while a recording is reconstructed.

use super::*;

fn training() -> Window {
    let recording = Info { has_reconstruction: false, has_features: false, has_labels: true, ..scene() };
    let mut window = Window::on(recording);
    window.click("Reconstruct…");
    window.click("Start");
    window.until(|app| app.document.mode == ViewMode::SideBySide);
    window
}

#[test]
fn the_loss_and_its_terms_are_a_curve_while_it_learns() {
    let mut window = training();
    window.until_shown("Loss over the steps, now total");
    // Terms that this training does not have are not shown.
    assert!(window.shows("colour") && window.shows("depth") && !window.shows("words 0"));
}

#[test]
fn previews_can_be_rarer_or_off() {
    let mut window = training();
    let seconds = |window: &Window| window.harness.state().training.as_ref().unwrap().job.preview_seconds();
    assert_eq!(seconds(&window), 4);
    window.click("20 s");
    assert_eq!(seconds(&window), 20);
    window.click("off");
    assert_eq!(seconds(&window), 0);
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

fn bare() -> Info {
    Info { has_reconstruction: false, has_features: false, has_labels: true, ..scene() }
}

#[test]
fn a_recording_is_checked_when_it_is_opened_and_its_masks_can_be_flipped() {
    let inverted = Report {
        ok: false,
        frames: 48,
        warnings: vec!["Masks hide 94 % of the frames on average; they are probably inverted.".into()],
        errors: vec!["Nothing of frame 1 is left to learn from".into()],
        ..Report::default()
    };
    let checked = Mutex::new(Checked { report: inverted, can_flip: true });
    let backend = Arc::new(FakeBackend { info: bare(), checked, ..Default::default() });
    let mut window = Window::with(backend);
    window.harness.state_mut().preferences.is_acknowledged = true;
    let ctx = window.harness.ctx.clone();
    window.harness.state_mut().open_path(Path::new("/data/recording"), &ctx);
    window.until(|app| app.import_check.as_ref().is_some_and(|c| c.has_errors()));
    assert!(window.shows("A reconstruction would be wrong") && window.shows("probably inverted"));
    window.click("Reconstruct…");
    assert!(window.harness.state().train_dialog.is_none(), "nobody is led into it");
    window.click("Flip the masks");
    window.until(|app| app.open.is_some() && app.is_enabled(crate::viewer::command::Command::Reconstruct));
    window.until_shown("This recording can be reconstructed");
    assert!(window.shows("This recording can be reconstructed") && !window.shows("probably inverted"));
    window.click("Reconstruct…");
    assert!(window.harness.state().train_dialog.is_some());
}

#[test]
fn a_reconstruction_is_not_checked_again() {
    let window = Window::on(scene());
    assert!(window.harness.state().import_check.is_none());
}
