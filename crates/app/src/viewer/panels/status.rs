//! The bottom line: the limits of the intended use, values under the pointer, and engineering figures behind
//! a button.

use crate::viewer::{
    panels::{room::Room, widgets::caption},
    shared::Shared,
    theme,
};
use egui::{Popup, RichText, Ui};
use surgtpgs_core::{about::intended_use, clock::PassName, raster::FramePass};

/// Shows the bottom line of the window.
pub(crate) fn status_ui(ui: &mut Ui, shared: &Shared, room: Room) {
    let layout = egui::Layout::right_to_left(egui::Align::Center);
    ui.allocate_ui_with_layout(egui::vec2(ui.available_width(), 22.0), layout, |ui| {
        ui.spacing_mut().interact_size.y = 20.0;
        if shared.open.is_some() {
            details_ui(ui, shared);
        }
        ui.with_layout(egui::Layout::left_to_right(egui::Align::Center), |ui| {
            let intended = RichText::new(intended_use()).font(theme::small()).color(theme::AMBER);
            ui.add(egui::Label::new(intended).truncate());
            if let Some(text) = under_pointer(shared, ui.ctx()).filter(|_| !room.is_narrow()) {
                ui.separator();
                ui.add(egui::Label::new(caption(text)).truncate());
            }
        });
    });
}

/// Shows a button that opens figures about the scene and its last picture.
fn details_ui(ui: &mut Ui, shared: &Shared) {
    let button = egui::Button::new(caption("Details")).frame(false);
    let button = ui.add(button).on_hover_text("What the picture was made of, by what, and how fast");
    Popup::from_toggle_button_response(&button).width(330.0).show(|ui| {
        let (Some(picture), Some(info)) = (shared.picture(), shared.info()) else { return };
        ui.label(caption(format!("{} × {} pixels, {} frames", info.width, info.height, info.num_frames)));
        for (words, why) in &info.notes {
            ui.label(caption(format!("{words}. {why}")));
        }
        if !picture.renderer.is_empty() {
            let (run, all) = (picture.passes_run, FramePass::ALL.len());
            let (ms, renderer) = (picture.took_ms, &picture.renderer);
            ui.label(caption(format!("The last picture took {ms:.0} ms, made by {renderer}.")));
            ui.label(caption(format!("{run} of {all} steps of drawing had to run anew for it.")));
        }
    });
}

/// Describes the pixel under the pointer: position, depth and scores.
fn under_pointer(shared: &Shared, ctx: &egui::Context) -> Option<String> {
    let pointer = ctx.input(|i| i.pointer.hover_pos())?;
    let [u, v] = shared.viewport.panes.picture_position(pointer)?;
    let (info, picture) = (shared.info()?, shared.picture()?);
    let at = |share: f32, n: usize| ((share * n as f32) as usize).min(n.saturating_sub(1));
    let mut text = format!("x {}  y {}", at(u, info.width), at(v, info.height));
    let depth = picture.depth_values.as_ref().filter(|d| info.has_measured_depth && !d.data.is_empty());
    if let Some(depth) = depth {
        match depth.at(at(u, depth.width), at(v, depth.height)) {
            d if d > 0.0 => text += &format!("   depth {d:.1} scene units"),
            _ => text += "   no depth",
        }
    }
    for finding in &picture.findings {
        if let Ok(found) = &finding.outcome
            && !found.scores.data.is_empty()
        {
            let score = found.scores.at(at(u, found.scores.width), at(v, found.scores.height));
            text += &format!("   {} {score:.2}", finding.text);
        }
    }
    Some(text)
}
