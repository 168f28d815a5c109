//! Division of the viewport into panes, each with the texture that it shows.

use crate::viewer::{
    picture::{difference, texture::Texture},
    shared::Shared,
    state::view_mode::{Layer, ViewMode},
};
use egui::{Rect, Ui, vec2};

/// A rectangle of the viewport and its contents.
#[derive(Clone)]
pub(crate) struct PaneView {
    pub(crate) rect: Rect,
    pub(crate) picture: Rect,
    pub(crate) texture: Option<Texture>,
    pub(crate) label: &'static str,
    pub(crate) is_synthesised: bool,
    /// `true` if lines around what was found belong on the picture.
    pub(crate) has_outlines: bool,
}

impl PaneView {
    /// Returns the part of the pane that the picture covers, where labels belong.
    pub(crate) fn visible(&self) -> Rect {
        self.rect.intersect(self.picture)
    }
}

/// A picture and its name.
type Content<'a> = (Option<&'a Texture>, &'static str);

/// Divides `area` as the view mode wants it; there are no panes before the first picture.
pub(crate) fn panes<'a>(shared: &'a Shared, area: Rect, ui: &Ui) -> Vec<PaneView> {
    let (Some(info), Some(shown)) = (shared.info(), shared.open.as_ref().and_then(|o| o.shown.as_ref()))
    else {
        return Vec::new();
    };
    if shared.document.is_excluded(shown.picture.request.view.frame) {
        return Vec::new();
    }
    let size = vec2(info.width as f32, info.height as f32);
    let with_marks = !shared.document.is_hidden;
    let is_synthesised = !shown.picture.request.view.orbit.is_home();
    let pane = |rect: Rect, texture: Option<&Texture>, label, is_synthesised| PaneView {
        rect,
        picture: shared.document.look.zoom.picture_rect(rect.shrink(6.0), size),
        texture: texture.cloned(),
        label,
        is_synthesised,
        has_outlines: with_marks && ["Recorded", "Reconstruction", "Depth"].contains(&label),
    };
    let reconstruction = (shown.reconstruction.texture(with_marks), "Reconstruction");
    let depth = match shown.layer() {
        Some((Layer::Depth, texture)) => (Some(texture), "Depth"),
        Some((Layer::Motion, texture)) => (Some(texture), "Moving"),
        Some((Layer::Opacity, texture)) => (Some(texture), "Opacity"),
        None => (None, ""),
    };
    let original = (shown.original.texture(with_marks), "Recorded");
    // While the picture of another mode is being made, the last one stays, under its own name.
    let first = |options: [Content<'a>; 3]| {
        let mut options = options.into_iter().chain([original, reconstruction, depth]);
        options.find(|(texture, _)| texture.is_some()).unwrap_or((None, ""))
    };
    let single = |options| {
        let (texture, label) = first(options);
        vec![pane(area, texture, label, is_synthesised && label != "Recorded")]
    };
    let beside = |a: Content<'a>, b: Content<'a>| {
        let (left, right) = area.split_left_right_at_fraction(0.5);
        [(left, a), (right, b)].map(|(r, (t, label))| pane(r, t, label, is_synthesised)).to_vec()
    };
    if shared.is_peeking(ui.ctx()) && shown.original.texture(false).is_some() {
        return vec![pane(area, shown.original.texture(false), "Recorded, nothing drawn over it", false)];
    }
    match shared.document.mode {
        ViewMode::Original => single([original, reconstruction, depth]),
        ViewMode::Reconstruction | ViewMode::Wipe => single([reconstruction, original, depth]),
        ViewMode::Depth | ViewMode::Motion | ViewMode::Opacity => single([depth, reconstruction, original]),
        ViewMode::Difference => single([(shown.difference(), "Difference"), reconstruction, original]),
        ViewMode::Blink => {
            let now = ui.input(|i| i.time);
            ui.ctx().request_repaint_after_secs(difference::seconds_to_turn(now) as f32);
            let is_recorded = difference::is_recorded_turn(now);
            let turns = if is_recorded { [original, reconstruction] } else { [reconstruction, original] };
            single([turns[0], turns[1], depth])
        }
        ViewMode::SideBySide => beside(original, reconstruction),
        ViewMode::DepthBeside => beside(reconstruction, depth),
    }
}
