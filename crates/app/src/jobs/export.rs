//! Masked frames of a scene, written to a folder.

use crate::{
    engine::{Engine, Question, frames_around},
    outputs,
    settings::prompt_colour,
};
use image::RgbImage;
use std::{
    collections::{BTreeMap, btree_map::Entry},
    path::{Path, PathBuf},
};
use surgtpgs_core::{
    Error, Remedy, Result,
    export::{
        Export, ExportOptions, ExportPrompt, ExportSummary, Format, LeftOut, PictureSource, Provenance,
    },
    files::{Claim, Earlier, OutputFolder},
    grid::Grid,
    hash::file_sha256,
    marks::{Mark, Marks},
    mask::mean_scores,
    meaning::EncoderIdentity,
    progress::{Observer, Progress},
    relevancy::Query,
    sequence::{SourceReferences, blacken, names_instrument},
};

/// A question that an export answers, with the look of the answer.
#[derive(Clone, Debug, PartialEq)]
pub struct ExportQuestion {
    /// Words or a sample to look for.
    pub question: Question,
    /// Score above which a pixel is found.
    pub threshold: f32,
    /// Colour of what is found.
    pub colour: [u8; 3],
    /// `true` for an instrument.
    pub is_instrument: bool,
}

impl ExportQuestion {
    /// Gives questions one threshold, and colours in their order. Instruments are recognised by their names.
    pub fn with_standard_look(questions: Vec<Question>, threshold: f32) -> Vec<Self> {
        let look = |(question, colour): (Question, [u8; 3])| Self {
            is_instrument: names_instrument(question.text.trim()),
            question,
            threshold,
            colour,
        };
        questions.into_iter().zip((0..).map(prompt_colour)).map(look).collect()
    }
}

/// Everything that an export depends on.
#[derive(Clone, Debug, PartialEq)]
pub struct ExportRequest {
    /// The scene file that the engine has open.
    pub scene: PathBuf,
    /// Folder to write.
    pub folder: PathBuf,
    /// Frames, counted from 0.
    pub frames: Vec<usize>,
    /// Questions to answer.
    pub questions: Vec<ExportQuestion>,
    /// Marks by hand to carry to the scene first. If there are none, those of the engine stay.
    pub marks: Vec<Mark>,
    /// Options of the export.
    pub options: ExportOptions,
    /// `true` if another export may be replaced, once this one is whole.
    pub replace: bool,
    /// `true` if the same export is completed where it is there already, instead of being made anew.
    pub completes_same: bool,
}

/// Writes masked frames. Stops when the observer says so; the next export goes on from there. The engine
/// keeps the questions.
pub fn export(
    engine: &mut Engine,
    request: &ExportRequest,
    observer: &mut Observer<'_>,
) -> Result<ExportSummary> {
    let ExportRequest { scene, options, .. } = request;
    if !request.marks.is_empty() {
        engine.set_marks(Marks::new(request.marks.clone(), &engine.canvas())?)?;
    }
    let chosen = Chosen::of(engine, request)?;
    let mut provenance = provenance(engine, request, chosen)?;
    let sources = source_references(engine, options)?;
    provenance.dicom_sources_sha256 = sources.as_ref().map(SourceReferences::digest);
    let inputs = engine.inputs(scene);
    let is_same = |there: &Path| Export::is_of(there, &provenance);
    let claim = Claim {
        unfinished: Earlier::Keep,
        is_same: &is_same,
        completes_same: request.completes_same,
        ..Claim::new(outputs::EXPORT, &inputs, request.replace)
    };
    let output = OutputFolder::claim(&request.folder, claim)?;
    let export = Export::begin(output.path(), request.frames.clone(), provenance.clone())?;
    let mut export = export.with_sources(sources);
    let mut answers = AnsweredFrames::new(options);
    while let Some(frame) = export.next_frame() {
        let (done, total) = (export.frames_done(), export.num_frames());
        if observer(&Progress::new("exporting", done, total)).is_break() {
            break;
        }
        let (picture, scores) = answers.of(engine, frame)?;
        let tools = engine.instruments(frame)?;
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

/// Returns the number of questions that an export writes something for; the engine has its marks already, and
/// keeps those questions.
pub fn num_written(engine: &mut Engine, request: &ExportRequest) -> Result<usize> {
    Ok(Chosen::of(engine, request)?.written.len())
}

/// The prompts that are written, which the engine is asked, and those that are not.
struct Chosen {
    encoder: EncoderIdentity,
    /// Each with the words that it stands for, if it is only the class nearest to them.
    written: Vec<(ExportQuestion, Option<String>)>,
    left_out: Vec<LeftOut>,
}

impl Chosen {
    /// Asks the engine, and chooses.
    fn of(engine: &mut Engine, request: &ExportRequest) -> Result<Self> {
        if request.questions.is_empty() {
            return Err(Error::input("there is no prompt to export", "Give at least one."));
        }
        let questions: Vec<Question> = request.questions.iter().map(|q| q.question.clone()).collect();
        engine.set_questions(&questions)?;
        let encoder = engine.encoder_identity()?;
        let mut chosen = Self { encoder, written: Vec::new(), left_out: Vec::new() };
        for (asked, answer) in request.questions.iter().zip(engine.answers()) {
            let words = asked.question.text.trim().to_owned();
            let is_nearest = asked.question.shows_nearest || request.options.nearest;
            match &answer.nearest {
                nearest if !answer.is_exported(asked.threshold, is_nearest) => {
                    let (nearest, why) = (nearest.clone(), answer.absence.in_short().to_owned());
                    chosen.left_out.push(LeftOut { text: words, nearest, why });
                }
                Some(class) if !answer.may_be_found(asked.threshold) => {
                    let question = Question { shows_nearest: true, ..asked.question.clone() };
                    let text = class.clone();
                    let nearest = ExportQuestion { question: Question { text, ..question }, ..asked.clone() };
                    chosen.written.push((nearest, Some(words)));
                }
                _ => chosen.written.push((asked.clone(), None)),
            }
        }
        let questions: Vec<Question> =
            chosen.written.iter().map(|(asked, _)| asked.question.clone()).collect();
        engine.set_questions(&questions)?;
        Ok(chosen)
    }
}

/// Returns `true` if what is written depends on the recorded frames: if they are drawn, if marks follow them,
/// or if a segmentation refers to them.
fn needs_recording(engine: &Engine, options: &ExportOptions) -> bool {
    let needs = |format: &Format| format.draws_pictures() || *format == Format::DicomSeg;
    let is_original = options.source == PictureSource::Original;
    is_original && (engine.marks().is_some() || options.formats.iter().any(needs))
}

/// Returns the record of how the files are made. Fails if the recorded frames are needed and not at hand.
fn provenance(engine: &Engine, request: &ExportRequest, chosen: Chosen) -> Result<Provenance> {
    let ExportRequest { scene, options, .. } = request;
    let wants_recording = options.source == PictureSource::Original;
    if let (true, Some(why)) = (needs_recording(engine, options), engine.recording_missing()) {
        return Err(not_at_hand(why));
    }
    if wants_recording {
        engine.require_recording()?;
    }
    let prompt = |((asked, stands_for), query): ((ExportQuestion, Option<String>), &Query)| ExportPrompt {
        text: query.prompt.clone(),
        threshold: asked.threshold,
        colour: asked.colour,
        negatives: query.compared_with().map(str::to_owned).collect(),
        is_instrument: asked.is_instrument,
        certainty: Some(query.certainty),
        stands_for,
    };
    let prompts = chosen.written.into_iter().zip(engine.queries()).map(prompt).collect();
    let names = (engine.renderer_name(), engine.relevancy_name());
    let (hash, settings) = (file_sha256(scene)?, engine.settings().clone());
    let mut provenance =
        Provenance::new(engine.scene(), hash, &chosen.encoder, settings, names, prompts, options.clone());
    provenance.left_out = chosen.left_out;
    provenance.marks_sha256 = engine.marks().map(Marks::digest);
    provenance.marks_model_sha256 = engine.marks_model_sha256().map(str::to_owned);
    // Older scenes do not hold the identity of their recording.
    provenance.sequence_frame_names = engine.frame_sources();
    provenance.hidden = engine.hidden().to_vec();
    if let (None, true, Some(sequence)) = (&provenance.sequence_sha256, wants_recording, engine.sequence()) {
        provenance.sequence_sha256 = Some(sequence.identity()?.digest());
    }
    Ok(provenance)
}

/// Reads the identifiers of the recording's DICOM files, if a format needs them and the recording is at hand.
fn source_references(engine: &Engine, options: &ExportOptions) -> Result<Option<SourceReferences>> {
    let sequence = engine.sequence().filter(|_| options.formats.contains(&Format::DicomSeg));
    sequence.map_or(Ok(None), |sequence| sequence.source_references())
}

/// Answers on recorded frames: the picture to mask, and the scores, smoothed over time if that is asked for.
/// A frame that several answers need is rendered once.
struct AnsweredFrames {
    /// Pictures to mask; `None` if no format shows them.
    source: Option<PictureSource>,
    /// Number of frames before and after a frame that count, as far as they are of its shot.
    reach: usize,
    /// Rendered pictures, if they are to be masked, and scores, one image per question; by frame.
    known: BTreeMap<usize, (Option<RgbImage>, Vec<Grid<f32>>)>,
}

impl AnsweredFrames {
    fn new(options: &ExportOptions) -> Self {
        let shows_pictures = options.formats.iter().any(|format| format.draws_pictures());
        let source = shows_pictures.then_some(options.source);
        Self { source, reach: options.clean_up.smooth_frames, known: BTreeMap::new() }
    }

    /// Returns the picture and the scores of a frame.
    fn of(&mut self, engine: &mut Engine, frame: usize) -> Result<(RgbImage, Vec<Grid<f32>>)> {
        let around = frames_around(frame, self.reach, &engine.scene().shot_of(frame));
        self.known.retain(|f, _| around.contains(f));
        for other in around {
            if let Entry::Vacant(place) = self.known.entry(other) {
                let view = engine.view(other)?;
                let images = engine.render(&view, true)?;
                let picture = (self.source == Some(PictureSource::Reconstruction)).then(|| {
                    let mut picture = images.to_rgb();
                    let identity = engine.scene().provenance.identity.as_ref();
                    blacken(&mut picture, identity.map_or(&[], |identity| identity.hidden()));
                    picture
                });
                place.insert((picture, engine.scores(&images, &view)?));
            }
        }
        let (rendered, scores) = if self.reach == 0 {
            self.known.remove(&frame).unwrap_or_default()
        } else {
            self.smoothed(frame)
        };
        let picture = match self.source {
            Some(PictureSource::Original) => engine.original(frame)?,
            Some(PictureSource::Reconstruction) => rendered,
            None => scores.first().map(|s| RgbImage::new(s.width as u32, s.height as u32)),
        };
        Ok((picture.ok_or_else(|| not_at_hand(&format!("frame {frame} is missing")))?, scores))
    }

    /// Returns the mean of the scores of a frame and of its neighbours.
    fn smoothed(&self, frame: usize) -> (Option<RgbImage>, Vec<Grid<f32>>) {
        let Some((picture, own)) = self.known.get(&frame) else { return Default::default() };
        let neighbours = |k: usize| -> Vec<&Grid<f32>> {
            self.known.iter().filter(|(f, _)| **f != frame).map(|(_, (_, scores))| &scores[k]).collect()
        };
        let scores = own.iter().enumerate().map(|(k, scores)| mean_scores(scores, &neighbours(k)));
        (picture.clone(), scores.collect())
    }
}

fn not_at_hand(why: &str) -> Error {
    Error::input(
        format!("the recorded frames are not at hand: {}", why.trim_end_matches('.')),
        Remedy::FindRecording,
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::engine::{
        BackendChoice, EngineOptions, Negatives,
        asking_tests::{engine_on, unfinished_engine},
    };
    use std::{collections::BTreeSet, sync::Arc};
    use surgtpgs_core::{
        export::num_files,
        mask::CleanUp,
        progress::unobserved,
        relevancy::RelevancySettings,
        scene::{Chapter, Scene},
    };

    /// Opens an engine on two shots of two frames each. The second shows fat in place of liver, and liver in
    /// place of fat.
    fn engine_of_two_shots() -> Engine {
        let whole = engine_on(BackendChoice::Cpu, &["liver", "fat"], &[]);
        let part = |index: usize| {
            let mut scene = Scene::clone(whole.scene());
            scene.cameras = vec![scene.cameras[0]; 4];
            let shown = 2 * index..2 * index + 2;
            let chapter = Chapter { index, count: 2, learned: shown.clone(), shown };
            scene.provenance.settings = serde_json::json!({ "chapter": chapter });
            let of_one = scene.gaussians.latent_dim;
            scene.gaussians.features.rotate_left(index * of_one);
            scene.as_chapter()
        };
        let scene = Scene::joined(Some(Scene::joined(None, part(0))), part(1));
        let options = EngineOptions { backend: BackendChoice::Cpu, ..Default::default() };
        Engine::new(Arc::new(scene), None, options).unwrap()
    }

    #[test]
    fn scores_are_not_smoothed_across_a_cut() {
        let mut engine = engine_of_two_shots();
        engine.set_prompts(&["liver".into()]).unwrap();
        let mut scores = |frame: usize, smooth_frames: usize| {
            let clean_up = CleanUp { smooth_frames, ..CleanUp::default() };
            let options =
                ExportOptions { formats: vec![Format::Binary], clean_up, ..ExportOptions::default() };
            AnsweredFrames::new(&options).of(&mut engine, frame).unwrap().1.swap_remove(0)
        };
        let far = |a: &Grid<f32>, b: &Grid<f32>| {
            let pairs = a.data.iter().zip(&b.data);
            pairs.map(|(a, b)| (a - b).abs()).fold(0.0, f32::max)
        };
        let [before, after] = [1, 2].map(|frame| scores(frame, 0));
        assert!(far(&before, &after) > 0.3, "{}", far(&before, &after));
        for (frame, own) in [(1, &before), (2, &after)] {
            let smoothed = scores(frame, 2);
            assert!(far(&smoothed, own) < 0.01, "frame {frame}: {}", far(&smoothed, own));
        }
    }

    /// Asks for two frames in `folder`, beside the scene.
    fn request(engine: &Engine, folder: &Path, words: &[&str], formats: &[Format]) -> ExportRequest {
        let question = |words: &&str| Question::words(*words, Negatives::of(engine.settings()));
        ExportRequest {
            scene: folder.join("scene.safetensors"),
            folder: folder.join("out"),
            frames: vec![0, 1],
            questions: ExportQuestion::with_standard_look(words.iter().map(question).collect(), 0.5),
            marks: Vec::new(),
            options: ExportOptions { formats: formats.to_vec(), ..Default::default() },
            replace: true,
            completes_same: false,
        }
    }

    #[test]
    fn many_questions_have_colours_of_their_own() {
        let settings = RelevancySettings::default();
        let questions = (0..20).map(|k| Question::words(format!("words {k}"), Negatives::of(&settings)));
        let asked = ExportQuestion::with_standard_look(questions.collect(), 0.5);
        let colours: BTreeSet<[u8; 3]> = asked.iter().map(|question| question.colour).collect();
        assert_eq!(colours.len(), 20);
    }

    #[test]
    fn what_is_left_out_is_not_counted() {
        let mut engine = unfinished_engine();
        let folder = tempfile::tempdir().unwrap();
        engine.scene().save(&folder.path().join("scene.safetensors")).unwrap();
        for (words, expected) in [(&["liver", "spleen", "Leber"][..], 1), (&["Leber"][..], 0)] {
            let request = request(&engine, folder.path(), words, &[Format::Binary]);
            assert_eq!(num_written(&mut engine, &request).unwrap(), expected, "{words:?}");
            let summary = export(&mut engine, &request, &mut unobserved).unwrap();
            assert_eq!(summary.files, num_files(&[Format::Binary], 2, expected), "{words:?}");
            assert_eq!(summary.left_out.len(), words.len() - expected, "{words:?}");
            for left_out in &summary.left_out {
                let is_known = left_out.text == "spleen";
                let why = if is_known { "not in this recording" } else { "words not known here" };
                assert_eq!(left_out.why, why, "{left_out}");
            }
        }
    }

    #[test]
    fn what_shows_no_picture_needs_no_recording() {
        let mut engine = unfinished_engine();
        let folder = tempfile::tempdir().unwrap();
        engine.scene().save(&folder.path().join("scene.safetensors")).unwrap();
        let mut written = |formats: &[Format]| {
            let request = request(&engine, folder.path(), &["liver"], formats);
            export(&mut engine, &request, &mut unobserved)
        };
        assert_eq!(written(&[Format::Binary, Format::Csv]).unwrap().files, 3);
        for format in [Format::Overlay, Format::Cutout, Format::Video, Format::DicomSeg] {
            let error = written(&[Format::Binary, format]).unwrap_err().to_string();
            assert!(error.contains("not at hand"), "{error}");
        }
    }
}
