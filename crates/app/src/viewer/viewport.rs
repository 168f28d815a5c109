//! The picture in the middle: recorded, reconstructed, both, or depth; with zoom, wipe and turned views.

use super::{
    app::ViewerApp,
    clean_up_ui,
    command::{Command, tooltip, with_keys},
    compare::{self, Difference},
    document::ViewMode,
    legend,
    orbit::{MAX_MOVING_DEGREES, MAX_STILL_DEGREES},
    probe, ruler,
    source::Info,
    start, theme,
    view_mode::Layer,
    widgets::{choice, plate},
    zoom::{Panes, Zoom},
};
use egui::{
    Align2, Color32, CursorIcon, Frame, Margin, PointerButton, Pos2, Rect, Response, Role, Sense, Stroke,
    TextureId, Ui, WidgetInfo, pos2, vec2,
};

/// Message in place of an excluded frame.
pub(crate) const EXCLUDED: &str = "This frame is left out of everything";
/// Message where a turned view shows more than was recorded.
const FADED: &str = "Faded: not seen by the endoscope on this frame";

/// Shows the toolbar and the picture.
pub(crate) fn viewport_ui(ui: &mut Ui, app: &mut ViewerApp) {
    if let Some(problem) = app.problem.clone() {
        problem_ui(ui, app, &problem);
    }
    if app.open.is_none() {
        start::start_ui(ui, app);
        return;
    }
    Frame::new().fill(theme::PANEL).inner_margin(Margin::symmetric(12, 6)).show(ui, |ui| toolbar_ui(ui, app));
    let area = ui.available_rect_before_wrap();
    let response = ui.allocate_rect(area, Sense::click_and_drag());
    let panes = panes(app, area, ui);
    app.panes = Panes(panes.iter().map(|p| (p.rect, p.picture)).collect());
    steer(ui, app, &response);
    for pane in &panes {
        paint_pane(ui, app, pane);
    }
    if app.document.mode == ViewMode::Wipe {
        wipe_ui(ui, app, area);
    }
    if let Some(pane) = panes.iter().find(|p| p.is_synthesised) {
        let is_faded = app.picture().is_some_and(|p| p.unseen_share > 0.0) && pane.label == "Reconstruction";
        paint_synthesised(ui, pane.visible(), is_faded);
    }
    let with_marks = !app.document.is_hidden && !app.is_peeking(ui.ctx());
    if with_marks && !panes.is_empty() {
        let corner = panes.first().map_or(area, PaneView::visible);
        legend::legend_ui(ui, app, corner, &panes.iter().map(|p| (p.rect, p.picture)).collect::<Vec<_>>());
    }
    notices_ui(ui, app, area, with_marks);
    probe::probe_ui(ui, app, area);
    ruler::ruler_ui(ui, app, area);
    let description = describe(app, &panes);
    response.widget_info(|| WidgetInfo::labeled(Role::Image, true, &description));
}

fn problem_ui(ui: &mut Ui, app: &mut ViewerApp, problem: &str) {
    let fill = Color32::from_rgb(0x4a, 0x1f, 0x22);
    Frame::new().fill(fill).inner_margin(Margin::symmetric(12, 8)).show(ui, |ui| {
        ui.horizontal(|ui| {
            ui.with_layout(egui::Layout::right_to_left(egui::Align::Center), |ui| {
                if ui.button("Close").clicked() {
                    app.problem = None;
                }
                ui.with_layout(egui::Layout::left_to_right(egui::Align::Center), |ui| {
                    ui.add(egui::Label::new(egui::RichText::new(problem).color(theme::TEXT)).wrap());
                });
            });
        });
    });
}

fn toolbar_ui(ui: &mut Ui, app: &mut ViewerApp) {
    ui.horizontal(|ui| {
        let command = |mode| match mode {
            ViewMode::Original | ViewMode::Reconstruction => Command::SwapOriginal,
            ViewMode::SideBySide => Command::SideBySide,
            ViewMode::Wipe => Command::Wipe,
            ViewMode::Blink => Command::Blink,
            ViewMode::Difference => Command::Difference,
            ViewMode::Depth => Command::Depth,
            ViewMode::DepthBeside => Command::DepthBeside,
            ViewMode::Motion => Command::Motion,
            ViewMode::Opacity => Command::Opacity,
        };
        let info = app.info();
        let is_shown = |m: &&ViewMode| ViewMode::MAIN.contains(m) || app.document.mode == **m;
        let options: Vec<_> = [&ViewMode::MAIN[..], &[ViewMode::Motion, ViewMode::Opacity]]
            .concat()
            .iter()
            .filter(is_shown)
            .map(|m| (*m, m.label(), tooltip(command(*m)), info.is_some_and(|i| m.is_possible(i))))
            .collect();
        choice(ui, &mut app.document.mode, &options);
        ui.with_layout(egui::Layout::right_to_left(egui::Align::Center), |ui| {
            if !app.document.look.orbit.is_home() || !app.document.look.zoom.is_home() {
                let text =
                    if app.document.look.orbit.is_home() { "Whole picture" } else { "Back to the endoscope" };
                if ui.button(text).on_hover_text(tooltip(Command::ResetView)).clicked() {
                    app.run(Command::ResetView.into(), &ui.ctx().clone());
                }
            }
        });
    });
}

/// A rectangle of the viewport and its contents.
#[derive(Clone)]
struct PaneView {
    rect: Rect,
    picture: Rect,
    texture: Option<TextureId>,
    label: &'static str,
    is_synthesised: bool,
}

impl PaneView {
    /// Returns the part of the pane that the picture covers, where labels belong.
    fn visible(&self) -> Rect {
        self.rect.intersect(self.picture)
    }
}

fn panes(app: &ViewerApp, area: Rect, ui: &Ui) -> Vec<PaneView> {
    let (Some(info), Some(shown)) = (app.info(), app.open.as_ref().and_then(|o| o.shown.as_ref())) else {
        return Vec::new();
    };
    if app.document.is_excluded(shown.picture.request.view.frame) {
        return Vec::new();
    }
    let size = vec2(info.width as f32, info.height as f32);
    let with_marks = !app.document.is_hidden;
    let is_synthesised = !shown.picture.request.view.orbit.is_home();
    let pane = |rect: Rect, texture, label, is_synthesised| PaneView {
        rect,
        picture: app.document.look.zoom.picture_rect(rect.shrink(6.0), size),
        texture,
        label,
        is_synthesised,
    };
    let reconstruction = (shown.reconstruction.id(with_marks), "Reconstruction");
    let depth = match shown.layer() {
        Some((Layer::Depth, texture)) => (Some(texture), "Depth"),
        Some((Layer::Motion, texture)) => (Some(texture), "Moving"),
        Some((Layer::Opacity, texture)) => (Some(texture), "Opacity"),
        None => (None, ""),
    };
    let original = (shown.original.id(with_marks), "Recorded");
    // While the picture of another mode is being made, the last one stays, under its own name.
    let first = |options: [(Option<TextureId>, &'static str); 3]| {
        let mut options = options.into_iter().chain([original, reconstruction, depth]);
        options.find(|(texture, _)| texture.is_some()).unwrap_or((None, ""))
    };
    let single = |options| {
        let (texture, label) = first(options);
        vec![pane(area, texture, label, is_synthesised && label != "Recorded")]
    };
    let beside = |a: (Option<TextureId>, &'static str), b: (Option<TextureId>, &'static str)| {
        let (left, right) = area.split_left_right_at_fraction(0.5);
        [(left, a), (right, b)].map(|(r, (t, label))| pane(r, t, label, is_synthesised)).to_vec()
    };
    if app.is_peeking(ui.ctx()) && shown.original.id(false).is_some() {
        return vec![pane(area, shown.original.id(false), "Recorded, nothing drawn over it", false)];
    }
    match app.document.mode {
        ViewMode::Original => single([original, reconstruction, depth]),
        ViewMode::Reconstruction | ViewMode::Wipe => single([reconstruction, original, depth]),
        ViewMode::Depth | ViewMode::Motion | ViewMode::Opacity => single([depth, reconstruction, original]),
        ViewMode::Difference => single([(shown.difference(), "Difference"), reconstruction, original]),
        ViewMode::Blink => {
            let now = ui.input(|i| i.time);
            ui.ctx().request_repaint_after_secs(compare::seconds_to_turn(now) as f32);
            let is_recorded = compare::is_recorded_turn(now);
            let turns = if is_recorded { [original, reconstruction] } else { [reconstruction, original] };
            single([turns[0], turns[1], depth])
        }
        ViewMode::SideBySide => beside(original, reconstruction),
        ViewMode::DepthBeside => beside(reconstruction, depth),
    }
}

fn paint_pane(ui: &Ui, app: &ViewerApp, pane: &PaneView) {
    let painter = ui.painter().with_clip_rect(pane.rect.intersect(ui.clip_rect()));
    let Some(texture) = pane.texture else { return };
    let whole = Rect::from_min_max(Pos2::ZERO, pos2(1.0, 1.0));
    painter.image(texture, pane.picture, whole, Color32::WHITE);
    if app.document.mode == ViewMode::Wipe && pane.label == "Reconstruction" {
        paint_wiped(ui, app, pane);
        return;
    }
    let corner = pane.visible().left_top() + vec2(8.0, 8.0);
    plate(&painter, corner, Align2::LEFT_TOP, &frame_label(app, pane.label), theme::TEXT);
}

/// Formats the number of the frame on the screen, which may still be the previous one while the next is made.
fn frame_label(app: &ViewerApp, what: &str) -> String {
    let shown = app.picture().map_or(0, |p| p.request.view.frame);
    let text = format!("{what}  ·  frame {}", shown + 1);
    match app.picture().and_then(|p| p.difference.as_ref()).filter(|_| what == "Difference") {
        Some(Difference { psnr_db: Some(psnr), .. }) => {
            format!("{text}  ·  PSNR {psnr:.1} dB (whole picture)")
        }
        Some(_) => text + "  ·  no difference",
        None => text,
    }
}

/// Paints the recorded frame to the left of the line, over the reconstruction.
fn paint_wiped(ui: &Ui, app: &ViewerApp, pane: &PaneView) {
    let Some(shown) = app.open.as_ref().and_then(|o| o.shown.as_ref()) else { return };
    let x = pane.rect.left() + pane.rect.width() * app.wipe;
    let left = Rect::from_min_max(pane.rect.min, pos2(x, pane.rect.bottom()));
    let whole = Rect::from_min_max(Pos2::ZERO, pos2(1.0, 1.0));
    let painter = ui.painter().with_clip_rect(left.intersect(ui.clip_rect()));
    if let Some(texture) = shown.original.id(!app.document.is_hidden) {
        painter.image(texture, pane.picture, whole, Color32::WHITE);
    }
    let all = ui.painter().with_clip_rect(pane.rect);
    let corner = pane.visible().left_top() + vec2(8.0, 8.0);
    plate(&all, corner, Align2::LEFT_TOP, &frame_label(app, "Recorded"), theme::TEXT);
    let corner = pane.visible().right_top() + vec2(-8.0, 8.0);
    plate(&all, corner, Align2::RIGHT_TOP, "Reconstruction", theme::TEXT);
}

fn wipe_ui(ui: &mut Ui, app: &mut ViewerApp, area: Rect) {
    let x = area.left() + area.width() * app.wipe;
    let handle = Rect::from_center_size(pos2(x, area.center().y), vec2(18.0, area.height()));
    let response = ui
        .interact(handle, ui.scope_id().with("wipe"), Sense::drag())
        .on_hover_cursor(CursorIcon::ResizeHorizontal);
    if let Some(pointer) = response.interact_pointer_pos() {
        app.wipe = ((pointer.x - area.left()) / area.width().max(1.0)).clamp(0.02, 0.98);
    }
    response.widget_info(|| WidgetInfo::slider(true, f64::from(app.wipe), "Wipe"));
    let painter = ui.painter().with_clip_rect(area);
    painter.vline(x, area.y_range(), Stroke::new(4.0, theme::PLATE));
    painter.vline(x, area.y_range(), Stroke::new(2.0, Color32::WHITE));
    painter.circle(pos2(x, area.center().y), 11.0, theme::PLATE, Stroke::new(2.0, Color32::WHITE));
    for side in [-1.0, 1.0] {
        let at = |dx: f32, dy: f32| pos2(x + side * dx, area.center().y + dy);
        let points = vec![at(3.0, -4.0), at(7.5, 0.0), at(3.0, 4.0)];
        painter.add(egui::Shape::convex_polygon(points, Color32::WHITE, Stroke::NONE));
    }
}

/// Returns the largest rotation of the view away from the endoscope's, degrees.
pub(crate) fn orbit_limit(info: &Info) -> f32 {
    if info.camera_moves { MAX_MOVING_DEGREES } else { MAX_STILL_DEGREES }
}

/// Handles mouse and wheel: look around with the right button or Alt, pan with the left, zoom with the wheel.
fn steer(ui: &Ui, app: &mut ViewerApp, response: &Response) {
    let alt = ui.input(|i| i.modifiers.alt);
    let turns =
        response.dragged_by(PointerButton::Secondary) || (alt && response.dragged_by(PointerButton::Primary));
    if turns && app.may_orbit() {
        let limit = app.info().map_or(MAX_STILL_DEGREES, orbit_limit);
        app.document.look.orbit = app.document.look.orbit.dragged(response.drag_delta().into(), limit);
        app.is_moving = true;
    } else if !turns && ruler::drag(app, response) {
        // The ruler has the mouse.
    } else if response.clicked() && app.info().is_some_and(|i| i.has_features) {
        app.probe = response.interact_pointer_pos().and_then(|p| app.panes.picture_position(p));
    } else if !turns && response.dragged() && !app.document.look.zoom.is_home() {
        app.document.look.zoom.pan(response.drag_delta(), &app.panes);
    }
    if response.double_clicked() {
        app.document.look.zoom = Zoom::default();
    }
    if response.hovered()
        && let Some(at) = response.hover_pos()
    {
        let (scroll, pinch) = ui.input(|i| (i.smooth_scroll_delta().y, i.zoom_delta()));
        let by = pinch * (scroll / 300.0).exp();
        if by != 1.0 {
            app.document.look.zoom.magnify(by, at, &app.panes);
        }
    }
}

/// Marks a view that nobody recorded, with a frame and words.
fn paint_synthesised(ui: &Ui, rect: Rect, is_faded: bool) {
    let painter = ui.painter();
    painter.rect_stroke(rect, 0.0, Stroke::new(3.0, theme::AMBER), egui::StrokeKind::Inside);
    // Below the frame's label where both do not fit side by side.
    let down = if rect.width() < 660.0 { 42.0 } else { 8.0 };
    let at = rect.right_top() + vec2(-8.0, down);
    let text = "Synthesised view – not what the endoscope saw  ·  R returns";
    let said = plate(painter, at, Align2::RIGHT_TOP, text, theme::AMBER);
    if is_faded {
        plate(painter, said.right_bottom() + vec2(0.0, 4.0), Align2::RIGHT_TOP, FADED, theme::AMBER);
    }
}

/// Shows the notice about the picture as a whole, in its lower middle.
fn notices_ui(ui: &mut Ui, app: &ViewerApp, area: Rect, with_marks: bool) {
    let at = area.center_bottom() + vec2(0.0, -18.0);
    let Some((text, colour)) = notice(app, with_marks) else { return };
    let rect = plate(ui.painter(), at, Align2::CENTER_BOTTOM, &text, colour);
    let response = ui.interact(rect, ui.scope_id().with("notice"), Sense::hover());
    response.widget_info(|| WidgetInfo::labeled(Role::Label, true, &text));
}

fn notice(app: &ViewerApp, with_marks: bool) -> Option<(String, Color32)> {
    if let Some(waiting) = app.waiting_for() {
        return Some((waiting, theme::TEXT));
    }
    let Some(picture) = app.picture() else {
        return Some(("Making the first picture…".into(), theme::TEXT));
    };
    if app.document.is_excluded(picture.request.view.frame) {
        let how = with_keys("the Time menu takes it back in", Command::Exclude);
        return Some((format!("{EXCLUDED} – {how}"), theme::AMBER));
    }
    if let Some(problem) = &picture.problem {
        return Some((problem.clone(), theme::ERROR));
    }
    let info = app.info()?;
    if app.document.mode.needs_original() && !info.has_original {
        return info.original_missing.clone().map(|why| (why, theme::AMBER));
    }
    if app.document.is_hidden && !app.document.prompts().is_empty() {
        return Some((format!("Overlays are hidden – {}", tooltip(Command::HideOverlays)), theme::TEXT_WEAK));
    }
    let answers: Vec<_> = picture.findings.iter().filter_map(|f| f.outcome.as_ref().ok()).collect();
    let is_nothing = with_marks && !answers.is_empty() && answers.iter().all(|f| f.area_px == 0);
    is_nothing.then(|| (super::prompts::NOTHING.to_owned(), theme::AMBER))
}

/// Describes the picture in words, for users who cannot see it.
fn describe(app: &ViewerApp, panes: &[PaneView]) -> String {
    let Some(picture) = app.picture() else { return "No picture yet".into() };
    if app.document.is_excluded(picture.request.view.frame) {
        return format!(
            "Frame {} of {}, {EXCLUDED}",
            picture.request.view.frame + 1,
            app.playback.num_frames()
        );
    }
    let mode = app.document.mode.label();
    let shown = panes.iter().map(|p| p.label).collect::<Vec<_>>().join(" and ");
    let mut text = format!(
        "{}, frame {} of {}",
        if shown == mode { shown } else { format!("{mode}: {shown}") },
        picture.request.view.frame + 1,
        app.playback.num_frames()
    );
    if !picture.request.view.orbit.is_home() {
        text += ", synthesised view";
        if picture.unseen_share > 0.0 {
            text += &format!(", {FADED}");
        }
    }
    if app.document.is_hidden {
        return text + ", overlays hidden";
    }
    if let Some(words) =
        clean_up_ui::describe(picture.request.clean_up).filter(|_| !picture.findings.is_empty())
    {
        text += &format!(", {words}");
    }
    for finding in &picture.findings {
        if let Ok(found) = &finding.outcome {
            text += &format!(", {} {}", finding.text, super::prompts::percent(found.area_fraction));
        }
    }
    text
}
