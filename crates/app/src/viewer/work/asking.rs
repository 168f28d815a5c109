//! The picture to request in the present state.

use crate::engine::Question;
use crate::viewer::{
    backend::{FrameView, orbit::Orbit},
    picture::request::{AskedPrompt, Request},
    shared::Shared,
    state::{
        content::{PREVIEW, Prompt},
        marks::MarkList,
        view_mode::ViewMode,
    },
};
use surgtpgs_core::sequence::{is_same_name, names_instrument};

/// Largest number of classes whose scores are asked for a probed point, beside those of the prompts.
const MAX_CANDIDATES: usize = 12;

/// Number of words that are remembered, in the session and nowhere else.
const MAX_EARLIER: usize = 20;

impl Shared {
    /// Requests the picture of the present state, unless it has been requested already. While `is_peeking`,
    /// only the recorded frame is to be shown.
    pub(crate) fn ask(&mut self, is_peeking: bool) {
        let Some(request) = self.request(is_peeking) else { return };
        if let Some(open) = &mut self.open {
            open.ask(request);
        }
    }

    /// Moves to the frame that is due at `now`, and skips excluded frames while playing.
    pub(crate) fn play(&mut self, now: f64) {
        // A range of which nothing is left is none.
        let range = self.document.content().range.filter(|range| self.document.has_included(*range));
        self.playback.set_range(range);
        self.playback.advance(now);
        let (frame, bounds) = (self.playback.frame(), self.playback.bounds());
        if self.playback.is_playing() && self.document.is_excluded(frame) {
            let (is_forwards, wraps) = (self.playback.speed() > 0.0, self.playback.is_looping());
            match self.document.next_included(frame, is_forwards, bounds, wraps) {
                Some(next) => self.playback.seek(next, now),
                None => self.playback.pause(),
            }
        }
    }

    /// Returns the frame that is seen: while it plays, that of the picture on the screen, which may lag
    /// behind the clock; or the frame that was asked for since, until there is a picture behind it. Nothing is
    /// seen of a frame that is left out.
    pub(crate) fn seen_frame(&self) -> usize {
        let jump = self.playback.jump();
        let shown = self.picture().map(|picture| &picture.request);
        let shown = shown.filter(|request| request.jump == jump.number);
        let frame = shown.map_or(jump.frame, |request| request.view.frame);
        let is_seen = self.playback.is_playing() && !self.document.is_excluded(frame);
        if is_seen { frame } else { self.playback.frame() }
    }

    /// Goes to the frame that is seen. If it plays, it goes on from there.
    pub(crate) fn go_to_seen(&mut self, now: f64) {
        let frame = self.seen_frame();
        if frame != self.playback.frame() {
            self.playback.seek(frame, now);
        }
    }

    /// Stops on the frame that is seen.
    pub(crate) fn pause(&mut self, now: f64) {
        self.go_to_seen(now);
        self.playback.pause();
    }

    /// Stops on the frame that is seen, or plays.
    pub(crate) fn play_or_pause(&mut self, now: f64) {
        self.go_to_seen(now);
        self.playback.toggle(now);
    }

    /// Stops, and moves by `frames` from the frame that is seen.
    pub(crate) fn step(&mut self, frames: isize, now: f64) {
        self.go_to_seen(now);
        self.playback.step(frames);
    }

    /// Adds a prompt and remembers its words.
    pub(crate) fn add_prompt(&mut self, text: &str) {
        self.document.add(text);
        let text = text.trim().to_owned();
        if !text.is_empty() {
            let earlier = &mut self.prompt_box.earlier;
            earlier.retain(|e| !e.eq_ignore_ascii_case(&text));
            earlier.insert(0, text);
            earlier.truncate(MAX_EARLIER);
        }
    }

    /// Returns questions whose scores are wanted besides those of the visible prompts while a point is probed:
    /// hidden prompts, and classes that no prompt asks for.
    pub(crate) fn candidates(&self) -> Vec<Question> {
        let Some(info) = self.info().filter(|i| i.has_features && self.viewport.probe.is_some()) else {
            return Vec::new();
        };
        let prompts = self.document.prompts();
        let hidden = prompts.iter().filter(|p| !p.is_visible).map(|p| self.document.question(p));
        let is_new = |class: &&String| !prompts.iter().any(|p| is_same_name(&p.text, class));
        let classes = info.example_prompts.iter().take(MAX_CANDIDATES).filter(is_new);
        hidden.chain(classes.map(|class| self.document.bare_question(class))).collect()
    }

    fn request(&self, is_peeking: bool) -> Option<Request> {
        let open = self.open.as_ref()?;
        let mode = self.document.mode;
        let turned = self.document.look.orbit;
        let orbit = if self.may_orbit() && !turned.is_home() { turned } else { Orbit::default() };
        let is_moving = self.viewport.is_moving || self.playback.is_playing();
        Some(Request {
            view: FrameView { frame: self.playback.frame(), orbit, is_preview: is_moving && open.is_slow() },
            jump: self.playback.jump().number,
            needs_original: mode.needs_original() || is_peeking,
            needs_reconstruction: mode.needs_reconstruction(),
            layer: mode.layer(),
            needs_difference: mode == ViewMode::Difference,
            needs_depth: !is_moving,
            prompts: if self.can_ask() { self.asked_prompts() } else { Vec::new() },
            candidates: self.unmarked_questions(),
            look: self.document.overlay,
            clean_up: self.document.content().clean_up,
            point: self.viewport.probe.filter(|_| open.info.has_features),
            marks: if self.carries_marks() { self.marks_shown() } else { MarkList::default() },
            is_typing: !self.prompt_box.live().is_empty() && !self.playback.is_playing(),
        })
    }

    /// Returns the questions whose scores are wanted without being drawn. If there are none and the prompt box
    /// has the focus, that for an example word is returned, so that the text encoder and the features are ready
    /// at the first letter.
    fn unmarked_questions(&self) -> Vec<Question> {
        let questions = self.candidates();
        let rehearses = questions.is_empty() && self.prompt_box.is_focused;
        let info = self.info().filter(|i| rehearses && i.has_features);
        let example = info.and_then(|info| info.example_prompts.first());
        example.map_or(questions, |word| vec![self.document.bare_question(word)])
    }

    /// Returns the visible prompts and the one being typed.
    fn asked_prompts(&self) -> Vec<AskedPrompt> {
        let asked = |p: &Prompt| AskedPrompt {
            id: p.id,
            question: self.document.question(p),
            threshold: p.threshold,
            colour: p.colour,
            is_instrument: p.is_instrument,
        };
        let mut prompts: Vec<AskedPrompt> =
            self.document.prompts().iter().filter(|p| p.is_visible).map(asked).collect();
        let live = self.prompt_box.live();
        if !live.is_empty() && !prompts.iter().any(|p| is_same_name(&p.question.text, live)) {
            prompts.push(AskedPrompt {
                id: PREVIEW,
                question: self.document.bare_question(live),
                threshold: self.document.default_threshold(),
                colour: self.document.next_colour(),
                is_instrument: names_instrument(live),
            });
        }
        prompts
    }
}
