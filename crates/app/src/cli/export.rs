//! `surgtpgs export`: masked frames with a record of how they were made.

use super::{
    Exit,
    console::{self, ProgressView, print, print_json, say},
    open_engine,
};
use crate::{
    args::{ExportArgs, FrameRange},
    engine::Engine,
    jobs::{self, ExportRequest},
};
use surgtpgs_core::{
    Error, Result,
    export::{ExportOptions, ExportSummary, num_files},
    overlay::OverlayLook,
};

pub(super) fn run(args: &ExportArgs) -> Result<Exit> {
    let (_, summary) = export(args, !args.force)?;
    if args.json {
        print_json(&summary)?;
    } else {
        print(&format!(
            "{} files in {} ({} frames, {} of them were there already)\n",
            summary.files,
            args.output.display(),
            summary.frames,
            summary.skipped_frames
        ))?;
    }
    if summary.complete {
        Ok(Exit::Done)
    } else {
        say("run the same command again to go on");
        Err(Error::Cancelled)
    }
}

/// Writes the files; `completes_same` as in [`ExportRequest`]. An export that is not complete was stopped by
/// the user. The returned engine still has the prompts.
pub(super) fn export(args: &ExportArgs, completes_same: bool) -> Result<(Engine, ExportSummary)> {
    let options = args.relevancy.engine_options(&args.scene, args.sequence.clone());
    let mut engine = open_engine(&args.scene, options)?;
    engine.set_questions(&args.prompts.questions(engine.settings())?)?;
    let frames = FrameRange::frames(args.frames, engine.scene().num_frames())?;
    let request = ExportRequest {
        scene: &args.scene.scene,
        folder: &args.output,
        prompts: jobs::export_prompts(&engine),
        options: export_options(args),
        replace: args.force,
        completes_same,
        frames,
    };
    say(&format!(
        "exporting {} frames, {} prompts, {} files to {}",
        request.frames.len(),
        request.prompts.len(),
        num_files(&request.options.formats, request.frames.len(), request.prompts.len()),
        args.output.display()
    ));
    console::watch_interrupts();
    let mut view = ProgressView::default();
    let summary = jobs::export(&mut engine, request, &mut |p| view.show(p))?;
    Ok((engine, summary))
}

fn export_options(args: &ExportArgs) -> ExportOptions {
    ExportOptions {
        formats: args.format.clone(),
        source: args.source.into(),
        exclusive: args.exclusive,
        stamp: !args.no_stamp,
        look: OverlayLook {
            style: args.style,
            opacity: args.opacity,
            outline_opacity: args.outline_opacity,
            below_instruments: !args.above_instruments,
        },
        clean_up: args.clean_up.clean_up(),
    }
}
