//! Prompts of a web page: their answers on all frames, and the Gaussians that they find.

use super::{
    answers::{PromptAnswers, ask},
    console::ProgressView,
};
use crate::{
    engine::{BackendChoice, EncoderChoice, Engine, EngineOptions, Negatives, Question, Verdict},
    settings::prompt_colour,
};
use std::sync::Arc;
use surgtpgs_core::{
    Result,
    scene::{PagePrompt, Scene},
};

/// Asks `words`, which a text encoder understands, on all frames. The CPU answers, so that equal scenes give
/// equal pages.
pub(super) fn prompts(
    scene: &Arc<Scene>,
    words: &[String],
    encoder: EncoderChoice,
) -> Result<Vec<PagePrompt>> {
    if words.is_empty() {
        return Ok(Vec::new());
    }
    let options = EngineOptions { backend: BackendChoice::Cpu, encoder, sequence: None };
    let mut engine = Engine::new(scene.clone(), None, options)?;
    let negatives = Negatives::of(engine.settings());
    let questions: Vec<Question> =
        words.iter().map(|text| Question::words(text, negatives.clone())).collect();
    let frames = Vec::from_iter(0..scene.num_frames());
    let mut view = ProgressView::default();
    let answers = ask(&mut engine, &questions, &frames, &mut |p| view.show(p))?;
    drop(view);
    let shares = shares(&mut engine)?;
    let shown = answers.prompts.into_iter().zip(shares).zip((0..).map(prompt_colour));
    Ok(shown.map(|((prompt, shares), colour)| page_prompt(prompt, shares, colour)).collect())
}

fn page_prompt(prompt: PromptAnswers, shares: Vec<f32>, colour: [u8; 3]) -> PagePrompt {
    let note = if prompt.answer == Verdict::Found { String::new() } else { prompt.why_not_found() };
    let frames = prompt.frames.iter().map(|frame| frame.answer.name()).collect();
    PagePrompt { text: prompt.text, colour, frames, nearest: prompt.nearest, note, shares }
}

/// Returns for each prompt and Gaussian the share of frames on which the score is above the threshold.
fn shares(engine: &mut Engine) -> Result<Vec<Vec<f32>>> {
    let (scene, threshold) = (engine.scene().clone(), engine.settings().threshold);
    let part = 1.0 / scene.num_frames().max(1) as f32;
    let mut shares = vec![vec![0.0; scene.gaussians.len()]; engine.queries().len()];
    for frame in 0..scene.num_frames() {
        for (shares, scores) in shares.iter_mut().zip(engine.gaussian_scores(scene.time(frame))?) {
            let found = shares.iter_mut().zip(&scores).filter(|(_, score)| **score > threshold);
            found.for_each(|(share, _)| *share += part);
        }
    }
    Ok(shares)
}
