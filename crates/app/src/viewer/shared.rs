//! State of the window that panels read and that commands and actions change.

use crate::viewer::{
    backend::{Backend, Info, ranges::joined},
    picture::{
        areas::{Areas, Curve, Measure},
        open::Open,
        request::{Finding, Picture},
    },
    remedy::statement,
    state::{
        autosave::Autosave,
        content::Prompt,
        document::Document,
        exporting::Exporting,
        marking::Marking,
        opening::Opening,
        playback::Playback,
        pointing::Pointing,
        preferences::Preferences,
        reconstruction::Reconstruction,
        saving::Saving,
        time_scale::Span,
        toast::{Back, SHOWN_SECS, Toast},
        zoom::Panes,
    },
    text::{done, sentence},
};
use std::{
    path::{Path, PathBuf},
    sync::Arc,
};
use surgtpgs_core::{Result, relevancy::RelevancySettings};

/// Name of the built-in demo.
pub(crate) const DEMO: &str = "Demo: a made-up recording";

/// State of the window. Panels draw it and hold only what concerns them alone, such as half-typed text.
pub(crate) struct Shared {
    pub(crate) backend: Arc<dyn Backend>,
    pub(crate) preferences: Preferences,
    pub(crate) document: Document,
    pub(crate) playback: Playback,
    pub(crate) prompt_box: PromptBox,
    pub(crate) viewport: Viewport,
    pub(crate) open: Option<Open>,
    pub(crate) opening: Opening,
    /// Marks that wait for the masks of what they point at.
    pub(crate) pointing: Pointing,
    pub(crate) reconstruction: Reconstruction,
    /// Export that is running, or has ended and was not looked at.
    pub(crate) exporting: Option<Exporting>,
    pub(crate) saving: Saving,
    pub(crate) dialog: Option<Dialog>,
    /// Latest problem, until it is dismissed.
    pub(crate) problem: Option<String>,
    /// Message about what has just happened.
    pub(crate) toast: Option<Toast>,
    /// Size of the window, in points of text at its normal size; `None` where it is not known.
    pub(crate) window_size: Option<[f32; 2]>,
}

/// State of the text field for prompts.
#[derive(Debug, Default)]
pub(crate) struct PromptBox {
    pub(crate) text: String,
    pub(crate) wants_focus: bool,
    pub(crate) is_focused: bool,
    /// Words of earlier prompts, newest first.
    pub(crate) earlier: Vec<String>,
}

impl PromptBox {
    /// Returns the words being typed, which are looked for before they are added.
    pub(crate) fn live(&self) -> &str {
        self.text.trim()
    }
}

/// State of the picture's surroundings.
#[derive(Debug)]
pub(crate) struct Viewport {
    /// Panes as last painted.
    pub(crate) panes: Panes,
    /// Position of the wipe's dividing line, as share of the width.
    pub(crate) wipe: f32,
    /// Point of the picture that is probed, as share of its width and height.
    pub(crate) probe: Option<[f32; 2]>,
    /// Part of the recording that the time bar shows.
    pub(crate) span: Span,
    /// The present frame when that part was chosen; another one is followed.
    pub(crate) span_frame: usize,
    /// `true` while the ruler is in use.
    pub(crate) has_ruler: bool,
    /// The tool that marks are made with.
    pub(crate) marking: Marking,
    /// `true` if the user moves time or view during this update.
    pub(crate) is_moving: bool,
}

impl Default for Viewport {
    fn default() -> Self {
        Self {
            panes: Panes::default(),
            wipe: 0.5,
            probe: None,
            span: None,
            span_frame: 0,
            has_ruler: false,
            marking: Marking::default(),
            is_moving: false,
        }
    }
}

/// The dialog over the window.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Dialog {
    Reconstruct,
    Export,
    Quality,
    GoToFrame,
    Bookmarks,
    Phases,
    /// Phrases that prompts are compared with.
    Comparison,
    Shortcuts,
    About,
}

impl Shared {
    pub(crate) fn new(backend: Arc<dyn Backend>, preferences: Preferences, autosave: Autosave) -> Self {
        let threshold = RelevancySettings::default().threshold;
        Self {
            backend,
            document: Document::new(preferences.overlay, threshold),
            preferences,
            playback: Playback::new(1, None),
            prompt_box: PromptBox::default(),
            viewport: Viewport::default(),
            open: None,
            opening: Opening::default(),
            pointing: Pointing::default(),
            reconstruction: Reconstruction::default(),
            exporting: None,
            saving: Saving::new(autosave),
            dialog: None,
            problem: None,
            toast: None,
            window_size: None,
        }
    }

    pub(crate) fn info(&self) -> Option<&Info> {
        self.open.as_ref().map(|open| &open.info)
    }

    /// Returns `true` if a path belongs to the built-in demo.
    pub(crate) fn is_demo(&self, path: &Path) -> bool {
        self.opening.demo_folder.as_ref().is_some_and(|folder| path.starts_with(folder))
    }

    /// Returns the name of what is open, as the window calls it.
    pub(crate) fn title(&self) -> String {
        match self.info() {
            Some(info) if self.is_demo(&info.path) => DEMO.into(),
            Some(info) => info.name.clone(),
            None => String::new(),
        }
    }

    /// Returns the name of a path in lists.
    pub(crate) fn path_name(&self, path: &Path) -> String {
        let name = path.file_name().map(|n| n.to_string_lossy().into_owned());
        if self.is_demo(path) { DEMO.into() } else { name.unwrap_or_else(|| path.display().to_string()) }
    }

    pub(crate) fn picture(&self) -> Option<&Picture> {
        self.open.as_ref()?.picture()
    }

    /// Returns `true` if the frame on the screen is left out: nothing of it is shown or told.
    pub(crate) fn is_left_out(&self) -> bool {
        self.picture().is_some_and(|p| self.document.is_excluded(p.request.view.frame))
    }

    /// Returns the paths that were opened last, each once. All of the built-in demo is one.
    pub(crate) fn recent(&self) -> Vec<&Path> {
        let mut recent: Vec<&Path> = Vec::new();
        for path in self.preferences.recent.iter().map(PathBuf::as_path) {
            let is_same = |other: &Path| other == path || (self.is_demo(other) && self.is_demo(path));
            if !recent.iter().any(|other| is_same(other)) {
                recent.push(path);
            }
        }
        recent
    }

    /// Returns what a prompt found in the shown picture; `None` until the prompt has been answered.
    pub(crate) fn finding(&self, id: u64, text: &str) -> Option<&Finding> {
        self.open.as_ref()?.finding(id, text)
    }

    /// Returns the areas of all prompts on every frame, as far as they have been counted.
    pub(crate) fn areas(&self) -> Option<&Areas> {
        self.open.as_ref()?.areas.as_ref()
    }

    /// Returns the area over time of the selected prompt.
    pub(crate) fn selected_curve(&self) -> Option<Curve> {
        self.curve(self.document.prompt(self.document.selected?)?)
    }

    /// Returns the area of a prompt over time, of frames that count; `None` before the first one was counted.
    fn curve(&self, prompt: &Prompt) -> Option<Curve> {
        let curve = self.areas()?.curve(&self.measure(prompt), prompt.threshold)?;
        Some(curve.without(&self.not_counted()))
    }

    /// Returns the ranges of frames that do not count: those that are left out, and those that no part of a
    /// long recording reconstructs.
    fn not_counted(&self) -> Vec<(usize, usize)> {
        let unlearned = self.info().map(|info| info.unlearned.as_slice()).unwrap_or_default();
        let ranges = unlearned.iter().map(|frames| (frames.start, frames.end.saturating_sub(1)));
        ranges.fold(self.document.excluded().to_vec(), joined)
    }

    /// Returns the measure that is counted for a prompt on every frame.
    pub(crate) fn measure(&self, prompt: &Prompt) -> Measure {
        let question = self.document.question(prompt);
        Measure::new(question, self.document.content().clean_up, prompt.threshold)
    }

    /// Returns the visible prompts with their numbers and curves. A curve is there before anything of it is
    /// counted: if it came later, the picture would move while the user points at it.
    pub(crate) fn curves(&self) -> Vec<(usize, Prompt, Curve)> {
        let Some(info) = self.info().filter(|_| self.can_ask() && self.areas().is_some()) else {
            return Vec::new();
        };
        let prompts = self.document.prompts().iter().enumerate().filter(|(_, p)| p.is_visible);
        let unknown = || Curve::new(vec![None; info.num_frames]).without(&self.not_counted());
        let curve = |p: &Prompt| self.curve(p).unwrap_or_else(unknown);
        prompts.map(|(index, p)| (index + 1, p.clone(), curve(p))).collect()
    }

    /// Says for a while what has just happened, with a way `back` from it.
    pub(crate) fn say(&mut self, text: impl Into<String>, back: Option<Back>, now: f64) {
        let revision = self.document.revision();
        self.toast = Some(Toast { text: text.into(), back, until: now + SHOWN_SECS, revision });
    }

    /// Says which edit was made since a revision of the document, if any.
    pub(crate) fn say_edit_since(&mut self, revision: u64, now: f64) {
        if self.document.revision() != revision
            && let Some(name) = self.document.undo_name().map(done)
        {
            self.say(sentence(&name), Some(Back::Undo), now);
        }
    }

    /// Forgets a message whose time is over, or that something newer made untrue. Returns the seconds until
    /// the present one is over.
    pub(crate) fn expire_toast(&mut self, now: f64) -> Option<f64> {
        let revision = self.document.revision();
        self.toast.take_if(|toast| now >= toast.until || toast.revision != revision);
        self.toast.as_ref().map(|toast| toast.until - now)
    }

    /// Returns the value of a result, or shows its error as the problem.
    pub(crate) fn settle<T>(&mut self, result: Result<T>) -> Option<T> {
        result.map_err(|e| self.problem = Some(statement(&e))).ok()
    }

    /// Returns `true` if the view may be turned. Where a recorded frame is compared, both pictures must be
    /// seen from the same place.
    pub(crate) fn may_orbit(&self) -> bool {
        let mode = self.document.mode;
        mode.may_orbit() && self.info().is_some_and(|i| i.has_reconstruction)
    }
}
