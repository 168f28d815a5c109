//! The offer to restore work that was left unsaved.

use crate::viewer::{
    action::Action,
    command::Command,
    panels::widgets::{dialog, main_button},
    shared::Shared,
    state::session::Session,
    theme,
};
use egui::{Context, RichText};

/// Offers at the start to restore work that was left unsaved.
pub(crate) fn recovery_ui(ctx: &Context, shared: &Shared, actions: &mut Vec<Action>) {
    if !shared.preferences.is_acknowledged {
        return;
    }
    let Some(left) = shared.saving.autosave.left.first().filter(|_| !shared.saving.is_recovery_put_off)
    else {
        return;
    };
    let what = summary(&left.session);
    let file = left.session.opened.display().to_string();
    let (answer, is_closed) = dialog(ctx, "recovery", 480.0, |ui| {
        ui.heading("Your last work was not saved");
        ui.label(what);
        ui.label(RichText::new(file).font(theme::small()).color(theme::TEXT_WEAK));
        ui.add_space(10.0);
        ui.horizontal(|ui| {
            let restore = ui.add(main_button("Restore")).clicked();
            let later = ui.button("Ask again next time").clicked();
            let tip = format!(
                "Forget it for good. What is restored can be saved: {}",
                shared.tooltip(Command::SaveSession)
            );
            let discard = ui.button("Discard").on_hover_text(tip).clicked();
            (restore, later, discard)
        })
        .inner
    });
    match answer {
        (true, ..) => actions.push(Action::Restore),
        (_, _, true) => actions.push(Action::Discard),
        (_, is_later, _) if is_later || is_closed => actions.push(Action::RestoreLater),
        _ => {}
    }
}

/// Summarises a session, e.g. "clip: 2 prompts, 1 bookmark, at frame 8".
fn summary(session: &Session) -> String {
    let count = |n: usize, what: &str| format!("{n} {what}{}", if n == 1 { "" } else { "s" });
    let content = &session.content;
    format!(
        "{}: {}, {}, at frame {}",
        session.name(),
        count(content.prompts.len(), "prompt"),
        count(content.bookmarks.len(), "bookmark"),
        session.time.frame + 1
    )
}
