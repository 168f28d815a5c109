//! Tests that measure a reconstruction against its recording.

use super::*;

#[test]
fn classes_and_frames_are_measured_saved_and_gone_to() {
    let folder = tempfile::tempdir().unwrap();
    let mut window = Window::on(Info { output_folder: folder.path().to_owned(), ..scene() });
    window.press_with(Modifiers::COMMAND, Key::M);
    window.until(|app| app.dialog == Some(Dialog::Quality));
    window.until_shown("2 frames that the training did not see");
    // Means over both frames. Half of the liver is found on one, and some on the other, where there is none.
    for text in ["35.00 dB", "30.00 dB", "0.875", "liver", "0.500", "0.667", "40.00 dB"] {
        assert!(window.shows(text), "{text}");
    }
    // Another program takes the offered name.
    std::fs::create_dir(folder.path().join("clip-quality")).unwrap();
    std::fs::write(folder.path().join("clip-quality/notes.txt"), "mine").unwrap();
    window.click("Save tables");
    window.until_shown("The folder is not empty");
    window.click("Save tables");
    window.until_shown("Saved in");
    let saved = folder.path().join("clip-quality-2");
    let classes = std::fs::read_to_string(saved.join("classes.csv")).unwrap();
    assert!(classes.contains("threshold,0,liver,2,1,1,4,0.5,"), "{classes}");
    assert!(saved.join("frames.csv").is_file() && saved.join("eval.json").is_file());
    window.click("Frame 9");
    window.until_picture(|p| p.request.view.frame == 8);
    assert!(window.harness.state().shared.dialog != Some(Dialog::Quality), "the sheet is out of the way");
}

#[test]
fn what_was_measured_stays_as_long_as_the_same_is_open() {
    let mut window = Window::on(scene());
    let measured = "2 frames that the training did not see";
    let measure = |window: &mut Window, times: usize| {
        window.press_with(Modifiers::COMMAND, Key::M);
        window.until_shown(measured);
        assert_eq!(window.backend.num_measured.load(Ordering::Relaxed), times);
    };
    measure(&mut window, 1);
    window.click("Frame 9");
    measure(&mut window, 1);
    let close = |window: &mut Window| {
        window.press(Key::Escape);
        window.harness.step();
        assert_eq!(window.harness.state().shared.dialog, None);
    };
    close(&mut window);
    window.harness.state_mut().shared.document.toggle_excluded(3, 5);
    measure(&mut window, 2);
    close(&mut window);
    let ctx = window.harness.ctx.clone();
    window.harness.state_mut().shared.open_path(Path::new("/data/other.safetensors"), &ctx);
    window.until(|app| app.info().is_some_and(|i| i.path.ends_with("other.safetensors")));
    measure(&mut window, 3);
}

#[test]
fn frames_that_are_left_out_are_not_measured() {
    let mut window = Window::on(scene());
    window.harness.state_mut().shared.document.toggle_excluded(3, 5);
    window.press_with(Modifiers::COMMAND, Key::M);
    window.until_shown("2 frames that the training did not see");
    assert_eq!(*window.backend.unmeasured.lock().unwrap(), [(3, 5)]);
}

#[test]
fn the_psnr_of_training_frames_is_told_beside_that_of_others_alone() {
    let mut window = Window::on(scene());
    let ctx = window.harness.ctx.clone();
    for (scene, is_told) in [("/data/clip.safetensors", true), ("/data/all-learned", false)] {
        window.harness.state_mut().shared.open_path(Path::new(scene), &ctx);
        window.until(|app| app.info().is_some_and(|i| i.path == Path::new(scene)));
        window.press_with(Modifiers::COMMAND, Key::M);
        window.until_shown("A blend of the frames around");
        assert_eq!(window.shows("PSNR of training frames"), is_told, "{scene}");
        window.press(Key::Escape);
        window.harness.step();
    }
}

#[test]
fn what_cannot_be_measured_is_said_and_nothing_is_kept_of_another_recording() {
    let mut window = Window::on(scene());
    let ctx = window.harness.ctx.clone();
    window.harness.state_mut().shared.open_path(Path::new("/data/gone"), &ctx);
    window.until(|app| app.info().is_some_and(|i| i.path.ends_with("gone")));
    window.press_with(Modifiers::COMMAND, Key::M);
    window.until(|app| app.problem.is_some());
    assert!(window.shows("The recording is not at hand"));
    assert!(window.harness.state().shared.dialog != Some(Dialog::Quality));

    let mut bare = Window::on(Info { has_original: false, ..scene() });
    bare.press_with(Modifiers::COMMAND, Key::M);
    assert!(
        bare.harness.state().shared.dialog != Some(Dialog::Quality),
        "there is nothing to measure against"
    );
}
