//! Marks by hand: which of them prompts can find, the tool that makes them, and their files.

use crate::viewer::{
    backend::{
        paths::{PathAsk, PathKind, free_path},
        task::{Task, TaskEvent},
    },
    shared::Shared,
    state::{
        content::Prompt,
        marking::Draft,
        marks::{MarkList, canvas},
        saving::SavedKind,
        toast::Back,
    },
    text::counted,
};
use egui::Context;
use std::path::Path;
use surgtpgs_core::{
    files::write_whole,
    marks::Marks,
    sequence::{Sequence, is_same_name},
};

impl Shared {
    /// Returns `true` if prompts can be asked: the reconstruction has features, or marks can be carried to it.
    pub(crate) fn can_ask(&self) -> bool {
        let has_features = self.info().is_some_and(|i| i.has_features);
        let has_marks = || !self.document.marks().is_empty() || self.draft_shown().is_some();
        has_features || (self.carries_marks() && has_marks())
    }

    /// Returns `true` if prompts can be typed: they are answered now, or wait for the reconstruction.
    pub(crate) fn takes_prompts(&self) -> bool {
        self.can_ask() || self.awaits_reconstruction()
    }

    /// Returns `true` if what is open is a recording without a reconstruction.
    pub(crate) fn awaits_reconstruction(&self) -> bool {
        self.info().is_some_and(|i| !i.has_reconstruction)
    }

    /// Returns `true` if the planned reconstruction of what is open will find words; `None` if there is none.
    pub(crate) fn will_find_words(&self) -> Option<bool> {
        let recording = self.info()?.recording.as_ref()?;
        self.reconstruction.will_find_words(recording)
    }

    /// Returns `true` if what is open is being reconstructed, or will be without being asked.
    pub(crate) fn is_to_be_reconstructed(&self) -> bool {
        let is_demo = || self.info().is_some_and(|i| self.is_demo(&i.path));
        let is_made = self.opening.is_making_demo() && is_demo();
        self.will_find_words().is_some() || self.is_reconstructing() || is_made
    }

    /// Returns `true` if what is marked can be found: there is a reconstruction, and it is finished.
    pub(crate) fn carries_marks(&self) -> bool {
        self.info().is_some_and(|i| i.has_reconstruction) && !self.is_reconstructing()
    }

    /// Returns `true` if there are marks that wait for a reconstruction.
    pub(crate) fn has_waiting_marks(&self) -> bool {
        self.open.is_some() && !self.document.marks().is_empty() && !self.carries_marks()
    }

    /// Returns `true` if a prompt finds what is marked once there is a reconstruction.
    pub(crate) fn waits_as_marked(&self, prompt: &Prompt) -> bool {
        let is_marked = || self.document.marks().names().into_iter().any(|name| prompt.is_marked_as(name));
        self.has_waiting_marks() && is_marked()
    }

    /// Returns all marks, with the one that is being drawn.
    pub(crate) fn marks_shown(&self) -> MarkList {
        let marks = self.document.marks();
        self.draft_shown().map_or_else(|| marks.clone(), |draft| marks.with([draft.mark.clone()]))
    }

    /// Returns the mark that is being drawn, if it marks something already.
    fn draft_shown(&self) -> Option<&Draft> {
        let marking = &self.viewport.marking;
        marking.draft.as_ref().filter(|draft| marking.is_on && draft.fits)
    }

    /// Returns the names of all that may be marked or looked for here: prompts, marks, classes.
    pub(crate) fn known_names(&self) -> Vec<String> {
        let prompts = self.document.prompts().iter().filter(|p| p.like.is_none()).map(|p| p.text.as_str());
        let classes = self.info().map(|i| i.example_prompts.as_slice()).unwrap_or_default();
        let mut names: Vec<String> = Vec::new();
        for name in prompts.chain(self.document.marks().names()).chain(classes.iter().map(String::as_str)) {
            if !names.iter().any(|known| is_same_name(known, name)) {
                names.push(name.to_owned());
            }
        }
        names
    }

    /// Takes the tool for marking in hand, or puts it away.
    pub(crate) fn toggle_marking(&mut self) {
        match self.viewport.marking.is_on {
            true => self.put_away_marking(),
            false => self.take_marking(),
        }
    }

    /// Puts the tool for marking away, if it is in hand.
    pub(crate) fn put_away_marking(&mut self) {
        let marking = &mut self.viewport.marking;
        if std::mem::take(&mut marking.is_on) {
            (marking.draft, marking.put_away_at) = (None, self.document.selected);
            (marking.wants_name, marking.is_just_taken) = (false, false);
        }
    }

    /// Takes the tool for marking in hand. A prompt that was selected since it was put away is what is
    /// marked, unless another name is typed. Where the tool keeps its name, keys stay commands: none of them
    /// types over it.
    pub(crate) fn take_marking(&mut self) {
        let selected = self.document.selected.and_then(|id| self.document.prompt(id));
        let name = selected.filter(|p| p.like.is_none()).map(|p| p.text.clone());
        let marking = &mut self.viewport.marking;
        let is_missing = marking.plain_name().is_empty();
        let is_new = is_missing || self.document.selected != marking.put_away_at;
        let offered = name.filter(|name| is_new && *name != marking.name);
        let wants_name = offered.is_some() || is_missing;
        (marking.is_on, marking.draft, marking.wants_name) = (true, None, wants_name);
        marking.is_just_taken = true;
        if let Some(name) = offered {
            marking.name = name;
        }
        (self.viewport.has_ruler, self.viewport.probe) = (false, None);
        if !self.document.look.orbit.is_home() {
            self.document.reset_look();
        }
    }

    /// Asks where to save the marks.
    pub(crate) fn save_marks(&mut self, ctx: &Context) {
        let Some(info) = self.info() else { return };
        let file = free_path(&info.output_folder, &format!("{}-marks", info.name), "json", &[]);
        self.ask_for(PathAsk::save("Save the marks as", &file, PathKind::SaveMarks), ctx);
    }

    /// Writes all marks to a file.
    pub(crate) fn write_marks(&mut self, file: &Path, now: f64) {
        let Some(info) = self.info() else { return };
        let marks = Marks::new(self.document.marks().all().to_vec(), &canvas(info));
        let written = marks.and_then(|marks| write_whole(file, marks.to_text()?.as_bytes()));
        if self.settle_saving(SavedKind::Marks, file, written) {
            let name = file.file_name().unwrap_or_default().to_string_lossy();
            self.say(format!("Marks saved as {name}"), None, now);
        }
    }

    /// Asks for a file of marks to open.
    pub(crate) fn open_marks(&mut self, ctx: &Context) {
        let folder = self.info().map(|info| info.output_folder.clone());
        let title = "Open marks: a file that was saved here, or annotations of another program".into();
        self.ask_for(PathAsk { title, kind: PathKind::Marks, folder }, ctx);
    }

    /// Reads a file of marks in the background.
    pub(crate) fn read_marks(&mut self, file: &Path, ctx: &Context) {
        let Some(info) = self.info() else { return };
        let (at, canvas, recording) = (file.to_owned(), canvas(info), info.sequence.clone());
        let open = move || Sequence::open(&recording?).ok();
        self.opening.marks = Some(Task::start("marks", ctx, move |_| Marks::read_for(&at, &canvas, open)));
    }

    /// Takes the marks that were read, beside those that are there.
    pub(crate) fn poll_marks(&mut self, now: f64) {
        let event = self.opening.marks.as_mut().and_then(Task::poll);
        let Some(TaskEvent::Done(result)) = event else { return };
        self.opening.marks = None;
        let (Some(marks), Some(info)) = (self.settle(result), self.info()) else { return };
        // Something else may be open by now.
        let canvas = canvas(info);
        let marks: Vec<_> = marks.all().iter().filter(|mark| mark.fits(&canvas)).cloned().collect();
        let name = |count: usize| format!("opening {count} {}", if count == 1 { "mark" } else { "marks" });
        let before = self.document.marks().all().len();
        let added = self.document.add_marks(name, marks);
        let marks = counted(added, "mark", "marks");
        match (added, before) {
            (0, _) => self.say("The file has no marks that are not there already", None, now),
            (_, 0) => self.say(format!("Added {marks}"), Some(Back::Undo), now),
            _ => {
                let earlier = counted(before, "earlier one", "earlier ones");
                self.say(format!("Added {marks} to {earlier}"), Some(Back::Undo), now);
            }
        }
    }
}
