//! The window's own dialog for paths: a field to type in, and the contents of a folder. It serves where the
//! system has no file dialog.

use crate::viewer::{
    action::Action,
    backend::{
        paths::{PathAsk, PathKind, taken},
        task::{Task, TaskEvent},
    },
    panels::widgets::{caption, dialog, focus_selecting, main_button},
    shared::Shared,
    theme,
};
use egui::{Button, Context, Id, Key, RichText, ScrollArea, TextEdit, Ui, vec2};
use std::{
    ops::Range,
    path::{Path, PathBuf},
};
use surgtpgs_core::marks::Marks;

/// Number of entries of a folder that are shown.
const MAX_ENTRIES: usize = 2000;

/// A file or folder in a list.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
struct Entry {
    /// `false` for folders, which come first.
    is_file: bool,
    name: String,
}

/// The dialog.
#[derive(Default)]
pub(crate) struct Picker {
    /// Path being typed.
    typed: String,
    /// Folder whose contents are listed.
    folder: PathBuf,
    entries: Vec<Entry>,
    listing: Option<Task<Vec<Entry>>>,
    is_open: bool,
    /// `true` until the field has the focus for the first time.
    wants_focus: bool,
}

impl Picker {
    /// Shows the dialog, if a path is asked for.
    pub(crate) fn ui(&mut self, ctx: &Context, shared: &Shared, actions: &mut Vec<Action>) {
        let Some(ask) = &shared.opening.asked else {
            *self = Self::default();
            return;
        };
        if !std::mem::replace(&mut self.is_open, true) {
            self.begin(ask, ctx);
        }
        if let Some(TaskEvent::Done(listed)) = self.listing.as_mut().and_then(Task::poll) {
            (self.listing, self.entries) = (None, listed.unwrap_or_default());
        }
        let ((chosen, is_cancelled), is_closed) =
            dialog(ctx, "picker", 620.0, |ui| self.contents_ui(ui, ask, shared.saving.saved.file.as_deref()));
        if let Some(path) = chosen {
            actions.push(Action::Pick(path, ask.kind.clone()));
        } else if is_cancelled || is_closed {
            actions.push(Action::PickNothing);
        }
    }

    fn begin(&mut self, ask: &PathAsk, ctx: &Context) {
        self.wants_focus = true;
        let start = ask.folder.clone().or_else(dirs::home_dir).unwrap_or_else(|| PathBuf::from("/"));
        self.enter(start, &ask.kind, ctx);
    }

    /// Returns the name of the file to write: the typed one, or the one that is offered where there is none;
    /// `None` if something that exists is asked for.
    fn name_to_write(&self, kind: &PathKind) -> Option<PathBuf> {
        let (PathKind::Save(offered, _) | PathKind::SaveMarks(offered)) = kind else { return None };
        let typed = Path::new(self.typed.trim());
        let name = typed.file_name().filter(|_| !typed.is_dir());
        Some(name.map_or_else(|| PathBuf::from(offered), PathBuf::from))
    }

    /// Lists the contents of a folder, on a thread of its own. The name of a file to write stays.
    fn enter(&mut self, folder: PathBuf, kind: &PathKind, ctx: &Context) {
        let name = self.name_to_write(kind);
        let path = name.map_or_else(|| folder.clone(), |name| folder.join(name));
        self.typed = path.display().to_string();
        let at = folder.clone();
        self.listing = Some(Task::start("list", ctx, move |_| Ok(list(&at))));
        (self.folder, self.entries) = (folder, Vec::new());
    }

    /// Shows the dialog; returns the chosen path, and `true` if the dialog is to be closed. The file `own` may be
    /// written over.
    fn contents_ui(&mut self, ui: &mut Ui, ask: &PathAsk, own: Option<&Path>) -> (Option<PathBuf>, bool) {
        ui.heading(&ask.title);
        let field = TextEdit::singleline(&mut self.typed).id(Id::unique("path to pick"));
        let field = ui.add(field.desired_width(f32::INFINITY).hint_text("Path").return_key(None));
        field.ctx.accesskit_node_builder(field.id, |node| node.set_label("Path"));
        if std::mem::take(&mut self.wants_focus) {
            focus_selecting(&field, typed_over(&self.typed, &ask.kind));
        }
        let is_entered = field.has_focus() && ui.input(|i| i.key_pressed(Key::Enter));
        let typed = PathBuf::from(self.typed.trim());
        let (mut chosen, mut entered) = (None, None);
        ui.horizontal(|ui| {
            let up = self.folder.parent().map(Path::to_owned);
            if ui.add_enabled(up.is_some(), Button::new("Folder above")).clicked() {
                entered = up;
            }
            ui.add(egui::Label::new(caption(self.folder.display().to_string())).truncate());
        });
        let writes = ask.kind.written_extension().is_some();
        match self.entries_ui(ui, &ask.kind) {
            Some((path, false)) => entered = Some(path),
            Some((path, true)) if writes => self.typed = path.display().to_string(),
            Some((path, true)) => chosen = Some(path),
            None => {}
        }
        let problem = problem(&typed, &ask.kind, own);
        if let Some(why) = &problem {
            ui.label(RichText::new(why).font(theme::small()).color(theme::TEXT_WEAK));
        }
        let is_ready = problem.is_none();
        let verb = if writes { "Save" } else { "Open" };
        let is_cancelled = ui.horizontal(|ui| {
            if ui.add_enabled(is_ready, main_button(verb)).clicked() || (is_ready && is_entered) {
                chosen = Some(ask.kind.completed(&typed));
            }
            ui.button("Cancel").clicked()
        });
        if is_entered && typed.is_dir() && chosen.is_none() {
            entered = Some(typed);
        }
        if let Some(folder) = entered {
            self.enter(folder, &ask.kind, ui.ctx());
        }
        (chosen, is_cancelled.inner)
    }

    /// Shows the contents of the folder; returns the entry that is clicked, and `true` for a file.
    fn entries_ui(&self, ui: &mut Ui, kind: &PathKind) -> Option<(PathBuf, bool)> {
        let mut clicked = None;
        let height = (ui.ctx().content_rect().height() - 300.0).clamp(60.0, 360.0);
        let area = ScrollArea::vertical().max_height(height).min_scrolled_height(height).auto_shrink(false);
        area.show(ui, |ui| {
            for entry in &self.entries {
                let path = self.folder.join(&entry.name);
                if !is_wanted(entry, &path, kind) {
                    continue;
                }
                let name = if entry.is_file { entry.name.clone() } else { format!("{}/", entry.name) };
                let button =
                    Button::new(name).truncate().frame(false).min_size(vec2(ui.available_width(), 28.0));
                if ui.add(button).clicked() {
                    clicked = Some((path, entry.is_file));
                }
            }
        });
        clicked
    }
}

/// Returns the letters of a path that are typed over: the name of the file to write, without its extension.
/// Of a path that exists, there are none: the rest of it is typed behind it.
fn typed_over(path: &str, kind: &PathKind) -> Range<usize> {
    let end = path.chars().count();
    if kind.written_extension().is_none() {
        return end..end;
    }
    let name = Path::new(path).file_name().unwrap_or_default().to_string_lossy().into_owned();
    let stem = Path::new(&name).file_stem().unwrap_or_default().to_string_lossy().into_owned();
    let first = end.saturating_sub(name.chars().count());
    first..first + stem.chars().count()
}

/// Returns `true` for entries that lead to what is asked for, or that have its kind of name.
fn is_wanted(entry: &Entry, path: &Path, kind: &PathKind) -> bool {
    let extension = path.extension().unwrap_or_default().to_string_lossy().to_lowercase();
    match kind {
        _ if !entry.is_file => true,
        PathKind::File(extensions) => extensions.contains(&&*extension),
        PathKind::Marks => Marks::EXTENSIONS.contains(&&*extension),
        PathKind::Folder | PathKind::MasksModel => false,
        PathKind::Save(..) | PathKind::SaveMarks(_) => kind.written_extension() == Some(&*extension),
    }
}

/// Says why a path cannot be chosen; `None` if it can. The file `own` may be written over.
fn problem(path: &Path, kind: &PathKind, own: Option<&Path>) -> Option<String> {
    let file = kind.completed(path);
    let why = match kind {
        PathKind::File(_) | PathKind::Marks if !path.exists() => "There is no such file.",
        PathKind::Folder | PathKind::MasksModel if !path.is_dir() => "There is no such folder.",
        PathKind::File(_) | PathKind::Marks | PathKind::Folder | PathKind::MasksModel => return None,
        PathKind::Save(..) | PathKind::SaveMarks(_) if path.is_dir() => {
            "Type a name for the file behind the folder."
        }
        PathKind::Save(..) | PathKind::SaveMarks(_) if !path.parent().is_some_and(Path::is_dir) => {
            "There is no such folder."
        }
        PathKind::Save(..) | PathKind::SaveMarks(_) => return taken(&file).filter(|_| own != Some(&file)),
    };
    Some(why.to_owned())
}

/// Lists the contents of a folder without hidden entries: folders first, each in the order of names.
fn list(folder: &Path) -> Vec<Entry> {
    let Ok(entries) = std::fs::read_dir(folder) else { return Vec::new() };
    let entry = |entry: std::fs::DirEntry| {
        let is_file = !entry.path().is_dir();
        Entry { is_file, name: entry.file_name().to_string_lossy().into_owned() }
    };
    let mut entries: Vec<Entry> =
        entries.flatten().map(entry).filter(|e| !e.name.starts_with('.')).take(MAX_ENTRIES).collect();
    entries.sort();
    entries
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_form_of_marks_is_offered() {
        let is_offered = |name: &str| {
            let entry = Entry { is_file: true, name: name.into() };
            is_wanted(&entry, Path::new(name), &PathKind::Marks)
        };
        let offered = ["marks.json", "annotations.xml", "liver.seg.nrrd", "seg.dcm", "EXPORT.JSON", "A.DCM"];
        assert!(offered.into_iter().all(is_offered));
        assert!(!["scene.safetensors", "frame.png", "notes"].into_iter().any(is_offered));
    }

    #[test]
    fn the_name_of_a_file_to_write_is_typed_over_and_a_folder_is_not() {
        let kind = PathKind::Save("Prüfung.2024.surgtpgs".into(), "Sessions");
        assert_eq!(typed_over("/data/Prüfung.2024.surgtpgs", &kind), 6..18);
        let kind = PathKind::SaveMarks("clip-marks.json".into());
        assert_eq!(typed_over("/data/clip-marks.json", &kind), 6..16);
        assert_eq!(typed_over("/data/op", &PathKind::Folder), 8..8);
    }

    #[test]
    fn the_typed_name_of_a_file_to_write_stays_in_another_folder() {
        let folder = tempfile::tempdir().unwrap();
        let below = folder.path().join("below");
        std::fs::create_dir(&below).unwrap();
        let ctx = Context::default();
        let kind = PathKind::Save("case.surgtpgs".into(), "Sessions");
        let entered = |typed: &Path, kind: &PathKind| {
            let mut picker = Picker { typed: typed.display().to_string(), ..Picker::default() };
            picker.enter(below.clone(), kind, &ctx);
            PathBuf::from(picker.typed)
        };
        assert_eq!(entered(&folder.path().join("mine"), &kind), below.join("mine"));
        assert_eq!(entered(folder.path(), &kind), below.join("case.surgtpgs"), "no name is typed");
        assert_eq!(entered(Path::new(""), &kind), below.join("case.surgtpgs"));
        let marks = PathKind::SaveMarks("case-marks.json".into());
        assert_eq!(entered(&folder.path().join("a.json"), &marks), below.join("a.json"));
        assert_eq!(entered(&folder.path().join("mine"), &PathKind::Folder), below);
    }

    #[test]
    fn a_file_that_is_there_is_not_chosen_for_another_one() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("case.surgtpgs");
        std::fs::write(&file, "of yesterday").unwrap();
        let kind = PathKind::Save("case-2.surgtpgs".into(), "Sessions");
        for typed in ["case.surgtpgs", "case"] {
            let typed = folder.path().join(typed);
            assert!(problem(&typed, &kind, None).unwrap().contains("is there already"));
            assert_eq!(problem(&typed, &kind, Some(&file)), None, "the session's own");
        }
        assert_eq!(problem(&folder.path().join("case.2"), &kind, None), None);
        let there = Entry { is_file: true, name: "case.surgtpgs".into() };
        assert!(is_wanted(&there, &file, &kind), "what is there is shown");
    }
}
