//! Test of the layout: every state of the window, at six sizes and three sizes of text. No two texts cover
//! each other, none is cut off at its side, and everything that is pressed can be reached.

use super::*;
use crate::viewer::{
    command::{Command, entry},
    state::{phases::Phase, session::Session},
};
use egui::{Pos2, Rect, Shape, pos2, vec2};
use surgtpgs_core::overlay::OverlayStyle;

/// Sizes of the window, in points of text at its normal size.
const SIZES: [[f32; 2]; 6] =
    [[900.0, 600.0], [1024.0, 768.0], [1360.0, 860.0], [1920.0, 1080.0], [2560.0, 1440.0], [3840.0, 2160.0]];
/// Sizes of text, percent.
const SCALES: [u32; 3] = [100, 140, 200];
/// Overlap that is none, points: letters do not fill their line.
const TOLERANCE: f32 = 2.0;
/// Steps until everything has its place.
const STEPS: usize = 5;

/// Something painted, in the order of painting.
enum Painted {
    Text {
        words: String,
        rect: Rect,
        clip: Rect,
    },
    /// An area that hides what is below it.
    Cover(Rect),
}

fn collect(shape: &Shape, clip: Rect, into: &mut Vec<Painted>) {
    match shape {
        Shape::Text(text) => {
            for row in text.galley.rows.iter().filter(|row| !row.text().trim().is_empty()) {
                let rect = row.rect_without_leading_space().translate(text.pos.to_vec2());
                into.push(Painted::Text { words: row.text(), rect: rect.shrink2(vec2(0.0, 2.0)), clip });
            }
        }
        Shape::Rect(rect) if rect.fill.a() > 0xa0 => into.push(Painted::Cover(rect.rect.intersect(clip))),
        Shape::Vec(shapes) => shapes.iter().for_each(|shape| collect(shape, clip, into)),
        _ => {}
    }
}

/// Returns the faults of the layout that is shown.
fn faults(window: &Window) -> Vec<String> {
    let mut painted = Vec::new();
    window.harness.output().shapes.iter().for_each(|s| collect(&s.shape, s.clip_rect, &mut painted));
    let screen = window.harness.ctx.content_rect();
    let mut faults = faults_of_texts(&painted, screen);
    faults.extend(out_of_reach(window, screen));
    faults
}

fn faults_of_texts(painted: &[Painted], screen: Rect) -> Vec<String> {
    let mut faults = Vec::new();
    // Texts so far, with the areas that were painted over each.
    let mut seen: Vec<(&str, Rect, Vec<Rect>)> = Vec::new();
    for item in painted {
        match item {
            Painted::Cover(cover) => seen.iter_mut().for_each(|(.., covers)| covers.push(cover.expand(1.0))),
            Painted::Text { words, rect, clip } => {
                let visible = rect.intersect(*clip);
                if !visible.is_positive() || visible.height() < 1.0 {
                    continue;
                }
                let allowed = clip.intersect(screen).expand(TOLERANCE);
                if rect.left() < allowed.left() || rect.right() > allowed.right() {
                    faults.push(format!("\"{words}\" is cut off: {rect:?} in {allowed:?}"));
                }
                for (other, there, covers) in &seen {
                    let both = visible.intersect(*there);
                    let is_large = both.is_positive() && both.width().min(both.height()) > TOLERANCE;
                    if is_large && !covers.iter().any(|cover| cover.contains_rect(both)) {
                        faults.push(format!("\"{words}\" lies over \"{other}\" at {both:?}"));
                    }
                }
                seen.push((words, visible, Vec::new()));
            }
        }
    }
    faults
}

/// Returns widgets that cannot be reached sideways. Up and down, everything long can be scrolled.
fn out_of_reach(window: &Window, screen: Rect) -> Vec<String> {
    let roles = [Role::Button, Role::CheckBox, Role::RadioButton, Role::Slider, Role::TextInput, Role::Link];
    let nodes = roles.into_iter().flat_map(|role| window.harness.query_all_by_role(role));
    let is_out = |rect: Rect| rect.left() < screen.left() - 1.0 || rect.right() > screen.right() + 1.0;
    let name = |node: &egui_kittest::Node<'_>| node.accesskit_node().label().unwrap_or_default();
    let told =
        |node: egui_kittest::Node<'_>| format!("\"{}\" is out of reach: {:?}", name(&node), node.rect());
    nodes.filter(|node| is_out(node.rect())).map(told).collect()
}

/// Shows the window at every size, and reports all faults.
fn check(what: &str, window: &mut Window) {
    let mut found = Vec::new();
    for size in SIZES {
        for scale in SCALES {
            window.harness.set_size(egui::Vec2::from(size) * 100.0 / scale as f32);
            (0..STEPS).for_each(|_| window.harness.step());
            for fault in faults(window) {
                found.push(format!("{what}, {} × {} at {scale} %: {fault}", size[0], size[1]));
            }
        }
    }
    assert!(found.is_empty(), "{} faults\n{}", found.len(), found[..found.len().min(12)].join("\n"));
}

/// Opens a window on a scene with several prompts, long and short, found and not.
fn with_prompts(count: usize) -> Window {
    let mut window = Window::on(Info { has_measured_depth: false, ..scene() });
    let words = [
        "gallbladder",
        "liver",
        "the second long instrument that comes from the right side of the picture",
        "spleen",
        "nothing",
        "polyp",
        "banana",
        "fat",
        "broken",
    ];
    words.iter().take(count).for_each(|words| window.add_prompt(words));
    window.until_found();
    window
}

#[test]
fn the_start_page_holds() {
    let folder = tempfile::tempdir().unwrap();
    Session::new("/data/clip.safetensors".into()).save(&folder.path().join("0.surgtpgs")).unwrap();
    let mut window = Window::with(Arc::new(FakeBackend { info: scene(), ..Default::default() }));
    check("the notice", &mut window);
    let shared = &mut window.harness.state_mut().shared;
    shared.preferences.is_acknowledged = true;
    shared.opening.demo_folder = Some("/data/demo".into());
    check("the first start page", &mut window);
    let shared = &mut window.harness.state_mut().shared;
    let long = "/home/somebody/recordings/of the year/in a deep folder/laparoscopic cholecystectomy.mp4";
    (0..8).for_each(|i| shared.preferences.remember(Path::new(&format!("{long}{i}"))));
    shared.saving.autosave = Autosave::open(Some(folder.path().to_owned()));
    shared.problem = Some(format!("What should be opened is not there. Check the path. ({long})"));
    check("the full start page", &mut window);
}

#[test]
fn the_start_page_holds_while_work_is_running() {
    let mut window = Window::on(bare());
    window.harness.state_mut().shared.dialog = Some(Dialog::Reconstruct);
    (0..STEPS).for_each(|_| window.harness.step());
    window.click("Start");
    let ctx = window.harness.ctx.clone();
    let second = Path::new("/elsewhere/second");
    window.harness.state_mut().shared.open_path(second, &ctx);
    window.until(|app| app.info().is_some_and(|i| i.path == second));
    let shared = &mut window.harness.state_mut().shared;
    shared.run(Command::StartPage.into(), &ctx);
    let first = "/data/the second long recording of the year that comes from the operating room.safetensors";
    shared.reconstruction.offer(first.into());
    shared.say("An export is running. Close the window again to stop it", None, 1e9);
    window.until_shown("Details of the training");
    check("the start page during work", &mut window);
}

#[test]
fn a_scene_with_and_without_prompts_holds() {
    for count in [0, 3, 9] {
        let mut window = with_prompts(count);
        check(&format!("{count} prompts"), &mut window);
    }
}

#[test]
fn the_picture_keeps_its_room_where_text_is_large() {
    let mut window = with_prompts(3);
    let mut shown = |size: [f32; 2]| {
        window.harness.set_size(size.into());
        (0..STEPS).for_each(|_| window.harness.step());
        let panes = &window.harness.state().shared.viewport.panes;
        (panes.0[0].0.height(), window.shows("Area over time"))
    };
    // 1280 × 800 with text of 100 and of 168 percent.
    let ((large, has_curves), (small, has_small_curves)) = (shown([1280.0, 800.0]), shown([762.0, 476.0]));
    assert!(large > 400.0 && has_curves, "{large}");
    assert!(small > 190.0 && !has_small_curves, "{small}");
}

#[test]
fn every_entry_of_every_menu_can_be_reached() {
    let mut window = with_prompts(1);
    window.harness.set_size(vec2(900.0, 600.0) / 2.0);
    (0..STEPS).for_each(|_| window.harness.step());
    let screen = window.harness.ctx.content_rect();
    for (menu, last) in [
        ("File", Command::Quit),
        ("Edit", Command::CopyAreas),
        ("View", Command::NormalSize),
        ("Time", Command::TimeFarther),
        ("Help", Command::About),
    ] {
        window.click(menu);
        (0..STEPS).for_each(|_| window.harness.step());
        window.harness.get_by_label_contains(entry(last).label).scroll_to_me();
        (0..STEPS * 4).for_each(|_| window.harness.step());
        let rect = window.harness.get_by_label_contains(entry(last).label).rect();
        assert!(screen.contains_rect(rect), "{menu}: {} is at {rect:?}", entry(last).label);
        window.press(Key::Escape);
        window.harness.step();
    }
}

#[test]
fn a_menu_keeps_its_width_while_it_is_scrolled() {
    let mut window = with_prompts(1);
    window.harness.set_size(vec2(900.0, 600.0));
    (0..STEPS).for_each(|_| window.harness.step());
    window.click("Time");
    let label = entry(Command::TimeFarther).label;
    let width = |window: &Window| window.harness.get_by_label_contains(label).rect().width();
    (0..STEPS).for_each(|_| window.harness.step());
    let before = width(&window);
    window.harness.get_by_label_contains(label).scroll_to_me();
    (0..STEPS * 4).for_each(|_| window.harness.step());
    assert!(before > 250.0 && width(&window) == before, "{} after {before}", width(&window));
}

#[test]
fn every_view_holds() {
    let mut window = with_prompts(3);
    for mode in ViewMode::MAIN.into_iter().chain([ViewMode::Motion, ViewMode::Opacity]) {
        window.harness.state_mut().shared.document.mode = mode;
        window.until_picture(|p| p.request.layer == mode.layer());
        check(mode.label(), &mut window);
    }
    window.harness.state_mut().shared.document.mode = ViewMode::Reconstruction;
    let look = &mut window.harness.state_mut().shared.document.look;
    look.orbit = look.orbit.dragged([80.0, 0.0], 15.0);
    window.until_picture(|p| p.unseen_share > 0.0);
    check("a turned view", &mut window);
    window.harness.state_mut().shared.document.look = Default::default();
    window.harness.state_mut().shared.document.overlay.style = OverlayStyle::Heatmap;
    window.until_picture(|p| p.request.look.style == OverlayStyle::Heatmap);
    check("heatmap", &mut window);
    window.harness.state_mut().shared.document.is_hidden = true;
    check("everything hidden", &mut window);
}

#[test]
fn a_recording_before_and_during_its_reconstruction_holds() {
    let report = CheckReport {
        ok: true,
        frames: 48,
        warnings: vec!["Masks hide 94 % of the frames on average; they are probably inverted.".into(); 5],
        camera: "assumed: a field of view of 60° from left to right".into(),
        ..CheckReport::default()
    };
    let mut window = Window::on(bare());
    let outcome = Some(Ok(Checked { report, can_flip: true }));
    window.harness.state_mut().shared.reconstruction.check.as_mut().unwrap().outcome = outcome;
    check("a recording", &mut window);
    window.harness.set_size(vec2(1280.0, 800.0));
    (0..STEPS).for_each(|_| window.harness.step());
    window.harness.state_mut().shared.dialog = Some(Dialog::Reconstruct);
    check("the questions before training", &mut window);
    window.harness.set_size(vec2(1280.0, 800.0));
    (0..STEPS).for_each(|_| window.harness.step());
    window.click("Start");
    window.until_shown("Details of the training");
    window.click("Details of the training");
    window.until_shown("Loss over the steps, now total");
    check("training", &mut window);
}

#[test]
fn every_dialog_holds() {
    let mut window = with_prompts(3);
    (0..12).for_each(|frame| window.harness.state_mut().shared.document.toggle_bookmark(frame));
    for (k, name) in ["Preparation", "Dissection of the gallbladder", "End"].iter().enumerate() {
        window.harness.state_mut().shared.document.add_phase(Phase::new(name, 10 * k, 10 * k + 8));
    }
    for dialog in [
        Dialog::Export,
        Dialog::Quality,
        Dialog::GoToFrame,
        Dialog::Bookmarks,
        Dialog::Phases,
        Dialog::Comparison,
        Dialog::Shortcuts,
        Dialog::About,
    ] {
        window.harness.state_mut().shared.dialog = Some(dialog);
        check(&format!("{dialog:?}"), &mut window);
    }
    window.harness.state_mut().shared.dialog = None;
    let ctx = window.harness.ctx.clone();
    window.harness.state_mut().shared.run(Command::OpenPath.into(), &ctx);
    check("the own dialog for paths", &mut window);
}

#[test]
fn the_buttons_of_long_dialogs_are_always_seen() {
    let mut scene_window = with_prompts(3);
    let mut bare_window = Window::on(bare());
    let windows = [
        (&mut scene_window, Dialog::Export, "Start export"),
        (&mut bare_window, Dialog::Reconstruct, "Start"),
    ];
    for (window, dialog, start) in windows {
        window.harness.state_mut().shared.dialog = Some(dialog);
        for size in [[1280.0_f32, 800.0], [900.0, 600.0], [450.0, 300.0]] {
            window.harness.set_size(size.into());
            (0..STEPS).for_each(|_| window.harness.step());
            let screen = window.harness.ctx.content_rect();
            for label in [start, "Cancel"] {
                let rect = window.harness.get_by_label(label).rect();
                assert!(screen.contains_rect(rect), "{label} is at {rect:?} of {size:?}");
            }
        }
    }
}

#[test]
fn cards_and_messages_over_the_picture_hold() {
    let mut window = with_prompts(3);
    window.harness.state_mut().shared.viewport.probe = Some([0.3, 0.4]);
    window.until_picture(|p| p.sample.is_some());
    check("a probed point", &mut window);
    window.harness.state_mut().shared.viewport.probe = None;
    window.harness.state_mut().shared.viewport.has_ruler = true;
    check("the ruler", &mut window);
    window.harness.state_mut().shared.viewport.has_ruler = false;
    window.harness.state_mut().shared.document.remove(1);
    let text = "Deleted \"the second long instrument that comes from the right side of the picture\"";
    let back = Some(crate::viewer::state::toast::Back::Undo);
    window.harness.state_mut().shared.say(text, back, 1e9);
    check("a message", &mut window);
    window.harness.state_mut().shared.problem = Some("The disk is full. Make room. ".repeat(12));
    check("a problem", &mut window);
}

#[test]
fn marking_by_hand_holds() {
    let mark = |frame: usize, name: &str| {
        let shape = surgtpgs_core::marks::Shape::Click { point_px: [9.0, 9.0], radius_px: 4.0 };
        Mark::new(frame, name, true, shape)
    };
    let mut window = with_prompts(3);
    let shared = &mut window.harness.state_mut().shared;
    shared.viewport.marking.is_on = true;
    check("the tool for marking", &mut window);
    let shared = &mut window.harness.state_mut().shared;
    shared.viewport.marking.name = "liver".into();
    shared.document.add_mark(mark(0, "the second long instrument that comes from the right side"));
    shared.document.add_mark(mark(7, "liver"));
    window.until_found();
    check("marks", &mut window);
    let mut window = Window::on(bare());
    window.harness.state_mut().shared.document.add_mark(mark(3, "tool"));
    check("marks that wait", &mut window);
    window.harness.state_mut().shared.viewport.marking.is_on = true;
    check("the tool on a recording", &mut window);
}

#[test]
fn the_side_panel_keeps_its_width_whatever_it_says() {
    let mut window = Window::on(scene());
    let width = |window: &Window| window.harness.get_by_label("Prompt").rect().width();
    let before = width(&window);
    window.add_prompt("the second long instrument that comes from the right side of the picture, and more");
    window.until_found();
    assert_eq!(width(&window), before);
    let border = window.harness.get_by_label("Width of the panel").rect().center();
    let to = border - vec2(100.0, 0.0);
    drag(&mut window, border, to);
    assert!((width(&window) - before - 100.0).abs() < 2.0, "{} after {before}", width(&window));
    assert!((window.harness.state().shared.preferences.panel_width - 440.0).abs() < 2.0);
}

fn drag(window: &mut Window, from: Pos2, to: Pos2) {
    let button = |pos, pressed| egui::Event::PointerButton {
        pos,
        button: egui::PointerButton::Primary,
        pressed,
        modifiers: Modifiers::NONE,
    };
    window.harness.hover_at(from);
    window.harness.step();
    window.harness.event(button(from, true));
    window.harness.step();
    for i in 1..=5 {
        window.harness.hover_at(from.lerp(to, i as f32 / 5.0));
        window.harness.step();
    }
    window.harness.event(button(to, false));
    window.harness.step();
    window.harness.step();
}

#[test]
fn the_list_of_prompts_takes_the_room_there_is() {
    let mut window = with_prompts(3);
    window.harness.set_size(vec2(1360.0, 860.0));
    (0..STEPS).for_each(|_| window.harness.step());
    let screen = window.harness.ctx.content_rect();
    for words in ["gallbladder", "liver"] {
        let row = window.harness.get_by_label(&format!("Delete {words}")).rect();
        assert!(screen.contains_rect(row), "{words}");
    }
    assert!(screen.contains(pos2(700.0, window.harness.get_by_label("Below instruments").rect().bottom())));
}

#[test]
fn a_layout_with_faults_is_found_out() {
    let screen = Rect::from_min_max(Pos2::ZERO, pos2(400.0, 300.0));
    let text = |words: &str, x: f32, y: f32| {
        let rect = Rect::from_min_size(pos2(x, y), vec2(80.0, 12.0));
        Painted::Text { words: words.into(), rect, clip: screen }
    };
    let told = |painted: &[Painted]| faults_of_texts(painted, screen).len();
    assert_eq!(told(&[text("one", 10.0, 10.0), text("below", 10.0, 24.0)]), 0);
    assert_eq!(told(&[text("one", 10.0, 10.0), text("over it", 50.0, 15.0)]), 1);
    let plate = Painted::Cover(Rect::from_min_size(Pos2::ZERO, vec2(200.0, 50.0)));
    assert_eq!(told(&[text("one", 10.0, 10.0), plate, text("on a plate", 50.0, 15.0)]), 0);
    assert_eq!(told(&[text("at the side", 350.0, 10.0)]), 1);
}
