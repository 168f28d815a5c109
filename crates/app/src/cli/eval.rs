//! `surgtpgs eval`: the results of an evaluation as text, JSON and files.

use super::{
    Exit,
    console::{ProgressView, print, print_json, say, watch_interrupts},
    open_engine,
};
use crate::{
    args::EvalArgs,
    engine::Engine,
    evaluation::{as_text, evaluate, evaluate_masks, write_files},
    jobs::{Material, Progress},
    memory::{Work, require_for},
    outputs,
};
use std::path::Path;
use surgtpgs_core::{Result, files::Inputs, metrics::PredictedMasks};

pub(super) fn run(args: &EvalArgs) -> Result<Exit> {
    watch_interrupts();
    let take = |inputs: &Inputs| {
        let folder = args.output.as_deref();
        folder.map(|folder| outputs::folder(folder, outputs::EVALUATION, inputs, args.force)).transpose()
    };
    let mut view = ProgressView::default();
    let mut observer = |p: &Progress<'_>| view.show(p);
    let mut notes = Vec::new();
    let (output, evaluation) = match (&args.masks, &args.paths[..]) {
        (None, [scene, sequence]) => {
            let mut engine = open(args, scene, sequence)?;
            let inputs = outputs::inputs_of_engine(scene, &engine).with("the recording", sequence);
            (take(&inputs)?, evaluate(&mut engine, args.lpips.as_deref(), &mut observer)?)
        }
        (Some(folder), [path]) => {
            let material = Material::open(path)?;
            let sequence = material.sequence();
            require_for(&Work::Reading(sequence))?;
            let inputs = outputs::inputs_of_material(path, &material).with("the masks", folder);
            let mut masks = PredictedMasks::open(folder, sequence)?;
            let output = take(&inputs)?;
            let evaluation = evaluate_masks(&mut masks, sequence, &mut observer)?;
            notes = masks.notes();
            (output, evaluation)
        }
        (None, _) => return usage("give a scene and its recording"),
        (Some(_), _) => return usage("with --masks, give the recording alone"),
    };
    drop(view);
    notes.iter().for_each(|note| say(&format!("note: {note}")));
    let report = &evaluation.report;
    if !report.held_out && args.masks.is_none() {
        say("no frame was held out of training: these figures are of frames that the scene was trained on");
    }
    if report.iou.is_none() {
        say("no IoU: it needs a scene with features and a recording with label masks");
    }
    if let Some(output) = output {
        write_files(output.path(), &evaluation)?;
        output.finish()?;
    }
    if args.json {
        print_json(report)?;
    } else {
        print(&as_text(report))?;
    }
    Ok(Exit::Done)
}

/// Opens the engine of a scene with its recording.
pub(super) fn open(args: &EvalArgs, scene: &Path, sequence: &Path) -> Result<Engine> {
    let scene = args.scene(scene);
    open_engine(&scene, args.relevancy.engine_options(&scene, Some(sequence.to_owned())))
}

fn usage(what: &str) -> Result<Exit> {
    say(&format!("error: {what} (see `surgtpgs eval --help`)"));
    Ok(Exit::Usage)
}
