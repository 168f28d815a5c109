//! `report.md` and `report.html` with their figures, and `report.json`.

use crate::{
    cli::{
        answers::Answers,
        document::{escaped, number, table, write_report},
        figures::{answers, answers_table, classes_table, comparison},
    },
    engine::Engine,
    evaluation::EvalReport,
    jobs::Trained,
    pictures::png,
};
use image::RgbImage;
use std::path::Path;
use surgtpgs_core::{Result, about::intended_use, files::write_whole};

/// Everything that the report tells.
pub(super) struct Findings<'a> {
    pub(super) trained: &'a Trained,
    pub(super) evaluation: &'a EvalReport,
    pub(super) answers: &'a Answers,
    /// Number of files of masked frames.
    pub(super) exported: usize,
}

/// Writes the report, its figures and its JSON into `folder`.
pub(super) fn write(folder: &Path, engine: &mut Engine, findings: &Findings<'_>) -> Result<()> {
    let figures = folder.join("figures");
    save(&comparison(engine, 1, u32::MAX)?, &figures.join("reconstruction.png"))?;
    let answers = answers(engine, findings.answers, u32::MAX)?;
    if let Some(picture) = &answers {
        save(picture, &figures.join("answers.png"))?;
    }
    write_report(folder, "SurgTPGS demo", &markdown(findings, answers.is_some()))?;
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

/// Returns the summary that a person reads at the end of the run.
pub(super) fn summary(folder: &Path, findings: &Findings<'_>) -> String {
    let e = findings.evaluation;
    let iou = e.iou.as_ref().map_or("unknown".into(), |i| {
        format!("{} by the paper's protocol, {} strictly", number(i.paper.mean, 3), number(i.strict.mean, 3))
    });
    let mut text = format!(
        "\n{} Gaussians trained in {:.0} s. On {} frames that training never saw: PSNR {} dB, IoU {iou}.\n\n",
        e.gaussians.unwrap_or(0),
        findings.trained.seconds,
        e.frames,
        number(e.psnr_masked_db, 3),
    );
    for prompt in &findings.answers.prompts {
        let found = match prompt.frames_found() {
            0 => prompt.why_not_found(),
            n => format!("found on {n} of {} frames", prompt.frames.len()),
        };
        text += &format!("  {:<14} {found}, best score {:.2}\n", prompt.text, prompt.max_score());
    }
    text += &format!("\nRead {}; masked frames are in masked-frames/.\n", folder.join("report.md").display());
    text
}

fn markdown(findings: &Findings<'_>, has_answers: bool) -> String {
    let e = findings.evaluation;
    let mut text = format!(
        "# SurgTPGS demo\n\n{}\n\n\
         A synthetic clip was recorded, prepared with the built-in text encoder and reconstructed; every eighth frame was\n\
         held out. The figures below are of those {} frames, which training never saw.\n\n\
         ![Recorded frame, reconstruction, depth](figures/reconstruction.png)\n\n\
         {}",
        intended_use(),
        e.frames,
        table(&["measured", "value"], measured(findings)),
    );
    if let Some(iou) = &e.iou {
        text += &format!("## Classes\n\n{}", classes_table(iou));
    }
    text += &format!("## Prompts\n\n{}", answers_table(findings.answers));
    if has_answers {
        text += "![What was found](figures/answers.png)\n";
    }
    text += "\nMasked frames: `masked-frames/`, made as `masked-frames/provenance.json` says. The scene: `scene.safetensors`.\n";
    text
}

/// Returns the rows of the table of figures.
fn measured(findings: &Findings<'_>) -> Vec<Vec<String>> {
    let (t, e) = (findings.trained, findings.evaluation);
    let frame = number(e.ms.as_ref().map(|ms| ms.frame), 1);
    let prompt = number(e.ms.as_ref().and_then(|ms| ms.relevancy), 3);
    let renderer = escaped(e.renderer.as_deref().unwrap_or("unknown"));
    [
        ("training", format!("{} steps in {:.1} s", t.steps, t.seconds)),
        ("Gaussians", e.gaussians.unwrap_or(0).to_string()),
        ("PSNR inside the picture", number(e.psnr_masked_db, 3) + " dB"),
        ("PSNR of training frames", number(e.train_psnr_db, 3) + " dB"),
        ("PSNR of the frames around, blended", number(e.blend_psnr_db, 3) + " dB"),
        ("PSNR of the same, moved by their flow", number(e.flow_psnr_db, 3) + " dB"),
        ("PSNR of all pixels", number(e.psnr_db, 3) + " dB"),
        ("SSIM", number(e.ssim, 3)),
        ("depth RMSE", number(e.depth_rmse, 3) + " scene units"),
        ("time of a frame", format!("{frame} ms, of a prompt {prompt} ms ({renderer})")),
    ]
    .map(|(what, value)| vec![what.into(), value])
    .into()
}

fn save(picture: &RgbImage, path: &Path) -> Result<()> {
    write_whole(path, &png(picture.clone())?)
}
