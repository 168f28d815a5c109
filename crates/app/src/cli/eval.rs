//! `surgtpgs eval`: a scene against its recording.

use super::{
    Exit,
    console::{ProgressView, print, print_json, say},
    open_engine,
};
use crate::{
    args::EvalArgs,
    engine::{Engine, View},
};
use std::{sync::Arc, time::Instant};
use surgtpgs_core::{
    Result,
    clock::PassName,
    grid::Grid,
    metrics::{IouReport, MiouAccumulator, depth_rmse, psnr_db, psnr_per_channel_db, ssim},
    raster::{FramePass, Images, MIN_DEPTH_ALPHA},
    sequence::{Class, Sequence},
};

/// The JSON report; its keys are a contract.
#[derive(serde::Serialize)]
pub(super) struct Report {
    /// Over all pixels, all channels together.
    pub(super) psnr_db: Option<f64>,
    /// Inside the supervision mask.
    pub(super) psnr_masked_db: Option<f64>,
    /// As the paper's code has it: each channel by itself, then the mean.
    pub(super) psnr_per_channel_db: Option<f64>,
    pub(super) ssim: Option<f64>,
    /// Scene units.
    pub(super) depth_rmse: Option<f64>,
    pub(super) frames: usize,
    /// Whether these frames were kept from training.
    pub(super) held_out: bool,
    pub(super) gaussians: usize,
    /// `None` without labels or features.
    pub(super) iou: Option<Iou>,
    pub(super) ms: Milliseconds,
    pub(super) renderer: String,
    pub(super) relevancy: &'static str,
}

#[derive(serde::Serialize)]
pub(super) struct Iou {
    pub(super) paper: IouReport,
    pub(super) strict: IouReport,
}

/// Median times per frame; `relevancy` is of one prompt, `frame` of everything with one prompt.
#[derive(serde::Serialize)]
pub(super) struct Milliseconds {
    /// `None` where the renderer does both passes in one.
    pub(super) deform: Option<f64>,
    pub(super) raster: f64,
    pub(super) relevancy: Option<f64>,
    pub(super) frame: f64,
}

pub(super) fn run(args: &EvalArgs) -> Result<Exit> {
    let options = args.relevancy.engine_options(&args.scene, Some(args.sequence.clone()));
    let mut engine = open_engine(&args.scene, options)?;
    let report = evaluate(&mut engine)?;
    if !report.held_out {
        say("no frame was held out of training: these figures are of frames that the scene was trained on");
    }
    if args.json {
        print_json(&report);
    } else {
        print(&as_text(&report));
    }
    Ok(Exit::Done)
}

/// Evaluates the engine's scene on its recording: the held-out frames, or all if none was held out.
pub(super) fn evaluate(engine: &mut Engine) -> Result<Report> {
    let sequence = engine.sequence().cloned().ok_or_else(|| {
        surgtpgs_core::Error::input("the recording is not at hand", "Give it after the scene.")
    })?;
    let held_out = engine.scene().provenance.held_out;
    let frames: Vec<usize> =
        (0..sequence.num_frames()).filter(|&i| !held_out || Sequence::is_test_frame(i)).collect();
    let classes = asked_classes(engine, &sequence)?;
    let mut sums = Sums::default();
    let mut view = ProgressView::default();
    for (done, &frame) in frames.iter().enumerate() {
        let at = engine.view(frame)?;
        let images = sums.times.render(engine, &at)?;
        sums.add_pictures(&images, &sequence, frame)?;
        let started = Instant::now();
        let scores = engine.scores(&images, &at)?;
        sums.times.scored(started, scores.len());
        sums.add_classes(&scores, engine.settings().threshold, &classes, &sequence, frame)?;
        view.count("evaluating", done + 1, frames.len());
    }
    Ok(Report {
        psnr_db: mean(&sums.psnr),
        psnr_masked_db: mean(&sums.psnr_masked),
        psnr_per_channel_db: mean(&sums.psnr_per_channel),
        ssim: mean(&sums.ssim),
        depth_rmse: mean(&sums.depth_rmse),
        frames: frames.len(),
        held_out,
        gaussians: engine.scene().gaussians.len(),
        iou: (!classes.is_empty())
            .then(|| Iou { paper: sums.classes.paper(), strict: sums.classes.strict() }),
        ms: sums.times.medians(),
        renderer: engine.renderer_name(),
        relevancy: engine.relevancy_name(),
    })
}

/// The classes of the recording, asked of the engine by name; none where scene or recording cannot tell.
fn asked_classes(engine: &mut Engine, sequence: &Sequence) -> Result<Vec<Class>> {
    let classes: Vec<Class> =
        sequence.classes().iter().filter(|c| !is_background(&c.name)).cloned().collect();
    if engine.scene().codec.is_none() || classes.is_empty() {
        say("no IoU: it needs a scene with features and a recording with label masks");
        return Ok(Vec::new());
    }
    let names: Vec<String> = classes.iter().map(|c| c.name.clone()).collect();
    engine.set_prompts(&names)?;
    Ok(classes)
}

/// The paper asks for no background class, neither the black border nor "background tissue" (method §9.4).
fn is_background(name: &str) -> bool {
    name.split([' ', '-', '_']).any(|word| word == "background")
}

#[derive(Default)]
struct Sums {
    psnr: Vec<f64>,
    psnr_masked: Vec<f64>,
    psnr_per_channel: Vec<f64>,
    ssim: Vec<f64>,
    depth_rmse: Vec<f64>,
    classes: MiouAccumulator,
    times: Times,
}

impl Sums {
    fn add_pictures(&mut self, images: &Images, sequence: &Sequence, frame: usize) -> Result<()> {
        let (picture, truth, mask) = (images.to_rgb(), sequence.frame(frame)?, sequence.mask(frame)?);
        self.psnr.extend(psnr_db(&picture, &truth, None));
        self.psnr_masked.extend(psnr_db(&picture, &truth, Some(&mask)));
        self.psnr_per_channel.extend(psnr_per_channel_db(&picture, &truth, None));
        self.ssim.extend(Some(ssim(&picture, &truth)).filter(|v| v.is_finite()));
        if let Some(truth) = sequence.depth(frame)? {
            self.depth_rmse.extend(depth_rmse(
                &images.normalised_depth(MIN_DEPTH_ALPHA),
                &truth,
                Some(&mask),
            ));
        }
        Ok(())
    }

    fn add_classes(
        &mut self,
        scores: &[Grid<f32>],
        threshold: f32,
        classes: &[Class],
        sequence: &Sequence,
        frame: usize,
    ) -> Result<()> {
        let Some(labels) = sequence.labels(frame)?.filter(|_| !classes.is_empty()) else { return Ok(()) };
        let keep = sequence.mask(frame)?;
        for (class, scores) in classes.iter().zip(scores) {
            let found = surgtpgs_core::mask::threshold(scores, threshold);
            self.classes.add(&class.name, &found, &labels.map(|&id| id == class.id), &keep)?;
        }
        Ok(())
    }
}

#[derive(Default)]
struct Times {
    deform: Vec<f64>,
    raster: Vec<f64>,
    relevancy: Vec<f64>,
    warm: bool,
}

impl Times {
    /// Renders with features; the first frame is rendered twice, to warm up.
    fn render(&mut self, engine: &mut Engine, view: &View) -> Result<Arc<Images>> {
        if !std::mem::replace(&mut self.warm, true) {
            engine.render(view, true)?;
            engine.forget_last();
        }
        let ms = |engine: &Engine, pass| engine.clock().seconds(pass) * 1e3;
        let all = |engine: &Engine| FramePass::ALL.iter().map(|p| ms(engine, *p)).sum::<f64>();
        let (deform_before, before) = (ms(engine, FramePass::Deform), all(engine));
        let images = engine.render(view, true)?;
        let deform = ms(engine, FramePass::Deform) - deform_before;
        // A GPU does everything at once.
        self.deform.extend((deform > 0.0).then_some(deform));
        self.raster.push(all(engine) - before - deform);
        Ok(images)
    }

    fn scored(&mut self, started: Instant, prompts: usize) {
        if prompts > 0 {
            self.relevancy.push(started.elapsed().as_secs_f64() * 1e3 / prompts as f64);
        }
    }

    fn medians(&mut self) -> Milliseconds {
        let (deform, relevancy) = (median(&mut self.deform), median(&mut self.relevancy));
        let raster = median(&mut self.raster).unwrap_or(0.0);
        let frame = deform.unwrap_or(0.0) + raster + relevancy.unwrap_or(0.0);
        Milliseconds { deform, raster, relevancy, frame }
    }
}

fn mean(values: &[f64]) -> Option<f64> {
    (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
}

fn median(values: &mut [f64]) -> Option<f64> {
    values.sort_unstable_by(f64::total_cmp);
    values.get(values.len() / 2).copied()
}

fn as_text(report: &Report) -> String {
    let value = |v: Option<f64>, unit: &str| v.map_or("unknown".into(), |v| format!("{v:.3}{unit}"));
    let kind = if report.held_out { "held-out" } else { "training (none was held out)" };
    let mut text = format!(
        "{} {kind} frames, {} Gaussians\n\
         PSNR        {} (inside the masks {}, paper's way {})\n\
         SSIM        {}\n\
         depth RMSE  {}\n",
        report.frames,
        report.gaussians,
        value(report.psnr_db, " dB"),
        value(report.psnr_masked_db, " dB"),
        value(report.psnr_per_channel_db, " dB"),
        value(report.ssim, ""),
        value(report.depth_rmse, " scene units"),
    );
    if let Some(iou) = &report.iou {
        text += &format!(
            "IoU         {} (paper), {} (strict)\n",
            value(iou.paper.mean, ""),
            value(iou.strict.mean, "")
        );
        for (name, strict) in &iou.strict.classes {
            text += &format!(
                "  {name}: {} (paper), {strict:.3} (strict)\n",
                value(iou.paper.classes.get(name).copied(), "")
            );
        }
    }
    let ms = &report.ms;
    text += &format!(
        "times       deform {}, raster {:.2} ms, one prompt {}, frame {:.2} ms ({})\n",
        value(ms.deform, " ms"),
        ms.raster,
        value(ms.relevancy, " ms"),
        ms.frame,
        report.renderer
    );
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn backgrounds_are_not_asked_for() {
        assert!(is_background("black background") && is_background("background-tissue"));
        assert!(!is_background("abdominal wall"));
    }

    #[test]
    fn nothing_measured_is_unknown_not_zero() {
        assert_eq!((mean(&[]), median(&mut [])), (None, None));
        assert_eq!((mean(&[1.0, 3.0]), median(&mut [5.0, 1.0, 3.0])), (Some(2.0), Some(3.0)));
    }
}
