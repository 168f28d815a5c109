//! The timeline: the bar to scrub on, and the buttons beside it.

use super::{
    app::ViewerApp,
    areas::Curve,
    command::{Command, entry, tooltip},
    curves,
    document::Prompt,
    theme,
    widgets::{Icon, caption, command_button, dialog, main_button, timecode},
};
use egui::{Context, Rect, Response, RichText, Sense, Stroke, Ui, WidgetInfo, pos2, vec2};

/// Shows the buttons, the clock and the bar.
pub(crate) fn timeline_ui(ui: &mut Ui, app: &mut ViewerApp) {
    bar_ui(ui, app);
    ui.add_space(2.0);
    ui.horizontal(|ui| {
        let play = if app.playback.is_playing() { Icon::Pause } else { Icon::Play };
        let frame = app.playback.frame();
        let is_marked = app.document.bookmarks().iter().any(|b| b.frame == frame);
        let is_looping = app.playback.is_looping();
        for (icon, command, is_on) in [
            (Icon::First, Command::First, false),
            (Icon::HopBack, Command::HopBack, false),
            (Icon::StepBack, Command::StepBack, false),
            (play, Command::PlayPause, app.playback.is_playing()),
            (Icon::StepForward, Command::StepForward, false),
            (Icon::HopForward, Command::HopForward, false),
            (Icon::Last, Command::Last, false),
            (Icon::Loop, Command::Loop, is_looping),
            (Icon::Pin, Command::Bookmark, is_marked),
        ] {
            if command_button(ui, icon, command, is_on, true) {
                app.run(command.into(), &ui.ctx().clone());
            }
        }
        ui.add_space(8.0);
        clock_ui(ui, app);
        ui.with_layout(egui::Layout::right_to_left(egui::Align::Center), |ui| speed_ui(ui, app));
    });
}

/// Shows the frame number (a click lets the user type one) and the time.
fn clock_ui(ui: &mut Ui, app: &mut ViewerApp) {
    let playback = &app.playback;
    let (frame, last) = (playback.frame(), playback.num_frames() - 1);
    let text = format!("Frame {} of {}", frame + 1, last + 1);
    let tip = format!(
        "{}\nIn files this frame has the index {frame}: they count from 0",
        tooltip(Command::GoToFrame)
    );
    if ui.button(text).on_hover_text(tip).clicked() {
        app.run(Command::GoToFrame.into(), &ui.ctx().clone());
    }
    let playback = &app.playback;
    let time = format!("{} / {}", timecode(playback.seconds(frame)), timecode(playback.seconds(last)));
    ui.label(RichText::new(time).monospace().color(theme::TEXT_WEAK));
}

fn speed_ui(ui: &mut Ui, app: &mut ViewerApp) {
    let is_assumed = app.info().is_some_and(|i| i.frames_per_second.is_none());
    let note = if is_assumed { " (assumed)" } else { "" };
    let fps = format!("{:.0} frames per second{note}", app.playback.fps());
    ui.label(caption(fps));
    let speed = app.playback.speed();
    if speed != 1.0 {
        let text = RichText::new(format!("speed {speed}×")).font(theme::small()).color(theme::AMBER);
        if ui.button(text).on_hover_text(tooltip(Command::NormalSpeed)).clicked() {
            app.run(Command::NormalSpeed.into(), &ui.ctx().clone());
        }
    }
}

/// Shows the bar: one place per frame, the part that plays, the present frame; below it the areas over time.
fn bar_ui(ui: &mut Ui, app: &mut ViewerApp) {
    let width = ui.available_width();
    let (rect, response) = ui.allocate_exact_size(vec2(width, 30.0), Sense::click_and_drag());
    let line = Rect::from_min_max(rect.min + vec2(8.0, 11.0), rect.max - vec2(8.0, 11.0));
    scrub(ui, app, &response, line);
    let frame = app.playback.frame();
    response.widget_info(|| WidgetInfo::slider(true, frame as f64 + 1.0, "Frame"));
    paint_bar(ui, app, line, response.hovered() || response.dragged());
    hover_ui(app, response, line);
    let curves = curves::curves(app);
    if !curves.is_empty() {
        curves_ui(ui, app, &curves, line);
    }
}

fn curves_ui(ui: &mut Ui, app: &mut ViewerApp, curves: &[(usize, Prompt, Curve)], line: Rect) {
    let size = vec2(ui.available_width(), curves::HEIGHT);
    let (rect, response) = ui.allocate_exact_size(size, Sense::click_and_drag());
    scrub(ui, app, &response, line);
    let last = app.playback.num_frames() - 1;
    let x = |frame: usize| frame_x(line, frame, last);
    let plot = Rect::from_min_max(pos2(line.left(), rect.top()), pos2(line.right(), rect.bottom()));
    curves::paint(ui, app, curves, plot, &x);
    ui.painter().vline(x(app.playback.frame()), plot.y_range(), Stroke::new(1.5, theme::TEXT));
    response
        .widget_info(|| WidgetInfo::labeled(egui::Role::GraphicsDocument, true, curves::describe(curves)));
    hover_ui(app, response, line);
}

/// Goes to the frame under the pointer while it is pressed.
fn scrub(ui: &Ui, app: &mut ViewerApp, response: &Response, line: Rect) {
    if let Some(pointer) = response.interact_pointer_pos() {
        app.playback.pause();
        let now = ui.input(|i| i.time);
        app.playback.seek(frame_at(line, pointer.x, app.playback.num_frames() - 1), now);
        app.is_moving |= response.dragged();
    }
}

/// Shows number, time and note of the frame under the pointer.
fn hover_ui(app: &ViewerApp, response: Response, line: Rect) {
    let Some(pointer) = response.hover_pos() else { return };
    let under = frame_at(line, pointer.x, app.playback.num_frames() - 1);
    let mut text = format!("Frame {}  ·  {}", under + 1, timecode(app.playback.seconds(under)));
    if app.document.is_excluded(under) {
        text += "\nLeft out of everything";
    }
    if let Some(bookmark) = app.document.bookmarks().iter().find(|b| b.frame == under) {
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

fn paint_bar(ui: &Ui, app: &ViewerApp, line: Rect, is_hot: bool) {
    let painter = ui.painter();
    let last = app.playback.num_frames() - 1;
    let x = |frame: usize| frame_x(line, frame, last);
    painter.rect_filled(line, 4.0, theme::CONTROL);
    if let Some((start, end)) = app.playback.range() {
        let part = Rect::from_min_max(pos2(x(start), line.top()), pos2(x(end), line.bottom()));
        painter.rect_filled(part.expand2(vec2(1.0, 0.0)), 4.0, theme::SELECTION);
    }
    for &(from, to) in app.document.excluded() {
        let part = Rect::from_min_max(pos2(x(from), line.top()), pos2(x(to), line.bottom()));
        paint_excluded(painter, part.expand2(vec2(2.0, 0.0)));
    }
    let done = Rect::from_min_max(line.min, pos2(x(app.playback.frame()), line.bottom()));
    painter.rect_filled(done, 4.0, theme::ACCENT.gamma_multiply(0.55));
    // One tick per ten frames, or per more frames where the ticks would be too dense.
    let every =
        [10_usize, 50, 100, 500, 1000].into_iter().find(|n| x(*n) - line.left() > 14.0).unwrap_or(5000);
    for frame in (every..app.playback.num_frames()).step_by(every) {
        let stroke = Stroke::new(1.0, theme::TEXT_WEAK.gamma_multiply(0.6));
        painter.vline(x(frame), line.bottom() + 2.0..=line.bottom() + 6.0, stroke);
    }
    for bookmark in app.document.bookmarks() {
        paint_bookmark(painter, pos2(x(bookmark.frame), line.top() - 2.0), bookmark.is_flagged);
    }
    let head = pos2(x(app.playback.frame()), line.center().y);
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

/// Shows the small dialog to type a frame number. Afterwards the keys belong to the picture again.
pub(crate) fn go_to_ui(ctx: &Context, app: &mut ViewerApp) {
    let Some(mut text) = app.go_to.take() else { return };
    let last = app.playback.num_frames();
    let (chosen, is_closed) = dialog(ctx, "go to frame", 280.0, |ui| {
        ui.heading(entry(Command::GoToFrame).label.trim_end_matches('…'));
        let field = ui.add(egui::TextEdit::singleline(&mut text).hint_text(format!("1 to {last}")));
        field.request_focus();
        field.ctx.accesskit_node_builder(field.id, |node| node.set_label("Frame number"));
        let typed = text.trim().parse::<usize>().ok().filter(|n| (1..=last).contains(n));
        if typed.is_none() && !text.trim().is_empty() {
            ui.colored_label(theme::ERROR, format!("There are frames 1 to {last}."));
        }
        let go = ui.add_enabled(typed.is_some(), main_button("Go"));
        typed.filter(|_| go.clicked() || ui.input(|i| i.key_pressed(egui::Key::Enter)))
    });
    match chosen {
        Some(frame) => {
            let now = ctx.input(|i| i.time);
            app.playback.pause();
            app.playback.seek(frame - 1, now);
        }
        None if is_closed => {}
        None => app.go_to = Some(text),
    }
    if app.go_to.is_none() {
        ctx.memory_mut(|m| m.stop_text_input());
    }
}
