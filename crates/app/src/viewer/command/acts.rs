//! Actions that several commands share, or that do not fit their rows.

use crate::viewer::{
    backend::paths::{PathAsk, PathKind},
    command::Command,
    picture::areas::{self, Curve},
    shared::{Shared, Viewport},
    state::{time_scale::TimeScale, view_mode::ViewMode},
    text::thousands,
};
use egui::{Context, Order, Pos2, Rect, ViewportCommand, pos2};
use std::path::Path;

/// Extensions of files that can be opened.
const OPENED: [&str; 9] = ["safetensors", "ply", "spz", "surgtpgs", "mp4", "mov", "mkv", "avi", "dcm"];

/// Circumstances in which a command is carried out.
pub(super) struct Given<'a> {
    /// Index of the command's key that was pressed.
    pub(super) index: usize,
    pub(super) ctx: &'a Context,
    /// Time by the window's clock, seconds.
    pub(super) now: f64,
    /// `true` while the key of [`Command::Stop`](super::Command::Stop) is down.
    pub(super) is_stop_down: bool,
}

/// Goes to the frame where one more mark would help most, with the tool in hand, which shows the place. Keys
/// stay commands, unless a name is missing.
pub(super) fn look_here(shared: &mut Shared, given: &Given<'_>) {
    let counts = |frame: usize| !shared.document.is_excluded(frame);
    if let Some(frame) = shared.areas().and_then(|areas| areas.look_here(counts)).map(|here| here.frame) {
        shared.playback.pause();
        shared.playback.go_to(frame, given.now);
        if !shared.viewport.marking.is_on {
            shared.take_marking();
            let marking = &mut shared.viewport.marking;
            marking.wants_name = marking.plain_name().is_empty();
        }
    }
}

/// Asks what to open.
pub(super) fn pick(shared: &mut Shared, is_folder: bool, ctx: &Context) {
    shared.ask_for(what_to_open(shared, is_folder), ctx);
}

/// Returns the question what to open: a file, or a folder. It begins beside what is open, or was last.
pub(super) fn what_to_open(shared: &Shared, is_folder: bool) -> PathAsk {
    let (title, kind) = if is_folder {
        ("Open a recording: a folder of frames", PathKind::Folder)
    } else {
        ("Open a reconstruction, a session or a video", PathKind::File(&OPENED))
    };
    let open = shared.info().map(|info| &info.path);
    let known = open.into_iter().chain(&shared.preferences.recent).find(|path| !shared.is_demo(path));
    let folder = known.and_then(|path| path.parent()).map(Path::to_owned);
    PathAsk { title: title.into(), kind, folder }
}

/// Dismisses one thing, the topmost.
pub(super) fn dismiss(shared: &mut Shared) {
    let Viewport { probe, marking, .. } = &mut shared.viewport;
    let is_done = shared.problem.take().is_some() || probe.take().is_some() || marking.draft.take().is_some();
    if !is_done {
        shared.viewport.has_ruler = false;
        shared.put_away_marking();
    }
}

pub(super) fn full_screen(ctx: &Context) {
    let is_full = ctx.input(|i| i.viewport().fullscreen.unwrap_or(false));
    ctx.send_viewport_cmd(ViewportCommand::Fullscreen(!is_full));
}

/// Shows a view; if it is shown already, goes back to the recorded frame.
pub(super) fn switch(shared: &mut Shared, mode: ViewMode) {
    let usual = shared.info().map(ViewMode::usual).unwrap_or_default();
    let is_shown = shared.document.mode == mode;
    shared.document.mode = if is_shown { usual } else { mode };
}

/// Plays in a direction (1 or −1). As on a video deck, makes single steps while the stop key is held down.
pub(super) fn shuttle(shared: &mut Shared, given: &Given<'_>, direction: isize) {
    if given.is_stop_down {
        shared.step(direction, given.now);
    } else {
        shared.playback.shuttle(direction as f64, given.now);
    }
}

/// Begins the part that plays on the frame that is seen.
pub(super) fn begin_range(shared: &mut Shared, given: &Given<'_>) {
    shared.go_to_seen(given.now);
    shared.document.set_range(Some(shared.playback.range_from_here()));
}

/// Ends the part that plays on the frame that is seen.
pub(super) fn end_range(shared: &mut Shared, given: &Given<'_>) {
    shared.go_to_seen(given.now);
    shared.document.set_range(Some(shared.playback.range_to_here()));
}

/// Sets a bookmark on the frame that is seen, or deletes it.
pub(super) fn toggle_bookmark(shared: &mut Shared, given: &Given<'_>) {
    shared.go_to_seen(given.now);
    shared.document.toggle_bookmark(shared.playback.frame());
}

/// Leaves the range that plays, or the frame that is seen, out of everything, or takes it back in.
pub(super) fn exclude(shared: &mut Shared, given: &Given<'_>) {
    shared.go_to_seen(given.now);
    let frame = shared.playback.frame();
    let (from, to) = shared.document.content().range.unwrap_or((frame, frame));
    shared.document.toggle_excluded(from, to);
}

/// Enlarges the time bar around the present frame.
pub(super) fn magnify_time(shared: &mut Shared, by: f32) {
    let line = Rect::from_min_max(pos2(0.0, 0.0), pos2(1.0, 1.0));
    let scale = TimeScale::new(line, shared.playback.num_frames() - 1, shared.viewport.span);
    shared.viewport.span = scale.magnified(by, scale.x(shared.playback.frame()));
}

pub(super) fn go_to_found(shared: &mut Shared, given: &Given<'_>, which: fn(&Curve) -> Option<usize>) {
    if let Some(frame) = shared.selected_curve().as_ref().and_then(which) {
        shared.playback.pause();
        shared.playback.go_to(frame, given.now);
    }
}

/// Goes to the next bookmark in a direction (1 or −1) from the frame that is seen.
pub(super) fn go_to_bookmark(shared: &mut Shared, given: &Given<'_>, direction: isize) {
    if let Some(frame) = shared.document.bookmark_beside(shared.seen_frame(), direction) {
        shared.playback.pause();
        shared.playback.go_to(frame, given.now);
    }
}

/// Copies the areas of all visible prompts that have an answer as a table, and says how long it is.
pub(super) fn copy_areas(shared: &mut Shared, given: &Given<'_>) {
    let mut curves = shared.curves();
    curves.retain(|(.., curve)| !curve.has_no_answer());
    let num_rows: usize = curves.iter().map(|(.., curve)| curve.num_known()).sum();
    let rows = curves.iter().map(|(_, p, c)| (p.text.as_str(), p.threshold, c.clone()));
    given.ctx.copy_text(areas::csv(rows, |frame| shared.playback.seconds(frame)));
    let rows = if num_rows == 1 { "row" } else { "rows" };
    shared.say(format!("A table of {} {rows} is copied", thousands(num_rows)), None, given.now);
}

/// Turns the view around the point under the pointer from now on, or around the probed point if the pointer
/// is not on the picture, such as in a menu.
pub(super) fn centre_orbit(shared: &mut Shared, given: &Given<'_>) {
    let point = pointed_at(shared, given.ctx).or(shared.viewport.probe);
    let said = match point.map(|point| point_in_space(shared, point)) {
        Some(Some(pivot)) => {
            shared.document.look.orbit.pivot = Some(pivot);
            "The view turns around this point from now on".to_owned()
        }
        Some(None) => "No depth is known here: point at tissue in the endoscope's own view".to_owned(),
        None => shared.with_keys("Point at the picture and press the key", Command::CentreOrbit),
    };
    shared.say(said, None, given.now);
}

/// Returns the point of the picture under the pointer, as share of width and height; `None` where something
/// lies over the picture.
fn pointed_at(shared: &Shared, ctx: &Context) -> Option<[f32; 2]> {
    let is_bare = |at: &Pos2| ctx.layer_id_at(*at).is_none_or(|layer| layer.order == Order::Background);
    let at = ctx.input(|i| i.pointer.hover_pos()).filter(is_bare)?;
    shared.viewport.panes.picture_position(at)
}

/// Returns the point in space that a point of the picture shows, in the endoscope's axes; `None` where there
/// is no recorded depth.
fn point_in_space(shared: &Shared, [u, v]: [f32; 2]) -> Option<[f32; 3]> {
    let (info, picture) = (shared.info()?, shared.picture()?);
    let (depth, lens) = (picture.depth_values.as_ref()?, info.lens?);
    let index = |share: f32, n: usize| ((share * n as f32) as usize).min(n.saturating_sub(1));
    let is_recorded = picture.request.view.orbit.is_home() && !depth.data.is_empty();
    let z = if is_recorded { depth.at(index(u, depth.width), index(v, depth.height)) } else { 0.0 };
    let on_axis = |share: f32, n: usize, c: f32, f: f32| (share * n as f32 - c) / f * z;
    let x = on_axis(u, info.width, lens.cx, lens.fx);
    let y = on_axis(v, info.height, lens.cy, lens.fy);
    (z > 0.0).then_some([x, y, z])
}
