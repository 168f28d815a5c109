//! Tests of marking by hand: drawing, the prompts that it makes, files and sessions.

use super::{
    pointing::{button, click_at, drag, on_screen},
    *,
};
use crate::viewer::{
    backend::task::Task,
    command::Command,
    state::{marking::Tool, session::Session},
};
use surgtpgs_core::marks::Shape;

/// A scene without features: only what is marked can be looked for.
pub(super) fn without_features() -> Info {
    Info { has_features: false, example_prompts: Vec::new(), ..scene() }
}

/// Takes the tool in hand and names what is to be marked.
pub(super) fn take_tool(window: &mut Window, name: &str) {
    let marking = &mut window.harness.state_mut().shared.viewport.marking;
    (marking.is_on, marking.name, marking.radius_px) = (true, name.into(), 2.0);
    // The room for the curve of its name makes the picture smaller.
    (0..3).for_each(|_| window.harness.step());
}

pub(super) fn marks(window: &Window) -> Vec<Mark> {
    window.harness.state().shared.document.marks().all().to_vec()
}

fn texts(window: &Window) -> Vec<String> {
    window.harness.state().shared.document.prompts().iter().map(|p| p.text.clone()).collect()
}

/// Waits until a prompt is answered with all marks; returns the share of the picture that it finds.
pub(super) fn share(window: &mut Window, text: &str) -> f32 {
    let all = window.harness.state().shared.document.marks().clone();
    window.until_picture(|p| {
        p.request.marks == all && !p.request.view.is_preview && p.findings.iter().any(|f| f.text == text)
    });
    let picture = window.harness.state().shared.picture().unwrap();
    let finding = picture.findings.iter().find(|f| f.text == text).unwrap();
    finding.outcome.as_ref().unwrap().area_fraction
}

#[test]
fn a_stroke_becomes_a_prompt_and_undo_takes_both_back() {
    let mut window = Window::on(without_features());
    assert!(window.harness.state().shared.document.prompts().is_empty() && !window.shows("Compared with"));
    window.press(Key::S);
    window.until_shown("Give it a name first.");
    window.harness.get_by_label("Name of what is marked").type_text("Tool");
    window.harness.step();
    drag(&mut window, [0.2, 0.5], [0.6, 0.5]);
    let made = marks(&window);
    let [Mark { frame: 0, name, add: true, shape: Shape::Stroke { points_px, radius_px } }] = &made[..]
    else {
        panic!("{made:?}");
    };
    assert_eq!((name.as_str(), *radius_px), ("tool", 8.0));
    let ends = [points_px[0], points_px[points_px.len() - 1]];
    assert!((ends[0][0] - 6.4).abs() < 0.1 && (ends[1][0] - 19.2).abs() < 3.0, "{ends:?}");
    assert_eq!(texts(&window), ["tool"]);
    assert!(share(&mut window, "tool") > 0.5);
    window.until(|app| app.selected_curve().is_some_and(|curve| curve.is_complete()));
    assert!(window.shows("Found on 48 of 48 frames"));
    assert_eq!(window.harness.state().shared.document.undo_name(), Some("marking \"tool\" on frame 1"));
    window.press_with(Modifiers::COMMAND, Key::Z);
    assert!(marks(&window).is_empty() && texts(&window).is_empty());
    window.press_with(Modifiers::COMMAND, Key::Y);
    assert_eq!((marks(&window).len(), texts(&window)), (1, vec!["tool".to_owned()]));
}

#[test]
fn the_first_mark_leaves_the_picture_where_it_is() {
    let mut window = Window::on(without_features());
    take_tool(&mut window, "tool");
    let corners = |window: &Window| [[0.0, 0.0], [1.0, 1.0]].map(|at| on_screen(window, at));
    let before = corners(&window);
    drag(&mut window, [0.2, 0.5], [0.6, 0.5]);
    assert!(share(&mut window, "tool") > 0.0);
    assert_eq!(corners(&window), before);
}

#[test]
fn a_stroke_that_a_slow_window_gets_at_once_or_after_its_press_is_drawn_as_it_was() {
    let mut window = Window::on(without_features());
    take_tool(&mut window, "tool");
    let corners = |is_lower: bool| {
        let top = if is_lower { 0.4 } else { 0.2 };
        [[0.2, top], [0.5, top], [0.5, 0.8]]
    };
    let cases = [(Tool::Brush, false), (Tool::Box, false), (Tool::Brush, true), (Tool::Box, true)];
    for (tool, is_pressed_before) in cases {
        window.harness.state_mut().shared.viewport.marking.tool = tool;
        window.harness.step();
        let way = corners(is_pressed_before).map(|at| on_screen(&window, at));
        window.harness.hover_at(way[0]);
        window.harness.step();
        window.harness.input_mut().events.push(button(way[0], true));
        if is_pressed_before {
            window.harness.step();
        }
        let events = &mut window.harness.input_mut().events;
        events.extend(way.map(egui::Event::PointerMoved));
        events.push(button(way[2], false));
        window.harness.step();
        assert!(share(&mut window, "tool") > 0.0);
    }
    let made = marks(&window);
    assert_eq!(made.len(), cases.len());
    let size = [SIZE.0, SIZE.1].map(|n| n as f32);
    let is_at = |point: &[f32; 2], share: [f32; 2]| {
        point.iter().zip(share).zip(size).all(|((p, share), n)| (p - share * n).abs() < 0.1)
    };
    for (mark, (_, is_pressed_before)) in made.iter().zip(cases) {
        let corners = corners(is_pressed_before);
        let is_as_drawn = match &mark.shape {
            Shape::Stroke { points_px, .. } => {
                points_px.len() == 3 && points_px.iter().zip(corners).all(|(p, at)| is_at(p, at))
            }
            Shape::Box { corners_px } => {
                is_at(&corners_px[0], corners[0]) && is_at(&corners_px[1], corners[2])
            }
            _ => false,
        };
        assert!(is_as_drawn, "{mark:?}");
    }
}

#[test]
fn each_tool_makes_its_mark_and_shift_turns_it_round() {
    let mut window = Window::on(scene());
    take_tool(&mut window, "liver");
    let set = |window: &mut Window, tool| window.harness.state_mut().shared.viewport.marking.tool = tool;
    set(&mut window, Tool::Click);
    click_at(&mut window, [0.5, 0.5]);
    // The curve of the new prompt takes its room below the picture.
    window.until_found();
    set(&mut window, Tool::Box);
    drag(&mut window, [0.25, 0.25], [0.75, 0.75]);
    set(&mut window, Tool::Outline);
    for corner in [[0.1, 0.1], [0.9, 0.1]] {
        click_at(&mut window, corner);
    }
    assert_eq!(marks(&window).len(), 2, "an outline is open until it is closed");
    drag(&mut window, [0.9, 0.9], [0.5, 0.95]);
    set(&mut window, Tool::Brush);
    let at = on_screen(&window, [0.3, 0.3]);
    window.harness.hover_at(at);
    window.harness.event(egui::Event::ModifiersChanged(Modifiers::SHIFT));
    window.harness.event(button(at, true));
    window.harness.step();
    window.harness.event(button(at, false));
    window.harness.step();
    window.harness.step();
    let made = marks(&window);
    let [a, b, c, d] = &made[..] else { panic!("{made:?}") };
    assert!(
        matches!(a.shape, Shape::Click { point_px: [x, y], .. } if (x - 16.0).abs() + (y - 12.0).abs() < 0.1)
    );
    assert!(
        matches!(b.shape, Shape::Box { corners_px: [[x, _], [_, y]] } if (x - 8.0).abs() + (y - 18.0).abs() < 0.1)
    );
    assert!(matches!(&c.shape, Shape::Polygon { points_px } if points_px.len() > 3));
    assert!(matches!(d.shape, Shape::Stroke { .. }) && !d.add && a.add);
    assert!(window.harness.state().shared.viewport.probe.is_none(), "the tool has the mouse");
}

#[test]
fn the_shown_frame_answers_while_one_draws() {
    let mut window = Window::on(without_features());
    take_tool(&mut window, "tool");
    let (from, to) = (on_screen(&window, [0.2, 0.5]), on_screen(&window, [0.7, 0.5]));
    window.harness.hover_at(from);
    window.harness.step();
    window.harness.event(button(from, true));
    window.harness.step();
    window.harness.hover_at(to);
    window.harness.step();
    window.until_picture(|p| p.request.marks.all().len() == 1);
    assert!(marks(&window).is_empty(), "not yet");
    window.press(Key::Escape);
    window.until_picture(|p| p.request.marks.is_empty());
    window.harness.event(button(to, false));
    window.harness.step();
    assert!(marks(&window).is_empty(), "what was given up stays away");
}

#[test]
fn a_mark_and_its_opposite_leave_nothing() {
    let mut window = Window::on(without_features());
    take_tool(&mut window, "tool");
    drag(&mut window, [0.2, 0.5], [0.6, 0.5]);
    assert!(share(&mut window, "tool") > 0.0);
    let stroke = marks(&window).pop().unwrap();
    let opposite = Mark { add: false, ..stroke };
    window.harness.state_mut().shared.document.add_mark(opposite);
    assert_eq!(share(&mut window, "tool"), 0.0);
}

#[test]
fn marks_wait_for_a_reconstruction_and_answer_when_it_is_there() {
    let recording = Info { has_reconstruction: false, has_features: false, ..scene() };
    let mut window = Window::on(recording);
    take_tool(&mut window, "tool");
    drag(&mut window, [0.2, 0.5], [0.6, 0.5]);
    window.harness.step();
    assert!(window.shows("once this recording is reconstructed: press Reconstruct"));
    assert!(window.shows("Marked; waits for the reconstruction"));
    assert!(window.harness.state().shared.picture().unwrap().request.prompts.is_empty());
    window.press_with(Modifiers::COMMAND, Key::R);
    window.harness.step();
    window.harness.step();
    window.click("Start");
    window.until(|app| app.info().is_some_and(|i| i.has_reconstruction));
    assert!(window.shows("as soon as the reconstruction is ready"));
    assert!(window.harness.state().shared.picture().is_some_and(|p| p.request.marks.is_empty()));
    window.stop_training();
    window.until(|app| !app.is_reconstructing() && app.opening.underway.is_none());
    assert!(share(&mut window, "tool") > 0.0);
    assert!(!window.shows("waits for the reconstruction"));
}

#[test]
fn the_picture_says_of_what_waits_that_it_is_found_when_the_reconstruction_is_ready() {
    let mut window = Window::on(Info { has_reconstruction: false, has_labels: true, ..scene() });
    take_tool(&mut window, "spleen");
    drag(&mut window, [0.2, 0.5], [0.6, 0.5]);
    window.press(Key::Escape);
    window.press_with(Modifiers::COMMAND, Key::R);
    window.harness.step();
    window.harness.step();
    window.click("Start");
    window.until(|app| app.info().is_some_and(|i| i.has_reconstruction));
    window.until_found();
    let painted = painted(&window);
    let says = |words: &str| painted.iter().any(|text| text.contains(words));
    assert!(says("found when the reconstruction is ready") && !says("ot in this recording"), "{painted:?}");
}

#[test]
fn the_demo_in_the_making_is_not_to_be_reconstructed_by_hand() {
    let mut window = Window::on(Info { has_reconstruction: false, has_features: false, ..scene() });
    let (hold, held) = mpsc::channel::<()>();
    let ctx = window.harness.ctx.clone();
    let opening = &mut window.harness.state_mut().shared.opening;
    opening.demo_folder = Some("/data".into());
    opening.demo = Some(Task::start("demo", &ctx, move |_| {
        let _ = held.recv();
        Err(Error::Cancelled)
    }));
    take_tool(&mut window, "tool");
    drag(&mut window, [0.2, 0.5], [0.6, 0.5]);
    window.harness.step();
    assert!(window.shows("as soon as the reconstruction is ready") && !window.shows("press Reconstruct"));
    drop(hold);
}

#[test]
fn marks_on_a_recording_that_was_reconstructed_before_wait_until_that_is_opened() {
    let made_before = Some("/data/clip.safetensors".into());
    let mut window =
        Window::on(Info { has_reconstruction: false, has_features: false, made_before, ..scene() });
    take_tool(&mut window, "tool");
    drag(&mut window, [0.2, 0.5], [0.6, 0.5]);
    window.harness.step();
    assert!(window.shows("once you open the reconstruction") && !window.shows("press Reconstruct"));
}

#[test]
fn marks_are_saved_opened_and_part_of_the_session() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("clip-marks.json");
    let mut window = Window::on(scene());
    take_tool(&mut window, "Cystic_Duct");
    drag(&mut window, [0.2, 0.5], [0.6, 0.5]);
    window.harness.state_mut().shared.playback.seek(3, 0.0);
    window.until_picture(|p| p.request.view.frame == 3);
    click_at(&mut window, [0.5, 0.5]);
    let made = marks(&window);
    assert_eq!(
        made.iter().map(|m| (m.frame, m.name.as_str())).collect::<Vec<_>>(),
        [(0, "cystic duct"), (3, "cystic duct")]
    );
    *window.backend.picked.lock().unwrap() = Some(Picked::Path(file.clone()));
    let ctx = window.harness.ctx.clone();
    window.harness.state_mut().shared.run(Command::SaveMarks.into(), &ctx);
    window.until_shown("Marks saved as clip-marks.json");
    let session = window.harness.state().shared.session().unwrap();
    let told = serde_json::to_string(&session).unwrap();
    let read: Session = serde_json::from_str(&told).unwrap();
    assert!(read.content.is_alike(&session.content) && told.contains("\"kind\":\"stroke\""));

    let mut window = Window::on(scene());
    *window.backend.picked.lock().unwrap() = Some(Picked::Path(file.clone()));
    let ctx = window.harness.ctx.clone();
    window.harness.state_mut().shared.run(Command::OpenMarks.into(), &ctx);
    window.until(|app| !app.document.marks().is_empty());
    assert_eq!((marks(&window), texts(&window)), (made, vec!["cystic duct".to_owned()]));
    window.until_shown("Added 2 marks");
    window.harness.state_mut().shared.run(Command::OpenMarks.into(), &ctx);
    window.until_shown("The file has no marks that are not there already");
    assert_eq!(marks(&window).len(), 2, "the same marks again say nothing new");
    window.harness.state_mut().shared.document.clear_marks(3);
    window.harness.state_mut().shared.run(Command::OpenMarks.into(), &ctx);
    window.until_shown("Added 1 mark to 1 earlier one");
    assert_eq!(marks(&window).len(), 2);
    std::fs::write(
        &file,
        r#"{"marks": [{"frame": 999, "name": "fat", "kind": "click", "points_px": [[1, 1]]}]}"#,
    )
    .unwrap();
    window.harness.state_mut().shared.run(Command::OpenMarks.into(), &ctx);
    window.until(|app| app.problem.is_some());
    let problem = window.harness.state().shared.problem.clone().unwrap();
    assert!(problem.contains("there is no frame 999"), "{problem}");
}

#[test]
fn the_prompt_that_was_selected_since_is_what_is_marked_next() {
    let mut window = Window::on(without_features());
    take_tool(&mut window, "liver");
    drag(&mut window, [0.2, 0.5], [0.6, 0.5]);
    window.press(Key::S);
    window.add_prompt("gallbladder");
    let name = |window: &Window| window.harness.state().shared.viewport.marking.name.clone();
    window.press(Key::S);
    assert_eq!(name(&window), "gallbladder");
    window.harness.state_mut().shared.viewport.marking.name = "fat".into();
    // Out of the field, and out of the hand.
    (0..2).for_each(|_| window.press(Key::Escape));
    assert!(!window.harness.state().shared.viewport.marking.is_on);
    window.press(Key::S);
    assert_eq!(name(&window), "fat", "nothing else was selected");
}

#[test]
fn an_outline_around_nothing_is_not_added_and_the_window_says_so() {
    const SAID: &str = "This outline encloses nothing: draw around the structure";
    let mut window = Window::on(without_features());
    take_tool(&mut window, "tool");
    window.harness.state_mut().shared.viewport.marking.tool = Tool::Outline;
    drag(&mut window, [0.2, 0.5], [0.6, 0.5]);
    window.until_shown(SAID);
    // Less than half a pixel high, around the centres of some.
    window.harness.state_mut().shared.toast = None;
    [[0.2, 0.5125], [0.6, 0.5125]].into_iter().for_each(|corner| click_at(&mut window, corner));
    drag(&mut window, [0.4, 0.53], [0.42, 0.53]);
    window.until_shown(SAID);
    assert!(marks(&window).is_empty() && texts(&window).is_empty());
    assert_eq!(window.harness.state().shared.viewport.marking.draft, None);
    window.harness.state_mut().shared.toast = None;
    [[0.2, 0.2], [0.6, 0.2]].into_iter().for_each(|corner| click_at(&mut window, corner));
    drag(&mut window, [0.6, 0.6], [0.4, 0.6]);
    assert_eq!(marks(&window).len(), 1);
    assert!(!window.shows(SAID));
}

#[test]
fn marks_are_painted_while_the_tool_is_in_use() {
    let mut window = Window::on(without_features());
    take_tool(&mut window, "tool");
    drag(&mut window, [0.2, 0.5], [0.6, 0.5]);
    share(&mut window, "tool");
    // Pictures of the recording, and that of the marks.
    let pictures = |window: &Window| {
        let shapes = &window.harness.output().shapes;
        shapes.iter().filter(|clipped| matches!(clipped.shape, egui::Shape::Callback(_))).count()
    };
    let with_marks = pictures(&window);
    window.press(Key::S);
    window.harness.step();
    assert_eq!(pictures(&window), with_marks - 1);
}

#[test]
fn nothing_is_told_of_a_frame_that_is_left_out_and_the_tool_says_so() {
    let mut window = Window::on(scene());
    window.add_prompt("gallbladder");
    window.until_found();
    take_tool(&mut window, "gallbladder");
    let says = |window: &Window, words: &str| window.harness.query_all_by_label(words).next().is_some();
    assert!(window.shows("Draw along the structure") && says(&window, "25 % of the picture"));
    window.harness.state_mut().shared.document.toggle_excluded(0, 0);
    (0..3).for_each(|_| window.harness.step());
    assert!(window.shows("This frame is left out of everything, and cannot be marked."));
    assert!(says(&window, "Left out") && !says(&window, "25 % of the picture"));
    assert!(!window.shows("Draw along the structure"));
}

#[test]
fn the_tool_is_scrolled_to_when_it_is_taken() {
    let mut window = Window::on(scene());
    let shared = &mut window.harness.state_mut().shared;
    (0..20).for_each(|k| shared.document.add(&format!("structure {k}")));
    let (selected, marking) = (shared.document.selected, &mut shared.viewport.marking);
    // The tool keeps its name, and asks for no other.
    (marking.name, marking.put_away_at) = ("tool".into(), selected);
    (0..3).for_each(|_| window.harness.step());
    let top = |window: &Window, label: &str| window.harness.get_by_label(label).rect().top();
    window.harness.get_by_label("Delete structure 19").scroll_to_me();
    (0..60).for_each(|_| window.harness.step());
    assert!(top(&window, "Delete structure 0") < top(&window, "Prompt"), "it is scrolled");
    window.press(Key::S);
    (0..60).for_each(|_| window.harness.step());
    assert!(top(&window, "Name of what is marked") > top(&window, "Prompt"));
    assert!(!window.harness.get_by_label("Name of what is marked").is_focused());
}

#[test]
fn a_prompt_that_needs_a_mark_has_no_curve() {
    let mut window = Window::on(without_features());
    take_tool(&mut window, "tool");
    drag(&mut window, [0.2, 0.5], [0.6, 0.5]);
    window.press(Key::Escape);
    window.add_prompt("grasper");
    window.until(|app| app.selected_curve().is_some_and(|curve| curve.is_complete()));
    let curve = window.harness.state().shared.selected_curve();
    assert!(curve.is_some_and(|curve| curve.has_no_answer()));
    assert!(window.shows("grasper: cannot be looked for"));
}

#[test]
fn the_window_goes_where_a_mark_would_help_most() {
    let mut window = Window::on(without_features());
    assert!(!window.harness.state().shared.is_enabled(Command::LookHere));
    take_tool(&mut window, "tool");
    drag(&mut window, [0.2, 0.5], [0.6, 0.5]);
    window.until(|app| app.selected_curve().is_some_and(|curve| curve.is_complete()));
    window.harness.step();
    window.press(Key::S);
    window.press_with(Modifiers::SHIFT, Key::S);
    assert_eq!(window.frame(), 17);
    assert!(window.harness.state().shared.viewport.marking.is_on, "the tool shows the ring");
    window.until_shown("The ring is around what is least sure");
    window.until_picture(|p| p.request.view.frame == 17);
    drag(&mut window, [0.2, 0.5], [0.6, 0.5]);
    let best = |app: &Shared| app.areas().and_then(|areas| areas.look_here(|_| true)).map(|here| here.frame);
    window.until(|app| best(app).is_some_and(|frame| frame != 17));
    let Some(next) = best(&window.harness.state().shared) else { panic!("another frame is in doubt") };
    window.harness.state_mut().shared.document.toggle_excluded(next, next);
    window.click("Look here");
    assert_ne!(window.frame(), next, "that frame is left out");
}

/// Opens a window that knows where to look. Nothing is selected, and the tool was never used.
fn doubtful() -> Window {
    let mut window = Window::on(without_features());
    let shape = Shape::Click { point_px: [5.0, 5.0], radius_px: 1.0 };
    let document = &mut window.harness.state_mut().shared.document;
    document.add_mark(Mark::new(0, "fat", true, shape));
    window.until(|app| app.selected_curve().is_some_and(|curve| curve.is_complete()));
    window.harness.state_mut().shared.document.selected = None;
    window
}

#[test]
fn a_name_typed_fast_where_one_looks_is_no_row_of_commands() {
    let mut window = doubtful();
    let mode = window.harness.state().shared.document.mode;
    let key = |pressed| egui::Event::Key {
        key: Key::S,
        physical_key: None,
        pressed,
        repeat: false,
        modifiers: Modifiers::SHIFT,
    };
    let events = &mut window.harness.input_mut().events;
    events.extend([key(true), egui::Event::Text("S".into()), key(false)]);
    window.type_at_once("duct\n");
    let app = &window.harness.state().shared;
    assert_eq!((app.viewport.marking.name.as_str(), window.frame()), ("duct", 17));
    assert!(app.viewport.marking.is_on && app.document.mode == mode && !app.playback.is_playing());
}

#[test]
fn a_name_without_words_is_typed_where_one_looks() {
    for (name, is_missing) in [("tool", false), ("", true), (" - ", true)] {
        let mut window = doubtful();
        window.harness.state_mut().shared.viewport.marking.name = name.into();
        window.press_with(Modifiers::SHIFT, Key::S);
        window.harness.step();
        assert_eq!(window.frame(), 17);
        assert_eq!(window.harness.get_by_label("Name of what is marked").is_focused(), is_missing, "{name}");
    }
}

#[test]
fn typed_words_find_what_is_marked_and_nothing_else() {
    let mut window = Window::on(without_features());
    take_tool(&mut window, "tool");
    drag(&mut window, [0.2, 0.5], [0.6, 0.5]);
    let own = share(&mut window, "tool");
    window.press(Key::Escape);
    window.harness.step();
    window.click("Delete tool");
    assert!(marks(&window).is_empty(), "its marks go with it");
    window.click("Undo");
    assert_eq!((marks(&window).len(), share(&mut window, "tool")), (1, own));
    window.press(Key::Escape);
    window.type_prompt("grasper");
    window.until_shown("Cannot be looked for: mark it by hand – Enter keeps it");
    window.press(Key::Enter);
    window.press(Key::Escape);
    window.until_found();
    assert_eq!(share(&mut window, "grasper"), 0.0);
    assert!(window.shows("Cannot be looked for: mark it by hand") && !window.shows("Not in this recording"));
    let painted = painted(&window);
    let in_legend = |words: &str| painted.iter().any(|text| text.contains(words));
    assert!(in_legend("cannot be looked for: mark it by hand") && !in_legend("in this recording"));
    window.click("Suggestions");
    window.until_shown("Classes of this recording");
}

#[test]
fn what_takes_nearly_everything_asks_for_its_opposite() {
    const ADVICE: &str = "Now show what";
    let mut window = Window::on(without_features());
    let line = |points: [[f32; 2]; 2], radius_px| Shape::Stroke { points_px: points.to_vec(), radius_px };
    let some = line([[0.0, 8.0], [31.0, 8.0]], 4.0);
    let few = line([[1.0, 22.0], [8.0, 22.0]], 1.0);
    let add = |window: &mut Window, name: &str, add: bool, shape: &Shape| {
        let mark = Mark::new(0, name, add, shape.clone());
        window.harness.state_mut().shared.document.add_mark(mark);
    };
    take_tool(&mut window, "tool");
    add(&mut window, "tool", true, &few);
    assert!(share(&mut window, "tool") < 0.2 && window.shows(ADVICE), "it is alone");
    add(&mut window, "fat", true, &few);
    share(&mut window, "fat");
    assert!(!window.shows(ADVICE), "two tell each other apart");
    add(&mut window, "fat", true, &some);
    let found = share(&mut window, "fat");
    assert!((0.25..0.4).contains(&found) && window.shows("Now show what \"fat\" is not"), "{found}");
    add(&mut window, "wall", true, &few);
    share(&mut window, "wall");
    assert!(!window.shows(ADVICE), "three tell each other apart, however large they are");
    window.press_with(Modifiers::COMMAND, Key::Z);
    assert!(window.shows(ADVICE));
    add(&mut window, "fat", false, &few);
    share(&mut window, "fat");
    assert!(!window.shows(ADVICE));
    let mut window = Window::on(Info { example_prompts: vec!["gallbladder".into()], ..scene() });
    take_tool(&mut window, "Gall Bladder");
    add(&mut window, "Gall Bladder", true, &few);
    share(&mut window, "gall bladder");
    assert!(!window.shows(ADVICE), "the recording knows it");
    let mut window = Window::on(without_features());
    take_tool(&mut window, "tool");
    add(&mut window, "tool", true, &Shape::Box { corners_px: [[0.0, 0.0], [31.0, 20.0]] });
    assert!(share(&mut window, "tool") > 0.4 && !window.shows(ADVICE), "an outline says what lies outside");
}
