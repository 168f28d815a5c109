//! Probe of a point of the picture: the scores of all prompts, and of the recording's classes, as bars.

use crate::viewer::{
    action::Action,
    panels::{
        ruler::paint_cross,
        threshold::TIE,
        widgets::{caption, card, focus_ring},
    },
    shared::Shared,
    state::{content::NamedSample, zoom::Panes},
    theme,
};
use egui::{
    Align2, Rect, RichText, Role, Sense, Stroke, Ui, WidgetInfo, pos2,
    text::{LayoutJob, TextWrapping},
    vec2,
};
use surgtpgs_core::grid::Grid;

/// Name of the card.
pub(crate) const CARD: &str = "this point";

/// Room for a score beside its words.
const VALUE_WIDTH: f32 = 44.0;

/// One bar of the card.
#[derive(Clone, Debug, PartialEq)]
struct Row {
    text: String,
    score: f32,
    /// Colour of a prompt; `None` for a class that is not looked for.
    colour: Option<[u8; 3]>,
}

fn rows(shared: &Shared, [u, v]: [f32; 2]) -> Vec<Row> {
    let Some(picture) = shared.picture() else { return Vec::new() };
    let at = |scores: &Grid<f32>| {
        let index = |share: f32, n: usize| ((share * n as f32) as usize).min(n.saturating_sub(1));
        let is_there = !scores.data.is_empty();
        if is_there { scores.at(index(u, scores.width), index(v, scores.height)) } else { 0.0 }
    };
    let prompts = picture.findings.iter().filter_map(|finding| {
        let found = finding.outcome.as_ref().ok()?;
        let colour = picture.request.prompts.iter().find(|p| p.id == finding.id).map(|p| p.colour);
        Some(Row { text: finding.text.clone(), score: at(&found.scores), colour })
    });
    let candidates = picture.candidates.iter();
    let candidates =
        candidates.map(|(text, scores)| Row { text: text.clone(), score: at(scores), colour: None });
    let mut rows: Vec<Row> = prompts.chain(candidates).collect();
    rows.sort_by(|a, b| b.score.total_cmp(&a.score));
    rows
}

/// Returns `true` if everything that the point is compared with has an answer.
fn is_complete(shared: &Shared) -> bool {
    let candidates = shared.candidates();
    shared.picture().is_some_and(|p| candidates.iter().all(|c| p.request.candidates.contains(c)))
}

/// Shows the cross on every pane, and the card with the bars.
pub(crate) fn probe_ui(ui: &mut Ui, shared: &Shared, actions: &mut Vec<Action>, panes: &Panes, area: Rect) {
    let Some(point) = shared.viewport.probe else { return };
    let crosses: Vec<_> = panes.screen_positions(point).collect();
    for (pane, at) in &crosses {
        paint_cross(&ui.painter().with_clip_rect(*pane), *at);
    }
    // On the side away from the point.
    let is_left = crosses.first().is_some_and(|(_, at)| at.x > area.center().x);
    let anchor = if is_left { Align2::LEFT_CENTER } else { Align2::RIGHT_CENTER };
    card(ui.ctx(), CARD, area, anchor, |ui| card_ui(ui, shared, actions, point));
}

fn card_ui(ui: &mut Ui, shared: &Shared, actions: &mut Vec<Action>, point: [f32; 2]) {
    ui.horizontal(|ui| {
        ui.label(RichText::new("This point").strong());
        ui.with_layout(egui::Layout::right_to_left(egui::Align::Center), |ui| {
            if ui.button("Close").on_hover_text("Close (Esc)").clicked() {
                actions.push(Action::Probe(None));
            }
        });
    });
    let rows = rows(shared, point);
    if rows.is_empty() || !is_complete(shared) {
        let text =
            if shared.candidates().is_empty() { "No prompt to compare it with." } else { "Comparing…" };
        ui.label(caption(text));
        return;
    }
    if rows.iter().all(|r| r.score <= 0.0) {
        ui.label(RichText::new("Nothing was reconstructed here.").color(theme::AMBER));
        return;
    }
    ui.label(caption("How alike, 0 to 1; at the line it is as likely as not. Click words to look for them."));
    for row in &rows {
        row_ui(ui, actions, row);
    }
    sample_ui(ui, shared, actions, point);
    if is_complete(shared) && rows.iter().all(|r| r.score < TIE) {
        let text = "Less likely than not any of these.";
        ui.label(RichText::new(text).font(theme::small()).color(theme::AMBER));
    }
}

/// Offers the sample of the point as a prompt of its own, or as an exception of the selected prompt.
fn sample_ui(ui: &mut Ui, shared: &Shared, actions: &mut Vec<Action>, [u, v]: [f32; 2]) {
    let Some((picture, info)) = shared.picture().zip(shared.info()) else { return };
    // While the picture of this point is being made, the sample is of another point.
    let Some(sample) = picture.sample.clone().filter(|_| picture.request.point == Some([u, v])) else {
        return;
    };
    let frame = picture.request.view.frame + 1;
    let [x, y] = [(u, info.width), (v, info.height)].map(|(share, n)| (share * n as f32) as usize);
    let named = |verb: &str| NamedSample {
        name: format!("{verb} frame {frame}, x {x}, y {y}"),
        sample: sample.clone(),
    };
    let selected =
        shared.document.selected.and_then(|id| shared.document.prompt(id)).map(|p| (p.id, p.text.clone()));
    ui.horizontal_wrapped(|ui| {
        let tip = "Look for what looks like this point, without words";
        if ui.button("More like this").on_hover_text(tip).clicked() {
            let like = named("like");
            actions.push(Action::edit(move |d| d.add_like(like)));
        }
        if let Some((id, text)) = selected {
            let tip = "What looks like this point is not what this prompt means: it is compared with it from now on";
            let label = format!("Not \"{}\"", crate::viewer::panels::legend::shortened(&text));
            if ui.button(label).on_hover_text(tip).clicked() {
                let not_like = named("what is at");
                actions.push(Action::edit(move |d| d.add_not_like(id, not_like)));
            }
        }
    });
}

fn row_ui(ui: &mut Ui, actions: &mut Vec<Action>, row: &Row) {
    let (rect, response) = ui.allocate_exact_size(vec2(ui.available_width(), 25.0), Sense::click());
    let bar = Rect::from_min_max(rect.left_top() + vec2(0.0, 19.0), rect.right_bottom() - vec2(0.0, 1.0));
    let painter = ui.painter();
    if response.hovered() {
        painter.rect_filled(rect.expand(2.0), 3.0, theme::CONTROL_HOVER);
    }
    focus_ring(painter, rect, &response);
    painter.rect_filled(bar, 2.0, theme::BACKDROP);
    let filled = Rect::from_min_max(bar.min, pos2(bar.left() + bar.width() * row.score, bar.bottom()));
    painter.rect_filled(filled, 2.0, row.colour.map_or(theme::TEXT_WEAK, theme::colour32));
    painter.vline(bar.left() + bar.width() * TIE, bar.expand(2.0).y_range(), Stroke::new(1.0, theme::TEXT));
    let text = if row.colour.is_some() { row.text.clone() } else { format!("+ {}", row.text) };
    let font = theme::small();
    let value = format!("{:.2}", row.score);
    let mut words = LayoutJob::simple_singleline(text, font.clone(), theme::TEXT);
    words.wrap = TextWrapping::truncate_at_width((rect.width() - VALUE_WIDTH).max(0.0));
    painter.galley(rect.left_top() + vec2(0.0, 1.0), painter.layout_job(words), theme::TEXT);
    painter.text(rect.right_top() + vec2(0.0, 1.0), Align2::RIGHT_TOP, value, font, theme::TEXT);
    let spoken = format!("{} {:.2} at this point", row.text, row.score);
    response.widget_info(|| WidgetInfo::labeled(Role::Button, true, &spoken));
    if response.on_hover_text(format!("Look for \"{}\"", row.text)).clicked() {
        actions.push(Action::AddPrompt(row.text.clone()));
    }
}
