//! The menu bar. A menu that is higher than the window scrolls.

use crate::viewer::{
    action::Action,
    command::{Command, entry},
    panels::widgets::{SCROLL_BAR, add_unless, show_scroll_bars},
    shared::Shared,
    theme,
};
use egui::{Frame, Margin, ScrollArea, Ui};

/// Height of a window that its menus leave free: the menu bar and their frame, points.
const ROOM_AROUND: f32 = 60.0;
/// Width of a menu without its scroll bar, points.
const WIDTH: f32 = 300.0;

/// Shows the menus, whose entries are commands.
pub(crate) fn menus_ui(ui: &mut Ui, shared: &Shared, actions: &mut Vec<Action>) {
    use Command as C;
    egui::MenuBar::new().ui(ui, |ui| {
        scrolling_menu(ui, "File", |ui| {
            let opens = [C::OpenFile, C::OpenFolder, C::OpenPath, C::OpenDemo];
            opens.into_iter().for_each(|c| item(ui, shared, actions, c));
            recent_ui(ui, shared, actions);
            ui.separator();
            [C::SaveSession, C::SaveSessionAs].into_iter().for_each(|c| item(ui, shared, actions, c));
            ui.separator();
            [C::OpenMarks, C::SaveMarks].into_iter().for_each(|c| item(ui, shared, actions, c));
            ui.separator();
            [C::Reconstruct, C::Export, C::Quality].into_iter().for_each(|c| item(ui, shared, actions, c));
            ui.separator();
            [C::StartPage, C::Quit].into_iter().for_each(|c| item(ui, shared, actions, c));
        });
        menu(ui, shared, actions, "Edit", &[&[C::Undo, C::Redo], &[C::CopyPicture, C::CopyAreas]]);
        let views: &[&[C]] = &[
            &[C::SwapOriginal, C::SideBySide, C::Wipe, C::Blink, C::Difference],
            &[C::Depth, C::DepthBeside, C::Motion, C::Opacity],
            &[C::Negatives],
            &[C::HideOverlays, C::CycleStyle, C::MoreOpacity, C::BelowInstruments],
            &[C::Mark, C::LookHere],
            &[C::CentreOrbit, C::Measure],
            &[C::ResetView, C::FullScreen],
            &[C::Larger, C::Smaller, C::NormalSize],
        ];
        menu(ui, shared, actions, "View", views);
        let times: &[&[C]] = &[
            &[C::PlayPause, C::StepBack, C::StepForward, C::HopBack, C::HopForward],
            &[C::First, C::Last, C::GoToFrame],
            &[C::Slower, C::Faster, C::NormalSpeed],
            &[C::Loop, C::RangeStart, C::RangeEnd, C::RangeClear, C::Exclude],
            &[C::FirstFound, C::LargestFound, C::LastFound],
            &[C::Bookmark, C::DeleteBookmark, C::PreviousBookmark, C::NextBookmark, C::Bookmarks],
            &[C::Phases, C::TimeCloser, C::TimeFarther],
        ];
        menu(ui, shared, actions, "Time", times);
        menu(ui, shared, actions, "Help", &[&[C::Shortcuts, C::About]]);
        ui.with_layout(egui::Layout::right_to_left(egui::Align::Center), |ui| {
            let title = egui::RichText::new(shared.title()).color(theme::TEXT_WEAK);
            ui.add(egui::Label::new(title).truncate());
        });
    });
}

/// Shows a button with a menu that is never higher than the window, and keeps its width while it is scrolled.
fn scrolling_menu(ui: &mut Ui, title: &str, content: impl FnOnce(&mut Ui)) {
    ui.menu_button(title, |ui| {
        let room = ui.ctx().content_rect().height() - ROOM_AROUND;
        show_scroll_bars(ui);
        ScrollArea::vertical().max_height(room).min_scrolled_height(room).show(ui, |ui| {
            // The scroll bar covers no keys.
            let margin = Margin { right: SCROLL_BAR as i8, ..Margin::ZERO };
            Frame::new().inner_margin(margin).show(ui, |ui| {
                ui.set_width(WIDTH);
                content(ui);
            });
        });
    });
}

fn menu(ui: &mut Ui, shared: &Shared, actions: &mut Vec<Action>, title: &str, groups: &[&[Command]]) {
    scrolling_menu(ui, title, |ui| {
        for (i, group) in groups.iter().enumerate() {
            if i > 0 {
                ui.separator();
            }
            group.iter().for_each(|c| item(ui, shared, actions, *c));
        }
    });
}

/// Shows a menu entry; label, key and tooltip are those of the command table.
fn item(ui: &mut Ui, shared: &Shared, actions: &mut Vec<Action>, of: Command) {
    let entry = entry(of);
    let label = match of {
        Command::Undo => named("Undo", shared.document.undo_name()),
        Command::Redo => named("Redo", shared.document.redo_name()),
        _ => entry.label.to_owned(),
    };
    let button = egui::Button::new(label).shortcut_text(shared.keys_text(of)).frame(false);
    let button = button.min_size(egui::vec2(ui.available_width(), 0.0));
    if add_unless(ui, shared.obstacle(of), button, entry.tooltip).clicked() {
        actions.push(Action::Run(of));
        ui.close();
    }
}

/// Names the edit that a command would act on, e.g. "Undo adding liver".
fn named(verb: &str, what: Option<&str>) -> String {
    what.map_or_else(|| verb.to_owned(), |what| format!("{verb} {what}"))
}

fn recent_ui(ui: &mut Ui, shared: &Shared, actions: &mut Vec<Action>) {
    let recent = shared.recent();
    ui.menu_button("Recently opened", |ui| {
            for path in &recent {
                let button = egui::Button::new(shared.path_name(path)).frame(false);
                let (place, is_gone) = (path.display().to_string(), shared.opening.gone.has(path));
                let obstacle = is_gone.then(|| format!("{place} is not there any more"));
                if add_unless(ui, obstacle.as_deref(), button, place).clicked() {
                    actions.push(Action::Open(path.to_path_buf()));
                    ui.close();
                }
            }
            if !recent.is_empty() {
                ui.separator();
            }
            let forget = ui.add_enabled(!recent.is_empty(), egui::Button::new("Forget these"));
            if forget.on_disabled_hover_text("Nothing is remembered").clicked() {
                let remembers = shared.preferences.remembers_files;
                actions.push(Action::prefer(move |p| p.forget_files(remembers)));
                ui.close();
            }
            let mut forgets = !shared.preferences.remembers_files;
            let tip = "Paths may hold names: with this on, none is kept, and unsaved work is dropped when the window is closed";
            if ui.checkbox(&mut forgets, "Do not remember what is opened").on_hover_text(tip).changed() {
                actions.push(Action::prefer(move |p| p.forget_files(!forgets)));
            }
    });
}
