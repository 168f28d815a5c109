//! `surgtpgs eval`: what an evaluation comes to, as text, JSON and files.

use super::{
    Exit,
    console::{ProgressView, print, print_json, say, watch_interrupts},
    open_engine,
};
use crate::{
    args::EvalArgs,
    engine::Engine,
    evaluation::{as_text, evaluate, evaluate_masks, write_files},
    jobs::Progress,
    memory::{Work, require_for},
    outputs,
};
use std::path::Path;
use surgtpgs_core::{Result, files::Inputs, metrics::PredictedMasks, prepare::Prepared, sequence::Sequence};

pub(super) fn run(args: &EvalArgs) -> Result<Exit> {
    watch_interrupts();
    let inputs = args
        .paths
        .iter()
        .fold(Inputs::none(), |inputs, path| inputs.with("the scene or its recording", path));
    let inputs = inputs.with_some("the masks", args.masks.as_deref());
    let take = |folder| outputs::folder(folder, outputs::EVALUATION, &inputs, args.force);
    let output = args.output.as_deref().map(take).transpose()?;
    let mut view = ProgressView::default();
    let mut observer = |p: &Progress<'_>| view.show(p);
    let mut notes = Vec::new();
    let evaluation = match (&args.masks, &args.paths[..]) {
        (None, [scene, sequence]) => {
            evaluate(&mut open(args, scene, sequence)?, args.lpips.as_deref(), &mut observer)?
        }
        (Some(folder), [sequence]) => {
            let prepared = Prepared::is_prepared(sequence);
            let sequence =
                if prepared { Prepared::open(sequence)?.sequence } else { Sequence::open(sequence)? };
            require_for(&Work::Reading(&sequence))?;
            let mut masks = PredictedMasks::open(folder, &sequence)?;
            let evaluation = evaluate_masks(&mut masks, &sequence, &mut observer)?;
            notes = masks.notes();
            evaluation
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

/// The engine of a scene with its recording.
pub(super) fn open(args: &EvalArgs, scene: &Path, sequence: &Path) -> Result<Engine> {
    let scene = args.scene(scene);
    open_engine(&scene, args.relevancy.engine_options(&scene, Some(sequence.to_owned())))
}

fn usage(what: &str) -> Result<Exit> {
    say(&format!("error: {what} (see `surgtpgs eval --help`)"));
    Ok(Exit::Usage)
}
