//! Tests of everything that could mislead a user. (Nothing found, frames that do not match, lengths and
//! scores have tests of their own beside their parts.)

use super::*;
use surgtpgs_core::overlay::OverlayStyle;

#[test]
fn left_is_left_and_up_is_up() {
    let mut window = Window::on(scene());
    window.add_prompt("gallbladder");
    window.press(Key::O);
    window.until_found();
    window.until_picture(|p| p.request.look.style == OverlayStyle::Fill);
    let (width, height) = (SIZE.0 as usize, SIZE.1 as usize);
    let picture = window.harness.state().shared.picture().unwrap();
    let pane = picture.reconstruction.as_ref().unwrap();
    assert_eq!(pane.bare.size, [width, height]);
    let marked = pane.marked.as_ref().unwrap();
    let is_marked = |x: usize, y: usize| marked.pixels[y * width + x] != pane.bare.pixels[y * width + x];
    assert!(is_marked(1, height / 2) && !is_marked(width - 2, height / 2), "the left part is found");
    // On the screen, too, the picture's origin is its upper left corner.
    let at = |point| window.harness.state().shared.viewport.panes.screen_positions(point).next().unwrap().1;
    let (origin, end) = (at([0.0, 0.0]), at([1.0, 1.0]));
    assert!(origin.x < end.x && origin.y < end.y);
}

#[test]
fn a_view_that_nobody_recorded_says_so() {
    let mut window = Window::on(scene());
    assert!(!window.shows("synthesised view"));
    let look = &mut window.harness.state_mut().shared.document.look;
    look.orbit = look.orbit.dragged([80.0, 0.0], 15.0);
    window.until_picture(|p| !p.request.view.orbit.is_home());
    assert!(window.shows("synthesised view"));
    window.press(Key::R);
    window.until_picture(|p| p.request.view.orbit.is_home());
    assert!(!window.shows("synthesised view"));
    window.press_with(Modifiers::COMMAND, Key::Z);
    window.until_picture(|p| !p.request.view.orbit.is_home());
}

#[test]
fn the_picture_names_what_was_applied_not_what_is_being_typed() {
    let mut window = Window::on(scene());
    window.add_prompt("gallbladder");
    window.until_found();
    window.type_prompt("liv");
    let label = window.harness.get_by_role(Role::Image).accesskit_node().label().unwrap();
    assert!(label.contains("gallbladder 25 %") && !label.contains("liv"), "{label}");
}

#[test]
fn a_prompt_says_what_it_is_compared_with_and_is_exported_so() {
    let mut window = Window::on(scene());
    window.add_prompt("gallbladder");
    window.press(Key::N);
    window.harness.step();
    window.click("As in the paper");
    // The dialog grows by the paper's phrases.
    window.harness.step();
    window.harness.step();
    window.click("texture");
    window.type_into("Another phrase", "smoke");
    window.press(Key::Enter);
    // The dialog grows by a row.
    window.harness.step();
    window.harness.step();
    window.click("Close");
    let phrases = ["object", "things", "stuff", "smoke"];
    window.until_picture(|p| {
        !p.findings.is_empty() && p.request.prompts[0].question.negatives.phrases == phrases
    });
    let id = window.harness.state().shared.document.prompts()[0].id;
    window.harness.state_mut().shared.document.set_but_not(id, &["fat".to_owned()]);
    window.press_with(Modifiers::COMMAND, Key::E);
    window.harness.step();
    window.click("Start export");
    let backend = window.backend.clone();
    window.until(|_| !backend.exported.lock().unwrap().is_empty());
    let exported = backend.exported.lock().unwrap();
    assert_eq!(exported[0].1.phrases, phrases);
    assert_eq!(
        exported[0].0.questions[0].question.negatives.phrases,
        ["object", "things", "stuff", "smoke", "fat"]
    );
}

#[test]
fn a_prompt_has_exceptions_of_its_own() {
    let mut window = Window::on(scene());
    window.add_prompt("gallbladder");
    window.add_prompt("liver");
    window.click("More about liver");
    window.type_into("liver but not", "fat, bile");
    // It acts at once, and Esc keeps it.
    window.press(Key::Escape);
    window.until_picture(|p| p.findings.len() == 2);
    window.until_picture(|p| {
        let negatives = |k: usize| &p.request.prompts[k].question.negatives.phrases;
        negatives(0).is_empty() && *negatives(1) == ["fat", "bile"]
    });
}

#[test]
fn one_menu_serves_all_prompts_and_loses_no_words() {
    let mut window = Window::on(scene());
    ["polyp", "liver", "fat"].into_iter().for_each(|words| window.add_prompt(words));
    let words = |window: &Window| -> Vec<String> {
        window.harness.state().shared.document.prompts().iter().map(|p| p.text.clone()).collect()
    };
    let layers = |window: &Window| window.harness.ctx.memory(|m| m.layer_ids().len());

    window.click("More about fat");
    let with_one_menu = layers(&window);
    for (words_before, typed, other) in [("fat", " tissue", "liver"), ("liver", " lobe", "polyp")] {
        let field = format!("Words of {words_before}");
        window.type_into(&field, typed);
        window.click(&format!("More about {other}"));
        assert!(words(&window).iter().any(|w| w.contains(typed)), "leaving a field keeps what was typed");
        assert!(window.harness.query_by_label(&format!("Words of {other}")).is_some());
        assert_eq!(window.harness.query_all_by_label_contains("Words of").count(), 1);
    }
    let before = words(&window);
    window.click("Move down");
    assert_eq!(words(&window), [before[1].as_str(), "polyp", &before[2]]);
    assert!(window.harness.query_by_label("Words of polyp").is_some(), "the menu goes with its prompt");
    assert_eq!(layers(&window), with_one_menu, "egui keeps every layer it ever had");

    window.click("More about polyp");
    assert!(window.harness.query_by_label("Words of polyp").is_none(), "its button closes it");
    window.click("More about polyp");
    window.click("Delete polyp");
    window.press_with(Modifiers::COMMAND, Key::Z);
    assert_eq!(words(&window)[1], "polyp");
    assert!(window.harness.query_by_label("Words of polyp").is_none(), "it closed with its prompt");

    window.click("More about polyp");
    let open = window.harness.state_mut().shared.open.take();
    window.harness.step();
    window.harness.state_mut().shared.open = open;
    window.harness.step();
    assert!(window.harness.query_by_label("More about polyp").is_some());
    assert!(window.harness.query_by_label("Words of polyp").is_none(), "it closed with its recording");
}

#[test]
fn words_used_before_and_those_of_an_operation_are_suggested() {
    let mut window = Window::on(Info { example_prompts: Vec::new(), ..scene() });
    window.add_prompt("polyp");
    window.click("Delete polyp");
    window.click("Suggestions");
    assert!(window.shows("Looked for before"));
    window.click("polyp");
    window.click("cystic duct");
    let words: Vec<_> =
        window.harness.state().shared.document.prompts().iter().map(|p| p.text.clone()).collect();
    assert_eq!(words, ["polyp", "cystic duct"]);
    // A recording whose classes are known suggests these.
    let classes = vec!["fat".to_owned()];
    let mut window = Window::on(Info { example_prompts: classes, ..scene() });
    window.click("Suggestions");
    assert!(window.shows("Classes of this recording") && !window.shows("cystic duct"));
}

#[test]
fn text_can_be_made_larger_by_key_and_stays_so() {
    let mut window = Window::on(scene());
    window.press_with(Modifiers::COMMAND, Key::Plus);
    window.harness.step();
    window.harness.step();
    assert!((window.harness.ctx.zoom_factor() - 1.2).abs() < 1e-6);
    window.press_with(Modifiers::COMMAND, Key::Num0);
    window.harness.step();
    window.harness.step();
    assert!((window.harness.ctx.zoom_factor() - 1.0).abs() < 1e-6);
}

#[test]
fn everything_that_is_pressed_has_a_name() {
    let mut window = Window::on(scene());
    window.add_prompt("gallbladder");
    window.press(Key::M);
    window.until(|app| app.selected_curve().is_some_and(|curve| curve.is_complete()));
    let mut num_named = 0;
    for role in [Role::Button, Role::Slider, Role::CheckBox, Role::RadioButton, Role::TextInput] {
        for node in window.harness.query_all_by_role(role) {
            let node = node.accesskit_node();
            let name = node.label().or_else(|| node.value()).unwrap_or_default();
            assert!(!name.trim().is_empty(), "a {role:?} without a name");
            num_named += 1;
        }
    }
    assert!(num_named > 20, "{num_named}");
}

#[test]
fn what_is_pressed_is_large_enough_for_a_hurried_hand() {
    let window = Window::on(scene());
    for label in ["Play or pause", "Bookmark", "Hide all overlays", "Repeat"] {
        let size = window.harness.get_by_role_and_label(Role::Button, label).rect().size();
        assert!(size.x >= 32.0 && size.y >= 32.0, "{label}: {size:?}");
    }
}
