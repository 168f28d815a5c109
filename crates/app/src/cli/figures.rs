//! Pictures and tables of a scene for reports.

use super::{
    answers::Answers,
    document::{escaped, number, table},
};
use crate::{
    engine::Engine,
    evaluation::Iou,
    pictures::{narrowed, side_by_side, stacked},
    settings::prompt_colour,
};
use image::RgbImage;
use surgtpgs_core::{
    Result,
    num::spread,
    overlay::{OverlayLook, OverlayPrompt, OverlayStyle, overlay},
    raster::Images,
    sequence::Sequence,
};

/// Draws frames, evenly spread over those that are evaluated: each as recorded, as reconstructed,
/// and its depth (near is bright).
pub(super) fn comparison(engine: &mut Engine, count: usize, panel_width: u32) -> Result<RgbImage> {
    let held_out = engine.scene().provenance.held_out;
    let n = engine.scene().num_frames();
    let frames: Vec<usize> = (0..n).filter(|&i| !held_out || Sequence::is_test_frame(i)).collect();
    let mut rows = Vec::new();
    for frame in spread(frames.len(), count).map(|k| frames[k]) {
        let images = engine.render(&engine.view(frame)?, false)?;
        let pictures = engine.original(frame)?.into_iter().chain([images.to_rgb(), depth(&images)]);
        rows.push(side_by_side(&pictures.map(|p| narrowed(p, panel_width)).collect::<Vec<_>>()));
    }
    Ok(stacked(&rows))
}

fn depth(images: &Images) -> RgbImage {
    let depth = images.normalised_depth();
    let known = || depth.data.iter().copied().filter(|z| *z > 0.0);
    let (near, far) = (known().fold(f32::INFINITY, f32::min), known().fold(0.0, f32::max));
    RgbImage::from_fn(depth.width as u32, depth.height as u32, |x, y| {
        let z = depth.at(x as usize, y as usize);
        let bright = if z > 0.0 { 255.0 - 215.0 * (z - near) / (far - near).max(1e-6) } else { 0.0 };
        image::Rgb([bright as u8; 3])
    })
}

/// Draws each prompt that was found, on the frame where it covers most, three in a row; `None` if nothing was
/// found. The engine must have the prompts that were asked.
pub(super) fn answers(engine: &mut Engine, answers: &Answers, panel_width: u32) -> Result<Option<RgbImage>> {
    let found = answers.prompts.iter().enumerate().filter_map(|(k, p)| p.largest().map(|f| (k, f.frame)));
    let mut pictures = Vec::new();
    for (k, frame) in found {
        let view = engine.view(frame)?;
        let images = engine.render(&view, true)?;
        let scores = engine.scores(&images, &view)?;
        let picture = engine.original(frame)?.unwrap_or_else(|| images.to_rgb());
        let (threshold, colour) = (engine.settings().threshold, prompt_colour(k));
        let prompt = |scores| (OverlayPrompt::new(scores, threshold, colour), false);
        let drawn: Vec<_> = scores.get(k).into_iter().map(prompt).collect();
        let look = OverlayLook { style: OverlayStyle::Fill, opacity: 0.45, ..Default::default() };
        let drawn = overlay(&picture, &drawn, None, look, picture.dimensions());
        pictures.push(narrowed(drawn, panel_width));
    }
    let rows: Vec<RgbImage> = pictures.chunks(3).map(side_by_side).collect();
    Ok((!rows.is_empty()).then(|| stacked(&rows)))
}

/// Returns the table of the IoU of each class.
pub(super) fn classes_table(iou: &Iou) -> String {
    let all = vec!["all".into(), number(iou.paper.mean, 3), number(iou.strict.mean, 3)];
    let each = iou.strict.classes.iter().map(|(name, strict)| {
        let paper = iou.paper.classes.get(name).copied();
        vec![escaped(name), number(paper, 3), number(Some(*strict), 3)]
    });
    table(&["class", "IoU, paper's protocol", "IoU, strict"], [all].into_iter().chain(each))
}

/// Returns the table of the frames and areas on which each prompt was found.
pub(super) fn answers_table(answers: &Answers) -> String {
    let rows = answers.prompts.iter().map(|prompt| {
        let largest = match prompt.largest() {
            Some(f) => format!("{:.1} % of frame {}", 100.0 * f.area_fraction.unwrap_or(0.0), f.frame),
            None => escaped(&prompt.why_not_found()),
        };
        let found = format!("{} of {} frames", prompt.frames_found(), prompt.frames_shown());
        vec![escaped(&prompt.text), found, largest, format!("{:.2}", prompt.max_score())]
    });
    format!(
        "A pixel is found where its similarity score is above {}.\n\n{}",
        answers.threshold,
        table(&["prompt", "found on", "largest area", "best score"], rows)
    )
}
