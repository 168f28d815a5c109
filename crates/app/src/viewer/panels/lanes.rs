//! Lanes below the time bar: the phases, and where each visible prompt was found.

use crate::settings::PROMPT_COLOURS;
use crate::viewer::{
    picture::areas::Curve,
    shared::Shared,
    state::{content::Prompt, time_scale::TimeScale},
    theme,
};
use egui::{Align2, FontId, Painter, Rect, vec2};

/// Height of the lane of phases.
pub(crate) const PHASES_HEIGHT: f32 = 20.0;
/// Height of the lane of a prompt, with the gap below it.
const LANE: f32 = 7.0;
/// Largest number of lanes.
const MAX_LANES: usize = 8;

/// Height of the lanes of so many prompts.
pub(crate) fn height(prompts: usize) -> f32 {
    LANE * prompts.min(MAX_LANES) as f32 + 2.0
}

/// Paints the phases, each with its name as far as there is room.
pub(crate) fn paint_phases(painter: &Painter, shared: &Shared, rect: Rect, scale: &TimeScale) {
    let line = Rect::from_x_y_ranges(scale.line.x_range(), rect.y_range());
    let painter = painter.with_clip_rect(line);
    let mut names: Vec<&str> = Vec::new();
    for phase in shared.document.phases() {
        let known = names.iter().position(|name| *name == phase.name);
        let index = known.unwrap_or_else(|| {
            names.push(&phase.name);
            names.len() - 1
        });
        let colour = theme::colour32(PROMPT_COLOURS[index % PROMPT_COLOURS.len()]);
        let part = Rect::from_x_y_ranges(scale.x(phase.first)..=scale.x(phase.last + 1), line.y_range());
        let part = part.shrink2(vec2(0.5, 1.0));
        painter.rect_filled(part, 3.0, colour.gamma_multiply(0.4));
        let seen = part.intersect(line);
        let galley = painter.layout_no_wrap(phase.name.clone(), FontId::proportional(12.0), theme::TEXT);
        if galley.size().x + 8.0 < seen.width() {
            let place = Align2::CENTER_CENTER.align_size_within_rect(galley.size(), seen);
            painter.galley(place.min, galley, theme::TEXT);
        }
    }
}

/// Describes the phases in words.
pub(crate) fn describe_phases(shared: &Shared) -> String {
    let one = |p: &crate::viewer::state::phases::Phase| {
        format!("{}: frames {} to {}", p.name, p.first + 1, p.last + 1)
    };
    format!("Phases. {}", shared.document.phases().iter().map(one).collect::<Vec<_>>().join("; "))
}

/// Paints a lane for each prompt, filled where it was found.
pub(crate) fn paint_found(
    painter: &Painter,
    curves: &[(usize, Prompt, Curve)],
    rect: Rect,
    scale: &TimeScale,
) {
    let painter = painter.with_clip_rect(Rect::from_x_y_ranges(scale.line.x_range(), rect.y_range()));
    for (k, (_, prompt, curve)) in curves.iter().take(MAX_LANES).enumerate() {
        let top = rect.top() + LANE * k as f32;
        let lane = |from: f32, to: f32| Rect::from_x_y_ranges(from..=to, top..=top + LANE - 2.0);
        painter.rect_filled(lane(scale.line.left(), scale.line.right()), 2.0, theme::BACKDROP);
        for (first, last) in runs(curve) {
            let half = 0.5 * (scale.x(1) - scale.x(0));
            let part = lane(scale.x(first) - half, scale.x(last) + half);
            painter.rect_filled(part, 2.0, theme::colour32(prompt.colour));
        }
    }
}

/// Returns first and last frame of each part on which something was found.
fn runs(curve: &Curve) -> Vec<(usize, usize)> {
    let mut runs: Vec<(usize, usize)> = Vec::new();
    let found = curve.points.iter().enumerate().filter(|(_, p)| p.is_some_and(|p| p.area_px > 0));
    for (frame, _) in found {
        match runs.last_mut().filter(|(_, last)| last + 1 == frame) {
            Some((_, last)) => *last = frame,
            None => runs.push((frame, frame)),
        }
    }
    runs
}
