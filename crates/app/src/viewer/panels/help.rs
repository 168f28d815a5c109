//! Sheets over the window: keys, about, and the limits of the intended use.

use crate::viewer::{
    action::Action,
    command::{COMMANDS, Command, Entry, Group, entry, keys},
    panels::widgets::{dialog, main_button},
    shared::{Dialog, Shared},
    theme,
};
use egui::{Context, Event, Grid, KeyboardShortcut, Modifiers, RichText, ScrollArea, Ui};
use surgtpgs_core::about::intended_use;

/// Notice below the intended use, shown before the first use and in About.
pub(crate) const NOTICE: &str = "SurgTPGS is not a medical device and has not been approved for clinical use. What it \
highlights may be wrong or incomplete: a similarity score says how close a pixel is to your words, not how likely it \
is to be right. The user is responsible for how it is used.";

const PRIVACY: &str = "Everything happens on this computer. The program has no network access, sends nothing anywhere \
and keeps no statistics. It remembers which files were opened last (File, Recently opened: there it can be told \
to forget them) and work that was not saved.";

/// The sheets over the window.
#[derive(Default)]
pub(crate) struct Sheets {
    /// Command whose key is being chosen on the shortcut sheet.
    choosing_key: Option<Command>,
}

impl Sheets {
    /// Shows the open sheet. Before the first use, shows the notice instead.
    pub(crate) fn ui(&mut self, ctx: &Context, shared: &Shared, actions: &mut Vec<Action>) {
        if !shared.preferences.is_acknowledged {
            notice_ui(ctx, actions);
            return;
        }
        let (is_shortcuts, width) = match shared.dialog {
            Some(Dialog::Shortcuts) => (true, 800.0),
            Some(Dialog::About) => (false, 500.0),
            _ => {
                self.choosing_key = None;
                return;
            }
        };
        let (is_done, is_closed) = dialog(ctx, "sheet", width, |ui| {
            if is_shortcuts {
                shortcuts_ui(ui, &mut self.choosing_key, shared, actions);
            } else {
                about_ui(ui);
            }
            ui.add_space(10.0);
            ui.add(main_button("Close")).clicked()
        });
        let is_choosing = self.choosing_key.is_some();
        self.take_chosen_key(ctx, actions);
        if is_closed {
            self.choosing_key = None;
        }
        if is_done || (is_closed && !is_choosing) {
            actions.push(Action::CloseDialog);
        }
    }

    /// Gives the next pressed key to the command whose key is being chosen.
    fn take_chosen_key(&mut self, ctx: &Context, actions: &mut Vec<Action>) {
        let Some(command) = self.choosing_key else { return };
        let pressed = ctx.input(|i| {
            i.events.iter().find_map(|event| match event {
                Event::Key { key, pressed: true, modifiers, .. } => Some((*key, *modifiers)),
                _ => None,
            })
        });
        let Some((key, Modifiers { command: ctrl, alt, shift, .. })) = pressed else { return };
        let modifiers = Modifiers { alt, shift, command: ctrl, ..Modifiers::NONE };
        let key = KeyboardShortcut::new(modifiers, key);
        if keys::can_be_chosen(key) {
            actions.push(Action::ChooseKey(command, Some(key)));
        }
        self.choosing_key = None;
    }
}

fn notice_ui(ctx: &Context, actions: &mut Vec<Action>) {
    dialog(ctx, "notice", 500.0, |ui| {
        ui.heading("For research use only");
        ui.add_space(4.0);
        ui.label(RichText::new(intended_use()).color(theme::AMBER));
        ui.label(NOTICE);
        ui.add_space(10.0);
        if ui.add(main_button("I understand")).clicked() {
            actions.push(Action::prefer(|p| p.is_acknowledged = true));
        }
    });
}

/// Shows the shortcut sheet, which lists the command table.
fn shortcuts_ui(ui: &mut Ui, choosing: &mut Option<Command>, shared: &Shared, actions: &mut Vec<Action>) {
    ui.horizontal_wrapped(|ui| {
        ui.heading("Keyboard shortcuts");
        let has_own = !shared.preferences.keys.is_empty();
        if ui.add_enabled(has_own, egui::Button::new("Usual keys again")).clicked() {
            actions.push(Action::prefer(|p| p.keys.clear()));
        }
    });
    let text = match *choosing {
        Some(command) => format!("Press the new key for \"{}\". Esc leaves it as it is.", label(entry(command))),
        None => "Click on a key to choose another one, for a foot pedal for example. A key that was another command's is taken \
                 from it."
            .into(),
    };
    let colour = if choosing.is_some() { theme::AMBER } else { theme::TEXT_WEAK };
    ui.label(RichText::new(text).font(theme::small()).color(colour));
    let height = (ui.ctx().content_rect().height() - 270.0).max(120.0);
    // Full height from the start, or the sheet would grow under the pointer.
    let area = ScrollArea::vertical().max_height(height).min_scrolled_height(height);
    area.show(ui, |ui| {
        ui.spacing_mut().interact_size.y = 18.0;
        let num_columns = if ui.available_width() < 700.0 { 1 } else { 2 };
        ui.columns(num_columns, |columns| {
            for group in Group::ALL {
                let is_second = !matches!(group, Group::File | Group::Edit | Group::Time);
                let column = usize::from(is_second).min(num_columns - 1);
                group_ui(&mut columns[column], choosing, shared, actions, group);
            }
            mouse_ui(&mut columns[num_columns - 1]);
        });
    });
}

fn label(entry: &Entry) -> &'static str {
    entry.label.trim_end_matches('…')
}

fn group_ui(
    ui: &mut Ui,
    choosing: &mut Option<Command>,
    shared: &Shared,
    actions: &mut Vec<Action>,
    group: Group,
) {
    ui.add_space(6.0);
    ui.label(RichText::new(group.title()).strong().color(theme::ACCENT));
    Grid::new(group.title()).num_columns(2).spacing([14.0, 3.0]).min_col_width(96.0).show(ui, |ui| {
        for entry in COMMANDS.iter().filter(|e| e.group == group && !e.keys.is_empty()) {
            key_ui(ui, choosing, shared, actions, entry);
            ui.label(label(entry)).on_hover_text(entry.tooltip);
            ui.end_row();
        }
    });
}

/// Shows the keys of a command as a button that chooses another key.
fn key_ui(
    ui: &mut Ui,
    choosing: &mut Option<Command>,
    shared: &Shared,
    actions: &mut Vec<Action>,
    entry: &'static Entry,
) {
    let is_chosen = keys::is_chosen(entry.command, &shared.preferences.keys);
    let keys = shared.keys_text(entry.command);
    let text = match (*choosing == Some(entry.command), keys.is_empty()) {
        (true, _) => "press a key".to_owned(),
        (false, true) => "none".to_owned(),
        (false, false) => keys,
    };
    let colour = if is_chosen { theme::ACCENT } else { theme::TEXT };
    let text = RichText::new(text).monospace().color(colour);
    if entry.keys.len() > 2 || entry.command == Command::Dismiss {
        ui.label(text);
        return;
    }
    let button = ui.add(egui::Button::new(text).frame(false));
    let name = format!("Key of {}", label(entry));
    button.widget_info(|| egui::WidgetInfo::labeled(egui::Role::Button, true, &name));
    let tip =
        if is_chosen { "Choose another key; right-click for the usual one" } else { "Choose another key" };
    let button = button.on_hover_text(tip);
    if button.clicked() {
        *choosing = Some(entry.command);
    }
    if button.secondary_clicked() {
        actions.push(Action::ChooseKey(entry.command, None));
    }
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
