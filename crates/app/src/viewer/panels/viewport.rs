//! The picture in the middle: recorded, reconstructed, both, or depth; with zoom, wipe and turned views.

use crate::viewer::{
    action::Action,
    backend::Info,
    command::Command,
    panels::{
        drawing::{self, Drawing},
        legend,
        marking::FOUND_WHEN_READY,
        outlines::paint_outlines,
        panes::{PaneView, panes},
        plates::Plates,
        probe,
        prompts::nothing_here,
        room::Room,
        ruler::{self, Ruler},
        start, toast,
        widgets::choice,
    },
    picture::{
        difference::Difference,
        notes::{FADED, SYNTHESISED},
        request::{AskedPrompt, Finding, Picture},
    },
    shared::Shared,
    state::{
        excluded::EXCLUDED,
        view_mode::ViewMode,
        zoom::{Panes, Zoom},
    },
    text::{sentence, timecode},
    theme,
};
use egui::{
    Align2, Color32, CursorIcon, Frame, Margin, PointerButton, Rect, Response, Role, ScrollArea, Sense,
    Stroke, Ui, WidgetInfo, pos2, vec2,
};
use surgtpgs_core::camera::MAX_STILL_DEGREES;

/// Message where nothing was found of several prompts, for several reasons.
const NOTHING_OF_ALL: &str = "Nothing was found on this frame";

/// The toolbar and the picture.
#[derive(Default)]
pub(crate) struct ViewportPanel {
    ruler: Ruler,
    drawing: Drawing,
}

impl ViewportPanel {
    /// Shows the panel.
    pub(crate) fn ui(&mut self, ui: &mut Ui, shared: &Shared, actions: &mut Vec<Action>, room: Room) {
        if let Some(problem) = &shared.problem {
            problem_ui(ui, actions, problem);
        }
        if shared.open.is_none() {
            let area = ui.available_rect_before_wrap();
            start::start_ui(ui, shared, actions);
            toast::toast_ui(ui, shared, actions, &mut Plates::default(), area);
            return;
        }
        let frame = Frame::new().inner_margin(Margin::symmetric(12, 6));
        // Where the window is low, the View menu has all of it.
        if !room.is_low() {
            frame.show(ui, |ui| toolbar_ui(ui, shared, actions));
        }
        let area = ui.available_rect_before_wrap();
        let response = ui.allocate_rect(area, Sense::click_and_drag());
        let views = panes(shared, area, ui);
        paint_backdrop(ui, area, &views);
        let panes = Panes(views.iter().map(|p| (p.rect, p.picture)).collect());
        self.steer(ui, shared, actions, &response, &panes);
        let mut plates = Plates::default();
        cards(ui).for_each(|rect| plates.take(rect));
        for pane in &views {
            paint_pane(ui, shared, pane, &mut plates);
        }
        let with_marks = !shared.document.is_hidden && !shared.is_peeking(ui.ctx());
        if with_marks {
            self.drawing.ui(ui, shared, &views);
        }
        if shared.document.mode == ViewMode::Wipe {
            wipe_ui(ui, shared, actions, area);
        }
        if let Some(pane) = views.iter().find(|p| p.is_synthesised) {
            let is_faded =
                shared.picture().is_some_and(|p| p.unseen_share > 0.0) && pane.label == "Reconstruction";
            paint_synthesised(ui, pane.visible(), is_faded, &mut plates);
        }
        self.ruler.paint(ui, shared, &panes, &mut plates);
        toast::toast_ui(ui, shared, actions, &mut plates, area);
        notices_ui(ui, shared, area, with_marks, &mut plates);
        if let Some(first) = views.first().filter(|_| with_marks) {
            legend::legend_ui(ui, shared, first.visible(), &panes.0, &mut plates);
        }
        probe::probe_ui(ui, shared, actions, &panes, area);
        self.ruler.ui(ui, shared, actions, area);
        let description = describe(shared, &views);
        response.widget_info(|| WidgetInfo::labeled(Role::Image, true, &description));
        if panes != shared.viewport.panes {
            actions.push(Action::Place(panes));
        }
    }

    /// Handles mouse and wheel: look around with the right button or Alt, pan with the left, zoom with the
    /// wheel.
    fn steer(
        &mut self,
        ui: &Ui,
        shared: &Shared,
        actions: &mut Vec<Action>,
        response: &Response,
        panes: &Panes,
    ) {
        let alt = ui.input(|i| i.modifiers.alt);
        let is_dragged = |button| response.dragged_by(button);
        let turns = is_dragged(PointerButton::Secondary) || (alt && is_dragged(PointerButton::Primary));
        let mut look = shared.document.look;
        let mut is_moving = false;
        let is_recorded = shared.document.mode == ViewMode::Original;
        if turns && is_recorded && shared.info().is_some_and(|i| i.has_reconstruction) {
            // Only the reconstruction can be looked at from elsewhere.
            actions.push(Action::edit(|d| d.mode = ViewMode::Reconstruction));
        } else if turns && shared.may_orbit() {
            let limit = shared.info().map_or(MAX_STILL_DEGREES, Info::orbit_limit);
            look.orbit = look.orbit.dragged(response.drag_delta().into(), limit);
            is_moving = true;
        } else if !turns
            && !is_dragged(PointerButton::Middle)
            && drawing::draw(shared, actions, panes, response)
        {
            // The tool for marking has the mouse.
        } else if !turns && self.ruler.drag(shared, panes, response) {
            // The ruler has the mouse.
        } else if response.clicked() && shared.info().is_some_and(|i| i.has_features) {
            let point = response.interact_pointer_pos().and_then(|p| panes.picture_position(p));
            actions.push(Action::Probe(point));
        } else if !turns && response.dragged() && !look.zoom.is_home() {
            look.zoom.pan(response.drag_delta(), panes);
        }
        if response.double_clicked() && !shared.viewport.marking.is_on {
            look.zoom = Zoom::default();
        }
        if response.hovered()
            && let Some(at) = response.hover_pos()
        {
            let (scroll, pinch) = ui.input(|i| (i.smooth_scroll_delta().y, i.zoom_delta()));
            let by = pinch * (scroll / 300.0).exp();
            if by != 1.0 {
                look.zoom.magnify(by, at, panes);
            }
        }
        if look != shared.document.look || is_moving {
            actions.push(Action::Look { look, is_moving });
        }
    }
}

fn problem_ui(ui: &mut Ui, actions: &mut Vec<Action>, problem: &str) {
    let fill = Color32::from_rgb(0x4a, 0x1f, 0x22);
    Frame::new().fill(fill).inner_margin(Margin::symmetric(12, 8)).show(ui, |ui| {
        ui.set_width(ui.available_width());
        let height = (ui.available_height() * 0.4).max(40.0);
        ScrollArea::vertical().max_height(height).auto_shrink([false, true]).show(ui, |ui| {
            ui.add(egui::Label::new(egui::RichText::new(problem).color(theme::TEXT)).wrap());
            if ui.button("Close").clicked() {
                actions.push(Action::CloseProblem);
            }
        });
    });
}

fn toolbar_ui(ui: &mut Ui, shared: &Shared, actions: &mut Vec<Action>) {
    ui.set_width(ui.available_width());
    ui.horizontal_wrapped(|ui| {
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
        let info = shared.info();
        let is_shown = |m: &&ViewMode| ViewMode::MAIN.contains(m) || shared.document.mode == **m;
        let options: Vec<_> = [&ViewMode::MAIN[..], &[ViewMode::Motion, ViewMode::Opacity]]
            .concat()
            .iter()
            .filter(is_shown)
            .map(|m| {
                let obstacle = info.and_then(|info| m.obstacle(info));
                let tip = obstacle.map_or_else(|| shared.tooltip(command(*m)), str::to_owned);
                (*m, m.label(), tip, obstacle.is_none())
            })
            .collect();
        let mut mode = shared.document.mode;
        choice(ui, &mut mode, &options);
        if mode != shared.document.mode {
            actions.push(Action::edit(move |d| d.mode = mode));
        }
        if !shared.document.look.orbit.is_home() || !shared.document.look.zoom.is_home() {
            let is_home = shared.document.look.orbit.is_home();
            let text = if is_home { "Whole picture" } else { "Back to the endoscope" };
            if ui.button(text).on_hover_text(shared.tooltip(Command::ResetView)).clicked() {
                actions.push(Action::Run(Command::ResetView));
            }
        }
    });
}

/// Returns the places of the cards over the picture, as they were shown last.
fn cards(ui: &Ui) -> impl Iterator<Item = Rect> {
    let shown = [probe::CARD, ruler::CARD].map(|name| ui.ctx().memory(|m| shown_area(m, name)));
    shown.into_iter().flatten()
}

fn shown_area(memory: &egui::Memory, name: &str) -> Option<Rect> {
    let id = egui::Id::unique(name);
    let is_shown = memory.areas().is_visible(&egui::LayerId::new(egui::Order::Middle, id));
    memory.area_rect(id).filter(|_| is_shown)
}

/// Fills the area around the pictures. What they cover is left out but for a point at their borders, which
/// may lie within a pixel.
fn paint_backdrop(ui: &Ui, area: Rect, views: &[PaneView]) {
    let fill = |rect: Rect| {
        ui.painter().rect_filled(rect, 0.0, theme::BACKDROP);
    };
    if views.is_empty() {
        fill(area);
    }
    for pane in views {
        let Rect { min, max } = pane.rect;
        let covered = pane.visible().shrink(1.0);
        if pane.texture.is_none() || !covered.is_positive() {
            fill(pane.rect);
            continue;
        }
        fill(Rect::from_min_max(min, pos2(max.x, covered.top())));
        fill(Rect::from_min_max(pos2(min.x, covered.bottom()), max));
        fill(Rect::from_min_max(pos2(min.x, covered.top()), covered.left_bottom()));
        fill(Rect::from_min_max(covered.right_top(), pos2(max.x, covered.bottom())));
    }
}

fn paint_pane(ui: &Ui, shared: &Shared, pane: &PaneView, plates: &mut Plates) {
    let painter = ui.painter().with_clip_rect(pane.rect.intersect(ui.clip_rect()));
    let Some(texture) = &pane.texture else { return };
    texture.paint(&painter, pane.picture);
    let is_wiped = shared.document.mode == ViewMode::Wipe && pane.label == "Reconstruction";
    if is_wiped {
        paint_wiped(ui, shared, pane, plates);
    }
    if let Some(picture) = shared.picture().filter(|_| pane.has_outlines) {
        paint_outlines(&painter, pane.picture, &picture.outlines);
    }
    if is_wiped {
        return;
    }
    plates.text(&painter, pane.visible(), Align2::LEFT_TOP, &frame_label(shared, pane.label), theme::TEXT);
    if !pane.label.starts_with("Recorded") {
        for text in shared.cautions() {
            plates.text(&painter, pane.visible(), Align2::LEFT_TOP, &text, theme::AMBER);
        }
    }
}

/// Formats the number of the frame on the screen, which may still be the previous one while the next is made.
fn frame_label(shared: &Shared, what: &str) -> String {
    let shown = shared.picture().map_or(0, |p| p.request.view.frame);
    let time = timecode(shared.playback.seconds(shown));
    let text = format!("{what}  ·  frame {}  ·  {time}", shown + 1);
    match shared.picture().and_then(|p| p.difference.as_ref()).filter(|_| what == "Difference") {
        Some(Difference { psnr_db: Some(psnr), .. }) => {
            format!("{text}  ·  PSNR {psnr:.1} dB (whole picture)")
        }
        Some(_) => text + "  ·  no difference",
        None => text,
    }
}

/// Paints the recorded frame to the left of the line, over the reconstruction.
fn paint_wiped(ui: &Ui, shared: &Shared, pane: &PaneView, plates: &mut Plates) {
    let Some(shown) = shared.open.as_ref().and_then(|o| o.shown.as_ref()) else { return };
    let x = pane.rect.left() + pane.rect.width() * shared.viewport.wipe;
    let left = Rect::from_min_max(pane.rect.min, pos2(x, pane.rect.bottom()));
    let painter = ui.painter().with_clip_rect(left.intersect(ui.clip_rect()));
    if let Some(texture) = shown.original.texture(!shared.document.is_hidden) {
        texture.paint(&painter, pane.picture);
    }
    let all = ui.painter().with_clip_rect(pane.rect);
    plates.text(&all, pane.visible(), Align2::LEFT_TOP, &frame_label(shared, "Recorded"), theme::TEXT);
    plates.text(&all, pane.visible(), Align2::RIGHT_TOP, "Reconstruction", theme::TEXT);
    for text in shared.cautions() {
        plates.text(&all, pane.visible(), Align2::RIGHT_TOP, &text, theme::AMBER);
    }
}

fn wipe_ui(ui: &mut Ui, shared: &Shared, actions: &mut Vec<Action>, area: Rect) {
    let x = area.left() + area.width() * shared.viewport.wipe;
    let handle = Rect::from_center_size(pos2(x, area.center().y), vec2(18.0, area.height()));
    let response = ui
        .interact(handle, ui.scope_id().with("wipe"), Sense::drag())
        .on_hover_cursor(CursorIcon::ResizeHorizontal);
    if let Some(pointer) = response.interact_pointer_pos() {
        let share = ((pointer.x - area.left()) / area.width().max(1.0)).clamp(0.02, 0.98);
        actions.push(Action::Wipe(share));
    }
    response.widget_info(|| WidgetInfo::slider(true, f64::from(shared.viewport.wipe), "Wipe"));
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

/// Marks a view that nobody recorded, with a frame and words.
fn paint_synthesised(ui: &Ui, rect: Rect, is_faded: bool, plates: &mut Plates) {
    let painter = ui.painter();
    painter.rect_stroke(rect, 0.0, Stroke::new(3.0, theme::AMBER), egui::StrokeKind::Inside);
    let text = format!("{SYNTHESISED}  ·  R returns");
    plates.text(painter, rect, Align2::RIGHT_TOP, &text, theme::AMBER);
    if is_faded {
        plates.text(painter, rect, Align2::RIGHT_TOP, FADED, theme::AMBER);
    }
}

/// Shows the notice about the picture as a whole, in its lower middle.
fn notices_ui(ui: &mut Ui, shared: &Shared, area: Rect, with_marks: bool, plates: &mut Plates) {
    let Some((text, colour)) = notice(shared, with_marks) else { return };
    let painter = ui.painter().clone();
    let Some(rect) = plates.text(&painter, area, Align2::CENTER_BOTTOM, &text, colour) else { return };
    let response = ui.interact(rect, ui.scope_id().with("notice"), Sense::hover());
    response.widget_info(|| WidgetInfo::labeled(Role::Label, true, &text));
}

fn notice(shared: &Shared, with_marks: bool) -> Option<(String, Color32)> {
    if let Some(waiting) = shared.opening.waiting_for() {
        return Some((waiting, theme::TEXT));
    }
    let Some(picture) = shared.picture() else {
        return Some(("Making the first picture…".into(), theme::TEXT));
    };
    if shared.document.is_excluded(picture.request.view.frame) {
        let how = shared.with_keys("the Time menu takes it back in", Command::Exclude);
        return Some((format!("{EXCLUDED} – {how}"), theme::AMBER));
    }
    if let Some(problem) = &picture.problem {
        return Some((problem.clone(), theme::ERROR));
    }
    let info = shared.info()?;
    if shared.document.mode.needs_original() && !info.has_original {
        return info.original_missing.clone().map(|why| (why, theme::AMBER));
    }
    if shared.document.is_hidden && !shared.document.prompts().is_empty() {
        return Some((
            format!("Overlays are hidden – {}", shared.tooltip(Command::HideOverlays)),
            theme::TEXT_WEAK,
        ));
    }
    let answers: Vec<_> = picture.findings.iter().filter_map(|f| f.outcome.as_ref().ok()).collect();
    let is_nothing = with_marks && !answers.is_empty() && answers.iter().all(|f| f.area_px == 0);
    is_nothing.then(|| (nothing_found(shared, picture), theme::AMBER))
}

/// Says that nothing was found, and why, if that is the same for all prompts.
fn nothing_found(shared: &Shared, picture: &Picture) -> String {
    let waits = |id| shared.document.prompt(id).is_some_and(|prompt| shared.waits_as_marked(prompt));
    let reason = |(finding, prompt): (&Finding, &AskedPrompt)| {
        if waits(prompt.id) {
            return FOUND_WHEN_READY;
        }
        let answer = finding.answer.as_ref().filter(|answer| !answer.may_be_found(prompt.threshold));
        answer.map_or(nothing_here(shared), |answer| answer.absence.words())
    };
    let reasons: Vec<&str> = picture.findings.iter().zip(&picture.request.prompts).map(reason).collect();
    match &reasons[..] {
        [first, others @ ..] if others.iter().all(|other| other == first) => sentence(first),
        _ => shared.not_reconstructed().unwrap_or(NOTHING_OF_ALL).to_owned(),
    }
}

/// Describes the picture in words, for users who cannot see it.
fn describe(shared: &Shared, panes: &[PaneView]) -> String {
    let Some(picture) = shared.picture() else { return "No picture yet".into() };
    if shared.document.is_excluded(picture.request.view.frame) {
        return format!(
            "Frame {} of {}, {EXCLUDED}",
            picture.request.view.frame + 1,
            shared.playback.num_frames()
        );
    }
    let mode = shared.document.mode.label();
    let shown = panes.iter().map(|p| p.label).collect::<Vec<_>>().join(" and ");
    let mut text = format!(
        "{}, frame {} of {}",
        if shown == mode { shown } else { format!("{mode}: {shown}") },
        picture.request.view.frame + 1,
        shared.playback.num_frames()
    );
    if !picture.request.view.orbit.is_home() {
        text += ", synthesised view";
        if picture.unseen_share > 0.0 {
            text += &format!(", {FADED}");
        }
    }
    if panes.iter().any(|p| !p.label.starts_with("Recorded")) {
        shared.cautions().iter().for_each(|caution| text += &format!(", {caution}"));
    }
    if shared.document.is_hidden {
        return text + ", overlays hidden";
    }
    if let Some(words) = shared.clean_up_words().filter(|_| !picture.findings.is_empty()) {
        text += &format!(", {words}");
    }
    for finding in picture.findings.iter().filter(|finding| finding.outcome.is_ok()) {
        if let Some(asked) = picture.request.prompts.iter().find(|asked| asked.id == finding.id) {
            text += &format!(", {} {}", finding.text, legend::value(shared, asked, finding));
        }
    }
    text
}
