//! The files of a single frame.

use super::{Format, Provenance, frame::FrameContent, outline, slugs, yolo};
use crate::{
    Error, Result, files,
    grid::{Grid, Mask},
};
use image::{DynamicImage, GrayImage, ImageBuffer, Luma, RgbImage, Rgba, RgbaImage};
use rayon::prelude::*;

/// A file before it is written.
pub(super) struct File {
    /// Path inside the export, with `/`.
    pub(super) name: String,
    /// The prompt it is about; `None` if it shows all of them.
    pub(super) prompt: Option<String>,
    pub(super) bytes: Vec<u8>,
}

/// Content of one file: a format, and a prompt if there is one file per frame and prompt.
type PictureFile = (Format, Option<usize>);

/// Returns the parts of a frame, in the order of their files.
fn parts(provenance: &Provenance) -> Vec<PictureFile> {
    let prompts = 0..provenance.prompts.len();
    let of_format = |&format: &Format| -> Vec<PictureFile> {
        if format.is_per_frame_and_prompt() {
            prompts.clone().map(|p| (format, Some(p))).collect()
        } else {
            vec![(format, None)]
        }
    };
    provenance.options.formats.iter().filter(|f| !f.is_series()).flat_map(of_format).collect()
}

/// Returns the paths of the files of a frame inside the export. A frame that the scene does not show has
/// none: an empty mask would say that nothing is there.
pub(super) fn names(provenance: &Provenance, frame: usize) -> Vec<String> {
    if !provenance.shows(frame) {
        return Vec::new();
    }
    let slugs = slugs(provenance.prompts.iter().map(|p| p.text.as_str()));
    parts(provenance).into_iter().map(|part| name(part, frame, &slugs)).collect()
}

fn name((format, prompt): PictureFile, frame: usize, slugs: &[String]) -> String {
    let prompt = prompt.map_or(String::new(), |p| format!("_{}", slugs[p]));
    format!("{}/frame_{frame:06}{prompt}.{}", format.name(), format.extension())
}

/// Draws and encodes every file of a frame.
pub(super) fn draw(frame: &FrameContent<'_>) -> Result<Vec<File>> {
    let provenance = frame.provenance;
    let slugs = slugs(provenance.prompts.iter().map(|p| p.text.as_str()));
    let draw_one = |part: PictureFile| -> Result<File> {
        let (format, prompt) = part;
        // Formats that are not per prompt have none, and do not look at it.
        let (mask, scores) = (&frame.masks[prompt.unwrap_or(0)], &frame.scores[prompt.unwrap_or(0)]);
        let bytes = match format {
            Format::Cutout => png(cutout(frame.picture, mask))?,
            Format::Binary => png(binary(mask))?,
            Format::Score => png(score(scores))?,
            Format::Npy => {
                files::npy(&[scores.height, scores.width], &scores.data, "Export another format.")?
            }
            Format::Overlay => png(frame.overlay().clone())?,
            Format::Index => png(index(frame))?,
            Format::Yolo => yolo::labels(frame).into_bytes(),
            Format::Outline => outline::svg(frame).into_bytes(),
            _ => return Err(Error::input("this format has one file about all frames", "")),
        };
        Ok(File {
            name: name(part, frame.frame, &slugs),
            prompt: part.1.map(|p| provenance.prompts[p].text.clone()),
            bytes,
        })
    };
    parts(provenance).into_par_iter().map(draw_one).collect()
}

/// Cuts out the masked pixels with straight alpha. All other pixels are black: a cut-out must not
/// carry hidden pixels.
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

fn index(frame: &FrameContent<'_>) -> GrayImage {
    let (width, height) = frame.size();
    GrayImage::from_fn(width as u32, height as u32, |x, y| {
        Luma([frame.label(y as usize * width + x as usize)])
    })
}

fn score(scores: &Grid<f32>) -> ImageBuffer<Luma<u16>, Vec<u16>> {
    ImageBuffer::from_fn(scores.width as u32, scores.height as u32, |x, y| {
        // NaN becomes 0 by the cast.
        let steps = f64::from(scores.at(x as usize, y as usize)) * f64::from(u16::MAX);
        Luma([steps.round() as u16])
    })
}

pub(super) fn png(picture: impl Into<DynamicImage>) -> Result<Vec<u8>> {
    files::png(picture, "Export at the recording's size.")
}
