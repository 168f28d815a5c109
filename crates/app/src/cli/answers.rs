//! Answers to prompts, frame by frame.

use crate::engine::{Absence, Answer, Engine, Negatives, Question, Verdict};
use std::path::PathBuf;
use surgtpgs_core::{
    Result,
    camera::Camera,
    grid::{Grid, Mask},
    marks::LookHere,
    mask::Region,
    object::seen_area,
    progress::{Observer, Progress},
};

/// Answers to all prompts, as they are reported in JSON; the keys are a contract.
#[derive(serde::Serialize, serde::Deserialize)]
pub(super) struct Answers {
    pub(super) prompts: Vec<PromptAnswers>,
    pub(super) threshold: f32,
    pub(super) relevancy: String,
    pub(super) renderer: String,
    /// Runs of frames that no chapter of the scene shows, each by its first and last frame.
    #[serde(default)]
    pub(super) frames_not_shown: Vec<[usize; 2]>,
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
    /// `true` if only what is marked by hand can be looked for, and the words mean none of it.
    #[serde(default)]
    pub(super) needs_mark: bool,
    /// `true` if the words are not understood, so that nobody knows if what they mean is there.
    #[serde(default)]
    pub(super) not_understood: bool,
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

/// Answer to one prompt on one frame: if it was found, and how much of it. There are no numbers of a frame
/// that the scene does not show.
#[derive(serde::Serialize, serde::Deserialize)]
pub(super) struct FrameAnswer {
    pub(super) frame: usize,
    pub(super) answer: Verdict,
    /// Class that is most like the words and is on this frame.
    pub(super) nearest: Option<String>,
    pub(super) found: bool,
    pub(super) area_px: Option<usize>,
    pub(super) area_fraction: Option<f64>,
    pub(super) max_score: Option<f32>,
    /// Area of the found pixels at their depth, facing the camera, in scene units²; `None` if the depth was
    /// not measured.
    pub(super) seen_area: Option<f64>,
    /// File name of the recorded frame, where known.
    #[serde(default)]
    pub(super) source: Option<String>,
}

/// A frame on which prompts are looked for.
struct Seen<'a> {
    frame: usize,
    /// `true` if a chapter of the scene shows it.
    is_shown: bool,
    camera: &'a Camera,
    /// Depth of its pixels, if it was measured.
    depth: Option<Grid<f32>>,
    /// File name of the recorded frame, where known.
    source: Option<&'a str>,
}

impl FrameAnswer {
    /// Says how much of a prompt was found on a frame; `shows_nearest` if the class that is most like its
    /// words is there.
    fn of(answer: &Answer, seen: &Seen<'_>, scores: &Grid<f32>, mask: &Mask, shows_nearest: bool) -> Self {
        let region = seen.is_shown.then(|| Region::of(scores, mask));
        let verdict = match region {
            Some(region) => answer.verdict(region.area_px > 0, shows_nearest),
            None => Verdict::NotShown,
        };
        let depth = seen.depth.as_ref().filter(|_| seen.is_shown);
        Self {
            frame: seen.frame,
            answer: verdict,
            nearest: answer.nearest.clone().filter(|_| verdict == Verdict::Nearest),
            found: verdict == Verdict::Found,
            area_px: region.map(|region| region.area_px),
            area_fraction: region.map(|region| region.area_fraction),
            max_score: region.map(|region| region.max_score),
            seen_area: depth.map(|depth| seen_area(mask, depth, seen.camera)),
            source: seen.source.map(str::to_owned),
        }
    }
}

impl PromptAnswers {
    /// Begins the answers to a question, without a frame.
    fn new(question: &Question, answer: &Answer) -> Self {
        Self {
            text: question.text.trim().to_owned(),
            answer: Verdict::Absent,
            nearest: answer.nearest.clone(),
            certainty: answer.certainty,
            why: answer.why.clone(),
            needs_mark: answer.absence == Absence::NeedsMark,
            not_understood: answer.absence == Absence::NotUnderstood,
            frames: Vec::new(),
            gaussians: None,
        }
    }

    /// Takes the verdict on all frames from those on each.
    fn conclude(&mut self) {
        let verdicts = [Verdict::Found, Verdict::Nearest, Verdict::Absent];
        let seen = |verdict: &Verdict| self.frames.iter().any(|f| f.answer == *verdict);
        self.answer = verdicts.into_iter().find(seen).unwrap_or(Verdict::NotShown);
    }

    /// Returns the number of frames asked that the scene shows.
    pub(super) fn frames_shown(&self) -> usize {
        self.frames.iter().filter(|f| f.answer != Verdict::NotShown).count()
    }

    pub(super) fn frames_found(&self) -> usize {
        self.frames.iter().filter(|f| f.found).count()
    }

    pub(super) fn max_score(&self) -> f32 {
        self.frames.iter().filter_map(|f| f.max_score).fold(0.0, f32::max)
    }

    /// Returns the frame where the prompt covers most; `None` if it is never found.
    pub(super) fn largest(&self) -> Option<&FrameAnswer> {
        self.frames.iter().filter(|f| f.found).max_by_key(|f| f.area_px)
    }

    fn absence(&self) -> Absence {
        match (self.needs_mark, self.not_understood) {
            (true, _) => Absence::NeedsMark,
            (false, true) => Absence::NotUnderstood,
            (false, false) => Absence::NotThere,
        }
    }

    /// Says where a prompt stands that was found on no frame.
    pub(super) fn why_not_found(&self) -> String {
        let (total, why) = (self.frames_shown(), &self.why);
        let nearest = self.frames.iter().filter(|f| f.answer == Verdict::Nearest).count();
        match &self.nearest {
            Some(class) if nearest > 0 => {
                format!("not found; looks like {class}, which is on {nearest} of {total} frames ({why})")
            }
            _ if total == 0 => "no chapter of the scene shows these frames".into(),
            _ if self.certainty > 0.5 => format!("on none of {total} frames ({why})"),
            _ => format!("{} ({why})", self.absence().words()),
        }
    }
}

/// Asks `questions` on `frames`.
pub(super) fn ask(
    engine: &mut Engine,
    questions: &[Question],
    frames: &[usize],
    observer: &mut Observer<'_>,
) -> Result<Answers> {
    engine.set_questions(questions)?;
    let answers = engine.answers().to_vec();
    let stand_ins = StandIns::of(questions, &answers);
    engine.set_questions(&[questions, &stand_ins.questions].concat())?;
    let begun = questions.iter().zip(&answers).map(|(question, answer)| PromptAnswers::new(question, answer));
    let mut prompts: Vec<PromptAnswers> = begun.collect();
    let sources = engine.frame_sources();
    let is_measured = engine.depth_origin().is_measured();
    let mut in_doubt: Vec<LookHere> = Vec::new();
    for (done, &frame) in frames.iter().enumerate() {
        let at = engine.view(frame)?;
        let images = engine.render(&at, true)?;
        let scores = engine.scores(&images, &at)?;
        let masks = engine.masks(&scores);
        let seen = Seen {
            frame,
            is_shown: engine.scene().shows_frame(frame),
            camera: &at.camera,
            depth: is_measured.then(|| images.normalised_depth()),
            source: sources.get(frame).map(String::as_str),
        };
        for (k, (prompt, answer)) in prompts.iter_mut().zip(&answers).enumerate() {
            let shows_nearest = stand_ins.places[k].is_some_and(|place| masks[place].count() > 0);
            prompt.frames.push(FrameAnswer::of(answer, &seen, &scores[k], &masks[k], shows_nearest));
        }
        in_doubt.extend(engine.look_here_on(frame)?);
        Progress::new("asking", done + 1, frames.len()).tell(observer)?;
    }
    prompts.iter_mut().for_each(PromptAnswers::conclude);
    engine.set_questions(questions)?;
    Ok(Answers {
        prompts,
        threshold: engine.settings().threshold,
        relevancy: engine.relevancy_name().into(),
        renderer: engine.renderer_name(),
        frames_not_shown: engine.scene().frames_not_shown(),
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::engine::asking_tests::unfinished_engine;
    use std::ops::ControlFlow;
    use surgtpgs_core::{Error, progress::unobserved};

    #[test]
    fn asking_stops_after_a_frame_on_request() {
        let mut engine = unfinished_engine();
        let questions = [Question::words("liver", Negatives::of(engine.settings()))];
        let mut done = Vec::new();
        let mut stop = |p: &Progress<'_>| {
            done.push(p.done);
            ControlFlow::Break(())
        };
        let stopped = ask(&mut engine, &questions, &[0, 1], &mut stop);
        assert!(matches!(stopped, Err(Error::Cancelled)));
        assert_eq!(done, [1]);
    }

    #[test]
    fn nobody_looked_on_frames_that_no_chapter_shows() {
        let mut engine = unfinished_engine();
        let questions = ["liver", "spleen"].map(|words| {
            let negatives = Negatives::of(engine.settings());
            Question::words(words, negatives)
        });
        let answers = ask(&mut engine, &questions, &[0, 1, 2, 3], &mut unobserved).unwrap();
        assert_eq!(answers.frames_not_shown, [[2, 3]]);
        let [liver, spleen] = &answers.prompts[..] else { panic!("two prompts") };
        let verdicts: Vec<Verdict> = liver.frames.iter().map(|f| f.answer).collect();
        assert_eq!(verdicts, [Verdict::Found, Verdict::Found, Verdict::NotShown, Verdict::NotShown]);
        let last = &liver.frames[3];
        assert!(last.area_px.is_none() && last.area_fraction.is_none() && last.max_score.is_none());
        assert!(last.seen_area.is_none() && !last.found);
        assert_eq!((liver.frames_found(), liver.frames_shown(), liver.answer), (2, 2, Verdict::Found));
        assert_eq!(spleen.answer, Verdict::Absent);
        let beyond = ask(&mut engine, &questions, &[2, 3], &mut unobserved).unwrap();
        assert_eq!(beyond.prompts[0].answer, Verdict::NotShown);
        assert_eq!(beyond.prompts[1].why_not_found(), "no chapter of the scene shows these frames");
    }

    #[test]
    fn words_that_are_not_understood_are_reported_as_such() {
        let mut engine = unfinished_engine();
        let negatives = Negatives::of(engine.settings());
        let questions = ["spleen", "Leber"].map(|words| Question::words(words, negatives.clone()));
        let answers = ask(&mut engine, &questions, &[0], &mut unobserved).unwrap();
        let [spleen, unknown] = &answers.prompts[..] else { panic!("two prompts") };
        assert_eq!((spleen.answer, unknown.answer), (Verdict::Absent, Verdict::Absent));
        assert_eq!(spleen.why_not_found(), "not in this recording (means spleen)");
        let told = unknown.why_not_found();
        assert!(told.starts_with("these words are not known here: try another"), "{told}");
        assert!(told.contains("or mark it by hand (it is in no list"), "{told}");
        let json = serde_json::to_value(&answers).unwrap();
        assert_eq!([0, 1].map(|k| json["prompts"][k]["not_understood"] == true), [false, true]);
        assert_eq!(json["prompts"][1]["answer"], "absent");
    }
}
