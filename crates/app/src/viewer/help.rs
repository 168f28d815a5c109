//! Sheets over the window: keys, about, and what this program is not for.

use super::{
    app::ViewerApp,
    command::{COMMANDS, Group, keys_text},
    theme,
    widgets::{dialog, main_button},
};
use egui::{Context, Grid, RichText, ScrollArea, Ui};
use surgtpgs_core::export::intended_use;

/// A sheet that covers the window until it is closed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Sheet {
    Shortcuts,
    About,
}

/// Shown below the intended use before the first use, and in About.
pub(crate) const NOTICE: &str = "SurgTPGS is not a medical device and has not been approved for clinical use. What it \
highlights may be wrong or incomplete: a similarity score says how close a pixel is to your words, not how likely it \
is to be right. The user is responsible for how it is used.";

const PRIVACY: &str = "Everything happens on this computer. The program has no network access, sends nothing anywhere \
and keeps no statistics. It remembers which files were opened last (File, Recently opened: there it can be told \
to forget them) and work that was not saved.";

/// The sheet that is open; before anything else the notice, once.
pub(crate) fn sheets_ui(ctx: &Context, app: &mut ViewerApp) {
    if !app.preferences.is_acknowledged {
        notice_ui(ctx, app);
        return;
    }
    let Some(sheet) = app.sheet else { return };
    let width = if sheet == Sheet::Shortcuts { 800.0 } else { 500.0 };
    let (is_done, is_closed) = dialog(ctx, "sheet", width, |ui| {
        match sheet {
            Sheet::Shortcuts => shortcuts_ui(ui),
            Sheet::About => about_ui(ui),
        }
        ui.add_space(10.0);
        ui.add(main_button("Close")).clicked()
    });
    if is_done || is_closed {
        app.sheet = None;
    }
}

fn notice_ui(ctx: &Context, app: &mut ViewerApp) {
    dialog(ctx, "notice", 500.0, |ui| {
        ui.heading("For research use only");
        ui.add_space(4.0);
        ui.label(RichText::new(intended_use()).color(theme::AMBER));
        ui.label(NOTICE);
        ui.add_space(10.0);
        if ui.add(main_button("I understand")).clicked() {
            app.preferences.is_acknowledged = true;
            app.preferences.save();
        }
    });
}

/// The sheet is the command table.
fn shortcuts_ui(ui: &mut Ui) {
    ui.heading("Keyboard shortcuts");
    let height = ui.ctx().content_rect().height() - 190.0;
    ScrollArea::vertical().max_height(height.max(200.0)).show(ui, |ui| {
        ui.spacing_mut().interact_size.y = 18.0;
        ui.columns(2, |columns| {
            for group in Group::ALL {
                let column = usize::from(!matches!(group, Group::File | Group::Edit | Group::Time));
                group_ui(&mut columns[column], group);
            }
            mouse_ui(&mut columns[1]);
        });
    });
}

fn group_ui(ui: &mut Ui, group: Group) {
    ui.add_space(6.0);
    ui.label(RichText::new(group.title()).strong().color(theme::ACCENT));
    Grid::new(group.title()).num_columns(2).spacing([14.0, 3.0]).min_col_width(96.0).show(ui, |ui| {
        for entry in COMMANDS.iter().filter(|e| e.group == group && !e.keys.is_empty()) {
            ui.label(RichText::new(keys_text(entry)).monospace().color(theme::TEXT));
            ui.label(entry.label.trim_end_matches('…')).on_hover_text(entry.tooltip);
            ui.end_row();
        }
    });
}

fn mouse_ui(ui: &mut Ui) {
    ui.add_space(6.0);
    ui.label(RichText::new("Mouse on the picture").strong().color(theme::ACCENT));
    Grid::new("mouse").num_columns(2).spacing([14.0, 3.0]).min_col_width(96.0).show(ui, |ui| {
        for (what, does) in [
            ("Click", "What this point is most like"),
            ("Wheel", "Zoom"),
            ("Drag", "Move the enlarged picture"),
            ("Double-click", "Whole picture"),
            ("Right or Alt drag", "Look around a little"),
        ] {
            ui.label(RichText::new(what).monospace());
            ui.label(does);
            ui.end_row();
        }
    });
}

fn about_ui(ui: &mut Ui) {
    ui.heading(format!("SurgTPGS {}", env!("CARGO_PKG_VERSION")));
    ui.label(
        RichText::new("Text-prompted Gaussian splatting of surgical recordings, after Huang et al.")
            .color(theme::TEXT_WEAK),
    );
    ui.add_space(8.0);
    ui.label(RichText::new(intended_use()).color(theme::AMBER));
    ui.label(NOTICE);
    ui.add_space(8.0);
    ui.label(PRIVACY);
}
