//! Findings of all prompts of a picture.

use crate::{
    engine::{Answer, Question},
    viewer::picture::{
        found::Found,
        request::{AskedPrompt, Finding, Request},
    },
};
use rayon::prelude::*;
use std::sync::Arc;
use surgtpgs_core::{
    grid::{Grid, Mask},
    mask::{CleanUp, threshold},
};

/// A score image, or why there is none.
pub(crate) type Scores = Result<Arc<Grid<f32>>, String>;
/// A question with its scores.
pub(crate) type PromptScores = (Question, Scores);

/// Results of the prompts of the last picture. The next one has most of them, too, while words are typed.
#[derive(Default)]
pub(crate) struct FoundLast(Vec<Known>);

/// A result with what it was made from, beside the scores in it.
struct Known {
    threshold: f32,
    clean_up: CleanUp,
    found: Found,
}

impl FoundLast {
    /// Returns what was found of each prompt of a request, with what is `said` to it. Numbers of prompts lie
    /// beside `tools` and other instruments.
    pub(crate) fn findings(
        &mut self,
        answers: &[PromptScores],
        request: &Request,
        said: &[Option<Answer>],
        tools: Option<&Mask>,
    ) -> Vec<Finding> {
        let clean_up = request.clean_up();
        let finding = |(prompt, answer): (&AskedPrompt, &Option<Answer>)| {
            let (_, scores) = answers.iter().find(|(question, _)| *question == prompt.question)?;
            let outcome = scores.clone().map(|scores| self.found(scores, prompt.threshold, clean_up));
            Some(Finding {
                id: prompt.id,
                text: prompt.question.text.clone(),
                answer: answer.clone(),
                outcome,
            })
        };
        let asked = request.prompts.par_iter().zip(said);
        let mut findings: Vec<Finding> = asked.filter_map(finding).collect();
        let prompt = |id| request.prompts.iter().find(|p| p.id == id);
        let known = |finding: &Finding| {
            let (threshold, found) = (prompt(finding.id)?.threshold, finding.outcome.as_ref().ok()?.clone());
            Some(Known { threshold, clean_up, found })
        };
        self.0 = findings.iter().filter_map(known).collect();
        let instruments = findings.iter().filter_map(|finding| {
            let instrument = prompt(finding.id).filter(|p| p.is_instrument)?;
            Some(threshold(&finding.outcome.as_ref().ok()?.cleaned, instrument.threshold))
        });
        if let Some(covered) = tools.cloned().into_iter().chain(instruments).reduce(union) {
            findings.par_iter_mut().for_each(|finding| {
                let tissue = prompt(finding.id).filter(|p| !p.is_instrument);
                if let (Some(prompt), Ok(found)) = (tissue, &mut finding.outcome) {
                    found.place_number(prompt.threshold, &covered);
                }
            });
        }
        findings
    }

    /// Returns the result of a prompt with these scores, which may be one of the last picture.
    fn found(&self, scores: Arc<Grid<f32>>, threshold: f32, clean_up: CleanUp) -> Found {
        let is_same = |known: &&Known| {
            (known.threshold, known.clean_up) == (threshold, clean_up)
                && Arc::ptr_eq(&known.found.scores, &scores)
        };
        let known = self.0.iter().find(is_same).map(|known| known.found.clone());
        known.unwrap_or_else(|| Found::new(scores, threshold, clean_up))
    }
}

/// Returns the pixels of either mask, in the size of the second one.
fn union(a: Mask, mut b: Mask) -> Mask {
    let a = a.sampled(b.width, b.height);
    b.data.iter_mut().zip(a.data).for_each(|(b, a)| *b |= a);
    b
}
