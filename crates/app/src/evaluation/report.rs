//! The report of an evaluation, as JSON and as text.

use super::{FrameRow, masks::Classes, times::Milliseconds};
use surgtpgs_core::{
    metrics::{DepthErrors, IouReport, MaskSummary},
    num::mean,
};

/// The JSON report; its keys are a contract.
#[derive(serde::Serialize)]
pub(crate) struct EvalReport {
    /// PSNR over all pixels, all channels together.
    pub(crate) psnr_db: Option<f64>,
    /// PSNR inside the supervision mask.
    pub(crate) psnr_masked_db: Option<f64>,
    /// Frames that show again what a frame shows that training saw, as a changed frame rate leaves them; none of
    /// foreign masks.
    pub(crate) repeated_frames: usize,
    /// PSNR inside the masks without these, of the scene and of both baselines; `None` if there are none, or no
    /// others.
    pub(crate) psnr_masked_new_db: Option<f64>,
    pub(crate) blend_psnr_new_db: Option<f64>,
    pub(crate) flow_psnr_new_db: Option<f64>,
    /// PSNR inside the masks with cameras that were fitted to the very frames; `None` if not asked for. Not to be
    /// compared with figures of frames that nothing was read of.
    pub(crate) fitted_camera_psnr_db: Option<f64>,
    /// PSNR as the paper's code has it: each channel by itself, then the mean.
    pub(crate) psnr_per_channel_db: Option<f64>,
    /// PSNR inside the masks of the blend of the frames around, which training may see; a baseline.
    pub(crate) blend_psnr_db: Option<f64>,
    /// The same, of these frames moved by their optical flow.
    pub(crate) flow_psnr_db: Option<f64>,
    /// PSNR inside the masks of frames that training saw; `None` if none was held out.
    pub(crate) train_psnr_db: Option<f64>,
    /// Mean share of the picture that the masks keep.
    pub(crate) mask_share: Option<f64>,
    /// PSNR, SSIM and LPIPS by the formulas of publications on endoscopy, to compare with their figures alone:
    /// what the masks leave out is black in both pictures, and counts as right.
    pub(crate) psnr_published_db: Option<f64>,
    pub(crate) ssim_published: Option<f64>,
    pub(crate) lpips_published: Option<f64>,
    /// SSIM with zeros outside the picture, as the 3DGS code family has it.
    pub(crate) ssim: Option<f64>,
    /// SSIM of the pixels whose window lies inside, as scikit-image has it.
    pub(crate) ssim_inside: Option<f64>,
    /// LPIPS of the whole pictures; `None` without a model.
    pub(crate) lpips: Option<f64>,
    /// Root mean square error of depth, scene units.
    pub(crate) depth_rmse: Option<f64>,
    pub(crate) depth: Option<DepthErrors>,
    pub(crate) frames: usize,
    /// Runs of frames that no chapter of the scene shows, each by its first and last frame; they are not
    /// measured.
    pub(crate) frames_not_shown: Vec<[usize; 2]>,
    /// Classes of which foreign masks have none, or that nobody marked where only what is marked is found; they
    /// count as not found.
    pub(crate) classes_without_masks: Vec<String>,
    /// `true` if the frames were kept from training; for foreign masks, `true` if they are the test frames.
    pub(crate) held_out: bool,
    /// Gaussians of all chapters.
    pub(crate) gaussians: Option<usize>,
    /// `None` without labels or features.
    pub(crate) iou: Option<Iou>,
    pub(crate) masks: Option<Masks>,
    /// The same measures of a copy of the labels of the nearest training frame, or of the nearest marked one if
    /// the scene knows marks alone, for comparison; `None` if no such frame has labels.
    pub(crate) copied_labels: Option<Copied>,
    pub(crate) ms: Option<Milliseconds>,
    pub(crate) fps: Option<Fps>,
    pub(crate) training: Option<Training>,
    pub(crate) renderer: Option<String>,
    pub(crate) relevancy: Option<&'static str>,
}

/// Mean IoU by two protocols; masks are found by the prompts' own thresholds.
#[derive(serde::Serialize, serde::Deserialize)]
pub(crate) struct Iou {
    pub(crate) paper: IouReport,
    pub(crate) strict: IouReport,
}

/// Measures of masks, by the way in which the masks come about.
#[derive(serde::Serialize)]
pub(crate) struct Masks {
    /// Masks of each class by itself, where its score is above the threshold: the paper's way. They
    /// may overlap.
    pub(crate) threshold: MaskSummary,
    /// Masks that give each pixel the class of the highest score, the background among the classes.
    pub(crate) argmax: Option<MaskSummary>,
}

/// Measures of copied labels.
#[derive(serde::Serialize)]
pub(crate) struct Copied {
    pub(crate) iou: Iou,
    pub(crate) masks: MaskSummary,
}

/// Frames per second, one after the other: rendering, one prompt on a rendered frame, both.
#[derive(serde::Serialize)]
pub(crate) struct Fps {
    pub(crate) render: f64,
    pub(crate) query: Option<f64>,
    pub(crate) frame: f64,
}

impl Fps {
    pub(super) fn of(ms: &Milliseconds) -> Self {
        let fps = |ms: f64| 1e3 / ms.max(1e-6);
        Self {
            render: fps(ms.deform.unwrap_or(0.0) + ms.raster),
            query: ms.relevancy.map(fps),
            frame: fps(ms.frame),
        }
    }
}

/// Length of the training, as recorded in the scene.
#[derive(serde::Serialize)]
pub(crate) struct Training {
    pub(crate) steps: usize,
}

impl EvalReport {
    /// Takes the means over frames and classes.
    pub(super) fn of(rows: &[FrameRow], held_out: bool, classes: &Classes) -> Self {
        let mean_of = |value: fn(&FrameRow) -> Option<f64>| mean(rows.iter().filter_map(value));
        let repeats = rows.iter().any(|r| r.repeats);
        let mean_of_new = |value: fn(&FrameRow) -> Option<f64>| {
            mean(rows.iter().filter(|r| repeats && !r.repeats).filter_map(value))
        };
        let depth_rmse = mean_of(|r| r.depth_rmse);
        let depth = depth_rmse.map(|rmse| DepthErrors {
            rmse,
            abs_rel: mean_of(|r| r.depth_abs_rel).unwrap_or(f64::NAN),
            rmse_log: mean_of(|r| r.depth_rmse_log).unwrap_or(f64::NAN),
            within_1_25: mean_of(|r| r.depth_within_1_25).unwrap_or(f64::NAN),
        });
        let has_classes = !classes.is_empty();
        Self {
            psnr_db: mean_of(|r| r.psnr_db),
            psnr_masked_db: mean_of(|r| r.psnr_masked_db),
            repeated_frames: rows.iter().filter(|r| r.repeats).count(),
            psnr_masked_new_db: mean_of_new(|r| r.psnr_masked_db),
            blend_psnr_new_db: mean_of_new(|r| r.blend_psnr_db),
            flow_psnr_new_db: mean_of_new(|r| r.flow_psnr_db),
            fitted_camera_psnr_db: mean_of(|r| r.fitted_camera_psnr_db),
            psnr_per_channel_db: mean_of(|r| r.psnr_per_channel_db),
            blend_psnr_db: mean_of(|r| r.blend_psnr_db),
            flow_psnr_db: mean_of(|r| r.flow_psnr_db),
            train_psnr_db: None,
            mask_share: mean_of(|r| r.mask_share),
            psnr_published_db: mean_of(|r| r.psnr_published_db),
            ssim_published: mean_of(|r| r.ssim_published),
            lpips_published: mean_of(|r| r.lpips_published),
            ssim: mean_of(|r| r.ssim),
            ssim_inside: mean_of(|r| r.ssim_inside),
            lpips: mean_of(|r| r.lpips),
            depth_rmse,
            depth,
            frames: rows.len(),
            frames_not_shown: Vec::new(),
            classes_without_masks: Vec::new(),
            held_out,
            gaussians: None,
            iou: has_classes
                .then(|| Iou { paper: classes.threshold.paper(), strict: classes.threshold.strict() }),
            masks: has_classes.then(|| Masks {
                threshold: classes.threshold.summary(),
                argmax: classes.argmax.as_ref().map(|a| a.scores.summary()),
            }),
            copied_labels: (has_classes && !classes.copied.rows().is_empty()).then(|| Copied {
                iou: Iou { paper: classes.copied.paper(), strict: classes.copied.strict() },
                masks: classes.copied.summary(),
            }),
            ms: None,
            fps: None,
            training: None,
            renderer: None,
            relevancy: None,
        }
    }
}

pub(crate) fn as_text(report: &EvalReport) -> String {
    let mut lines = match report.gaussians {
        Some(gaussians) => lines_of_pictures(report, gaussians),
        None => vec![format!("masks of {} frames", report.frames)],
    };
    if report.repeated_frames > 0 {
        lines.push(format!(
            "repeats     {} of these frames repeat one that was learned; PSNR without them {} (blend {}, flow {})",
            report.repeated_frames,
            in_db(report.psnr_masked_new_db),
            in_db(report.blend_psnr_new_db),
            in_db(report.flow_psnr_new_db)
        ));
    }
    if report.fitted_camera_psnr_db.is_some() {
        let psnr = in_db(report.fitted_camera_psnr_db);
        lines.push(format!("fitted      PSNR {psnr} inside the masks, with cameras fitted to these frames"));
    }
    if report.lpips.is_some() {
        lines.push(format!("LPIPS       {}", plain(report.lpips)));
    }
    lines.extend(lines_of_classes(report));
    for (name, summary) in report.masks.iter().flat_map(|m| {
        [Some(("threshold", &m.threshold)), m.argmax.as_ref().map(|a| ("argmax", a))].into_iter().flatten()
    }) {
        let all = &summary.all;
        lines.push(format!(
            "{name:<11} IoU {}, Dice {}, border F {}, precision {}, recall {}, absent classes found {}",
            plain(all.iou),
            plain(all.dice),
            plain(all.boundary_f),
            plain(all.precision),
            plain(all.recall),
            plain(all.absent.false_positive_rate)
        ));
    }
    if let (Some(ms), Some(fps), Some(renderer)) = (&report.ms, &report.fps, &report.renderer) {
        lines.push(format!(
            "times       deform {}, raster {:.2} ms, one prompt {}, frame {:.2} ms: {:.0} frames/s ({renderer})",
            value(ms.deform, " ms"),
            ms.raster,
            value(ms.relevancy, " ms"),
            ms.frame,
            fps.frame,
        ));
    }
    lines.join("\n") + "\n"
}

/// Writes a figure in words, with its unit.
fn value(figure: Option<f64>, unit: &str) -> String {
    figure.map_or("unknown".into(), |figure| format!("{figure:.3}{unit}"))
}

fn in_db(figure: Option<f64>) -> String {
    value(figure, " dB")
}

fn plain(figure: Option<f64>) -> String {
    value(figure, "")
}

/// Writes the lines of what a scene shows: pictures and depth.
fn lines_of_pictures(report: &EvalReport, gaussians: usize) -> Vec<String> {
    let kind = if report.held_out { "held-out frames" } else { "frames, not held out from training" };
    let depth = |of: fn(&DepthErrors) -> f64| plain(report.depth.as_ref().map(of));
    vec![
        format!("{} {kind}, {gaussians} Gaussians", report.frames),
        format!("PSNR        {} inside the masks", in_db(report.psnr_masked_db)),
        format!(
            "  to beat: {} by a blend of the frames around, {} by their flow",
            in_db(report.blend_psnr_db),
            in_db(report.flow_psnr_db)
        ),
        format!(
            "  training frames {}, all pixels {}, the paper's way {}",
            in_db(report.train_psnr_db),
            in_db(report.psnr_db),
            in_db(report.psnr_per_channel_db)
        ),
        format!("SSIM        {} (away from the border {})", plain(report.ssim), plain(report.ssim_inside)),
        format!(
            "published   PSNR {}, SSIM {}, LPIPS {} by the field's formulas, masks keep {} of the picture",
            in_db(report.psnr_published_db),
            plain(report.ssim_published),
            plain(report.lpips_published),
            plain(report.mask_share)
        ),
        format!(
            "depth       RMSE {}, relative {}, within a factor of 1.25 {}",
            value(report.depth_rmse, " scene units"),
            depth(|d| d.abs_rel),
            depth(|d| d.within_1_25)
        ),
    ]
}

/// Writes the lines of what is found of classes: first what sceptics ask for, each figure beside that of
/// copied labels.
fn lines_of_classes(report: &EvalReport) -> Vec<String> {
    let (Some(iou), Some(masks)) = (&report.iou, &report.masks) else { return Vec::new() };
    let copied = report.copied_labels.as_ref();
    let beside = |v: fn(&Copied) -> Option<f64>| {
        copied.map_or(String::new(), |c| format!(" (copied labels: {})", plain(v(c))))
    };
    let absent = &masks.threshold.all.absent;
    let mut lines = vec![
        format!(
            "absent      found on {} of {} pairs of frame and class that is not there, {} with a speck{}",
            plain(absent.false_find_rate),
            absent.pairs,
            plain(absent.false_positive_rate),
            beside(|c| c.masks.all.absent.false_find_rate)
        ),
        format!(
            "IoU         {} strict{}, {} by the paper's protocol{}",
            plain(iou.strict.mean),
            beside(|c| c.iou.strict.mean),
            plain(iou.paper.mean),
            beside(|c| c.iou.paper.mean)
        ),
    ];
    for (name, strict) in &iou.strict.classes {
        let paper = plain(iou.paper.classes.get(name).copied());
        lines.push(format!("  {name}: {strict:.3} strict, {paper} by the paper's protocol"));
    }
    lines
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nothing_measured_is_unknown_not_zero() {
        let empty = EvalReport::of(&[], true, &Classes::new(&[]));
        assert!(empty.psnr_db.is_none() && empty.iou.is_none() && empty.depth.is_none());
        assert!(as_text(&empty).contains("0 frames"));
    }

    #[test]
    fn frames_a_second_are_of_one_thing_after_the_other() {
        let ms = Milliseconds { deform: Some(1.0), raster: 9.0, relevancy: Some(2.0), frame: 12.0 };
        let fps = Fps::of(&ms);
        assert_eq!((fps.render, fps.query), (100.0, Some(500.0)));
    }
}
