//! The pixels of each format.

use super::{Format, Provenance, masks, slugs, stamp};
use crate::{
    Error, Result,
    grid::{Grid, Mask},
    overlay::{OverlayPrompt, overlay},
};
use image::{DynamicImage, GrayImage, ImageFormat, Luma, RgbImage, Rgba, RgbaImage};
use rayon::prelude::*;

/// A file before it is written.
pub(super) struct File {
    /// Path inside the export, with `/`.
    pub(super) name: String,
    /// The prompt it is about; `None` where it shows all of them.
    pub(super) prompt: Option<String>,
    /// A PNG.
    pub(super) bytes: Vec<u8>,
}

/// What is in one file: a format, and a prompt where there is a file for each.
type Part = (Format, Option<usize>);

/// The parts of a frame, in the order of their files.
fn parts(provenance: &Provenance) -> Vec<Part> {
    let prompts = 0..provenance.prompts.len();
    let of_format = |&format: &Format| -> Vec<Part> {
        if format.is_per_prompt() {
            prompts.clone().map(|p| (format, Some(p))).collect()
        } else {
            vec![(format, None)]
        }
    };
    provenance.options.formats.iter().flat_map(of_format).collect()
}

/// Paths of the files of a frame inside the export.
pub(super) fn names(provenance: &Provenance, frame: usize) -> Vec<String> {
    let slugs = slugs(provenance.prompts.iter().map(|p| p.text.as_str()));
    parts(provenance).into_iter().map(|part| name(part, frame, &slugs)).collect()
}

fn name((format, prompt): Part, frame: usize, slugs: &[String]) -> String {
    match prompt {
        Some(p) => format!("{}/frame_{frame:06}_{}.png", format.folder(), slugs[p]),
        None => format!("{}/frame_{frame:06}.png", format.folder()),
    }
}

/// Draws and encodes every file of a frame; `picture` and `scores` (one per prompt) have one size.
pub(super) fn draw(
    provenance: &Provenance,
    frame: usize,
    picture: &RgbImage,
    scores: &[Grid<f32>],
) -> Result<Vec<File>> {
    let slugs = slugs(provenance.prompts.iter().map(|p| p.text.as_str()));
    let masks = masks(scores, &provenance.prompts, provenance.options.exclusive);
    let draw_one = |part: Part| -> Result<File> {
        let drawn: DynamicImage = match part {
            (Format::Cutout, Some(p)) => cutout(picture, &masks[p]).into(),
            (Format::Binary, Some(p)) => binary(&masks[p]).into(),
            (Format::Index, _) => index(provenance, scores).into(),
            _ => draw_overlay(provenance, picture, scores, &masks).into(),
        };
        Ok(File {
            name: name(part, frame, &slugs),
            prompt: part.1.map(|p| provenance.prompts[p].text.clone()),
            bytes: png(&drawn)?,
        })
    };
    parts(provenance).into_par_iter().map(draw_one).collect()
}

/// Straight alpha. What is cut away is black: a cut-out must not carry what it hides.
fn cutout(picture: &RgbImage, mask: &Mask) -> RgbaImage {
    RgbaImage::from_fn(picture.width(), picture.height(), |x, y| {
        let [r, g, b] = picture.get_pixel(x, y).0;
        if mask.at(x as usize, y as usize) { Rgba([r, g, b, 255]) } else { Rgba([0; 4]) }
    })
}

fn binary(mask: &Mask) -> GrayImage {
    GrayImage::from_fn(mask.width as u32, mask.height as u32, |x, y| {
        Luma([if mask.at(x as usize, y as usize) { 255 } else { 0 }])
    })
}

/// A pixel can carry one id only: prompts are exclusive here whatever the options say.
fn index(provenance: &Provenance, scores: &[Grid<f32>]) -> GrayImage {
    let masks = masks(scores, &provenance.prompts, true);
    let (width, height) = masks.first().map_or((0, 0), |m| (m.width as u32, m.height as u32));
    GrayImage::from_fn(width, height, |x, y| {
        let owner = masks.iter().position(|m| m.at(x as usize, y as usize));
        Luma([owner.map_or(0, |p| (p + 1) as u8)])
    })
}

fn draw_overlay(
    provenance: &Provenance,
    picture: &RgbImage,
    scores: &[Grid<f32>],
    masks: &[Mask],
) -> RgbImage {
    let options = &provenance.options;
    let owned: Vec<Grid<f32>> =
        scores.iter().zip(masks).map(|(s, m)| where_not_lost(s, m, options.exclusive)).collect();
    let prompts: Vec<OverlayPrompt<'_>> = owned
        .iter()
        .zip(&provenance.prompts)
        .map(|(scores, p)| OverlayPrompt { scores, threshold: p.threshold, colour: p.colour })
        .collect();
    let mut drawn = overlay(picture, &prompts, options.style, options.opacity);
    if options.stamp {
        stamp::stamp(&mut drawn);
    }
    drawn
}

/// The scores to draw: where prompts exclude each other, those of pixels that another prompt has won are dropped.
fn where_not_lost(scores: &Grid<f32>, mask: &Mask, exclusive: bool) -> Grid<f32> {
    let mut kept = scores.clone();
    if exclusive {
        kept.data.iter_mut().zip(&mask.data).filter(|(_, won)| !**won).for_each(|(s, _)| *s = 0.0);
    }
    kept
}

fn png(image: &DynamicImage) -> Result<Vec<u8>> {
    let mut bytes = std::io::Cursor::new(Vec::new());
    image.write_to(&mut bytes, ImageFormat::Png).map_err(|e| {
        Error::input(format!("a picture could not be encoded as PNG: {e}"), "Export at the recording's size.")
    })?;
    Ok(bytes.into_inner())
}
