//! From the grid of points to the lists of masks.

use super::{
    BitMask, FoundMask, FrameMasks, Level, MaskSettings, PointSegmenter, gaps,
    grid::{self, Crop},
    nms::{box_nms, mask_nms},
    regions::without_small_regions,
    upsample::Upsampler,
};
use crate::{Error, Result, grid::Mask, mask::PixelRect};
use image::RgbImage;
use rayon::prelude::*;
use std::ops::ControlFlow;

/// An answer that passed the network's own rating and the test of stability.
struct Candidate {
    found: FoundMask,
    /// Which of the network's answers to its prompt.
    answer: usize,
    /// Pixels of the crop it was found on.
    crop_px: usize,
}

/// Finds everything on `image`. `keep` says which pixels matter; `progress` gets (prompts asked, prompts) and may ask to
/// stop, which is the error [`Error::Cancelled`].
///
/// A network whose answers have the wrong number of values is an error; values that are not numbers are outside.
pub fn automatic_masks(
    segmenter: &mut dyn PointSegmenter,
    image: &RgbImage,
    keep: &Mask,
    settings: &MaskSettings,
    progress: &mut dyn FnMut(usize, usize) -> ControlFlow<()>,
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
    let total = points.iter().map(Vec::len).sum::<usize>() + settings.gap_prompts;
    let mut done = 0;
    // The image itself is the first crop, asked last: the network then still knows it when gaps are looked at.
    let mut pools: [Vec<Vec<Candidate>>; 4] = Default::default();
    for (crop, points) in crops.iter().zip(&points).rev() {
        let mut told = |n: usize| {
            done += n;
            progress(done, total)
        };
        let found = ask_crop(segmenter, image, area, crop, points, settings, &mut told)?;
        for (pool, list) in pools.iter_mut().zip(lists_of_crop(found, settings)) {
            pool.push(list);
        }
    }
    let mut levels = pools.map(|mut pool| {
        pool.reverse();
        finish(pool.into_iter().flatten().collect(), keep, settings)
    });
    let default = &mut levels[Level::Default as usize];
    default.extend(gaps::fill(segmenter, default, keep, settings)?);
    if progress(total, total).is_break() {
        return Err(Error::Cancelled);
    }
    if settings.small_on_top {
        levels.iter_mut().for_each(|level| level.sort_by_key(|f| std::cmp::Reverse(f.mask.area_px())));
    }
    Ok(FrameMasks { width, height, levels })
}

/// Asks at every point of a crop; only good answers are kept.
fn ask_crop(
    segmenter: &mut dyn PointSegmenter,
    image: &RgbImage,
    area: PixelRect,
    crop: &Crop,
    points: &[[f32; 2]],
    settings: &MaskSettings,
    progress: &mut dyn FnMut(usize) -> ControlFlow<()>,
) -> Result<Vec<Candidate>> {
    let w = crop.window;
    let [x, y, width, height] = [w.x, w.y, w.width, w.height].map(|v| v as u32);
    segmenter.set_image(&image::imageops::crop_imm(image, x, y, width, height).to_image())?;
    let mut found = Vec::new();
    for batch in points.chunks(segmenter.batch().max(1)) {
        let prompts: Vec<_> = batch.iter().map(|point| vec![*point]).collect();
        for (answer, mask) in answers(segmenter, &prompts, [area.width, area.height], w, settings)? {
            let is_cut = crop.cuts(mask.mask.bounds(), area);
            let is_good =
                mask.predicted_iou > settings.min_predicted_iou && mask.stability >= settings.min_stability;
            if is_good && !is_cut {
                found.push(Candidate { found: mask, answer, crop_px: w.width * w.height });
            }
        }
        if progress(batch.len()).is_break() {
            return Err(Error::Cancelled);
        }
    }
    Ok(found)
}

/// Every answer to `prompts` that is worth a look, with its number among the answers to its prompt. Those that the
/// network rates too low for the grid are not brought to the image's size when there are points of a grid only.
pub(super) fn answers(
    segmenter: &mut dyn PointSegmenter,
    prompts: &[Vec<[f32; 2]>],
    image: [usize; 2],
    window: PixelRect,
    settings: &MaskSettings,
) -> Result<Vec<(usize, FoundMask)>> {
    let prediction = segmenter.predict(prompts)?;
    let [map_width, map_height] = prediction.size;
    let num = prompts.len() * prediction.masks_per_prompt;
    let map_len = map_width * map_height;
    if map_len == 0 || prediction.logits.len() != num * map_len || prediction.predicted_iou.len() != num {
        return Err(Error::input(
            format!(
                "the mask decoder gave {} logits and {} ratings for {} prompts with {} masks of {map_width}×{map_height}",
                prediction.logits.len(),
                prediction.predicted_iou.len(),
                prompts.len(),
                prediction.masks_per_prompt
            ),
            "Encoder and decoder may not belong together.",
        ));
    }
    let upsampler = Upsampler::new(image, window, prediction.size, prediction.extent);
    let is_single = prompts.first().is_none_or(|prompt| prompt.len() == 1);
    let least = if is_single { settings.min_predicted_iou } else { 0.0 };
    let look = |(i, logits): (usize, &[f32])| {
        let predicted_iou = prediction.predicted_iou[i];
        if !(predicted_iou > least) {
            return None;
        }
        let measured = upsampler.measure(logits, settings.stability_offset)?;
        let found = FoundMask { mask: measured.mask, predicted_iou, stability: measured.stability };
        Some((i % prediction.masks_per_prompt, found))
    };
    Ok(prediction.logits.par_chunks_exact(map_len).enumerate().filter_map(look).collect())
}

/// The candidates of a crop, all and by answer, without those that repeat another one's box.
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

/// The candidates of all crops to the final list of a level.
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
        found.retain(|f| 2 * px(f) >= f.mask.area_px() && px(f) as f32 <= most_px);
    }
    let scores: Vec<f32> = found.iter().map(|f| f.stability * f.predicted_iou).collect();
    let masks: Vec<&BitMask> = found.iter().map(|f| &f.mask).collect();
    let kept = mask_nms(&masks, &scores, &settings.mask_nms);
    take(found, kept)
}

/// Without small holes and islands; where two masks become alike by it, one that needed no mending stays.
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

/// The items with the numbers `kept`, in that order.
fn take<T>(items: Vec<T>, kept: Vec<usize>) -> Vec<T> {
    let mut items: Vec<Option<T>> = items.into_iter().map(Some).collect();
    kept.into_iter().filter_map(|i| items[i].take()).collect()
}
