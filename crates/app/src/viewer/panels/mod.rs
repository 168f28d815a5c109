//! The panels: menus above, prompts to the right, time below, the picture in the middle, dialogs over them.
//!
//! A panel reads the state and pushes actions. It holds only what concerns it alone, such as half-typed text.

mod bookmarks;
mod clean_up;
mod comparison;
mod curves;
mod drawing;
pub(crate) mod export;
mod exporting;
pub(crate) mod go_to;
mod help;
mod import_check;
mod lanes;
mod legend;
mod loss_curve;
mod marking;
mod menus;
mod models;
mod outlines;
mod panes;
mod phases;
mod picker;
mod picking;
mod plates;
mod probe;
mod prompt_menu;
pub(crate) mod prompts;
mod quality;
mod recovery;
pub(crate) mod room;
mod ruler;
mod start;
mod status;
mod suggestions;
mod threshold;
pub(crate) mod timeline;
mod toast;
mod training;
mod viewport;
mod widgets;

use crate::viewer::{action::Action, shared::Shared, theme};
use comparison::ComparisonDialog;
use egui::{
    CentralPanel, CursorIcon, Frame, Margin, Panel, Rect, Sense, Stroke, Ui, UiBuilder, WidgetInfo, vec2,
};
use export::ExportDialog;
use go_to::GoToDialog;
use help::Sheets;
use phases::PhasesDialog;
use picker::Picker;
use prompts::Prompts;
use quality::QualityDialog;
use room::Room;
use training::TrainDialog;
use viewport::ViewportPanel;

/// The panels that hold something of their own.
#[derive(Default)]
pub(crate) struct Panels {
    prompts: Prompts,
    viewport: ViewportPanel,
    train: TrainDialog,
    export: ExportDialog,
    quality: QualityDialog,
    go_to: GoToDialog,
    comparison: ComparisonDialog,
    phases: PhasesDialog,
    sheets: Sheets,
    picker: Picker,
}

impl Panels {
    /// Shows the whole window.
    pub(crate) fn ui(&mut self, ui: &mut Ui, shared: &Shared, actions: &mut Vec<Action>) {
        let room = Room::of(ui.ctx());
        // The window is cleared in the colour of panels: without a GPU every filled pixel costs.
        let frame = |x, y| Frame::new().inner_margin(Margin::symmetric(x, y));
        Panel::top("menus").frame(frame(10, 4)).show(ui, |ui| menus::menus_ui(ui, shared, actions));
        Panel::bottom("status").frame(frame(12, 4)).show(ui, |ui| status::status_ui(ui, shared, room));
        let mut panel = None;
        if shared.open.is_some() {
            let time = Panel::bottom("time").frame(frame(12, if room.is_low() { 3 } else { 8 }));
            time.show(ui, |ui| timeline::timeline_ui(ui, shared, actions, room));
            let width = room.panel_width(shared.preferences.panel_width);
            let margin = if room.is_narrow() { 8 } else { 14 };
            let prompts = Panel::right("prompts").resizable(false).exact_size(width);
            let shown = prompts.frame(frame(margin, 10)).show(ui, |ui| {
                // The panel keeps its width, whatever its contents would like.
                let inner = ui.available_rect_before_wrap();
                ui.allocate_rect(inner, Sense::hover());
                let mut ui = ui.new_child(UiBuilder::new().max_rect(inner));
                ui.shrink_clip_rect(inner.expand(4.0));
                self.prompts.ui(&mut ui, shared, actions);
            });
            panel = Some(shown.response.rect);
        }
        CentralPanel::default()
            .frame(Frame::new())
            .show(ui, |ui| self.viewport.ui(ui, shared, actions, room));
        if let Some(panel) = panel {
            resize_ui(ui, panel, room, actions);
        }
        let ctx = ui.ctx().clone();
        self.train.ui(&ctx, shared, actions);
        self.export.ui(&ctx, shared, actions);
        self.quality.ui(&ctx, shared, actions);
        self.go_to.ui(&ctx, shared, actions);
        bookmarks::bookmarks_ui(&ctx, shared, actions);
        self.phases.ui(&ctx, shared, actions);
        self.comparison.ui(&ctx, shared, actions);
        recovery::recovery_ui(&ctx, shared, actions);
        self.picker.ui(&ctx, shared, actions);
        self.sheets.ui(&ctx, shared, actions);
    }
}

/// Shows the border of the panel, which changes its width when it is dragged.
fn resize_ui(ui: &Ui, panel: Rect, room: Room, actions: &mut Vec<Action>) {
    let border = Rect::from_min_max(panel.left_top(), panel.left_bottom()).expand2(vec2(4.0, 0.0));
    let response = ui.interact(border, ui.scope_id().with("width of the panel"), Sense::drag());
    let response = response.on_hover_cursor(CursorIcon::ResizeHorizontal);
    response.widget_info(|| WidgetInfo::slider(true, f64::from(panel.width()), "Width of the panel"));
    if let Some(pointer) = response.interact_pointer_pos().filter(|_| response.dragged()) {
        let width = room.panel_width(panel.right() - pointer.x);
        actions.push(Action::PanelWidth(width));
    }
    let colour = if response.hovered() || response.dragged() { theme::LINE_HOVER } else { theme::LINE };
    ui.painter().vline(panel.left(), panel.y_range(), Stroke::new(1.0, colour));
}
