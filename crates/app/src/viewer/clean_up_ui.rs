//! Settings for the clean-up of masks: small parts, holes, borders, and smoothing over time. The window says
//! so wherever a clean-up is on.

use super::{app::ViewerApp, theme, widgets::caption};
use egui::{Popup, PopupCloseBehavior, RichText, Slider, Ui};
use surgtpgs_core::mask::CleanUp;

/// Largest number of frames before and after to smooth over.
const MAX_SMOOTH: usize = 5;
/// Largest area of removed parts and filled holes, px.
const MAX_AREA: usize = 20_000;
/// Largest distance that a border moves, px.
const MAX_GROW: i32 = 20;

/// Limits the clean-up to what the window offers, because files may hold any values.
pub(crate) fn mended(clean_up: CleanUp) -> CleanUp {
    CleanUp {
        smooth_frames: clean_up.smooth_frames.min(MAX_SMOOTH),
        fill_holes_px: clean_up.fill_holes_px.min(MAX_AREA),
        min_area_px: clean_up.min_area_px.min(MAX_AREA),
        grow_px: clean_up.grow_px.clamp(-MAX_GROW, MAX_GROW),
    }
}

/// Describes the active clean-up in words, for the picture; `None` where masks are left as they are.
pub(crate) fn describe(clean_up: CleanUp) -> Option<String> {
    if clean_up.is_off() {
        return None;
    }
    let mut words = Vec::new();
    if (CleanUp { smooth_frames: 0, ..clean_up }) != CleanUp::default() {
        words.push("masks cleaned up".to_owned());
    }
    if clean_up.smooth_frames > 0 {
        words.push(format!("scores smoothed over {} frames", 2 * clean_up.smooth_frames + 1));
    }
    Some(words.join(", "))
}

/// Shows the button that opens the settings.
pub(crate) fn clean_up_ui(ui: &mut Ui, app: &mut ViewerApp) {
    let mut clean_up = app.document.content().clean_up;
    let text = RichText::new("Clean up masks…").font(theme::small());
    let text = if clean_up.is_off() { text } else { text.color(theme::AMBER) };
    let tip = "Leave out specks, fill holes, move borders, smooth over time; exports do the same";
    let button = ui.button(text).on_hover_text(tip);
    let menu = Popup::from_toggle_button_response(&button);
    let mut is_over = false;
    menu.close_behavior(PopupCloseBehavior::CloseOnClickOutside).width(330.0).show(|ui| {
        ui.label(caption("Off leaves masks as they are. Exports do what is set here, and say so."));
        let mut row = |ui: &mut Ui, slider: Slider<'_>, tip: &str| {
            let response = ui.add(slider).on_hover_text(tip);
            is_over |= response.drag_stopped() || response.lost_focus();
        };
        let areas = 0..=MAX_AREA;
        let slider = Slider::new(&mut clean_up.min_area_px, areas.clone()).logarithmic(true);
        row(ui, slider.text("smallest part, px"), "Parts of a smaller area are left out");
        let slider = Slider::new(&mut clean_up.fill_holes_px, areas).logarithmic(true);
        row(ui, slider.text("fill holes, px"), "Holes up to this area are filled");
        let slider = Slider::new(&mut clean_up.grow_px, -MAX_GROW..=MAX_GROW);
        row(ui, slider.text("grow or shrink, px"), "Moves the border outwards, or inwards below 0");
        let slider = Slider::new(&mut clean_up.smooth_frames, 0..=MAX_SMOOTH);
        let tip = "Scores are the mean over so many frames before, so many after, and this one";
        row(ui, slider.text("smooth over ± frames"), tip);
        if clean_up.smooth_frames > 0 {
            let text = "What is found is then no longer of this frame alone: what moves fast smears.";
            ui.label(RichText::new(text).font(theme::small()).color(theme::AMBER));
        }
        if ui.add_enabled(!clean_up.is_off(), egui::Button::new("Off")).clicked() {
            clean_up = CleanUp::default();
            is_over = true;
        }
    });
    app.document.set_clean_up(clean_up);
    if is_over {
        app.document.end_gesture();
    }
}
