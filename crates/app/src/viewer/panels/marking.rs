//! Controls of the tool for marking, in the side panel while it is in use.

use crate::viewer::{
    action::Action,
    command::{Command, entry},
    panels::widgets::{add_unless, caption, choice, focus_selecting},
    shared::Shared,
    state::{
        excluded::EXCLUDED,
        marking::{RADII_PX, Tool},
    },
    text::counted,
    theme,
};
use egui::{Align, Button, Frame, Id, Layout, Margin, RichText, Slider, Stroke, TextEdit, Ui, vec2};
use surgtpgs_core::{marks::Mark, sequence::is_same_name};

/// Message while marks wait.
pub(crate) const WAITS: &str = "Marked; waits for the reconstruction";
/// Value of a prompt in the picture while its marks wait.
pub(crate) const FOUND_WHEN_READY: &str = "found when the reconstruction is ready";
/// Number of names that are offered.
const MAX_NAMES: usize = 14;

/// Shows a button that takes the tool in hand.
pub(crate) fn mark_button_ui(ui: &mut Ui, shared: &Shared, actions: &mut Vec<Action>) {
    let is_on = shared.viewport.marking.is_on;
    let button = Button::selectable(is_on, RichText::new(entry(Command::Mark).label).font(theme::small()));
    let response = ui.add(button.frame_when_inactive(true));
    if response.on_hover_text(shared.tooltip(Command::Mark)).clicked() {
        actions.push(Action::Run(Command::Mark));
    }
}

/// Shows the controls, if the tool is in use.
pub(crate) fn marking_ui(ui: &mut Ui, shared: &Shared, actions: &mut Vec<Action>) {
    if !shared.viewport.marking.is_on {
        if shared.has_waiting_marks() {
            waits_ui(ui, shared);
        }
        return;
    }
    let frame = Frame::new().fill(theme::RAISED).corner_radius(8).inner_margin(Margin::symmetric(10, 8));
    let shown = frame.stroke(Stroke::new(1.0, theme::ACCENT)).show(ui, |ui| {
        ui.set_width(ui.available_width());
        name_ui(ui, shared, actions);
        tool_ui(ui, shared, actions);
        state_ui(ui, shared, actions);
    });
    let marking = &shared.viewport.marking;
    if marking.is_just_taken {
        actions.push(Action::marking(|m| m.is_just_taken = false));
    }
    if marking.is_just_taken || marking.wants_name {
        // If there is no room for all of it, its upper part with the name is shown.
        let is_high = shown.response.rect.height() > ui.clip_rect().height();
        shown.response.scroll_to_me(is_high.then_some(Align::Min));
    }
    ui.add_space(6.0);
}

/// Shows the field of the name, and names to choose from.
fn name_ui(ui: &mut Ui, shared: &Shared, actions: &mut Vec<Action>) {
    let marking = &shared.viewport.marking;
    let mut name = marking.name.clone();
    let row = ui.horizontal(|ui| {
        let right_to_left = Layout::right_to_left(Align::Center);
        ui.with_layout(right_to_left, |ui| {
            if ui.button("Done").on_hover_text(shared.tooltip(Command::Mark)).clicked() {
                actions.push(Action::Run(Command::Mark));
            }
            // An id of its own: the field keeps the focus when something appears above it.
            let field = TextEdit::singleline(&mut name).id(Id::unique("name of what is marked"));
            let field = field.hint_text("What do you mark?").char_limit(200);
            ui.add(field.margin(Margin::symmetric(8, 6)).desired_width(f32::INFINITY))
        })
        .inner
    });
    let response = row.inner;
    response.ctx.accesskit_node_builder(response.id, |node| node.set_label("Name of what is marked"));
    if marking.wants_name {
        focus_selecting(&response, 0..name.chars().count());
        actions.push(Action::marking(|m| m.wants_name = false));
    }
    if name != marking.name {
        actions.push(Action::marking(move |m| m.name = name));
    }
    if marking.plain_name().is_empty() {
        ui.label(RichText::new("Give it a name first.").font(theme::small()).color(theme::AMBER));
    }
    ui.horizontal_wrapped(|ui| {
        ui.spacing_mut().item_spacing = vec2(4.0, 4.0);
        for known in shared.known_names().into_iter().take(MAX_NAMES) {
            let is_own = is_same_name(&known, &marking.name);
            let button = Button::selectable(is_own, RichText::new(&known).font(theme::small())).truncate();
            let response = ui.add(button.frame_when_inactive(true));
            if response.on_hover_text(format!("Mark {known}")).clicked() {
                actions.push(Action::marking(move |m| m.name = known));
            }
        }
    });
}

/// Shows the choice of tools.
fn tool_ui(ui: &mut Ui, shared: &Shared, actions: &mut Vec<Action>) {
    let marking = &shared.viewport.marking;
    let mut tool = marking.tool;
    let options = Tool::ALL.map(|tool| (tool, tool.label().0, tool.label().1.to_owned(), true));
    choice(ui, &mut tool, &options);
    if tool != marking.tool {
        actions.push(Action::marking(move |m| (m.tool, m.draft) = (tool, None)));
    }
    side_ui(ui, shared, actions);
}

/// Shows the choice between what it is and what it is not, and the radius.
fn side_ui(ui: &mut Ui, shared: &Shared, actions: &mut Vec<Action>) {
    let marking = &shared.viewport.marking;
    let mut adds = marking.adds;
    let this = "What you draw on belongs to the structure. Hold Shift to draw on what does not";
    let not_this = "What you draw on does not belong to the structure. It takes back one mark of the structure \
                    below it: where several overlap, draw as often. Hold Shift to draw on what does";
    let options = [(true, "This", this.to_owned(), true), (false, "Not this", not_this.to_owned(), true)];
    choice(ui, &mut adds, &options);
    if adds != marking.adds {
        actions.push(Action::marking(move |m| (m.adds, m.draft) = (adds, None)));
    }
    if marking.tool.has_radius() {
        // A number stands behind the slider.
        ui.spacing_mut().slider_width = (ui.available_width() - 80.0).clamp(30.0, 150.0);
        let mut radius = marking.radius_px;
        let slider = Slider::new(&mut radius, RADII_PX[0]..=RADII_PX[1]).logarithmic(true);
        let response = ui.add(slider.fixed_decimals(0).suffix(" px"));
        response.ctx.accesskit_node_builder(response.id, |node| node.set_label("Radius of the brush"));
        response.on_hover_text("Radius of the brush and of clicks, pixels of the recording");
        if radius != marking.radius_px {
            actions.push(Action::marking(move |m| m.radius_px = radius));
        }
    }
    if marking.tool.points() {
        borders_ui(ui, shared, actions);
    }
}

/// Shows the choice of a network that makes a mask of what is clicked on or boxed.
fn borders_ui(ui: &mut Ui, shared: &Shared, actions: &mut Vec<Action>) {
    let folder = &shared.preferences.models.masks;
    let is_chosen = !folder.as_os_str().is_empty();
    let mut wanted = shared.preferences.finds_borders && is_chosen;
    ui.horizontal_wrapped(|ui| {
        let tip = "A Segment Anything makes a mask of the object that you click on or draw a box around";
        if ui.checkbox(&mut wanted, "Find the borders").on_hover_text(tip).changed() {
            actions.push(match is_chosen {
                true => Action::prefer(move |p| p.finds_borders = wanted),
                false => Action::ChooseMasksModel,
            });
        }
        if wanted {
            let tip = format!("{}: choose another Segment Anything", folder.display());
            let button = Button::new(RichText::new("Network…").font(theme::small()));
            if ui.add(button).on_hover_text(tip).clicked() {
                actions.push(Action::ChooseMasksModel);
            }
        }
    });
    let count = shared.pointing.count();
    if wanted && !shared.finds_borders() {
        let text = "The recorded frames are not at hand: borders cannot be found in them.";
        ui.label(RichText::new(text).font(theme::small()).color(theme::AMBER));
    } else if count > 0 {
        ui.label(caption(format!("Finding the borders of {}…", counted(count, "mark", "marks"))));
    }
}

/// Shows what is marked, and what can be done with it.
fn state_ui(ui: &mut Ui, shared: &Shared, actions: &mut Vec<Action>) {
    let marks = shared.document.marks();
    let frame = shared.picture().map_or(0, |p| p.request.view.frame);
    if shared.picture().is_some_and(|p| !p.request.view.orbit.is_home()) {
        let text =
            shared.with_keys("Marks are made on the endoscope's own view: go back", Command::ResetView);
        ui.label(RichText::new(text).font(theme::small()).color(theme::AMBER));
    }
    let (here, all) = (marks.on(frame).count(), marks.all().len());
    if shared.is_left_out() {
        let text = format!("{EXCLUDED}, and cannot be marked.");
        ui.label(RichText::new(text).font(theme::small()).color(theme::AMBER));
    } else {
        let how = shared.viewport.marking.tool.label().1;
        ui.label(caption(format!("{how}. Marks on this frame: {here}, in all: {all}.")));
    }
    if shared.has_waiting_marks() {
        waits_ui(ui, shared);
    } else if here > 0 && shared.info().is_some_and(|info| info.is_unlearned(frame)) {
        let text = "This frame is not reconstructed yet: its marks wait until it is.";
        ui.label(RichText::new(text).font(theme::small()).color(theme::AMBER));
    } else if let Some(name) = lacking_opposite(shared) {
        let text = format!(
            "Now show what \"{name}\" is not: draw with \"Not this\", or mark what lies beside it by another name."
        );
        ui.label(RichText::new(text).font(theme::small()).color(theme::AMBER));
    }
    ui.horizontal_wrapped(|ui| {
        ui.spacing_mut().item_spacing = vec2(4.0, 4.0);
        let clear = Button::new(RichText::new("Clear this frame").font(theme::small()));
        let tip = "Take all marks of this frame away (undo brings them back)";
        let obstacle = (here == 0).then_some("Nothing is marked on this frame");
        if add_unless(ui, obstacle, clear, tip).clicked() {
            actions.push(Action::edit(move |d| d.clear_marks(frame)));
        }
        let look = Button::new(RichText::new(entry(Command::LookHere).label).font(theme::small()));
        let tip = shared.tooltip(Command::LookHere);
        if add_unless(ui, shared.obstacle(Command::LookHere), look, tip).clicked() {
            actions.push(Action::Run(Command::LookHere));
        }
    });
    if shared.areas().is_some_and(|areas| areas.look_here_on(frame).is_some()) {
        ui.label(caption("The ring is around what is least sure on this frame."));
    }
}

/// Share of the picture from which on a structure probably takes what is not of it.
const LARGE: f32 = 0.25;

/// Returns a marked name that has no class and of which nothing says what it is not, if it is alone, or found
/// nearly everywhere beside one other; first of all that of the tool. Three names tell each other apart.
fn lacking_opposite(shared: &Shared) -> Option<&str> {
    let (marks, tool) = (shared.document.marks(), shared.viewport.marking.plain_name());
    let classes = shared.info().map(|i| i.example_prompts.as_slice()).unwrap_or_default();
    let is_new = |name: &&str| !classes.iter().any(|class| is_same_name(class, name));
    let mut new: Vec<&str> = marks.names().into_iter().filter(is_new).collect();
    new.sort_by_key(|name| !is_same_name(name, &tool));
    let is_large = |name: &str| {
        let prompt = shared.document.prompts().iter().find(|p| p.is_marked_as(name));
        let finding = prompt.and_then(|p| shared.finding(p.id, &p.text));
        finding.and_then(|f| f.outcome.as_ref().ok()).is_some_and(|found| found.area_fraction > LARGE)
    };
    // An outline says by itself what lies outside.
    let is_open = |name: &str| {
        let own: Vec<&Mark> = marks.all().iter().filter(|mark| mark.name == name).collect();
        own.iter().all(|mark| mark.add) && own.iter().any(|mark| !mark.shape.is_outlined())
    };
    let lacks = |name: &&str| is_open(name) && (new.len() == 1 || is_large(name));
    new.iter().copied().filter(|_| new.len() <= 2).find(lacks)
}

/// Says that marks wait for a reconstruction.
fn waits_ui(ui: &mut Ui, shared: &Shared) {
    let made_before = shared.info().is_some_and(|info| info.made_before.is_some());
    let text = if shared.is_to_be_reconstructed() {
        "What you marked is found on every frame as soon as the reconstruction is ready."
    } else if made_before {
        "What you marked is found on every frame once you open the reconstruction."
    } else {
        "What you marked is found on every frame once this recording is reconstructed: press Reconstruct."
    };
    ui.label(RichText::new(text).font(theme::small()).color(theme::AMBER));
    ui.add_space(4.0);
}
