//! The content of an exported frame. Intermediate results that several formats need are computed once.

use super::{ExportOptions, ExportPrompt, Provenance, caption, stamp};
use crate::{
    grid::{Grid, Mask},
    mask,
    overlay::overlay,
};
use image::RgbImage;
use std::{borrow::Cow, sync::OnceLock};

/// A frame with the masks of all prompts. `picture` and `scores` (one per prompt) have one size.
pub(super) struct FrameContent<'a> {
    pub(super) provenance: &'a Provenance,
    pub(super) frame: usize,
    pub(super) picture: &'a RgbImage,
    pub(super) scores: &'a [Grid<f32>],
    /// Pixels of instruments, if known.
    tools: Option<&'a Mask>,
    /// Scores after the clean-up that the options ask for.
    cleaned: Vec<Cow<'a, Grid<f32>>>,
    /// Masks, one per prompt, as the options ask for.
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

    /// Returns columns and rows.
    pub(super) fn size(&self) -> (usize, usize) {
        (self.picture.width() as usize, self.picture.height() as usize)
    }

    /// Returns `true` if the scene shows the frame, so that what is not found is not there.
    pub(super) fn is_shown(&self) -> bool {
        self.provenance.shows(self.frame)
    }

    /// Returns the prompts with their masks.
    pub(super) fn found(&self) -> impl Iterator<Item = (&'a ExportPrompt, &Mask)> {
        self.provenance.prompts.iter().zip(&self.masks)
    }

    /// Returns the label of a pixel: 0 = nothing, else the number of the prompt counted from 1. A pixel
    /// can carry only one label, so prompts are disjoint here whatever the options say.
    pub(super) fn label(&self, pixel: usize) -> u8 {
        let disjoint = self.disjoint.get_or_init(|| masks(&self.cleaned, &self.provenance.prompts, true));
        disjoint.iter().position(|m| m.data[pixel]).map_or(0, |prompt| (prompt + 1) as u8)
    }

    /// Returns the picture with all prompts drawn over it, at the size and with the words that the options
    /// say.
    pub(super) fn overlay(&self) -> &RgbImage {
        self.overlay.get_or_init(|| {
            let options = &self.provenance.options;
            let mut drawn = self.drawn(options.width_px.unwrap_or(self.picture.width()));
            if options.look.style.shows_scores() {
                caption::draw_scale(&mut drawn, options.look.palette);
            }
            if options.captions {
                self.write_caption(&mut drawn);
            }
            if options.stamp {
                stamp::stamp(&mut drawn);
            }
            drawn
        })
    }

    /// Writes frame, time and the prompts that were found on an exported picture.
    pub(super) fn write_caption(&self, picture: &mut RgbImage) {
        let found = self.found().filter(|(_, mask)| mask.count() > 0);
        let found: Vec<_> = found.map(|(p, _)| (caption::prompt_words(p), p.colour)).collect();
        let title = caption::frame_words(self.frame, self.provenance.shown_seconds(self.frame));
        let state = if self.is_shown() { "" } else { "  not reconstructed" };
        caption::caption(picture, &format!("{title}{state}"), &[], &found);
    }

    /// Returns the overlay at most `max_width` columns wide, without words.
    pub(super) fn small_overlay(&self, max_width: u32) -> RgbImage {
        self.drawn(self.picture.width().min(max_width))
    }

    /// Draws all prompts over the picture, `width` columns wide.
    fn drawn(&self, width: u32) -> RgbImage {
        let options = &self.provenance.options;
        let scores = self.kept_scores();
        let layer = |(scores, p): (_, &ExportPrompt)| (p.drawn(scores), p.is_instrument);
        let layers: Vec<_> = scores.iter().zip(&self.provenance.prompts).map(layer).collect();
        let size = scaled_size(self.picture.dimensions(), width);
        overlay(self.picture, &layers, self.tools, options.look, size)
    }

    /// Returns the scores to draw. If prompts exclude each other, scores of pixels that another prompt
    /// has won are dropped.
    fn kept_scores(&self) -> Vec<Grid<f32>> {
        let mut kept: Vec<Grid<f32>> = self.cleaned.iter().map(|s| s.as_ref().clone()).collect();
        if self.provenance.options.exclusive {
            let (width, height) = self.size();
            let mut won = vec![false; width * height];
            for mask in &self.masks {
                won.iter_mut().zip(&mask.data).for_each(|(won, own)| *won |= own);
            }
            for (scores, mask) in kept.iter_mut().zip(&self.masks) {
                let pixels = scores.data.iter_mut().zip(mask.data.iter().zip(&won));
                pixels.filter(|(_, (own, won))| **won && !**own).for_each(|(score, _)| *score = 0.0);
            }
        }
        kept
    }
}

/// Returns one mask per prompt, from its scores and threshold; disjoint if `exclusive`.
fn masks(scores: &[Cow<'_, Grid<f32>>], prompts: &[ExportPrompt], exclusive: bool) -> Vec<Mask> {
    if exclusive {
        let thresholds: Vec<f32> = prompts.iter().map(|p| p.threshold).collect();
        mask::exclusive(&scores.iter().map(Cow::as_ref).collect::<Vec<_>>(), &thresholds)
    } else {
        scores.iter().zip(prompts).map(|(s, p)| mask::threshold(s, p.threshold)).collect()
    }
}

/// Returns columns and rows of pictures of a size with prompts drawn over them.
pub(super) fn drawn_size(options: &ExportOptions, size: (u32, u32)) -> (u32, u32) {
    scaled_size(size, options.width_px.unwrap_or(size.0))
}

/// Returns the size of a picture that is made `width` columns wide and keeps its shape.
pub(super) fn scaled_size(size: (u32, u32), width: u32) -> (u32, u32) {
    let rows = (u64::from(size.1) * u64::from(width) + u64::from(size.0) / 2) / u64::from(size.0.max(1));
    (width.max(1), (rows as u32).max(1))
}

/// Scales `size` down to at most `max_width` columns and keeps its shape.
pub(super) fn small_size(size: (u32, u32), max_width: u32) -> (u32, u32) {
    scaled_size(size, size.0.min(max_width))
}
