//! The panels: menus above, prompts to the right, time below, the picture in the middle, dialogs over them.
//!
//! A panel reads the state and pushes actions. It holds only what concerns it alone, such as half-typed text.

mod bookmarks;
mod clean_up;
mod comparison;
mod curves;
pub(crate) mod export;
mod folder;
pub(crate) mod go_to;
mod help;
mod import_check;
mod legend;
mod loss_curve;
mod menus;
mod panes;
mod probe;
mod prompt_menu;
pub(crate) mod prompts;
mod quality;
mod recovery;
mod ruler;
mod start;
mod status;
mod suggestions;
mod threshold;
pub(crate) mod timeline;
mod training;
mod viewport;
mod widgets;

use crate::viewer::{action::Action, shared::Shared, theme};
use comparison::ComparisonDialog;
use egui::{CentralPanel, Frame, Margin, Panel, Ui};
use export::ExportDialog;
use go_to::GoToDialog;
use help::Sheets;
use prompts::Prompts;
use quality::QualityDialog;
use training::TrainDialog;
use viewport::ViewportPanel;

const PROMPTS_WIDTH: f32 = 340.0;

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
    sheets: Sheets,
}

impl Panels {
    /// Shows the whole window.
    pub(crate) fn ui(&mut self, ui: &mut Ui, shared: &Shared, actions: &mut Vec<Action>) {
        let frame = |x, y| Frame::new().fill(theme::PANEL).inner_margin(Margin::symmetric(x, y));
        Panel::top("menus").frame(frame(10, 4)).show(ui, |ui| menus::menus_ui(ui, shared, actions));
        Panel::bottom("status").frame(frame(12, 4)).show(ui, |ui| status::status_ui(ui, shared));
        if shared.open.is_some() {
            let time = Panel::bottom("time").frame(frame(12, 8));
            time.show(ui, |ui| timeline::timeline_ui(ui, shared, actions));
            let prompts = Panel::right("prompts").default_size(PROMPTS_WIDTH).size_range(300.0..=520.0);
            prompts.frame(frame(14, 12)).show(ui, |ui| {
                training::training_ui(ui, shared, actions);
                import_check::import_check_ui(ui, shared, actions);
                self.prompts.ui(ui, shared, actions);
            });
        }
        CentralPanel::default()
            .frame(Frame::new().fill(theme::BACKDROP))
            .show(ui, |ui| self.viewport.ui(ui, shared, actions));
        let ctx = ui.ctx().clone();
        self.train.ui(&ctx, shared, actions);
        self.export.ui(&ctx, shared, actions);
        self.quality.ui(&ctx, shared, actions);
        self.go_to.ui(&ctx, shared, actions);
        bookmarks::bookmarks_ui(&ctx, shared, actions);
        self.comparison.ui(&ctx, shared, actions);
        recovery::recovery_ui(&ctx, shared, actions);
        self.sheets.ui(&ctx, shared, actions);
    }
}
