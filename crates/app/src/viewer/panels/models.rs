//! The choice of what words are found by, and of the networks for it, which are checked at once.

use crate::viewer::{
    backend::{
        Backend, ModelFaults, Models, Words,
        paths::{PathAsk, PathKind},
        task::{Task, TaskEvent},
    },
    panels::{
        picking::Picking,
        widgets::{caption, choice, path_field},
    },
    remedy::message,
    theme,
};
use egui::{Context, RichText, Ui};
use std::{
    path::{Path, PathBuf},
    sync::Arc,
};

/// Networks to choose, with the check of them.
pub(crate) struct ModelsForm {
    pub(crate) chosen: Models,
    check: Asked<ModelFaults>,
    recording: PathBuf,
    /// Folders of what networks found, perhaps in this recording.
    folders: Vec<PathBuf>,
    /// Folder of what the chosen networks found in the recording.
    found: Asked<Option<PathBuf>>,
    picking: Picking,
    /// The field that a folder is picked for.
    picked_field: usize,
}

/// A question about networks, which is answered in the background.
struct Asked<T> {
    /// Question that is underway, with what it is about.
    underway: Option<(Models, Task<T>)>,
    /// Latest answer, with what it is about.
    latest: Option<(Models, Result<T, String>)>,
    /// Returns `true` if the answer for one says everything about the other.
    is_alike: fn(&Models, &Models) -> bool,
}

impl<T: Send + 'static> Asked<T> {
    fn new(is_alike: fn(&Models, &Models) -> bool) -> Self {
        Self { underway: None, latest: None, is_alike }
    }

    /// Takes the answer of the thread.
    fn poll(&mut self) {
        if let Some(TaskEvent::Done(result)) = self.underway.as_mut().and_then(|(_, task)| task.poll())
            && let Some((about, _)) = self.underway.take()
        {
            self.latest = Some((about, result.map_err(|e| message(&e))));
        }
    }

    /// Asks about networks, unless that is underway or answered.
    fn ask(&mut self, models: &Models, start: impl FnOnce(Models) -> Task<T>) {
        let is_underway = self.underway.as_ref().is_some_and(|(about, _)| (self.is_alike)(about, models));
        if !is_underway && self.about(models).is_none() {
            self.underway = Some((models.clone(), start(models.clone())));
        }
    }

    /// Returns the answer about networks, once it is there.
    fn about(&self, models: &Models) -> Option<&Result<T, String>> {
        let latest = self.latest.as_ref().filter(|(about, _)| (self.is_alike)(about, models));
        latest.map(|(_, result)| result)
    }
}

/// Numbers of points along each side of a picture, with their names.
const DENSITIES: [(usize, &str, &str); 3] = [
    (8, "Coarse", "Large structures; the fastest"),
    (16, "Medium", "Smaller structures, too; several times slower"),
    (32, "Fine", "As much as can be found; many times slower"),
];

impl ModelsForm {
    /// Makes the form for a recording. The folders hold what networks found, perhaps in it.
    pub(crate) fn new(chosen: Models, recording: PathBuf, folders: Vec<PathBuf>) -> Self {
        let (check, found) = (Asked::new(have_same_folders), Asked::new(find_the_same));
        Self { chosen, check, recording, folders, found, picking: Picking::default(), picked_field: 0 }
    }

    /// Returns `true` if networks were chosen before.
    pub(crate) fn is_known(&self) -> bool {
        !self.chosen.masks.as_os_str().is_empty() && !self.chosen.images.as_os_str().is_empty()
    }

    /// Takes the results of the threads, and checks what has changed.
    fn update(&mut self, backend: &Arc<dyn Backend>, ctx: &Context) {
        if let Some(folder) = self.picking.poll() {
            *self.field(self.picked_field) = folder;
        }
        self.check.poll();
        self.found.poll();
        let theirs = backend.clone();
        if self.is_known() {
            self.check.ask(&self.chosen, |models| {
                Task::start("models", ctx, move |task| theirs.check_models(&models, task))
            });
        }
        if self.is_usable() && !self.folders.is_empty() {
            let (theirs, recording, folders) =
                (backend.clone(), self.recording.clone(), self.folders.clone());
            self.found.ask(&self.chosen, |models| {
                Task::start("found before", ctx, move |task| {
                    theirs.found_before(&models, &recording, &folders, task)
                })
            });
        }
    }

    /// Returns `true` if nothing is wrong with the networks.
    fn is_usable(&self) -> bool {
        matches!(self.check.about(&self.chosen), Some(Ok(faults)) if faults.is_none())
    }

    /// Returns `true` while it is not known if the networks found something before.
    fn is_looking(&self) -> bool {
        !self.folders.is_empty() && self.found.about(&self.chosen).is_none()
    }

    /// Returns the folder of what the networks found in the recording before; `None` if there is none.
    pub(crate) fn found(&self) -> Option<&PathBuf> {
        self.found.about(&self.chosen)?.as_ref().ok()?.as_ref()
    }

    fn field(&mut self, index: usize) -> &mut PathBuf {
        match index {
            0 => &mut self.chosen.masks,
            1 => &mut self.chosen.images,
            _ => &mut self.chosen.texts,
        }
    }

    fn pick(&mut self, field: usize, title: &str, backend: Arc<dyn Backend>, ctx: &Context) {
        // Models usually lie beside each other.
        let known = [&self.chosen.masks, &self.chosen.images, &self.chosen.texts];
        let folder = known.into_iter().find_map(|path| path.parent()).map(Path::to_owned);
        let ask = PathAsk { title: title.to_owned(), kind: PathKind::Folder, folder };
        self.picking.ask(ask, backend, ctx);
        self.picked_field = field;
    }
}

/// Returns `true` if a check of one says everything about the other.
fn have_same_folders(a: &Models, b: &Models) -> bool {
    (&a.masks, &a.images, &a.texts) == (&b.masks, &b.images, &b.texts)
}

/// Returns `true` if both find the same in a recording, whatever words it is compared with.
fn find_the_same(a: &Models, b: &Models) -> bool {
    (&a.masks, &a.images, a.points_per_side) == (&b.masks, &b.images, b.points_per_side)
}

/// Shows the choice of what words are found by; returns `true` if it can be used.
pub(crate) fn words_ui(
    ui: &mut Ui,
    words: &mut Words,
    has_labels: bool,
    form: &mut ModelsForm,
    backend: &Arc<dyn Backend>,
) -> bool {
    ui.label(RichText::new("Words are found in it").strong());
    ui.add_enabled_ui(has_labels, |ui| {
        let label = if has_labels { "by its class labels" } else { "by class labels: it has none" };
        if ui.radio(*words == Words::Labels, label).clicked() {
            *words = Words::Labels;
        }
    });
    if ui
        .radio(matches!(words, Words::Models(_)), "by networks that find regions and tell what they show")
        .clicked()
    {
        *words = Words::Models(form.chosen.clone());
    }
    if ui.radio(*words == Words::Nothing, "only what you mark by hand").clicked() {
        *words = Words::Nothing;
    }
    let Words::Models(models) = words else { return true };
    form.update(backend, ui.ctx());
    let is_ready = ui.indent("models", |ui| models_ui(ui, form, backend)).inner;
    models.clone_from(&form.chosen);
    is_ready
}

/// Shows the fields of the networks and what is wrong with them; returns `true` if nothing is.
fn models_ui(ui: &mut Ui, form: &mut ModelsForm, backend: &Arc<dyn Backend>) -> bool {
    let faults = form.check.about(&form.chosen).cloned();
    let fault = |of: fn(&ModelFaults) -> &Option<String>| match &faults {
        Some(Ok(faults)) => of(faults).clone(),
        _ => None,
    };
    let rows = [
        (
            "Regions: folder with a Segment Anything",
            "Folder with a Segment Anything",
            fault(|f| &f.masks),
            true,
        ),
        (
            "What they show: folder with an image encoder",
            "Folder with an image encoder",
            fault(|f| &f.images),
            true,
        ),
        (
            "Words: folder with its text encoder; none for the built-in one",
            "Folder with a text encoder",
            fault(|f| &f.texts),
            false,
        ),
    ];
    for (index, (title, name, fault, is_needed)) in rows.into_iter().enumerate() {
        ui.label(caption(title));
        ui.horizontal(|ui| {
            let button = form.picking.button_ui(ui, "Choose…");
            if button.on_hover_text(name).clicked() {
                form.pick(index, name, backend.clone(), ui.ctx());
            }
            path_field(ui, name, form.field(index));
        });
        let missing = missing(form.field(index), is_needed);
        if let Some(text) = missing.or(fault) {
            ui.label(RichText::new(text).font(theme::small()).color(theme::AMBER));
        }
    }
    form.picking.note_ui(ui);
    ui.horizontal_wrapped(|ui| {
        ui.label(caption("Regions"));
        let options = DENSITIES.map(|(points, label, tip)| (points, label, tip.to_owned(), true));
        choice(ui, &mut form.chosen.points_per_side, &options);
    });
    let is_usable = form.is_usable();
    let (text, colour) = match &faults {
        _ if !form.is_known() => {
            ("The page about models says where such networks come from.".to_owned(), theme::TEXT_WEAK)
        }
        None => ("Trying the networks…".to_owned(), theme::TEXT_WEAK),
        Some(Err(problem)) => (problem.clone(), theme::ERROR),
        Some(Ok(_)) if is_usable && form.is_looking() => {
            ("Looking for what they found before…".to_owned(), theme::TEXT_WEAK)
        }
        Some(Ok(_)) if is_usable => ("These networks can be used.".to_owned(), theme::TEXT),
        Some(Ok(_)) => ("These networks cannot be used yet.".to_owned(), theme::AMBER),
    };
    ui.label(RichText::new(text).font(theme::small()).color(colour));
    is_usable && !form.is_looking()
}

/// Returns what is missing about a folder, which can be seen without opening anything.
fn missing(folder: &Path, is_needed: bool) -> Option<String> {
    if folder.as_os_str().is_empty() {
        return is_needed.then(|| "Choose a folder.".to_owned());
    }
    (!folder.exists()).then(|| "There is no such folder.".to_owned())
}
