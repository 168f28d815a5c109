//! `surgtpgs eval`: the results of an evaluation as text, JSON and files.

use super::{
    args::{MarkArgs, RelevancyArgs, SceneArgs},
    console::{ProgressView, print_report, say, watch_interrupts},
    verb::{Exit, Run},
};
use crate::{
    engine::{BackendChoice, Engine},
    evaluation::{Evaluation, Extras, as_text, evaluate, evaluate_masks, write_files},
    jobs::{Material, Observer, Progress},
    memory::{Work, require_for},
    outputs,
};
use clap::Args;
use std::path::{Path, PathBuf};
use surgtpgs_core::{
    Result,
    files::{Inputs, OutputFolder},
    metrics::PredictedMasks,
};

/// Compare a scene, or another program's masks, with the recording: PSNR, SSIM, depth, IoU, Dice, times
#[derive(Debug, Args)]
pub(super) struct EvalArgs {
    /// A scene and the recording it was trained on; with --masks the recording alone
    #[arg(value_name = "[SCENE] SEQ", num_args = 1..=2, required = true)]
    pub(super) paths: Vec<PathBuf>,
    /// Score the masks in this folder instead of a scene: FRAME_CLASS.png or CLASS/FRAME.png (white =
    /// found, or opaque), FRAME.png (class ids), or K/CLASS.png for the K-th held-out frame; a frame with no
    /// mask at all is not looked at
    #[arg(long, value_name = "DIR", conflicts_with_all = ["marks", "marks_model"])]
    masks: Option<PathBuf>,
    /// Marks by hand; then frames with a mark are not looked at
    #[command(flatten)]
    marks: MarkArgs,
    /// Also write tables, the report with every frame and class, and pictures of errors into this folder
    #[arg(short, long, value_name = "DIR")]
    pub(super) output: Option<PathBuf>,
    /// Replace an earlier evaluation in that folder, once the new one is whole
    #[arg(long, requires = "output")]
    pub(super) force: bool,
    /// Also measure LPIPS with this model: two float images [1,3,height,width] of -1 to 1 in, one number out
    #[arg(long, value_name = "MODEL.onnx", conflicts_with = "masks")]
    pub(super) lpips: Option<PathBuf>,
    /// Also measure PSNR with cameras that are fitted to the very frames: what the estimated path costs
    #[arg(long, conflicts_with = "masks")]
    fit_cameras: bool,
    /// Device to render on
    #[arg(long, value_enum, default_value_t = BackendChoice::Auto)]
    backend: BackendChoice,
    /// Options for asking class names
    #[command(flatten)]
    relevancy: RelevancyArgs,
    /// Report as JSON
    #[arg(long)]
    json: bool,
}

/// An evaluation, with notes for the user and the folder that it is to be written into.
struct Evaluated {
    evaluation: Evaluation,
    output: Option<OutputFolder>,
    notes: Vec<String>,
}

impl Run for EvalArgs {
    fn run(&self) -> Result<Exit> {
        watch_interrupts();
        let mut view = ProgressView::default();
        let mut observer = |p: &Progress<'_>| view.show(p);
        let Evaluated { evaluation, output, notes } = match (&self.masks, &self.paths[..]) {
            (None, [scene, sequence]) => self.evaluate_scene(scene, sequence, &mut observer)?,
            (Some(folder), [path]) => self.evaluate_masks(folder, path, &mut observer)?,
            (None, _) => return usage("give a scene and its recording"),
            (Some(_), _) => return usage("with --masks, give the recording alone"),
        };
        drop(view);
        notes.iter().for_each(|note| say(&format!("note: {note}")));
        let report = &evaluation.report;
        if !report.held_out && self.masks.is_none() && self.marks.marks.is_none() {
            say(
                "no frame was held out of training: these figures are of frames that the scene was trained on",
            );
        }
        if report.iou.is_none() {
            say("no IoU: it needs a scene with features and a recording with label masks");
        }
        if let Some(output) = output {
            write_files(output.path(), &evaluation)?;
            output.finish()?;
        }
        print_report(report, &as_text(report), self.json)?;
        Ok(Exit::Done)
    }

    fn output(&self) -> Option<&Path> {
        self.output.as_deref()
    }
}

impl EvalArgs {
    /// Opens the engine of a scene with its recording, and with the marks.
    pub(super) fn open(&self, scene: &Path, sequence: &Path) -> Result<Engine> {
        let scene = SceneArgs { scene: scene.to_owned(), backend: self.backend };
        let mut engine = scene.open(&self.relevancy, Some(sequence.to_owned()))?;
        self.marks.give_to(&mut engine)?;
        Ok(engine)
    }

    /// Measures that are taken beside the usual ones.
    pub(super) fn extras(&self) -> Extras<'_> {
        Extras { lpips: self.lpips.as_deref(), fits_cameras: self.fit_cameras, left_out: &[] }
    }

    fn evaluate_scene(
        &self,
        scene: &Path,
        sequence: &Path,
        observer: &mut Observer<'_>,
    ) -> Result<Evaluated> {
        let mut engine = self.open(scene, sequence)?;
        let inputs = engine.inputs(scene).with("the recording", sequence);
        let output = self.claim(&inputs)?;
        let evaluation = evaluate(&mut engine, self.extras(), observer)?;
        let missing = without("marks", &evaluation.report.classes_without_masks);
        Ok(Evaluated { evaluation, output, notes: missing.into_iter().collect() })
    }

    fn evaluate_masks(&self, folder: &Path, path: &Path, observer: &mut Observer<'_>) -> Result<Evaluated> {
        let material = Material::open(path)?;
        let sequence = material.sequence();
        require_for(&Work::Reading(sequence))?;
        let inputs = material.inputs(path).with("the masks", folder);
        let mut masks = PredictedMasks::open(folder, sequence)?;
        let output = self.claim(&inputs)?;
        let evaluation = evaluate_masks(&mut masks, sequence, observer)?;
        let missing = without("masks", &evaluation.report.classes_without_masks);
        Ok(Evaluated { evaluation, output, notes: masks.notes().into_iter().chain(missing).collect() })
    }

    /// Takes the folder that the files are written into, if they are wanted.
    fn claim(&self, inputs: &Inputs) -> Result<Option<OutputFolder>> {
        let claim = |folder: &PathBuf| outputs::folder(folder, outputs::EVALUATION, inputs, self.force);
        self.output.as_ref().map(claim).transpose()
    }
}

/// Names the classes without any masks, or marks, as `what` says; `None` if there is none.
fn without(what: &str, classes: &[String]) -> Option<String> {
    let counts = if classes.len() == 1 { "it counts" } else { "they count" };
    let names = classes.join(", ");
    (!classes.is_empty()).then(|| format!("no {what} of {names}: {counts} as not found"))
}

fn usage(what: &str) -> Result<Exit> {
    say(&format!("error: {what} (see `surgtpgs eval --help`)"));
    Ok(Exit::Usage)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn classes_without_masks_or_marks_are_named() {
        let note = |what: &str, names: &[&str]| {
            without(what, &names.iter().map(|n| (*n).to_owned()).collect::<Vec<_>>())
        };
        assert_eq!(note("masks", &[]), None);
        assert_eq!(note("masks", &["fat"]).unwrap(), "no masks of fat: it counts as not found");
        let both = note("marks", &["liver", "fat"]).unwrap();
        assert_eq!(both, "no marks of liver, fat: they count as not found");
    }
}
