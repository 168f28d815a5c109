//! Requests of panels. A panel reads the state and pushes actions; they are carried out once all panels are
//! shown.

use crate::viewer::{
    backend::{TrainRequest, paths::PathKind},
    command::{Command, keys},
    shared::Shared,
    state::{
        autosave::LeftId,
        content::{Look, PromptId},
        document::Document,
        marking::Marking,
        preferences::Preferences,
        time_scale::Span,
        zoom::Panes,
    },
};
use crate::{engine::Negatives, jobs::ExportRequest};
use egui::{Context, KeyboardShortcut};
use std::path::PathBuf;
use surgtpgs_core::marks::Mark;

/// Something that a panel wants to be done.
pub(crate) enum Action {
    /// Gives a command.
    Run(Command),
    /// Changes the document; see [`Action::edit`].
    Edit(Box<dyn FnOnce(&mut Document)>),
    /// Gives a prompt other words.
    Rename(PromptId, String),
    /// Adds a prompt and remembers its words.
    AddPrompt(String),
    /// Takes over what is typed into the prompt box.
    Type { text: String, is_focused: bool },
    /// Stops and goes to a frame.
    GoTo(usize),
    /// Goes to a frame while the pointer is dragged.
    Scrub(usize),
    /// Shows a part of the recording on the time bar.
    TimeSpan(Span),
    /// Asks for small pictures of these frames.
    Thumbnails(Vec<usize>),
    /// Turns, moves or magnifies the picture.
    Look { look: Look, is_moving: bool },
    /// Notes where the panes were painted.
    Place(Panes),
    /// Adds a mark, with the mask of what it points at if that is wanted.
    AddMark(Mark),
    /// Asks for the folder of the network that finds borders.
    ChooseMasksModel,
    /// Changes the tool that marks are made with; see [`Action::marking`].
    Marking(Box<dyn FnOnce(&mut Marking)>),
    /// Changes the width of the side panel.
    PanelWidth(f32),
    /// Moves the dividing line of the wipe, as share of the width.
    Wipe(f32),
    /// Probes a point of the picture, as share of width and height.
    Probe(Option<[f32; 2]>),
    /// Opens a scene, a recording or a session.
    Open(PathBuf),
    /// Uses the path that the window's own dialog asked for.
    Pick(PathBuf, PathKind),
    /// Closes the window's own dialog for paths.
    PickNothing,
    /// Changes a preference; see [`Action::prefer`].
    Prefer(Box<dyn FnOnce(&mut Preferences)>),
    /// Chooses a key for a command; `None` restores its default keys.
    ChooseKey(Command, Option<KeyboardShortcut>),
    /// Starts training.
    Train(TrainRequest),
    /// Starts an export; the negatives are those of prompts without exceptions of their own.
    Export(Box<(ExportRequest, Negatives)>),
    /// Closes the result of an export.
    ForgetExport,
    /// Shows a folder with the system's file manager.
    ShowFolder(PathBuf),
    /// Takes a recording out of those that wait to be reconstructed.
    Unqueue(usize),
    /// Stops offering a finished reconstruction.
    ForgetFinished(PathBuf),
    /// Inverts which side of the recording's masks is kept.
    FlipMasks,
    /// Restores unsaved work.
    Restore(LeftId),
    /// Discards unsaved work.
    Discard(LeftId),
    /// Offers unsaved work again at the next start.
    RestoreLater(LeftId),
    /// Says something for a while.
    Say(&'static str),
    /// Shows a problem.
    Report(String),
    /// Closes the message about a problem.
    CloseProblem,
    /// Closes the message about what has just happened.
    CloseToast,
    /// Closes the open dialog.
    CloseDialog,
}

impl Action {
    /// Makes an edit of the document.
    pub(crate) fn edit(change: impl FnOnce(&mut Document) + 'static) -> Self {
        Self::Edit(Box::new(change))
    }

    /// Makes a change of the tool that marks are made with.
    pub(crate) fn marking(change: impl FnOnce(&mut Marking) + 'static) -> Self {
        Self::Marking(Box::new(change))
    }

    /// Makes a change of the preferences, which are saved afterwards.
    pub(crate) fn prefer(change: impl FnOnce(&mut Preferences) + 'static) -> Self {
        Self::Prefer(Box::new(change))
    }
}

impl Shared {
    /// Edits the document, and says so if something was taken away.
    fn edit(&mut self, change: Box<dyn FnOnce(&mut Document)>, now: f64) {
        let count = |d: &Document| (d.prompts().len(), d.bookmarks().len(), d.marks().all().len());
        let (before, revision) = (count(&self.document), self.document.revision());
        let phases = self.document.phases().to_vec();
        change(&mut self.document);
        let after = count(&self.document);
        let is_less = after.0 < before.0 || after.1 < before.1 || after.2 < before.2;
        if is_less || self.document.lacks_phase_of(&phases) {
            self.say_edit_since(revision, now);
        }
    }

    /// Gives a prompt other words, or says that another prompt has them.
    fn rename(&mut self, id: PromptId, words: String, now: f64) {
        let taken = self.document.namesake(id, &words);
        match taken.map(|other| format!("There is a prompt \"{}\" already", other.text)) {
            Some(why) => self.say(why, None, now),
            None => self.edit(Box::new(move |d: &mut Document| d.rename(id, &words)), now),
        }
    }

    /// Carries out an action.
    pub(crate) fn act(&mut self, action: Action, ctx: &Context) {
        let now = ctx.input(|i| i.time);
        match action {
            Action::Run(command) => self.run(command.into(), ctx),
            Action::Edit(change) => self.edit(change, now),
            Action::Rename(id, words) => self.rename(id, words, now),
            Action::AddPrompt(text) => self.add_prompt(&text),
            Action::Type { text, is_focused } => {
                (self.prompt_box.text, self.prompt_box.is_focused) = (text, is_focused);
                self.prompt_box.wants_focus = false;
            }
            Action::GoTo(frame) => {
                self.playback.pause();
                self.playback.go_to(frame, now);
            }
            Action::Scrub(frame) => {
                self.playback.pause();
                self.playback.go_to(frame, now);
                self.viewport.is_moving = true;
            }
            Action::TimeSpan(span) => {
                (self.viewport.span, self.viewport.span_frame) = (span, self.playback.frame());
            }
            Action::Thumbnails(frames) => {
                if let Some(open) = &mut self.open {
                    open.want_thumbnails(frames);
                }
            }
            Action::Look { look, is_moving } => {
                self.document.look = look;
                self.viewport.is_moving |= is_moving;
            }
            Action::Place(panes) => self.viewport.panes = panes,
            Action::AddMark(mark) => self.add_mark(mark, ctx),
            Action::ChooseMasksModel => self.choose_masks_model(ctx),
            Action::Marking(change) => change(&mut self.viewport.marking),
            Action::PanelWidth(width) => self.preferences.panel_width = width,
            Action::Wipe(share) => self.viewport.wipe = share,
            Action::Probe(point) => self.viewport.probe = point,
            Action::Open(path) => self.open_path(&path, ctx),
            Action::Pick(path, kind) => self.take_picked(&path, &kind, now, ctx),
            Action::PickNothing => self.opening.asked = None,
            Action::Prefer(change) => {
                change(&mut self.preferences);
                self.preferences.save();
            }
            Action::ChooseKey(command, key) => {
                keys::choose(&mut self.preferences.keys, command, key);
                self.preferences.save();
            }
            Action::Train(request) => self.start_training(request, ctx),
            Action::Unqueue(index) => drop(self.reconstruction.queue.remove(index)),
            Action::Export(export) => self.start_export(export.0, export.1, ctx),
            Action::ForgetExport => self.exporting = None,
            Action::ShowFolder(folder) => {
                let shown = self.backend.show_folder(&folder);
                self.settle(shown);
            }
            Action::ForgetFinished(scene) => self.reconstruction.forget(&scene),
            Action::FlipMasks => self.flip_masks(ctx),
            Action::Restore(id) => self.restore(id, ctx),
            Action::Discard(id) => self.discard(id, now),
            Action::RestoreLater(id) => self.restore_later(id, now),
            Action::Say(text) => self.say(text, None, now),
            Action::Report(problem) => self.problem = Some(problem),
            Action::CloseProblem => self.problem = None,
            Action::CloseToast => self.toast = None,
            Action::CloseDialog => self.dialog = None,
        }
    }
}
