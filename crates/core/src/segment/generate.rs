//! The way from the grid of points to the lists of masks.

use super::{
    BitMask, FoundMask, FrameMasks, MaskSettings, PointSegmenter, Prediction, alike,
    grid::{self, Crop},
    nms::{box_nms, mask_nms},
    regions::without_small_regions,
    upsample::Upsampler,
};
use crate::{
    Error, Result,
    grid::Mask,
    mask::PixelRect,
    progress::{Observer, Progress},
};
use image::RgbImage;
use rayon::prelude::*;

/// Stage of finding masks in the progress.
pub(crate) const FINDING_MASKS: &str = "finding masks";

/// An answer that passed the network's own rating and the test of stability.
struct Candidate {
    found: FoundMask,
    /// Index of this answer among the network's answers to its prompt.
    answer: usize,
    /// Number of pixels of the crop it was found on.
    crop_px: usize,
}

/// Finds everything on `image`. `keep` marks the pixels that matter. Progress is counted in
/// prompts.
///
/// Fails if the answers of the network have the wrong number of values, or if the observer asks to stop.
/// Values that are not numbers count as outside.
pub fn automatic_masks(
    segmenter: &mut dyn PointSegmenter,
    image: &RgbImage,
    keep: &Mask,
    settings: &MaskSettings,
    observer: &mut Observer<'_>,
) -> Result<FrameMasks> {
    let (width, height) = (image.width() as usize, image.height() as usize);
    let area = PixelRect { x: 0, y: 0, width, height };
    let crops = grid::crops(area, settings);
    let asked_at = |crop: &Crop| -> Vec<[f32; 2]> {
        let is_wanted = |p: &[f32; 2]| {
            let (x, y) = (crop.window.x + p[0] as usize, crop.window.y + p[1] as usize);
            !settings.inside_only || keep.at(x.min(width - 1), y.min(height - 1))
        };
        crop.points().into_iter().filter(is_wanted).collect()
    };
    let points: Vec<_> = crops.iter().map(asked_at).collect();
    let total = points.iter().map(Vec::len).sum::<usize>() + settings.alike_prompts;
    let mut done = 0;
    let mut pools: [Vec<Vec<Candidate>>; 4] = Default::default();
    for (crop, points) in crops.iter().zip(points) {
        let mut told = |n: usize| {
            done += n;
            Progress::new(FINDING_MASKS, done, total).tell(observer)
        };
        let w = crop.window;
        let [x, y, columns, rows] = [w.x, w.y, w.width, w.height].map(|v| v as u32);
        segmenter.set_image(&image::imageops::crop_imm(image, x, y, columns, rows).to_image())?;
        let single: Vec<_> = points.into_iter().map(|point| vec![point]).collect();
        let mut found = ask(segmenter, &single, area, crop, settings, &mut told)?;
        if w == area {
            let features = segmenter.features();
            let groups = alike::prompts(image, features.as_ref(), keep, settings.alike_prompts);
            found.extend(ask(segmenter, &groups, area, crop, settings, &mut told)?);
        }
        for (pool, list) in pools.iter_mut().zip(lists_of_crop(found, settings)) {
            pool.push(list);
        }
    }
    let mut levels = pools.map(|pool| finish(pool.into_iter().flatten().collect(), keep, settings));
    Progress::new(FINDING_MASKS, total, total).tell(observer)?;
    if settings.small_on_top {
        levels.iter_mut().for_each(|level| level.sort_by_key(|f| std::cmp::Reverse(f.mask.area_px())));
    }
    Ok(FrameMasks { width, height, levels })
}

/// Asks about a crop and keeps only good answers. If a prompt has several points, its best answer is
/// passed back to the network to be improved.
fn ask(
    segmenter: &mut dyn PointSegmenter,
    prompts: &[Vec<[f32; 2]>],
    area: PixelRect,
    crop: &Crop,
    settings: &MaskSettings,
    tell: &mut dyn FnMut(usize) -> Result<()>,
) -> Result<Vec<Candidate>> {
    let mut found = Vec::new();
    for batch in prompts.chunks(segmenter.batch().max(1)) {
        let first = checked(segmenter.predict(batch, None)?, batch.len())?;
        let betters = batch.iter().all(|p| p.len() > 1) && segmenter.earlier_size() == Some(first.size);
        let second = match betters.then(|| best_answers(&first)) {
            Some(earlier) => Some(checked(segmenter.predict(batch, Some(&earlier))?, batch.len())?),
            None => None,
        };
        for prediction in [Some(first), second].into_iter().flatten() {
            found.extend(candidates(&prediction, area, crop, settings));
        }
        tell(batch.len())?;
    }
    Ok(found)
}

/// Returns an error if the lengths of an answer do not fit.
pub(super) fn checked(prediction: Prediction, num_prompts: usize) -> Result<Prediction> {
    let [width, height] = prediction.size;
    let (answers, len) = (prediction.masks_per_prompt, width * height);
    let num = num_prompts * answers;
    if num == 0 || len == 0 || prediction.logits.len() != num * len || prediction.predicted_iou.len() != num {
        return Err(Error::input(
            format!(
                "the mask decoder gave {} logits and {} ratings for {num_prompts} prompts with {answers} masks of {width}×{height}",
                prediction.logits.len(),
                prediction.predicted_iou.len(),
            ),
            "Encoder and decoder may not belong together.",
        ));
    }
    Ok(prediction)
}

/// Returns the logits of each prompt's best-rated answer, within the range that Segment Anything reads.
fn best_answers(prediction: &Prediction) -> Vec<f32> {
    /// Largest logit that Segment Anything's own interactive prediction passes back.
    const LARGEST: f32 = 32.0;
    let len = prediction.size[0] * prediction.size[1];
    let answers = prediction.masks_per_prompt;
    let best = |(prompt, ratings): (usize, &[f32])| {
        let best = (0..answers).max_by(|&a, &b| ratings[a].total_cmp(&ratings[b])).unwrap_or(0);
        prompt * answers + best
    };
    let numbers = prediction.predicted_iou.chunks_exact(answers).enumerate().map(best);
    let logits = numbers.flat_map(|number| &prediction.logits[number * len..][..len]);
    logits.map(|v| v.clamp(-LARGEST, LARGEST)).collect()
}

/// Returns the good answers among `prediction`, at the size of the image.
fn candidates(
    prediction: &Prediction,
    area: PixelRect,
    crop: &Crop,
    settings: &MaskSettings,
) -> Vec<Candidate> {
    let w = crop.window;
    let upsampler = Upsampler::new([area.width, area.height], w, prediction.size, prediction.extent);
    let look = |(i, logits): (usize, &[f32])| {
        let predicted_iou = prediction.predicted_iou[i];
        if !(predicted_iou > settings.min_predicted_iou) {
            return None;
        }
        let measured = upsampler.measure(logits, settings.stability_offset)?;
        let is_good = measured.stability >= settings.min_stability;
        let found = FoundMask { mask: measured.mask, predicted_iou, stability: measured.stability };
        (is_good && !crop.cuts(found.mask.bounds(), area)).then(|| Candidate {
            found,
            answer: i % prediction.masks_per_prompt,
            crop_px: w.width * w.height,
        })
    };
    let maps = prediction.logits.par_chunks_exact(prediction.size[0] * prediction.size[1]);
    maps.enumerate().filter_map(look).collect()
}

/// Returns the candidates of a crop, all and by answer, without those that repeat another one's box.
fn lists_of_crop(found: Vec<Candidate>, settings: &MaskSettings) -> [Vec<Candidate>; 4] {
    let mut lists: [Vec<Candidate>; 4] = Default::default();
    for candidate in found {
        if let Some(list) = lists.get_mut(candidate.answer + 1) {
            list.push(Candidate { found: candidate.found.clone(), ..candidate });
        }
        lists[0].push(candidate);
    }
    lists.map(|list| {
        let ratings: Vec<f32> = list.iter().map(|c| c.found.predicted_iou).collect();
        let kept = box_nms(&boxes(list.iter().map(|c| &c.found.mask)), &ratings, settings.box_nms_iou);
        take(list, kept)
    })
}

/// Turns the candidates of all crops into the final list of a level.
fn finish(candidates: Vec<Candidate>, keep: &Mask, settings: &MaskSettings) -> Vec<FoundMask> {
    let candidates = if settings.crop_layers > 0 {
        // Masks of smaller crops are finer.
        let scores: Vec<f32> = candidates.iter().map(|c| 1.0 / c.crop_px as f32).collect();
        let kept = box_nms(&boxes(candidates.iter().map(|c| &c.found.mask)), &scores, settings.crop_nms_iou);
        take(candidates, kept)
    } else {
        candidates
    };
    let found: Vec<FoundMask> = candidates.into_iter().map(|c| c.found).collect();
    let mut found = mended(found, settings);
    if settings.inside_only {
        let inside = BitMask::of(keep);
        let px = |f: &FoundMask| inside.as_ref().map_or(0, |inside| inside.intersection_px(&f.mask));
        let most_px = settings.max_share * keep.count() as f32;
        let says_something = |f: &FoundMask| px(f) as f32 <= most_px;
        found.retain(|f| 2 * px(f) >= f.mask.area_px());
        if found.iter().any(says_something) {
            found.retain(says_something);
        }
    }
    let scores: Vec<f32> = found.iter().map(|f| f.stability * f.predicted_iou).collect();
    let masks: Vec<&BitMask> = found.iter().map(|f| &f.mask).collect();
    let kept = mask_nms(&masks, &scores, &settings.mask_nms);
    take(found, kept)
}

/// Removes small holes and islands. If two masks become alike by this, one that was not changed stays.
fn mended(found: Vec<FoundMask>, settings: &MaskSettings) -> Vec<FoundMask> {
    let mend = |f: FoundMask| match without_small_regions(&f.mask, settings.min_region_px) {
        Some(mask) => (FoundMask { mask, ..f }, 0.0),
        None => (f, 1.0),
    };
    let (found, scores): (Vec<FoundMask>, Vec<f32>) = found.into_par_iter().map(mend).unzip();
    let limit = settings.box_nms_iou.max(settings.crop_nms_iou);
    let kept = box_nms(&boxes(found.iter().map(|f| &f.mask)), &scores, limit);
    take(found, kept)
}

fn boxes<'a>(masks: impl Iterator<Item = &'a BitMask>) -> Vec<PixelRect> {
    masks.map(BitMask::bounds).collect()
}

/// Returns the items with the numbers `kept`, in that order.
fn take<T>(items: Vec<T>, kept: Vec<usize>) -> Vec<T> {
    let mut items: Vec<Option<T>> = items.into_iter().map(Some).collect();
    kept.into_iter().filter_map(|i| items[i].take()).collect()
}
