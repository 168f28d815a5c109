//! Quality of a reconstruction: the match of its pictures with the recording, and of its class names with the
//! labels. The same as `surgtpgs eval`.

use crate::evaluation::{self, EvalReport, Evaluation, FrameRow};
use crate::viewer::{
    action::Action,
    backend::{
        Info,
        paths::free_folder,
        task::{Task, TaskContext, TaskEvent},
    },
    panels::widgets::{caption, dialog, main_button},
    remedy::statement,
    shared::{Dialog, Shared},
    text::thousands,
    theme,
};
use egui::{Context, Grid, ProgressBar, RichText, ScrollArea, Ui};
use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
    sync::Arc,
};
use surgtpgs_core::{files::Inputs, metrics::ClassSummary};

/// Height of the window that the tables leave free; tables that do not fit are scrolled.
const REST_HEIGHT: f32 = 230.0;
const ROW_HEIGHT: f32 = 20.0;

/// A measurement, from measuring to saving.
struct Measurement {
    /// The scene that is measured.
    info: Info,
    /// Ranges of frames that are not measured.
    left_out: Vec<(usize, usize)>,
    /// Folder for the tables.
    folder: PathBuf,
    /// Files that are measured: the scene and its recording.
    inputs: Inputs,
    state: State,
}

enum State {
    Measuring(Task<Evaluation>),
    Measured(Arc<Evaluation>),
    Saving(Arc<Evaluation>, Task<()>),
    Saved(Arc<Evaluation>),
}

/// Click on the sheet.
enum Click {
    Nothing,
    Close,
    Save,
    Frame(usize),
}

/// The dialog about quality.
#[derive(Default)]
pub(crate) struct QualityDialog {
    measurement: Option<Measurement>,
    /// `true` if the dialog was shown in the last pass.
    was_shown: bool,
}

impl Measurement {
    /// Starts to measure the open scene.
    fn start(shared: &Shared, ctx: &Context) -> Option<Self> {
        let info = shared.info()?;
        let (backend, scene) = (shared.backend.clone(), info.path.clone());
        let left_out = shared.document.excluded().to_vec();
        let without = left_out.clone();
        let task = Task::start("quality", ctx, move |task| backend.evaluate(&scene, &without, task));
        let folder = free_folder(&info.output_folder, &info.name, "quality");
        let inputs = Inputs::none()
            .with("the scene", &info.path)
            .with_some("the scene's recording", info.sequence.as_deref());
        Some(Self { info: info.clone(), left_out, folder, inputs, state: State::Measuring(task) })
    }

    /// Returns `true` if what is open would be measured in the same way.
    fn is_about_open(&self, shared: &Shared) -> bool {
        shared.info() == Some(&self.info) && self.left_out == shared.document.excluded()
    }

    /// Takes the result of the thread; returns a problem, if there is one.
    fn poll(&mut self) -> Option<String> {
        let (next, problem) = match &mut self.state {
            State::Measuring(task) => match task.poll()? {
                TaskEvent::Done(Ok(evaluation)) => (State::Measured(Arc::new(evaluation)), None),
                TaskEvent::Done(Err(problem)) => return Some(statement(&problem)),
                _ => return None,
            },
            State::Saving(evaluation, task) => match task.poll()? {
                TaskEvent::Done(Ok(())) => (State::Saved(evaluation.clone()), None),
                TaskEvent::Done(Err(problem)) => {
                    // Another program may have taken the name.
                    let parent = self.folder.parent().unwrap_or(Path::new("")).to_owned();
                    self.folder = free_folder(&parent, &self.info.name, "quality");
                    (State::Measured(evaluation.clone()), Some(statement(&problem)))
                }
                _ => return None,
            },
            State::Measured(_) | State::Saved(_) => return None,
        };
        self.state = next;
        problem
    }

    fn is_measured(&self) -> bool {
        !matches!(self.state, State::Measuring(_))
    }

    fn save(&mut self, ctx: &Context) {
        let State::Measured(evaluation) = &self.state else { return };
        let (evaluation, folder) = (evaluation.clone(), self.folder.clone());
        let tables = evaluation.clone();
        let inputs = self.inputs.clone();
        let save = move |_: &TaskContext| evaluation::write(&folder, &inputs, false, &tables);
        let task = Task::start("save quality", ctx, save);
        self.state = State::Saving(evaluation, task);
    }
}

impl QualityDialog {
    /// Shows the dialog, if it is open.
    pub(crate) fn ui(&mut self, ctx: &Context, shared: &Shared, actions: &mut Vec<Action>) {
        let is_wanted = shared.dialog == Some(Dialog::Quality);
        let was_shown = std::mem::replace(&mut self.was_shown, is_wanted);
        let measurement = self.measurement.take().filter(|m| m.is_about_open(shared));
        if !is_wanted {
            // Measuring takes long: what was measured is shown when the dialog is opened again.
            self.measurement = measurement.filter(Measurement::is_measured);
            return;
        }
        let begin = || if was_shown { None } else { Measurement::start(shared, ctx) };
        let Some(mut quality) = measurement.or_else(begin) else {
            // Another scene was opened meanwhile.
            actions.push(Action::CloseDialog);
            return;
        };
        if let Some(problem) = quality.poll() {
            actions.push(Action::Report(problem));
            if !quality.is_measured() {
                actions.push(Action::CloseDialog);
                return;
            }
        }
        match quality_ui(ctx, &mut quality) {
            Click::Save => quality.save(ctx),
            Click::Frame(frame) => actions.extend([Action::GoTo(frame), Action::CloseDialog]),
            Click::Close => actions.push(Action::CloseDialog),
            Click::Nothing => {}
        }
        self.measurement = Some(quality);
    }
}

fn quality_ui(ctx: &Context, quality: &mut Measurement) -> Click {
    let (click, is_closed) = dialog(ctx, "quality", 720.0, |ui| {
        ui.heading("Measured against the recording");
        match &quality.state {
            State::Measuring(task) => measuring_ui(ui, task),
            State::Measured(evaluation) | State::Saving(evaluation, _) | State::Saved(evaluation) => {
                let click = evaluation_ui(ui, evaluation);
                ui.add_space(10.0);
                saving_ui(ui, quality).unwrap_or(click)
            }
        }
    });
    if is_closed && matches!(click, Click::Nothing) { Click::Close } else { click }
}

fn measuring_ui(ui: &mut Ui, task: &Task<Evaluation>) -> Click {
    let progress = &task.progress;
    ui.label(format!("{} of {} frames", thousands(progress.done), thousands(progress.total)));
    ui.add(ProgressBar::new(progress.fraction()).desired_height(10.0).fill(theme::ACCENT));
    if ui.button("Stop").clicked() { Click::Close } else { Click::Nothing }
}

/// Shows the buttons and the folder of the tables.
fn saving_ui(ui: &mut Ui, quality: &Measurement) -> Option<Click> {
    let mut click = None;
    ui.horizontal(|ui| {
        if ui.add(main_button("Close")).clicked() {
            click = Some(Click::Close);
        }
        let folder = quality.folder.display().to_string();
        match &quality.state {
            State::Saving(..) => drop(ui.label(caption("Saving…"))),
            State::Saved(_) => drop(ui.add(egui::Label::new(caption(format!("Saved in {folder}"))).truncate())),
            _ => {
                let tip = "Every frame and class as CSV and JSON, which class is taken for which, and pictures of what is wrong";
                if ui.button("Save tables").on_hover_text(tip).clicked() {
                    click = Some(Click::Save);
                }
                ui.add(egui::Label::new(caption(folder)).truncate());
            }
        }
    });
    click
}

fn evaluation_ui(ui: &mut Ui, evaluation: &Evaluation) -> Click {
    let report = &evaluation.report;
    if report.held_out {
        let text = format!("{} frames that the training did not see", thousands(report.frames));
        ui.label(caption(text));
    } else {
        let text =
            "No frame was held out of training: these figures are of frames that the scene was trained on.";
        ui.label(RichText::new(text).font(theme::small()).color(theme::AMBER));
    }
    ui.add_space(6.0);
    let height = (ui.ctx().content_rect().height() - REST_HEIGHT).max(120.0);
    let area = ScrollArea::both().max_height(height).min_scrolled_height(height);
    area.show(ui, |ui| {
        ui.spacing_mut().interact_size.y = ROW_HEIGHT;
        pictures_ui(ui, report);
        classes_ui(ui, report);
        frames_ui(ui, evaluation)
    })
    .inner
}

/// Name of the PSNR of frames that training saw, beside that of frames that were held out.
const TRAINING_PSNR: &str = "PSNR of training frames";

fn pictures_ui(ui: &mut Ui, report: &EvalReport) {
    let depth = report.depth.map(|d| format!("{:.2} scene units ({:.1} %)", d.rmse, 100.0 * d.abs_rel));
    let db = |value: Option<f64>| value.map(|v| format!("{v:.2} dB"));
    let rows = [
        ("PSNR", db(report.psnr_masked_db), "Inside the masks, that is without instruments"),
        (
            "A blend of the frames around",
            db(report.blend_psnr_db),
            "PSNR of the mean of the frames before and after, which training saw: a reconstruction should beat it",
        ),
        (
            "The same, moved by flow",
            db(report.flow_psnr_db),
            "PSNR of the frames before and after, each moved half way by optical flow",
        ),
        (TRAINING_PSNR, db(report.train_psnr_db), "How well the frames are learned that training saw"),
        ("PSNR, whole picture", db(report.psnr_db), "Instruments, which are not reconstructed, count too"),
        ("SSIM", share(report.ssim), "How alike the structures of both pictures are, 0 to 1"),
        ("Depth error", depth, "Root of the mean square, and the mean share of the depth"),
    ];
    Grid::new("pictures").num_columns(2).spacing([18.0, 4.0]).show(ui, |ui| {
        // Where nothing was held out, the first row says it already.
        for (name, value, tip) in rows.into_iter().filter(|row| report.held_out || row.0 != TRAINING_PSNR) {
            ui.label(name).on_hover_text(tip);
            ui.label(value.unwrap_or_else(|| "unknown".into()));
            ui.end_row();
        }
    });
}

fn classes_ui(ui: &mut Ui, report: &EvalReport) {
    ui.add_space(8.0);
    let Some(masks) = &report.masks else {
        ui.label(caption(
            "No masks to measure: it takes a recording with labels, and a reconstruction with features.",
        ));
        return;
    };
    Grid::new("classes").num_columns(6).spacing([18.0, 4.0]).striped(true).show(ui, |ui| {
        let heads = [
            ("Class", "By its name, with the usual threshold"),
            ("IoU", "Pixels of both by pixels of either: 1 is right, 0 is wrong"),
            ("Dice", "Twice the pixels of both by the pixels of each"),
            ("Border F", "How well the borders agree"),
            ("Precision", "Share of what was found that is right"),
            ("Recall", "Share of what is there that was found"),
        ];
        for (head, tip) in heads {
            ui.label(RichText::new(head).strong()).on_hover_text(tip);
        }
        ui.end_row();
        let all = std::iter::once(("All", &masks.threshold.all));
        let classes = masks.threshold.classes.iter().map(|(n, c)| (n.as_str(), c));
        for (name, class) in all.chain(classes.filter(|(_, class)| !is_false(class))) {
            ui.label(name);
            for value in [class.iou, class.dice, class.boundary_f, class.precision, class.recall] {
                ui.label(text(share(value)));
            }
            ui.end_row();
        }
    });
    let names: Vec<&str> = masks
        .threshold
        .classes
        .iter()
        .filter(|(_, class)| is_false(class))
        .map(|(n, _)| n.as_str())
        .collect();
    if !names.is_empty() {
        let text = format!("Found, though nothing is labelled so on these frames: {}", names.join(", "));
        ui.label(RichText::new(text).font(theme::small()).color(theme::AMBER));
    }
}

/// Returns `true` for a class that was found, but is labelled nowhere.
fn is_false(class: &ClassSummary) -> bool {
    class.labelled == 0 && class.precision.is_some()
}

/// Shows a row per frame: PSNR and SSIM, then the IoU of every class that is labelled or found there.
fn frames_ui(ui: &mut Ui, evaluation: &Evaluation) -> Click {
    ui.add_space(8.0);
    let mut iou: BTreeMap<&str, BTreeMap<usize, f64>> = BTreeMap::new();
    for row in evaluation.class_rows() {
        let of_class = iou.entry(&row.class).or_default();
        of_class.extend(row.iou.map(|iou| (row.frame, iou)));
    }
    iou.retain(|_, frames| !frames.is_empty());
    let mut click = Click::Nothing;
    if !iou.is_empty() {
        ui.label(caption("Frame by frame, with the IoU of each class"));
    }
    Grid::new("frames").num_columns(3 + iou.len()).spacing([18.0, 4.0]).striped(true).show(ui, |ui| {
        for head in ["Frame", "PSNR", "SSIM"].into_iter().chain(iou.keys().copied()) {
            ui.label(RichText::new(head).strong());
        }
        ui.end_row();
        for FrameRow { frame, psnr_masked_db, ssim, .. } in &evaluation.frames {
            let go = ui.button(format!("Frame {}", frame + 1)).on_hover_text("Go to this frame");
            if go.clicked() {
                click = Click::Frame(*frame);
            }
            ui.label(text(psnr_masked_db.map(|v| format!("{v:.2} dB"))));
            ui.label(text(share(*ssim)));
            for frames in iou.values() {
                ui.label(text(share(frames.get(frame).copied())));
            }
            ui.end_row();
        }
    });
    click
}

fn share(value: Option<f64>) -> Option<String> {
    value.map(|v| format!("{v:.3}"))
}

/// Formats a value, or a dash where there was nothing to measure, which is not zero.
fn text(value: Option<String>) -> String {
    value.unwrap_or_else(|| "–".into())
}
