//! Settings for the clean-up of masks: small parts, holes, borders, and smoothing over time. The window says
//! so wherever a clean-up is on.

use crate::viewer::{
    action::Action,
    panels::widgets::caption,
    shared::Shared,
    state::clean_up::{MAX_AREA, MAX_GROW, MAX_ROUND},
    theme,
};
use egui::{Popup, PopupCloseBehavior, RichText, Slider, Ui};
use surgtpgs_core::mask::{CleanUp, MAX_SMOOTH};

/// Shows the button that opens the settings.
pub(crate) fn clean_up_ui(ui: &mut Ui, shared: &Shared, actions: &mut Vec<Action>) {
    let mut clean_up = shared.document.content().clean_up;
    let text = RichText::new("Clean up masks…").font(theme::small());
    let usual = shared.info().map(|info| CleanUp::usual(info.width, info.height)).unwrap_or_default();
    let text = if clean_up == usual { text } else { text.color(theme::AMBER) };
    let tip = "Leave out specks, fill holes, round and move borders, smooth over time; exports do the same";
    let button = ui.button(text).on_hover_text(tip);
    let menu = Popup::from_toggle_button_response(&button);
    let mut is_over = false;
    menu.close_behavior(PopupCloseBehavior::CloseOnClickOutside).width(330.0).show(|ui| {
        ui.label(caption(
            "Off leaves masks as they are. Exports do what is set here, and their record says so.",
        ));
        let mut row = |ui: &mut Ui, slider: Slider<'_>, tip: &str| {
            let response = ui.add(slider).on_hover_text(tip);
            is_over |= response.drag_stopped() || response.lost_focus();
        };
        let areas = 0..=MAX_AREA;
        let slider = Slider::new(&mut clean_up.min_area_px, areas.clone()).logarithmic(true);
        row(ui, slider.text("smallest part, pixels"), "Parts of a smaller area are left out");
        let slider = Slider::new(&mut clean_up.fill_holes_px, areas).logarithmic(true);
        row(ui, slider.text("fill holes, pixels"), "Holes up to this area are filled");
        let slider = Slider::new(&mut clean_up.round_px, 0..=MAX_ROUND);
        row(ui, slider.text("round borders, pixels"), "Evens out borders over so many pixels");
        let slider = Slider::new(&mut clean_up.grow_px, -MAX_GROW..=MAX_GROW);
        row(ui, slider.text("grow or shrink, pixels"), "Moves the border outwards, or inwards below 0");
        let slider = Slider::new(&mut clean_up.smooth_frames, 0..=MAX_SMOOTH);
        let tip = "Scores are the mean over so many frames before, so many after, and this one";
        row(ui, slider.text("smooth over ± frames"), tip);
        if clean_up.smooth_frames > 0 {
            let text = "What is found is then no longer of this frame alone: what moves fast smears.";
            ui.label(RichText::new(text).font(theme::small()).color(theme::AMBER));
        }
        ui.horizontal(|ui| {
            for (label, chosen) in [("As usual", usual), ("Off", CleanUp::default())] {
                if ui.add_enabled(clean_up != chosen, egui::Button::new(label)).clicked() {
                    clean_up = chosen;
                    is_over = true;
                }
            }
        });
    });
    if clean_up != shared.document.content().clean_up {
        actions.push(Action::edit(move |d| d.set_clean_up(clean_up)));
    }
    if is_over {
        actions.push(Action::edit(move |d| d.end_gesture()));
    }
}
