//! The timeline: the bar to scrub on, and the buttons beside it.

use crate::viewer::{
    action::Action,
    command::Command,
    panels::{
        curves,
        room::Room,
        widgets::{Icon, caption, command_button, focus_ring},
    },
    picture::areas::Curve,
    shared::Shared,
    state::content::Prompt,
    text::timecode,
    theme,
};
use egui::{Rect, Response, RichText, Sense, Stroke, Ui, WidgetInfo, pos2, vec2};

/// Shows the buttons, the clock and the bar.
pub(crate) fn timeline_ui(ui: &mut Ui, shared: &Shared, actions: &mut Vec<Action>, room: Room) {
    bar_ui(ui, shared, actions, room);
    ui.add_space(2.0);
    ui.horizontal(|ui| {
        buttons_ui(ui, shared, actions, room);
        ui.add_space(if room.is_narrow() { 0.0 } else { 8.0 });
        clock_ui(ui, shared, actions, room);
        ui.with_layout(egui::Layout::right_to_left(egui::Align::Center), |ui| {
            speed_ui(ui, shared, actions, room);
        });
    });
}

/// Shows the buttons of a player. Where there is little room, those that the Time menu has, too, are left
/// out.
fn buttons_ui(ui: &mut Ui, shared: &Shared, actions: &mut Vec<Action>, room: Room) {
    let is_playing = shared.playback.is_playing();
    let frame = shared.playback.frame();
    let is_marked = shared.document.bookmarks().iter().any(|b| b.frame == frame);
    let bookmark = if is_marked { Command::DeleteBookmark } else { Command::Bookmark };
    let play = if is_playing { Icon::Pause } else { Icon::Play };
    for (icon, command, is_on, is_needed) in [
        (Icon::First, Command::First, false, false),
        (Icon::HopBack, Command::HopBack, false, false),
        (Icon::StepBack, Command::StepBack, false, true),
        (play, Command::PlayPause, is_playing, true),
        (Icon::StepForward, Command::StepForward, false, true),
        (Icon::HopForward, Command::HopForward, false, false),
        (Icon::Last, Command::Last, false, false),
        (Icon::Loop, Command::Loop, shared.playback.is_looping(), false),
        (Icon::Pin, bookmark, is_marked, true),
    ] {
        let is_shown = is_needed || !room.is_narrow();
        if is_shown && command_button(ui, shared, icon, command, is_on) {
            actions.push(Action::Run(command));
        }
    }
}

/// Shows the frame number (a click lets the user type one) and the time.
fn clock_ui(ui: &mut Ui, shared: &Shared, actions: &mut Vec<Action>, room: Room) {
    let playback = &shared.playback;
    let (frame, last) = (playback.frame(), playback.num_frames() - 1);
    let text = format!("Frame {} of {}", frame + 1, last + 1);
    if ui.button(text).on_hover_text(shared.tooltip(Command::GoToFrame)).clicked() {
        actions.push(Action::Run(Command::GoToFrame));
    }
    if !room.is_narrow() {
        let time = format!("{} / {}", timecode(playback.seconds(frame)), timecode(playback.seconds(last)));
        ui.label(RichText::new(time).monospace().color(theme::TEXT_WEAK));
    }
}

fn speed_ui(ui: &mut Ui, shared: &Shared, actions: &mut Vec<Action>, room: Room) {
    let is_assumed = shared.info().is_some_and(|i| i.frames_per_second.is_none());
    let note = if is_assumed { " (assumed)" } else { "" };
    if !room.is_narrow() {
        let fps = format!("{:.0} frames per second{note}", shared.playback.fps());
        ui.add(egui::Label::new(caption(fps)).truncate());
    }
    let speed = shared.playback.speed();
    if speed != 1.0 {
        let text = RichText::new(format!("speed {speed}×")).font(theme::small()).color(theme::AMBER);
        if ui.button(text).on_hover_text(shared.tooltip(Command::NormalSpeed)).clicked() {
            actions.push(Action::Run(Command::NormalSpeed));
        }
    }
}

/// Shows the bar: one place per frame, the part that plays, the present frame; below it the areas over time.
fn bar_ui(ui: &mut Ui, shared: &Shared, actions: &mut Vec<Action>, room: Room) {
    let width = ui.available_width();
    let (rect, response) = ui.allocate_exact_size(vec2(width, 30.0), Sense::click_and_drag());
    let line = Rect::from_min_max(rect.min + vec2(8.0, 11.0), rect.max - vec2(8.0, 11.0));
    scrub(shared, actions, &response, line);
    let frame = shared.playback.frame();
    response.widget_info(|| WidgetInfo::slider(true, frame as f64 + 1.0, "Frame"));
    paint_bar(ui, shared, line, response.hovered() || response.dragged());
    focus_ring(ui.painter(), line, &response);
    hover_ui(shared, response, line);
    let curves = shared.curves();
    if !curves.is_empty() && !room.is_low() {
        curves_ui(ui, shared, actions, &curves, line);
    }
}

fn curves_ui(
    ui: &mut Ui,
    shared: &Shared,
    actions: &mut Vec<Action>,
    curves: &[(usize, Prompt, Curve)],
    line: Rect,
) {
    let size = vec2(ui.available_width(), curves::HEIGHT);
    let (rect, response) = ui.allocate_exact_size(size, Sense::click_and_drag());
    scrub(shared, actions, &response, line);
    let last = shared.playback.num_frames() - 1;
    let x = |frame: usize| frame_x(line, frame, last);
    let plot = Rect::from_min_max(pos2(line.left(), rect.top()), pos2(line.right(), rect.bottom()));
    curves::paint(ui, shared, curves, plot, &x);
    ui.painter().vline(x(shared.playback.frame()), plot.y_range(), Stroke::new(1.5, theme::TEXT));
    response
        .widget_info(|| WidgetInfo::labeled(egui::Role::GraphicsDocument, true, curves::describe(curves)));
    hover_ui(shared, response, line);
}

/// Goes to the frame under the pointer while it is pressed.
fn scrub(shared: &Shared, actions: &mut Vec<Action>, response: &Response, line: Rect) {
    if let Some(pointer) = response.interact_pointer_pos() {
        let frame = frame_at(line, pointer.x, shared.playback.num_frames() - 1);
        actions.push(if response.dragged() { Action::Scrub(frame) } else { Action::GoTo(frame) });
    }
}

/// Shows number, time and note of the frame under the pointer.
fn hover_ui(shared: &Shared, response: Response, line: Rect) {
    let Some(pointer) = response.hover_pos() else { return };
    let under = frame_at(line, pointer.x, shared.playback.num_frames() - 1);
    let mut text = format!("Frame {}  ·  {}", under + 1, timecode(shared.playback.seconds(under)));
    if shared.document.is_excluded(under) {
        text += "\nLeft out of everything";
    }
    if let Some(bookmark) = shared.document.bookmarks().iter().find(|b| b.frame == under) {
        text += if bookmark.is_flagged { "\nBookmark, flagged" } else { "\nBookmark" };
        text += &format!("  {}", bookmark.note);
    }
    response.on_hover_text_at_pointer(text);
}

fn frame_at(line: Rect, x: f32, last: usize) -> usize {
    let share = ((x - line.left()) / line.width().max(1.0)).clamp(0.0, 1.0);
    (share * last as f32).round() as usize
}

fn frame_x(line: Rect, frame: usize, last: usize) -> f32 {
    line.left() + line.width() * frame as f32 / last.max(1) as f32
}

fn paint_bar(ui: &Ui, shared: &Shared, line: Rect, is_hot: bool) {
    let painter = ui.painter();
    let last = shared.playback.num_frames() - 1;
    let x = |frame: usize| frame_x(line, frame, last);
    painter.rect_filled(line, 4.0, theme::CONTROL);
    if let Some((start, end)) = shared.playback.range() {
        let part = Rect::from_min_max(pos2(x(start), line.top()), pos2(x(end), line.bottom()));
        painter.rect_filled(part.expand2(vec2(1.0, 0.0)), 4.0, theme::SELECTION);
    }
    for &(from, to) in shared.document.excluded() {
        let part = Rect::from_min_max(pos2(x(from), line.top()), pos2(x(to), line.bottom()));
        paint_excluded(painter, part.expand2(vec2(2.0, 0.0)));
    }
    let done = Rect::from_min_max(line.min, pos2(x(shared.playback.frame()), line.bottom()));
    painter.rect_filled(done, 4.0, theme::ACCENT.gamma_multiply(0.55));
    // One tick per ten frames, or per more frames where the ticks would be too dense.
    let every =
        [10_usize, 50, 100, 500, 1000].into_iter().find(|n| x(*n) - line.left() > 14.0).unwrap_or(5000);
    for frame in (every..shared.playback.num_frames()).step_by(every) {
        let stroke = Stroke::new(1.0, theme::TEXT_WEAK.gamma_multiply(0.6));
        painter.vline(x(frame), line.bottom() + 2.0..=line.bottom() + 6.0, stroke);
    }
    for frame in shared.document.marks().frames() {
        paint_marked(painter, pos2(x(frame), line.bottom() + 5.0));
    }
    for bookmark in shared.document.bookmarks() {
        paint_bookmark(painter, pos2(x(bookmark.frame), line.top() - 2.0), bookmark.is_flagged);
    }
    let head = pos2(x(shared.playback.frame()), line.center().y);
    painter.circle(head, if is_hot { 9.0 } else { 7.5 }, theme::TEXT, Stroke::new(2.0, theme::PANEL));
}

/// Paints a part as crossed out: hatched, and dark below the hatches.
fn paint_excluded(painter: &egui::Painter, part: Rect) {
    painter.rect_filled(part, 2.0, theme::BACKDROP);
    let painter = painter.with_clip_rect(part);
    let mut left = part.left() - part.height();
    while left < part.right() {
        let ends = [pos2(left, part.bottom()), pos2(left + part.height(), part.top())];
        painter.line_segment(ends, Stroke::new(1.5, theme::AMBER));
        left += 6.0;
    }
}

/// Paints a diamond below the bar, on a frame with marks by hand.
fn paint_marked(painter: &egui::Painter, at: egui::Pos2) {
    let points = [(0.0, -4.5), (4.5, 0.0), (0.0, 4.5), (-4.5, 0.0)].map(|(dx, dy)| at + vec2(dx, dy));
    painter.add(egui::Shape::convex_polygon(points.to_vec(), theme::ACCENT, Stroke::new(1.0, theme::PANEL)));
}

/// Paints a pin above the bar; a flagged one has another shape as well as another colour.
fn paint_bookmark(painter: &egui::Painter, tip: egui::Pos2, is_flagged: bool) {
    let at = |dx: f32, dy: f32| tip + vec2(dx, dy);
    let (points, colour) = if is_flagged {
        (vec![at(0.0, 0.0), at(0.0, -9.0), at(8.0, -6.5), at(0.0, -4.0)], theme::AMBER)
    } else {
        (vec![at(0.0, 0.0), at(-4.5, -8.0), at(4.5, -8.0)], theme::TEXT)
    };
    painter.add(egui::Shape::convex_polygon(points, colour, Stroke::new(1.0, theme::PANEL)));
}
