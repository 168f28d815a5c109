//! Answers to prompts, frame by frame.

use super::console::ProgressView;
use crate::engine::{Answer, Engine, Negatives, Question, Verdict};
use std::path::PathBuf;
use surgtpgs_core::{Result, marks::LookHere, mask::Region, object::seen_area, raster::MIN_DEPTH_ALPHA};

/// Answers to all prompts, as they are reported in JSON; the keys are a contract.
#[derive(serde::Serialize, serde::Deserialize)]
pub(super) struct Answers {
    pub(super) prompts: Vec<PromptAnswers>,
    pub(super) threshold: f32,
    pub(super) relevancy: String,
    pub(super) renderer: String,
    /// Place where one more mark would help most; only with marks.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(super) look_here: Option<LookHere>,
}

/// Answers to one prompt.
#[derive(serde::Serialize, serde::Deserialize)]
pub(super) struct PromptAnswers {
    pub(super) text: String,
    /// Verdict on all frames asked: the best one of theirs.
    pub(super) answer: Verdict,
    /// Class that is most like the words, if they mean none and any is like them.
    pub(super) nearest: Option<String>,
    /// Probability that the words mean something that the scene knows.
    pub(super) certainty: f32,
    /// Reason, in a few words.
    pub(super) why: String,
    pub(super) frames: Vec<FrameAnswer>,
    /// Gaussians that the prompt found, if asked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) gaussians: Option<FoundGaussians>,
}

/// Object that a prompt found, in three dimensions.
#[derive(serde::Serialize, serde::Deserialize)]
pub(super) struct FoundGaussians {
    /// Frame at whose time the Gaussians were found and written.
    pub(super) frame: usize,
    pub(super) count: usize,
    pub(super) file: PathBuf,
}

/// Answer to one prompt on one frame: if it was found, and how much of it.
#[derive(serde::Serialize, serde::Deserialize)]
pub(super) struct FrameAnswer {
    pub(super) frame: usize,
    pub(super) answer: Verdict,
    /// Class that is most like the words and is on this frame.
    pub(super) nearest: Option<String>,
    pub(super) found: bool,
    pub(super) area_px: usize,
    pub(super) area_fraction: f64,
    pub(super) max_score: f32,
    /// Area of the found pixels at their depth, facing the camera, in scene units²; `None` if the depth was
    /// not measured.
    pub(super) seen_area: Option<f64>,
    /// File name of the recorded frame, where known.
    #[serde(default)]
    pub(super) source: Option<String>,
}

impl PromptAnswers {
    /// Takes the verdict on all frames from those on each.
    fn conclude(&mut self) {
        let verdicts = [Verdict::Found, Verdict::Nearest];
        let seen = |verdict: &Verdict| self.frames.iter().any(|f| f.answer == *verdict);
        self.answer = verdicts.into_iter().find(seen).unwrap_or(Verdict::Absent);
    }

    pub(super) fn frames_found(&self) -> usize {
        self.frames.iter().filter(|f| f.found).count()
    }

    pub(super) fn max_score(&self) -> f32 {
        self.frames.iter().map(|f| f.max_score).fold(0.0, f32::max)
    }

    /// Returns the frame where the prompt covers most; `None` if it is never found.
    pub(super) fn largest(&self) -> Option<&FrameAnswer> {
        self.frames.iter().filter(|f| f.found).max_by_key(|f| f.area_px)
    }

    /// Says where a prompt stands that was found on no frame.
    pub(super) fn why_not_found(&self) -> String {
        let (total, why) = (self.frames.len(), &self.why);
        let nearest = self.frames.iter().filter(|f| f.answer == Verdict::Nearest).count();
        match &self.nearest {
            Some(class) if nearest > 0 => {
                format!("not found; looks like {class}, which is on {nearest} of {total} frames ({why})")
            }
            _ if self.certainty > 0.5 => format!("on none of {total} frames ({why})"),
            _ => format!("not in this recording ({why})"),
        }
    }
}

/// Asks `questions` on `frames`.
pub(super) fn ask(engine: &mut Engine, questions: &[Question], frames: &[usize]) -> Result<Answers> {
    engine.set_questions(questions)?;
    let answers = engine.answers().to_vec();
    let stand_ins = StandIns::of(questions, &answers);
    engine.set_questions(&[questions, &stand_ins.questions].concat())?;
    let blank = |(question, answer): (&Question, &Answer)| PromptAnswers {
        text: question.text.trim().to_owned(),
        answer: Verdict::Absent,
        nearest: answer.nearest.clone(),
        certainty: answer.certainty,
        why: answer.why.clone(),
        frames: Vec::with_capacity(frames.len()),
        gaussians: None,
    };
    let mut prompts: Vec<PromptAnswers> = questions.iter().zip(&answers).map(blank).collect();
    let sources = engine.frame_sources();
    let mut view = ProgressView::default();
    let is_measured = engine.depth_origin().is_measured();
    let mut in_doubt: Vec<LookHere> = Vec::new();
    for (done, &frame) in frames.iter().enumerate() {
        let at = engine.view(frame)?;
        let images = engine.render(&at, true)?;
        let scores = engine.scores(&images, &at)?;
        let masks = engine.masks(&scores);
        let depth = images.normalised_depth(MIN_DEPTH_ALPHA);
        for (k, (prompt, answer)) in prompts.iter_mut().zip(&answers).enumerate() {
            let region = Region::of(&scores[k], &masks[k]);
            let shows_nearest = stand_ins.places[k].is_some_and(|place| masks[place].count() > 0);
            let verdict = answer.verdict(region.area_px > 0, shows_nearest);
            prompt.frames.push(FrameAnswer {
                frame,
                answer: verdict,
                nearest: answer.nearest.clone().filter(|_| verdict == Verdict::Nearest),
                found: region.area_px > 0,
                area_px: region.area_px,
                area_fraction: region.area_fraction,
                max_score: region.max_score,
                seen_area: is_measured.then(|| seen_area(&masks[k], &depth, &at.camera)),
                source: sources.get(frame).cloned(),
            });
        }
        in_doubt.extend(engine.look_here_on(frame)?);
        view.count("asking", done + 1, frames.len());
    }
    prompts.iter_mut().for_each(PromptAnswers::conclude);
    engine.set_questions(questions)?;
    Ok(Answers {
        prompts,
        threshold: engine.settings().threshold,
        relevancy: engine.relevancy_name().into(),
        renderer: engine.renderer_name(),
        look_here: LookHere::best(&in_doubt).cloned(),
    })
}

/// Classes that prompts are like, asked for themselves.
struct StandIns {
    questions: Vec<Question>,
    /// Place of each prompt's class among all questions.
    places: Vec<Option<usize>>,
}

impl StandIns {
    fn of(questions: &[Question], answers: &[Answer]) -> Self {
        let none = || Negatives { phrases: Vec::new(), samples: Vec::new(), uses_classes: true };
        let mut own: Vec<Question> = Vec::new();
        let places = answers.iter().map(|answer| {
            let question = Question::words(answer.nearest.clone()?, none());
            let known = own.iter().position(|other| *other == question).unwrap_or_else(|| {
                own.push(question);
                own.len() - 1
            });
            Some(questions.len() + known)
        });
        let places = places.collect();
        Self { questions: own, places }
    }
}
