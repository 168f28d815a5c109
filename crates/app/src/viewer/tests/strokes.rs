//! Tests that a stroke has every position of the pointer, however slow the window is.

use super::{
    marking::{marks, share, take_tool, without_features},
    pointing::{button, click_at, drag, on_screen},
    *,
};
use crate::viewer::state::marking::Tool;
use surgtpgs_core::marks::Shape;

/// A way around the middle of the picture.
const WAY: [[f32; 2]; 6] = [[0.2, 0.2], [0.8, 0.2], [0.8, 0.8], [0.6, 0.9], [0.4, 0.9], [0.2, 0.8]];

/// Asserts that points of the recording are those of [`WAY`] from `first` on.
fn assert_is_way(points_px: &[[f32; 2]], first: usize) {
    let expected: Vec<_> = WAY[first..].iter().map(|[u, v]| [u * SIZE.0 as f32, v * SIZE.1 as f32]).collect();
    let is_near = |(a, b): (&[f32; 2], &[f32; 2])| (a[0] - b[0]).hypot(a[1] - b[1]) < 0.1;
    let is_same = points_px.len() == expected.len() && points_px.iter().zip(&expected).all(is_near);
    assert!(is_same, "{points_px:?} for {expected:?}");
}

/// Draws along [`WAY`] from `first` on: the frame of the press has `with_press` moves, the next has the
/// others.
fn draw(window: &mut Window, first: usize, with_press: usize) {
    let way: Vec<_> = WAY[first..].iter().map(|at| on_screen(window, *at)).collect();
    window.harness.hover_at(way[0]);
    window.harness.step();
    let moves = |range: std::ops::Range<usize>| way[range].iter().map(|at| egui::Event::PointerMoved(*at));
    window.harness.input_mut().events.push(button(way[0], true));
    window.harness.input_mut().events.extend(moves(1..1 + with_press));
    window.harness.step();
    window.harness.input_mut().events.extend(moves(1 + with_press..way.len()));
    window.harness.step();
    window.harness.event(button(way[way.len() - 1], false));
    window.harness.step();
    window.harness.step();
}

#[test]
fn positions_in_the_frame_of_the_press_and_several_in_a_later_one_are_drawn() {
    let mut window = Window::on(without_features());
    take_tool(&mut window, "tool");
    for (tool, with_press) in [(Tool::Outline, 0), (Tool::Outline, 2), (Tool::Brush, 0), (Tool::Brush, 2)] {
        window.harness.state_mut().shared.viewport.marking.tool = tool;
        window.harness.step();
        draw(&mut window, 0, with_press);
        assert!(share(&mut window, "tool") > 0.0);
    }
    let made = marks(&window);
    assert_eq!(made.len(), 2, "with either tool, both ways are the same mark");
    for mark in &made {
        match &mark.shape {
            Shape::Polygon { points_px } | Shape::Stroke { points_px, .. } => assert_is_way(points_px, 0),
            other => panic!("{other:?}"),
        }
    }
}

#[test]
fn an_outline_begun_with_corners_goes_on_where_the_button_is_pressed() {
    let mut window = Window::on(without_features());
    take_tool(&mut window, "tool");
    window.harness.state_mut().shared.viewport.marking.tool = Tool::Outline;
    click_at(&mut window, WAY[0]);
    assert!(marks(&window).is_empty());
    draw(&mut window, 1, 1);
    let made = marks(&window);
    let [Mark { shape: Shape::Polygon { points_px }, .. }] = &made[..] else { panic!("{made:?}") };
    assert_is_way(points_px, 0);
}

#[test]
fn the_line_between_two_pictures_is_dragged_without_drawing() {
    let mut window = Window::on(without_features());
    take_tool(&mut window, "tool");
    window.harness.state_mut().shared.document.mode = ViewMode::Wipe;
    (0..5).for_each(|_| window.harness.step());
    drag(&mut window, [0.5, 0.5], [0.7, 0.5]);
    assert!(window.harness.state().shared.viewport.wipe > 0.55);
    assert!(marks(&window).is_empty() && window.harness.state().shared.viewport.marking.draft.is_none());
}
