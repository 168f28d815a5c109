//! The user's decisions. Every change of the [`Content`], and every return to the endoscope's view, is a
//! named edit that can be undone.

use crate::viewer::state::{
    content::{Content, Look, NamedSample, PREVIEW, Prompt, PromptId, hundredths},
    history::History,
    measure::Scale,
    view_mode::ViewMode,
};
use crate::{engine::Sample, settings::prompt_colour};
use serde_json::Map;
use surgtpgs_core::{
    mask::CleanUp,
    overlay::{OverlayLook, OverlayStyle},
    sequence::{is_same_name, names_instrument, plain_words},
};

/// Change of the threshold by a threshold key.
pub(crate) const THRESHOLD_STEP: f32 = 0.01;
/// Number of colours among which one is looked for that no prompt has.
const MAX_COLOURS: usize = 256;
/// Increase of the opacity by the opacity key.
pub(crate) const OPACITY_STEP: f32 = 0.2;

/// Kind of change. Successive changes of the same kind are joined into one edit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Joint {
    Threshold(PromptId),
    ButNot(PromptId),
    Note(usize),
    Phase(usize),
    CleanUp,
}

/// Content before an edit, and the look if the edit changed it.
#[derive(Clone, Debug)]
struct Snapshot {
    content: Content,
    look: Option<Look>,
}

/// The user's decisions with their history.
#[derive(Clone, Debug)]
pub(crate) struct Document {
    content: Content,
    next_id: PromptId,
    /// The prompt that the threshold keys act on.
    pub(crate) selected: Option<PromptId>,
    /// Style of the overlay.
    pub(crate) overlay: OverlayLook,
    /// `true` if everything drawn over the picture is hidden.
    pub(crate) is_hidden: bool,
    pub(crate) mode: ViewMode,
    pub(crate) look: Look,
    default_threshold: f32,
    history: History<Snapshot, Joint>,
    /// Counter that grows with every change of the content.
    revision: u64,
}

impl Document {
    pub(crate) fn new(overlay: OverlayLook, default_threshold: f32) -> Self {
        Self {
            content: Content::default(),
            next_id: PREVIEW + 1,
            selected: None,
            overlay,
            is_hidden: false,
            mode: ViewMode::default(),
            look: Look::default(),
            default_threshold,
            history: History::default(),
            revision: 0,
        }
    }

    pub(crate) fn content(&self) -> &Content {
        &self.content
    }

    pub(crate) fn prompts(&self) -> &[Prompt] {
        &self.content.prompts
    }

    pub(crate) fn prompt(&self, id: PromptId) -> Option<&Prompt> {
        self.prompts().iter().find(|p| p.id == id)
    }

    pub(crate) fn default_threshold(&self) -> f32 {
        self.default_threshold
    }

    pub(crate) fn revision(&self) -> u64 {
        self.revision
    }

    /// Replaces the content by a saved one. There is nothing to undo afterwards.
    pub(crate) fn load(&mut self, content: Content, num_frames: usize) {
        self.content = content.mended(num_frames);
        for prompt in &mut self.content.prompts {
            prompt.id = self.next_id;
            self.next_id += 1;
        }
        self.selected = self.content.prompts.first().map(|p| p.id);
        self.history = History::default();
        self.revision += 1;
    }

    /// Prepares for another recording, with a clean-up of its masks: all decisions belong to the previous one.
    pub(crate) fn start_recording(&mut self, clean_up: CleanUp) {
        self.content = Content { clean_up, ..Content::default() };
        self.selected = None;
        self.history = History::default();
        self.revision += 1;
    }

    /// Adds a prompt and selects it. If there is a prompt of this name, it is selected and shown instead.
    /// Empty words do nothing.
    pub(crate) fn add(&mut self, text: &str) {
        self.add_prompt(text, None);
    }

    /// Adds a prompt that looks for a sample of a picture.
    pub(crate) fn add_like(&mut self, NamedSample { name, sample }: NamedSample) {
        self.add_prompt(&name, Some(sample));
    }

    /// Adds a sample of a picture to what a prompt does not mean.
    pub(crate) fn add_not_like(&mut self, id: PromptId, not_like: NamedSample) {
        let Some(prompt) = self.prompt(id).filter(|p| !p.not_like.contains(&not_like)) else { return };
        let name = format!("what \"{}\" is not", prompt.text);
        self.edit_prompt(name, None, id, |p| p.not_like.push(not_like));
    }

    pub(crate) fn remove_not_like(&mut self, id: PromptId, index: usize) {
        let Some(prompt) = self.prompt(id).filter(|p| index < p.not_like.len()) else { return };
        let name = format!("what \"{}\" is not", prompt.text);
        self.edit_prompt(name, None, id, |p| drop(p.not_like.remove(index)));
    }

    fn add_prompt(&mut self, text: &str, like: Option<Sample>) {
        let text = text.trim();
        if text.is_empty() {
            return;
        }
        if let Some(index) = self.index_of(text) {
            self.selected = Some(self.prompts()[index].id);
            if !self.prompts()[index].is_visible {
                self.toggle_visible(index);
            }
            return;
        }
        let prompt = self.new_prompt(text, like);
        self.selected = Some(prompt.id);
        self.edit(format!("adding \"{text}\""), None, |content| content.prompts.push(prompt));
    }

    /// Makes a prompt with a new id.
    pub(super) fn new_prompt(&mut self, text: &str, like: Option<Sample>) -> Prompt {
        let id = self.next_id;
        self.next_id += 1;
        Prompt {
            id,
            text: text.to_owned(),
            colour: self.next_colour(),
            is_visible: true,
            is_instrument: names_instrument(text),
            threshold: self.default_threshold,
            but_not: Vec::new(),
            like,
            shows_nearest: false,
            not_like: Vec::new(),
            unknown: Map::new(),
        }
    }

    /// Deletes a prompt, and the marks of its name.
    pub(crate) fn remove(&mut self, id: PromptId) {
        let Some(prompt) = self.prompt(id) else { return };
        let marks = self.marks().kept(|mark| !prompt.is_marked_as(&mark.name));
        let with = if marks == *self.marks() { "" } else { " and its marks" };
        let name = format!("deleting \"{}\"{with}", prompt.text);
        self.edit(name, None, |content| {
            content.prompts.retain(|p| p.id != id);
            content.marks = marks;
        });
        self.mend_selection();
    }

    /// Returns another prompt that has these words already.
    pub(crate) fn namesake(&self, id: PromptId, text: &str) -> Option<&Prompt> {
        self.prompts().iter().find(|p| p.id != id && is_same_name(&p.text, text))
    }

    /// Gives a prompt other words, and its marks their name; refuses empty words and those of another prompt.
    pub(crate) fn rename(&mut self, id: PromptId, text: &str) {
        let text = text.trim();
        let Some(prompt) = self.prompt(id).filter(|p| p.text != text && !text.is_empty()) else { return };
        if self.namesake(id, text).is_some() {
            return;
        }
        let name = format!("changing \"{}\" to \"{text}\"", prompt.text);
        let marks = match prompt.like {
            None => self.marks().renamed(&plain_words(&prompt.text), &plain_words(text)),
            Some(_) => self.marks().clone(),
        };
        self.edit(name, None, |content| {
            content.prompts.iter_mut().filter(|p| p.id == id).for_each(|p| p.text = text.to_owned());
            content.marks = marks;
        });
    }

    /// Moves a prompt up (−1) or down (+1) in the list, which is also the order of drawing.
    pub(crate) fn reorder(&mut self, id: PromptId, by: isize) {
        let Some(from) = self.prompts().iter().position(|p| p.id == id) else { return };
        let to = from.saturating_add_signed(by).min(self.prompts().len() - 1);
        if from != to {
            let name = format!("moving \"{}\"", self.prompts()[from].text);
            self.edit(name, None, |content| {
                let prompt = content.prompts.remove(from);
                content.prompts.insert(to, prompt);
            });
        }
    }

    pub(crate) fn set_colour(&mut self, id: PromptId, colour: [u8; 3]) {
        let Some(prompt) = self.prompt(id).filter(|p| p.colour != colour) else { return };
        let name = format!("colour of \"{}\"", prompt.text);
        self.edit_prompt(name, None, id, |p| p.colour = colour);
    }

    /// Sets the phrases that a prompt is compared with, besides those for all prompts.
    pub(crate) fn set_but_not(&mut self, id: PromptId, but_not: &[String]) {
        let Some(prompt) = self.prompt(id).filter(|p| p.but_not != but_not) else { return };
        let name = format!("what \"{}\" is not", prompt.text);
        self.edit_prompt(name, Some(Joint::ButNot(id)), id, |p| p.but_not = but_not.to_vec());
    }

    /// Sets whether a prompt is about an instrument.
    pub(crate) fn set_instrument(&mut self, id: PromptId, is_instrument: bool) {
        let Some(prompt) = self.prompt(id).filter(|p| p.is_instrument != is_instrument) else { return };
        let kind = if is_instrument { "an instrument" } else { "no instrument" };
        let name = format!("\"{}\" is {kind}", prompt.text);
        self.edit_prompt(name, None, id, |p| p.is_instrument = is_instrument);
    }

    /// Sets whether the class that is most like a prompt is drawn in its stead.
    pub(crate) fn set_shows_nearest(&mut self, id: PromptId, shows_nearest: bool) {
        let Some(prompt) = self.prompt(id).filter(|p| p.shows_nearest != shows_nearest) else { return };
        let what = if shows_nearest { "showing" } else { "hiding" };
        let name = format!("{what} what is like \"{}\"", prompt.text);
        self.edit_prompt(name, None, id, |p| p.shows_nearest = shows_nearest);
    }

    /// Sets the clean-up of masks.
    pub(crate) fn set_clean_up(&mut self, clean_up: CleanUp) {
        if self.content.clean_up != clean_up {
            let name = if clean_up.is_off() { "masks as they are" } else { "cleaning up masks" };
            self.edit(name.into(), Some(Joint::CleanUp), |content| content.clean_up = clean_up);
        }
    }

    /// Shows or hides prompt number `index` (from 0).
    pub(crate) fn toggle_visible(&mut self, index: usize) {
        let Some(prompt) = self.prompts().get(index) else { return };
        let name = format!("{} \"{}\"", if prompt.is_visible { "hiding" } else { "showing" }, prompt.text);
        self.edit(name, None, |content| content.prompts[index].is_visible ^= true);
    }

    /// Shows prompt number `index` alone; if it is alone already, shows all.
    pub(crate) fn solo(&mut self, index: usize) {
        let Some(prompt) = self.prompts().get(index) else { return };
        let is_alone = self.prompts().iter().enumerate().all(|(i, p)| p.is_visible == (i == index));
        let name = if is_alone { "showing all".to_owned() } else { format!("only \"{}\"", prompt.text) };
        self.edit(name, None, |content| {
            content.prompts.iter_mut().enumerate().for_each(|(i, p)| p.is_visible = is_alone || i == index);
        });
    }

    /// Sets a threshold, rounded to whole hundredths.
    pub(crate) fn set_threshold(&mut self, id: PromptId, threshold: f32) {
        let threshold = hundredths(threshold);
        let Some(prompt) = self.prompt(id).filter(|p| p.threshold != threshold) else { return };
        let name = format!("threshold of \"{}\"", prompt.text);
        self.edit_prompt(name, Some(Joint::Threshold(id)), id, |p| p.threshold = threshold);
    }

    /// Moves the threshold of the selected prompt.
    pub(crate) fn nudge_threshold(&mut self, by: f32) {
        if let Some(prompt) = self.selected.and_then(|id| self.prompt(id)) {
            self.set_threshold(prompt.id, prompt.threshold + by);
        }
    }

    /// Sets the part that plays; `None` is the whole recording.
    pub(crate) fn set_range(&mut self, range: Option<(usize, usize)>) {
        if self.content.range != range {
            let name = match range {
                Some((from, to)) => format!("playing frames {} to {}", from + 1, to + 1),
                None => "playing the whole recording".into(),
            };
            self.edit(name, None, |content| content.range = range);
        }
    }

    pub(crate) fn set_scale(&mut self, scale: Option<Scale>) {
        let name = if scale.is_some() { "setting the scale" } else { "removing the scale" };
        self.edit(name.into(), None, |content| content.scale = scale);
    }

    /// Returns to the endoscope's own view, without zoom.
    pub(crate) fn reset_look(&mut self) {
        if self.look != Look::default() {
            let (content, look) = (&self.content, self.look);
            let before = || Snapshot { content: content.clone(), look: Some(look) };
            self.history.record("returning to the endoscope".into(), None, before);
            self.look = Look::default();
        }
    }

    pub(crate) fn next_style(&mut self) {
        self.overlay.style = self.overlay.style.next();
    }

    /// Makes the overlay more opaque by one step; the least opaque step follows the most opaque one.
    pub(crate) fn next_opacity(&mut self) {
        let OverlayLook { style, opacity, heat_opacity, outline_opacity, .. } = &mut self.overlay;
        let opacity = match style {
            OverlayStyle::Outline => outline_opacity,
            OverlayStyle::Fill => opacity,
            OverlayStyle::Heatmap => heat_opacity,
        };
        let next = *opacity + OPACITY_STEP;
        *opacity = if next > 1.01 { OPACITY_STEP } else { next.min(1.0) };
    }

    /// Returns the colour for the next prompt: the first that no prompt has.
    pub(crate) fn next_colour(&self) -> [u8; 3] {
        self.free_colour(&[])
    }

    /// Returns the colour for the next prompt, if `more` are added before it.
    pub(super) fn free_colour(&self, more: &[Prompt]) -> [u8; 3] {
        let is_free = |colour: &[u8; 3]| !self.prompts().iter().chain(more).any(|p| p.colour == *colour);
        (0..MAX_COLOURS).map(prompt_colour).find(is_free).unwrap_or_else(|| prompt_colour(0))
    }

    /// Returns the name of the edit that undo would take back.
    pub(crate) fn undo_name(&self) -> Option<&str> {
        self.history.undo_name()
    }

    /// Returns the name of the edit that redo would repeat.
    pub(crate) fn redo_name(&self) -> Option<&str> {
        self.history.redo_name()
    }

    pub(crate) fn undo(&mut self) {
        let (content, look) = (&mut self.content, &mut self.look);
        self.history.undo(|there| there.exchange(content, look));
        self.after_exchange();
    }

    pub(crate) fn redo(&mut self) {
        let (content, look) = (&mut self.content, &mut self.look);
        self.history.redo(|there| there.exchange(content, look));
        self.after_exchange();
    }

    /// Ends a series of joined changes: the next one is an edit of its own.
    pub(crate) fn end_gesture(&mut self) {
        self.history.end_gesture();
    }

    /// Changes the content by a named edit.
    pub(crate) fn edit(&mut self, name: String, joins: Option<Joint>, change: impl FnOnce(&mut Content)) {
        let content = &self.content;
        self.history.record(name, joins, || Snapshot { content: content.clone(), look: None });
        change(&mut self.content);
        self.revision += 1;
    }

    fn edit_prompt(
        &mut self,
        name: String,
        joins: Option<Joint>,
        id: PromptId,
        change: impl FnOnce(&mut Prompt),
    ) {
        self.edit(name, joins, |content| {
            if let Some(prompt) = content.prompts.iter_mut().find(|p| p.id == id) {
                change(prompt);
            }
        });
    }

    fn index_of(&self, text: &str) -> Option<usize> {
        self.prompts().iter().position(|p| is_same_name(&p.text, text))
    }

    fn after_exchange(&mut self) {
        self.revision += 1;
        self.mend_selection();
    }

    fn mend_selection(&mut self) {
        if self.selected.and_then(|id| self.prompt(id)).is_none() {
            self.selected = self.prompts().last().map(|p| p.id);
        }
    }
}

impl Snapshot {
    /// Swaps the snapshot with the present state.
    fn exchange(&mut self, content: &mut Content, look: &mut Look) {
        std::mem::swap(&mut self.content, content);
        if let Some(own) = &mut self.look {
            std::mem::swap(own, look);
        }
    }
}
