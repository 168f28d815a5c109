//! The bottom line: values under the pointer, the renderer, and the limits of the intended use.

use crate::viewer::{panels::widgets::caption, shared::Shared, theme};
use egui::{RichText, Ui};
use surgtpgs_core::{clock::PassName, export::intended_use, raster::FramePass};

/// Shows the bottom line of the window.
pub(crate) fn status_ui(ui: &mut Ui, shared: &Shared) {
    ui.horizontal(|ui| {
        ui.label(RichText::new(intended_use()).font(theme::small()).color(theme::AMBER));
        ui.separator();
        if let Some(text) = under_pointer(shared, ui.ctx()) {
            ui.label(caption(text));
        }
        ui.with_layout(egui::Layout::right_to_left(egui::Align::Center), |ui| {
            let (Some(picture), Some(info)) = (shared.picture(), shared.info()) else { return };
            for (words, why) in &info.notes {
                ui.label(caption(words)).on_hover_text(why);
                ui.separator();
            }
            if info.has_reconstruction {
                let passes = format!("{} of {} passes", picture.passes_run, FramePass::ALL.len());
                let text = format!("{passes}  ·  {:.0} ms  ·  {}", picture.took_ms, info.renderer);
                let why = "Passes that had to run for the last picture, its time, and what made it";
                ui.label(caption(text)).on_hover_text(why);
            }
        });
    });
}

/// Describes the pixel under the pointer: position, depth and scores.
fn under_pointer(shared: &Shared, ctx: &egui::Context) -> Option<String> {
    let pointer = ctx.input(|i| i.pointer.hover_pos())?;
    let [u, v] = shared.viewport.panes.picture_position(pointer)?;
    let (info, picture) = (shared.info()?, shared.picture()?);
    let at = |share: f32, n: usize| ((share * n as f32) as usize).min(n.saturating_sub(1));
    let mut text = format!("x {}  y {}", at(u, info.width), at(v, info.height));
    if let Some(depth) = picture.depth_values.as_ref().filter(|d| !d.data.is_empty()) {
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
