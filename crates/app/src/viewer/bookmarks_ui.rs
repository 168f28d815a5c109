//! The list of bookmarks, with notes and flags.

use super::{
    app::ViewerApp,
    command::{Command, keys_text},
    theme,
    widgets::{Icon, caption, dialog, icon_button, main_button, timecode},
};
use egui::{Context, RichText, ScrollArea, TextEdit, Ui};

/// Shows the list, if it is open.
pub(crate) fn bookmarks_ui(ctx: &Context, app: &mut ViewerApp) {
    if !app.shows_bookmarks {
        return;
    }
    let (is_done, is_closed) = dialog(ctx, "bookmarks", 620.0, |ui| {
        ui.heading("Bookmarks");
        let key = keys_text(super::command::entry(Command::Bookmark));
        if app.document.bookmarks().is_empty() {
            ui.label(
                RichText::new(format!("None yet. {key} marks the frame that is shown."))
                    .color(theme::TEXT_WEAK),
            );
        } else {
            ui.label(caption(format!("{key} marks a frame. Notes are saved with the session.")));
        }
        ScrollArea::vertical().max_height(380.0).show(ui, |ui| rows_ui(ui, app));
        ui.add_space(10.0);
        ui.add(main_button("Close")).clicked()
    });
    if is_done || is_closed {
        app.shows_bookmarks = false;
        app.document.end_gesture();
    }
}

fn rows_ui(ui: &mut Ui, app: &mut ViewerApp) {
    for bookmark in app.document.bookmarks().to_vec() {
        let (frame, number) = (bookmark.frame, bookmark.frame + 1);
        ui.horizontal(|ui| {
            let time = timecode(app.playback.seconds(frame));
            let go = ui.add_sized(
                [190.0, theme::CONTROL_HEIGHT],
                egui::Button::new(format!("Frame {number}  ·  {time}")),
            );
            if go.on_hover_text("Go to this frame").clicked() {
                let now = ui.input(|i| i.time);
                app.playback.pause();
                app.playback.seek(frame, now);
                app.shows_bookmarks = false;
            }
            let name = format!("Flag frame {number}");
            let tip = "Needs another look";
            if icon_button(ui, Icon::Flag, &name, tip, bookmark.is_flagged, true).clicked() {
                app.document.toggle_flag(frame);
            }
            let mut note = bookmark.note.clone();
            let width = ui.available_width() - theme::CONTROL_HEIGHT - 16.0;
            let field = ui.add(TextEdit::singleline(&mut note).hint_text("Note").desired_width(width));
            field
                .ctx
                .accesskit_node_builder(field.id, |node| node.set_label(format!("Note on frame {number}")));
            if field.changed() {
                app.document.set_note(frame, &note);
            }
            if field.lost_focus() {
                app.document.end_gesture();
            }
            let name = format!("Delete the bookmark at frame {number}");
            if icon_button(ui, Icon::Cross, &name, "Delete this bookmark (undo brings it back)", false, true)
                .clicked()
            {
                app.document.toggle_bookmark(frame);
            }
        });
    }
}
