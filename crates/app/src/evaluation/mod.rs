//! Evaluation of a scene, or of masks that another program made, against a recording: measures of
//! every frame and class.

mod files;
mod masks;
mod matrix;
mod neighbours;
mod report;
mod times;

pub(crate) use files::{write, write_files};
pub(crate) use report::{EvalReport, Iou, as_text};

use crate::{
    engine::{Absence, Engine, SceneView},
    jobs::{Observer, Progress},
};
use image::RgbImage;
use masks::Classes;
use neighbours::Neighbours;
use report::{Fps, Training};
use std::{ops::ControlFlow, path::Path, time::Instant};
use surgtpgs_clip::Lpips;
use surgtpgs_core::{
    Error, Remedy, Result,
    marks::Marks,
    mask::threshold,
    metrics::{
        ClassOnFrame, DepthErrors, PredictedMasks, depth_errors, masked, psnr_db, psnr_per_channel_db,
        psnr_published_db, ssim,
    },
    num::mean,
    raster::Images,
    scene::Scene,
    sequence::Sequence,
    train::fit_camera,
};
use times::Times;

/// Most training frames that are rendered to compare them with those held out.
const MOST_TRAIN_FRAMES: usize = 64;

/// Measures of the picture and depth of one frame; a row of `frames.csv`.
#[derive(Clone, Debug, Default, serde::Serialize)]
pub(crate) struct FrameRow {
    pub(crate) frame: usize,
    psnr_db: Option<f64>,
    pub(crate) psnr_masked_db: Option<f64>,
    /// PSNR inside the masks from where the scene looks most like the frame.
    fitted_camera_psnr_db: Option<f64>,
    psnr_per_channel_db: Option<f64>,
    /// PSNR inside the masks of what the frames around tell: their blend, and the same moved by their flow.
    blend_psnr_db: Option<f64>,
    flow_psnr_db: Option<f64>,
    pub(crate) ssim: Option<f64>,
    ssim_inside: Option<f64>,
    lpips: Option<f64>,
    /// Share of the picture that the mask keeps.
    mask_share: Option<f64>,
    psnr_published_db: Option<f64>,
    ssim_published: Option<f64>,
    lpips_published: Option<f64>,
    depth_rmse: Option<f64>,
    depth_abs_rel: Option<f64>,
    depth_rmse_log: Option<f64>,
    depth_within_1_25: Option<f64>,
    /// File name of the recorded frame.
    source: Option<String>,
    /// `true` if the frame shows again what one beside it shows, which training saw.
    repeats: bool,
}

/// Everything measured.
pub(crate) struct Evaluation {
    pub(crate) report: EvalReport,
    pub(crate) frames: Vec<FrameRow>,
    classes: Classes,
}

impl Evaluation {
    /// Returns the rows of every class on every frame, each class by its own threshold.
    pub(crate) fn class_rows(&self) -> &[ClassOnFrame] {
        self.classes.threshold.rows()
    }
}

/// Measures that are taken if asked for, and frames that are not measured.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Extras<'a> {
    /// Model of LPIPS.
    pub(crate) lpips: Option<&'a Path>,
    /// `true` to measure PSNR from where the scene looks most like each frame, too.
    pub(crate) fits_cameras: bool,
    /// Ranges of frames that were left out since the training; no picture of them is kept.
    pub(crate) left_out: &'a [(usize, usize)],
}

/// Evaluates the engine's scene on its recording: the held-out frames, or all if none was held out; with
/// marks, those of them without one. Without labels, or features or marks, there are no masks to measure.
///
/// # Errors
/// No recording, frames that cannot be read, or [`Error::Cancelled`].
pub(crate) fn evaluate(
    engine: &mut Engine,
    extras: Extras<'_>,
    observer: &mut Observer<'_>,
) -> Result<Evaluation> {
    let lpips = extras.lpips.map(Lpips::open).transpose()?;
    let sequence = engine
        .sequence()
        .cloned()
        .ok_or_else(|| Error::input("the recording is not at hand", "Give it after the scene."))?;
    engine.require_recording()?;
    let held_out = engine.scene().provenance.held_out;
    let shown = shown_frames(engine.scene(), sequence.num_frames(), extras.left_out);
    let marked = engine.marks().map(Marks::frames).unwrap_or_default();
    let frames = frames_to_measure(&shown, held_out, &marked);
    if frames.is_empty() {
        let what = "there is no frame to measure: all that count are marked or left out, or too few to hold \
                    one out";
        return Err(Error::input(what, "Evaluate a longer recording, or with marks on some frames only."));
    }
    let seen = if held_out { training_frames(&shown) } else { Vec::new() };
    let total = frames.len() + seen.len();
    let classes = asked_classes(engine, &sequence)?;
    let classes_without_masks = classes_without_marks(engine, &classes);
    let mut measures = Measures {
        sequence: &sequence,
        shown: &shown,
        held_out,
        labels_known_on: match knows_marks_alone(engine) {
            true => marked,
            false => shown.iter().copied().filter(|i| !(held_out && Sequence::is_test_frame(*i))).collect(),
        },
        fits_cameras: extras.fits_cameras,
        lpips,
        times: Times::default(),
        classes,
    };
    let mut rows = Vec::new();
    for (done, &frame) in frames.iter().enumerate() {
        rows.push(measures.frame(engine, frame)?);
        observe(observer, done + 1, total)?;
    }
    let tell = |done: usize| observe(observer, frames.len() + done, total);
    let train_psnr_db = training_psnr(engine, &sequence, &seen, tell)?;
    let ms = measures.times.medians();
    let classes = measures.classes;
    let scene = engine.scene();
    let report = EvalReport {
        gaussians: Some(scene.num_gaussians()?),
        frames_not_shown: scene.frames_not_shown(),
        classes_without_masks,
        train_psnr_db,
        fps: Some(Fps::of(&ms)),
        ms: Some(ms),
        training: Some(Training { steps: scene.provenance.steps }),
        renderer: Some(engine.renderer_name()),
        relevancy: Some(engine.relevancy_name()),
        ..EvalReport::of(&rows, held_out, &classes)
    };
    Ok(Evaluation { report, frames: rows, classes })
}

/// Measures of frames, taken one after the other.
struct Measures<'a> {
    sequence: &'a Sequence,
    /// Frames that the scene shows.
    shown: &'a [usize],
    held_out: bool,
    /// Frames whose labels may be known, ascending.
    labels_known_on: Vec<usize>,
    fits_cameras: bool,
    lpips: Option<Lpips>,
    times: Times,
    classes: Classes,
}

impl Measures<'_> {
    /// Measures a frame, and adds the masks on it to those of the classes.
    fn frame(&mut self, engine: &mut Engine, frame: usize) -> Result<FrameRow> {
        let at = engine.view(frame)?;
        let images = self.times.render(engine, &at)?;
        let shot = engine.scene().shot_of(frame);
        let neighbours = Neighbours::of(frame, self.shown, &shot, self.held_out);
        let mut measured = row(&images, self.sequence, neighbours, self.lpips.as_mut())?;
        measured.repeats = self.held_out && neighbours.repeats(engine.scene());
        let started = Instant::now();
        let scores = engine.scores(&images, &at)?;
        self.times.scored(started, scores.len());
        let limit = engine.settings().threshold;
        if self.fits_cameras {
            let camera = fit_camera(engine.scene(), self.sequence, frame)?;
            let picture = engine.render(&SceneView { camera, ..at }, false)?.to_rgb();
            measured.fitted_camera_psnr_db = psnr_inside(&picture, self.sequence, frame)?;
        }
        self.classes.add_scores(&scores, |s| threshold(s, limit), self.sequence, frame)?;
        let others = neighbours.copied_from(&self.labels_known_on, &shot);
        self.classes.add_copy(self.sequence, frame, &others)?;
        Ok(measured)
    }
}

/// Returns the mean PSNR in dB inside the masks of frames that training saw; `None` if there are none. `tell`
/// hears how many of them are done.
fn training_psnr(
    engine: &mut Engine,
    sequence: &Sequence,
    frames: &[usize],
    mut tell: impl FnMut(usize) -> Result<()>,
) -> Result<Option<f64>> {
    let mut all = Vec::new();
    for (done, &frame) in (1..).zip(frames) {
        let at = engine.view(frame)?;
        let picture = engine.render(&at, false)?.to_rgb();
        all.extend(psnr_inside(&picture, sequence, frame)?);
        tell(done)?;
    }
    Ok(mean(all.into_iter()))
}

/// Returns the PSNR in dB of a picture of a frame inside its mask.
fn psnr_inside(picture: &RgbImage, sequence: &Sequence, frame: usize) -> Result<Option<f64>> {
    Ok(psnr_db(picture, &sequence.frame(frame)?, Some(&sequence.mask(frame)?)))
}

/// Returns the frames that the scene shows: all but those that were left out of the training or since, and
/// those that no chapter shows.
fn shown_frames(scene: &Scene, num_frames: usize, left_out: &[(usize, usize)]) -> Vec<usize> {
    // Read by itself: settings of older scenes are not whole.
    let excluded = scene.provenance.settings.get("excluded").cloned().unwrap_or_default();
    let excluded: Vec<(usize, usize)> = serde_json::from_value(excluded).unwrap_or_default();
    let is_excluded = |i: &usize| excluded.iter().chain(left_out).any(|(from, to)| (from..=to).contains(&i));
    (0..num_frames).filter(|i| !is_excluded(i) && scene.shows_frame(*i)).collect()
}

/// Returns of the shown frames without a mark those held out, or all if none was held out.
fn frames_to_measure(shown: &[usize], held_out: bool, marked: &[usize]) -> Vec<usize> {
    let counts = |i: &usize| !marked.contains(i) && (!held_out || Sequence::is_test_frame(*i));
    shown.iter().copied().filter(counts).collect()
}

/// Returns `true` if there are marks, and the scene learned the labels of no other frames.
fn knows_marks_alone(engine: &Engine) -> bool {
    let scene = engine.scene();
    engine.marks().is_some() && (scene.classes.is_empty() || scene.words.from_marks)
}

/// Names the classes that nobody marked, where only what is marked can be found.
fn classes_without_marks(engine: &Engine, classes: &Classes) -> Vec<String> {
    let needs_mark =
        |k: usize| engine.answers().get(k).is_some_and(|answer| answer.absence == Absence::NeedsMark);
    classes.asked().filter(|(k, _)| needs_mark(*k)).map(|(_, class)| class.name.clone()).collect()
}

/// Returns at most [`MOST_TRAIN_FRAMES`] of the shown frames that are not held out, evenly spread.
fn training_frames(shown: &[usize]) -> Vec<usize> {
    let seen: Vec<usize> = shown.iter().copied().filter(|&i| !Sequence::is_test_frame(i)).collect();
    let step = seen.len().div_ceil(MOST_TRAIN_FRAMES).max(1);
    seen.into_iter().step_by(step).collect()
}

/// Scores masks that another program made, on the frames that it made some for.
pub(crate) fn evaluate_masks(
    masks: &mut PredictedMasks,
    sequence: &Sequence,
    observer: &mut Observer<'_>,
) -> Result<Evaluation> {
    let mut classes = Classes::new(sequence.classes());
    if classes.is_empty() {
        return Err(Error::input_at(
            sequence.path(),
            "the recording has no label masks to compare with",
            Remedy::CheckRecording,
        ));
    }
    let size = (sequence.width(), sequence.height());
    let frames = masks.frames();
    for (done, &frame) in frames.iter().enumerate() {
        classes.add_masks(masks.masks(frame, sequence.classes(), size)?, sequence, frame)?;
        observe(observer, done + 1, frames.len())?;
    }
    let held_out = frames.iter().all(|&i| Sequence::is_test_frame(i));
    let without = classes.asked().map(|(_, class)| class).filter(|class| !masks.has_masks_of(class));
    let report = EvalReport {
        frames: frames.len(),
        classes_without_masks: without.map(|class| class.name.clone()).collect(),
        ..EvalReport::of(&[], held_out, &classes)
    };
    Ok(Evaluation { report, frames: Vec::new(), classes })
}

fn observe(observer: &mut Observer<'_>, done: usize, total: usize) -> Result<()> {
    match observer(&Progress::new("evaluating", done, total)) {
        ControlFlow::Break(()) if done < total => Err(Error::Cancelled),
        _ => Ok(()),
    }
}

/// Makes the classes of the recording the engine's prompts, by name, and returns them; none if the scene has
/// no features or the recording no classes.
fn asked_classes(engine: &mut Engine, sequence: &Sequence) -> Result<Classes> {
    let classes = Classes::new(sequence.classes());
    let can_be_asked = engine.scene().codec.is_some() || engine.marks().is_some();
    if !can_be_asked || classes.is_empty() {
        return Ok(Classes::new(&[]));
    }
    let names: Vec<String> = sequence.classes().iter().map(|c| c.name.clone()).collect();
    engine.set_prompts(&names)?;
    Ok(classes)
}

fn row(
    images: &Images,
    sequence: &Sequence,
    neighbours: Neighbours,
    mut lpips: Option<&mut Lpips>,
) -> Result<FrameRow> {
    let frame = neighbours.frame;
    let (picture, truth, mask) = (images.to_rgb(), sequence.frame(frame)?, sequence.mask(frame)?);
    let (picture_kept, truth_kept) = (masked(&picture, &mask), masked(&truth, &mask));
    let guess = neighbours.guess(sequence)?;
    let inside = |picture: &RgbImage| psnr_db(picture, &truth, Some(&mask));
    let mut distance =
        |a: &RgbImage, b: &RgbImage| lpips.as_mut().map(|lpips| lpips.distance(a, b)).transpose();
    // Depth that a network estimated is no truth to compare with.
    let is_measured = sequence.estimated_depth().is_none();
    let depth = sequence.depth(frame)?.filter(|_| is_measured).and_then(|truth| -> Option<DepthErrors> {
        depth_errors(&images.normalised_depth(), &truth, Some(&mask))
    });
    let structure = ssim(&picture, &truth);
    Ok(FrameRow {
        frame,
        psnr_db: psnr_db(&picture, &truth, None),
        psnr_masked_db: inside(&picture),
        fitted_camera_psnr_db: None,
        psnr_per_channel_db: psnr_per_channel_db(&picture, &truth),
        blend_psnr_db: guess.as_ref().and_then(|g| inside(&g.blend)),
        flow_psnr_db: guess.as_ref().and_then(|g| inside(&g.moved)),
        ssim: structure.map(|s| s.padded),
        ssim_inside: structure.map(|s| s.inside).filter(|s| s.is_finite()),
        lpips: distance(&picture, &truth)?,
        mask_share: Some(mask.share()).filter(|s| s.is_finite()),
        psnr_published_db: psnr_published_db(&picture, &truth, &mask),
        ssim_published: ssim(&picture_kept, &truth_kept).map(|s| s.padded),
        lpips_published: distance(&picture_kept, &truth_kept)?,
        depth_rmse: depth.map(|d| d.rmse),
        depth_abs_rel: depth.map(|d| d.abs_rel),
        depth_rmse_log: depth.map(|d| d.rmse_log),
        depth_within_1_25: depth.map(|d| d.within_1_25),
        source: sequence.outline().names().nth(frame).map(str::to_owned),
        repeats: false,
    })
}

#[cfg(test)]
impl Evaluation {
    /// Two held-out frames of 4 pixels. Liver is found on half of its pixels on the one frame; the
    /// other frame has no labels.
    pub(crate) fn example() -> Self {
        use surgtpgs_core::{grid::Mask, sequence::Class};
        let row = |frame, db| FrameRow {
            frame,
            psnr_db: Some(db - 5.0),
            psnr_masked_db: Some(db),
            ssim: Some(0.875),
            ..Default::default()
        };
        let mut classes = Classes::new(&[Class { id: 1, name: "liver".into(), colour: [0; 3] }]);
        let mask = |pixels: [bool; 4]| Mask::from_vec(4, 1, pixels.to_vec());
        for (frame, truth) in [(0, [true, true, false, false]), (8, [false; 4])] {
            let found = mask([true, false, false, false]);
            let measured = ClassOnFrame::measure(frame, "liver", &found, &mask(truth), &mask([true; 4]));
            classes.threshold.add(measured.expect("masks of one size"));
        }
        let frames = vec![row(0, 30.0), row(8, 40.0)];
        Self { report: EvalReport::of(&frames, true, &classes), frames, classes }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use surgtpgs_core::{scene::Chapter, stress::ordinary};

    #[test]
    fn frames_that_training_never_saw_do_not_count() {
        let mut scene = ordinary(3);
        assert_eq!(shown_frames(&scene, 4, &[]), [0, 1, 2, 3]);
        scene.cameras = vec![scene.cameras[0]; 20];
        // Stopped after the first of two chapters.
        let chapter = Chapter { index: 0, count: 2, shown: 0..10, learned: 0..12 };
        scene.provenance.settings = serde_json::json!({ "chapter": chapter, "excluded": [[3, 5]] });
        let scene = scene.as_chapter();
        let shown = shown_frames(&scene, 20, &[]);
        assert_eq!(shown, [0, 1, 2, 6, 7, 8, 9]);
        assert_eq!(shown_frames(&scene, 20, &[(0, 0), (7, 8)]), [1, 2, 6, 9], "left out since");
        assert_eq!(training_frames(&shown), [0, 2, 6, 7, 8], "1 and 9 are held out");
        let long: Vec<usize> = (0..1000).collect();
        assert!(training_frames(&long).len() <= MOST_TRAIN_FRAMES);
    }

    #[test]
    fn with_marks_held_out_frames_count_alone_if_there_are_some() {
        let shown: Vec<usize> = (0..20).collect();
        assert_eq!(frames_to_measure(&shown, true, &[]), [1, 9, 17]);
        assert_eq!(frames_to_measure(&shown, true, &[4, 9]), [1, 17]);
        assert_eq!(frames_to_measure(&shown[..5], false, &[1, 3]), [0, 2, 4]);
    }
}
