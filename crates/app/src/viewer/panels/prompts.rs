//! The panel of prompts: the prompt box, one row per prompt, and the style of the overlay.

use crate::engine::{Absence, Answer};
use crate::viewer::{
    action::Action,
    command::Command,
    panels::{
        clean_up::clean_up_ui,
        exporting::exporting_ui,
        import_check,
        marking::{self, WAITS},
        prompt_menu::PromptMenu,
        suggestions::suggestions_ui,
        threshold::{TIE, threshold_ui},
        training,
        widgets::{Icon, add_unless, caption, choice, command_button, icon_button, palette_ui, swatch},
    },
    picture::{found::Found, request::Finding},
    shared::Shared,
    state::content::{PREVIEW, Prompt},
    text::{percent, sentence},
    theme,
};
use egui::{Frame, Key, Margin, Response, RichText, ScrollArea, Sense, Stroke, TextEdit, Ui, vec2};
use surgtpgs_core::{overlay::OverlayStyle, sequence::is_same_name};

/// Message of a prompt that is known to the recording but not found on the frame.
pub(crate) const NOTHING: &str = "Not on this frame";
/// Message of all prompts on a frame that is left out.
const LEFT_OUT: &str = "Left out";
/// Message of a prompt that has no answer yet.
pub(crate) const ENCODING: &str = "Looking for it…";
/// Message where prompts cannot be asked.
pub(crate) const NO_FEATURES: &str = "This recording has no text features";

/// Height of the panel below its prompt box, points, under which what was found goes before the buttons.
const LOW: f32 = 200.0;

/// The right-hand panel.
#[derive(Default)]
pub(crate) struct Prompts {
    menu: PromptMenu,
}

impl Prompts {
    /// Shows the panel. The prompt box stays in place, everything else can be scrolled.
    pub(crate) fn ui(&mut self, ui: &mut Ui, shared: &Shared, actions: &mut Vec<Action>) {
        box_ui(ui, shared, actions);
        ui.add_space(4.0);
        let is_low = ui.available_height() < LOW;
        ScrollArea::vertical().auto_shrink(false).show(ui, |ui| {
            // The scroll bar covers nothing.
            ui.set_width(ui.available_width() - 10.0);
            if !is_low {
                ways_ui(ui, shared, actions);
            }
            exporting_ui(ui, shared, actions);
            marking::marking_ui(ui, shared, actions);
            training::training_ui(ui, shared, actions);
            import_check::import_check_ui(ui, shared, actions);
            if shared.can_ask() {
                preview_ui(ui, shared);
            } else {
                unanswered_ui(ui, shared);
            }
            rows_ui(ui, &mut self.menu, shared, actions);
            if is_low {
                ways_ui(ui, shared, actions);
            }
            if shared.can_ask() {
                overlay_ui(ui, shared, actions);
            }
        });
    }
}

/// Shows other ways to say what to find, and what words are compared with.
fn ways_ui(ui: &mut Ui, shared: &Shared, actions: &mut Vec<Action>) {
    ui.horizontal_wrapped(|ui| {
        marking::mark_button_ui(ui, shared, actions);
        // The first mark makes words possible, and must not move the tool under the hand.
        if shared.can_ask() && !shared.viewport.marking.is_on {
            suggestions_ui(ui, shared, actions);
            let button = ui.button(RichText::new("Compared with…").font(theme::small()));
            if button.on_hover_text(shared.tooltip(Command::Negatives)).clicked() {
                actions.push(Action::Run(Command::Negatives));
            }
        }
    });
    ui.add_space(4.0);
}

fn box_ui(ui: &mut Ui, shared: &Shared, actions: &mut Vec<Action>) {
    let prompt_box = &shared.prompt_box;
    let mut text = prompt_box.text.clone();
    let field = TextEdit::singleline(&mut text)
        .id_salt("prompt box")
        .hint_text("Type what to find, e.g. gallbladder")
        .char_limit(200)
        // Enter adds the prompt, and the next one can be typed at once.
        .return_key(None)
        .margin(Margin::symmetric(10, 8))
        .desired_width(f32::INFINITY);
    let (obstacle, tip) = (shared.obstacle(Command::FocusPrompt), shared.tooltip(Command::FocusPrompt));
    let response = add_unless(ui, obstacle, field, tip);
    response.ctx.accesskit_node_builder(response.id, |node| node.set_label("Prompt"));
    if prompt_box.wants_focus {
        response.request_focus();
    }
    // The key that goes to the box, pressed in it.
    if let Some(words) = text.strip_prefix('/') {
        text = words.to_owned();
    }
    let is_focused = response.has_focus();
    if is_focused && ui.input(|i| i.key_pressed(Key::Enter)) {
        actions.push(Action::AddPrompt(std::mem::take(&mut text)));
    }
    if text != prompt_box.text || is_focused != prompt_box.is_focused || prompt_box.wants_focus {
        actions.push(Action::Type { text, is_focused });
    }
}

/// Shows the result of the words being typed, before Enter adds them.
fn preview_ui(ui: &mut Ui, shared: &Shared) {
    let live = shared.prompt_box.live();
    let is_added = shared.document.prompts().iter().any(|p| is_same_name(&p.text, live));
    if live.is_empty() || is_added {
        return;
    }
    let state = match shared.is_left_out() {
        true => (LEFT_OUT.to_owned(), theme::TEXT_WEAK),
        false => {
            let threshold = shared.document.default_threshold();
            state_text(shared.finding(PREVIEW, live), threshold, nothing_here(shared))
        }
    };
    ui.horizontal_wrapped(|ui| {
        let (rect, _) = ui.allocate_exact_size(vec2(14.0, 14.0), Sense::hover());
        swatch(ui.painter(), rect, shared.document.next_colour(), "");
        let text = format!("{} – Enter keeps it", state.0);
        ui.label(RichText::new(text).font(theme::small()).color(state.1));
    });
}

/// Says in a row why words have no answer yet, or will have none.
fn unanswered_text(shared: &Shared) -> String {
    match shared.will_find_words() {
        Some(true) => "Waits for the reconstruction".into(),
        None if shared.awaits_reconstruction() => "Looked for once this recording is reconstructed".into(),
        _ => sentence(Absence::NeedsMark.words()),
    }
}

/// Says how words come to be found, where they are not yet.
fn unanswered_ui(ui: &mut Ui, shared: &Shared) {
    let Some(info) = shared.info() else { return };
    if info.has_reconstruction {
        ui.label(RichText::new(NO_FEATURES).color(theme::AMBER));
    }
    let has_marks = !shared.document.marks().is_empty();
    let will_find_none = shared.will_find_words() == Some(false);
    let advice = match (info.has_reconstruction, info.has_labels) {
        _ if will_find_none && has_marks => {
            "It is being reconstructed without labels and networks: only what is marked will be found in it."
        }
        _ if will_find_none => {
            "It is being reconstructed without labels and networks: no words will be found in it."
        }
        (false, true) if shared.is_reconstructing() => {
            "Words are found in it as soon as the first preview is there."
        }
        (false, true) => "Words are found in it once it is reconstructed.",
        (_, false) => {
            "It has no class labels. Reconstruct it with networks that find regions and tell what they show: \
             then words can be found in it."
        }
        (true, true) => {
            "It was reconstructed without its class labels. Reconstruct it again to find words in it."
        }
    };
    ui.label(caption(advice));
    if !has_marks {
        let how = if will_find_none { "Mark" } else { "Or mark" };
        let hint = "a structure by hand on one frame: it is then found on all of them.";
        ui.label(caption(format!("{how} {hint}")));
    }
    ui.add_space(6.0);
}

fn rows_ui(ui: &mut Ui, menu: &mut PromptMenu, shared: &Shared, actions: &mut Vec<Action>) {
    if shared.document.prompts().is_empty() && shared.takes_prompts() {
        examples_ui(ui, shared, actions);
    }
    let prompts = shared.document.prompts();
    let mut menu_buttons = Vec::with_capacity(prompts.len());
    for (index, prompt) in prompts.iter().enumerate() {
        menu_buttons.push(row_ui(ui, shared, actions, index, prompt));
        ui.add_space(2.0);
    }
    menu.ui(ui, shared, actions, &menu_buttons);
}

/// Shows a few words that this recording knows, as long as there is no prompt.
fn examples_ui(ui: &mut Ui, shared: &Shared, actions: &mut Vec<Action>) {
    let examples =
        shared.info().map(|i| &i.example_prompts[..i.example_prompts.len().min(6)]).unwrap_or_default();
    if examples.is_empty() {
        return;
    }
    ui.label(caption("For example"));
    ui.horizontal_wrapped(|ui| {
        for example in examples {
            if ui.button(example).clicked() {
                actions.push(Action::AddPrompt(example.clone()));
            }
        }
    });
}

/// Shows the result of a prompt and its controls. Returns the button that opens its menu.
fn row_ui(
    ui: &mut Ui,
    shared: &Shared,
    actions: &mut Vec<Action>,
    index: usize,
    prompt: &Prompt,
) -> Response {
    let is_selected = shared.document.selected == Some(prompt.id);
    let line = if is_selected { theme::ACCENT } else { theme::LINE };
    let frame = Frame::new().fill(theme::RAISED).corner_radius(8).inner_margin(Margin::symmetric(10, 6));
    let row = frame.stroke(Stroke::new(1.0, line)).show(ui, |ui| {
        ui.set_width(ui.available_width());
        let menu_button = head_ui(ui, shared, actions, index, prompt);
        let is_left_out = shared.is_left_out();
        let finding = shared.finding(prompt.id, &prompt.text).filter(|_| !is_left_out);
        let (text, colour) = if !prompt.is_visible {
            ("Hidden".to_owned(), theme::TEXT_WEAK)
        } else if is_left_out && shared.can_ask() {
            (LEFT_OUT.to_owned(), theme::TEXT_WEAK)
        } else if shared.waits_as_marked(prompt) {
            (WAITS.to_owned(), theme::TEXT_WEAK)
        } else if !shared.can_ask() {
            (unanswered_text(shared), theme::TEXT_WEAK)
        } else {
            state_text(finding, prompt.threshold, nothing_here(shared))
        };
        let why = finding.and_then(|f| f.answer.as_ref()).map_or("", |answer| &answer.why);
        let state = ui.label(RichText::new(text).font(theme::small()).color(colour));
        if !why.is_empty() {
            state.on_hover_text(format!("“{}”: {why}", prompt.text));
        }
        nearest_ui(ui, actions, prompt, finding);
        if is_selected && prompt.is_visible && (shared.can_ask() || !shared.awaits_reconstruction()) {
            let found = finding.and_then(|f| f.outcome.as_ref().ok());
            threshold_row_ui(ui, shared, actions, prompt, found);
        }
        menu_button
    });
    row.inner
}

/// Shows a switch that draws the class which is most like a prompt that means none.
fn nearest_ui(ui: &mut Ui, actions: &mut Vec<Action>, prompt: &Prompt, finding: Option<&Finding>) {
    let Some(answer) = finding.and_then(|f| f.answer.as_ref()) else { return };
    let Some(class) = &answer.nearest else { return };
    let mut shows = prompt.shows_nearest;
    let label = RichText::new(format!("Show {class}, dashed")).font(theme::small());
    let tip = format!(
        "“{}”: {}. This draws what is most like these words: {class}",
        prompt.text,
        answer.absence.words()
    );
    if ui.checkbox(&mut shows, label).on_hover_text(tip).changed() {
        let id = prompt.id;
        actions.push(Action::edit(move |d| d.set_shows_nearest(id, shows)));
    }
}

/// Shows the head of a row: number, words, eye, menu and delete. In a narrow panel the buttons have a line of
/// their own.
fn head_ui(
    ui: &mut Ui,
    shared: &Shared,
    actions: &mut Vec<Action>,
    index: usize,
    prompt: &Prompt,
) -> Response {
    const NARROW: f32 = 230.0;
    let words_ui = |ui: &mut Ui, actions: &mut Vec<Action>| {
        let words = egui::Label::new(RichText::new(&prompt.text).color(theme::TEXT));
        let words = ui.add(words.truncate().selectable(false).sense(Sense::click()));
        let tip =
            format!("{}\nSelect: its threshold is shown, and the keys T and Shift+T change it", prompt.text);
        if words.on_hover_text(tip).clicked() {
            let id = prompt.id;
            actions.push(Action::edit(move |d| d.selected = Some(id)));
        }
    };
    let is_narrow = ui.available_width() < NARROW;
    let right = egui::Layout::right_to_left(egui::Align::Center);
    let head = ui.horizontal(|ui| {
        let (rect, _) = ui.allocate_exact_size(vec2(22.0, 22.0), Sense::hover());
        swatch(ui.painter(), rect, prompt.colour, &(index + 1).to_string());
        if is_narrow {
            words_ui(ui, actions);
            return None;
        }
        let buttons = ui.with_layout(right, |ui| {
            let menu_button = buttons_ui(ui, shared, actions, index, prompt);
            let left = egui::Layout::left_to_right(egui::Align::Center);
            ui.with_layout(left, |ui| words_ui(ui, actions));
            menu_button
        });
        Some(buttons.inner)
    });
    let mut own_line = |ui: &mut Ui| {
        let line = vec2(ui.available_width(), theme::CONTROL_HEIGHT);
        ui.allocate_ui_with_layout(line, right, |ui| buttons_ui(ui, shared, actions, index, prompt)).inner
    };
    head.inner.unwrap_or_else(|| own_line(ui))
}

/// Shows the buttons of a row, from the right; returns the one that opens the prompt's menu.
fn buttons_ui(
    ui: &mut Ui,
    shared: &Shared,
    actions: &mut Vec<Action>,
    index: usize,
    prompt: &Prompt,
) -> Response {
    ui.spacing_mut().item_spacing.x = 2.0;
    let name = format!("Delete {}", prompt.text);
    let tip = "Delete this prompt (undo brings it back)";
    if icon_button(ui, Icon::Cross, &name, tip, false, true).clicked() {
        let id = prompt.id;
        actions.push(Action::edit(move |d| d.remove(id)));
    }
    let name = format!("More about {}", prompt.text);
    let menu_button = icon_button(ui, Icon::More, &name, "Other words, colour, order", false, true);
    let (icon, word) = if prompt.is_visible { (Icon::Eye, "Hide") } else { (Icon::EyeClosed, "Show") };
    let name = format!("{word} {}", prompt.text);
    if icon_button(ui, icon, &name, &shared.tooltip(Command::TogglePrompt), false, true).clicked() {
        actions.push(Action::edit(move |d| d.toggle_visible(index)));
    }
    menu_button
}

fn threshold_row_ui(
    ui: &mut Ui,
    shared: &Shared,
    actions: &mut Vec<Action>,
    prompt: &Prompt,
    found: Option<&Found>,
) {
    let mut threshold = prompt.threshold;
    let is_over = threshold_ui(ui, &prompt.text, &mut threshold, prompt.colour, found);
    if threshold != prompt.threshold {
        let id = prompt.id;
        actions.push(Action::edit(move |d| d.set_threshold(id, threshold)));
    }
    if is_over {
        actions.push(Action::edit(move |d| d.end_gesture()));
    }
    jumps_ui(ui, shared, actions, prompt);
    let text = format!("Similarity score above {threshold:.2} counts as found");
    ui.label(caption(text));
    if found.is_some_and(|f| f.max_score < TIE && f.area_px > 0) {
        let text = "No pixel here is closer to these words than to something else.";
        ui.label(RichText::new(text).font(theme::small()).color(theme::AMBER));
    }
}

/// Shows buttons to the first, largest and last appearance.
fn jumps_ui(ui: &mut Ui, shared: &Shared, actions: &mut Vec<Action>, prompt: &Prompt) {
    ui.horizontal_wrapped(|ui| {
        ui.spacing_mut().item_spacing.x = 3.0;
        for (label, command) in
            [("First", Command::FirstFound), ("Largest", Command::LargestFound), ("Last", Command::LastFound)]
        {
            let button = egui::Button::new(RichText::new(label).font(theme::small()));
            if add_unless(ui, shared.obstacle(command), button, shared.tooltip(command)).clicked() {
                actions.push(Action::Run(command));
            }
        }
    });
    // The line is there before the count, so that nothing moves when it comes.
    if prompt.is_visible && shared.can_ask() && shared.areas().is_some() {
        let text = match shared.selected_curve() {
            Some(curve) if curve.has_no_answer() => "It cannot be looked for".into(),
            Some(curve) if curve.is_complete() => {
                format!("Found on {} of {} frames", curve.num_found(), curve.num_frames())
            }
            _ => "Counting…".into(),
        };
        ui.label(caption(text));
    }
}

/// Says why a prompt that is known to the recording is not found on the frame on the screen.
pub(crate) fn nothing_here(shared: &Shared) -> &'static str {
    shared.not_reconstructed().unwrap_or(NOTHING)
}

/// Describes the result of a prompt in words, with a colour for their importance. `nothing` says why a prompt
/// that is known is not found.
fn state_text(finding: Option<&Finding>, threshold: f32, nothing: &str) -> (String, egui::Color32) {
    match finding.map(|f| &f.outcome) {
        None => (ENCODING.into(), theme::TEXT_WEAK),
        Some(Err(problem)) => (problem.clone(), theme::ERROR),
        Some(Ok(found)) if found.area_px == 0 => {
            let answer = finding.and_then(|f| f.answer.as_ref());
            let text = match answer.filter(|answer| !answer.may_be_found(threshold)) {
                None => nothing.to_owned(),
                Some(answer) => absent_text(answer, |class| format!("looks like {class}")),
            };
            (text, theme::AMBER)
        }
        Some(Ok(found)) => {
            let share = format!("{} of the picture", percent(found.area_fraction));
            let answer = finding.and_then(|f| f.answer.as_ref()).filter(|a| !a.may_be_found(threshold));
            match answer.filter(|answer| answer.nearest.is_some()) {
                Some(answer) => (absent_text(answer, |class| format!("{class} is {share}")), theme::AMBER),
                None => (share, theme::TEXT_WEAK),
            }
        }
    }
}

/// Says that nothing can be found, and what is told of the class that is most like the words.
fn absent_text(answer: &Answer, tell: impl Fn(&str) -> String) -> String {
    let absence = sentence(answer.absence.words());
    answer.nearest.as_ref().map_or_else(|| absence.clone(), |class| format!("{absence}; {}", tell(class)))
}

fn overlay_ui(ui: &mut Ui, shared: &Shared, actions: &mut Vec<Action>) {
    ui.separator();
    ui.horizontal(|ui| {
        ui.label(RichText::new("Overlay").strong());
        ui.with_layout(egui::Layout::right_to_left(egui::Align::Center), |ui| {
            let icon = if shared.document.is_hidden { Icon::EyeClosed } else { Icon::Eye };
            if command_button(ui, shared, icon, Command::HideOverlays, shared.document.is_hidden) {
                actions.push(Action::Run(Command::HideOverlays));
            }
            if shared.document.is_hidden {
                ui.label(RichText::new("hidden").font(theme::small()).color(theme::AMBER));
            }
        });
    });
    let mut look = shared.document.overlay;
    let next = shared.keys_text(Command::CycleStyle);
    let tip = |what: &str| format!("{what} ({next} for the next)");
    choice(
        ui,
        &mut look.style,
        &OverlayStyle::ALL.map(|style| (style, style.label().0, tip(style.label().1), true)),
    );
    // A slider has a number and a word behind it.
    ui.spacing_mut().slider_width = (ui.available_width() - 130.0).clamp(30.0, 150.0);
    let share = |ui: &mut Ui, value, least, what| {
        ui.add(egui::Slider::new(value, least..=1.0).fixed_decimals(2).text(what));
    };
    if look.style.shows_scores() {
        share(ui, &mut look.heat_opacity, 0.05, "opacity");
        palette_ui(ui, &mut look.palette);
    } else {
        if look.style.has_fill() {
            share(ui, &mut look.opacity, 0.05, "opacity");
        }
        share(ui, &mut look.outline_opacity, 0.1, "outline");
    }
    ui.horizontal_wrapped(|ui| {
        let tip = "What is found lies under the instruments, as far as the recording's masks, its labels or prompts about \
                   instruments say where they are";
        ui.checkbox(&mut look.below_instruments, "Below instruments").on_hover_text(tip);
        clean_up_ui(ui, shared, actions);
    });
    if look != shared.document.overlay {
        actions.push(Action::edit(move |d| d.overlay = look));
    }
}
