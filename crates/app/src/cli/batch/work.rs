//! One step of one recording, by the code of its verb.

use super::{
    plan::Task,
    record::{Record, Status},
    steps::StepVerb,
};
use crate::{
    cli::{
        answers::ask,
        console::ProgressView,
        eval::EvalArgs,
        export::{self, ExportArgs},
        figures, remedy, train,
        verb::Run,
    },
    evaluation, jobs, memory, outputs,
    pictures::jpeg,
    text::one_line,
};
use serde_json::{Value, json};
use std::{
    any::Any,
    panic::{AssertUnwindSafe, catch_unwind},
    path::Path,
    time::Instant,
};
use surgtpgs_core::{Error, Result, files::write_whole, train::is_checkpoint};

/// Result of running a step.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Outcome {
    Done,
    Failed(String),
    /// Stopped by the user; the next run goes on.
    Stopped,
}

/// Pictures of the report, beside the results that they show.
pub(super) const RECONSTRUCTION: &str = "reconstruction.jpg";
pub(super) const ANSWERS: &str = "answers.jpg";

/// Number of frames shown of the reconstruction, and width of pictures in the report, px.
const SHOWN_FRAMES: usize = 3;
const PANEL_WIDTH: u32 = 400;

/// Runs a step that is not done. Returns an error if its output is in the way or if its record in `folder`
/// cannot be written; errors of the step itself are its outcome.
pub(super) fn run(folder: &Path, task: &mut Task, status: &Status, fingerprint: &str) -> Result<Outcome> {
    let record = Record::begun(fingerprint);
    make_room(task, status)?;
    record.write(folder, task.step)?;
    memory::forget_peak();
    let started = Instant::now();
    // A panic is a mistake of ours, and no reason to leave the other recordings undone.
    let result =
        catch_unwind(AssertUnwindSafe(|| work(&task.verb))).unwrap_or_else(|cause| Err(of_panic(&*cause)));
    let (record, outcome) = match result {
        Ok(report) => (record.done(&task.output, started.elapsed().as_secs_f64(), report), Outcome::Done),
        Err(Error::Cancelled) => return Ok(Outcome::Stopped),
        Err(error) => {
            let error = one_line(&remedy::message(&error));
            (record.failed(error.clone()), Outcome::Failed(error))
        }
    };
    record.write(folder, task.step)?;
    Ok(outcome)
}

fn of_panic(cause: &(dyn Any + Send)) -> Error {
    let text = cause.downcast_ref::<String>().map(String::as_str).or(cause.downcast_ref::<&str>().copied());
    let what = format!("the program itself failed: {}", text.unwrap_or("it does not say how"));
    Error::input(what, "This is a mistake in it, please report it.")
}

/// Lets the verb replace the result of an earlier run with other settings, or go on with an unfinished run
/// with the same settings. Fails if the output is there and no batch made it.
pub(super) fn make_room(task: &mut Task, status: &Status) -> Result<()> {
    if matches!(status, Status::New) && task.output.exists() {
        return Err(in_the_way(&task.output));
    }
    let goes_on = matches!(status, Status::Unfinished(_));
    match &mut task.verb {
        StepVerb::Prepare(args) => args.force = true,
        StepVerb::Train(args) => {
            let checkpoint = jobs::checkpoint_path(&task.output);
            if !goes_on && checkpoint.exists() {
                if matches!(status, Status::New) || !is_checkpoint(&checkpoint) {
                    return Err(in_the_way(&checkpoint));
                }
                // It is of other settings, or of another recording.
                jobs::remove_file(&checkpoint)?;
            }
            // Chapters that lie beside the scene are of these settings, too.
            args.resume = checkpoint.exists() || goes_on && !jobs::begun_chapters(&task.output).is_empty();
            args.force = true;
        }
        StepVerb::Eval(args) => args.force = true,
        StepVerb::Export(args) => args.force = true,
    }
    Ok(())
}

fn in_the_way(path: &Path) -> Error {
    let hint = "Move it away, or choose another folder with `--output`.";
    Error::input_at(path, "this is in the way and was not made by a batch", hint)
}

/// Runs the step and returns its report.
fn work(verb: &StepVerb) -> Result<Value> {
    match verb {
        StepVerb::Prepare(args) => args.run().map(|_| Value::Null),
        StepVerb::Train(args) => {
            let report = train::train(args)?;
            if report.finished { Ok(json!(report)) } else { Err(Error::Cancelled) }
        }
        StepVerb::Eval(args) => evaluate(args),
        StepVerb::Export(args) => export_found(args),
    }
}

fn evaluate(args: &EvalArgs) -> Result<Value> {
    let ([scene, sequence], Some(folder)) = (&args.paths[..], &args.output) else {
        return Err(Error::input("an evaluation needs a scene, a recording and a folder", ""));
    };
    let mut engine = args.open(scene, sequence)?;
    let inputs = engine.inputs(scene).with("the recording", sequence);
    let output = outputs::folder(folder, outputs::EVALUATION, &inputs, args.force)?;
    let mut view = ProgressView::default();
    let evaluation = evaluation::evaluate(&mut engine, args.extras(), &mut |p| view.show(p))?;
    evaluation::write_files(output.path(), &evaluation)?;
    let picture = figures::comparison(&mut engine, SHOWN_FRAMES, PANEL_WIDTH)?;
    write_whole(&output.path().join(RECONSTRUCTION), &jpeg(&picture)?)?;
    output.finish()?;
    Ok(json!(evaluation.report))
}

fn export_found(args: &ExportArgs) -> Result<Value> {
    let (mut engine, summary) = export::export(args, true)?;
    if !summary.complete {
        return Err(Error::Cancelled);
    }
    let frames = args.frames.of(engine.scene().num_frames())?;
    let questions = args.prompts.questions(engine.settings())?;
    let mut view = ProgressView::default();
    let answers = ask(&mut engine, &questions, &frames, &mut |p| view.show(p))?;
    drop(view);
    let picture = figures::answers(&mut engine, &answers, PANEL_WIDTH)?;
    if let Some(picture) = &picture {
        write_whole(&args.output.join(ANSWERS), &jpeg(picture)?)?;
    }
    Ok(json!({ "export": summary, "query": answers }))
}
