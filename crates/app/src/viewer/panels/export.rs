//! The export dialog: formats, look, frames and folder, and the number of files before the start.

use crate::viewer::{
    action::Action,
    backend::{
        Backend,
        paths::{PathAsk, PathKind, free_folder},
        ranges::included,
    },
    panels::{
        picking::Picking,
        widgets::{self, caption, choice, main_button, palette_ui, path_field},
    },
    shared::{Dialog, Shared},
    state::{content::Prompt, view_mode::ViewMode},
    text::{counted, sentence, thousands},
    theme,
};
use crate::{
    engine::Negatives,
    jobs::{ExportQuestion, ExportRequest},
    outputs,
};
use egui::{Context, DragValue, RichText, Ui};
use std::{
    path::{Path, PathBuf},
    sync::Arc,
};
use surgtpgs_core::{
    export::{ExportOptions, Format, FormatGroup, PictureSource, SegType, VideoFault, num_files},
    files::{is_free_folder, unfinished_kind},
    overlay::OverlayStyle,
};

/// Widths of exported overlays to choose from, px; `None` is the size of the recording.
const WIDTHS: [Option<u32>; 4] = [None, Some(960), Some(1280), Some(1920)];

/// The questions before an export.
struct Export {
    request: ExportRequest,
    /// First and last frame.
    range: (usize, usize),
    /// Ranges of frames that are left out.
    excluded: Vec<(usize, usize)>,
    /// Negatives of prompts without exceptions of their own.
    negatives: Negatives,
    /// Name of the open scene, after which a new folder is named.
    name: String,
    last_frame: usize,
    has_original: bool,
    picking: Picking,
}

/// The export dialog.
#[derive(Default)]
pub(crate) struct ExportDialog {
    export: Option<Export>,
}

impl Export {
    /// Makes the dialog for the visible prompts of the open scene.
    fn new(shared: &Shared) -> Option<Self> {
        let info = shared.info()?;
        let question = |p: &Prompt| ExportQuestion {
            question: shared.document.question(p),
            threshold: p.threshold,
            colour: p.colour,
            is_instrument: p.is_instrument,
        };
        let shows_original = shared.document.mode != ViewMode::Reconstruction && info.has_original;
        let options = ExportOptions {
            formats: vec![Format::Overlay, Format::Binary],
            source: if shows_original { PictureSource::Original } else { PictureSource::Reconstruction },
            look: shared.document.overlay,
            clean_up: shared.document.content().clean_up,
            captions: true,
            ..ExportOptions::default()
        };
        let request = ExportRequest {
            scene: info.path.clone(),
            folder: free_folder(&info.output_folder, &info.name, "export"),
            frames: Vec::new(),
            questions: shared.document.prompts().iter().filter(|p| p.is_visible).map(question).collect(),
            marks: shared.document.marks().all().to_vec(),
            options,
            replace: false,
            completes_same: true,
        };
        Some(Self {
            request,
            range: shared.playback.bounds(),
            excluded: shared.document.excluded().to_vec(),
            negatives: shared.document.comparison().common(),
            name: info.name.clone(),
            last_frame: info.num_frames.saturating_sub(1),
            has_original: info.has_original,
            picking: Picking::default(),
        })
    }

    /// Takes the answer of the system's dialog.
    fn poll(&mut self) {
        if let Some(folder) = self.picking.poll() {
            self.request.folder = folder_in(&folder, &self.name);
        }
    }

    /// Returns the frames that are exported.
    fn frames(&self) -> Vec<usize> {
        included(self.range, &self.excluded)
    }

    fn pick_folder(&mut self, backend: Arc<dyn Backend>, ctx: &Context) {
        let title = "Export into this folder".to_owned();
        let folder = self.request.folder.parent().map(Path::to_owned);
        self.picking.ask(PathAsk { title, kind: PathKind::Folder, folder }, backend, ctx);
    }
}

/// Returns the folder for an export of `name` after the user picked `folder`. This is `folder` if it is free
/// or holds an export to continue, and otherwise a new folder in it.
pub(crate) fn folder_in(folder: &Path, name: &str) -> PathBuf {
    match is_free_folder(folder) {
        Ok(true) => folder.to_owned(),
        _ if unfinished_kind(folder).as_deref() == Some(outputs::EXPORT) => folder.to_owned(),
        _ => free_folder(folder, name, "export"),
    }
}

impl ExportDialog {
    /// Shows the dialog, if it is open.
    pub(crate) fn ui(&mut self, ctx: &Context, shared: &Shared, actions: &mut Vec<Action>) {
        let is_wanted = shared.dialog == Some(Dialog::Export);
        let opened = shared.info().map(|info| &info.path);
        let is_valid = |e: &mut Export| is_wanted && Some(&e.request.scene) == opened;
        let kept = self.export.take_if(is_valid);
        let had_other = self.export.take().is_some();
        if !is_wanted {
            return;
        }
        let begin = || if had_other { None } else { Export::new(shared) };
        let Some(mut export) = kept.or_else(begin) else {
            actions.push(Action::CloseDialog);
            return;
        };
        export.poll();
        let content = |ui: &mut Ui| {
            ui.heading("Export masked frames");
            asking_ui(ui, &mut export, shared);
            export
        };
        let footer = |ui: &mut Ui, export: Export| (start_ui(ui, &export, shared, actions), export);
        let ((is_done, export), is_closed) =
            widgets::dialog_with_footer(ctx, "export", 560.0, content, footer);
        if is_done || is_closed {
            actions.push(Action::CloseDialog);
        }
        self.export = Some(export);
    }
}

/// Shows the settings of an export, each with what it leaves out.
fn asking_ui(ui: &mut Ui, export: &mut Export, shared: &Shared) {
    let names: Vec<_> = export.request.questions.iter().map(|q| format!("\"{}\"", q.question.text)).collect();
    let what = if names.is_empty() { "No visible prompt".to_owned() } else { names.join(", ") };
    ui.label(RichText::new(what).color(if names.is_empty() { theme::AMBER } else { theme::TEXT_WEAK }));
    let left_out = left_out(&export.request.questions, shared);
    if !left_out.is_empty() {
        warn(ui, format!("Nothing will be written for {}", left_out.join(", ")));
    }
    ui.add_space(6.0);
    formats_ui(ui, &mut export.request.options.formats);
    seg_type_ui(ui, &mut export.request.options);
    ui.separator();
    look_ui(ui, &mut export.request.options);
    ui.separator();
    frames_ui(ui, export);
    let num_unlearned = num_unlearned(&export.frames(), shared);
    if num_unlearned > 0 {
        let count = thousands(num_unlearned);
        warn(ui, format!("Frames that are not reconstructed yet are left out: {count}"));
    }
    ui.horizontal(|ui| {
        if export.picking.button_ui(ui, "Folder…").clicked() {
            export.pick_folder(shared.backend.clone(), &ui.ctx().clone());
        }
        path_field(ui, "Folder of the export", &mut export.request.folder);
    });
    export.picking.note_ui(ui);
    ui.label(caption("A provenance.json beside them says how they were made."));
}

/// Shows how many files will be written, and the buttons; returns `true` if the dialog is to be closed.
fn start_ui(ui: &mut Ui, export: &Export, shared: &Shared, actions: &mut Vec<Action>) -> bool {
    let frames = export.frames();
    ui.add_space(10.0);
    let is_ready = plan_ui(ui, &export.request, &frames, shared);
    ui.horizontal(|ui| {
        if ui.add_enabled(is_ready, main_button("Start export")).clicked() {
            let request = ExportRequest { frames, ..export.request.clone() };
            actions.push(Action::Export(Box::new((request, export.negatives.clone()))));
        }
        ui.button("Cancel").clicked()
    })
    .inner
}

/// Shows how many files an export of `frames` writes, or why it cannot be made. Returns `true` if it can.
fn plan_ui(ui: &mut Ui, request: &ExportRequest, frames: &[usize], shared: &Shared) -> bool {
    let ExportRequest { options, questions, .. } = request;
    let Some(info) = shared.info() else { return false };
    let fault = fault(options, frames, (info.width, info.height));
    let is_ready = !options.formats.is_empty() && !questions.is_empty() && fault.is_none();
    fault.into_iter().for_each(|text| warn(ui, text));
    let num_written = questions.len() - left_out(questions, shared).len();
    let count = match is_ready {
        true => num_files(&options.formats, frames.len() - num_unlearned(frames, shared), num_written),
        false => 0,
    };
    ui.label(RichText::new(format!("{} will be written", counted(count, "file", "files"))).strong());
    is_ready
}

fn warn(ui: &mut Ui, text: String) {
    ui.label(RichText::new(text).font(theme::small()).color(theme::AMBER));
}

/// Counts the frames that are not reconstructed yet.
fn num_unlearned(frames: &[usize], shared: &Shared) -> usize {
    shared.info().map_or(0, |info| frames.iter().filter(|frame| info.is_unlearned(**frame)).count())
}

/// Says why the frames of a recording, whose pictures have a size, cannot be exported in the chosen formats.
fn fault(options: &ExportOptions, frames: &[usize], size: (usize, usize)) -> Option<String> {
    let is_apart = frames.windows(2).any(|pair| pair[0] + 1 != pair[1]);
    if is_apart && options.formats.iter().any(|f| f.is_series()) {
        let text = "Frames are left out in between: videos, tables and volumes need them in one piece. Choose frames before or \
                    behind what is left out.";
        return Some(text.into());
    }
    let fault = VideoFault::of(options, size)?;
    Some(format!("{}. Choose another size, or leave the video out.", sentence(&fault.to_string())))
}

/// Names the questions that nothing will be written for, each with the reason. Those that have no answer yet
/// may be found.
fn left_out(questions: &[ExportQuestion], shared: &Shared) -> Vec<String> {
    let absence = |asked: &ExportQuestion| {
        let is_asked = |prompt: &&Prompt| shared.document.question(prompt) == asked.question;
        let prompt = shared.document.prompts().iter().find(is_asked)?;
        // Marks that wait are carried to the scene before it is asked.
        let is_marked = shared.document.marks().names().into_iter().any(|name| prompt.is_marked_as(name));
        let finding = shared.finding(prompt.id, &prompt.text).filter(|_| !is_marked)?;
        let answer = finding.answer.as_ref()?;
        let is_written = answer.is_exported(asked.threshold, asked.question.shows_nearest);
        (!is_written).then(|| format!("\"{}\" ({})", prompt.text, answer.absence.in_short()))
    };
    questions.iter().filter_map(absence).collect()
}

fn formats_ui(ui: &mut Ui, formats: &mut Vec<Format>) {
    for group in FormatGroup::ALL {
        ui.label(caption(group.label()));
        ui.horizontal_wrapped(|ui| {
            for format in group.formats() {
                let (label, explanation) = format.label();
                let mut is_on = formats.contains(&format);
                if ui.checkbox(&mut is_on, label).on_hover_text(explanation).changed() {
                    formats.retain(|f| *f != format);
                    if is_on {
                        formats.push(format);
                    }
                }
            }
        });
        ui.add_space(4.0);
    }
}

/// Shows the kinds of DICOM segmentations, if one is to be written.
fn seg_type_ui(ui: &mut Ui, options: &mut ExportOptions) {
    if options.formats.contains(&Format::DicomSeg) {
        ui.horizontal_wrapped(|ui| {
            ui.label("DICOM segmentation as");
            let kinds = SegType::ALL.map(|kind| (kind, kind.name(), kind.about().to_owned(), true));
            choice(ui, &mut options.seg_type, &kinds);
        });
    }
}

/// Shows the look of pictures with prompts drawn over them.
fn look_ui(ui: &mut Ui, options: &mut ExportOptions) {
    ui.horizontal_wrapped(|ui| {
        ui.label("Drawn as");
        let look = &mut options.look;
        choice(
            ui,
            &mut look.style,
            &OverlayStyle::ALL.map(|s| (s, s.label().0, s.label().1.to_owned(), true)),
        );
        if look.style.shows_scores() {
            palette_ui(ui, &mut look.palette);
        }
    });
    ui.horizontal_wrapped(|ui| {
        ui.label("Size");
        let label = |width: Option<u32>| match width {
            None => "as recorded",
            Some(960) => "960 wide",
            Some(1280) => "1280 wide",
            Some(_) => "1920 wide",
        };
        let tip = "Size of overlays and videos; lines and words stay sharp. Masks and data keep the recording's size";
        choice(ui, &mut options.width_px, &WIDTHS.map(|width| (width, label(width), tip.to_owned(), true)));
    });
    let tip =
        "Written into the upper left corner of overlays, videos and animations, and below contact sheets";
    ui.checkbox(&mut options.captions, "Write names, frame number and time").on_hover_text(tip);
    let tip = "Pictures travel without their caption; the record says it if it was left out";
    ui.checkbox(&mut options.stamp, "Write \"research use only\"").on_hover_text(tip);
}

fn frames_ui(ui: &mut Ui, export: &mut Export) {
    ui.horizontal_wrapped(|ui| {
        ui.label("Frames");
        // Frames are shown from 1 and stored from 0.
        let (mut from, mut to) = (export.range.0 + 1, export.range.1 + 1);
        let last = export.last_frame + 1;
        ui.add(DragValue::new(&mut from).range(1..=last)).on_hover_text("First frame");
        ui.label("to");
        ui.add(DragValue::new(&mut to).range(1..=last)).on_hover_text("Last frame");
        export.range = (from.min(to) - 1, to.max(from) - 1);
        if ui.button("All").clicked() {
            export.range = (0, export.last_frame);
        }
    });
    ui.horizontal_wrapped(|ui| {
        ui.label("Pictures from");
        let source = &mut export.request.options.source;
        ui.add_enabled_ui(export.has_original, |ui| {
            ui.radio_value(source, PictureSource::Original, "the recording");
        });
        ui.radio_value(source, PictureSource::Reconstruction, "the reconstruction");
    });
    if export.request.questions.len() > 1 {
        let exclusive = &mut export.request.options.exclusive;
        ui.checkbox(exclusive, "Each pixel belongs to one prompt only (the highest score)");
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use egui_kittest::{Harness, kittest::Queryable};

    #[test]
    fn every_format_is_offered() {
        let mut window =
            Harness::new_ui_state(|ui, formats: &mut Vec<Format>| formats_ui(ui, formats), Vec::new());
        for format in Format::ALL {
            window.get_by_label(format.label().0).click();
            window.run();
        }
        assert_eq!(*window.state(), Format::ALL);
    }

    #[test]
    fn what_a_video_cannot_show_is_said_before_the_start() {
        let said = |formats: &[Format], width_px: Option<u32>, frames: &[usize]| {
            let options = ExportOptions { formats: formats.to_vec(), width_px, ..Default::default() };
            fault(&options, frames, (4096, 2160))
        };
        let large = said(&[Format::Overlay, Format::Video], None, &[3, 4]).unwrap();
        assert!(large.starts_with("A video has at most 3840×2160 pixels, and"), "{large}");
        assert!(said(&[Format::Video], None, &[3, 5]).unwrap().contains("left out in between"));
        assert_eq!(said(&[Format::Overlay, Format::Video], Some(1920), &[3, 4]), None);
        assert_eq!(said(&[Format::Overlay], None, &[3, 5]), None);
    }
}
