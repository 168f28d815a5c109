//! The list of bookmarks, with notes and flags.

use crate::settings::PROMPT_COLOURS;
use crate::viewer::{
    action::Action,
    command::Command,
    panels::widgets::{Icon, caption, colour_button, dialog, icon_button, main_button},
    shared::{Dialog, Shared},
    state::content::Bookmark,
    text::timecode,
    theme,
};
use egui::{Context, Popup, RichText, ScrollArea, TextEdit, Ui};

/// Shows the list, if it is open.
pub(crate) fn bookmarks_ui(ctx: &Context, shared: &Shared, actions: &mut Vec<Action>) {
    if shared.dialog != Some(Dialog::Bookmarks) {
        return;
    }
    let (is_done, is_closed) = dialog(ctx, "bookmarks", 620.0, |ui| {
        ui.heading("Bookmarks");
        let key = shared.keys_text(Command::Bookmark);
        if shared.document.bookmarks().is_empty() {
            ui.label(
                RichText::new(format!("None yet. {key} marks the frame that is shown."))
                    .color(theme::TEXT_WEAK),
            );
        } else {
            ui.label(caption(format!("{key} marks a frame. Notes are saved with the session.")));
        }
        ScrollArea::vertical().max_height(380.0).show(ui, |ui| rows_ui(ui, shared, actions));
        ui.add_space(10.0);
        ui.add(main_button("Close")).clicked()
    });
    if is_done || is_closed {
        actions.push(Action::CloseDialog);
        actions.push(Action::edit(move |d| d.end_gesture()));
    }
}

fn rows_ui(ui: &mut Ui, shared: &Shared, actions: &mut Vec<Action>) {
    for bookmark in shared.document.bookmarks().to_vec() {
        let (frame, number) = (bookmark.frame, bookmark.frame + 1);
        ui.horizontal(|ui| {
            let time = timecode(shared.playback.seconds(frame));
            let go = ui.add_sized(
                [190.0, theme::CONTROL_HEIGHT],
                egui::Button::new(format!("Frame {number}  ·  {time}")),
            );
            if go.on_hover_text("Go to this frame").clicked() {
                actions.push(Action::GoTo(frame));
                actions.push(Action::CloseDialog);
            }
            let name = format!("Flag frame {number}");
            let tip = "Needs another look";
            if icon_button(ui, Icon::Flag, &name, tip, bookmark.is_flagged, true).clicked() {
                actions.push(Action::edit(move |d| d.toggle_flag(frame)));
            }
            colour_ui(ui, &bookmark, actions);
            let mut note = bookmark.note.clone();
            let width = ui.available_width() - theme::CONTROL_HEIGHT - 16.0;
            let field = ui.add(TextEdit::singleline(&mut note).hint_text("Note").desired_width(width));
            field
                .ctx
                .accesskit_node_builder(field.id, |node| node.set_label(format!("Note on frame {number}")));
            if field.changed() {
                actions.push(Action::edit(move |d| d.set_note(frame, &note)));
            }
            if field.lost_focus() {
                actions.push(Action::edit(move |d| d.end_gesture()));
            }
            let name = format!("Delete the bookmark at frame {number}");
            if icon_button(ui, Icon::Cross, &name, "Delete this bookmark (undo brings it back)", false, true)
                .clicked()
            {
                actions.push(Action::edit(move |d| d.toggle_bookmark(frame)));
            }
        });
    }
}

/// Shows the colour of a bookmark, as a button that offers others.
fn colour_ui(ui: &mut Ui, bookmark: &Bookmark, actions: &mut Vec<Action>) {
    let frame = bookmark.frame;
    let shown = |colour: Option<[u8; 3]>| colour.map_or(theme::TEXT, theme::colour32);
    let name = format!("Colour of the bookmark at frame {}", frame + 1);
    let button = colour_button(ui, shown(bookmark.colour), false, &name);
    Popup::menu(&button.on_hover_text("Colour on the time bar")).show(|ui| {
        ui.horizontal(|ui| {
            let colours = std::iter::once(None).chain(PROMPT_COLOURS.into_iter().map(Some));
            for (number, colour) in colours.enumerate() {
                let is_own = bookmark.colour == colour;
                if colour_button(ui, shown(colour), is_own, &format!("Colour {number}")).clicked() {
                    actions.push(Action::edit(move |d| d.set_bookmark_colour(frame, colour)));
                }
            }
        });
    });
}
