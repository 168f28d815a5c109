//! Masked frames of a scene, written to a folder.

use super::{Observer, Progress};
use crate::{engine::Engine, outputs, settings::PROMPT_COLOURS};
use image::RgbImage;
use std::{
    collections::{BTreeMap, btree_map::Entry},
    path::Path,
};
use surgtpgs_core::{
    Error, Remedy, Result,
    export::{Export, ExportOptions, ExportPrompt, ExportSummary, PictureSource, Provenance},
    files::{Claim, Earlier, OutputFolder},
    grid::Grid,
    hash::file_sha256,
    mask::mean_scores,
    sequence::names_instrument,
};

/// Returns the engine's prompts as an export records them: the threshold is that of the engine's settings,
/// colours come in order, and instruments are recognised by their names.
pub fn export_prompts(engine: &Engine) -> Vec<ExportPrompt> {
    let colours = PROMPT_COLOURS.iter().cycle();
    let prompt = |(query, &colour): (&surgtpgs_core::relevancy::Query, &[u8; 3])| ExportPrompt {
        text: query.prompt.clone(),
        threshold: engine.settings().threshold,
        colour,
        negatives: query.negatives.iter().map(|(words, _)| words.clone()).collect(),
        is_instrument: names_instrument(&query.prompt),
    };
    engine.queries().iter().zip(colours).map(prompt).collect()
}

/// Request to export masked frames.
#[derive(Clone, Debug)]
pub struct ExportRequest<'a> {
    /// The scene file that the engine has open.
    pub scene: &'a Path,
    /// Folder to write.
    pub folder: &'a Path,
    /// Frames, counted from 0.
    pub frames: Vec<usize>,
    /// The engine's prompts, see [`export_prompts`].
    pub prompts: Vec<ExportPrompt>,
    /// Options of the export.
    pub options: ExportOptions,
    /// `true` if another export may be replaced, once this one is whole.
    pub replace: bool,
    /// `true` if the same export is completed where it is there already, instead of being made anew.
    pub completes_same: bool,
}

/// Writes masked frames. Stops when the observer says so; the next export goes on from there.
pub fn export(
    engine: &mut Engine,
    request: ExportRequest<'_>,
    observer: &mut Observer<'_>,
) -> Result<ExportSummary> {
    let ExportRequest { scene, folder, frames, prompts, options, replace, completes_same } = request;
    let (source, reach) = (options.source, options.clean_up.smooth_frames);
    let mut scorer = Scorer { reach, known: BTreeMap::new() };
    if let (PictureSource::Original, Some(why)) = (source, engine.recording_missing()) {
        return Err(Error::input(
            format!("the recorded frames are not at hand: {}", why.trim_end_matches('.')),
            Remedy::FindRecording,
        ));
    }
    if source == PictureSource::Original {
        engine.require_recording()?;
    }
    let encoder = engine
        .encoder_identity()
        .cloned()
        .ok_or_else(|| Error::input("there is no prompt to export", "Give at least one."))?;
    let names = (engine.renderer_name(), engine.relevancy_name());
    let hash = file_sha256(scene)?;
    let settings = engine.settings().clone();
    let mut provenance = Provenance::new(engine.scene(), hash, &encoder, settings, names, prompts, options);
    // Older scenes do not hold the identity of their recording.
    provenance.sequence_frame_names = engine.frame_sources();
    if let (None, PictureSource::Original, Some(sequence)) =
        (&provenance.sequence_sha256, source, engine.sequence())
    {
        provenance.sequence_sha256 = Some(sequence.identity()?.digest());
    }
    let inputs = outputs::inputs_of_engine(scene, engine);
    let is_same = |there: &Path| Export::is_of(there, &provenance);
    let claim = Claim {
        unfinished: Earlier::Keep,
        is_same: &is_same,
        completes_same,
        ..Claim::new(outputs::EXPORT, &inputs, replace)
    };
    let output = OutputFolder::claim(folder, claim)?;
    let mut export = Export::begin(output.path(), frames, provenance.clone(), false)?;
    while let Some(frame) = export.next_frame() {
        let (done, total) = (export.frames_done(), export.num_frames());
        if observer(&Progress::new("exporting", done, total)).is_break() {
            break;
        }
        let scores = scorer.scores(engine, frame)?;
        let images = engine.render(&engine.view(frame)?, true)?;
        let tools = engine.instruments(frame)?;
        let picture: RgbImage = match source {
            PictureSource::Original => engine.original(frame)?.unwrap_or_else(|| images.to_rgb()),
            PictureSource::Reconstruction => images.to_rgb(),
        };
        export.write(&picture, &scores, tools.as_ref()).map_err(|e| {
            let place = format!("the export stopped at frame {frame}, {done} of {total} are complete");
            match e {
                Error::Io { doing, source, path } => {
                    Error::Io { doing: format!("{doing} ({place})"), source, path }
                }
                other => other,
            }
        })?;
    }
    let summary = export.finish()?;
    if summary.complete {
        output.finish()?;
    }
    Ok(summary)
}

/// Scores of recorded frames, smoothed over time if that is asked for. Scores that several frames
/// need are computed once.
struct Scorer {
    /// Number of frames before and after a frame that count.
    reach: usize,
    /// Scores by frame, one image per prompt.
    known: BTreeMap<usize, Vec<Grid<f32>>>,
}

impl Scorer {
    fn scores(&mut self, engine: &mut Engine, frame: usize) -> Result<Vec<Grid<f32>>> {
        let last = engine.scene().num_frames().saturating_sub(1);
        let around = frame.saturating_sub(self.reach)..=(frame + self.reach).min(last);
        self.known.retain(|f, _| around.contains(f));
        for other in around {
            if let Entry::Vacant(place) = self.known.entry(other) {
                let view = engine.view(other)?;
                let images = engine.render(&view, true)?;
                place.insert(engine.scores(&images, &view)?);
            }
        }
        if self.reach == 0 {
            return Ok(self.known.remove(&frame).unwrap_or_default());
        }
        let neighbours = |k: usize| -> Vec<&Grid<f32>> {
            self.known.iter().filter(|(f, _)| **f != frame).map(|(_, scores)| &scores[k]).collect()
        };
        let own = self.known.get(&frame).into_iter().flatten().enumerate();
        Ok(own.map(|(k, scores)| mean_scores(scores, &neighbours(k))).collect())
    }
}
