//! Tests of the mouse on the picture: probing a point, measuring, zooming.

use super::*;
use crate::viewer::backend::Lens;
use egui::Pos2;

/// Returns the screen position of a point of the picture.
pub(super) fn on_screen(window: &Window, point: [f32; 2]) -> Pos2 {
    window.harness.state().shared.viewport.panes.screen_positions(point).next().unwrap().1
}

pub(super) fn button(pos: Pos2, pressed: bool) -> egui::Event {
    let button = egui::PointerButton::Primary;
    egui::Event::PointerButton { pos, button, pressed, modifiers: Modifiers::NONE }
}

pub(super) fn click_at(window: &mut Window, point: [f32; 2]) {
    let at = on_screen(window, point);
    window.harness.hover_at(at);
    window.harness.step();
    window.harness.event(button(at, true));
    window.harness.step();
    window.harness.event(button(at, false));
    window.harness.step();
    window.harness.step();
}

pub(super) fn drag(window: &mut Window, from: [f32; 2], to: [f32; 2]) {
    let (from, to) = (on_screen(window, from), on_screen(window, to));
    window.harness.hover_at(from);
    window.harness.step();
    window.harness.event(button(from, true));
    window.harness.step();
    for i in 1..=10 {
        window.harness.hover_at(from.lerp(to, i as f32 / 10.0));
        window.harness.step();
    }
    window.harness.event(button(to, false));
    window.harness.step();
    window.harness.step();
}

fn measurable() -> Info {
    Info { lens: Some(Lens { fx: 32.0, fy: 32.0, cx: 16.0, cy: 12.0 }), ..scene() }
}

#[test]
fn a_click_says_what_a_point_is_most_like_and_offers_to_look_for_it() {
    let mut window = Window::on(scene());
    window.add_prompt("nothing");
    window.until_found();
    click_at(&mut window, [0.1, 0.5]);
    window.until_picture(|p| p.candidates.len() == 2);
    assert!(window.shows("This point"));
    // The classes of the recording are found in its left part, the prompt nowhere.
    assert!(window.shows("liver 0.80 at this point") && window.shows("nothing 0.20 at this point"));
    assert!(!window.shows("Less likely than not any of these"));
    window.click("liver 0.80 at this point");
    assert!(window.harness.state().shared.document.prompts().iter().any(|p| p.text == "liver"));
    click_at(&mut window, [0.5, 0.9]);
    window.until_picture(|p| p.candidates.len() == 1);
    assert!(window.shows("liver 0.30 at this point"));
    assert!(window.shows("Less likely than not any of these"));
    window.press(Key::Escape);
    window.harness.step();
    assert!(!window.shows("This point"));
    window.until_picture(|p| p.candidates.is_empty());
}

#[test]
fn a_point_becomes_a_prompt_without_words_and_what_a_prompt_is_not() {
    let mut window = Window::on(scene());
    window.add_prompt("gallbladder");
    window.until_found();
    click_at(&mut window, [0.76, 0.52]);
    window.until_picture(|p| p.sample.is_some());
    window.click("Not \"gallbladder\"");
    window.until_picture(|p| p.request.prompts[0].question.negatives.samples.len() == 1);
    let prompt = window.harness.state().shared.document.prompts()[0].clone();
    assert_eq!(prompt.not_like[0].name, "what is at frame 1, x 24, y 12");
    assert_eq!(window.harness.state().shared.document.undo_name(), Some("what \"gallbladder\" is not"));
    window.click("More like this");
    window.until_picture(|p| p.findings.len() == 2);
    let picture = window.harness.state().shared.picture().unwrap();
    let asked = &picture.request.prompts[1].question;
    assert_eq!((asked.text.as_str(), &asked.like), ("like frame 1, x 24, y 12", &picture.sample));
    // Samples are the user's work: they come back with the session.
    let session = window.harness.state().shared.session().unwrap();
    let told = serde_json::to_string(&session).unwrap();
    let read: crate::viewer::state::session::Session = serde_json::from_str(&told).unwrap();
    assert!(read.content.is_alike(&session.content) && told.contains("embedding"));
    window.click("More about gallbladder");
    window.click("Remove what is at frame 1, x 24, y 12");
    assert!(window.harness.state().shared.document.prompts()[0].not_like.is_empty());
}

#[test]
fn a_hidden_prompt_is_compared_as_it_is_asked() {
    let mut window = Window::on(scene());
    click_at(&mut window, [0.1, 0.5]);
    window.until_picture(|p| p.sample.is_some());
    window.click("More like this");
    let document = &mut window.harness.state_mut().shared.document;
    document.add("broken");
    document.add("Liver");
    document.add("spleen");
    (0..4).for_each(|k| document.toggle_visible(k));
    let id = document.selected.unwrap();
    document.set_shows_nearest(id, true);
    document.set_but_not(id, &["smoke".to_owned()]);
    let asked: Vec<Question> = document.prompts().iter().map(|p| document.question(p)).collect();
    assert!(asked[0].like.is_some());
    window.until_picture(|p| p.request.candidates.starts_with(&asked));
    let candidates = &window.harness.state().shared.picture().unwrap().request.candidates;
    assert_eq!(candidates[4..].iter().map(|q| q.text.as_str()).collect::<Vec<_>>(), ["fat"]);
    // What has no answer does not keep the others waiting.
    assert!(window.shows("spleen 0.80 at this point") && !window.shows("Comparing…"));
}

#[test]
fn where_nothing_was_reconstructed_there_is_nothing_to_look_for() {
    let mut window = Window::on(scene());
    click_at(&mut window, [0.5, 0.95]);
    window.until_picture(|p| p.candidates.len() == 2);
    assert!(window.shows("This point") && !window.shows("More like this"));
}

#[test]
fn asking_a_point_draws_nothing_over_the_picture() {
    let mut window = Window::on(scene());
    click_at(&mut window, [0.1, 0.5]);
    window.until_picture(|p| p.candidates.len() == 2);
    let picture = window.harness.state().shared.picture().unwrap();
    assert!(picture.findings.is_empty() && picture.reconstruction.as_ref().unwrap().marked.is_none());
}

#[test]
fn a_length_has_no_millimetres_before_somebody_gives_a_scale() {
    let mut window = Window::on(measurable());
    window.press(Key::U);
    window.harness.step();
    assert!(window.shows("Drag on the picture"));
    drag(&mut window, [0.25, 0.5], [0.75, 0.5]);
    // 16 px at 50 units with a focal length of 32 px are 25 units.
    assert!(window.shows("16.0 px  ·  25 ± 1 scene units"));
    assert!(window.shows("scene units  ·  frame 1"));
    assert!(!window.shows(" mm"));
    window.type_into("Known length in millimetres", "50");
    window.click("Set the scale");
    assert!(window.shows("50 ± 3 mm"), "{:?}", window.harness.state().shared.document.content().scale);
    assert!(window.shows("Scale from a known length of 50 mm on frame 1"));
    assert_eq!(window.harness.state().shared.document.undo_name(), Some("setting the scale"));
    window.press_with(Modifiers::COMMAND, Key::Z);
    window.harness.step();
    assert!(!window.shows(" mm"));
}

#[test]
fn the_recorded_frame_is_measured_and_turned_around_without_a_prompt() {
    let mut window = Window::gated(measurable(), None);
    window.until_picture(|p| p.depth_values.is_some());
    assert_eq!(window.harness.state().shared.document.mode, ViewMode::Original);
    window.press(Key::U);
    window.harness.step();
    drag(&mut window, [0.25, 0.5], [0.75, 0.5]);
    assert!(window.shows("16.0 px  ·  25 ± 1 scene units"));
    window.press(Key::U);
    let at = on_screen(&window, [0.75, 0.5]);
    window.harness.hover_at(at);
    (0..2).for_each(|_| window.harness.step());
    assert!(window.shows("depth 50.0 scene units"));
    window.press(Key::C);
    assert!(window.harness.state().shared.document.look.orbit.pivot.is_some());
}

/// Returns the places of the painted texts that are as wanted.
fn places(window: &Window, is_wanted: impl Fn(&str) -> bool) -> Vec<egui::Rect> {
    let place = |clipped: &egui::epaint::ClippedShape| match &clipped.shape {
        egui::Shape::Text(text) if is_wanted(text.galley.text()) => {
            Some(egui::Rect::from_min_size(text.pos, text.galley.size()))
        }
        _ => None,
    };
    window.harness.output().shapes.iter().filter_map(place).collect()
}

#[test]
fn the_legend_makes_way_for_the_length() {
    let mut window = Window::on(measurable());
    window.add_prompt("gallbladder");
    window.until_found();
    for mode in [ViewMode::SideBySide, ViewMode::DepthBeside] {
        window.harness.state_mut().shared.document.mode = mode;
        window.until_picture(|p| {
            p.request.layer == mode.layer() && (p.original.is_some() || p.layer.is_some())
        });
        (0..5).for_each(|_| window.harness.step());
        let legend = |window: &Window| places(window, |text| text.starts_with("gallbladder   "))[0];
        let before = legend(&window);
        window.press(Key::U);
        window.harness.step();
        // The length is written where the legend was.
        let ends = [before.left_center(), before.right_center()].map(|at| {
            let panes = &window.harness.state().shared.viewport.panes;
            panes.picture_position(at - egui::vec2(0.0, 16.0)).unwrap()
        });
        drag(&mut window, ends[0], ends[1]);
        let lengths = places(&window, |text| text.contains(" px") && !text.contains("frame"));
        assert!(lengths.iter().any(|length| length.intersects(before)), "{lengths:?} and {before:?}");
        let after = legend(&window);
        assert!(!lengths.iter().any(|length| length.intersects(after)), "{lengths:?} and {after:?}");
        window.press(Key::U);
        window.harness.step();
    }
}

#[test]
fn where_there_is_no_depth_a_length_is_in_pixels() {
    let mut window = Window::on(Info { has_reconstruction: false, has_features: false, ..measurable() });
    window.press(Key::U);
    window.harness.step();
    drag(&mut window, [0.25, 0.5], [0.75, 0.5]);
    assert!(window.shows("16.0 px  ·  frame 1"));
    assert!(window.shows("Pixels only"));
    window.click("Put away");
    assert!(!window.harness.state().shared.viewport.has_ruler);
}

#[test]
fn a_typed_scale_gives_millimetres_in_the_picture_and_says_so() {
    let mut window = Window::on(Info { has_reconstruction: false, has_features: false, ..measurable() });
    window.press(Key::U);
    window.harness.step();
    drag(&mut window, [0.25, 0.5], [0.75, 0.5]);
    assert!(!window.shows(" mm"));
    window.type_into("Pixels in a millimetre", "4");
    window.click("Set");
    assert!(window.shows("16.0 px  ·  4.0 mm if all is equally far away"));
    assert!(
        window.shows("4 pixels in a millimetre, as typed")
            && window.shows("what is nearer is shorter than it says")
    );
    window.press_with(Modifiers::COMMAND, Key::Z);
    window.harness.step();
    assert!(!window.shows(" mm"));
}

#[test]
fn a_turned_view_gives_pixels_only() {
    let mut window = Window::on(measurable());
    window.press(Key::U);
    window.harness.step();
    drag(&mut window, [0.25, 0.5], [0.75, 0.5]);
    assert!(window.shows("scene units"));
    let look = &mut window.harness.state_mut().shared.document.look;
    look.orbit = look.orbit.dragged([80.0, 0.0], 15.0);
    window.until_picture(|p| !p.request.view.orbit.is_home());
    assert!(window.shows("Pixels only: this view has no measured depth"));
}

#[test]
fn the_point_under_the_pointer_becomes_what_the_view_turns_around() {
    let mut window = Window::on(measurable());
    let pivot = |window: &Window| window.harness.state().shared.document.look.orbit.pivot;
    window.press(Key::C);
    assert_eq!(pivot(&window), None, "the pointer is nowhere");
    assert!(window.shows("Point at the picture and press the key (C)"));
    let at = on_screen(&window, [0.75, 0.5]);
    window.harness.hover_at(at);
    window.harness.step();
    window.press(Key::C);
    let [x, y, z] = pivot(&window).unwrap();
    // 8 px from the middle at 50 units with a focal length of 32 px
    assert!((x - 12.5).abs() < 0.01 && y.abs() < 0.01 && z == 50.0);
    assert!(window.harness.state().shared.document.look.orbit.is_home(), "nothing has turned yet");
    assert!(window.shows("turns around this point from now on"));
}

#[test]
fn in_the_menu_the_view_turns_around_the_point_that_was_clicked() {
    let mut window = Window::on(Info { lens: None, ..measurable() });
    // The menu lies over the picture.
    window.harness.set_size(egui::vec2(900.0, 1400.0));
    (0..3).for_each(|_| window.harness.step());
    click_at(&mut window, [0.25, 0.5]);
    let from_menu = |window: &mut Window| {
        window.click("View");
        let entry = window.harness.get_by_label_contains("Turn around this point").rect().center();
        window.harness.hover_at(entry);
        window.harness.step();
        let panes = &window.harness.state().shared.viewport.panes;
        assert!(panes.picture_position(entry).is_some(), "{entry} is not over {panes:?}");
        window.harness.event(button(entry, true));
        window.harness.step();
        window.harness.event(button(entry, false));
        (0..3).for_each(|_| window.harness.step());
    };
    from_menu(&mut window);
    assert!(window.shows("No depth is known here"));
    window.harness.state_mut().shared.open.as_mut().unwrap().info.lens = measurable().lens;
    from_menu(&mut window);
    let [x, y, z] = window.harness.state().shared.document.look.orbit.pivot.unwrap();
    assert!((x + 12.5).abs() < 0.2 && y.abs() < 0.2 && z == 50.0, "{x} {y}");
}

#[test]
fn the_status_line_has_no_millimetres() {
    let mut window = Window::on(measurable());
    let at = on_screen(&window, [0.5, 0.5]);
    window.harness.hover_at(at);
    window.harness.step();
    window.harness.step();
    assert!(window.shows("depth 50.0 scene units"));
    assert!(!window.shows(" mm"));
}

#[test]
fn a_guessed_shape_has_no_lengths_in_space_and_says_so() {
    let mut window = Window::on(Info { has_measured_depth: false, ..measurable() });
    assert!(window.shows("The shape is guessed"));
    let at = on_screen(&window, [0.5, 0.5]);
    window.harness.hover_at(at);
    window.harness.step();
    window.harness.step();
    assert!(!window.shows("depth 50") && !window.shows("scene units"));
    window.press(Key::U);
    window.harness.step();
    drag(&mut window, [0.25, 0.5], [0.75, 0.5]);
    assert!(window.shows("16.0 px") && window.shows("Pixels only: the shape is guessed"));
    assert!(!window.shows("±") && !window.shows("scene units"));
    assert!(window.harness.query_by_label("Known length in millimetres").is_none());
    window.press(Key::Escape);
    window.press(Key::D);
    window.until_picture(|p| p.layer.is_some());
    let texts = painted(&window);
    assert!(texts.iter().any(|t| t == "near") && !texts.iter().any(|t| t.contains("50.0")), "{texts:?}");
    assert!(texts.iter().any(|t| t == "The shape is guessed"));
}

#[test]
fn a_session_brings_no_millimetres_into_a_guessed_shape() {
    use crate::viewer::state::{measure::Scale, session::Session};
    let folder = tempfile::tempdir().unwrap();
    for (has_measured_depth, comes_back) in [(true, true), (false, false)] {
        let file = folder.path().join("review.surgtpgs");
        let mut session = Session::new("/data/clip.safetensors".into());
        let scale =
            Scale { mm_per_unit: 0.5, relative_uncertainty: 0.0, source: "x".into(), px_per_mm: None };
        session.content.scale = Some(scale);
        session.save(&file).unwrap();
        let mut window = Window::on(Info { has_measured_depth, ..measurable() });
        let ctx = window.harness.ctx.clone();
        window.harness.state_mut().shared.open_path(&file, &ctx);
        window.until(|app| app.saving.saved.file.is_some());
        assert_eq!(window.harness.state().shared.document.content().scale.is_some(), comes_back);
    }
}
