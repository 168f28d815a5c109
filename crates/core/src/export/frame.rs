//! A frame with what was found on it, and what several formats want of it, made once.

use super::{ExportPrompt, Provenance, stamp};
use crate::{
    grid::{Grid, Mask},
    mask,
    overlay::{OverlayPrompt, overlay_layers},
};
use image::{RgbImage, imageops};
use std::{borrow::Cow, sync::OnceLock};

/// `picture` and `scores` (one per prompt) have one size.
pub(super) struct FrameContent<'a> {
    pub(super) provenance: &'a Provenance,
    pub(super) frame: usize,
    pub(super) picture: &'a RgbImage,
    pub(super) scores: &'a [Grid<f32>],
    /// Where instruments are, if that is known.
    tools: Option<&'a Mask>,
    /// The scores, cleaned up as the options say.
    cleaned: Vec<Cow<'a, Grid<f32>>>,
    /// One per prompt, as the options say.
    pub(super) masks: Vec<Mask>,
    disjoint: OnceLock<Vec<Mask>>,
    overlay: OnceLock<RgbImage>,
}

impl<'a> FrameContent<'a> {
    pub(super) fn new(
        provenance: &'a Provenance,
        frame: usize,
        picture: &'a RgbImage,
        scores: &'a [Grid<f32>],
        tools: Option<&'a Mask>,
    ) -> Self {
        let clean_up = provenance.options.clean_up;
        let prompts = scores.iter().zip(&provenance.prompts);
        let cleaned: Vec<_> = prompts.map(|(s, p)| clean_up.scores(s, p.threshold)).collect();
        let masks = masks(&cleaned, &provenance.prompts, provenance.options.exclusive);
        Self {
            provenance,
            frame,
            picture,
            scores,
            tools,
            cleaned,
            masks,
            disjoint: OnceLock::new(),
            overlay: OnceLock::new(),
        }
    }

    /// Columns and rows.
    pub(super) fn size(&self) -> (usize, usize) {
        (self.picture.width() as usize, self.picture.height() as usize)
    }

    /// The prompts with their masks.
    pub(super) fn found(&self) -> impl Iterator<Item = (&'a ExportPrompt, &Mask)> {
        self.provenance.prompts.iter().zip(&self.masks)
    }

    /// A label per pixel, 0 = nothing, else the number of the prompt counted from 1. A pixel can carry one label only:
    /// prompts are disjoint here whatever the options say.
    pub(super) fn label(&self, pixel: usize) -> u8 {
        let disjoint = self.disjoint.get_or_init(|| masks(&self.cleaned, &self.provenance.prompts, true));
        disjoint.iter().position(|m| m.data[pixel]).map_or(0, |prompt| (prompt + 1) as u8)
    }

    /// The picture with all prompts drawn over it, stamped if the options say so.
    pub(super) fn overlay(&self) -> &RgbImage {
        self.overlay.get_or_init(|| {
            let mut drawn = self.draw_over(self.picture, &self.kept_scores());
            if self.provenance.options.stamp {
                stamp::stamp(&mut drawn);
            }
            drawn
        })
    }

    /// As [`Self::overlay`], at most `max_width` columns wide and not stamped. Prompts are drawn at the small size, or
    /// their lines would fade.
    pub(super) fn small_overlay(&self, max_width: u32) -> RgbImage {
        let (width, height) = small_size(self.picture.dimensions(), max_width);
        if width == self.picture.width() {
            return self.draw_over(self.picture, &self.kept_scores());
        }
        let small = imageops::resize(self.picture, width, height, imageops::FilterType::Triangle);
        let scores: Vec<_> =
            self.kept_scores().iter().map(|s| s.sampled(width as usize, height as usize)).collect();
        self.draw_over(&small, &scores)
    }

    /// The scores to draw: where prompts exclude each other, those of pixels that another prompt has won are dropped.
    fn kept_scores(&self) -> Vec<Grid<f32>> {
        let mut kept: Vec<Grid<f32>> = self.cleaned.iter().map(|s| s.as_ref().clone()).collect();
        if self.provenance.options.exclusive {
            for (scores, mask) in kept.iter_mut().zip(&self.masks) {
                scores.data.iter_mut().zip(&mask.data).filter(|(_, won)| !**won).for_each(|(s, _)| *s = 0.0);
            }
        }
        kept
    }

    fn draw_over(&self, picture: &RgbImage, scores: &[Grid<f32>]) -> RgbImage {
        let options = &self.provenance.options;
        let layer = |(scores, p): (_, &ExportPrompt)| {
            (OverlayPrompt { scores, threshold: p.threshold, colour: p.colour }, p.is_instrument)
        };
        let layers: Vec<_> = scores.iter().zip(&self.provenance.prompts).map(layer).collect();
        overlay_layers(picture, &layers, self.tools, options.look)
    }
}

/// One mask per prompt, from its scores and threshold; disjoint if `exclusive`.
fn masks(scores: &[Cow<'_, Grid<f32>>], prompts: &[ExportPrompt], exclusive: bool) -> Vec<Mask> {
    if exclusive {
        let thresholds: Vec<f32> = prompts.iter().map(|p| p.threshold).collect();
        mask::exclusive(&scores.iter().map(Cow::as_ref).collect::<Vec<_>>(), &thresholds)
    } else {
        scores.iter().zip(prompts).map(|(s, p)| mask::threshold(s, p.threshold)).collect()
    }
}

/// `size` scaled down, its shape kept, to at most `max_width` columns.
pub(super) fn small_size((width, height): (u32, u32), max_width: u32) -> (u32, u32) {
    let small = width.min(max_width);
    let rows = (u64::from(height) * u64::from(small) + u64::from(width) / 2) / u64::from(width.max(1));
    (small, (rows as u32).max(1))
}
