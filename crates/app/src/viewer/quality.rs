//! Quality of a reconstruction: the match of its pictures with the recording, and of its class names with the
//! labels. The same as `surgtpgs eval`.

use super::{
    app::ViewerApp,
    export_dialog::free_folder,
    jobs::{Job, JobContext, JobEvent},
    theme,
    widgets::{caption, dialog, main_button, thousands},
};
use crate::evaluation::{self, EvalReport, Evaluation, FrameRow};
use egui::{Context, Grid, ProgressBar, RichText, ScrollArea, Ui};
use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
    sync::Arc,
};
use surgtpgs_core::files::Inputs;

/// Height of the window that the tables leave free; tables that do not fit are scrolled.
const REST_HEIGHT: f32 = 230.0;
const ROW_HEIGHT: f32 = 20.0;

/// State of the sheet, from measuring to saving.
pub(crate) struct Quality {
    /// Folder for the tables, and the name that it is derived from.
    folder: PathBuf,
    name: String,
    /// Scene and recording that are measured.
    inputs: Inputs,
    state: State,
}

enum State {
    Measuring(Job<Evaluation>),
    Measured(Arc<Evaluation>),
    Saving(Arc<Evaluation>, Job<()>),
    Saved(Arc<Evaluation>),
}

/// Click on the sheet.
enum Click {
    Nothing,
    Close,
    Save,
    Frame(usize),
}

impl Quality {
    /// Starts to measure the open scene.
    pub(crate) fn start(app: &ViewerApp, ctx: &Context) -> Option<Self> {
        let info = app.info()?;
        let (backend, scene) = (app.backend.clone(), info.path.clone());
        let job = Job::start("quality", ctx, move |job| backend.evaluate(&scene, job));
        let folder = free_folder(&info.output_folder, &info.name, "quality");
        let inputs = Inputs::none()
            .with("the scene", &info.path)
            .with_some("the scene's recording", info.sequence.as_deref());
        Some(Self { folder, name: info.name.clone(), inputs, state: State::Measuring(job) })
    }

    /// Takes the result of the thread; returns a problem, if there is one.
    pub(crate) fn poll(&mut self) -> Option<String> {
        let (next, problem) = match &mut self.state {
            State::Measuring(job) => match job.poll()? {
                JobEvent::Done(Ok(evaluation)) => (State::Measured(Arc::new(evaluation)), None),
                JobEvent::Done(Err(problem)) => return Some(problem.to_string()),
                _ => return None,
            },
            State::Saving(evaluation, job) => match job.poll()? {
                JobEvent::Done(Ok(())) => (State::Saved(evaluation.clone()), None),
                JobEvent::Done(Err(problem)) => {
                    // Another program may have taken the name.
                    let parent = self.folder.parent().unwrap_or(Path::new("")).to_owned();
                    self.folder = free_folder(&parent, &self.name, "quality");
                    (State::Measured(evaluation.clone()), Some(problem.to_string()))
                }
                _ => return None,
            },
            State::Measured(_) | State::Saved(_) => return None,
        };
        self.state = next;
        problem
    }

    pub(crate) fn is_measured(&self) -> bool {
        !matches!(self.state, State::Measuring(_))
    }

    fn save(&mut self, ctx: &Context) {
        let State::Measured(evaluation) = &self.state else { return };
        let (evaluation, folder) = (evaluation.clone(), self.folder.clone());
        let tables = evaluation.clone();
        let inputs = self.inputs.clone();
        let save = move |_: &JobContext| evaluation::write(&folder, &inputs, false, &tables);
        let job = Job::start("save quality", ctx, save);
        self.state = State::Saving(evaluation, job);
    }
}

/// Shows the sheet, if it is open.
pub(crate) fn quality_ui(ctx: &Context, app: &mut ViewerApp) {
    let Some(mut quality) = app.quality.take() else { return };
    let (click, is_closed) = dialog(ctx, "quality", 720.0, |ui| {
        ui.heading("Measured against the recording");
        match &quality.state {
            State::Measuring(job) => measuring_ui(ui, job),
            State::Measured(evaluation) | State::Saving(evaluation, _) | State::Saved(evaluation) => {
                let click = evaluation_ui(ui, evaluation);
                ui.add_space(10.0);
                saving_ui(ui, &quality).unwrap_or(click)
            }
        }
    });
    match click {
        Click::Save => quality.save(ctx),
        Click::Frame(frame) => {
            app.playback.pause();
            app.playback.seek(frame, ctx.input(|i| i.time));
            return;
        }
        Click::Close => return,
        Click::Nothing if is_closed => return,
        Click::Nothing => {}
    }
    app.quality = Some(quality);
}

fn measuring_ui(ui: &mut Ui, job: &Job<Evaluation>) -> Click {
    let progress = &job.progress;
    ui.label(format!("{} of {} frames", thousands(progress.done), thousands(progress.total)));
    ui.add(ProgressBar::new(progress.fraction()).desired_height(10.0).fill(theme::ACCENT));
    if ui.button("Stop").clicked() { Click::Close } else { Click::Nothing }
}

/// Shows the buttons and the folder of the tables.
fn saving_ui(ui: &mut Ui, quality: &Quality) -> Option<Click> {
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

fn pictures_ui(ui: &mut Ui, report: &EvalReport) {
    let depth = report.depth.map(|d| format!("{:.2} scene units ({:.1} %)", d.rmse, 100.0 * d.abs_rel));
    let db = |value: Option<f64>| value.map(|v| format!("{v:.2} dB"));
    let rows = [
        ("PSNR", db(report.psnr_masked_db), "Inside the masks, that is without instruments"),
        ("PSNR, whole picture", db(report.psnr_db), "Instruments, which are not reconstructed, count too"),
        ("SSIM", share(report.ssim), "How alike the structures of both pictures are, 0 to 1"),
        ("Depth error", depth, "Root of the mean square, and the mean share of the depth"),
    ];
    Grid::new("pictures").num_columns(2).spacing([18.0, 4.0]).show(ui, |ui| {
        for (name, value, tip) in rows {
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
        for (name, class) in all.chain(masks.threshold.classes.iter().map(|(n, c)| (n.as_str(), c))) {
            ui.label(name);
            for value in [class.iou, class.dice, class.boundary_f, class.precision, class.recall] {
                ui.label(text(share(value)));
            }
            ui.end_row();
        }
    });
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
