//! Tests of clicks and boxes that become the masks of what they point at.

use super::{
    marking::{marks, take_tool, without_features},
    pointing::{click_at, drag},
    *,
};
use crate::viewer::{backend::paths::Picked, state::marking::Tool};
use surgtpgs_core::marks::Shape;

/// A window on a recording whose frames are at hand, with a tool that points and the network of a folder.
fn pointing(tool: Tool, folder: &str) -> Window {
    let mut window = Window::on(Info { sequence: Some("/data/clip".into()), ..without_features() });
    let shared = &mut window.harness.state_mut().shared;
    shared.preferences.models.masks = folder.into();
    shared.preferences.finds_borders = true;
    shared.viewport.marking.tool = tool;
    take_tool(&mut window, "tool");
    window
}

#[test]
fn a_click_or_a_box_becomes_the_mask_of_what_is_there() {
    for tool in [Tool::Click, Tool::Box] {
        let mut window = pointing(tool, "/sam");
        window.backend.is_network_slow.store(true, Ordering::Relaxed);
        match tool {
            Tool::Click => click_at(&mut window, [0.25, 0.5]),
            _ => drag(&mut window, [0.1, 0.1], [0.4, 0.4]),
        }
        window.until_shown("Finding the borders of 1 mark…");
        assert!(marks(&window).is_empty(), "not yet");
        window.backend.is_network_slow.store(false, Ordering::Relaxed);
        window.until(|app| !app.document.marks().is_empty());
        let made = marks(&window);
        let [Mark { frame: 0, add: true, shape: shape @ Shape::Mask(_), .. }] = &made[..] else {
            panic!("{made:?}");
        };
        let (width, height) = (SIZE.0 as usize, SIZE.1 as usize);
        assert_eq!(shape.pixels(width, height).count(), width * height / 2);
        window.press_with(Modifiers::COMMAND, Key::Z);
        assert!(marks(&window).is_empty(), "one undo takes it back");
    }
}

#[test]
fn several_clicks_wait_for_each_other_and_none_is_lost() {
    let mut window = pointing(Tool::Click, "/blind");
    window.backend.is_network_slow.store(true, Ordering::Relaxed);
    for x in [0.2, 0.4, 0.6] {
        click_at(&mut window, [x, 0.5]);
    }
    window.until_shown("Finding the borders of 3 marks…");
    window.backend.is_network_slow.store(false, Ordering::Relaxed);
    window.until(|app| app.document.marks().all().len() == 3);
    assert!(marks(&window).iter().all(|mark| matches!(mark.shape, Shape::Click { .. })));
    window.until_shown("No object was found there");
}

#[test]
fn a_network_that_fails_is_told_and_the_mark_counts() {
    let mut window = pointing(Tool::Click, "/broken");
    click_at(&mut window, [0.25, 0.5]);
    window.until(|app| app.document.marks().all().len() == 1);
    window.until_shown("The network is damaged");
    assert!(matches!(marks(&window)[0].shape, Shape::Click { .. }));
}

#[test]
fn strokes_are_as_they_were_drawn() {
    let mut window = pointing(Tool::Brush, "/sam");
    drag(&mut window, [0.2, 0.5], [0.6, 0.5]);
    assert!(matches!(marks(&window)[..], [Mark { shape: Shape::Stroke { .. }, .. }]));
}

#[test]
fn the_first_wish_for_borders_asks_for_a_network() {
    let mut window = Window::on(Info { sequence: Some("/data/clip".into()), ..without_features() });
    window.harness.state_mut().shared.viewport.marking.tool = Tool::Click;
    take_tool(&mut window, "tool");
    assert!(!window.harness.state().shared.finds_borders());
    *window.backend.picked.lock().unwrap() = Some(Picked::Path("/models/sam".into()));
    window.click("Find the borders");
    window.until(|app| app.preferences.finds_borders);
    assert!(window.harness.state().shared.finds_borders());
    window.click("Find the borders");
    window.harness.step();
    assert!(!window.harness.state().shared.finds_borders());
}
