//! Tests of the overlay: opacity, instruments, cleaned masks.

use super::*;
use crate::viewer::{
    picture::{
        copy::{Shown, copy},
        notes::{FADED, GUESSED, SYNTHESISED},
        request::Pane,
    },
    state::saving::Origin,
};
use egui::Color32;
use surgtpgs_core::{mask::CleanUp, overlay::OverlayStyle, palette::Palette};

/// Returns a pixel of the picture without and with everything found.
fn pixel(window: &Window, x: usize, y: usize) -> [Color32; 2] {
    let pane = window.harness.state().shared.picture().unwrap().reconstruction.as_ref().unwrap();
    [&pane.bare, pane.marked.as_ref().unwrap()].map(|image| image.pixels[y * SIZE.0 as usize + x])
}

fn is_drawn(window: &Window, x: usize, y: usize) -> bool {
    let [bare, marked] = pixel(window, x, y);
    bare != marked
}

/// Opens a window with one prompt, whose fill is drawn, and waits for its result.
fn with_prompt(info: Info, prompt: &str) -> Window {
    let mut window = Window::on(info);
    window.harness.state_mut().shared.document.overlay.style = OverlayStyle::Fill;
    window.add_prompt(prompt);
    window.until_found();
    window.until_picture(|p| p.request.look.style == OverlayStyle::Fill);
    window
}

#[test]
fn outlines_have_an_opacity_of_their_own() {
    let mut window = with_prompt(scene(), "gallbladder");
    window.harness.state_mut().shared.document.overlay.style = OverlayStyle::Outline;
    window.until_picture(|p| p.request.look.style == OverlayStyle::Outline);
    let own = window.harness.state().shared.document.prompts()[0].colour;
    assert_eq!(painted_lines(&window, own).len(), 1);
    window.press_with(Modifiers::SHIFT, Key::O);
    window.until_picture(|p| p.request.look.outline_opacity < 0.3);
    assert!(painted_lines(&window, own).is_empty(), "fainter than its colour");
    assert!(window.shows("outline"));
}

#[test]
fn what_was_found_has_its_outline_over_depth() {
    let mut window = with_prompt(scene(), "gallbladder");
    let own = window.harness.state().shared.document.prompts()[0].colour;
    window.press(Key::D);
    window.until_picture(|p| p.layer.is_some() && p.reconstruction.is_none() && !p.findings.is_empty());
    assert_eq!(painted_lines(&window, own).len(), 1);
}

#[test]
fn a_frame_where_nothing_is_found_is_told_in_one_wording() {
    let mut window = with_prompt(scene(), "gallbladder");
    // All of it is smaller than what is removed.
    let clean_up = CleanUp { min_area_px: SIZE.0 as usize * SIZE.1 as usize, ..CleanUp::default() };
    window.harness.state_mut().shared.document.set_clean_up(clean_up);
    window.until_picture(|p| p.request.clean_up == clean_up && !p.findings.is_empty());
    assert!(window.harness.query_all_by_label(NOTHING).count() >= 2, "in the row and on the picture");
    assert!(!window.shows("0 % of the picture"));
}

#[test]
fn lines_are_as_wide_on_an_enlarged_picture_as_on_the_whole_one() {
    let mut window = with_prompt(scene(), "gallbladder");
    let own = window.harness.state().shared.document.prompts()[0].colour;
    let before = painted_lines(&window, own);
    let panes = window.harness.state().shared.viewport.panes.clone();
    let look = &mut window.harness.state_mut().shared.document.look;
    look.zoom.magnify(4.0, panes.0[0].0.center(), &panes);
    (0..3).for_each(|_| window.harness.step());
    let after = painted_lines(&window, own);
    let height = |lines: &[(Vec<egui::Pos2>, f32)]| {
        let points = &lines[0].0;
        (points[0].y - points[points.len() - 1].y).abs()
    };
    assert!(height(&after) > 3.0 * height(&before));
    assert_eq!(after[0].1, before[0].1, "the width");
}

#[test]
fn a_heatmap_has_a_palette_to_choose_and_a_scale() {
    let mut window = with_prompt(scene(), "gallbladder");
    window.click("Heatmap");
    window.until_picture(|p| p.request.look.style == OverlayStyle::Heatmap);
    assert!(window.harness.state().shared.picture().unwrap().outlines.lines.is_empty());
    assert!(painted(&window).iter().any(|text| text.starts_with("similarity score")));
    let hot = pixel(&window, 2, 12)[1];
    window.click("Viridis");
    window.until_picture(|p| p.request.look.palette == Palette::Viridis);
    let expected = Palette::Viridis.colour(0.8).map(|v| (0.65 * v).round());
    let drawn = pixel(&window, 2, 12)[1];
    let near = |a: u8, b: f32| (f32::from(a) - b).abs() <= 1.0;
    assert!(hot != drawn && near(drawn.r(), expected[0]) && near(drawn.g(), expected[1]), "{drawn:?}");
}

#[test]
fn the_legend_is_smaller_on_a_small_picture_and_keeps_the_names() {
    let mut window = Window::on(scene());
    ["gallbladder", "spleen", "nothing"].iter().for_each(|words| window.add_prompt(words));
    window.until_found();
    let says = |window: &mut Window, size: [f32; 2]| {
        window.harness.set_size(size.into());
        (0..5).for_each(|_| window.harness.step());
        painted(window)
    };
    let has = |texts: &[String], words: &str| texts.iter().any(|text| text == words);
    let large = says(&mut window, [1360.0, 860.0]);
    assert!(has(&large, "gallbladder   25 % of the picture"), "{large:?}");
    // A window of 900 × 600 with text of twice the size.
    let small = says(&mut window, [450.0, 300.0]);
    assert!(has(&small, "gallbladder") && !has(&small, "gallbladder   25 % of the picture"), "{small:?}");
    // Where both are too long, the name stays.
    for (name, gone) in [("spleen", "not in this recording"), ("nothing", "not on this frame")] {
        assert!(has(&large, &format!("{name}   {gone}")), "{large:?}");
        assert!(small.iter().any(|text| text.starts_with(name)) && !has(&small, gone), "{small:?}");
    }
}

#[test]
fn in_a_low_panel_what_was_found_goes_before_the_buttons() {
    let mut window = Window::on(scene());
    window.add_prompt("gallbladder");
    window.until_found();
    let mut is_first = |size: [f32; 2]| {
        window.harness.set_size(size.into());
        (0..5).for_each(|_| window.harness.step());
        let [row, button] = ["Delete gallbladder", "Compared with…"]
            .map(|label| window.harness.get_by_label(label).rect().top());
        row < button
    };
    assert!(!is_first([1360.0, 860.0]) && is_first([450.0, 300.0]));
}

/// Copies the picture; returns the copy, if there is one.
fn copied(window: &mut Window) -> Option<egui::ColorImage> {
    window.harness.input_mut().events.push(egui::Event::Copy);
    window.harness.step();
    let commands = &window.harness.output().platform_output.commands;
    commands.iter().find_map(|command| match command {
        egui::OutputCommand::CopyImage(image) => Some(image.clone()),
        _ => None,
    })
}

#[test]
fn the_picture_is_copied_as_it_is_shown() {
    let mut window = with_prompt(scene(), "gallbladder");
    let image = copied(&mut window).unwrap();
    assert_eq!(image.size, [SIZE.0 as usize, SIZE.1 as usize]);
    window.harness.step();
    assert!(window.shows("The picture is copied, 32 × 24 pixels"));
    window.press_with(Modifiers::SHIFT, Key::W);
    window.until_picture(|p| p.original.is_some() && p.reconstruction.is_some());
    assert_eq!(copied(&mut window).unwrap().size, [2 * SIZE.0 as usize, SIZE.1 as usize]);
    window.type_prompt("fat");
    assert!(copied(&mut window).is_none(), "text that is typed has the keys");
}

#[test]
fn a_copy_has_what_was_found_and_its_name_and_is_cut_to_what_is_seen() {
    let window = with_prompt(scene(), "gallbladder");
    let mut picture = window.harness.state().shared.picture().unwrap().clone();
    let image = |colour| Arc::new(egui::ColorImage::filled([320, 240], colour));
    let (bare, marked) = (image(Color32::BLUE), Some(image(Color32::GREEN)));
    picture.reconstruction = Some(Pane { bare, marked });
    let (mode, notes) = (ViewMode::Reconstruction, &["Stopped early".to_owned()]);
    let shown = Shown { mode, is_hidden: false, wipe: 0.5, seconds: 0.0, notes: &[] };
    let own = window.harness.state().shared.document.prompts()[0].colour;
    let own = Color32::from_rgb(own[0], own[1], own[2]);
    let whole = copy(&picture, shown, &[]).unwrap();
    let count = |image: &egui::ColorImage, colour| image.pixels.iter().filter(|p| **p == colour).count();
    assert!(whole.size == [320, 240] && count(&whole, Color32::GREEN) > 60_000);
    assert!(count(&whole, own) > 200, "the line, and the swatch of its name");
    let noted = copy(&picture, Shown { notes, ..shown }, &[]).unwrap();
    assert!(count(&noted, Color32::BLACK) > count(&whole, Color32::BLACK), "a line more");
    let hidden = copy(&picture, Shown { is_hidden: true, ..shown }, &[]).unwrap();
    assert_eq!((count(&hidden, own), count(&hidden, Color32::GREEN)), (0, 0));
    let seen = egui::Rect::from_min_max(egui::pos2(0.5, 0.25), egui::pos2(1.0, 0.75));
    assert_eq!(copy(&picture, shown, &[seen]).unwrap().size, [160, 120]);
}

#[test]
fn copies_say_what_must_be_known_about_the_picture() {
    let notes = |window: &Window| window.harness.state().shared.picture_notes();
    let mut window = Window::on(scene());
    assert!(notes(&window).is_empty());
    let look = &mut window.harness.state_mut().shared.document.look;
    look.orbit = look.orbit.dragged([80.0, 0.0], 15.0);
    window.until_picture(|p| p.unseen_share == 0.5);
    assert_eq!(notes(&window), [SYNTHESISED, FADED]);
    window.press(Key::R);
    window.until_picture(|p| p.request.view.orbit.is_home());
    window.press(Key::D);
    window.until_picture(|p| p.layer.is_some());
    assert!(notes(&window).iter().any(|note| note.starts_with("depth, scene units: near")));
    window.press(Key::F);
    window.until_picture(|p| p.difference.is_some());
    assert_eq!(notes(&window), ["difference, levels of 255: 0 (blue) to 64 or more (yellow)"]);

    let mut window = Window::on(Info { learned: 0.4, has_measured_depth: false, ..scene() });
    let cautions = ["Stopped early, after 40 % of its learning", GUESSED];
    assert_eq!(notes(&window), cautions);
    window.add_prompt("gallbladder");
    window.until_found();
    assert_eq!(notes(&window), cautions, "nothing unusual");
    let grown = CleanUp { grow_px: 2, ..CleanUp::default() };
    window.harness.state_mut().shared.document.set_clean_up(grown);
    assert_eq!(notes(&window), [cautions[0], cautions[1], "masks cleaned up"]);
    window.harness.state_mut().shared.document.mode = ViewMode::Original;
    window.until_picture(|p| p.original.is_some());
    assert_eq!(notes(&window), ["masks cleaned up"], "the recorded frame is as it is");

    let mut window = Window::on(Info { has_measured_depth: false, ..scene() });
    window.press(Key::D);
    window.until_picture(|p| p.layer.is_some());
    assert_eq!(notes(&window), [GUESSED, "depth: near (yellow) to far (blue)"], "once");

    // On a picture of this size, the notes lie between the title and the stamp.
    let [plain, warned] = [1.0, 0.4].map(|learned| {
        let mut window = Window::on(Info { learned, ..scene() });
        let shown = window.harness.state_mut().shared.open.as_mut().unwrap().shown.as_mut().unwrap();
        let bare = Arc::new(egui::ColorImage::filled([320, 240], Color32::BLUE));
        shown.picture.reconstruction = Some(Pane { bare, marked: None });
        copied(&mut window).unwrap()
    });
    let count = |image: &egui::ColorImage| image.pixels.iter().filter(|p| **p == Color32::BLUE).count();
    assert!(plain.size == [320, 240] && count(&warned) < count(&plain), "a line more");
}

#[test]
fn masks_are_cleaned_up_from_the_beginning_and_sessions_keep_what_was_chosen() {
    let large = Info { width: 854, height: 480, ..scene() };
    let mut window = Window::on(large);
    window.add_prompt("gallbladder");
    window.until_found();
    let shared = &window.harness.state().shared;
    assert_eq!(shared.document.content().clean_up, CleanUp::usual(854, 480));
    assert!(!window.shows("masks cleaned up"), "nothing unusual");
    window.harness.state_mut().shared.document.set_clean_up(CleanUp::default());
    let session = window.harness.state().shared.session().unwrap();
    let text = serde_json::to_string(&session).unwrap();
    assert!(text.contains("\"round_px\":0"), "{text}");
    let mut window = Window::on(Info { width: 854, height: 480, ..scene() });
    assert!(!window.harness.state().shared.is_unsaved(), "what is usual need not be saved");
    let ctx = window.harness.ctx.clone();
    let origin = Origin::File("/data/clip.surgtpgs".into());
    window.harness.state_mut().shared.open_session(session, origin, &ctx);
    window.until(|app| app.document.content().clean_up.is_off() && !app.document.prompts().is_empty());
}

#[test]
fn what_is_found_lies_below_the_instruments_until_it_is_to_lie_above() {
    let mut window = with_prompt(Info { name: "with tools".into(), ..scene() }, "gallbladder");
    assert!(!is_drawn(&window, 7, 3) && is_drawn(&window, 7, 20), "the upper half is instrument");
    window.press_with(Modifiers::ALT, Key::O);
    window.until_picture(|p| !p.request.look.below_instruments);
    assert!(is_drawn(&window, 7, 3) && is_drawn(&window, 7, 20));
    window.scroll_and_click("Below instruments");
    window.until_picture(|p| p.request.look.below_instruments);
    // The recorded mask does not tell the place of instruments in a turned view.
    let look = &mut window.harness.state_mut().shared.document.look;
    look.orbit = look.orbit.dragged([80.0, 0.0], 15.0);
    window.until_picture(|p| !p.request.view.orbit.is_home());
    assert!(is_drawn(&window, 7, 3));
}

#[test]
fn a_prompt_about_an_instrument_lies_above_the_others() {
    let mut window = with_prompt(Info { name: "with tools".into(), ..scene() }, "grasper");
    assert!(window.harness.state().shared.document.prompts()[0].is_instrument, "by its name");
    assert!(is_drawn(&window, 7, 3), "its outline is not hidden by what it outlines");
    window.click("More about grasper");
    window.click("This is an instrument");
    window.until_picture(|p| !p.request.prompts[0].is_instrument);
    assert!(!is_drawn(&window, 7, 3));
    assert_eq!(window.harness.state().shared.document.undo_name(), Some("\"grasper\" is no instrument"));
}

#[test]
fn masks_are_cleaned_up_in_the_window_as_in_exports_and_off_is_the_raw_mask() {
    let mut window = with_prompt(scene(), "gallbladder");
    let raw = window.harness.state().shared.picture().unwrap().outlines.clone();
    let grown = CleanUp { grow_px: 2, ..CleanUp::default() };
    window.harness.state_mut().shared.document.set_clean_up(grown);
    window.until_picture(|p| p.request.clean_up == grown);
    window.until(|app| app.selected_curve().is_some_and(|curve| curve.is_complete()));
    // 8 and 2 of 32 columns
    assert!(window.shows("31 % of the picture") && window.shows("masks cleaned up"));
    let curve = window.harness.state().shared.selected_curve().unwrap();
    assert_eq!(curve.points[5].unwrap().area_px, 10 * SIZE.1 as usize, "the curve is that of the picture");
    window.press_with(Modifiers::COMMAND, Key::E);
    window.harness.step();
    window.click("Start export");
    let backend = window.backend.clone();
    window.until(|_| !backend.exported.lock().unwrap().is_empty());
    assert_eq!(backend.exported.lock().unwrap()[0].0.options.clean_up, grown);
    window.until_shown("files are in");
    window.click("Close");
    window.press_with(Modifiers::COMMAND, Key::Z);
    window.until_picture(|p| p.request.clean_up.is_off());
    assert_eq!(window.harness.state().shared.picture().unwrap().outlines, raw);
    assert!(!window.shows("masks cleaned up"));
}

#[test]
fn smoothing_over_time_says_so_on_the_picture() {
    let mut window = with_prompt(scene(), "polyp");
    window.scroll_and_click("Clean up masks…");
    assert!(window.shows("smooth over ± frames"));
    let smooth = CleanUp { smooth_frames: 2, ..CleanUp::default() };
    window.harness.state_mut().shared.document.set_clean_up(smooth);
    window.until_picture(|p| p.request.clean_up == smooth);
    assert!(window.shows("scores smoothed over 5 frames") && window.shows("no longer of this frame alone"));
    window.harness.state_mut().shared.playback.seek(9, 0.0);
    window.until_picture(|p| p.request.view.frame == 9);
    // The first two columns score 0.8 on frames 10 and 11, and 0.3 on the other three of the five frames.
    let found = window.harness.state().shared.picture().unwrap().findings[0].outcome.clone().unwrap();
    assert!((found.max_score - 0.5).abs() < 1e-6 && found.area_px == 0, "{}", found.max_score);
    window.click("Off");
    window.until_picture(|p| p.request.clean_up.is_off());
    assert!(!window.shows("smoothed"));
}

#[test]
fn motion_and_opacity_are_shown_with_their_scales() {
    let mut window = Window::on(scene());
    window.press_with(Modifiers::SHIFT, Key::F);
    window.until_picture(|p| p.layer.is_some());
    let pane = window.harness.state().shared.picture().unwrap().layer.clone().unwrap();
    assert_eq!((pane.range.0, pane.note.as_str()), (0.0, "3 of 5 Gaussians move"));
    let brightness = |x: usize| pane.image.pixels[x].r();
    assert!(brightness(31) > brightness(10) && brightness(10) > brightness(0));
    assert!(window.shows("Moving, frame 1 of 48"));
    // Colours mean the same on every frame.
    window.press(Key::End);
    window.until_picture(|p| p.request.view.frame == FRAMES - 1 && p.layer.is_some());
    assert_eq!(window.harness.state().shared.picture().unwrap().layer.as_ref().unwrap().range, pane.range);
    window.press(Key::A);
    window.until_picture(|p| p.layer.as_ref().is_some_and(|l| l.range == (0.0, 1.0)));
    assert!(window.shows("Opacity, frame 48 of 48"));
    window.press(Key::A);
    window.until_picture(|p| p.layer.is_none());
}

#[test]
fn what_the_endoscope_did_not_see_is_faded_and_said() {
    let mut window = Window::on(scene());
    window.press(Key::End);
    window.until_picture(|p| p.request.view.frame == FRAMES - 1);
    let right = |window: &Window| {
        let pane = window.harness.state().shared.picture().unwrap().reconstruction.clone().unwrap();
        pane.bare.pixels[31]
    };
    assert!(!window.shows("not seen by the endoscope"));
    assert_eq!(right(&window), Color32::from_gray(47));
    let look = &mut window.harness.state_mut().shared.document.look;
    look.orbit = look.orbit.dragged([80.0, 0.0], 15.0);
    window.until_picture(|p| p.unseen_share == 0.5);
    assert!(window.shows("not seen by the endoscope on this frame"));
    assert_eq!(right(&window), Color32::from_gray(48), "0.3 · 47 + 0.7 · 48");
    window.press(Key::R);
    window.until_picture(|p| p.unseen_share == 0.0);
    assert!(!window.shows("not seen by the endoscope"));
}

#[test]
fn the_recorded_frame_comes_first_with_prompts_drawn_on_it() {
    let mut window = Window::gated(scene(), None);
    window.until(|app| app.picture().is_some());
    window.add_prompt("gallbladder");
    window.until_found();
    let app = &window.harness.state().shared;
    assert_eq!(app.document.mode, ViewMode::Original);
    let picture = app.picture().unwrap();
    assert!(picture.outlines.lines[0].lines.len() == 1 && picture.reconstruction.is_none());
    let own = app.document.prompts()[0].colour;
    assert_eq!(painted_lines(&window, own).len(), 1);
    assert!(window.shows("Recorded, frame 1 of 48"));
    window.press_with(Modifiers::COMMAND, Key::E);
    window.harness.step();
    window.click("Start export");
    let backend = window.backend.clone();
    window.until(|_| !backend.exported.lock().unwrap().is_empty());
    let source = backend.exported.lock().unwrap()[0].0.options.source;
    assert_eq!(source, surgtpgs_core::export::PictureSource::Original, "exports show what the window shows");

    let mut window = Window::gated(Info { has_original: false, ..scene() }, None);
    window.until(|app| app.picture().is_some());
    assert_eq!(window.harness.state().shared.document.mode, ViewMode::Reconstruction);
}

#[test]
fn a_reconstruction_that_was_stopped_early_says_so_wherever_it_is_seen() {
    let mut window = Window::on(Info { learned: 0.4, ..scene() });
    let told = "Stopped early, after 40 % of its learning";
    assert!(window.shows(told) && painted(&window).iter().any(|text| text == told));
    window.press(Key::W);
    window.until_picture(|p| p.original.is_some());
    assert!(painted(&window).iter().any(|text| text == told));
    window.press(Key::W);
    window.until_picture(|p| p.reconstruction.is_none());
    assert!(!window.shows(told), "the recorded frame is as it is");
    let window = Window::on(scene());
    assert!(!window.shows("Stopped early"));
    // A long recording of which the part on the screen is missing.
    let window = Window::on(Info { learned: 0.4, unlearned: vec![0..3, 8..9], ..scene() });
    assert!(window.shows("This part is not reconstructed yet") && !window.shows(told));
    let window = Window::on(Info { learned: 0.4, unlearned: std::iter::once(8..9).collect(), ..scene() });
    assert!(window.shows(told));
    // The training is finished, but that part was left out of it.
    let window = Window::on(Info { unlearned: vec![0..3, 8..9], ..scene() });
    let missing = "This part is not reconstructed";
    assert!(window.shows(missing) && painted(&window).iter().any(|text| text == missing));
}
