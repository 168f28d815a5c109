//! The timeline: the bar to scrub on, and the buttons beside it.

use crate::viewer::{
    action::Action,
    command::Command,
    panels::{
        curves, lanes,
        room::Room,
        widgets::{Icon, caption, command_button, focus_ring},
    },
    picture::thumbnails,
    shared::Shared,
    state::{content::Bookmark, time_scale::TimeScale},
    text::timecode,
    theme,
};
use egui::{Rect, Response, RichText, Sense, Stroke, Ui, WidgetInfo, pos2, vec2};

/// Most small pictures along the bar.
const MAX_SLOTS: f32 = 40.0;

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
    let (is_playing, frame) = (shared.playback.is_playing(), shared.seen_frame());
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

/// Shows small pictures, the bar with one place per frame, phases, where prompts were found, and their areas.
fn bar_ui(ui: &mut Ui, shared: &Shared, actions: &mut Vec<Action>, room: Room) {
    let (last, frame) = (shared.playback.num_frames() - 1, shared.playback.frame());
    let left = ui.cursor().left() + 8.0;
    let line = Rect::from_x_y_ranges(left..=left + ui.available_width() - 16.0, 0.0..=0.0);
    let scale = TimeScale::new(line, last, shared.viewport.span);
    let mut row = |ui: &mut Ui, height: f32, paint: &mut dyn FnMut(&mut Ui, Rect, &Response)| {
        let size = vec2(ui.available_width(), height);
        let (rect, response) = ui.allocate_exact_size(size, Sense::click_and_drag());
        magnify(ui, actions, &response, &scale);
        scrub(actions, &response, &scale);
        paint(ui, rect, &response);
        hover_ui(shared, response, &scale);
    };
    let curves = shared.curves();
    let rows = Rows::of(shared, room, curves.len());
    if rows.has_thumbnails {
        row(ui, thumbnails::HEIGHT_PX as f32, &mut |ui, rect, _| paint_thumbnails(ui, shared, rect, &scale));
    }
    row(ui, 30.0, &mut |ui, rect, response| {
        let bar = Rect::from_x_y_ranges(line.x_range(), rect.top() + 11.0..=rect.bottom() - 11.0);
        response.widget_info(|| WidgetInfo::slider(true, frame as f64 + 1.0, "Frame"));
        paint_bar(ui, shared, bar, &scale, response.hovered() || response.dragged());
        focus_ring(ui.painter(), bar, response);
    });
    if rows.has_phases {
        row(ui, lanes::PHASES_HEIGHT, &mut |ui, rect, response| {
            lanes::paint_phases(ui.painter(), shared, rect, &scale);
            let words = lanes::describe_phases(shared);
            response.widget_info(|| WidgetInfo::labeled(egui::Role::GraphicsDocument, true, &words));
        });
    }
    if rows.has_curves {
        row(ui, lanes::height(curves.len().max(1)), &mut |ui, rect, _| {
            lanes::paint_found(ui.painter(), &curves, rect, &scale);
        });
        row(ui, curves::HEIGHT, &mut |ui, rect, response| {
            let plot = Rect::from_x_y_ranges(line.x_range(), rect.y_range());
            curves::paint(ui, shared, &curves, plot, &|frame| scale.x(frame));
            let painter = ui.painter().with_clip_rect(plot);
            painter.vline(scale.x(frame), plot.y_range(), Stroke::new(1.5, theme::TEXT));
            let words = curves::describe(&curves);
            response.widget_info(|| WidgetInfo::labeled(egui::Role::GraphicsDocument, true, &words));
        });
    }
    if shared.viewport.span.is_some() && shared.viewport.span_frame != frame {
        actions.push(Action::TimeSpan(scale.following(frame)));
    }
    if let Some(wanted) = rows.has_thumbnails.then(|| wanted_thumbnails(shared, &scale)).flatten() {
        actions.push(Action::Thumbnails(wanted));
    }
}

/// Enlarges the bar with the wheel, and moves it with a wheel to the side.
fn magnify(ui: &Ui, actions: &mut Vec<Action>, response: &Response, scale: &TimeScale) {
    let Some(pointer) = response.hover_pos().filter(|_| response.hovered()) else { return };
    let (scroll, pinch) = ui.input(|i| (i.smooth_scroll_delta(), i.zoom_delta()));
    let by = pinch * (scroll.y / 200.0).exp();
    if by != 1.0 {
        actions.push(Action::TimeSpan(scale.magnified(by, pointer.x)));
    } else if scroll.x != 0.0 {
        actions.push(Action::TimeSpan(scale.moved(-scroll.x)));
    }
}

/// Goes to the frame under the pointer while it is pressed.
fn scrub(actions: &mut Vec<Action>, response: &Response, scale: &TimeScale) {
    if let Some(pointer) = response.interact_pointer_pos() {
        let frame = scale.frame(pointer.x);
        actions.push(if response.dragged() { Action::Scrub(frame) } else { Action::GoTo(frame) });
    }
}

/// Shows number, time, phase and note of the frame under the pointer.
fn hover_ui(shared: &Shared, response: Response, scale: &TimeScale) {
    let Some(pointer) = response.hover_pos() else { return };
    let under = scale.frame(pointer.x);
    let mut text = format!("Frame {}  ·  {}", under + 1, timecode(shared.playback.seconds(under)));
    if shared.document.is_excluded(under) {
        text += "\nLeft out of everything";
    }
    if let Some(phase) = shared.document.phase_at(under) {
        text += &format!("\n{}", phase.name);
    }
    if let Some(bookmark) = shared.document.bookmarks().iter().find(|b| b.frame == under) {
        text += if bookmark.is_flagged { "\nBookmark, flagged" } else { "\nBookmark" };
        text += &format!("  {}", bookmark.note);
    }
    response.on_hover_text_at_pointer(text);
}

fn paint_bar(ui: &Ui, shared: &Shared, line: Rect, scale: &TimeScale, is_hot: bool) {
    let painter = ui.painter().with_clip_rect(line.expand(11.0).intersect(ui.clip_rect()));
    let x = |frame: usize| scale.x(frame);
    painter.rect_filled(line, 4.0, theme::CONTROL);
    let part = |first: usize, last: usize, more: f32| {
        let (from, to) = (x(first).max(line.left()) - more, x(last).min(line.right()) + more);
        Rect::from_x_y_ranges(from..=to.max(from), line.y_range())
    };
    if let Some((start, end)) = shared.playback.range() {
        painter.rect_filled(part(start, end, 1.0), 4.0, theme::SELECTION);
    }
    for &(from, to) in shared.document.excluded() {
        if x(to) >= line.left() && x(from) <= line.right() {
            paint_excluded(&painter, part(from, to, 2.0));
        }
    }
    painter.rect_filled(part(0, shared.playback.frame(), 0.0), 4.0, theme::ACCENT.gamma_multiply(0.55));
    // One tick per ten frames, or per more frames where the ticks would be too dense.
    let every = [1_usize, 10, 50, 100, 500, 1000].into_iter().find(|n| x(*n) - x(0) > 14.0).unwrap_or(5000);
    let (first, last) = scale.shown();
    for frame in (first.next_multiple_of(every).max(every)..=last).step_by(every) {
        let stroke = Stroke::new(1.0, theme::TEXT_WEAK.gamma_multiply(0.6));
        painter.vline(x(frame), line.bottom() + 2.0..=line.bottom() + 6.0, stroke);
    }
    if shared.viewport.span.is_some() {
        // The part of the whole recording that is shown.
        let end = shared.playback.num_frames().max(2) as f32 - 1.0;
        let at = |frame: usize| line.left() + line.width() * frame as f32 / end;
        painter.hline(line.x_range(), line.bottom() + 8.5, Stroke::new(2.0, theme::CONTROL));
        painter.hline(at(first)..=at(last), line.bottom() + 8.5, Stroke::new(2.0, theme::ACCENT));
    }
    for frame in shared.document.marks().frames() {
        paint_marked(&painter, pos2(x(frame), line.bottom() + 5.0));
    }
    for bookmark in shared.document.bookmarks() {
        paint_bookmark(&painter, pos2(x(bookmark.frame), line.top() - 2.0), bookmark);
    }
    let head = pos2(x(shared.playback.frame()), line.center().y);
    painter.circle(head, if is_hot { 9.0 } else { 7.5 }, theme::TEXT, Stroke::new(2.0, theme::PANEL));
}

/// Rows beside the bar that there is something and room for.
struct Rows {
    has_thumbnails: bool,
    has_phases: bool,
    has_curves: bool,
}

impl Rows {
    fn of(shared: &Shared, room: Room, num_curves: usize) -> Self {
        const APART: f32 = 6.0;
        let mut left = room.below_picture(shared.preferences.panel_width);
        let mut takes = |is_wanted: bool, height: f32| {
            let is_shown = is_wanted && height + APART <= left;
            left -= if is_shown { height + APART } else { 0.0 };
            is_shown
        };
        // A first mark must not move the picture under the next one.
        let is_awaited = shared.viewport.marking.is_on && shared.carries_marks();
        // Those that tell most come first.
        let has_curves =
            takes(is_awaited || num_curves > 0, lanes::height(num_curves.max(1)) + APART + curves::HEIGHT);
        let has_phases = takes(!shared.document.phases().is_empty(), lanes::PHASES_HEIGHT);
        let has_original = shared.info().is_some_and(|info| info.has_original);
        Self { has_curves, has_phases, has_thumbnails: takes(has_original, thumbnails::HEIGHT_PX as f32) }
    }
}

/// Returns the places of small pictures from left to right, each with the frame in its middle.
fn slots(shared: &Shared, scale: &TimeScale) -> Vec<(Rect, usize)> {
    let Some(info) = shared.info() else { return Vec::new() };
    let height = thumbnails::HEIGHT_PX as f32;
    let width = (height * info.width as f32 / info.height.max(1) as f32).max(8.0);
    let count = (scale.line.width() / width).floor().clamp(1.0, MAX_SLOTS);
    let step = scale.line.width() / count;
    let slot = |k: usize| {
        let rect = Rect::from_min_size(pos2(scale.line.left() + k as f32 * step, 0.0), vec2(step, height));
        (rect, scale.frame(rect.center().x))
    };
    (0..count as usize).map(slot).collect()
}

/// Returns the frames whose small pictures are missing and have not been asked for.
fn wanted_thumbnails(shared: &Shared, scale: &TimeScale) -> Option<Vec<usize>> {
    let open = shared.open.as_ref()?;
    let frames: Vec<usize> = slots(shared, scale).into_iter().map(|(_, frame)| frame).collect();
    let missing = open.thumbnails.missing(&frames);
    let is_new = missing.iter().any(|frame| !open.wanted.contains(frame));
    is_new.then_some(missing)
}

fn paint_thumbnails(ui: &Ui, shared: &Shared, rect: Rect, scale: &TimeScale) {
    let Some(open) = &shared.open else { return };
    for (slot, frame) in slots(shared, scale) {
        let place = slot.translate(vec2(0.0, rect.top())).shrink2(vec2(0.5, 1.0));
        match open.thumbnails.texture(frame).filter(|_| !shared.document.is_excluded(frame)) {
            Some(texture) => texture.paint(ui.painter(), place),
            None => drop(ui.painter().rect_filled(place, 2.0, theme::BACKDROP)),
        }
    }
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

/// Paints a pin above the bar; a flagged one has another shape.
fn paint_bookmark(painter: &egui::Painter, tip: egui::Pos2, bookmark: &Bookmark) {
    let at = |dx: f32, dy: f32| tip + vec2(dx, dy);
    let usual = if bookmark.is_flagged { theme::AMBER } else { theme::TEXT };
    let colour = bookmark.colour.map_or(usual, theme::colour32);
    let points = if bookmark.is_flagged {
        vec![at(0.0, 0.0), at(0.0, -9.0), at(8.0, -6.5), at(0.0, -4.0)]
    } else {
        vec![at(0.0, 0.0), at(-4.5, -8.0), at(4.5, -8.0)]
    };
    painter.add(egui::Shape::convex_polygon(points, colour, Stroke::new(1.0, theme::PANEL)));
}
