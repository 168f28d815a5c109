//! `surgtpgs query`: the frames on which a scene shows the structures that the prompts name.

use super::{
    Exit,
    console::{ProgressView, print, print_data, print_json},
    objects, open_engine,
};
use crate::{
    args::{FrameRange, QueryVerbArgs},
    engine::Engine,
    outputs,
};
use std::path::PathBuf;
use surgtpgs_core::{Result, mask::Region, object::seen_area, raster::MIN_DEPTH_ALPHA};

/// The JSON report; its keys are a contract.
#[derive(serde::Serialize, serde::Deserialize)]
pub(super) struct Report {
    pub(super) prompts: Vec<PromptReport>,
    pub(super) threshold: f32,
    pub(super) relevancy: String,
    pub(super) renderer: String,
}

/// Report on one prompt.
#[derive(serde::Serialize, serde::Deserialize)]
pub(super) struct PromptReport {
    pub(super) text: String,
    pub(super) frames: Vec<FrameReport>,
    /// Gaussians that the prompt found, if asked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) gaussians: Option<GaussiansReport>,
}

/// Object that a prompt found, in three dimensions.
#[derive(serde::Serialize, serde::Deserialize)]
pub(super) struct GaussiansReport {
    /// Frame at whose time the Gaussians were found and written.
    pub(super) frame: usize,
    pub(super) count: usize,
    pub(super) file: PathBuf,
}

/// Report on one prompt on one frame: if it was found, and how much of it.
#[derive(serde::Serialize, serde::Deserialize)]
pub(super) struct FrameReport {
    pub(super) frame: usize,
    pub(super) found: bool,
    pub(super) area_px: usize,
    pub(super) area_fraction: f64,
    pub(super) max_score: f32,
    /// Area of the found pixels at their depth, facing the camera, in scene units².
    pub(super) seen_area: f64,
    /// File name of the recorded frame, where known.
    #[serde(default)]
    pub(super) source: Option<String>,
}

impl PromptReport {
    pub(super) fn frames_found(&self) -> usize {
        self.frames.iter().filter(|f| f.found).count()
    }

    pub(super) fn max_score(&self) -> f32 {
        self.frames.iter().map(|f| f.max_score).fold(0.0, f32::max)
    }

    /// Returns the frame where the prompt covers most; `None` if it is never found.
    pub(super) fn largest(&self) -> Option<&FrameReport> {
        self.frames.iter().filter(|f| f.found).max_by_key(|f| f.area_px)
    }
}

pub(super) fn run(args: &QueryVerbArgs) -> Result<Exit> {
    let mut engine = open_engine(&args.scene, args.relevancy.engine_options(&args.scene, None))?;
    engine.set_questions(&args.prompts.questions(engine.settings())?)?;
    let frames = FrameRange::frames(args.frames, engine.scene().num_frames())?;
    let inputs = outputs::inputs_of_engine(&args.scene.scene, &engine);
    let take = |folder| outputs::folder(folder, outputs::OBJECTS, &inputs, args.force);
    let objects = args.gaussians.as_deref().map(take).transpose()?;
    let mut report = query(&mut engine, &frames)?;
    if let Some((output, folder)) = objects.zip(args.gaussians.as_deref()) {
        objects::write(&mut engine, &mut report, output.path(), folder)?;
        output.finish()?;
    }
    if args.json {
        print_json(&report)?;
    } else if args.csv {
        print_data(&as_csv(&report))?;
    } else {
        print(&as_text(&report, frames.len()))?;
    }
    Ok(Exit::Done)
}

/// Asks the engine's prompts on `frames`.
pub(super) fn query(engine: &mut Engine, frames: &[usize]) -> Result<Report> {
    let mut prompts: Vec<PromptReport> = engine
        .queries()
        .iter()
        .map(|q| PromptReport {
            text: q.prompt.clone(),
            frames: Vec::with_capacity(frames.len()),
            gaussians: None,
        })
        .collect();
    let sources = engine.frame_sources();
    let mut view = ProgressView::default();
    for (done, &frame) in frames.iter().enumerate() {
        let at = engine.view(frame)?;
        let images = engine.render(&at, true)?;
        let scores = engine.scores(&images, &at)?;
        let masks = engine.masks(&scores);
        let depth = images.normalised_depth(MIN_DEPTH_ALPHA);
        for ((prompt, scores), mask) in prompts.iter_mut().zip(&scores).zip(&masks) {
            let region = Region::of(scores, mask);
            prompt.frames.push(FrameReport {
                frame,
                found: region.area_px > 0,
                area_px: region.area_px,
                area_fraction: region.area_fraction,
                max_score: region.max_score,
                seen_area: seen_area(mask, &depth, &at.camera),
                source: sources.get(frame).cloned(),
            });
        }
        view.count("asking", done + 1, frames.len());
    }
    Ok(Report {
        prompts,
        threshold: engine.settings().threshold,
        relevancy: engine.relevancy_name().into(),
        renderer: engine.renderer_name(),
    })
}

fn as_text(report: &Report, num_frames: usize) -> String {
    let line = |prompt: &PromptReport| {
        let found = match prompt.largest() {
            None => "nothing above the threshold".into(),
            Some(largest) => format!(
                "found on {} of {num_frames} frames, largest on frame {} ({} px, {:.1} %)",
                prompt.frames_found(),
                largest.frame,
                largest.area_px,
                100.0 * largest.area_fraction
            ),
        };
        // A score of 0.5 is a tie with the best of the phrases that the prompt is compared with.
        let caution = match prompt.max_score() {
            score if score < 0.5 && prompt.frames_found() > 0 => {
                "; no pixel prefers this phrase to the others"
            }
            _ => "",
        };
        let written = prompt.gaussians.as_ref().map_or(String::new(), |g| {
            format!("  {} Gaussians of frame {}: {}\n", g.count, g.frame, g.file.display())
        });
        format!("{}: {found}; best score {:.3}{caution}\n{written}", prompt.text, prompt.max_score())
    };
    report.prompts.iter().map(line).collect()
}

fn as_csv(report: &Report) -> String {
    let mut text = String::from("prompt,frame,found,area_px,area_fraction,max_score,source\n");
    for prompt in &report.prompts {
        let name = quoted(&prompt.text);
        for f in &prompt.frames {
            text += &format!(
                "{name},{},{},{},{},{},{}\n",
                f.frame,
                f.found,
                f.area_px,
                f.area_fraction,
                f.max_score,
                f.source.as_deref().map_or(String::new(), quoted)
            );
        }
    }
    text
}

/// Returns a CSV field in quotes.
fn quoted(text: &str) -> String {
    format!("\"{}\"", text.replace('"', "\"\""))
}
