//! The picture as it is shown, for the clipboard.

use crate::viewer::{
    picture::{
        marks::color_image,
        request::{Outlines, Picture},
    },
    state::view_mode::{Layer, ViewMode},
};
use egui::{ColorImage, Rect};
use image::{RgbImage, imageops};
use surgtpgs_core::{
    export::{caption, draw_scale, frame_words, stamp},
    strokes::draw_outlines,
};

/// State of the view that a copy is made of.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Shown<'a> {
    pub(crate) mode: ViewMode,
    /// `true` if everything drawn over the picture is hidden.
    pub(crate) is_hidden: bool,
    /// Position of the wipe's dividing line, as share of the width.
    pub(crate) wipe: f32,
    /// Time of the frame, seconds.
    pub(crate) seconds: f64,
    /// Cautions and other notes, which are written below the title.
    pub(crate) notes: &'a [String],
}

/// Makes a copy of what is shown, at the size of the picture: with what was found, its names, frame and time,
/// what must be known about it, and the words about its use. `seen` is the part of each pane's picture that
/// is seen, as share of it. `None` if nothing is shown.
pub(crate) fn copy(picture: &Picture, shown: Shown<'_>, seen: &[Rect]) -> Option<ColorImage> {
    let parts = parts(picture, shown);
    let whole = Rect::from_min_max(egui::Pos2::ZERO, egui::pos2(1.0, 1.0));
    let parts: Vec<RgbImage> =
        parts.iter().enumerate().map(|(k, part)| cut(part, *seen.get(k).unwrap_or(&whole))).collect();
    let width = parts.iter().map(RgbImage::width).sum();
    let mut all = RgbImage::new(width, parts.iter().map(RgbImage::height).max()?);
    let mut left = 0;
    for part in &parts {
        imageops::replace(&mut all, part, left, 0);
        left += i64::from(part.width());
    }
    let found = |(finding, prompt): (&crate::viewer::picture::request::Finding, &_)| {
        let is_found = finding.outcome.as_ref().is_ok_and(|f| f.area_px > 0);
        let name = finding.stand_in(prompt).unwrap_or(&finding.text).to_owned();
        is_found.then_some((name, prompt.colour))
    };
    let is_marked = !shown.is_hidden && shown.mode.layer().is_none() && shown.mode != ViewMode::Difference;
    let pairs = picture.findings.iter().zip(&picture.request.prompts);
    let found: Vec<_> = if is_marked { pairs.filter_map(found).collect() } else { Vec::new() };
    if is_marked && !found.is_empty() && picture.request.look.style.shows_scores() {
        draw_scale(&mut all, picture.request.look.palette);
    }
    let title = frame_words(picture.request.view.frame, shown.seconds);
    caption(&mut all, &format!("{}  {title}", shown.mode.label()), shown.notes, &found);
    stamp(&mut all);
    Some(color_image(&all))
}

/// Returns the pictures that are shown side by side.
fn parts(picture: &Picture, shown: Shown<'_>) -> Vec<RgbImage> {
    let pane = |pane: &Option<crate::viewer::picture::request::Pane>| {
        let pane = pane.as_ref()?;
        let marked = pane.marked.as_ref().filter(|_| !shown.is_hidden);
        let drawn = rgb(marked.unwrap_or(&pane.bare));
        Some(if shown.is_hidden { drawn } else { outlined(drawn, &picture.outlines) })
    };
    let (recorded, made) = (pane(&picture.original), pane(&picture.reconstruction));
    let layer = picture.layer.as_ref().map(|l| {
        let is_bare = shown.is_hidden || l.layer != Layer::Depth;
        if is_bare { rgb(&l.image) } else { outlined(rgb(&l.image), &picture.outlines) }
    });
    let parts = match shown.mode {
        ViewMode::Original | ViewMode::Blink => vec![recorded.or(made).or(layer)],
        ViewMode::Reconstruction => vec![made.or(recorded).or(layer)],
        ViewMode::SideBySide => vec![recorded, made],
        ViewMode::Wipe => vec![match (recorded, made) {
            (Some(left), Some(right)) => Some(wiped(&left, right, shown.wipe)),
            (recorded, made) => made.or(recorded),
        }],
        ViewMode::Difference => vec![picture.difference.as_ref().map(|d| rgb(&d.image)).or(made)],
        ViewMode::DepthBeside => vec![made, layer],
        ViewMode::Depth | ViewMode::Motion | ViewMode::Opacity => vec![layer.or(made)],
    };
    parts.into_iter().flatten().collect()
}

fn outlined(mut picture: RgbImage, outlines: &Outlines) -> RgbImage {
    draw_outlines(&mut picture, &outlines.lines, outlines.size, outlines.opacity);
    picture
}

fn wiped(left: &RgbImage, mut right: RgbImage, share: f32) -> RgbImage {
    let left = imageops::resize(left, right.width(), right.height(), imageops::FilterType::Triangle);
    let width = (right.width() as f32 * share.clamp(0.0, 1.0)) as u32;
    let part = imageops::crop_imm(&left, 0, 0, width, left.height()).to_image();
    imageops::replace(&mut right, &part, 0, 0);
    right
}

/// Cuts a part out, given as share of width and height.
fn cut(picture: &RgbImage, seen: Rect) -> RgbImage {
    let at = |share: f32, n: u32| (share.clamp(0.0, 1.0) * n as f32).round() as u32;
    let (width, height) = picture.dimensions();
    let (x, y) = (at(seen.left(), width), at(seen.top(), height));
    let (right, bottom) = (at(seen.right(), width).max(x + 1), at(seen.bottom(), height).max(y + 1));
    imageops::crop_imm(picture, x, y, right - x, bottom - y).to_image()
}

fn rgb(image: &ColorImage) -> RgbImage {
    let [width, height] = image.size.map(|n| n as u32);
    let pixel = |x: u32, y: u32| {
        let [r, g, b, _] = image.pixels[y as usize * image.size[0] + x as usize].to_array();
        image::Rgb([r, g, b])
    };
    RgbImage::from_fn(width, height, pixel)
}
