//! What the user decided: prompts and how they are drawn. Prompt edits can be undone by name.

use super::command::OPACITY_STEP;
use crate::settings::PROMPT_COLOURS;
use surgtpgs_core::overlay::OverlayStyle;

/// Names a prompt for its lifetime.
pub(crate) type PromptId = u64;

/// The prompt that is being typed and not yet added.
pub(crate) const PREVIEW: PromptId = 0;

/// Something to look for.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Prompt {
    pub(crate) id: PromptId,
    pub(crate) text: String,
    /// Kept for the prompt's lifetime: deleting another one does not recolour it.
    pub(crate) colour: [u8; 3],
    pub(crate) is_visible: bool,
    /// Score above which a pixel is found.
    pub(crate) threshold: f32,
}

/// What the viewport shows.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) enum ViewMode {
    /// The frame as it was recorded.
    Original,
    /// The frame as it was reconstructed.
    #[default]
    Reconstruction,
    /// Both beside each other.
    SideBySide,
    /// Both with a line between them.
    Wipe,
    /// Distance from the endoscope.
    Depth,
}

impl ViewMode {
    pub(crate) const ALL: [Self; 5] =
        [Self::Original, Self::Reconstruction, Self::SideBySide, Self::Wipe, Self::Depth];

    pub(crate) fn label(self) -> &'static str {
        match self {
            Self::Original => "Recorded",
            Self::Reconstruction => "Reconstruction",
            Self::SideBySide => "Side by side",
            Self::Wipe => "Wipe",
            Self::Depth => "Depth",
        }
    }

    pub(crate) fn needs_original(self) -> bool {
        matches!(self, Self::Original | Self::SideBySide | Self::Wipe)
    }

    pub(crate) fn needs_reconstruction(self) -> bool {
        self != Self::Original
    }
}

/// Prompts and overlay, with the history of the prompts.
#[derive(Clone, Debug)]
pub(crate) struct Document {
    prompts: Vec<Prompt>,
    next_id: PromptId,
    /// The prompt that the threshold keys act on.
    pub(crate) selected: Option<PromptId>,
    pub(crate) style: OverlayStyle,
    /// Of fills and heatmaps, 0–1.
    pub(crate) opacity: f32,
    /// Everything drawn over the picture is off.
    pub(crate) is_hidden: bool,
    pub(crate) mode: ViewMode,
    default_threshold: f32,
    past: Vec<Edit>,
    future: Vec<Edit>,
}

/// The prompts before a named change.
#[derive(Clone, Debug)]
struct Edit {
    name: String,
    prompts: Vec<Prompt>,
    /// Changes of the same thing in a row (a slider being dragged) are one edit.
    joins: Option<PromptId>,
}

/// Edits that are kept.
const MAX_EDITS: usize = 200;

impl Document {
    pub(crate) fn new(style: OverlayStyle, opacity: f32, default_threshold: f32) -> Self {
        Self {
            prompts: Vec::new(),
            next_id: PREVIEW + 1,
            selected: None,
            style,
            opacity,
            is_hidden: false,
            mode: ViewMode::default(),
            default_threshold,
            past: Vec::new(),
            future: Vec::new(),
        }
    }

    pub(crate) fn prompts(&self) -> &[Prompt] {
        &self.prompts
    }

    pub(crate) fn default_threshold(&self) -> f32 {
        self.default_threshold
    }

    /// Adds a prompt and selects it; words that are there already are selected and shown instead. Empty words do nothing.
    pub(crate) fn add(&mut self, text: &str) {
        let text = text.trim();
        if text.is_empty() {
            return;
        }
        if let Some(index) = self.prompts.iter().position(|p| p.text.eq_ignore_ascii_case(text)) {
            self.selected = Some(self.prompts[index].id);
            if !self.prompts[index].is_visible {
                self.toggle_visible(index);
            }
            return;
        }
        let prompt = Prompt {
            id: self.next_id,
            text: text.to_owned(),
            colour: self.next_colour(),
            is_visible: true,
            threshold: self.default_threshold,
        };
        self.next_id += 1;
        self.selected = Some(prompt.id);
        self.edit(format!("adding \"{text}\""), None, |prompts| prompts.push(prompt));
    }

    pub(crate) fn remove(&mut self, id: PromptId) {
        let Some(prompt) = self.prompts.iter().find(|p| p.id == id) else { return };
        self.edit(format!("deleting \"{}\"", prompt.text), None, |prompts| prompts.retain(|p| p.id != id));
        self.mend_selection();
    }

    /// Shows or hides prompt number `index` (from 0).
    pub(crate) fn toggle_visible(&mut self, index: usize) {
        let Some(prompt) = self.prompts.get(index) else { return };
        let name = format!("{} \"{}\"", if prompt.is_visible { "hiding" } else { "showing" }, prompt.text);
        self.edit(name, None, |prompts| prompts[index].is_visible ^= true);
    }

    /// Shows prompt number `index` alone; if it is alone already, shows all.
    pub(crate) fn solo(&mut self, index: usize) {
        let Some(prompt) = self.prompts.get(index) else { return };
        let is_alone = self.prompts.iter().enumerate().all(|(i, p)| p.is_visible == (i == index));
        let name = if is_alone { "showing all".to_owned() } else { format!("only \"{}\"", prompt.text) };
        self.edit(name, None, |prompts| {
            prompts.iter_mut().enumerate().for_each(|(i, p)| p.is_visible = is_alone || i == index);
        });
    }

    pub(crate) fn set_threshold(&mut self, id: PromptId, threshold: f32) {
        let threshold = threshold.clamp(0.0, 1.0);
        let Some(prompt) = self.prompts.iter().find(|p| p.id == id && p.threshold != threshold) else {
            return;
        };
        self.edit(format!("threshold of \"{}\"", prompt.text), Some(id), |prompts| {
            prompts.iter_mut().filter(|p| p.id == id).for_each(|p| p.threshold = threshold);
        });
    }

    /// Moves the threshold of the selected prompt, in whole hundredths.
    pub(crate) fn nudge_threshold(&mut self, by: f32) {
        let Some(prompt) = self.prompts.iter().find(|p| Some(p.id) == self.selected) else { return };
        self.set_threshold(prompt.id, ((prompt.threshold + by) * 100.0).round() / 100.0);
    }

    pub(crate) fn next_style(&mut self) {
        self.style = match self.style {
            OverlayStyle::Outline => OverlayStyle::Fill,
            OverlayStyle::Fill => OverlayStyle::Heatmap,
            OverlayStyle::Heatmap => OverlayStyle::Outline,
        };
    }

    /// More opaque by a step; after the most opaque comes the least.
    pub(crate) fn next_opacity(&mut self) {
        let next = self.opacity + OPACITY_STEP;
        self.opacity = if next > 1.01 { OPACITY_STEP } else { next.min(1.0) };
    }

    /// The colour that the next prompt will get: the first of the palette that is not in use.
    pub(crate) fn next_colour(&self) -> [u8; 3] {
        let uses = |c: &[u8; 3]| self.prompts.iter().filter(|p| p.colour == *c).count();
        PROMPT_COLOURS.into_iter().min_by_key(uses).unwrap_or([255; 3])
    }

    /// What undo would undo.
    pub(crate) fn undo_name(&self) -> Option<&str> {
        self.past.last().map(|e| e.name.as_str())
    }

    /// What redo would do again.
    pub(crate) fn redo_name(&self) -> Option<&str> {
        self.future.last().map(|e| e.name.as_str())
    }

    pub(crate) fn undo(&mut self) {
        if let Some(edit) = self.past.pop() {
            let prompts = std::mem::replace(&mut self.prompts, edit.prompts);
            self.future.push(Edit { prompts, joins: None, ..edit });
            self.mend_selection();
        }
    }

    pub(crate) fn redo(&mut self) {
        if let Some(edit) = self.future.pop() {
            let prompts = std::mem::replace(&mut self.prompts, edit.prompts);
            self.past.push(Edit { prompts, joins: None, ..edit });
            self.mend_selection();
        }
    }

    /// Ends a series of joined changes: the next one is an edit of its own.
    pub(crate) fn end_gesture(&mut self) {
        if let Some(edit) = self.past.last_mut() {
            edit.joins = None;
        }
    }

    fn edit(&mut self, name: String, joins: Option<PromptId>, change: impl FnOnce(&mut Vec<Prompt>)) {
        let is_joined = joins.is_some() && self.past.last().is_some_and(|e| e.joins == joins);
        if !is_joined {
            self.past.push(Edit { name, prompts: self.prompts.clone(), joins });
            let excess = self.past.len().saturating_sub(MAX_EDITS);
            self.past.drain(..excess);
        }
        self.future.clear();
        change(&mut self.prompts);
    }

    fn mend_selection(&mut self) {
        if !self.prompts.iter().any(|p| Some(p.id) == self.selected) {
            self.selected = self.prompts.last().map(|p| p.id);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn document(prompts: &[&str]) -> Document {
        let mut document = Document::new(OverlayStyle::Outline, 0.5, 0.4);
        prompts.iter().for_each(|p| document.add(p));
        document
    }

    #[test]
    fn the_same_words_are_added_once_and_empty_ones_never() {
        let mut document = document(&["gallbladder", "  ", " Gallbladder "]);
        assert_eq!(document.prompts().len(), 1);
        document.toggle_visible(0);
        document.add("gallbladder");
        assert!(document.prompts()[0].is_visible);
    }

    #[test]
    fn deleting_recolours_nobody_and_frees_the_colour() {
        let mut document = document(&["liver", "fat", "grasper"]);
        let colours: Vec<_> = document.prompts().iter().map(|p| p.colour).collect();
        assert!(colours[0] != colours[1] && colours[1] != colours[2] && colours[0] != colours[2]);
        document.remove(document.prompts()[1].id);
        assert_eq!([document.prompts()[0].colour, document.prompts()[1].colour], [colours[0], colours[2]]);
        assert_eq!(document.next_colour(), colours[1]);
    }

    #[test]
    fn undo_of_everything_and_redo_of_everything_are_identities() {
        let mut document = document(&["liver", "fat"]);
        document.solo(0);
        document.nudge_threshold(0.01);
        document.remove(document.prompts()[0].id);
        let end = document.prompts().to_vec();
        let mut steps = 0;
        while document.undo_name().is_some() {
            document.undo();
            steps += 1;
        }
        assert_eq!((steps, document.prompts().len()), (5, 0));
        assert_eq!(document.redo_name(), Some("adding \"liver\""));
        (0..steps).for_each(|_| document.redo());
        assert_eq!(document.prompts(), end);
        assert_eq!(document.redo_name(), None);
    }

    #[test]
    fn dragging_a_threshold_is_one_edit_until_the_mouse_is_let_go() {
        let mut document = document(&["liver"]);
        let id = document.prompts()[0].id;
        document.set_threshold(id, 0.5);
        document.set_threshold(id, 0.6);
        document.end_gesture();
        document.set_threshold(id, 7.0);
        assert_eq!(document.prompts()[0].threshold, 1.0);
        document.undo();
        assert_eq!(document.prompts()[0].threshold, 0.6);
        document.undo();
        assert_eq!(document.prompts()[0].threshold, 0.4);
    }

    #[test]
    fn solo_again_shows_all() {
        let mut document = document(&["liver", "fat", "grasper"]);
        document.solo(1);
        assert_eq!(document.prompts().iter().map(|p| p.is_visible).collect::<Vec<_>>(), [false, true, false]);
        document.solo(1);
        assert!(document.prompts().iter().all(|p| p.is_visible));
    }
}
