//! Layout of the panels: menus above, prompts to the right, time below, the picture in the middle.

use super::{
    app::ViewerApp,
    bookmarks_ui,
    command::{self, Command},
    help, import_check, keep, negatives, prompts, status, theme, timeline, training, viewport,
};
use egui::{CentralPanel, Frame, Margin, Panel, Ui};

const PROMPTS_WIDTH: f32 = 340.0;

/// Shows the whole window.
pub(crate) fn window_ui(ui: &mut Ui, app: &mut ViewerApp) {
    let frame = |x, y| Frame::new().fill(theme::PANEL).inner_margin(Margin::symmetric(x, y));
    Panel::top("menus").frame(frame(10, 4)).show(ui, |ui| menus_ui(ui, app));
    Panel::bottom("status").frame(frame(12, 4)).show(ui, |ui| status::status_ui(ui, app));
    if app.open.is_some() {
        Panel::bottom("time").frame(frame(12, 8)).show(ui, |ui| timeline::timeline_ui(ui, app));
        let prompts = Panel::right("prompts").default_size(PROMPTS_WIDTH).size_range(300.0..=520.0);
        prompts.frame(frame(14, 12)).show(ui, |ui| {
            training::training_ui(ui, app);
            import_check::import_check_ui(ui, app);
            prompts::prompts_ui(ui, app);
        });
    }
    CentralPanel::default()
        .frame(Frame::new().fill(theme::BACKDROP))
        .show(ui, |ui| viewport::viewport_ui(ui, app));
    let ctx = ui.ctx().clone();
    training::train_dialog_ui(&ctx, app);
    super::export_dialog::export_dialog_ui(&ctx, app);
    super::quality::quality_ui(&ctx, app);
    timeline::go_to_ui(&ctx, app);
    bookmarks_ui::bookmarks_ui(&ctx, app);
    negatives::comparison_ui(&ctx, app);
    keep::recovery_ui(&ctx, app);
    help::sheets_ui(&ctx, app);
}

fn menus_ui(ui: &mut Ui, app: &mut ViewerApp) {
    use Command as C;
    egui::MenuBar::new().ui(ui, |ui| {
        ui.menu_button("File", |ui| {
            [C::OpenFile, C::OpenFolder].into_iter().for_each(|c| item(ui, app, c));
            recent_ui(ui, app);
            ui.separator();
            [C::SaveSession, C::SaveSessionAs].into_iter().for_each(|c| item(ui, app, c));
            ui.separator();
            [C::Reconstruct, C::Export, C::Quality].into_iter().for_each(|c| item(ui, app, c));
            ui.separator();
            item(ui, app, C::Quit);
        });
        menu(ui, app, "Edit", &[&[C::Undo, C::Redo], &[C::CopyAreas]]);
        let views: &[&[C]] = &[
            &[C::SwapOriginal, C::SideBySide, C::Wipe, C::Blink, C::Difference],
            &[C::Depth, C::DepthBeside, C::Motion, C::Opacity],
            &[C::Negatives],
            &[C::HideOverlays, C::CycleStyle, C::MoreOpacity, C::BelowInstruments],
            &[C::CentreOrbit, C::Measure],
            &[C::ResetView, C::FullScreen],
            &[C::Larger, C::Smaller, C::NormalSize],
        ];
        menu(ui, app, "View", views);
        let times: &[&[C]] = &[
            &[C::PlayPause, C::StepBack, C::StepForward, C::HopBack, C::HopForward],
            &[C::First, C::Last, C::GoToFrame],
            &[C::Slower, C::Faster, C::NormalSpeed],
            &[C::Loop, C::RangeStart, C::RangeEnd, C::RangeClear, C::Exclude],
            &[C::FirstFound, C::LargestFound, C::LastFound],
            &[C::Bookmark, C::PreviousBookmark, C::NextBookmark, C::Bookmarks],
        ];
        menu(ui, app, "Time", times);
        menu(ui, app, "Help", &[&[C::Shortcuts, C::About]]);
        if let Some(info) = app.info() {
            ui.with_layout(egui::Layout::right_to_left(egui::Align::Center), |ui| {
                ui.label(egui::RichText::new(&info.name).color(theme::TEXT_WEAK));
            });
        }
    });
}

fn menu(ui: &mut Ui, app: &mut ViewerApp, title: &str, groups: &[&[Command]]) {
    ui.menu_button(title, |ui| {
        for (i, group) in groups.iter().enumerate() {
            if i > 0 {
                ui.separator();
            }
            group.iter().for_each(|c| item(ui, app, *c));
        }
    });
}

/// Shows a menu entry; label, key and tooltip are those of the command table.
fn item(ui: &mut Ui, app: &mut ViewerApp, of: Command) {
    ui.set_min_width(250.0);
    let entry = command::entry(of);
    let label = match of {
        Command::Undo => named("Undo", app.document.undo_name()),
        Command::Redo => named("Redo", app.document.redo_name()),
        _ => entry.label.to_owned(),
    };
    let button = egui::Button::new(label).shortcut_text(command::keys_text(entry)).frame(false);
    let response = ui.add_enabled(app.is_enabled(of), button.min_size(egui::vec2(ui.available_width(), 0.0)));
    if response.on_hover_text(entry.tooltip).clicked() {
        app.run(of.into(), &ui.ctx().clone());
        ui.close();
    }
}

/// Names the edit that a command would act on, e.g. "Undo adding liver".
fn named(verb: &str, what: Option<&str>) -> String {
    what.map_or_else(|| verb.to_owned(), |what| format!("{verb} {what}"))
}

fn recent_ui(ui: &mut Ui, app: &mut ViewerApp) {
    let recent = app.preferences.recent.clone();
    ui.menu_button("Recently opened", |ui| {
            for path in &recent {
                let name = path
                    .file_name()
                    .map_or_else(|| path.display().to_string(), |n| n.to_string_lossy().into());
                let button = egui::Button::new(name).frame(false);
                if ui.add_enabled(path.exists(), button).on_hover_text(path.display().to_string()).clicked() {
                    app.open_path(path, &ui.ctx().clone());
                    ui.close();
                }
            }
            if !recent.is_empty() {
                ui.separator();
            }
            if ui.add_enabled(!recent.is_empty(), egui::Button::new("Forget these")).clicked() {
                app.preferences.forget_files(app.preferences.remembers_files);
                ui.close();
            }
            let mut forgets = !app.preferences.remembers_files;
            let tip = "Paths may hold names: with this on, none is kept, and unsaved work is dropped when the window is closed";
            if ui.checkbox(&mut forgets, "Do not remember what is opened").on_hover_text(tip).changed() {
                app.preferences.forget_files(!forgets);
            }
    });
}
