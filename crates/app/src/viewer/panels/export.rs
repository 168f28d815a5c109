//! The export dialog: formats, look, frames and folder, and the number of files before the start.

use crate::viewer::{
    action::Action,
    backend::{
        Backend,
        paths::{PathAsk, PathKind},
        ranges::included,
    },
    panels::{
        folder::free_folder,
        picking::Picking,
        widgets::{self, caption, choice, main_button, palette_ui, path_field},
    },
    shared::{Dialog, Shared},
    state::{content::Prompt, view_mode::ViewMode},
    text::thousands,
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
    export::{ExportOptions, Format, FormatGroup, PictureSource, SegType, num_files},
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
        let (is_done, is_closed) = widgets::dialog(ctx, "export", 560.0, |ui| {
            ui.heading("Export masked frames");
            asking_ui(ui, &mut export, shared, actions)
        });
        if is_done || is_closed {
            actions.push(Action::CloseDialog);
        }
        self.export = Some(export);
    }
}

/// Shows the settings of an export; returns `true` if the dialog is to be closed.
fn asking_ui(ui: &mut Ui, export: &mut Export, shared: &Shared, actions: &mut Vec<Action>) -> bool {
    let names: Vec<_> = export.request.questions.iter().map(|q| format!("\"{}\"", q.question.text)).collect();
    let what = if names.is_empty() { "No visible prompt".to_owned() } else { names.join(", ") };
    ui.label(RichText::new(what).color(if names.is_empty() { theme::AMBER } else { theme::TEXT_WEAK }));
    ui.add_space(6.0);
    formats_ui(ui, &mut export.request.options.formats);
    seg_type_ui(ui, &mut export.request.options);
    ui.separator();
    look_ui(ui, &mut export.request.options);
    ui.separator();
    frames_ui(ui, export);
    ui.horizontal(|ui| {
        if export.picking.button_ui(ui, "Folder…").clicked() {
            export.pick_folder(shared.backend.clone(), &ui.ctx().clone());
        }
        path_field(ui, "Folder of the export", &mut export.request.folder);
    });
    export.picking.note_ui(ui);
    ui.add_space(10.0);
    let (frames, ExportRequest { options, questions, .. }) = (export.frames(), &export.request);
    let is_apart = frames.windows(2).any(|pair| pair[0] + 1 != pair[1]);
    let has_gaps = is_apart && options.formats.iter().any(|f| f.is_series());
    if has_gaps {
        let text = "Frames are left out in between: videos, tables and volumes need them in one piece. Choose frames before or \
                    behind what is left out.";
        ui.label(RichText::new(text).font(theme::small()).color(theme::AMBER));
    }
    let is_ready = !options.formats.is_empty() && !questions.is_empty() && !has_gaps;
    let unlearned = |frame: &&usize| shared.info().is_some_and(|info| info.is_unlearned(**frame));
    let num_left_out = frames.iter().filter(unlearned).count();
    let num_shown = frames.len() - num_left_out;
    let count = if is_ready { num_files(&options.formats, num_shown, questions.len()) } else { 0 };
    ui.label(RichText::new(format!("{} files will be written", thousands(count))).strong());
    if num_left_out > 0 {
        let text = format!("Frames that are not reconstructed yet are left out: {}", thousands(num_left_out));
        ui.label(RichText::new(text).font(theme::small()).color(theme::AMBER));
    }
    ui.label(caption("A provenance.json beside them says how they were made."));
    ui.horizontal(|ui| {
        if ui.add_enabled(is_ready, main_button("Start export")).clicked() {
            let request = ExportRequest { frames, ..export.request.clone() };
            actions.push(Action::Export(Box::new((request, export.negatives.clone()))));
        }
        ui.button("Cancel").clicked()
    })
    .inner
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
            let kinds = SegType::ALL.map(|kind| (kind, kind.label().0, kind.label().1.to_owned(), true));
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
    let tip = "Written into the upper left corner of overlays, videos and animations";
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
}
