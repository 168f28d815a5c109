//! Tests of sessions, undo, recovery and bookmarks.

use super::*;
use crate::viewer::state::{
    content::{Bookmark, Content},
    session::Session,
};

/// Opens a window on the scene of the tests that keeps its work in `folder`.
fn keeping(folder: &Path) -> Window {
    keeping_on(scene(), folder)
}

/// Opens a window that keeps its work in `folder`; what is opened in it is as `info` says.
pub(super) fn keeping_on(info: Info, folder: &Path) -> Window {
    let backend = Arc::new(FakeBackend { info, ..Default::default() });
    let theirs = backend.clone();
    let autosave = Autosave::open(Some(folder.to_owned()));
    let harness = Harness::builder()
        .with_size(egui::vec2(1280.0, 800.0))
        .with_step_dt(1.0 / 60.0)
        .build_eframe(|cc| Shell::new(&cc.egui_ctx, theirs, Preferences::load(None), autosave));
    let mut window = Window { harness, backend };
    window.harness.state_mut().shared.preferences.is_acknowledged = true;
    // A dialog is measured before it is shown.
    window.harness.step();
    window
}

pub(super) fn open(window: &mut Window, path: &Path) {
    let ctx = window.harness.ctx.clone();
    window.harness.state_mut().shared.open_path(path, &ctx);
    window.until(|app| {
        app.opening.underway.is_none() && app.picture().is_some() && app.saving.to_apply.is_none()
    });
}

/// Makes a short review: two prompts, one of them hidden, a threshold, a bookmark with a note, a range, a
/// frame and a view.
fn review(window: &mut Window) {
    window.press(Key::W);
    window.press(Key::O);
    window.add_prompt("gallbladder");
    window.add_prompt("liver");
    window.press(Key::Num2);
    window.press_with(Modifiers::SHIFT, Key::T);
    window.press(Key::End);
    window.press_with(Modifiers::SHIFT, Key::I);
    window.press_with(Modifiers::SHIFT, Key::ArrowLeft);
    window.press(Key::I);
    window.press(Key::M);
    let frame = window.frame();
    window.harness.state_mut().shared.document.set_note(frame, "bleeding?");
}

#[test]
fn after_a_kill_everything_is_offered_again_and_comes_back() {
    let folder = tempfile::tempdir().unwrap();
    let mut window = keeping(folder.path());
    open(&mut window, Path::new("/data/clip.safetensors"));
    review(&mut window);
    let kept = folder.path().join("0.surgtpgs");
    window.until(|app| Session::load(&kept).is_ok_and(|kept| kept.content.is_alike(app.document.content())));
    let before = window.harness.state().shared.session().unwrap();
    // Dropped without the program's own ending, as if it were killed: the system frees all that it held.
    drop(window);

    let mut window = keeping(folder.path());
    window.harness.step();
    assert!(window.shows("Your last work was not saved"));
    assert!(window.shows("clip: 2 prompts, 1 bookmark"));
    window.click("Restore");
    window.until(|app| app.picture().is_some() && app.saving.to_apply.is_none());
    let after = window.harness.state().shared.session().unwrap();
    assert!(after.content.is_alike(&before.content));
    assert_eq!(after.content.bookmarks[0].note, "bleeding?");
    assert_eq!(after.display, before.display);
    assert_eq!(after.time.frame, FRAMES - 11);
    assert!(window.harness.state().shared.is_unsaved(), "a restored session is still in no file");
    let mut files = std::fs::read_dir(folder.path()).unwrap().map(|f| f.unwrap().path());
    assert!(files.any(|f| Session::load(&f).is_ok()), "and stays kept");
}

#[test]
fn unsaved_work_waits_until_its_recording_is_opened_again() {
    let folder = tempfile::tempdir().unwrap();
    let mut window = keeping(folder.path());
    let (clip, other) = (Path::new("/data/clip.safetensors"), Path::new("/elsewhere/other.safetensors"));
    open(&mut window, clip);
    review(&mut window);
    let before = window.harness.state().shared.session().unwrap();
    open(&mut window, other);
    let app = &window.harness.state().shared;
    assert!(!window.shows("Your last work was not saved"), "not now");
    assert!(app.document.content().is_alike(&Content::default()), "prompts stay with their recording");
    open(&mut window, clip);
    window.until_shown("Your work on this recording is back");
    let after = window.harness.state().shared.session().unwrap();
    assert!(after.content.is_alike(&before.content));

    // Opening a session replaces all of the content.
    let file = folder.path().join("empty.surgtpgs");
    Session::new(clip.into()).save(&file).unwrap();
    open(&mut window, &file);
    assert!(window.harness.state().shared.document.prompts().is_empty());
    drop(window);
    let mut window = keeping(folder.path());
    window.harness.step();
    assert!(window.shows("clip: 2 prompts, 1 bookmark"));
}

#[test]
fn a_session_of_a_recording_that_has_changed_opens_and_says_so() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("review.surgtpgs");
    let info = |sum: &str| Info { frames_sha256: Some(sum.into()), ..scene() };
    let mut window = Window::on(info("one"));
    window.press(Key::M);
    window.harness.state().shared.session().unwrap().save(&file).unwrap();
    for (sum, is_said) in [("one", false), ("two", true)] {
        let mut window = Window::on(info(sum));
        open(&mut window, &file);
        window.harness.step();
        assert_eq!(window.shows("The recording is not as it was"), is_said, "{sum}");
        let shared = &window.harness.state().shared;
        assert_eq!(shared.document.bookmarks().len(), 1);
        assert_eq!(shared.saving.saved.file.is_none(), is_said, "what does not fit stays in the file");
    }
}

#[test]
fn work_that_cannot_be_kept_is_said_with_what_to_do() {
    let folder = tempfile::tempdir().unwrap();
    let place = folder.path().join("unsaved");
    let mut window = keeping(&place);
    open(&mut window, Path::new("/data/clip.safetensors"));
    std::fs::remove_dir_all(&place).unwrap();
    std::fs::write(&place, "no folder").unwrap();
    window.press(Key::M);
    window.until(|app| app.problem.is_some());
    window.harness.step();
    assert!(window.shows("cannot be kept safe") && window.shows("Save the session elsewhere"));
    assert!(window.harness.state().shared.is_unsaved());

    // The folder cannot even be made.
    let mut window = keeping(&place);
    open(&mut window, Path::new("/data/clip.safetensors"));
    window.press(Key::M);
    window.until(|app| app.problem.is_some());
    window.harness.step();
    assert!(window.shows("cannot be kept safe"));
    open(&mut window, Path::new("/elsewhere/other.safetensors"));
    open(&mut window, Path::new("/data/clip.safetensors"));
    window.until_shown("Your work on this recording is back");
}

#[test]
fn a_save_that_failed_is_a_problem_until_one_succeeds() {
    let folder = tempfile::tempdir().unwrap();
    let no_folder = folder.path().join("file");
    std::fs::write(&no_folder, "no folder").unwrap();
    let (bad, good) = (no_folder.join("review.surgtpgs"), folder.path().join("review.surgtpgs"));
    let mut window = Window::on(scene());
    window.press(Key::M);
    window.harness.state_mut().shared.write_session(&bad, 0.0);
    (0..2).for_each(|_| window.harness.step());
    assert!(window.shows(&format!("The session could not be written into {}", no_folder.display())));
    assert!(window.shows("Save the session in another folder."));
    let shared = &mut window.harness.state_mut().shared;
    shared.write_session(&good, 0.0);
    assert_eq!(shared.problem, None);
    shared.write_session(&bad, 0.0);
    shared.problem = Some("something else".into());
    shared.write_session(&good, 0.0);
    assert_eq!(shared.problem.as_deref(), Some("something else"));
    shared.write_marks(&bad, 0.0);
    shared.write_session(&good, 0.0);
    assert!(shared.problem.as_ref().is_some_and(|problem| problem.starts_with("The marks could not be")));
}

#[test]
fn what_was_left_can_be_discarded_or_put_off() {
    let folder = tempfile::tempdir().unwrap();
    Session::new("/data/clip.safetensors".into()).save(&folder.path().join("0.surgtpgs")).unwrap();
    let mut window = keeping(folder.path());
    window.harness.step();
    assert!(window.shows("Your last work was not saved"), "whoever does not answer is asked again");
    drop(window);
    let mut window = keeping(folder.path());
    window.harness.step();
    window.click("Discard");
    assert!(!window.shows("Your last work was not saved"));
    assert!(!folder.path().join("0.surgtpgs").exists());
}

/// Returns a session of a recording, with a number of bookmarks.
pub(super) fn bookmarked(opened: &str, count: usize) -> Session {
    let bookmark = |frame| Bookmark { frame, ..Bookmark::default() };
    let content = Content { bookmarks: (0..count).map(bookmark).collect(), ..Content::default() };
    Session { content, ..Session::new(opened.into()) }
}

#[test]
fn work_whose_recording_is_gone_is_kept_until_it_is_back() {
    let folder = tempfile::tempdir().unwrap();
    let kept = folder.path().join("0.surgtpgs");
    bookmarked("/no/such", 2).save(&kept).unwrap();
    let mut window = keeping(folder.path());
    window.harness.step();
    window.click("Restore");
    window.until(|app| app.problem.is_some());
    assert!(window.shows("There is no such file") && window.shows("put the recording back"));
    assert!(window.shows("such: 2 bookmarks"), "it is still offered");
    // Neither what is opened instead nor unsaved work on that takes its place.
    open(&mut window, Path::new("/data/clip.safetensors"));
    assert_eq!(Session::load(&kept).unwrap().content.bookmarks.len(), 2);
    window.press(Key::M);
    window.until(|_| folder.path().join("1.surgtpgs").exists());
    window.harness.state_mut().shared.saving.is_recovery_put_off = false;
    (0..2).for_each(|_| window.harness.step());
    assert!(!window.shows("Your last work was not saved"), "it is about another recording");
    let ctx = window.harness.ctx.clone();
    let shared = &mut window.harness.state_mut().shared;
    let id = shared.saving.autosave.left[0].id;
    shared.restore(id, &ctx);
    window.until(|app| app.problem.is_some());
    assert!(!window.shows("Your last work was not saved"), "not at once again");
    assert_eq!(window.harness.state().shared.document.bookmarks().len(), 1, "what was open stays");
    drop(window);
    let left = Autosave::open(Some(folder.path().to_owned())).left;
    let mut counts: Vec<_> = left.iter().map(|left| left.session.content.bookmarks.len()).collect();
    counts.sort_unstable();
    assert_eq!(counts, [1, 2]);
}

#[test]
fn each_of_several_works_on_one_recording_can_be_restored_or_discarded() {
    let folder = tempfile::tempdir().unwrap();
    for count in 1..=3 {
        let file = folder.path().join(format!("{count}.surgtpgs"));
        bookmarked("/data/clip.safetensors", count).save(&file).unwrap();
    }
    let mut window = keeping(folder.path());
    window.harness.step();
    let count = |window: &Window, row: usize| {
        window.harness.state().shared.saving.autosave.left[row].session.content.bookmarks.len()
    };
    let click = |window: &mut Window, label: &str, row: usize| {
        window.harness.get_all_by_label(label).nth(row).unwrap().click();
        (0..3).for_each(|_| window.harness.step());
    };
    let (discarded, restored) = (count(&window, 1), count(&window, 2));
    click(&mut window, "Discard", 1);
    assert!(!folder.path().join(format!("{discarded}.surgtpgs")).exists());
    click(&mut window, "Restore", 1);
    window.until(|app| app.picture().is_some() && app.saving.to_apply.is_none());
    assert_eq!(window.harness.state().shared.document.bookmarks().len(), restored);
    assert_eq!(window.harness.state().shared.saving.autosave.left.len(), 1);
}

#[test]
fn unsaved_work_is_not_replaced_by_earlier_work_on_its_recording() {
    let folder = tempfile::tempdir().unwrap();
    let mut window = keeping(folder.path());
    let (clip, again) = (Path::new("/data/clip.safetensors"), Path::new("/data/again.safetensors"));
    open(&mut window, clip);
    window.press(Key::M);
    open(&mut window, Path::new("/elsewhere/other.safetensors"));
    // Another file of the same recording.
    open(&mut window, again);
    review(&mut window);
    let before = window.harness.state().shared.session().unwrap();
    open(&mut window, clip);
    let after = window.harness.state().shared.session().unwrap();
    assert!(after.content.is_alike(&before.content));
    window.until_shown("Your last work was not saved");
    window.click("Restore");
    window.until(|app| app.saving.to_apply.is_none() && app.document.prompts().is_empty());
    let left = &window.harness.state().shared.saving.autosave.left;
    assert!(left[0].session.content.is_alike(&before.content), "it is put aside in turn");
}

#[test]
fn a_saved_session_opens_as_it_was_and_needs_no_recovery() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("review.surgtpgs");
    let mut window = keeping(&folder.path().join("unsaved"));
    open(&mut window, Path::new("/data/clip.safetensors"));
    review(&mut window);
    window.harness.state_mut().shared.write_session(&file, 0.0);
    let before = window.harness.state().shared.session().unwrap();
    assert!(!window.harness.state().shared.is_unsaved());
    window.until(|_| !folder.path().join("unsaved/0.surgtpgs").exists());
    window.press_with(Modifiers::COMMAND | Modifiers::SHIFT, Key::M);
    assert!(window.harness.state().shared.is_unsaved());
    // With a file chosen, saving asks nothing.
    window.press_with(Modifiers::COMMAND, Key::S);
    window.press_with(Modifiers::COMMAND, Key::Z);
    window.press_with(Modifiers::COMMAND, Key::S);
    assert!(!window.harness.state().shared.is_unsaved());
    drop(window);

    let mut window = keeping(&folder.path().join("unsaved"));
    window.harness.step();
    assert!(!window.shows("Your last work was not saved"));
    open(&mut window, &file);
    let after = window.harness.state().shared.session().unwrap();
    assert!(after.content.is_alike(&before.content));
    assert_eq!(after.display, before.display);
    assert_eq!(window.harness.state().shared.playback.range(), before.content.range);
    assert!(!window.harness.state().shared.is_unsaved());
    assert_eq!(window.harness.state().shared.preferences.recent, [file]);
}

#[test]
fn a_session_is_not_saved_over_what_another_window_saved_in_its_file() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("review.surgtpgs");
    let [mut window, mut other] = [(); 2].map(|()| Window::on(scene()));
    window.press(Key::M);
    window.harness.state_mut().shared.write_session(&file, 0.0);
    open(&mut other, &file);
    other.add_prompt("liver");
    other.press_with(Modifiers::COMMAND, Key::S);
    assert!(!other.harness.state().shared.is_unsaved());
    let theirs = std::fs::read_to_string(&file).unwrap();

    window.add_prompt("fat");
    window.press_with(Modifiers::COMMAND, Key::S);
    window.until(|app| app.opening.asked.is_some());
    let shared = &window.harness.state().shared;
    let problem = shared.problem.as_deref().unwrap();
    assert!(problem.starts_with("review.surgtpgs was changed elsewhere since"), "{problem}");
    assert!(shared.is_unsaved());
    (0..3).for_each(|_| window.harness.step());
    window.click("Save");
    window.until_shown("Saved as review-2.surgtpgs");
    assert_eq!(std::fs::read_to_string(&file).unwrap(), theirs);
    let shared = &window.harness.state().shared;
    assert!(shared.problem.is_none() && !shared.is_unsaved());
}

#[test]
fn saved_work_comes_back_with_its_recording() {
    let folder = tempfile::tempdir().unwrap();
    let of = |frames: &str| Info {
        frames_sha256: Some(frames.into()),
        output_folder: folder.path().into(),
        ..scene()
    };
    let mut window = Window::on(of("one"));
    window.press(Key::M);
    let file = folder.path().join("review.surgtpgs");
    window.harness.state_mut().shared.write_session(&file, 0.0);
    std::fs::write(folder.path().join("broken.surgtpgs"), "{").unwrap();
    drop(window);
    for (frames, is_back) in [("one", true), ("two", false)] {
        let window = Window::on(of(frames));
        let shared = &window.harness.state().shared;
        assert_eq!(shared.document.bookmarks().len(), usize::from(is_back), "{frames}");
        assert_eq!(shared.saving.saved.file, is_back.then(|| file.clone()));
        assert_eq!(window.shows("Your saved work on this recording is back: review.surgtpgs"), is_back);
    }
}

#[test]
fn closing_the_window_keeps_the_work_unless_nothing_shall_be_remembered() {
    for (remembers, is_kept) in [(true, true), (false, false)] {
        let folder = tempfile::tempdir().unwrap();
        let mut window = keeping(folder.path());
        open(&mut window, Path::new("/data/clip.safetensors"));
        window.harness.state_mut().shared.preferences.forget_files(remembers);
        review(&mut window);
        open(&mut window, Path::new("/elsewhere/other.safetensors"));
        window.press(Key::M);
        window.until(|_| folder.path().join("1.surgtpgs").exists());
        window.harness.state_mut().shared.keep_at_exit();
        for put_aside_or_open in ["0.surgtpgs", "1.surgtpgs"] {
            assert_eq!(folder.path().join(put_aside_or_open).exists(), is_kept);
        }
    }
}

#[test]
fn recordings_of_one_name_and_length_in_two_places_are_two() {
    let at = |place: &str| Info { sequence: Some(place.into()), ..scene() };
    assert!(!at("/patient-1/video.mp4").is_same_recording(&at("/patient-2/video.mp4")));
    assert!(
        at("/patient-1/video.mp4")
            .is_same_recording(&Info { name: "scene".into(), ..at("/patient-1/video.mp4") })
    );
    assert!(at("/patient-1/video.mp4").is_same_recording(&scene()), "nobody knows where this one was");
    let of = |frames: &str, place: &str| Info { frames_sha256: Some(frames.into()), ..at(place) };
    let video = of("one", "/patient-1/video.mp4");
    assert!(!video.is_same_recording(&of("two", "/patient-1/video.mp4")), "others of its frames");
    assert!(video.is_same_recording(&of("one", "/moved/video.mp4")));
    assert!(!at("/a.mp4").is_same_recording(&Info { num_frames: FRAMES / 2, ..at("/a.mp4") }));
}

#[test]
fn frames_of_the_same_sizes_in_two_files_are_two_recordings() {
    let folder = tempfile::tempdir().unwrap();
    let [a, b, gone] = ["a.dcm", "b.dcm", "gone.dcm"].map(|name| folder.path().join(name));
    [&a, &b].into_iter().for_each(|file| std::fs::write(file, "").unwrap());
    let of = |place: &Path, spots: Option<&str>| Info {
        path: place.to_owned(),
        sequence: Some(place.to_owned()),
        frames_sha256: Some("sizes".into()),
        spots_sha256: spots.map(str::to_owned),
        ..scene()
    };
    for (one, other, is_same) in [
        (of(&a, None), of(&b, None), false),
        (of(&a, Some("x")), of(&b, None), false),
        (of(&gone, None), of(&b, None), true),
        (of(&a, Some("x")), of(&b, Some("x")), true),
        (of(&gone, Some("x")), of(&b, Some("y")), false),
        (of(&a, Some("x")), of(&a, Some("y")), false),
    ] {
        assert_eq!(one.is_same_recording(&other), is_same, "{one:?} {other:?}");
        let Info { frames_sha256: recording, spots_sha256: spots, sequence, .. } = one;
        // It was made on a reconstruction.
        let session = Session { recording, spots, sequence, ..Session::new("/data/a.safetensors".into()) };
        assert_eq!(session.is_about(&other), is_same, "{session:?} {other:?}");
    }
    // An older session knows what was opened alone.
    let older = Session { recording: Some("sizes".into()), ..Session::new(a.clone()) };
    assert!(older.is_about(&of(&a, Some("x"))) && !older.is_about(&of(&b, Some("x"))));
}

#[test]
fn what_was_opened_from_a_folder_is_found_from_any_other() {
    let folder = tempfile::tempdir().unwrap();
    let mut window = keeping(folder.path());
    open(&mut window, Path::new("clip.safetensors"));
    let here = std::env::current_dir().unwrap().join("clip.safetensors");
    let app = &window.harness.state().shared;
    assert_eq!(app.session().unwrap().opened, here);
    assert_eq!(app.preferences.recent, [here]);
}

#[test]
fn a_session_whose_recording_is_gone_says_so() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("review.surgtpgs");
    Session::new("/no/such".into()).save(&file).unwrap();
    let mut window = keeping(&folder.path().join("unsaved"));
    let ctx = window.harness.ctx.clone();
    window.harness.state_mut().shared.open_path(&file, &ctx);
    window.until(|app| app.problem.is_some());
    assert!(window.shows("There is no such file"));
}

#[test]
fn menus_name_what_undo_would_undo() {
    let mut window = Window::on(scene());
    window.add_prompt("gallbladder");
    window.click("Edit");
    assert!(window.shows("Undo adding \"gallbladder\""));
    window.press(Key::Escape);
    window.press(Key::M);
    window.press_with(Modifiers::COMMAND, Key::Z);
    assert!(window.harness.state().shared.document.bookmarks().is_empty());
    window.click("Edit");
    assert!(window.shows("Redo a bookmark at frame 1"));
}

#[test]
fn a_range_set_by_keys_is_played_and_undone() {
    let mut window = Window::on(scene());
    window.press_with(Modifiers::SHIFT, Key::ArrowRight);
    window.press(Key::I);
    window.press_with(Modifiers::SHIFT, Key::ArrowRight);
    window.press_with(Modifiers::SHIFT, Key::I);
    window.harness.step();
    assert_eq!(window.harness.state().shared.playback.bounds(), (10, 20));
    window.press_with(Modifiers::ALT, Key::I);
    window.harness.step();
    assert_eq!(window.harness.state().shared.playback.bounds(), (0, FRAMES - 1));
    window.press_with(Modifiers::COMMAND, Key::Z);
    window.harness.step();
    assert_eq!(window.harness.state().shared.playback.bounds(), (10, 20));
}

#[test]
fn bookmarks_are_set_walked_and_described() {
    let mut window = Window::on(scene());
    for _ in 0..3 {
        window.press_with(Modifiers::SHIFT, Key::ArrowRight);
        window.press(Key::M);
    }
    window.press_with(Modifiers::COMMAND, Key::ArrowLeft);
    assert_eq!(window.frame(), 20);
    window.press_with(Modifiers::COMMAND, Key::ArrowLeft);
    window.press_with(Modifiers::COMMAND, Key::ArrowLeft);
    assert_eq!(window.frame(), 10, "before the first there is none");
    window.press_with(Modifiers::COMMAND, Key::ArrowRight);
    assert_eq!(window.frame(), 20);
    window.press_with(Modifiers::SHIFT, Key::M);
    window.harness.step();
    window.type_into("Note on frame 21", "clip applied");
    window.click("Flag frame 21");
    let bookmark = window.harness.state().shared.document.bookmarks()[1].clone();
    assert_eq!((bookmark.note.as_str(), bookmark.is_flagged), ("clip applied", true));
    window.click("Delete the bookmark at frame 31");
    assert_eq!(window.harness.state().shared.document.bookmarks().len(), 2);
}

#[test]
fn a_prompt_gets_other_words_another_colour_and_another_place() {
    let mut window = Window::on(scene());
    window.add_prompt("gallbladder");
    window.add_prompt("liver");
    window.click("More about liver");
    window.click("Move up");
    window.click("Colour 5 for liver");
    window.type_into("Words of liver", " lobe");
    window.press(Key::Enter);
    let first = window.harness.state().shared.document.prompts()[0].clone();
    assert!(first.text.contains("lobe") && first.text.contains("liver"), "{}", first.text);
    assert_eq!(first.colour, crate::settings::PROMPT_COLOURS[4]);
}

#[test]
fn words_that_another_prompt_has_are_refused_and_the_window_says_so() {
    let mut window = Window::on(scene());
    window.add_prompt("pa");
    window.add_prompt("papa");
    window.click("More about pa");
    window.type_into("Words of pa", "pa");
    window.press(Key::Enter);
    window.until_shown("There is a prompt \"papa\" already");
    assert_eq!(window.harness.state().shared.document.prompts()[0].text, "pa");
}

#[test]
fn comparing_in_turns_and_by_difference() {
    let mut window = Window::on(scene());
    window.press(Key::B);
    window.until_picture(|p| p.original.is_some() && p.reconstruction.is_some());
    let mut seen = [false; 2];
    for _ in 0..90 {
        window.harness.step();
        seen[0] |= window.shows("Blink: Recorded");
        seen[1] |= window.shows("Blink: Reconstruction");
    }
    assert_eq!(seen, [true; 2]);
    window.press_with(Modifiers::NONE, Key::F);
    window.until_picture(|p| p.difference.is_some());
    let picture = window.harness.state().shared.picture().unwrap();
    assert_eq!(picture.difference.as_ref().unwrap().psnr_db, None, "the fake's frame 0 is black in both");
    window.press(Key::ArrowRight);
    window.until_picture(|p| p.difference.as_ref().is_some_and(|d| d.psnr_db.is_some()));
    window.press_with(Modifiers::SHIFT, Key::D);
    window.until_picture(|p| p.layer.is_some() && p.reconstruction.is_some());
}
