//! The room that the window has, in points, which are larger where text is larger.

use egui::{Context, Vec2};

/// Least width of the side panel where there is room.
const MIN_PANEL: f32 = 300.0;
/// Largest share of the window that the side panel takes.
const MAX_SHARE: f32 = 0.46;

/// Height that the picture keeps before anything more is shown below it.
const PICTURE: f32 = 200.0;
/// Height of what is always there: menus, the time bar and its buttons, the status.
const ALWAYS: f32 = 150.0;
/// Height of a row of views to choose above the picture, and the width of all of them.
const VIEWS: Vec2 = Vec2::new(850.0, 38.0);

/// Size of the window's contents.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Room {
    size: Vec2,
}

impl Room {
    pub(crate) fn of(ctx: &Context) -> Self {
        Self { size: ctx.content_rect().size() }
    }

    /// Returns `true` if only the most important things fit side by side.
    pub(crate) fn is_narrow(self) -> bool {
        self.size.x < 720.0
    }

    /// Returns `true` if only the most important things fit one below the other.
    pub(crate) fn is_low(self) -> bool {
        self.size.y < 440.0
    }

    /// Returns the height that is left for more below the picture, beside a side panel of this width.
    pub(crate) fn below_picture(self, wanted_panel: f32) -> f32 {
        let width = self.size.x - self.panel_width(wanted_panel);
        let views = VIEWS.y * (VIEWS.x / width).ceil();
        if self.is_low() { 0.0 } else { (self.size.y - ALWAYS - views - PICTURE).max(0.0) }
    }

    /// Returns the width of the side panel that comes nearest to what is wanted.
    pub(crate) fn panel_width(self, wanted: f32) -> f32 {
        let most = self.size.x * MAX_SHARE;
        wanted.clamp(MIN_PANEL.min(most), most)
    }
}
