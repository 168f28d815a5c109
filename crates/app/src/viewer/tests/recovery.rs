//! Tests of work that belongs to the frames of a recording: it comes back on a reconstruction and after a
//! move, and not on other frames.

use super::{
    sessions::{bookmarked, keeping_on, open},
    *,
};
use crate::viewer::state::{marks::MarkList, session::Session};
use serde_json::Value;
use std::time::{Duration, SystemTime};
use surgtpgs_core::marks::Shape;

/// A recording whose frames are known.
fn recording() -> Info {
    let frames_sha256 = Some("one".into());
    Info { frames_sha256, has_reconstruction: false, has_features: false, has_labels: true, ..scene() }
}

/// Marks a point of a frame.
fn mark(window: &mut Window, frame: usize) {
    let shape = Shape::Click { point_px: [5.0, 5.0], radius_px: 1.0 };
    window.harness.state_mut().shared.document.add_mark(Mark::new(frame, "tool", true, shape));
    window.harness.step();
}

/// Returns the frames that are marked.
fn marked(app: &Shared) -> Vec<usize> {
    app.document.marks().frames().into_iter().collect()
}

/// A recording beside which sessions are saved.
fn beside(folder: &Path) -> Info {
    Info { output_folder: folder.into(), ..recording() }
}

/// Saves a session with a bookmark, and leaves another bookmark unsaved. Returns the file of the session.
fn saved_and_left(folder: &Path) -> PathBuf {
    let (file, unsaved) = (folder.join("clip.surgtpgs"), folder.join("unsaved"));
    let mut window = keeping_on(beside(folder), &unsaved);
    open(&mut window, Path::new("/data/clip.mp4"));
    window.press(Key::M);
    window.harness.state_mut().shared.write_session(&file, 0.0);
    window.press(Key::ArrowRight);
    window.press(Key::M);
    let kept = unsaved.join("0.surgtpgs");
    window.until(|_| Session::load(&kept).is_ok_and(|kept| kept.content.bookmarks.len() == 2));
    file
}

#[test]
fn saved_work_comes_back_when_later_work_is_declined() {
    for answer in ["Discard", "Ask again next time"] {
        let folder = tempfile::tempdir().unwrap();
        let file = saved_and_left(folder.path());
        let mut window = keeping_on(beside(folder.path()), &folder.path().join("unsaved"));
        open(&mut window, Path::new("/data/clip.mp4"));
        window.until_shown("Your last work was not saved");
        assert!(window.harness.state().shared.document.bookmarks().is_empty(), "it is not decided yet");
        window.click(answer);
        window.until_shown("Your saved work on this recording is back: clip.surgtpgs");
        let app = &window.harness.state().shared;
        assert_eq!((app.document.bookmarks().len(), &app.saving.saved.file), (1, &Some(file)), "{answer}");
        assert!(!window.shows("Your last work was not saved") && !app.is_unsaved());
    }
}

#[test]
fn restored_work_is_saved_in_the_session_that_it_belongs_to() {
    let written = |file: &Path, at: SystemTime| {
        std::fs::File::options().write(true).open(file).unwrap().set_modified(at).unwrap();
    };
    for (change, is_its) in [("none", true), ("gone", false), ("saved since", false), ("another", false)] {
        let folder = tempfile::tempdir().unwrap();
        let file = saved_and_left(folder.path());
        match change {
            "gone" => std::fs::remove_file(&file).unwrap(),
            "saved since" => written(&file, SystemTime::now() + Duration::from_secs(60)),
            "another" => {
                bookmarked("/data/other.mp4", 1).save(&file).unwrap();
                written(&file, SystemTime::UNIX_EPOCH);
            }
            _ => {}
        }
        let mut window = keeping_on(beside(folder.path()), &folder.path().join("unsaved"));
        open(&mut window, Path::new("/data/clip.mp4"));
        window.until_shown("Your last work was not saved");
        window.click("Restore");
        window.until(|app| app.saving.to_apply.is_none() && app.document.bookmarks().len() == 2);
        let app = &window.harness.state().shared;
        assert_eq!(app.saving.saved.file, is_its.then(|| file.clone()), "{change}");
        assert!(app.is_unsaved());
        if is_its {
            window.press_with(Modifiers::COMMAND, Key::S);
            assert!(!window.harness.state().shared.is_unsaved());
            assert_eq!(Session::load(&file).unwrap().content.bookmarks.len(), 2);
            assert!(!std::fs::read_to_string(&file).unwrap().contains("saved_as"), "it does not name itself");
        }
    }
}

#[test]
fn marks_of_a_recording_come_back_on_its_reconstruction_and_the_other_way_round() {
    let folder = tempfile::tempdir().unwrap();
    let mut window = keeping_on(recording(), folder.path());
    let sound = CheckReport { ok: true, ..CheckReport::default() };
    *window.backend.checked.lock().unwrap() = Checked { report: sound, can_flip: false };
    let (video, other) = (Path::new("/data/clip.mp4"), Path::new("/elsewhere/other.mp4"));
    let scene = Path::new("/data/clip.safetensors");
    open(&mut window, video);
    mark(&mut window, 3);
    window.press_with(Modifiers::COMMAND, Key::R);
    (0..2).for_each(|_| window.harness.step());
    window.click("Start");
    window.until(|app| app.reconstruction.training.is_some());
    open(&mut window, other);
    assert!(marked(&window.harness.state().shared).is_empty());
    window.until_shown("Stop and keep what was learned");
    window.stop_training();
    window.until_shown("clip.safetensors is reconstructed");
    window.click("Open it");
    window.until(|app| app.info().is_some_and(|info| info.path == scene) && marked(app) == [3]);
    assert!(window.shows("Your work on this recording is back"));

    mark(&mut window, 5);
    open(&mut window, other);
    open(&mut window, video);
    assert_eq!(marked(&window.harness.state().shared), [3, 5]);
}

#[test]
fn work_on_a_recording_that_was_moved_is_restored_where_it_is_now() {
    let folder = tempfile::tempdir().unwrap();
    let (unsaved, moved) = (folder.path().join("unsaved"), Path::new("/data/clip.mp4"));
    std::fs::create_dir(&unsaved).unwrap();
    let session = Session { recording: Some("one".into()), ..bookmarked("/no/such", 2) };
    session.save(&unsaved.join("0.surgtpgs")).unwrap();
    let mut window = keeping_on(recording(), &unsaved);
    window.harness.step();
    window.click("Restore");
    window.until(|app| app.problem.is_some());
    assert!(window.shows("Your work is still kept: open the recording where it is now"));
    open(&mut window, moved);
    window.until_shown("Your last work was not saved");
    window.click("Restore");
    window.until(|app| app.saving.to_apply.is_none() && app.document.bookmarks().len() == 2);
    let app = &window.harness.state().shared;
    assert_eq!((app.info().unwrap().path.as_path(), &app.problem), (moved, &None));
}

#[test]
fn a_session_is_opened_on_its_recording_that_was_moved() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("review.surgtpgs");
    let session = Session { recording: Some("one".into()), ..bookmarked("/no/such", 2) };
    session.save(&file).unwrap();
    let mut window = keeping_on(recording(), &folder.path().join("unsaved"));
    let ctx = window.harness.ctx.clone();
    window.harness.state_mut().shared.open_path(&file, &ctx);
    window.until(|app| app.problem.is_some());
    assert!(window.shows("open the recording where it is now, then open this session again"));
    open(&mut window, Path::new("/data/clip.mp4"));
    open(&mut window, &file);
    let app = &window.harness.state().shared;
    assert_eq!((app.document.bookmarks().len(), &app.saving.saved.file), (2, &Some(file)));
    assert!(app.problem.is_none() && !app.is_unsaved());
}

#[test]
fn work_on_other_frames_of_a_recording_is_kept_and_offered_and_what_does_not_fit_is_said() {
    let folder = tempfile::tempdir().unwrap();
    let video = Path::new("/data/clip.mp4");
    let info = Info { sequence: Some(video.into()), ..recording() };
    let mut window = keeping_on(info, folder.path());
    open(&mut window, video);
    mark(&mut window, 3);
    mark(&mut window, FRAMES - 1);
    window.press(Key::M);
    let change = |window: &mut Window, to: Option<(String, usize)>| {
        *window.backend.changed.lock().unwrap() = to;
        open(window, video);
    };
    change(&mut window, Some(("two".into(), 10)));
    let app = &window.harness.state().shared;
    assert!(marked(app).is_empty() && app.document.bookmarks().is_empty());
    let toast = app.toast.as_ref().map(|toast| toast.text.as_str());
    assert_eq!(toast, Some("These are other frames than before: your work on those is kept"));
    window.until_shown("The recording had other frames then");

    change(&mut window, None);
    window.until_shown("Your work on this recording is back");
    assert_eq!(marked(&window.harness.state().shared), [3, FRAMES - 1]);

    change(&mut window, Some(("two".into(), 10)));
    window.until_shown("Your last work was not saved");
    window.click("Restore");
    window.until(|app| app.saving.to_apply.is_none() && marked(app) == [3]);
    assert_eq!(window.harness.state().shared.document.bookmarks().len(), 1);
    assert!(window.shows("The recording is not as it was") && window.shows("do not fit it were left out"));
    (0..3).for_each(|_| window.harness.step());
    assert!(!window.shows("Your last work was not saved"), "not at once again");

    change(&mut window, None);
    window.until_shown("Your work on this recording is back");
    assert_eq!(marked(&window.harness.state().shared), [3, FRAMES - 1], "nothing of it is lost");
    change(&mut window, Some(("two".into(), 10)));
    assert_eq!(marked(&window.harness.state().shared), [3], "and what fits stays with the others");
}

#[test]
fn work_that_is_asked_about_next_time_is_not_offered_before() {
    let folder = tempfile::tempdir().unwrap();
    let (clip, other) = (Path::new("/data/clip.mp4"), Path::new("/elsewhere/other.mp4"));
    bookmarked("/data/clip.mp4", 2).save(&folder.path().join("0.surgtpgs")).unwrap();
    for _ in 0..2 {
        let mut window = keeping_on(recording(), folder.path());
        open(&mut window, clip);
        window.until_shown("Your last work was not saved");
        window.click("Ask again next time");
        for path in [other, clip] {
            open(&mut window, path);
            (0..3).for_each(|_| window.harness.step());
            assert!(!window.shows("Your last work was not saved"));
        }
        assert_eq!(window.harness.state().shared.saving.autosave.left.len(), 1, "it is kept");
    }
}

#[test]
fn marks_that_cannot_be_used_are_said_and_saved_as_they_were() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("review.surgtpgs");
    let mark = |frame: usize, x: f32| {
        let shape = Shape::Click { point_px: [x, 1.0], radius_px: 1.0 };
        Mark::new(frame, "fat", true, shape)
    };
    let list = [mark(2, 5.0), mark(2, 5000.0), mark(FRAMES, 5.0)];
    let mut session = Session::new("/data/clip.safetensors".into());
    session.content.marks = MarkList::of(list.to_vec());
    session.save(&file).unwrap();
    let read = || serde_json::from_str::<Value>(&std::fs::read_to_string(&file).unwrap()).unwrap();
    let mut told = read();
    let odd = serde_json::json!({"frame": 3, "name": "fat", "kind": "spray"});
    told["content"]["marks"].as_array_mut().unwrap().push(odd);
    std::fs::write(&file, told.to_string()).unwrap();

    let mut window = Window::on(scene());
    open(&mut window, &file);
    window.until_shown("Marks of this session that are left out: 1 cannot be read (kind must be");
    assert!(window.shows("2 do not fit the recording (the first: \"fat\" on frame 3)"));
    let app = &window.harness.state().shared;
    assert_eq!(app.document.marks().all(), &list[..1]);
    assert!(!app.is_unsaved(), "nothing of it was changed");
    window.press(Key::M);
    window.harness.state_mut().shared.write_session(&file, 0.0);
    let app = &window.harness.state().shared;
    assert!(app.document.bookmarks().len() == 1 && !app.is_unsaved());
    assert!(!app.saving.saved.is_changed_elsewhere());
    assert_eq!(read()["content"]["marks"], told["content"]["marks"], "no mark is lost");
}
