//! `surgtpgs eval`: a scene against its recording, or masks that another program made.

mod files;
mod masks;
mod matrix;
mod report;
mod times;

pub(super) use files::write;
pub(super) use report::{Iou, Report};

use super::{
    Exit,
    console::{ProgressView, print, print_json, say},
    open_engine,
};
use crate::{args::EvalArgs, engine::Engine};
use masks::Classes;
use report::{Fps, Training};
use std::{path::Path, time::Instant};
use surgtpgs_clip::Lpips;
use surgtpgs_core::{
    Error, Result,
    mask::threshold,
    metrics::{DepthErrors, PredictedMasks, depth_errors, psnr_db, psnr_per_channel_db, ssim},
    prepare::Prepared,
    raster::{Images, MIN_DEPTH_ALPHA},
    sequence::Sequence,
};
use times::Times;

/// Pictures and depth of one frame; a row of `frames.csv`.
#[derive(Clone, Debug, serde::Serialize)]
pub(super) struct FrameRow {
    frame: usize,
    psnr_db: Option<f64>,
    psnr_masked_db: Option<f64>,
    psnr_per_channel_db: Option<f64>,
    ssim: Option<f64>,
    ssim_inside: Option<f64>,
    lpips: Option<f64>,
    depth_rmse: Option<f64>,
    depth_abs_rel: Option<f64>,
    depth_rmse_log: Option<f64>,
    depth_within_1_25: Option<f64>,
}

/// Everything measured.
pub(super) struct Evaluation {
    pub(super) report: Report,
    frames: Vec<FrameRow>,
    classes: Classes,
}

pub(super) fn run(args: &EvalArgs) -> Result<Exit> {
    let evaluation = match (&args.masks, &args.paths[..]) {
        (None, [scene, sequence]) => evaluate(&mut open(args, scene, sequence)?, args.lpips.as_deref())?,
        (Some(folder), [sequence]) => {
            let prepared = Prepared::is_prepared(sequence);
            let sequence =
                if prepared { Prepared::open(sequence)?.sequence } else { Sequence::open(sequence)? };
            evaluate_masks(&PredictedMasks::open(folder, &sequence)?, &sequence)?
        }
        (None, _) => return usage("give a scene and its recording"),
        (Some(_), _) => return usage("with --masks, give the recording alone"),
    };
    let report = &evaluation.report;
    if !report.held_out && args.masks.is_none() {
        say("no frame was held out of training: these figures are of frames that the scene was trained on");
    }
    if let Some(folder) = &args.output {
        write(folder, &evaluation)?;
    }
    if args.json {
        print_json(report)?;
    } else {
        print(&report::as_text(report))?;
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

/// Evaluates the engine's scene on its recording: the held-out frames, or all if none was held out. With a model of LPIPS
/// that is measured, too.
pub(super) fn evaluate(engine: &mut Engine, lpips: Option<&Path>) -> Result<Evaluation> {
    let mut lpips = lpips.map(Lpips::open).transpose()?;
    let sequence = engine
        .sequence()
        .cloned()
        .ok_or_else(|| Error::input("the recording is not at hand", "Give it after the scene."))?;
    let held_out = engine.scene().provenance.held_out;
    let frames: Vec<usize> =
        (0..sequence.num_frames()).filter(|&i| !held_out || Sequence::is_test_frame(i)).collect();
    let mut classes = asked_classes(engine, &sequence)?;
    let (mut rows, mut times, mut view) = (Vec::new(), Times::default(), ProgressView::default());
    for (done, &frame) in frames.iter().enumerate() {
        let at = engine.view(frame)?;
        let images = times.render(engine, &at)?;
        rows.push(row(&images, &sequence, frame, lpips.as_mut())?);
        let started = Instant::now();
        let scores = engine.scores(&images, &at)?;
        times.scored(started, scores.len());
        let limit = engine.settings().threshold;
        classes.add_scores(&scores, |s| threshold(s, limit), &sequence, frame)?;
        view.count("evaluating", done + 1, frames.len());
    }
    let ms = times.medians();
    let scene = engine.scene();
    let report = Report {
        gaussians: Some(scene.gaussians.len()),
        fps: Some(Fps::of(&ms)),
        ms: Some(ms),
        training: Some(Training {
            seconds: scene.provenance.seconds,
            steps: scene.provenance.steps,
            peak_rss_bytes: scene.provenance.peak_rss_bytes,
        }),
        renderer: Some(engine.renderer_name()),
        relevancy: Some(engine.relevancy_name()),
        ..Report::of(&rows, held_out, &classes)
    };
    Ok(Evaluation { report, frames: rows, classes })
}

/// Scores masks that another program made, on the frames that it made some for.
fn evaluate_masks(masks: &PredictedMasks, sequence: &Sequence) -> Result<Evaluation> {
    let mut classes = Classes::new(sequence.classes());
    if classes.is_empty() {
        return Err(Error::input_at(
            sequence.path(),
            "the recording has no label masks to compare with",
            "Run `surgtpgs check` on it to see what it holds.",
        ));
    }
    let size = (sequence.width(), sequence.height());
    let (frames, mut view) = (masks.frames(), ProgressView::default());
    for (done, &frame) in frames.iter().enumerate() {
        classes.add_masks(masks.masks(frame, sequence.classes(), size)?, sequence, frame)?;
        view.count("evaluating", done + 1, frames.len());
    }
    let held_out = frames.iter().all(|&i| Sequence::is_test_frame(i));
    let report = Report { frames: frames.len(), ..Report::of(&[], held_out, &classes) };
    Ok(Evaluation { report, frames: Vec::new(), classes })
}

/// The classes of the recording, asked of the engine by name; none where scene or recording cannot tell.
fn asked_classes(engine: &mut Engine, sequence: &Sequence) -> Result<Classes> {
    let classes = Classes::new(sequence.classes());
    if engine.scene().codec.is_none() || classes.is_empty() {
        say("no IoU: it needs a scene with features and a recording with label masks");
        return Ok(Classes::new(&[]));
    }
    let names: Vec<String> = sequence.classes().iter().map(|c| c.name.clone()).collect();
    engine.set_prompts(&names)?;
    Ok(classes)
}

fn row(images: &Images, sequence: &Sequence, frame: usize, lpips: Option<&mut Lpips>) -> Result<FrameRow> {
    let (picture, truth, mask) = (images.to_rgb(), sequence.frame(frame)?, sequence.mask(frame)?);
    // What a network estimated is no truth to compare with.
    let is_measured = sequence.estimated_depth().is_none();
    let depth = sequence.depth(frame)?.filter(|_| is_measured).and_then(|truth| -> Option<DepthErrors> {
        depth_errors(&images.normalised_depth(MIN_DEPTH_ALPHA), &truth, Some(&mask))
    });
    let ssim = ssim(&picture, &truth);
    Ok(FrameRow {
        frame,
        psnr_db: psnr_db(&picture, &truth, None),
        psnr_masked_db: psnr_db(&picture, &truth, Some(&mask)),
        psnr_per_channel_db: psnr_per_channel_db(&picture, &truth, None),
        ssim: ssim.map(|s| s.padded),
        ssim_inside: ssim.map(|s| s.inside).filter(|s| s.is_finite()),
        lpips: lpips.map(|lpips| lpips.distance(&picture, &truth)).transpose()?,
        depth_rmse: depth.map(|d| d.rmse),
        depth_abs_rel: depth.map(|d| d.abs_rel),
        depth_rmse_log: depth.map(|d| d.rmse_log),
        depth_within_1_25: depth.map(|d| d.within_1_25),
    })
}
