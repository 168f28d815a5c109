//! `report.md` with its figures and `report.json`.

use crate::{
    cli::{
        eval,
        pictures::{png, side_by_side, stacked},
        query,
    },
    engine::Engine,
    jobs::Trained,
    settings::PROMPT_COLOURS,
};
use image::RgbImage;
use std::path::Path;
use surgtpgs_core::{
    Result,
    export::intended_use,
    files::write_whole,
    overlay::{OverlayLook, OverlayPrompt, OverlayStyle, overlay},
    sequence::Sequence,
};

/// Everything that the report tells.
pub(super) struct Findings<'a> {
    pub(super) trained: &'a Trained,
    pub(super) evaluation: &'a eval::Report,
    pub(super) answers: &'a query::Report,
    /// Files of masked frames.
    pub(super) exported: usize,
}

/// Writes the report, its figures and its JSON into `folder`.
pub(super) fn write(folder: &Path, engine: &mut Engine, findings: &Findings<'_>) -> Result<()> {
    let figures = folder.join("figures");
    save(&comparison(engine)?, &figures.join("reconstruction.png"))?;
    let answers = figure_of_answers(engine, findings.answers)?;
    if let Some(picture) = &answers {
        save(picture, &figures.join("answers.png"))?;
    }
    write_whole(&folder.join("report.md"), markdown(findings, answers.is_some()).as_bytes())?;
    let json = serde_json::json!({
        "intended_use": intended_use(),
        "train": { "seconds": findings.trained.seconds, "steps": findings.trained.steps,
                   "psnr_db": findings.trained.psnr_db },
        "eval": findings.evaluation,
        "query": findings.answers,
        "exported_files": findings.exported,
    });
    let text = serde_json::to_string_pretty(&json).unwrap_or_default() + "\n";
    write_whole(&folder.join("report.json"), text.as_bytes())
}

/// What a person wants to know at the end of the run.
pub(super) fn summary(folder: &Path, findings: &Findings<'_>) -> String {
    let e = findings.evaluation;
    let iou = e.iou.as_ref().map_or("unknown".into(), |i| {
        format!("{} by the paper's protocol, {} strictly", number(i.paper.mean), number(i.strict.mean))
    });
    let mut text = format!(
        "\n{} Gaussians trained in {:.0} s. On {} frames that training never saw: PSNR {} dB, IoU {iou}.\n\n",
        e.gaussians.unwrap_or(0),
        findings.trained.seconds,
        e.frames,
        number(e.psnr_masked_db),
    );
    for prompt in &findings.answers.prompts {
        let found = match prompt.frames_found() {
            0 => "not found".into(),
            n => format!("found on {n} of {} frames", prompt.frames.len()),
        };
        text += &format!("  {:<14} {found}, best score {:.2}\n", prompt.text, prompt.max_score());
    }
    text += &format!("\nRead {}; masked frames are in masked-frames/.\n", folder.join("report.md").display());
    text
}

fn markdown(findings: &Findings<'_>, has_answers: bool) -> String {
    let (t, e) = (findings.trained, findings.evaluation);
    let mut text = format!(
        "# SurgTPGS demo\n\n{}\n\n\
         A synthetic clip was recorded, prepared with the built-in text encoder and reconstructed; every eighth frame was\n\
         held out. The figures below are of those {} frames, which training never saw.\n\n\
         ![Recorded frame, reconstruction, depth](figures/reconstruction.png)\n\n\
         | measured | value |\n|---|---|\n\
         | training | {} steps in {:.1} s |\n| Gaussians | {} |\n| PSNR inside the picture | {} dB |\n\
         | PSNR of all pixels | {} dB |\n| SSIM | {} |\n| depth RMSE | {} scene units |\n\
         | time of a frame | {:.1} ms, of a prompt {} ms ({}) |\n\n",
        intended_use(),
        e.frames,
        t.steps,
        t.seconds,
        e.gaussians.unwrap_or(0),
        number(e.psnr_masked_db),
        number(e.psnr_db),
        number(e.ssim),
        number(e.depth_rmse),
        e.ms.as_ref().map_or(f64::NAN, |ms| ms.frame),
        number(e.ms.as_ref().and_then(|ms| ms.relevancy)),
        e.renderer.as_deref().unwrap_or("unknown"),
    );
    text += &classes_table(e);
    text += &answers_table(findings.answers);
    if has_answers {
        text += "\n![What was found](figures/answers.png)\n";
    }
    text += "\nMasked frames: `masked-frames/`, made as `masked-frames/provenance.json` says. The scene: `scene.safetensors`.\n";
    text
}

fn classes_table(evaluation: &eval::Report) -> String {
    let Some(iou) = &evaluation.iou else { return String::new() };
    let mut text = format!(
        "## Classes\n\n| class | IoU, paper's protocol | IoU, strict |\n|---|---|---|\n| all | {} | {} |\n",
        number(iou.paper.mean),
        number(iou.strict.mean)
    );
    for (name, strict) in &iou.strict.classes {
        text += &format!("| {name} | {} | {strict:.3} |\n", number(iou.paper.classes.get(name).copied()));
    }
    text + "\n"
}

fn answers_table(answers: &query::Report) -> String {
    let mut text = format!(
        "## Prompts\n\nA pixel is found where its similarity score is above {}.\n\n\
         | prompt | found on | largest area | best score |\n|---|---|---|---|\n",
        answers.threshold
    );
    for prompt in &answers.prompts {
        let largest = prompt
            .largest()
            .map_or("nothing".into(), |f| format!("{:.1} % of frame {}", 100.0 * f.area_fraction, f.frame));
        text += &format!(
            "| {} | {} of {} frames | {largest} | {:.2} |\n",
            prompt.text,
            prompt.frames_found(),
            prompt.frames.len(),
            prompt.max_score()
        );
    }
    text
}

fn number(value: Option<f64>) -> String {
    value.map_or("unknown".into(), |v| format!("{v:.3}"))
}

/// A held-out frame as recorded, as reconstructed, and its depth (near is bright).
fn comparison(engine: &mut Engine) -> Result<RgbImage> {
    let n = engine.scene().num_frames();
    let held_out: Vec<usize> = (0..n).filter(|&i| Sequence::is_test_frame(i)).collect();
    let frame = held_out.get(held_out.len() / 2).copied().unwrap_or(0);
    let view = engine.view(frame)?;
    let images = engine.render(&view, false)?;
    let mut pictures: Vec<RgbImage> = engine.original(frame)?.into_iter().collect();
    pictures.push(images.to_rgb());
    let depth = images.normalised_depth(0.5);
    let known = || depth.data.iter().copied().filter(|z| *z > 0.0);
    let (near, far) = (known().fold(f32::INFINITY, f32::min), known().fold(0.0, f32::max));
    pictures.push(RgbImage::from_fn(depth.width as u32, depth.height as u32, |x, y| {
        let z = depth.at(x as usize, y as usize);
        let bright = if z > 0.0 { 255.0 - 215.0 * (z - near) / (far - near).max(1e-6) } else { 0.0 };
        image::Rgb([bright as u8; 3])
    }));
    Ok(side_by_side(&pictures))
}

/// Each prompt that was found, on the frame where it covers most, three in a row; `None` if nothing was found.
fn figure_of_answers(engine: &mut Engine, answers: &query::Report) -> Result<Option<RgbImage>> {
    let found = answers.prompts.iter().filter_map(|p| p.largest().map(|f| (p.text.clone(), f.frame)));
    let mut pictures = Vec::new();
    for (k, (prompt, frame)) in found.enumerate() {
        engine.set_prompts(&[prompt])?;
        let view = engine.view(frame)?;
        let images = engine.render(&view, true)?;
        let scores = engine.scores(&images, &view)?;
        let picture = engine.original(frame)?.unwrap_or_else(|| images.to_rgb());
        let threshold = engine.settings().threshold;
        let colour = PROMPT_COLOURS[k % PROMPT_COLOURS.len()];
        let drawn: Vec<OverlayPrompt<'_>> =
            scores.iter().map(|scores| OverlayPrompt { scores, threshold, colour }).collect();
        let look = OverlayLook { style: OverlayStyle::Fill, opacity: 0.45, ..Default::default() };
        pictures.push(overlay(&picture, &drawn, look));
    }
    let rows: Vec<RgbImage> = pictures.chunks(3).map(side_by_side).collect();
    Ok((!rows.is_empty()).then(|| stacked(&rows)))
}

fn save(picture: &RgbImage, path: &Path) -> Result<()> {
    write_whole(path, &png(picture.clone())?)
}
