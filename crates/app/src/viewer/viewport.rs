//! The picture in the middle: recorded, reconstructed, both, or depth; with zoom, wipe and a look around.

use super::{
    app::ViewerApp,
    command::{Command, tooltip},
    document::ViewMode,
    legend,
    orbit::{MAX_MOVING_DEGREES, MAX_STILL_DEGREES},
    start, theme,
    widgets::{choice, plate},
};
use egui::{
    Align2, Color32, CursorIcon, Frame, Key, Margin, PointerButton, Pos2, Rect, Response, Role, Sense,
    Stroke, TextureId, Ui, Vec2, WidgetInfo, pos2, vec2,
};

/// Magnification of the picture; the panes of a comparison share it.
#[derive(Clone, Debug)]
pub(crate) struct Zoom {
    factor: f32,
    /// The point of the picture that is in the middle, as share of its width and height.
    centre: Vec2,
    /// Pane and picture rectangles as last painted.
    panes: Vec<(Rect, Rect)>,
}

impl Default for Zoom {
    fn default() -> Self {
        Self { factor: 1.0, centre: vec2(0.5, 0.5), panes: Vec::new() }
    }
}

const MAX_ZOOM: f32 = 12.0;

impl Zoom {
    fn is_home(&self) -> bool {
        self.factor == 1.0
    }

    /// Where the picture goes: as large as fits the pane, then magnified. Proportions are kept.
    fn picture_rect(&self, pane: Rect, size: Vec2) -> Rect {
        let fit = (pane.width() / size.x.max(1.0)).min(pane.height() / size.y.max(1.0));
        let shown = size * fit * self.factor;
        Rect::from_min_size(pane.center() - self.centre * shown, shown)
    }

    /// The point of the picture under a screen position, as share of width and height; `None` outside of it.
    pub(crate) fn picture_position(&self, at: Pos2) -> Option<[f32; 2]> {
        let (_, picture) =
            self.panes.iter().find(|(pane, picture)| pane.contains(at) && picture.contains(at))?;
        let share = (at - picture.min) / picture.size();
        Some([share.x, share.y])
    }

    /// Magnifies around a screen position, whose point of the picture stays where it is.
    fn magnify(&mut self, by: f32, at: Pos2) {
        let Some((pane, picture)) = self.panes.iter().find(|(pane, _)| pane.contains(at)).copied() else {
            return;
        };
        let factor = (self.factor * by).clamp(1.0, MAX_ZOOM);
        let share = (at - picture.min) / picture.size();
        let size = picture.size() * factor / self.factor;
        self.factor = factor;
        self.centre = share - (at - pane.center()) / size;
        self.keep_inside();
    }

    fn pan(&mut self, delta: Vec2) {
        let Some((_, picture)) = self.panes.first().copied() else { return };
        self.centre -= delta / picture.size();
        self.keep_inside();
    }

    fn keep_inside(&mut self) {
        let margin = 0.5 / self.factor;
        self.centre = self.centre.clamp(Vec2::splat(margin), Vec2::splat(1.0 - margin));
    }
}

/// Toolbar and picture.
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
    app.zoom.panes = panes.iter().map(|p| (p.rect, p.picture)).collect();
    steer(ui, app, &response);
    for pane in &panes {
        paint_pane(ui, app, pane);
    }
    if app.document.mode == ViewMode::Wipe {
        wipe_ui(ui, app, area);
    }
    if let Some(pane) = panes.iter().find(|p| p.is_synthesised) {
        paint_synthesised(ui, pane.visible());
    }
    let with_marks = !app.document.is_hidden && !app.is_peeking(ui.ctx());
    if with_marks {
        let corner = panes.first().map_or(area, PaneView::visible);
        legend::legend_ui(ui, app, corner, &panes.iter().map(|p| (p.rect, p.picture)).collect::<Vec<_>>());
    }
    notices_ui(ui, app, area, with_marks);
    let description = describe(app);
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
            ViewMode::Depth => Command::Depth,
        };
        let info = app.info();
        let is_possible = |mode: ViewMode| {
            info.is_some_and(|i| {
                (i.has_original || !mode.needs_original())
                    && (i.has_reconstruction || !mode.needs_reconstruction())
            })
        };
        let options: Vec<_> =
            ViewMode::ALL.iter().map(|m| (*m, m.label(), tooltip(command(*m)), is_possible(*m))).collect();
        choice(ui, &mut app.document.mode, &options);
        ui.with_layout(egui::Layout::right_to_left(egui::Align::Center), |ui| {
            if !app.orbit.is_home() || !app.zoom.is_home() {
                let text = if app.orbit.is_home() { "Whole picture" } else { "Back to the endoscope" };
                if ui.button(text).on_hover_text(tooltip(Command::ResetView)).clicked() {
                    app.run(Command::ResetView.into(), &ui.ctx().clone());
                }
            }
        });
    });
}

/// A rectangle of the viewport and what is painted in it.
struct PaneView {
    rect: Rect,
    picture: Rect,
    texture: Option<TextureId>,
    label: &'static str,
    is_synthesised: bool,
}

impl PaneView {
    /// The part of the pane that the picture covers: labels belong into it.
    fn visible(&self) -> Rect {
        self.rect.intersect(self.picture)
    }
}

fn panes(app: &ViewerApp, area: Rect, ui: &Ui) -> Vec<PaneView> {
    let (Some(info), Some(shown)) = (app.info(), app.open.as_ref().and_then(|o| o.shown.as_ref())) else {
        return Vec::new();
    };
    let size = vec2(info.width as f32, info.height as f32);
    let with_marks = !app.document.is_hidden;
    let is_synthesised = !shown.picture.request.view.orbit.is_home();
    let pane = |rect: Rect, texture, label, is_synthesised| PaneView {
        rect,
        picture: app.zoom.picture_rect(rect.shrink(6.0), size),
        texture,
        label,
        is_synthesised,
    };
    let original = |marks| (shown.original.id(marks), "Recorded");
    let reconstruction = |marks| (shown.reconstruction.id(marks), "Reconstruction");
    let depth = (shown.depth(), "Depth");
    // While the picture of another mode is being made, the last one stays, under its own name.
    let first_of = |options: [(Option<TextureId>, &'static str); 3]| {
        options.into_iter().find(|(texture, _)| texture.is_some()).unwrap_or((None, ""))
    };
    let single = |options| {
        let (texture, label) = first_of(options);
        vec![pane(area, texture, label, is_synthesised && label != "Recorded")]
    };
    if app.is_peeking(ui.ctx()) && shown.original.id(false).is_some() {
        return vec![pane(area, shown.original.id(false), "Recorded, nothing drawn over it", false)];
    }
    match app.document.mode {
        ViewMode::Original => single([original(with_marks), reconstruction(with_marks), depth]),
        ViewMode::Reconstruction => single([reconstruction(with_marks), original(with_marks), depth]),
        ViewMode::Depth => single([depth, reconstruction(with_marks), original(with_marks)]),
        ViewMode::Wipe => {
            let (texture, label) = first_of([reconstruction(with_marks), original(with_marks), depth]);
            vec![pane(area, texture, label, false)]
        }
        ViewMode::SideBySide => {
            let (left, right) = area.split_left_right_at_fraction(0.5);
            let side = |rect, (texture, label)| pane(rect, texture, label, false);
            vec![side(left, original(with_marks)), side(right, reconstruction(with_marks))]
        }
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

/// The number of the frame that is on the screen, which may still be the one before while the next is made.
fn frame_label(app: &ViewerApp, what: &str) -> String {
    let shown = app.picture().map_or(0, |p| p.request.view.frame);
    format!("{what}  ·  frame {}", shown + 1)
}

/// The recorded frame to the left of the line, over the reconstruction.
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

/// Mouse and wheel: look around with the right button or Alt, pan with the left, zoom with the wheel.
fn steer(ui: &Ui, app: &mut ViewerApp, response: &Response) {
    let (alt, escape) = ui.input(|i| (i.modifiers.alt, i.key_pressed(Key::Escape)));
    let turns =
        response.dragged_by(PointerButton::Secondary) || (alt && response.dragged_by(PointerButton::Primary));
    if turns && app.may_orbit() {
        let moves = app.info().is_some_and(|i| i.camera_moves);
        let limit = if moves { MAX_MOVING_DEGREES } else { MAX_STILL_DEGREES };
        app.orbit = app.orbit.dragged(response.drag_delta().into(), limit);
        app.is_moving = true;
    } else if !turns && response.dragged() && !app.zoom.is_home() {
        app.zoom.pan(response.drag_delta());
    }
    if response.double_clicked() {
        app.zoom = Zoom { panes: std::mem::take(&mut app.zoom.panes), ..Zoom::default() };
    }
    if escape && app.problem.is_some() {
        app.problem = None;
    }
    if response.hovered()
        && let Some(at) = response.hover_pos()
    {
        let (scroll, pinch) = ui.input(|i| (i.smooth_scroll_delta().y, i.zoom_delta()));
        let by = pinch * (scroll / 300.0).exp();
        if by != 1.0 {
            app.zoom.magnify(by, at);
        }
    }
}

/// A view that nobody recorded says so with frame and words.
fn paint_synthesised(ui: &Ui, rect: Rect) {
    let painter = ui.painter();
    painter.rect_stroke(rect, 0.0, Stroke::new(3.0, theme::AMBER), egui::StrokeKind::Inside);
    // Below the frame's label where both do not fit side by side.
    let down = if rect.width() < 660.0 { 42.0 } else { 8.0 };
    let at = rect.right_top() + vec2(-8.0, down);
    let text = "Synthesised view – not what the endoscope saw  ·  R returns";
    plate(painter, at, Align2::RIGHT_TOP, text, theme::AMBER);
}

/// What has to be said about the picture as a whole, in its lower middle.
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

/// The picture in words, for those who cannot see it.
fn describe(app: &ViewerApp) -> String {
    let Some(picture) = app.picture() else { return "No picture yet".into() };
    let mut text = format!(
        "{}, frame {} of {}",
        app.document.mode.label(),
        picture.request.view.frame + 1,
        app.playback.num_frames()
    );
    if app.document.is_hidden {
        return text + ", overlays hidden";
    }
    for finding in &picture.findings {
        if let Ok(found) = &finding.outcome {
            text += &format!(", {} {}", finding.text, super::prompts::percent(found.area_fraction));
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn zooming_keeps_the_point_under_the_pointer() {
        let pane = Rect::from_min_size(pos2(10.0, 20.0), vec2(800.0, 600.0));
        let size = vec2(640.0, 512.0);
        let mut zoom = Zoom::default();
        let at = pos2(500.0, 300.0);
        for by in [1.5, 2.0, 0.7] {
            zoom.panes = vec![(pane, zoom.picture_rect(pane, size))];
            let before = zoom.picture_position(at).unwrap();
            zoom.magnify(by, at);
            zoom.panes = vec![(pane, zoom.picture_rect(pane, size))];
            let after = zoom.picture_position(at).unwrap();
            assert!((before[0] - after[0]).abs() < 1e-4 && (before[1] - after[1]).abs() < 1e-4);
        }
    }

    #[test]
    fn proportions_are_kept_and_the_whole_picture_fits() {
        let pane = Rect::from_min_size(Pos2::ZERO, vec2(1000.0, 300.0));
        let picture = Zoom::default().picture_rect(pane, vec2(640.0, 512.0));
        assert!((picture.aspect_ratio() - 1.25).abs() < 1e-4);
        assert!(pane.expand(0.01).contains_rect(picture));
    }

    #[test]
    fn no_zoom_loses_the_picture() {
        let pane = (Rect::EVERYTHING, Rect::from_min_size(Pos2::ZERO, vec2(640.0, 512.0)));
        let mut zoom = Zoom { panes: vec![pane], ..Zoom::default() };
        zoom.pan(vec2(1e6, -1e6));
        assert_eq!(zoom.centre, vec2(0.5, 0.5));
        zoom.magnify(1e9, pos2(1.0, 1.0));
        assert_eq!(zoom.factor, MAX_ZOOM);
    }
}
