//! The offer to restore work that was left unsaved.

use crate::viewer::{
    action::Action,
    command::Command,
    panels::widgets::{dialog, main_button},
    shared::{DEMO, Shared},
    state::{autosave::Left, content::Content, session::Session},
    text::counted,
    theme,
};
use egui::{Context, Frame, Margin, RichText, Ui};

/// Shows work that was left unsaved on the start page, each with the offer to restore it.
pub(crate) fn left_ui(ui: &mut Ui, shared: &Shared, actions: &mut Vec<Action>) {
    let left = &shared.saving.autosave.left;
    if left.is_empty() {
        return;
    }
    let frame = Frame::new().fill(theme::RAISED).corner_radius(8).inner_margin(Margin::same(12));
    frame.show(ui, |ui| {
        ui.set_width(ui.available_width());
        ui.label(RichText::new("Your last work was not saved").strong().color(theme::AMBER));
        for left in left {
            let opened = &left.session.opened;
            ui.label(summary(shared, &left.session));
            ui.horizontal_wrapped(|ui| {
                if ui.add(main_button("Restore")).on_hover_text(opened.display().to_string()).clicked() {
                    actions.push(Action::Restore(left.id));
                }
                if ui.button("Discard").on_hover_text("Forget it for good").clicked() {
                    actions.push(Action::Discard(left.id));
                }
            });
        }
    });
    ui.add_space(12.0);
}

/// Offers to restore unsaved work on what is open.
pub(crate) fn recovery_ui(ctx: &Context, shared: &Shared, actions: &mut Vec<Action>) {
    if !shared.preferences.is_acknowledged || shared.open.is_none() {
        return;
    }
    let saving = &shared.saving;
    let is_wanted = !saving.is_recovery_put_off && saving.to_apply.is_none();
    let is_here = |left: &&Left| !saving.for_later.contains(&left.id) && shared.is_about_open(&left.session);
    let Some(left) = saving.autosave.left.iter().find(is_here).filter(|_| is_wanted) else { return };
    let what = summary(shared, &left.session);
    let file = left.session.opened.display().to_string();
    let is_of_other_frames = shared.info().is_some_and(|info| left.session.is_of_other_frames(info));
    let (answer, is_closed) = dialog(ctx, "recovery", 480.0, |ui| {
        ui.heading("Your last work was not saved");
        ui.label(what);
        ui.label(RichText::new(file).font(theme::small()).color(theme::TEXT_WEAK));
        if is_of_other_frames {
            let note = "The recording had other frames then: marks and bookmarks may not fit it any more.";
            ui.label(RichText::new(note).font(theme::small()).color(theme::AMBER));
        }
        ui.add_space(10.0);
        ui.horizontal_wrapped(|ui| {
            let restore = ui.add(main_button("Restore")).clicked();
            let later = ui.button("Ask again next time").clicked();
            let tip = "Forget it for good. To keep it, restore it and save the session";
            let tip = shared.with_keys(tip, Command::SaveSession);
            let discard = ui.button("Discard").on_hover_text(tip).clicked();
            (restore, later, discard)
        })
        .inner
    });
    match answer {
        (true, ..) => actions.push(Action::Restore(left.id)),
        (_, _, true) => actions.push(Action::Discard(left.id)),
        (_, is_later, _) if is_later || is_closed => actions.push(Action::RestoreLater(left.id)),
        _ => {}
    }
}

/// Summarises a session, e.g. "clip: 2 prompts, 1 bookmark, at frame 8".
fn summary(shared: &Shared, session: &Session) -> String {
    let name = if shared.is_demo(&session.opened) { DEMO.to_owned() } else { session.name() };
    format!("{name}: {}, at frame {}", decided(&session.content), session.time.frame + 1)
}

/// Counts what was decided, without what there is none of.
fn decided(content: &Content) -> String {
    let kinds = [
        (content.prompts.len(), "prompt", "prompts"),
        (content.bookmarks.len(), "bookmark", "bookmarks"),
        (content.phases.len(), "phase", "phases"),
        (content.marks.all().len(), "mark", "marks"),
        (content.excluded.len(), "part left out", "parts left out"),
    ];
    let some = kinds.into_iter().filter(|(n, ..)| *n > 0);
    let counts: Vec<String> = some.map(|(n, one, many)| counted(n, one, many)).collect();
    if counts.is_empty() { "settings of the view".to_owned() } else { counts.join(", ") }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::viewer::state::{content::Bookmark, phases::Phase};

    #[test]
    fn everything_that_was_decided_is_counted() {
        let content = Content {
            bookmarks: vec![Bookmark::default()],
            phases: vec![Phase::new("Preparation", 0, 4), Phase::new("Clipping", 5, 9)],
            excluded: vec![(2, 3)],
            ..Content::default()
        };
        assert_eq!(decided(&content), "1 bookmark, 2 phases, 1 part left out");
        let range = Content { range: Some((2, 9)), ..Content::default() };
        assert_eq!(decided(&range), "settings of the view");
    }
}
